"""Makes tests/fixtures/nerf_pytorch.tar and nerf_pytorch.json: a checkpoint in nerf-pytorch's format, and its rendering.

    python tools/nerf_pytorch_fixture.py tests/fixtures        (PyTorch; no other package)

Network and renderer are written from the paper's equations, in nerf-pytorch's conventions: names of modules, encoding with the
identity first, input before the trunk's output at the skip, rays through integer pixels, even samples and even u (no jitter,
no noise), the last interval 1e10 long, white background.
"""

import json
import sys

import torch
from torch import nn

WIDTH, DEPTH, SKIP = 32, 8, 4
OCTAVES = (6, 2)
SAMPLES, FINE = 24, 24
NEAR, FAR = 2.0, 6.0
COLUMNS, ROWS, FOCAL = 20, 14, 22.0


def encode(x, octaves):
    parts = [x]
    for k in range(octaves):
        parts += [torch.sin(x * 2.0**k), torch.cos(x * 2.0**k)]
    return torch.cat(parts, -1)


class Network(nn.Module):
    def __init__(self, depth, width, position, direction, skip):
        super().__init__()
        self.skip = skip
        inputs = [position] + [width + position if i == skip + 1 else width for i in range(1, depth)]
        self.pts_linears = nn.ModuleList([nn.Linear(n, width) for n in inputs])
        self.views_linears = nn.ModuleList([nn.Linear(direction + width, width // 2)])
        self.feature_linear = nn.Linear(width, width)
        self.alpha_linear = nn.Linear(width, 1)
        self.rgb_linear = nn.Linear(width // 2, 3)

    def forward(self, position, direction):
        hidden = position
        for i, layer in enumerate(self.pts_linears):
            hidden = torch.relu(layer(hidden))
            if i == self.skip:
                hidden = torch.cat([position, hidden], -1)
        density = self.alpha_linear(hidden)[..., 0]
        hidden = torch.cat([self.feature_linear(hidden), direction], -1)
        hidden = torch.relu(self.views_linears[0](hidden))
        return torch.sigmoid(self.rgb_linear(hidden)), torch.relu(density)


def render(network, origins, directions, t):
    points = origins[:, None] + t[..., None] * directions[:, None]
    views = directions / directions.norm(dim=-1, keepdim=True)
    views = views[:, None].expand(points.shape)
    rgb, density = network(encode(points, OCTAVES[0]), encode(views, OCTAVES[1]))
    lengths = torch.cat([t[:, 1:] - t[:, :-1], torch.full_like(t[:, :1], 1e10)], -1)
    lengths = lengths * directions.norm(dim=-1, keepdim=True)
    alpha = 1 - torch.exp(-density * lengths)
    passed = torch.cumprod(torch.cat([torch.ones_like(alpha[:, :1]), 1 - alpha + 1e-10], -1), -1)[:, :-1]
    weights = alpha * passed
    colour = (weights[..., None] * rgb).sum(1) + (1 - weights.sum(-1, keepdim=True))
    return colour, weights


def place(t, weights, count):
    """Samples the piecewise constant distribution over the midpoints of intervals, at even u."""
    middles = 0.5 * (t[:, 1:] + t[:, :-1])
    weights = weights[:, 1:-1] + 1e-5
    cdf = torch.cumsum(weights / weights.sum(-1, keepdim=True), -1)
    cdf = torch.cat([torch.zeros_like(cdf[:, :1]), cdf], -1)
    u = torch.linspace(0, 1, count).expand(t.shape[0], count).contiguous()
    above = torch.searchsorted(cdf, u, right=True)
    low, high = (above - 1).clamp(min=0), above.clamp(max=cdf.shape[-1] - 1)
    c0, c1 = cdf.gather(1, low), cdf.gather(1, high)
    t0, t1 = middles.gather(1, low), middles.gather(1, high)
    width = torch.where(c1 - c0 < 1e-5, torch.ones_like(c0), c1 - c0)
    return t0 + (u - c0) / width * (t1 - t0)


def picture(coarse, fine, pose):
    y, x = torch.meshgrid(torch.arange(ROWS).float(), torch.arange(COLUMNS).float(), indexing="ij")
    local = torch.stack([(x - 0.5 * COLUMNS) / FOCAL, -(y - 0.5 * ROWS) / FOCAL, -torch.ones_like(x)], -1)
    directions = (local.reshape(-1, 3)[:, None] * pose[:3, :3]).sum(-1)
    origins = pose[:3, 3].expand(directions.shape)
    t = torch.linspace(0, 1, SAMPLES)
    t = (NEAR * (1 - t) + FAR * t).expand(directions.shape[0], SAMPLES)
    _, weights = render(coarse, origins, directions, t)
    t, _ = torch.sort(torch.cat([t, place(t, weights, FINE)], -1), -1)
    return render(fine, origins, directions, t)[0]


def made(depth, width, seed):
    """Makes weights that render something: larger than PyTorch's, with density in some places."""
    torch.manual_seed(seed)
    network = Network(depth, width, 3 + 6 * OCTAVES[0], 3 + 6 * OCTAVES[1], SKIP)
    with torch.no_grad():
        for name, values in network.named_parameters():
            values *= 1.7 if name.endswith("weight") else 1.0
        network.alpha_linear.weight *= 6
        network.rgb_linear.weight *= 4
    return network


def checkpoint(coarse, fine, step):
    """Returns the object that nerf-pytorch saves, with Adam's state after a step."""
    parameters = list(coarse.parameters()) + list(fine.parameters())
    adam = torch.optim.Adam(parameters, lr=5e-4, betas=(0.9, 0.999))
    return {
        "global_step": step,
        "network_fn_state_dict": coarse.state_dict(),
        "network_fine_state_dict": fine.state_dict(),
        "optimizer_state_dict": adam.state_dict(),
    }


def look(angle):
    angle = torch.tensor(angle)
    back = torch.tensor([torch.cos(angle) * 0.9, torch.sin(angle) * 0.9, 0.4358899])
    right = torch.linalg.cross(torch.tensor([0.0, 0.0, 1.0]), back)
    right = right / right.norm()
    pose = torch.eye(4)
    pose[:3, 0], pose[:3, 1], pose[:3, 2], pose[:3, 3] = right, torch.linalg.cross(back, right), back, 4 * back
    return pose


def main(folder):
    coarse, fine = made(DEPTH, WIDTH, 1), made(DEPTH, WIDTH, 2)
    pose = look(0.7)
    with torch.no_grad():
        rgb = picture(coarse, fine, pose)
    print("mean", rgb.mean(0).tolist(), "deviation", rgb.std(0).tolist())
    torch.save(checkpoint(coarse, fine, 1234), f"{folder}/nerf_pytorch.tar")
    said = {
        "torch": torch.__version__,
        "near": NEAR,
        "far": FAR,
        "samples": [SAMPLES, FINE],
        "width": COLUMNS,
        "height": ROWS,
        "focal": FOCAL,
        "pose": pose.tolist(),
        "rgb": [round(value, 6) for value in rgb.reshape(-1).tolist()],
    }
    with open(f"{folder}/nerf_pytorch.json", "w") as file:
        json.dump(said, file)
        file.write("\n")


if __name__ == "__main__":
    main(sys.argv[1])
