#!/usr/bin/env python3
"""Gives each row of the comparison over scenes its words, by the rule of results/few_views/PLAN.md ("Analysis").

    tools/scenes_across.sh && tools/scenes_words.py

Prints a Markdown table and the ratios of draws to attack. Reads results/few_views/scenes and results/few_views/over_*; SCENES and OVER
name other results and another prefix for a trial.
"""
import csv
import os
import tomllib
from collections import defaultdict
from pathlib import Path

SCENES = Path(os.environ.get("SCENES", "results/few_views/scenes"))
OVER = os.environ.get("OVER", "results/few_views/over")
ATTACK, DRAWS, EARLY = "Aug-NeRF calibrated", "Draws, as far", "NeRF, fewer steps"
MARGIN = 0.3


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def comparison(name):
    """The lines of one comparison by row; none if it was not made."""
    path = Path(f"{OVER}_{name}/over_scenes.csv")
    return {line["row"]: line for line in read(path)} if path.exists() else {}


def seconds():
    """Mean training seconds of each row."""
    row_of = {point["id"]: point["row"] for point in read(SCENES / "points.csv")}
    found = defaultdict(list)
    for point in read(SCENES / "timing.csv"):
        if point["id"] in row_of and point["seconds_training"]:
            found[row_of[point["id"]]].append(float(point["seconds_training"]))
    return {row: sum(values) / len(values) for row, values in found.items()}


def failed():
    """Scenes of each row that have no number."""
    scenes = defaultdict(set)
    for point in read(SCENES / "points.csv"):
        if point["status"] != "done":
            scenes[point["row"]].add(point["scene"])
    return scenes


def words(lines):
    """What the tests of one comparison say of each row."""
    said = {}
    for row, line in lines.items():
        helps, harms = line["verdict"] == "higher", line["verdict"] == "lower"
        matters, ruled_out = line["matters"] == "true", line["ruled_out"] == "true"
        said[row] = [word for word, holds in [
            ("helps", helps), ("harms", harms), ("matters", matters), (f"a gain of {MARGIN} dB is ruled out", ruled_out),
            ("inconclusive", not helps and not harms and not ruled_out),
        ] if holds]
    return said


def recommended(said, lines, cost):
    """Rows that help and matter, and have no row at 0.9 of their seconds or less that helps as much, less the margin."""
    mean = {row: float(line["difference"]) for row, line in lines.items()}
    helping = [row for row in said if "helps" in said[row]]
    cheaper = lambda row: [
        other for other in helping if other != row and cost[other] <= 0.9 * cost[row] and mean[other] > mean[row] - MARGIN
    ]
    return [row for row in helping if "matters" in said[row] and not cheaper(row)]


def draws_ratios():
    """How far the draws move colours on the counted scenes, over how far the attack does, of each fitted site."""
    rows = tomllib.loads((SCENES / "sweep.toml").read_text())["row"]
    settings = next((row["set"] for row in rows if row["name"] == DRAWS), {})
    lines = read(SCENES / "attack.csv")

    def shift(row, site):
        found = [float(line[f"shift.{site}"]) for line in lines if line["row"] == row and line[f"shift.{site}"]]
        return sum(found) / len(found)

    sites = [key.split(".")[1] for key in settings if key.endswith(".epsilon")]
    return {site: shift(DRAWS, site) / shift(ATTACK, site) for site in sites}


def worst_case_helps(said, ratios):
    """The calibrated attack helps, what isolates it is below it, and the draws fit."""
    isolating = comparison("worst_case")
    below = len(isolating) == 2 and all(line["verdict"] == "lower" for line in isolating.values())
    return "helps" in said.get(ATTACK, []) and below and all(0.8 <= ratio <= 1.25 for ratio in ratios.values())


def dependence():
    """The words of each row that change if authors count once, or if those of tuning do not count."""
    notes, words_of_tests = defaultdict(list), words(comparison("scenes"))
    for name, meaning in [("authors", "one scene of each author"), ("new_authors", "without authors of tuning")]:
        for row, found in words(comparison(name)).items():
            if found != words_of_tests[row]:
                notes[row].append(f"{meaning}: {', '.join(found) or 'no word'}")
    return notes


def main():
    lines, lost = comparison("scenes"), failed()
    said, cost, ratios = words(lines), seconds(), draws_ratios()
    for row in recommended(said, lines, cost):
        said[row].append("recommended")
    if worst_case_helps(said, ratios):
        said[ATTACK].append("the worst case helps")
    early, notes = comparison("early"), dependence()
    print("| row | PSNR minus NeRF (dB), 95 % interval over scenes, Holm p | simultaneous interval | scenes up | seconds / NeRF's | words |")
    print("|---|---:|---:|---:|---:|---|")
    for row, line in sorted(lines.items(), key=lambda item: -float(item[1]["difference"])):
        number = lambda name: f"{float(line[name]):+.2f}"
        said_of = list(said[row])
        if row in early:
            said_of.append("above fewer steps" if early[row]["verdict"] == "higher" else "not shown above fewer steps")
        if (float(line["p"]) < 0.05) != (float(line["p_sign"]) < 0.05):
            said_of.append(f"t test and sign test disagree ({float(line['p']):.3f}, {float(line['p_sign']):.3f})")
        said_of += notes[row]
        if lost[row]:
            said_of = [f"failed: {', '.join(sorted(lost[row]))}"]
        print(
            f"| {row} | {number('difference')} [{number('low')}, {number('high')}], {float(line['p_holm']):.3f} "
            f"| [{number('simultaneous_low')}, {number('simultaneous_high')}] | {line['above']} of {line['scenes']} "
            f"| {cost[row] / cost['NeRF']:.1f} | {'; '.join(said_of)} |"
        )
    print(f"\nNeRF: {cost['NeRF']:.0f} s a training. Shift of draws over that of the attack:")
    print(", ".join(f"{site} {ratio:.2f}" for site, ratio in ratios.items()))


if __name__ == "__main__":
    main()
