#!/usr/bin/env python3
"""Training-step time of a Scene Representation Network (Sitzmann et al. 2019) in PyTorch: the peer of `--method srn`.

    python3 -m venv .venv && .venv/bin/pip install torch
    .venv/bin/python srn_peer.py --rays 1024 --threads 2
    augnerf bench --method srn --rays 1024 --width 256 --threads 2

Prints one JSON line: seconds per step (median), rays per second, the work done.
The work is that of the original code for a single scene: 4 layers (linear, layer norm, ReLU) from a point to its feature,
10 steps of an LSTM cell with 16 numbers and a linear head, 5 layers and a linear one from the last feature to a colour; the
squared error of colours and of depths behind the camera; Adam at 5e-5. Gradients at the cell's outputs are cut to 10 by a
hook. Its printing at every step is left out.
"""
import argparse, json, statistics, time
import torch
import torch.nn as nn


def layers(inputs, width, count):
    sizes = [inputs] + [width] * count
    blocks = [nn.Sequential(nn.Linear(i, o), nn.LayerNorm([o]), nn.ReLU(inplace=True)) for i, o in zip(sizes, sizes[1:])]
    net = nn.Sequential(*blocks)
    for module in net.modules():
        if isinstance(module, nn.Linear):
            nn.init.kaiming_normal_(module.weight, nonlinearity="relu")
    return net


class Srn(nn.Module):
    def __init__(self, width, steps, hidden=16):
        super().__init__()
        self.steps = steps
        self.phi = layers(3, width, 4)
        self.cell = nn.LSTMCell(width, hidden)
        for bias in (self.cell.bias_ih, self.cell.bias_hh):
            bias.data[hidden:2 * hidden] = 1
        self.head = nn.Linear(hidden, 1)
        self.pixel = nn.Sequential(layers(width, width, 5), nn.Linear(width, 3))

    def forward(self, origins, directions, viewdirs):
        z = torch.empty(len(origins), 1, device=origins.device).normal_(0.05, 5e-4)
        x, state = origins + z * directions, None
        per_length = 1 / directions.norm(dim=-1, keepdim=True)
        for _ in range(self.steps):
            state = self.cell(self.phi(x), state)
            state[0].register_hook(lambda gradient: gradient.clamp(-10, 10))
            length = self.head(state[0])
            x, z = x + viewdirs * length, z + length * per_length
        return self.pixel(self.phi(x)), z


def main():
    a = argparse.ArgumentParser()
    a.add_argument("--rays", type=int, default=1024)
    a.add_argument("--width", type=int, default=256)
    a.add_argument("--march", type=int, default=10, help="steps along a ray")
    a.add_argument("--steps", type=int, default=20)
    a.add_argument("--threads", type=int, default=0)
    a.add_argument("--device", default="cpu")
    a.add_argument("--compile", action="store_true", help="torch.compile the network")
    a = a.parse_args()
    if a.threads:
        torch.set_num_threads(a.threads)
    torch.manual_seed(0)
    dev = torch.device(a.device)
    net = Srn(a.width, a.march).to(dev)
    run = torch.compile(net) if a.compile else net
    opt = torch.optim.Adam(net.parameters(), 5e-5)
    o = torch.zeros(a.rays, 3, device=dev)
    o[:, 2] = 4
    d = torch.cat([torch.rand(a.rays, 2, device=dev) - 0.5, -torch.ones(a.rays, 1, device=dev)], -1)
    u = nn.functional.normalize(d, dim=-1)
    target = 2 * torch.rand(a.rays, 3, device=dev) - 1
    times = []
    for _ in range(a.steps + 3):
        start = time.perf_counter()
        opt.zero_grad()
        colour, z = run(o, d, u)
        loss = 200 * ((colour - target) ** 2).mean() + 10 * (z.clamp(max=0) ** 2).mean()
        loss.backward()
        opt.step()
        if dev.type == "cuda":
            torch.cuda.synchronize()
        times.append(time.perf_counter() - start)
    sec = statistics.median(times[3:])
    print(json.dumps(dict(peer="torch " + torch.__version__, method="srn", **vars(a), seconds_per_step=round(sec, 4),
                          rays_per_second=round(a.rays / sec, 1))))


if __name__ == "__main__":
    main()
