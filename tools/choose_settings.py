#!/usr/bin/env python3
"""Chooses each row's setting by its mean over scenes, from the points of a sweep whose rows have an axis.

    tools/choose_settings.py results/few_views/scenes_tuning/points.csv results/few_views/scenes_tuning_nerf/points.csv

Prints a Markdown table: each setting's mean difference to NeRF over the scenes, by the first number of its value, the best in bold (the
first of equal ones). A scene's NeRF is the mean of all its seeds in the files. A setting that lacks a scene has no mean. Ends with 1 if the best
setting of a row other than *NeRF, fewer steps* stands at an end of its grid.
"""
import csv
import re
import sys
from collections import defaultdict


def first_number(axes):
    found = re.search(r"[\d.]+(e-?\d+)?", axes)
    return float(found.group()) if found else 0.0


def main(paths, metric="psnr", baseline="NeRF"):
    points = [point for path in paths for point in csv.DictReader(open(path, newline=""))]
    scenes = {point["scene"] for point in points}
    values, order = defaultdict(dict), []
    for point in points:
        setting = point["row"], point.get("axes", "")
        if setting not in order:
            order.append(setting)
        if point["status"] == "done":
            values[setting].setdefault(point["scene"], []).append(float(point[metric]))
    mean = lambda numbers: sum(numbers) / len(numbers)
    base = {scene: mean(found) for scene, found in values[(baseline, "")].items()}
    ends, below = [], []
    print(f"{baseline} has these numbers of seeds: {', '.join(f'{scene} {len(found)}' for scene, found in values[(baseline, '')].items())}.\n")
    print(f"| row | {metric} minus {baseline}, mean of {len(scenes)} scenes |\n|---|---|")
    for row in dict.fromkeys(row for row, _ in order):
        if row == baseline:
            continue
        grid = sorted((axes for name, axes in order if name == row), key=first_number)
        complete = lambda axes: set(values[(row, axes)]) == scenes == set(base)
        gain = {axes: mean([mean(values[(row, axes)][s]) - base[s] for s in scenes]) for axes in grid if complete(axes)}
        best = max(gain, key=gain.get, default=None)
        if best in (grid[0], grid[-1]) and len(grid) > 1 and row != "NeRF, fewer steps":
            ends.append(row)
        if best is None or gain[best] <= 0:
            below.append(row)
        cell = lambda axes: f"{axes or 'as it is'}: {gain[axes]:+.2f}" if axes in gain else f"{axes}: lacks scenes"
        print(f"| {row} | " + "; ".join(f"**{cell(axes)}**" if axes == best else cell(axes) for axes in grid) + " |")
    if ends:
        print(f"\nThe best setting is at an end of its grid: {', '.join(ends)}.")
    if below:
        print(f"\nThe best setting is not above {baseline}: {', '.join(below)}.")
    return int(bool(ends))


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    sys.exit(main(sys.argv[1:]))
