#!/usr/bin/env python3
"""Makes the comparisons of X1, and gives both experiments their words, by results/paper/PLAN.md ("What counts").

    results/paper/controls_answer.py > words.md

Needs all points of results/paper/controls_fern_few and controls_fern_noise, and their logs in runs/. Writes
results/paper/controls_across/ROW_BASELINE with `augnerf sweep across`, and results/paper/controls_curves.csv: held-out PSNR (every third
pixel, both ways) after some epochs, and the share of a step's table entries that its second pass alone changes. AUGNERF names the program.
"""
import csv
import os
import subprocess
import sys
from math import sqrt
from pathlib import Path

AUGNERF = os.environ.get("AUGNERF", "target/release/augnerf")
RESULTS = Path(os.environ.get("RESULTS", "results/paper"))
SEEDS = 8
# Held-out views over training views, which say by how much intervals are too short because seeds share views (Nadeau and Bengio 2003).
RATIOS = {"controls_fern_few": 2.5 / 8, "controls_fern_noise": 2.5 / 17}
NERF, ATTACK, FAR = "NeRF", "Aug-NeRF", "Uniform draws, as far"
CONTROLS = ["Uniform draws, paper's geometry", "Uniform draws, between", FAR, "Second clean pass"]
BESIDE = ["Aug-NeRF, inputs alone", "Other rays' worst case", "NeRF, equal evaluations", "+ TV"]
# Training pixels of a view, and those of all views in each experiment.
PIXELS = 126 * 95
TRAINING = {"controls_fern_few": 8 * PIXELS, "controls_fern_noise": 17 * PIXELS}
RAYS = 128
EPOCHS = [0.3, 1, 3, 10]
# What the fit is about: how far a site alone moves colours.
SITES = ["t", "xyz", "feature"]


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def compare(row, baseline):
    """Returns the comparison's line of each experiment."""
    out = RESULTS / "controls_across" / "".join(c if c.isalnum() else "_" for c in f"{row} {baseline}".lower())
    command = [AUGNERF, "sweep", "across", *(RESULTS / name for name in RATIOS), "--row", row, "--baseline", baseline, "--out", out]
    if subprocess.run(command, stdout=subprocess.DEVNULL).returncode:
        sys.exit(f"{out}: `augnerf sweep across` failed")
    lines = {line["sweep"]: line for line in read(out / "across.csv")}
    for name in RATIOS:
        if name not in lines or int(lines[name]["pairs"]) != SEEDS:
            sys.exit(f"{out}: {name} needs {SEEDS} pairs; give no words before all points are done")
    return lines


def number(line, column):
    return float(line[column])


def widened(line, ratio):
    """Returns the interval with Nadeau and Bengio's variance."""
    middle, factor = number(line, "difference"), sqrt(1 + SEEDS * ratio)
    return [middle + factor * (number(line, end) - middle) for end in ("low", "high")]


def fit(name):
    """Returns how far F moves colours in units of P, for each site that is fitted."""
    shift = {line["row"]: line for line in read(RESULTS / name / "attack.csv") if line["source"] == "run"}
    return {site: number(shift[FAR], f"shift.{site}") / number(shift[ATTACK], f"shift.{site}") for site in SITES}


def curves():
    """Writes each training's held-out PSNR at the evaluations nearest to some epochs."""
    lines = []
    for name, pixels in TRAINING.items():
        for point in read(RESULTS / name / "points.csv"):
            logged = read(Path("runs") / name / "points" / point["id"].removeprefix("h") / "run" / "scalars.csv")
            evaluated = [line for line in logged if line["test_psnr"]]
            last = int(evaluated[-1]["step"]) * RAYS / pixels
            for epochs in [epochs for epochs in EPOCHS if epochs <= last]:
                line = min(evaluated, key=lambda line: abs(int(line["step"]) * RAYS / pixels - epochs))
                share = line.get("only_second.entries", "")
                lines.append([name, point["row"], point["seed"], epochs, line["step"], line["test_psnr"], share])
    with open(RESULTS / "controls_curves.csv", "w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["sweep", "row", "seed", "epochs", "step", "test_psnr", "only_second"])
        writer.writerows(lines)


def main():
    curves()
    gain, of_far = compare(ATTACK, NERF), compare(FAR, NERF)
    over = {row: compare(ATTACK, row) for row in CONTROLS + BESIDE}
    for name, ratio in RATIOS.items():
        said, only_if = [], "only if seeds are independent"
        holds = lambda line: line[name]["verdict"] == "higher"
        stays = lambda lines: all(widened(line[name], ratio)[0] > 0 for line in lines)
        sizes = fit(name)
        is_fitted = all(0.8 <= size <= 1.25 for size in sizes.values())
        if holds(gain):
            said.append("the attack gains" if stays([gain]) else f"the attack gains, {only_if}")
            controls = [over[row] for row in CONTROLS]
            if not is_fitted:
                said.append("no word on the search: draws do not move colours as far")
            elif not all(map(holds, controls)):
                said.append("it is not shown to be the search")
            else:
                said.append("it is the search" if stays(controls) else f"it is the search, {only_if}")
            half = 0.5 * number(gain[name], "difference")
            if is_fitted and holds(of_far) and number(over[FAR][name], "simultaneous_high") < half:
                said.append("moving colours does it")
        elif gain[name]["verdict"] == "lower":
            said.append("the attack harms")
        if gain[name]["ruled_out"] == "true":
            said.append("a gain of 0.3 dB is ruled out")
        print(f"## {name}\n\n**{'; '.join(said) or 'not shown'}**\n")
        print("| P minus | difference (dB) | 95 % interval | widened | verdict |\n|---|---:|---:|---:|---|")
        for row, lines in {NERF: gain, **over}.items():
            line = lines[name]
            own, wide = ([number(line, "low"), number(line, "high")], widened(line, ratio))
            shown = [f"[{low:+.2f}, {high:+.2f}]" for low, high in (own, wide)]
            print(f"| {row} | {number(line, 'difference'):+.2f} | {' | '.join(shown)} | {line['verdict'].replace('_', ' ')} |")
        print("\nF moves colours " + ", ".join(f"{size:.2f} times as far at {site}" for site, size in sizes.items()) + ".\n")


main()
