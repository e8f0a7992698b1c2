#!/usr/bin/env python3
"""Makes the tables of the comparison over scenes, and gives each row its words, by results/few_views/PLAN.md ("Analysis").

    results/few_views/scenes_answer.py > words.md

Needs all points in results/few_views/scenes. Writes results/few_views/over_* with `augnerf sweep across`, and prints Markdown. The repository
keeps some of these tables.
AUGNERF names the program. SCENES and OVER name other results and another prefix. TRIAL=1 allows fewer scenes or rows than the
plan has.
"""
import csv
import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections import defaultdict
from pathlib import Path

AUGNERF = os.environ.get("AUGNERF", "target/release/augnerf")
TRIAL = "TRIAL" in os.environ
SCENES = Path(os.environ.get("SCENES", "results/few_views/scenes"))
OVER = os.environ.get("OVER", "results/few_views/over")
NERF, EARLY, ATTACK = "NeRF", "NeRF, fewer steps", "Aug-NeRF calibrated"
DRAWS, SMOOTHING = "Draws, as far", "Smoothing of positions"
# The plan's rows, and those of them that tuning dropped.
ROWS = [
    NERF, EARLY, "NeRF, twice the steps", "+ TV", "+ l1", "+ distortion", "Aug-NeRF, paper's geometry", ATTACK, DRAWS, SMOOTHING,
    "Second clean pass", "+ hash decay", "Frequencies that open", "+ occlusion", "+ entropy of unseen rays", "+ depth smoothness",
    "Annealed samples", "SAM", "SAM, random",
]
DROPPED = ["+ l1", "Frequencies that open", "SAM", "SAM, random"]
MARGIN = 0.3
AUTHORS = {
    "capture_fruit", "colmap_canclip", "dtu_scan24", "llff_ethiopianhead", "llff_flower", "llff_milk", "llff_orbit77", "blender_bike",
    "builtin-1",
}
# How messages say that numbers were not finite, in a training's loss or logs, or in a rendered view.
NOT_FINITE = r"diverged at step|colour of pixel .* is not a number|values that are not finite|' is (NaN|-?inf) at step"
is_other = lambda scene: scene.startswith(("blender_", "builtin"))
by_author_of_tuning = lambda scene: scene in {"llff_flower", "llff_fortress", "llff_horns", "llff_trex", "blender_mic"} or scene.startswith("builtin")


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def stop(sentence):
    sys.exit(f"{SCENES}: {sentence}")


def run(command):
    try:
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
    except FileNotFoundError:
        sys.exit(f"{AUGNERF} is not there: build the program (cargo build --release), or set AUGNERF to its path")
    except subprocess.CalledProcessError as failed:
        sys.exit(f"{' '.join(map(str, command))} ended with exit code {failed.returncode}; tables that it had not reached are as they were")


class Points:
    """What the sweep trained: rows and scenes that count, and those that failed."""

    def __init__(self):
        lines = read(SCENES / "points.csv")
        self.seconds, self.lost_rows, lost_scenes = defaultdict(list), defaultdict(set), set()
        for line in lines:
            if line["status"] == "done":
                continue
            # Other failures say nothing of a row: such a point is trained again.
            if line["status"] != "failed" or not re.search(NOT_FINITE, line.get("reason", "")):
                stop(f"point {line['id']} is {line['status']} ({line.get('reason', '')}); tables are made once all points have ended")
            lost_scenes |= {line["scene"]} if line["row"] == NERF else set()
            self.lost_rows[line["row"]].add(line["scene"])
        rows, scenes = dict.fromkeys(line["row"] for line in lines), sorted({line["scene"] for line in lines})
        if not TRIAL and (len(scenes) != 24 or len(lines) != 48 * len(rows)):
            stop(f"{len(lines)} points of {len(scenes)} scenes; the plan has 48 for each row, of 24 scenes")
        self.lost_scenes = sorted(lost_scenes)
        self.lost_rows.pop(NERF, None)
        self.rows = [row for row in rows if row not in self.lost_rows]
        self.scenes = [scene for scene in scenes if scene not in lost_scenes]
        self.dropped = [row for row in ROWS if row not in rows]
        if not TRIAL and self.dropped != DROPPED:
            stop(f"there are no points of {', '.join(self.dropped)}; the plan's tuning dropped {', '.join(DROPPED)}")
        row_of = {line["id"]: line["row"] for line in lines if line["scene"] in self.scenes}
        for line in read(SCENES / "timing.csv"):
            if line["id"] in row_of:
                if line["threads"] != "1":
                    stop(f"point {line['id']} took {line['threads']} threads; seconds are compared between points of one")
                self.seconds[row_of[line["id"]]].append(float(line["seconds_training"]))
        for row in self.rows:
            if len(self.seconds[row]) != 2 * len(self.scenes):
                stop(f"timing.csv has {len(self.seconds[row])} points of {row}, for two seeds of {len(self.scenes)} scenes")
        self.cost = {row: sum(self.seconds[row]) / len(self.seconds[row]) for row in self.rows}


class Subset:
    """Some scenes, with the comparisons that give words."""

    def __init__(self, points, name, is_in):
        self.points, self.name = points, name
        self.scenes = [scene for scene in points.scenes if is_in(scene)]

    def compare(self, kind, baseline=NERF, rows=None, metric="psnr"):
        """Lines of `sweep across` by row."""
        out = Path("_".join(part for part in [OVER, kind, self.name] if part))
        wanted = [row for row in (self.points.rows if rows is None else rows) if row != baseline and row in self.points.rows]
        if not self.scenes or not wanted or baseline not in self.points.rows:
            shutil.rmtree(out, ignore_errors=True)
            return {}
        # The old folder stays until the new one is whole.
        new = out.with_name(f"{out.name}_new")
        shutil.rmtree(new, ignore_errors=True)
        command = [AUGNERF, "sweep", "across", SCENES, "--unit", "scene", "--metric", metric, "--baseline", baseline, "--out", new]
        command += ["--rows", ",".join(wanted)] if rows is not None or self.points.lost_rows else []
        command += ["--scenes", ",".join(self.scenes)] if self.name or self.points.lost_scenes else []
        run(command)
        # One figure is kept: that of the page.
        for figure in [*new.glob("*.svg"), *new.glob("*.png")]:
            if f"{OVER}_psnr" != str(out) or "column" in figure.name:
                figure.unlink()
        lines = {line["row"]: line for line in read(new / "over_scenes.csv")}
        for row in wanted:
            if int(lines[row]["scenes"]) != len(self.scenes) or lines[row]["lacking"] != "0":
                stop(f"{out}: {row} has {lines[row]['scenes']} of {len(self.scenes)} scenes, and {lines[row]['lacking']} lack a seed")
        shutil.rmtree(out, ignore_errors=True)
        new.rename(out)
        return lines

    def words(self, helping=None):
        """Words of each row, and the lines that they are from. `helping` names the rows to compare with stopping early."""
        lines, cost = self.compare("psnr"), self.points.cost
        said = {row: of_tests(line) for row, line in lines.items()}
        helps = [row for row in said if "helps" in said[row]]
        for row in helps:
            cheaper = [
                other for other in helps
                if other != row and cost[other] <= 0.9 * cost[row]
                and float(lines[other]["difference"]) > float(lines[row]["difference"]) - MARGIN
            ]
            if "matters" in said[row] and not cheaper:
                said[row].append("recommended")
        self.isolating = self.compare("worst_case", ATTACK, [DRAWS, SMOOTHING])
        below = len(self.isolating) == 2 and all(line["verdict"] == "lower" for line in self.isolating.values())
        ratios = draws_ratios(self.points)
        fits = ratios and all(0.8 <= ratio <= 1.25 for ratio in ratios.values())
        if ATTACK in helps and below and fits:
            said[ATTACK].append("the worst case helps")
        # In a part of the scenes the family is that of all scenes, so that the same rows are compared.
        self.early = self.compare("early", EARLY, helps if helping is None else helping)
        for row, line in self.early.items():
            said[row].append("above fewer steps" if line["verdict"] == "higher" else "not shown above fewer steps")
        return said, lines


def of_tests(line):
    helps, harms = line["verdict"] == "higher", line["verdict"] == "lower"
    ruled_out = line["ruled_out"] == "true"
    found = {
        "helps": helps, "harms": harms, "matters": line["matters"] == "true", f"a gain of {MARGIN} dB is ruled out": ruled_out,
        "inconclusive": not helps and not harms and not ruled_out,
    }
    return [word for word, holds in found.items() if holds]


def draws_ratios(points):
    """How far the draws move colours on the counted scenes, over how far the attack does, of each site with a fitted radius."""
    rows = tomllib.loads((SCENES / "sweep.toml").read_text())["row"]
    settings = next((row["set"] for row in rows if row["name"] == DRAWS), {})
    lines = [line for line in read(SCENES / "attack.csv") if line["scene"] in points.scenes]

    def shift(row, site):
        found = [float(line[f"shift.{site}"]) for line in lines if line["row"] == row and line[f"shift.{site}"]]
        if not TRIAL and row in points.rows and len(found) != len(points.scenes):
            stop(f"attack.csv has {len(found)} shifts of {row}, {site}, for {len(points.scenes)} scenes")
        return sum(found) / len(found)

    if not {ATTACK, DRAWS} <= set(points.rows):
        return {}
    sites = [key.split(".")[1] for key in settings if key.endswith(".epsilon")]
    return {site: shift(DRAWS, site) / shift(ATTACK, site) for site in sites}


def changed(words, others):
    """What `others`, the words on a part of the scenes, lack of `words`, and what they have more."""
    lost, gained = [word for word in words if word not in others], [word for word in others if word not in words]
    return "; ".join(f"{verb} {', '.join(map(repr, found))}" for verb, found in [("lacks", lost), ("has", gained)] if found)


def shown(p):
    if not p:
        return ""
    p = float(p)
    return f"{p:.1e}" if p < 0.0005 else f"{p:.5f}" if abs(p - 0.05) < 0.0005 else f"{p:.3f}"


def interval(line, low, high):
    return f"[{float(line[low]):+.2f}, {float(line[high]):+.2f}]"


class Answer:
    """The words of each row over all scenes, and what changes on parts of them."""

    PARTS = [
        ("authors", "one scene of each author", AUTHORS.__contains__),
        ("new_authors", "without authors of tuning", lambda scene: not by_author_of_tuning(scene)),
        ("same_unit", "without capture_fruit", lambda scene: scene != "capture_fruit"),
    ]

    def __init__(self, points):
        self.points, self.whole = points, Subset(points, "", lambda scene: True)
        self.said, self.lines = self.whole.words()
        self.helping = [row for row in self.said if "helps" in self.said[row] and row != EARLY]
        self.order = sorted(self.lines, key=lambda row: -float(self.lines[row]["difference"]))
        self.notes, tables = defaultdict(list), {}
        for name, meaning, is_in in self.PARTS:
            found, tables[name] = Subset(points, name, is_in).words(self.helping)
            for row in self.said:
                if change := changed(self.said[row], found.get(row, [])):
                    self.notes[row].append(f"{meaning}: {change}")
        self.beside = {
            "captures": Subset(points, "captures", lambda scene: not is_other(scene)).compare("psnr"),
            "others": Subset(points, "others", is_other).compare("psnr"),
            "without fruit": tables["same_unit"],
            "SSIM": self.whole.compare("ssim", metric="ssim"),
            "LPIPS, lower is better": self.whole.compare("lpips", metric="lpips_squeeze"),
        }

    def words(self, row):
        words, line = list(self.said[row]), self.lines[row]
        if line["p_sign"] and (float(line["p"]) < 0.05) != (float(line["p_sign"]) < 0.05):
            words.append(f"t test and sign test disagree (uncorrected p {shown(line['p'])} and {shown(line['p_sign'])})")
        if EARLY in self.points.lost_rows and row in self.helping:
            words.append("not compared with fewer steps, which failed")
        return "; ".join(words) or "none"

    def print_rows(self):
        cost = self.points.cost
        print(f"{len(self.points.scenes)} scenes. NeRF takes {cost[NERF]:.0f} s a training.\n")
        print("| row | PSNR minus NeRF (dB), 95 % interval, Holm p | simultaneous interval | scenes up | seconds, / NeRF's | words | on other scenes |")
        print("|---|---:|---:|---:|---:|---|---|")
        for row in self.order:
            line = self.lines[row]
            print(
                f"| {row} | {float(line['difference']):+.2f} {interval(line, 'low', 'high')}, {shown(line['p_holm'])} "
                f"| {interval(line, 'simultaneous_low', 'simultaneous_high')} | {line['above']} of {line['scenes']} "
                f"| {cost[row]:.0f}, {cost[row] / cost[NERF]:.2f} | {self.words(row)} | {'; '.join(self.notes[row]) or 'no'} |"
            )
        for row, scenes in self.points.lost_rows.items():
            print(f"| {row} | | | | | failed: {', '.join(sorted(scenes))} | |")
        for row in self.points.dropped:
            print(f"| {row} | | | | | not tested | |")

    def print_beside(self):
        print(f"\nDifferences and Holm's p:\n\n| row | {' | '.join(self.beside)} |\n|---|{'---:|' * len(self.beside)}")
        for row in self.order:
            of = lambda table: f"{float(table[row]['difference']):+.3f}, {shown(table[row]['p_holm'])}" if row in table else ""
            print(f"| {row} | {' | '.join(map(of, self.beside.values()))} |")

    def print_rest(self):
        print()
        for baseline, comparison in [(ATTACK, self.whole.isolating), (EARLY, self.whole.early)]:
            for row, line in comparison.items():
                print(f"- {row} minus {baseline}: {float(line['difference']):+.2f} {interval(line, 'low', 'high')}, {shown(line['p_holm'])}")
        print()
        if not any("recommended" in words for words in self.said.values()):
            print("No row is recommended.")
        if self.points.lost_scenes:
            print(f"NeRF failed on {', '.join(self.points.lost_scenes)}, so that all rows lack them.")
        ratios = ", ".join(f"{site} {ratio:.2f}" for site, ratio in draws_ratios(self.points).items())
        print(f"Shift of draws over that of the attack: {ratios or 'none'}.")


def main():
    answer = Answer(Points())
    answer.print_rows()
    answer.print_beside()
    answer.print_rest()


if __name__ == "__main__":
    main()
