#!/bin/bash
# Stages what is done of sweeps below runs/, for `augnerf sweep run` to go on from on another machine: the definitions, and of each
# point that has ended its result, metrics and logs. Checkpoints, pictures and the maps of depth errors stay behind: such points cannot
# be rendered again, and have no metrics over the pixels that all rows show. The points carry the revision of the program that made
# them: go on with a program that is built at that revision (git worktree). Taken out again once the tables are committed.
#
#   tools/keep_points.sh baselines_chair && git commit -m "Keep points of baselines_chair"
set -euo pipefail
shopt -s nullglob
cd "$(dirname "$0")/.."
for name in "$@"; do
  folder=runs/$name
  [ -f "$folder/points.json" ] || { echo "$folder has no points.json: it is no sweep that was begun" >&2; exit 2; }
  git add -f "$folder/sweep.toml" "$folder/points.json"
  [ ! -f "$folder/step_seconds.json" ] || git add -f "$folder/step_seconds.json"
  for result in "$folder"/points/*/result.json; do
    point=$(dirname "$result")
    git add -f "$result" "$point/config.toml"
    for file in config.toml metrics.json metrics.csv scalars.csv timing.json scene.json; do
      [ ! -f "$point/run/$file" ] || git add -f "$point/run/$file"
    done
  done
done
git diff --cached --shortstat
