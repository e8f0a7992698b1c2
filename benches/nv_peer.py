#!/usr/bin/env python3
"""Training-step time of Neural Volumes (Lombardi et al. 2019) in PyTorch: the peer of `--method nv`.

    python3 -m venv .venv && .venv/bin/pip install torch
    .venv/bin/python nv_peer.py --rays 2048 --resolution 64 --divide 4 --warp 16 --threads 2
    augnerf bench --method nv --rays 2048 --set nv.resolution=64 --set nv.divide=4 --set nv.warp_resolution=16 --threads 2

Prints one JSON line: seconds per step (median), rays per second, the work done.
The work is that of the original code for a still scene, without its encoder: a learned code, transposed convolutions to
a volume of colour and opacity, a mixture of 16 affine maps as its warp, `grid_sample` of both (corners aligned, as in the torch
that it was written for) at each step along the rays until the last of them leaves the box, the squared error of colours, the
priors of accumulation and variation, Adam at 1e-4.
"""
import argparse, json, math, statistics, time
import torch
import torch.nn as nn
import torch.nn.functional as F


def template(code, resolution, divide):
    layers = [nn.Linear(code, 1024 // divide), nn.LeakyReLU(0.2), nn.Unflatten(1, (1024 // divide, 1, 1, 1))]
    inputs, outputs = 1024, 512
    for _ in range(int(math.log2(resolution)) - 1):
        layers += [nn.ConvTranspose3d(inputs // divide, outputs // divide, 4, 2, 1), nn.LeakyReLU(0.2)]
        if inputs == outputs:
            outputs = inputs // 2
        else:
            inputs = outputs
    return nn.Sequential(*layers, nn.ConvTranspose3d(inputs // divide, 4, 4, 2, 1))


class Warp(nn.Module):
    def __init__(self, code, side, maps=16):
        super().__init__()
        self.side, self.maps = side, maps
        def head(hidden, outputs):
            return nn.Sequential(nn.Linear(code, hidden), nn.LeakyReLU(0.2), nn.Linear(hidden, outputs))
        self.scale, self.turn, self.shift = head(128, 3 * maps), head(128, 4 * maps), head(128, 3 * maps)
        self.weights = head(64, maps * side ** 3)
        at = torch.linspace(-1, 1, side)
        z, y, x = torch.meshgrid(at, at, at, indexing="ij")
        self.register_buffer("grid", torch.stack([x, y, z], -1))

    def rotations(self, q):
        x, y, z, w = (q / torch.sqrt(1e-5 + (q ** 2).sum(-1, keepdim=True))).unbind(-1)
        rows = [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w),
                2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w),
                2 * (x * z - y * w), 2 * (x * w + y * z), 1 - 2 * (x * x + y * y)]
        return torch.stack(rows, -1).view(-1, 3, 3)

    def forward(self, code):
        scale, shift = self.scale(code).view(self.maps, 3), 0.1 * self.shift(code).view(self.maps, 3)
        turn = self.rotations(self.turn(code).view(self.maps, 4))
        weights = torch.exp(self.weights(code).view(self.maps, 1, self.side, self.side, self.side))
        moved, sampled = [], []
        for i in range(self.maps):
            at = ((self.grid - shift[i])[..., None, :] * turn[i]).sum(-1) * scale[i]
            moved.append(at)
            sampled.append(F.grid_sample(weights[i:i + 1], at[None], padding_mode="border", align_corners=True)[0, 0])
        weights = torch.stack(sampled)
        mixed = (weights[..., None] * torch.stack(moved)).sum(0) / weights.sum(0).clamp(min=0.001)[..., None]
        return mixed.permute(3, 0, 1, 2)[None]


class Volume(nn.Module):
    def __init__(self, resolution, divide, warp, code=256):
        super().__init__()
        self.step = 2 / resolution
        self.code = nn.Parameter(torch.randn(1, code))
        self.template, self.warp = template(code, resolution, divide), Warp(code, warp)
        self.register_buffer("scale", torch.tensor([25., 25., 25., 1.]).view(1, 4, 1, 1, 1))
        self.register_buffer("shift", torch.tensor([100., 100., 100., 0.]).view(1, 4, 1, 1, 1))

    def march(self, volume, warp, o, u):
        with torch.no_grad():
            a, b = (-1 - o) / u, (1 - o) / u
            near, far = torch.minimum(a, b).amax(-1).clamp(min=0), torch.maximum(a, b).amin(-1)
            far = torch.where(near < far, far, torch.full_like(far, -1))
            near = torch.where(near < far, near, torch.zeros_like(near))
        t = near - self.step * torch.rand_like(near)
        x = o + t[:, None] * u
        rgb, acc = torch.zeros_like(o), torch.zeros(len(o), 1, device=o.device)
        done = torch.zeros_like(t, dtype=torch.bool)
        while not done.all():
            inside = ((x > -1) & (x < 1)).all(-1, keepdim=True).float()
            at = F.grid_sample(warp, x.view(1, 1, 1, -1, 3), align_corners=True).view(3, -1).t()
            value = F.grid_sample(volume, at.view(1, 1, 1, -1, 3), align_corners=True).view(4, -1).t() * inside
            with torch.no_grad():
                step = self.step * torch.exp(0.01 * torch.randn_like(t))
                done = done | (t + step >= far)
            more = ((acc + value[:, 3:] * step[:, None]).clamp(max=1) - acc) * inside
            rgb, acc = rgb + value[:, :3] * more, acc + more
            x, t = x + u * step[:, None], t + step
        return rgb, acc

    def forward(self, o, u):
        volume = F.softplus(self.shift + self.scale * self.template(self.code))
        rgb, acc = self.march(volume, self.warp(self.code), o, u)
        log = torch.log(1e-5 + volume[:, -1])
        here = log[:, :-1, :-1, :-1]
        steps = [log[:, :-1, :-1, 1:] - here, log[:, :-1, 1:, :-1] - here, log[:, 1:, :-1, :-1] - here]
        variation = torch.sqrt(1e-5 + sum(step ** 2 for step in steps)).mean()
        prior = (torch.log(0.1 + acc) + torch.log(1.1 - acc) + 2.20727).mean()
        return rgb + (1 - acc) * 255, 0.01 * (prior + variation)


def main():
    a = argparse.ArgumentParser()
    a.add_argument("--rays", type=int, default=2048)
    a.add_argument("--resolution", type=int, default=64)
    a.add_argument("--divide", type=int, default=4)
    a.add_argument("--warp", type=int, default=16)
    a.add_argument("--steps", type=int, default=20)
    a.add_argument("--threads", type=int, default=0)
    a.add_argument("--device", default="cpu")
    a = a.parse_args()
    if a.threads:
        torch.set_num_threads(a.threads)
    torch.manual_seed(0)
    dev = torch.device(a.device)
    net = Volume(a.resolution, a.divide, a.warp).to(dev)
    opt = torch.optim.Adam(net.parameters(), 1e-4)
    # A camera four units from a box of three.
    o = torch.zeros(a.rays, 3, device=dev)
    o[:, 2] = 4 / 1.5
    d = torch.cat([torch.rand(a.rays, 2, device=dev) - 0.5, -torch.ones(a.rays, 1, device=dev)], -1)
    u = F.normalize(d, dim=-1)
    target = 255 * torch.rand(a.rays, 3, device=dev)
    times = []
    for _ in range(a.steps + 3):
        start = time.perf_counter()
        opt.zero_grad()
        rgb, priors = net(o, u)
        (((rgb - target) / 25).pow(2).mean() + priors).backward()
        opt.step()
        if dev.type == "cuda":
            torch.cuda.synchronize()
        times.append(time.perf_counter() - start)
    sec = statistics.median(times[3:])
    print(json.dumps(dict(peer="torch " + torch.__version__, method="nv", **vars(a), seconds_per_step=round(sec, 4),
                          rays_per_second=round(a.rays / sec, 1))))


if __name__ == "__main__":
    main()
