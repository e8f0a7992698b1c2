#!/usr/bin/env python3
"""Training-step time of a hash-grid field in PyTorch on a processor: Instant-NGP (Mueller et al. 2022) with dense gathers,
as it is written without a GPU and its kernels.

    python3 -m venv .venv && .venv/bin/pip install torch
    .venv/bin/python torch_hash_peer.py --rays 1024 --threads 2

Prints one JSON line: seconds per step (median), points per second, the work done.
The work: 16 levels of 2 features, tables of 2^17, trilinear; density network 32-64-16, colour network (16 + spherical
harmonics of degree 4)-64-64-3; 48 even samples with density alone place 32 that are shaded by the inverse CDF, in one
field; photometric loss of the shaded samples, Adam with beta 0.9, 0.99 and epsilon 1e-15 on all parameters.
Gradients: dense, by `index_add` into the tables. Placing has none (`torch.no_grad`).
"""
import argparse, json, math, statistics, time
import torch
import torch.nn as nn
import torch.nn.functional as F

from torch_peer import composite, inverse_cdf

PRIMES = (1, 2654435761, 805459861)


class Tables(nn.Module):
    """Positions in 0..1 `[n, 3]` to features `[n, levels * features]`."""

    def __init__(self, levels=16, features=2, log2=17, coarsest=16, finest=2048):
        super().__init__()
        growth = math.exp((math.log(finest) - math.log(coarsest)) / (levels - 1))
        self.resolution = [int(coarsest * growth**level + 1e-9) for level in range(levels)]
        self.sizes = [min((n + 1) ** 3, 1 << log2) for n in self.resolution]
        self.tables = nn.ParameterList(nn.Parameter(torch.empty(size, features).uniform_(-1e-4, 1e-4)) for size in self.sizes)
        self.register_buffer("corners", torch.tensor([[i >> 2 & 1, i >> 1 & 1, i & 1] for i in range(8)]))

    def index(self, corner, n, size):
        """Entries of lattice corners `[..., 3]`: dense where the level fits, otherwise hashed."""
        x, y, z = corner.unbind(-1)
        if (n + 1) ** 3 <= size:
            return x + (n + 1) * (y + (n + 1) * z)
        return ((x * PRIMES[0]) ^ (y * PRIMES[1]) ^ (z * PRIMES[2])) & (size - 1)

    def forward(self, points):
        found = []
        for n, size, table in zip(self.resolution, self.sizes, self.tables):
            scaled = points * n
            cell = scaled.floor().clamp(0, n - 1)
            share = (scaled - cell)[:, None]  # [n, 1, 3]
            weight = torch.where(self.corners.bool(), share, 1 - share).prod(-1)  # [n, 8]
            index = self.index(cell.long()[:, None] + self.corners, n, size)  # [n, 8]
            found.append((F.embedding(index, table) * weight[..., None]).sum(1))
        return torch.cat(found, -1)


def harmonics(d):
    """Spherical harmonics up to degree 4 (16 numbers) of unit directions `[n, 3]`."""
    x, y, z = d.unbind(-1)
    xx, yy, zz, xy, yz, xz = x * x, y * y, z * z, x * y, y * z, x * z
    return torch.stack([
        torch.full_like(x, 0.28209479), -0.48860251 * y, 0.48860251 * z, -0.48860251 * x,
        1.09254843 * xy, -1.09254843 * yz, 0.94617470 * zz - 0.31539157, -1.09254843 * xz, 0.54627422 * (xx - yy),
        0.59004359 * y * (yy - 3 * xx), 2.89061144 * xy * z, 0.45704580 * y * (1 - 5 * zz),
        0.37317633 * z * (5 * zz - 3), 0.45704580 * x * (1 - 5 * zz), 1.44530572 * z * (xx - yy),
        0.59004359 * x * (3 * yy - xx)], -1)


class HashField(nn.Module):
    def __init__(self, log2):
        super().__init__()
        self.tables = Tables(log2=log2)
        self.trunk = nn.Sequential(nn.Linear(32, 64, bias=False), nn.ReLU(), nn.Linear(64, 16, bias=False))
        self.colour = nn.Sequential(nn.Linear(32, 64, bias=False), nn.ReLU(), nn.Linear(64, 64, bias=False), nn.ReLU(),
                                    nn.Linear(64, 3, bias=False))

    def features(self, points):
        """Points `[rays, samples, 3]` to density and features of each, `[rays * samples]` and `[rays * samples, 16]`."""
        feature = self.trunk(self.tables(((points.flatten(0, 1) + 1.5) / 3).clamp(0, 1)))
        return torch.exp(feature[:, 0].float().clamp(max=15)), feature

    def density(self, points):
        return self.features(points)[0].view(points.shape[:2])

    def forward(self, points, view):
        rays, samples = points.shape[:2]
        density, feature = self.features(points)
        seen = harmonics(view)[:, None].expand(-1, samples, -1).flatten(0, 1)
        rgb = torch.sigmoid(self.colour(torch.cat([feature, seen.to(feature.dtype)], -1)))
        return rgb.view(rays, samples, 3), density.view(rays, samples)


def render(field, o, d, near, far, placing, shaded):
    edges = torch.linspace(near, far, placing + 1)
    t = edges[:-1] + (edges[1:] - edges[:-1]) * torch.rand(o.shape[0], placing)
    with torch.no_grad():
        density = field.density(o[:, None] + t[..., None] * d[:, None])
        _, weights = composite(torch.zeros(*t.shape, 3), density, t)
        t = inverse_cdf(0.5 * (t[:, 1:] + t[:, :-1]), weights[:, 1:-1], shaded).sort(-1).values
    rgb, density = field(o[:, None] + t[..., None] * d[:, None], d)
    return composite(rgb, density, t)[0]


def main():
    a = argparse.ArgumentParser()
    a.add_argument("--rays", type=int, default=1024)
    a.add_argument("--placing", type=int, default=48, help="samples with density alone")
    a.add_argument("--shaded", type=int, default=32)
    a.add_argument("--log2", type=int, default=17, help="entries of a table, as a power of 2")
    a.add_argument("--steps", type=int, default=5)
    a.add_argument("--threads", type=int, default=0)
    a.add_argument("--bf16", action="store_true", help="torch.autocast to bfloat16")
    a = a.parse_args()
    if a.threads:
        torch.set_num_threads(a.threads)
    torch.manual_seed(0)
    field = HashField(a.log2)
    optimizer = torch.optim.Adam(field.parameters(), 1e-2, betas=(0.9, 0.99), eps=1e-15)
    o = torch.zeros(a.rays, 3)
    o[:, 2] = 4
    d = F.normalize(torch.randn(a.rays, 3) * 0.2 + torch.tensor([0.0, 0, -1]), dim=-1)
    target = torch.rand(a.rays, 3)
    times = []
    for _ in range(a.steps + 2):
        start = time.perf_counter()
        optimizer.zero_grad()
        with torch.autocast("cpu", torch.bfloat16, enabled=a.bf16):
            colour = render(field, o, d, 2.5, 5.5, a.placing, a.shaded)
            ((colour - target) ** 2).mean().backward()
        optimizer.step()
        times.append(time.perf_counter() - start)
    seconds = statistics.median(times[2:])
    points = a.rays * (a.placing + a.shaded)
    print(json.dumps(dict(peer="torch " + torch.__version__, method="hash", **vars(a), seconds_per_step=round(seconds, 4),
                          rays_per_second=round(a.rays / seconds, 1), points_per_second=round(points / seconds, 1),
                          points_per_clean_pass=points)))


if __name__ == "__main__":
    main()
