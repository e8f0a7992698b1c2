"""Builds two revisions, runs both and compares them. See same_bytes.sh for its use."""

import argparse
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from fnmatch import fnmatchcase
from pathlib import Path

from cases import PRELUDE, all_cases
from compare import Normaliser, compare, read_allowances

REPOSITORY = Path(__file__).resolve().parents[2]
# Paths of scenes and weights below their folders.
NEEDS = {
    "fern": ("DATA", "nerf_llff_data/fern"),
    "chair": ("DATA", "nerf_synthetic/chair"),
    "fox": ("DATA", "fox"),
    "lpips": ("WEIGHTS", ""),
}
# Time limit of a case in seconds.
LIMIT = 1200
# Most differing files that are printed for a case.
SHOWN = 8


def git(*arguments):
    """Returns a git command's standard output."""
    return subprocess.run(["git", *arguments], cwd=REPOSITORY, check=True, capture_output=True, text=True).stdout.strip()


def cargo_build(folder, target):
    """Builds the program in a checkout, with the build folder `target`."""
    environment = {**os.environ, "CARGO_TARGET_DIR": str(target)}
    command = ["cargo", "build", "--release", "--locked", "--quiet", "--bin", "augnerf"]
    if subprocess.run(command, cwd=folder, env=environment).returncode != 0:
        raise SystemExit(2)
    return target / "release/augnerf"


def flatten(sweeps, folder):
    """Copies all sweep files below `sweeps` into one folder; their names are unique."""
    folder.mkdir(parents=True, exist_ok=True)
    for file in sweeps.rglob("*.toml"):
        shutil.copy2(file, folder)
    return folder


class Program:
    """A built revision: its program, its sweeps, and the environment of its cases."""

    def __init__(self, binary, sweeps, places):
        self.binary, self.sweeps, self.places = binary, sweeps, places

    def run(self, case, old, out):
        """Runs a case and moves its files to `out`; returns its error text if it fails."""
        # Names of equal length, so that lines wrap alike.
        with tempfile.TemporaryDirectory(prefix="same_bytes_") as workplace:
            environment = {name: value for name, value in os.environ.items() if not name.startswith("AUGNERF_")}
            environment |= {name: str(place) for name, place in self.places.items()}
            environment |= {"AUGNERF": str(self.binary), "SWEEPS": str(self.sweeps), "RUST_BACKTRACE": "0", "LC_ALL": "C.UTF-8"}
            environment |= {"OLD": str(old)} if old else {}
            work = Path(workplace, "work")
            work.mkdir()
            done = subprocess.run(["bash", "-c", PRELUDE + case.script], cwd=work, env=environment, capture_output=True, timeout=LIMIT)
            shutil.rmtree(out, ignore_errors=True)
            out.mkdir(parents=True)
            shutil.move(work, out / "files")
            (out / "workplace").write_text(workplace)
            return done.stderr.decode(errors="replace") if done.returncode != 0 else None


def places():
    """Returns the existing folders with scenes and LPIPS weights."""
    def place(variable, beside):
        named = os.environ.get(variable)
        found = Path(named) if named else REPOSITORY.parent / "shared" / beside
        return found.resolve() if found.is_dir() else None
    found = {"DATA": place("AUGNERF_DATA", "data"), "WEIGHTS": place("AUGNERF_LPIPS_WEIGHTS", "weights/lpips")}
    return {name: folder for name, folder in found.items() if folder}


def lacking(case, found):
    """Returns the missing needs of a case."""
    def missing(need):
        place, below = NEEDS[need]
        return place not in found or not (found[place] / below).exists()
    return [need for need in case.needs if missing(need)]


class Unfit(Exception):
    """The old program does not end a case as expected: the case is wrong, or does not suit this machine."""


class Old:
    """The old revision: built once, each case run once, all results kept."""

    def __init__(self, revision, cache, found):
        self.folder = cache / revision
        self.revision, self.cache, self.found = revision, cache, found
        self.cases = {}

    def build(self):
        """Builds the program in a worktree, unless it is kept already."""
        binary, sweeps = self.folder / "augnerf", self.folder / "sweeps"
        if not binary.exists():
            print(f"building {self.revision} ...", flush=True)
            self.folder.mkdir(parents=True, exist_ok=True)
            with worktree(self.revision, self.cache / "worktree") as checkout:
                target = self.target()
                built = cargo_build(checkout, target)
                flatten(checkout / "sweeps", sweeps)
                shutil.copy2(built, self.folder / "augnerf.part")
                shutil.rmtree(target)
                (self.folder / "augnerf.part").rename(binary)
        self.program = Program(binary, sweeps, self.found)
        return self

    def target(self):
        """Makes a separate build folder with the dependencies that this tree has built. Cargo cannot tell two checkouts of
        one package apart."""
        target, ours = self.cache / "build", REPOSITORY / "target/release"
        shutil.rmtree(target, ignore_errors=True)
        if ours.exists():
            for part in ("deps", "build", ".fingerprint"):
                own = shutil.ignore_patterns("*augnerf*")
                shutil.copytree(ours / part, target / "release" / part, ignore=own, symlinks=True)
        return target

    def key(self, case):
        """Returns a hash of everything that the old program's output of a case depends on."""
        before = self.key(self.cases[case.old]) if case.old not in ("", case.name) else ""
        scenes = [str(self.found[NEEDS[need][0]]) for need in case.needs]
        text = "\n".join([PRELUDE, case.script, *scenes, processor(), before])
        return hashlib.sha256(text.encode()).hexdigest()

    def output(self, case):
        """Returns the folder with the case's output; makes it if the commands have changed."""
        out, key = self.folder / "outputs" / case.name.replace("/", "~"), self.key(case)
        if (out / "key").exists() and (out / "key").read_text() == key:
            return out
        error = self.program.run(case, self.input(case, own=False), out)
        if error is not None:
            raise Unfit(error)
        (out / "key").write_text(key)
        return out

    def input(self, case, own=True):
        """Returns the files that a case starts from. A case that names itself starts empty at first."""
        if not case.old or (case.old == case.name and not own):
            return None
        return self.output(self.cases[case.old]) / "files"


@contextmanager
def worktree(revision, folder):
    """Checks out `revision` in `folder` temporarily."""
    git("worktree", "prune")
    shutil.rmtree(folder, ignore_errors=True)
    git("worktree", "add", "--force", "--detach", str(folder), revision)
    try:
        yield folder
    finally:
        git("worktree", "remove", "--force", str(folder))


def processor():
    """Returns the CPU's name, since other CPUs may round differently."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        lines = []
    return next((line for line in lines if line.startswith("model name")), platform.processor())


def arguments():
    parser = argparse.ArgumentParser(prog="tools/same_bytes.sh", description="Compares this tree's outputs with an earlier revision's.")
    parser.add_argument("revision", metavar="REV")
    parser.add_argument("--only", nargs="+", metavar="PATTERN", default=["*"], help="cases of these names (globs)")
    parser.add_argument("--keep", type=Path, metavar="DIR", help="keep both sides' files here")
    parser.add_argument("--list", action="store_true", help="print the cases and stop")
    return parser.parse_args()


def main():
    started, given, found = time.monotonic(), arguments(), places()
    try:
        revision = git("rev-parse", "--short=12", given.revision + "^{commit}")[:12]
    except subprocess.CalledProcessError:
        print(f"{given.revision} is not a revision of this repository")
        return 2
    cache = Path(os.environ.get("AUGNERF_SAME_BYTES_CACHE") or REPOSITORY / "target/same_bytes").resolve()
    old = Old(revision, cache, found)
    sweeps = git("ls-tree", "-r", "--name-only", f"{revision}:sweeps").split()
    cases = all_cases(sorted(Path(name).stem for name in sweeps if name.endswith(".toml")))
    old.cases = {case.name: case for case in cases}
    chosen = [case for case in cases if any(fnmatchcase(case.name, pattern) for pattern in given.only)]
    if given.list:
        print("\n".join(case.name + (f"  (needs {', '.join(case.needs)})" if case.needs else "") for case in chosen))
        return 0
    if not chosen:
        print(f"no case matches {' '.join(given.only)}; --list prints all names")
        return 2
    old.build()
    print("building this tree ...", flush=True)
    built = cargo_build(REPOSITORY, REPOSITORY / "target")
    with tempfile.TemporaryDirectory(prefix="same_bytes_") as folder:
        # Another build must not replace the program meanwhile.
        sweeps = flatten(REPOSITORY / "sweeps", Path(folder, "sweeps"))
        new = Program(shutil.copy2(built, Path(folder, "augnerf")), sweeps, found)
        results = Results(read_allowances(REPOSITORY / "tools/same_bytes.allow"))
        revisions = (revision, git("rev-parse", "--short=12", "HEAD")[:12])
        for case in chosen:
            check(case, old, new, Path(folder, "new"), (given.keep, revisions), results)
    return results.summary(revision, time.monotonic() - started, complete=given.only == ["*"])


def check(case, old, new, out, keep_and_revisions, results):
    """Runs one case with both programs and notes how they compare."""
    keep, revisions = keep_and_revisions
    missing = lacking(case, old.found)
    if missing:
        return results.skip(case, missing)
    before = time.monotonic()
    try:
        ours = old.output(case)
    except Unfit as error:
        return results.unfit(case, old.revision, str(error))
    between = time.monotonic()
    error = new.run(case, old.input(case), out)
    seconds = (between - before, time.monotonic() - between)
    if keep:
        for side, source in (("old", ours), ("new", out)):
            shutil.copytree(source / "files", keep / side / case.name, dirs_exist_ok=True)
    normaliser = Normaliser(revisions, [(side / "workplace").read_text() for side in (ours, out)])
    return results.add(case, compare(ours / "files", out / "files", normaliser), error, seconds)


class Results:
    """Prints the results of cases and counts them."""

    def __init__(self, allowances):
        self.allowances = allowances
        self.same, self.intended = 0, 0
        self.different, self.skipped, self.broken = [], [], []

    def skip(self, case, missing):
        self.skipped.append(case.name)
        print(f"SKIPPED   {case.name}: no {', '.join(missing)} here", flush=True)

    def unfit(self, case, revision, error):
        self.broken.append(case.name)
        print(f"UNFIT     {case.name}: {revision} does not end it as expected:\n{indented(error)}", flush=True)

    def add(self, case, differences, error, seconds):
        unintended = []
        for difference in differences:
            allowance = next((entry for entry in self.allowances if entry.covers(case.name, difference)), None)
            if allowance is None:
                unintended.append(difference)
                continue
            allowance.used = True
            self.intended += 1
            print(f"  intended  {case.name}: {difference.file}: {allowance.reason}")
        word = "same" if not unintended and error is None else "DIFFERENT"
        print(f"{word:9} {case.name}  ({seconds[0]:.1f} s, {seconds[1]:.1f} s)", flush=True)
        if word == "same":
            self.same += 1
            return
        self.different.append(case.name)
        if error is not None:
            print(f"  a command of this tree did not end as expected:\n{indented(error)}")
        for difference in unintended[:SHOWN]:
            print(f"    {difference.file}: {difference.words}")
        if len(unintended) > SHOWN:
            print(f"    ... and {len(unintended) - SHOWN} more files")
        sys.stdout.flush()

    def summary(self, revision, seconds, complete):
        """Prints a summary and returns the exit code."""
        for entry in self.allowances:
            if complete and not self.skipped and not entry.used:
                print(f"  no longer needed in same_bytes.allow: {entry.case} | {entry.file} | {entry.reason}")
        print(f"\n{self.same} cases give the bytes of {revision}, {len(self.different)} do not, {len(self.skipped)} SKIPPED without "
              f"data; {self.intended} files differ as intended; {seconds:.0f} s")
        if self.different:
            print("different: " + " ".join(self.different))
        if self.skipped:
            print("SKIPPED (set AUGNERF_DATA, AUGNERF_LPIPS_WEIGHTS): " + " ".join(self.skipped))
        if self.broken:
            print("UNFIT: " + " ".join(self.broken))
        return 2 if self.broken else 1 if self.different else 0


def indented(text):
    return "    " + text.strip().replace("\n", "\n    ")


if __name__ == "__main__":
    sys.exit(main())
