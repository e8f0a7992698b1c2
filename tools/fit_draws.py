#!/usr/bin/env python3
"""Fits a row of random draws to an attack: the radii at which each site's draws move colours as far as the worst case does.

    tools/fit_draws.py results/few_views/scenes_tuning_fit "Aug-NeRF calibrated" "Draws, round 5"

Reads the shifts of both rows from attack.csv, as means over scenes and logged steps, and the draws' radii from sweep.toml. Prints both
shifts, their ratio and the radius to try next, in proportion. A site whose worst case moves colours by less than half a step of 255
is not fitted, nor is one whose radius the row does not set. Neither row may have axes. Ends with 1 as long as a ratio is further than a tenth from 1.
"""
import csv
import sys
import tomllib
from pathlib import Path


LEAST_SHIFT = 0.5


def main(results, attack, draws, within=0.1):
    lines = list(csv.DictReader((Path(results) / "attack.csv").open(newline="")))
    row = next(row for row in tomllib.loads((Path(results) / "sweep.toml").read_text())["row"] if row["name"] == draws)
    sites = [name.removeprefix("shift.") for name in lines[0] if name.startswith("shift.")]

    if any(line["axes"] for line in lines if line["row"] in (attack, draws)):
        sys.exit(f"{attack} or {draws} has axes: fit a sweep without them")

    def shift(name, site):
        found = [float(line[f"shift.{site}"]) for line in lines if line["row"] == name and line[f"shift.{site}"]]
        return sum(found) / len(found) if found else 0.0

    fits = True
    print("| site | worst case (1/255) | draws (1/255) | ratio | radius | next |\n|---|---:|---:|---:|---:|---:|")
    for site in sites:
        radius = row["set"].get(f"perturb.{site}.epsilon")
        of_attack, of_draws = shift(attack, site), shift(draws, site)
        if radius is not None and of_attack >= LEAST_SHIFT and of_draws == 0.0:
            sys.exit(f"{site}: draws of radius {radius:g} move no colour; start with a larger radius")
        if radius is None or of_attack < LEAST_SHIFT:
            print(f"| {site} | {of_attack:.3f} | {of_draws:.3f} | not fitted | | |")
            continue
        ratio = of_draws / of_attack
        fits &= abs(ratio - 1) <= within
        print(f"| {site} | {of_attack:.3f} | {of_draws:.3f} | {ratio:.2f} | {radius:g} | {radius / ratio:.3g} |")
    return int(not fits)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
