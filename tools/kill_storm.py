#!/usr/bin/env python3
"""Kills trainings and sweeps at random moments and compares their files with those of undisturbed ones, byte for byte.

    cargo build --release
    tools/kill_storm.py                       200 kills of trainings, 200 of sweeps, 200 of other commands, signals, a full disk,
                                              100 collects, 60 rounds of four containers
    tools/kill_storm.py --train 500 --seed 7  other numbers
    tools/kill_storm.py --only sweep,runners  some parts
    tools/kill_storm.py --short               under a minute

A training or sweep is started, killed, and started again as a user would, until it ends by itself. Then its folder must have
the same names and bytes as an undisturbed one, hidden names included. Not compared: clocks (timing.json, timing.csv)
and the process number in run.lock. Differing files are kept and named. The exit code is 0 if nothing differs, else 1.

Half of the kills come at a random time. If strace is available, the other half come at a random call that changes the file
system (write, rename, fsync, unlink, ...). The disk that fills up is a tmpfs; mounting it needs root, and so does a
container (unshare). Skipped parts are printed. Needs Python 3.9 without packages.
"""

import argparse
import hashlib
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
# Folders and files that are not reproducible.
FLEETING = {"timing.json", "timing.csv", "run.lock"}
CALLS = "write,rename,renameat2,unlink,unlinkat,rmdir,mkdir,link,linkat,fsync,ftruncate"
SIGNALS = {signal.SIGTERM: 143, signal.SIGINT: 130, signal.SIGHUP: 129}
# Seconds; a command that takes longer hangs.
PATIENCE = 300

SET = """
data.width=16 field.width=16 sampling.coarse=8 sampling.fine=8 train.rays=64 train.chunk=32 train.steps=40 train.checkpoint_every=2
train.log_every=2 train.eval_every=15 train.precrop_steps=3 eval.pictures=1
""".split()
SWEEP = """
title = "storm"
preset = "smoke"
scenes = ["builtin"]
seeds = [0]
metrics = ["psnr", "ssim", "tv"]
baseline = "NeRF"
[set]
{settings}
[[row]]
name = "NeRF"
[[row]]
name = "NeRF, one pass"
set = {{ "sampling.fine" = 0 }}
[[row]]
name = "Aug-NeRF"
set = {{ method = "aug-nerf", "perturb.attack" = "calibrated" }}
"""


def quoted(setting):
    name, value = setting.split("=")
    return f'"{name}" = {value}'


def content(folder):
    """Returns relative path -> file hash or link target, and every empty folder."""
    found = {}
    for path in sorted(folder.rglob("*")):
        place = path.relative_to(folder)
        if FLEETING.intersection(place.parts):
            continue
        if path.is_symlink():
            found[str(place)] = f"-> {os.readlink(path)}"
        elif path.is_file():
            found[str(place)] = hashlib.sha256(path.read_bytes()).hexdigest()
        elif not any(path.iterdir()):
            found[str(place) + "/"] = ""
    return found


def fill(path):
    """Writes a file until the disk is full."""
    with open(path, "wb", buffering=0) as file:
        try:
            while file.write(bytes(1 << 12)):
                pass
        except OSError:
            pass


class Storm:
    def __init__(self, arguments):
        self.arguments = arguments
        self.random = random.Random(arguments.seed)
        self.folder = Path(tempfile.mkdtemp(prefix="kill_storm-", dir=arguments.folder))
        self.environment = {k: v for k, v in os.environ.items() if not k.startswith("AUGNERF_")}
        self.strace = self.can_trace()
        self.definition = self.folder / "storm.toml"
        self.definition.write_text(SWEEP.format(settings="\n".join(map(quoted, SET))))
        self.rows = []
        self.wrong = 0
        self.lives = 0

    def can_trace(self):
        program = shutil.which("strace")
        command = [program or "", "-f", "-o", "/dev/null", "-e", "inject=mkdir:signal=SIGKILL:when=1", "mkdir", "x"]
        if program and subprocess.run(command, cwd=self.folder, capture_output=True).returncode == -signal.SIGKILL:
            return program
        print("kill_storm: SKIPPED: kills at calls of the file system (no working strace)")
        return None

    # Commands.

    def start(self, command, moment=None):
        """Starts the program; with a moment, strace kills it at that call of a thread."""
        words = [str(self.arguments.program), *map(str, command)]
        if moment is not None:
            inject = f"inject={CALLS}:signal=SIGKILL:when={moment}"
            words = [self.strace, "-f", "-o", "/dev/null", "-e", f"trace={CALLS}", "-e", inject, *words]
        # Its own process group, so that strace is killed with it.
        return subprocess.Popen(words, env=self.environment, cwd=self.folder, start_new_session=True,
                                stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)

    def end(self, process, allowed):
        """Waits for a process, whose exit code must be one of `allowed`."""
        try:
            said = process.communicate(timeout=PATIENCE)[1].decode(errors="replace").strip()
        except subprocess.TimeoutExpired:
            os.killpg(process.pid, signal.SIGKILL)
            self.fail(f"{process.args} hangs")
            return None
        if process.returncode not in allowed:
            self.fail(f"{' '.join(process.args)} ended with {process.returncode}, but only {sorted(allowed)} are allowed: {said}")
        return process.returncode

    def training(self, run):
        """Does what a user would do: starts a run, or resumes an existing one."""
        if (run / "config.toml").exists():
            return ["resume", "--quiet", "--threads", "2", run]
        method = ["--method", "aug-nerf"] if run.parent.name == "aug" else []
        return ["train", "--quiet", "--preset", "smoke", "--threads", "2", "--out", run, *method, *(w for s in SET for w in ("--set", s))]

    def sweep(self, out):
        return ["sweep", "run", self.definition, "--out", out, "--quiet", "--threads", "2"]

    def other_commands(self, base):
        """Returns the commands that write one thing: name -> function of a folder, which gives the command for its state."""
        tar = ROOT / "tests/fixtures/nerf_pytorch.tar"
        settings = ["--set", "data.width=16", "--set", "train.rays=32", "--set", "sampling.coarse=8", "--set", "sampling.fine=8"]
        nothing = ["settings", "train.steps"]

        def made(folder):
            folder.mkdir(exist_ok=True)
            return folder

        def imported(folder):
            run = made(folder) / "run"
            # A name stands for a run that is whole.
            return nothing if run.exists() else ["import", tar, "--out", run, *settings]

        def trained_from(folder):
            run = made(folder) / "run"
            if any(run.glob("checkpoints/step*")):
                return ["resume", "--quiet", run]
            again = ["--overwrite"] if run.exists() else []
            return ["train", "--quiet", "--from", base, "--out", run, "--set", "train.steps=60", *again]

        return {
            "import": imported,
            "from": trained_from,
            "report": lambda folder: ["report", base, "--out", made(folder) / "report.html"],
        }

    # Checks.

    def fail(self, what):
        self.wrong += 1
        print(f"kill_storm: WRONG: {what}", flush=True)

    def same(self, kind, straight, folder):
        """Compares the folder of killed commands with an undisturbed one, and deletes it if they are equal."""
        self.lives += 1
        left, right = content(straight), content(folder)
        if left == right:
            shutil.rmtree(folder)
            return
        differ = sorted(name for name in left.keys() | right.keys() if left.get(name) != right.get(name))
        self.fail(f"{kind}: {folder} differs from {straight}: {', '.join(differ[:8])}")

    def undisturbed(self, name, command):
        """Returns the folder of an undisturbed command, its seconds, and the calls of its busiest thread."""
        folder = self.folder / name
        folder.parent.mkdir(parents=True, exist_ok=True)
        started = time.monotonic()
        self.end(self.start(command(folder)), {0})
        return folder, time.monotonic() - started, self.calls(command, folder.with_name("traced"))

    def calls(self, command, folder):
        if not self.strace:
            return 0
        trace = self.folder / "trace"
        words = [self.strace, "-f", "-o", trace, "-e", f"trace={CALLS}", self.arguments.program, *command(folder)]
        subprocess.run(list(map(str, words)), env=self.environment, cwd=self.folder, capture_output=True)
        shutil.rmtree(folder)
        return max(Counter(line.split()[0] for line in trace.read_text().splitlines()).values())

    def part(self, name, what, work):
        if self.arguments.only and name not in self.arguments.only:
            return
        before, started = (self.wrong, self.lives), time.monotonic()
        done = work()
        wrong, lives = self.wrong - before[0], self.lives - before[1]
        self.rows.append((name, what.format(done), lives, wrong, time.monotonic() - started))
        print(f"kill_storm: {name}: {what.format(done)}, {lives} folders compared, {wrong} wrong", flush=True)

    # Parts.

    def kills(self, kind, command, undisturbed, wanted):
        """Kills a command repeatedly, from its start and after each kill."""
        straight, seconds, calls = undisturbed
        done = life = 0
        while done < wanted:
            folder = straight.parent / f"{kind}-{life}"
            life += 1
            killed = True
            while killed:
                at_call = self.strace and self.random.random() < 0.5
                moment = self.random.randint(1, calls) if at_call else None
                process = self.start(command(folder), moment)
                if not at_call:
                    time.sleep(self.random.random() * seconds)
                    try:
                        os.killpg(process.pid, signal.SIGKILL)
                    except ProcessLookupError:
                        pass
                killed = self.end(process, {0, -signal.SIGKILL}) == -signal.SIGKILL
                done += killed
                if killed and done >= wanted:
                    killed = self.end(self.start(command(folder)), {0}) is None
            self.same(kind, straight, folder)
        return done

    def signals(self, kind, command, undisturbed, each):
        """Sends signals that ask for a stop, and signals that pause the process."""
        straight, seconds, _ = undisturbed
        sent = 0
        for which, code in [*SIGNALS.items(), (signal.SIGSTOP, 0)]:
            for life in range(each):
                folder, ended = straight.parent / f"{kind}-{which.name}-{life}", None
                while ended != 0:
                    process = self.start(command(folder))
                    time.sleep(self.random.random() * seconds)
                    sent += process.poll() is None
                    process.send_signal(which)
                    if which == signal.SIGSTOP:
                        time.sleep(0.2)
                        process.send_signal(signal.SIGCONT)
                    # Before the program handles signals, a signal ends it as any program.
                    ended = self.end(process, {0, code, -which})
                    if ended is None:
                        break
                self.same(f"{kind} {which.name}", straight, folder)
        return sent

    def full_disk(self, kind, command, undisturbed, times):
        """Fills the disk while a command runs: exit code 4, and with free space it continues."""
        straight, seconds, _ = undisturbed
        place = straight.parent / "disk"
        place.mkdir()
        refused = 0
        for life in range(times):
            mounted = subprocess.run(["mount", "-t", "tmpfs", "-o", "size=24m", "kill_storm", place], capture_output=True)
            if mounted.returncode != 0:
                print(f"kill_storm: SKIPPED: a full disk ({mounted.stderr.decode().strip()})")
                return 0
            try:
                folder, ballast = place / "folder", place / "ballast"
                process = self.start(command(folder))
                # A disk in memory is fast.
                time.sleep(self.random.random() * min(seconds, 0.5))
                fill(ballast)
                refused += self.end(process, {0, 4}) == 4
                ballast.unlink()
                self.end(self.start(command(folder)), {0})
                kept = straight.parent / f"{kind}-disk-{life}"
                shutil.copytree(folder, kept, symlinks=True)
                self.same(f"{kind} on a full disk", straight, kept)
            finally:
                subprocess.run(["umount", place], check=True)
        return refused

    def runners(self, undisturbed, wanted):
        """Runs three workers of one sweep; one after the other is killed and started again."""
        straight, seconds, _ = undisturbed
        done = life = 0
        while done < wanted:
            out = straight.parent / f"runners-{life}"
            life += 1
            alive = [self.start(self.sweep(out)) for _ in range(3)]
            while alive:
                time.sleep(self.random.random() * seconds / 2)
                victim = alive.pop(self.random.randrange(len(alive)))
                if done < wanted and victim.poll() is None:
                    os.killpg(victim.pid, signal.SIGKILL)
                if self.end(victim, {0, -signal.SIGKILL}) == -signal.SIGKILL:
                    done += 1
                    alive.append(self.start(self.sweep(out)))
            # A note of one that was killed is left if nobody came after it.
            self.end(self.start(self.sweep(out)), {0})
            self.same("runners", straight, out)
        return done

    def commands(self, base, wanted):
        """Kills commands that write one thing each."""
        commands = self.other_commands(base)
        each = -(-wanted // len(commands))
        return sum(self.kills(name, command, self.undisturbed(f"{name}s/straight", command), each)
                   for name, command in commands.items())

    def containers(self, undisturbed, rounds):
        """Runs four workers of one sweep at once, each with the process numbers of a container of its own."""
        straight, _, _ = undisturbed
        alone = ["unshare", "--pid", "--fork", "--mount-proc"]
        if subprocess.run([*alone, "true"], capture_output=True).returncode != 0:
            print("kill_storm: SKIPPED: containers (unshare needs root)")
            return 0
        for number in range(rounds):
            out = straight.parent / f"containers-{number}"
            words = [*alone, str(self.arguments.program), *map(str, self.sweep(out))]
            workers = [subprocess.Popen(words, env=self.environment, cwd=self.folder, start_new_session=True,
                                        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) for _ in range(4)]
            for worker in workers:
                self.end(worker, {0})
            self.same("containers", straight, out)
        return rounds

    def collects(self, straight, count):
        """Collects one finished sweep many times at once."""
        # The tables get the folder's name.
        self.end(self.start(["sweep", "collect", straight]), {0})
        before = content(straight)
        running = [self.start(["sweep", "collect", straight]) for _ in range(count)]
        for process in running:
            self.end(process, {0})
        self.lives += 1
        if content(straight) != before:
            self.fail(f"{count} collects at once changed {straight}")
        return count

    def run(self):
        a = self.arguments
        plain = self.undisturbed("plain/straight", self.training)
        aug = self.undisturbed("aug/straight", self.training)
        sweep = self.undisturbed("sweeps/straight", self.sweep)
        half = (a.train + 1) // 2
        self.part("train", "{} kills of trainings", lambda: self.kills("nerf", self.training, plain, half)
                  + self.kills("aug-nerf", self.training, aug, a.train - half))
        self.part("sweep", "{} kills of sweeps", lambda: self.kills("sweep", self.sweep, sweep, a.sweep))
        self.part("runners", "{} kills among three runners", lambda: self.runners(sweep, a.runners))
        self.part("signals", "{} signals TERM, INT, HUP, STOP/CONT",
                  lambda: self.signals("nerf", self.training, plain, a.signals)
                  + self.signals("sweep", self.sweep, sweep, a.signals))
        self.part("disk", "{} times stopped by a full disk",
                  lambda: self.full_disk("nerf", self.training, plain, a.disks)
                  + self.full_disk("sweep", self.sweep, sweep, a.disks))
        self.part("commands", "{} kills of import, --from and report",
                  lambda: self.commands(plain[0], a.commands))
        self.part("containers", "{} rounds of four containers", lambda: self.containers(sweep, a.containers))
        self.part("collects", "{} collects at once", lambda: self.collects(sweep[0], a.collects))
        print(f"\n{'part':10} {'what':42} {'folders':>8} {'wrong':>6} {'seconds':>8}")
        for name, what, lives, wrong, took in self.rows:
            print(f"{name:10} {what:42} {lives:8} {wrong:6} {took:8.0f}")
        if self.wrong:
            print(f"kill_storm: {self.wrong} wrong; the files are in {self.folder}")
            return 1
        shutil.rmtree(self.folder)
        return 0


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--program", type=Path, default=ROOT / "target/release/augnerf")
    parser.add_argument("--folder", type=Path, help="folder of the work [default: the system's temporary folder; --short: in memory if possible]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", type=lambda text: text.split(","), help="parts, separated by commas")
    parser.add_argument("--short", action="store_true")
    numbers = {"train": (200, 10), "sweep": (200, 5), "runners": (60, 3), "signals": (5, 0), "disks": (10, 1), "collects": (100, 20),
               "commands": (200, 0), "containers": (60, 0)}
    for name, (default, _) in numbers.items():
        parser.add_argument(f"--{name}", type=int, help=f"[default: {default}]")
    arguments = parser.parse_args()
    for name, (default, short) in numbers.items():
        if getattr(arguments, name) is None:
            setattr(arguments, name, short if arguments.short else default)
    if arguments.short and not arguments.folder and os.access("/dev/shm", os.W_OK):
        arguments.folder = Path("/dev/shm")
    arguments.program = arguments.program.resolve()
    if not arguments.program.exists():
        sys.exit(f"kill_storm: {arguments.program} is missing; run cargo build --release")
    sys.exit(Storm(arguments).run())


if __name__ == "__main__":
    main()
