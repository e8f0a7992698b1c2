"""Compares the files of two programs byte for byte, except for clocks, processes and the code's revision."""

import csv
import difflib
import io
import json
import re
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import zip_longest
from pathlib import Path

# Additions since earlier revisions; everything next to them must be unchanged. Columns of the protocol, of metrics and of
# logs, fields of JSON files:
LATER = ["lpips_weights"]
LATER += ["attack_geometry", "step_over_radius", "last_shift"]
LATER += [f"shift.{site}" for site in ("t", "xyz", "view", "feature", "rgb", "density")]
LATER += ["training_views", "validation", "views_seen", "views_seed", "encoding", "position_octaves", "view_octaves", "skips"]
LATER += ["rgb_padding", "resample_padding", "jitter", "density_noise", "batching", "precrop_steps", "precrop_fraction"]
LATER += ["warmup_share", "warmup_from", "dead_start_share", "chunk", "eval_chunk", "xyz_radius", "norms", "perturb_last"]
LATER += ["core", "precision", "instructions", "train_views"]
LATER += [f"{kind}_{metric}" for kind in ("train", "gap") for metric in ("ssim", "lpips_alex", "lpips_vgg", "lpips_squeeze")]
LATER += ["train_psnr", "gap", "depth_mae_common", "depth_rmse_common", "depth_left_out_common"]
LATER += ["published_lpips", "published_average"]
LATER += ["dispatches_per_step", "product_bytes_per_step"]
LATER += ["view_depth", "view_width", "adam", "hash_grid", "inactive_by", "table_bytes_per_step"]
# Columns whose meaning changed with a later column: skipped if only one side has the later one.
REDEFINED = {"inactive_levels": "step_over_radius"}
# Settings, with their defaults in TOML files.
LATER_SETTINGS = {"holdout_offset": "0", "validation": "0", "views_seed": "0", "geometry": '"sampling"'}
LATER_SETTINGS |= {"view_depth": "1", "precision": '"f32"', "adam_beta2": "0.999", "adam_epsilon": "0.00000001", "eval_stride": "1"}
LATER_SETTINGS |= {"levels": "16", "features": "2", "log2_table": "17", "coarsest": "16", "interpolation": '"linear"'}
# Their sections, with the empty line before them.
LATER_SECTIONS = [rb"\n\[field\.hash\]"]

# Files with clocks and processes: their words are compared, their numbers are not.
CLOCKS = {"timing.json", "timing.csv", "run.lock"}
NUMBER = re.compile(rb"-?\d+(\.\d+)?(e[+-]?\d+)?|null")
# Clocks in messages (folder `said`), with their replacements.
SAID = [
    (re.compile(rb"(?m)^step \d+/\d+  .* rays/s  ETA .*\n"), b""),
    (re.compile(rb"(\d+ steps, )\d+ s\)"), rb"\1SECONDS)"),
    # Messages on training views, which earlier revisions did not measure.
    (re.compile(rb"(?m)^\d+ training views: .*\n"), b""),
    (re.compile(rb"(held-out PSNR [\d.]+ dB), of training views [\d.]+ dB"), rb"\1"),
    # `sweep run`, `sweep status`
    (re.compile(rb"; about .* left (in all|with \d+ at once)"), b""),
    # `sweep plan`
    (re.compile(rb" +[\d.]+ s/step +\d.* a point  .*"), b" COST"),
    (re.compile(rb"(?m)^\d.* in all, one point after the other, and .* of memory"), b"COST of memory"),
    # `bench`
    (re.compile(rb'("(seconds_per_step|rays_per_second|(gemm_peak_)?gflops|share_of_peak|peak_memory_mib)":)[^,}]+'), rb"\1CLOCK"),
]


@dataclass
class Difference:
    """A differing file: its differing lines from both sides, and a description."""

    file: str
    lines: list
    words: str


class Normaliser:
    """Removes from a file what may differ between two runs of one program."""

    def __init__(self, revisions, workplaces):
        names = b"|".join(re.escape(revision.encode()) for revision in revisions)
        # In a CSV file an h keeps spreadsheets from reading a revision as a number.
        self.revision = re.compile(rb"\bh?(" + names + rb")(-dirty)?\b")
        self.workplace = re.compile(b"|".join(re.escape(str(place).encode()) for place in workplaces))

    def content(self, file):
        """Returns a file's bytes without its clocks, revisions and working folder."""
        content = file.read_bytes()
        content = self.workplace.sub(b"WORKPLACE", self.revision.sub(b"REVISION", content))
        # A run of both programs names both.
        content = re.sub(rb'REVISION(?: \+ |",\s*")REVISION', b"REVISION", content)
        if file.name in CLOCKS:
            content = NUMBER.sub(b"0", content)
        if file.parent.name == "said":
            for pattern, instead in SAID:
                content = pattern.sub(instead, content)
        return content


def files(folder):
    """Returns every file and empty folder below `folder` by relative name."""
    paths = (path for path in folder.rglob("*") if not path.is_symlink() and (path.is_file() or is_empty(path)))
    return {str(path.relative_to(folder)): path for path in paths}


def is_empty(path):
    """Returns whether it is an empty folder."""
    return path.is_dir() and not any(path.iterdir())


def compare(old, new, normaliser):
    """Returns all differences between two folders."""
    ours, theirs = files(old), files(new)
    differences = []
    for name in sorted({*ours, *theirs}):
        if name not in theirs or name not in ours:
            side = "old" if name in ours else "new"
            differences.append(Difference(name, [f"only in the {side} program's output"], f"only in the {side} program's output"))
            continue
        a, b = ours[name], theirs[name]
        if a.is_dir() or b.is_dir():
            if a.is_dir() != b.is_dir():
                differences.append(Difference(name, ["a folder on one side"], "a folder on one side"))
            continue
        a, b = without_later(normaliser.content(a), normaliser.content(b), Path(name).suffix)
        if a != b:
            differences.append(describe(name, a, b))
    return differences


def without_later(a, b, ending):
    """Returns both contents without the additions (LATER, LATER_SETTINGS) that only one side has."""
    if ending == ".json":
        return without_fields(a, b)
    if ending == ".csv":
        columns = [set(side.split(b"\n", 1)[0].decode().strip().split(",")) for side in (a, b)]
        apart = columns[0] ^ columns[1]
        redefined = [column for column, later in REDEFINED.items() if later in apart]
        for column in [name for name in LATER if name in apart] + redefined:
            a, b = without_column(a, column), without_column(b, column)
    if ending in (".toml", ".txt"):
        # Messages contain settings and metrics too, one a line.
        lines = [rb"%s = %s" % (name.encode(), default.encode()) for name, default in LATER_SETTINGS.items()] + LATER_SECTIONS
        lines += [rb' *"%s": .*' % column.encode() for column in LATER if ending == ".txt"]
        for line in (re.compile(rb"(?m)^%s\n" % line) for line in lines):
            if bool(line.search(a)) != bool(line.search(b)):
                a, b = line.sub(b"", a), line.sub(b"", b)
    return a, b


def without_fields(a, b):
    """Returns two JSON files without later fields of objects, and pairs of lists, that only one has."""
    names = {*LATER, *LATER_SETTINGS}
    names = {name for name in names if (f'"{name}"'.encode() in a) != (f'"{name}"'.encode() in b)}
    if not names:
        return a, b

    def without(value):
        if isinstance(value, dict):
            return {name: without(inner) for name, inner in value.items() if name not in names}
        if isinstance(value, list):
            is_pair = lambda inner: isinstance(inner, list) and len(inner) == 2 and isinstance(inner[0], str) and inner[0] in names
            return [without(inner) for inner in value if not is_pair(inner)]
        return value

    # Numbers as written: no digit may differ.
    read = lambda content: json.loads(content, parse_float=lambda text: f"number {text}", parse_int=lambda text: f"number {text}")
    return tuple(json.dumps(without(read(content)), indent=2).encode() for content in (a, b))


def without_column(content, column):
    """Returns a CSV file without a column; a file that lacks it is only formatted again."""
    rows = list(csv.reader(io.StringIO(content.decode())))
    place = rows[0].index(column) if rows and column in rows[0] else None
    kept = [[cell for i, cell in enumerate(row) if i != place] for row in rows]
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows(kept)
    return out.getvalue().encode()


def describe(name, a, b):
    """Describes how two contents differ: the first line if both are text, otherwise the first byte."""
    try:
        texts = [side.decode() for side in (a, b)]
        binary = any("\0" in text for text in texts)
    except UnicodeDecodeError:
        binary = True
    if binary:
        at = next((i for i, (x, y) in enumerate(zip(a, b)) if x != y), min(len(a), len(b)))
        words = f"byte {at} of {len(a)} (old), {len(b)} (new){tensor(a, at) if name.endswith('.safetensors') else ''}"
        return Difference(name, [words], words)
    a, b = (text.split("\n") for text in texts)
    # After the two lines that name the sides.
    changed = [line[1:] for line in list(difflib.unified_diff(a, b, n=0, lineterm=""))[2:] if line[0] in "-+"]
    at, (x, y) = next((i, pair) for i, pair in enumerate(zip_longest(a, b)) if pair[0] != pair[1])
    column = next((i for i, (c, d) in enumerate(zip(x or "", y or "")) if c != d), min(len(x or ""), len(y or "")))
    begin = max(0, column - 60)
    shown = [line[begin : begin + 140] if line is not None else "(the file ends)" for line in (x, y)]
    words = f"line {at + 1}, column {column + 1}\n      old: {shown[0]}\n      new: {shown[1]}"
    return Difference(name, changed, words)


def tensor(content, at):
    """Returns the name of the tensor with byte `at` of a safetensors file."""
    (length,) = struct.unpack_from("<Q", content)
    if at < 8 + length:
        return ", in the header"
    header = json.loads(content[8 : 8 + length])
    inside = (name for name, entry in header.items()
              if name != "__metadata__" and entry["data_offsets"][0] <= at - 8 - length < entry["data_offsets"][1])
    return f", in tensor {next(inside, 'none')}"


@dataclass
class Allowance:
    """An intended difference."""

    case: str
    file: str
    lines: str
    reason: str
    used: bool = False

    def covers(self, case, difference):
        """Returns whether the difference is the intended one."""
        named = fnmatchcase(case, self.case) and fnmatchcase(difference.file, self.file)
        return named and (self.lines == "*" or all(re.search(self.lines, line) for line in difference.lines))


def read_allowances(path):
    """Returns the entries of the list of intended differences."""
    if not path.exists():
        return []
    entries = []
    for number, line in enumerate(path.read_text().splitlines(), 1):
        if not line.strip() or line.startswith("#"):
            continue
        parts = [part.strip() for part in line.split(" | ")]
        if len(parts) != 4 or not all(parts):
            raise SystemExit(f"{path}, line {number}: write it as case | file | lines | reason")
        entries.append(Allowance(*parts))
    return entries
