#!/usr/bin/env python3
"""Fits a row of random draws to an attack: the radii at which each site's draws move colours as far as the worst case does.

    tools/fit_draws.py results/few_views/scenes_draws "Aug-NeRF calibrated" "Draws, as far"

Reads the shifts of both rows from attack.csv, as means over scenes, and the draws' radii from sweep.toml. Prints both shifts, their
ratio and the radius to try next, in proportion. Ends with 1 as long as a ratio is further than a tenth from 1.
"""
import csv
import sys
import tomllib
from pathlib import Path


def main(results, attack, draws, within=0.1):
    lines = list(csv.DictReader((Path(results) / "attack.csv").open(newline="")))
    row = next(row for row in tomllib.loads((Path(results) / "sweep.toml").read_text())["row"] if row["name"] == draws)
    sites = [name.removeprefix("shift.") for name in lines[0] if name.startswith("shift.")]

    def shift(name, site):
        found = [float(line[f"shift.{site}"]) for line in lines if line["row"] == name and line[f"shift.{site}"]]
        return sum(found) / len(found)

    fits = True
    print("| site | worst case (1/255) | draws (1/255) | ratio | radius | next |\n|---|---:|---:|---:|---:|---:|")
    for site in sites:
        radius = row["set"][f"perturb.{site}.epsilon"]
        of_attack, of_draws = shift(attack, site), shift(draws, site)
        ratio = of_draws / of_attack
        fits &= abs(ratio - 1) <= within
        print(f"| {site} | {of_attack:.3f} | {of_draws:.3f} | {ratio:.2f} | {radius:g} | {radius / ratio:.3g} |")
    return int(not fits)


if __name__ == "__main__":
    if len(sys.argv) != 4:
        sys.exit(__doc__)
    sys.exit(main(*sys.argv[1:]))
