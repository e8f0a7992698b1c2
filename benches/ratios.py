#!/usr/bin/env python3
"""Times PyTorch and augnerf in turn on the same work and prints how many times as many rays a second augnerf takes.

    python3 -m venv .venv && .venv/bin/pip install torch
    cargo build --release
    benches/ratios.py --python .venv/bin/python --threads 2

Nothing else should run beside it. Each line is one kind of step: medians over the rounds of each program's own median
step, their ratio, the lowest and the highest ratio of a round, and what augnerf says of its own work.
"""
import argparse
import json
import pathlib
import statistics
import subprocess

HERE = pathlib.Path(__file__).parent
# Method, rays, coarse, fine, width, steps.
PROCESSOR = [
    ("nerf", 256, 64, 64, 256, 5),
    ("aug", 256, 64, 64, 256, 3),
    ("nerf", 256, 32, 32, 64, 40),
    ("aug", 256, 32, 32, 64, 20),
]
GPU = [
    ("nerf", 1024, 64, 64, 256, 20),
    ("aug", 1024, 64, 64, 256, 10),
    ("nerf", 1024, 64, 128, 256, 20),
    ("aug", 1024, 64, 128, 256, 10),
]


def ask(command):
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def cell(value, width, digits):
    return f"{'-':>{width}}" if value is None else f"{value:{width}.{digits}f}"


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", default="python3", help="an interpreter that has torch")
    parser.add_argument("--augnerf", default=str(HERE.parent / "target/release/augnerf"))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--device", default="cpu", help="cpu or cuda; cuda takes the paper's sizes")
    parser.add_argument("--tf32", action="store_true")
    parser.add_argument("--only", help="method:width, such as aug:256")
    arguments = parser.parse_args()
    threads = str(arguments.threads)
    print(f"{'method':6} {'width':>5} {'torch s':>8} {'augnerf s':>9} {'ratio':>6} {'of rounds':>12} {'GFLOP/s':>8} "
          f"{'of peak':>7} {'active':>6}")
    for method, rays, coarse, fine, width, steps in PROCESSOR if arguments.device == "cpu" else GPU:
        if arguments.only and arguments.only != f"{method}:{width}":
            continue
        flags = ["--method", method, "--rays", str(rays), "--coarse", str(coarse), "--fine", str(fine)]
        flags += ["--width", str(width), "--steps", str(steps), "--threads", threads]
        our_device = ["--device", arguments.device + "-tf32" * arguments.tf32]
        their_device = ["--device", arguments.device] + ["--tf32"] * arguments.tf32
        rounds = []
        for _ in range(arguments.rounds):
            peer = ask([arguments.python, str(HERE / "torch_peer.py"), *flags, *their_device])
            rounds.append((peer["seconds_per_step"], ask([arguments.augnerf, "bench", *flags, *our_device])))
        peer = statistics.median(peer for peer, _ in rounds)
        ours = statistics.median(ours["seconds_per_step"] for _, ours in rounds)
        ratios = sorted(peer / ours["seconds_per_step"] for peer, ours in rounds)
        last = rounds[-1][1]
        print(f"{method:6} {width:5} {peer:8.4f} {ours:9.4f} {peer / ours:6.2f} {ratios[0]:5.2f}..{ratios[-1]:5.2f} "
              f"{cell(last['gflops'], 8, 0)} {cell(last['share_of_peak'], 7, 2)} {cell(last['active_share'], 6, 2)}", flush=True)


if __name__ == "__main__":
    main()
