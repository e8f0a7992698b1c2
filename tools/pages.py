#!/usr/bin/env python3
"""Writes the pages that quote results, each from its template beside it: README.md from README.md.in.

    tools/pages.py            write all pages
    tools/pages.py --check    write nothing; end with 1 if a page is not what its template makes

In a template, {{FOLDER: COLUMN of ROW|+0.00}} is a number of the results folder of this name. After the bar stands what the number
looks like: 0.00 (if nothing is said), +0.00, 0,000, 0.0e0, 0 %, or `words` for "twice" and "a third".

    COLUMN of ROW on SCENE    one line of a table with several scenes
    COLUMN@0+1 of ROW         the mean over seeds 0 and 1 of points.csv and timing.csv
    A / B, A - B, -A          of such numbers

{{use FOLDER}} on a line of its own names the folder from there on. In a row of a table, ROW is what stands in the first cell.
{{WORDS if FOLDER: COLUMN of ROW is TEXT}} writes WORDS; if the condition (is, is not, <, >; several joined by ` and `) does not hold,
the page needs other words, and the program says so.
"""

import csv
import math
import re
import sys
from functools import cache
from pathlib import Path

try:
    import tomllib
except ImportError:
    sys.exit("tools/pages.py needs Python 3.11 or newer")

ROOT = Path(__file__).resolve().parent.parent
WORDS = {
    "a tenth": 0.1, "a fifth": 0.2, "a quarter": 0.25, "a third": 1 / 3, "half": 0.5, "two thirds": 2 / 3,
    "three quarters": 0.75, "one": 1, "twice": 2, "three": 3, "four": 4, "five": 5, "six": 6, "seven": 7, "eight": 8,
}  # fmt: skip
# How far a number may be from a word, as a share of it.
NEAR = 0.15


class Wrong(Exception):
    """What a template asks for is not there."""


def read(path):
    if not path.exists():
        return []
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def label(line):
    name = line.get("row") or line.get("sweep") or ""
    return f"{name}, {line['axes']}" if line.get("axes") else name


@cache
def folder(name):
    """Returns the lines of a results folder's tables, and those of its points."""
    found = [path for path in sorted((ROOT / "results").rglob(name)) if path.is_dir()]
    if len(found) != 1:
        raise Wrong(f"{len(found)} results folders are called '{name}'")
    path = found[0]
    if not (path / "table.csv").exists():
        return [line for table in ["over_scenes.csv", "scenes.csv", "across.csv"] for line in read(path / table)], []
    provenance = tomllib.loads((path / "provenance.toml").read_text()) if (path / "provenance.toml").exists() else {}
    constants = provenance.get("constants", {})
    attacks = {(label(line), line["scene"]): line for line in read(path / "attack.csv")}
    timing = {line["id"]: line for line in read(path / "timing.csv")}

    # What was not trained here has none of the constants.
    def whole(line, is_own, more):
        return {**(constants if is_own else {}), **more, **line}

    rows = [
        whole(line, line.get("source", "run") == "run", attacks.get((label(line), line["scene"]), {}))
        for line in read(path / "table.csv")
    ]
    points = [
        whole(line, line.get("status", "done") == "done", timing.get(line["id"], {})) for line in read(path / "points.csv")
    ]
    return rows, points


def line_of(name, place, seed):
    lines = folder(name)[1 if seed else 0]
    row, scene = place, None
    if " on " in place and not any(label(line) == place for line in lines):
        row, scene = place.rsplit(" on ", 1)
    fits = [line for line in lines if label(line) == row and seed in ("", str(line.get("seed")))]
    fits = [line for line in fits if scene in (None, line.get("scene"))]
    # A line over all scenes is meant where no scene is named.
    over_all = [line for line in fits if not line.get("scene")]
    fits = over_all if scene is None and over_all else fits
    if len(fits) != 1:
        raise Wrong(f"{name} has {len(fits)} lines of '{place}'" + (f" with seed {seed}" if seed else ""))
    return fits[0]


def cell(name, term, row):
    column, _, place = term.strip().partition(" of ")
    column, _, seeds = column.partition("@")
    cells = []
    for seed in seeds.split("+"):
        line = line_of(name, place or row, seed)
        if column not in line:
            raise Wrong(f"{name} has no column '{column}'")
        cells.append(line[column])
    return cells


def value(name, expression, row=None):
    """Returns a number, or None where a table has none."""
    if sum(expression.count(operator) for operator in [" / ", " - "]) > expression.startswith("-") ^ 1:
        raise Wrong(f"'{expression}' has several operators")
    if expression.startswith("-"):
        number = value(name, expression[1:], row)
        return None if number is None else -number
    for operator in [" / ", " - "]:
        if operator in expression:
            left, right = [value(name, part, row) for part in expression.split(operator, 1)]
            return None if None in (left, right) else left / right if operator == " / " else left - right
    cells = cell(name, expression, row)
    return None if "" in cells else sum(map(float, cells)) / len(cells)


def holds(name, condition):
    for operator in [" is not ", " is ", " < ", " > "]:
        if operator in condition:
            left, right = condition.rsplit(operator, 1)
            if operator.startswith(" is"):
                # An empty verdict is one where there was a test.
                if "" in cell(name, left, None) and "" in cell(name, left.replace("verdict", "p"), None):
                    raise Wrong(f"'{left}' is empty")
                return (cell(name, left, None) == [right]) == (operator == " is ")
            number = value(name, left)
            return number < float(right) if operator == " < " else number > float(right)
    raise Wrong(f"'{condition}' is no condition")


def shown(number, picture):
    """Returns a number as its picture has it."""
    if number is None:
        raise Wrong("the cell is empty")
    if picture == "words":
        word = min(WORDS, key=lambda word: abs(math.log(WORDS[word] / number)))
        if abs(number / WORDS[word] - 1) > NEAR:
            raise Wrong(f"{number} is not nearly {word}")
        return word
    sign, body, percent = re.fullmatch(r"(\+?)([0.,e]+)( ?%)?", picture).groups()
    number = number * 100 if percent else number
    mantissa = body.partition("e")[0]
    decimals = len(mantissa.partition(".")[2])
    kind = "e" if "e" in body else "f"
    text = f"{number:{sign}{',' if ',' in body else ''}.{decimals}{kind}}"
    if kind == "e":
        head, _, power = text.partition("e")
        text = f"{head}e{power.replace('+', '') if body.endswith('e00') else int(power)}"
    # What shows as 0 has no sign.
    text = text if re.search("[1-9]", text) else text.lstrip("+-")
    return text + (percent or "")


def written(marker, use, row):
    if match := re.fullmatch(r"(.+?) if ([\w-]+): (.+)", marker):
        words, name, conditions = match.groups()
        for condition in conditions.split(" and "):
            if not holds(name, condition):
                raise Wrong(f"'{words}' is said, and it is not so that {condition}")
        return words
    expression, _, picture = marker.partition("|")
    name, colon, rest = expression.partition(": ")
    number = value(name if colon else use, rest if colon else expression, row)
    return shown(number, picture or "0.00")


def page(template):
    """Returns the page that a template makes."""
    lines, use = [], None
    for number, line in enumerate(template.read_text().splitlines(keepends=True), 1):
        if match := re.fullmatch(r"\{\{use ([\w-]+)\}\}\n", line):
            use = match[1]
            continue
        # A row's name stands in the first cell, with its marks.
        row = re.sub(r"\{\{.*?\}\}", "", line).strip("| \n").split(" | ")[0].rstrip(" †*\\")
        try:
            lines.append(re.sub(r"\{\{(.*?)\}\}", lambda match: written(match[1], use, row), line))
        except Wrong as wrong:
            sys.exit(f"{template.relative_to(ROOT)}, line {number}: {wrong}")
    return "".join(lines)


def main():
    templates = [path for path in [ROOT, ROOT / "results"] for path in (path.glob("*.md.in") if path == ROOT else path.rglob("*.md.in"))]
    stale = []
    for template in sorted(templates):
        target, text = template.with_suffix(""), page(template)
        if not target.exists() or target.read_text() != text:
            stale.append(str(target.relative_to(ROOT)))
            if "--check" not in sys.argv:
                target.write_text(text)
    if stale:
        print("\n".join(f"{page}: {'not what its template makes' if '--check' in sys.argv else 'written'}" for page in stale))
    sys.exit("--check" in sys.argv and bool(stale))


if __name__ == "__main__":
    main()
