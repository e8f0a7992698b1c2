#!/usr/bin/env python3
"""Times PyTorch and augnerf in turn on the same work and prints how many times as many rays a second augnerf takes.

    python3 -m venv .venv && .venv/bin/pip install torch
    cargo build --release
    benches/ratios.py --python .venv/bin/python --threads 2
    benches/ratios.py --python .venv/bin/python --threads 2 --bf16

Nothing else should run beside it. A round times both programs one after the other, in an order that changes from round
to round. Each line is one kind of step: medians over the rounds of each program's own median step, the median of the
rounds' ratios, their lowest and highest, and what augnerf says of its own work: multiply-adds of a step, share of the
peak of large f32 products. `hash` is a hash-grid field (torch_hash_peer.py).

--bf16 is what users of either switch on: torch.autocast there, field.precision here. --peer-bf16 does it there alone.
"""
import argparse
import json
import pathlib
import statistics
import subprocess

HERE = pathlib.Path(__file__).parent
# Method, rays, coarse, fine, width, steps; of hash the samples that place and those that are shaded, of srn and nv none; nv's
# width is the voxels along a side.
PROCESSOR = [
    ("nerf", 256, 64, 64, 256, 5),
    ("aug", 256, 64, 64, 256, 3),
    ("nerf", 256, 32, 32, 64, 40),
    ("aug", 256, 32, 32, 64, 20),
    ("hash", 1024, 48, 32, 64, 20),
    ("srn", 1024, None, None, 256, 20),
    ("nv", 2048, None, None, 64, 10),
]
GPU = [
    ("nerf", 1024, 64, 64, 256, 20),
    ("aug", 1024, 64, 64, 256, 10),
    ("nerf", 1024, 64, 128, 256, 20),
    ("aug", 1024, 64, 128, 256, 10),
]
# Those of their own.
PEERS = {"hash": "torch_hash_peer.py", "srn": "srn_peer.py", "nv": "nv_peer.py"}
# What makes augnerf's step of NeRF that of the peer's hash grid, whose tables have 2^17 entries.
HASH = ["field.encoding=hash"]
# Sizes of preset fast: a quarter of the original's channels, half its voxels along a side.
DIVIDE, WARP = 4, 16


def ask(command):
    done = subprocess.run(command, capture_output=True, text=True)
    if done.returncode != 0:
        raise SystemExit(f"{' '.join(command)} failed:\n{done.stderr}")
    return json.loads(done.stdout.splitlines()[-1])


def cell(value, width, digits, scale=1.0):
    return f"{'-':>{width}}" if value is None else f"{value * scale:{width}.{digits}f}"


def peer_command(kind, arguments):
    method, rays, coarse, fine, width, steps = kind
    program = [arguments.python, str(HERE / PEERS.get(method, "torch_peer.py"))]
    flags = ["--rays", str(rays), "--steps", str(steps), "--threads", str(arguments.threads)]
    if method == "hash":
        flags += ["--placing", str(coarse), "--shaded", str(fine)]
    elif method == "srn":
        flags += ["--width", str(width)]
    elif method == "nv":
        flags += ["--resolution", str(width), "--divide", str(DIVIDE), "--warp", str(WARP)]
    else:
        flags += ["--method", method, "--coarse", str(coarse), "--fine", str(fine), "--width", str(width)]
        flags += ["--device", arguments.device] + ["--tf32"] * arguments.tf32
    return program + flags + ["--bf16"] * (arguments.bf16 or arguments.peer_bf16)


def our_command(kind, arguments):
    method, rays, coarse, fine, width, steps = kind
    flags = ["--method", "nerf" if method == "hash" else method, "--rays", str(rays)]
    flags += ["--steps", str(steps), "--threads", str(arguments.threads)]
    flags += [] if method == "nv" else ["--width", str(width)]
    flags += [] if coarse is None else ["--coarse", str(coarse), "--fine", str(fine)]
    volume = [f"nv.resolution={width}", f"nv.divide={DIVIDE}", f"nv.warp_resolution={WARP}"]
    settings = {"hash": HASH, "nv": volume}.get(method, [])
    settings = settings + ["field.precision=bf16"] * arguments.bf16
    flags += [word for setting in settings for word in ("--set", setting)]
    return [arguments.augnerf, "bench", *flags, "--device", arguments.device + "-tf32" * arguments.tf32]


def line(kind, rounds):
    """What the rounds of a kind of step say; each is (peer's JSON, ours)."""
    seconds = [[timed["seconds_per_step"] for timed in side] for side in zip(*rounds)]
    peer, ours = map(statistics.median, seconds)
    ratios = sorted(theirs / mine for theirs, mine in zip(*seconds))
    last = rounds[-1][1]
    return (f"{kind[0]:6} {kind[4]:5} {peer:8.4f} {ours:9.4f} {statistics.median(ratios):6.2f} "
            f"{ratios[0]:5.2f}..{ratios[-1]:5.2f} {cell(last['multiply_adds_per_step'], 8, 2, 1e-9)} "
            f"{cell(last['gflops'], 8, 0)} {cell(last['share_of_peak'], 7, 2)}")


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--python", default="python3", help="an interpreter that has torch")
    parser.add_argument("--augnerf", default=str(HERE.parent / "target/release/augnerf"))
    parser.add_argument("--threads", type=int, default=2)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--device", default="cpu", help="cpu or cuda; cuda takes the paper's sizes")
    parser.add_argument("--tf32", action="store_true")
    parser.add_argument("--bf16", action="store_true", help="both in bfloat16")
    parser.add_argument("--peer-bf16", action="store_true", help="PyTorch alone in bfloat16")
    parser.add_argument("--only", help="method:width, such as aug:256 or hash:64")
    arguments = parser.parse_args()
    print(f"{'method':6} {'width':>5} {'torch s':>8} {'augnerf s':>9} {'ratio':>6} {'of rounds':>12} {'Gmul-add':>8} "
          f"{'GFLOP/s':>8} {'of peak':>7}")
    for kind in PROCESSOR if arguments.device == "cpu" else GPU:
        if arguments.only and arguments.only != f"{kind[0]}:{kind[4]}":
            continue
        if kind[0] in ("srn", "nv") and (arguments.bf16 or arguments.peer_bf16):
            continue
        commands = [peer_command(kind, arguments), our_command(kind, arguments)]
        rounds = []
        for turn in range(arguments.rounds):
            # Whoever comes second finds the processor warm: they change places.
            timed = [ask(command) for command in (commands if turn % 2 == 0 else commands[::-1])]
            rounds.append(timed if turn % 2 == 0 else timed[::-1])
        print(line(kind, rounds), flush=True)


if __name__ == "__main__":
    main()
