#!/bin/bash
# Stages the finished points of sweeps below runs/, so that `augnerf sweep run` can continue on another machine. Adds the
# definitions and, for each point that has ended, its result, metrics and logs. Checkpoints, images and depth errors are not
# added. Such points cannot be rendered again, and have no metrics over the pixels that all rows show. Points name the revision
# of their program: continue with a program of that revision (git worktree). Remove the points once the tables are committed.
#
#   tools/keep_points.sh baselines_chair && git commit -m "Keep points of baselines_chair"
set -euo pipefail
shopt -s nullglob
cd "$(dirname "$0")/.."
for name in "$@"; do
  folder=runs/$name
  [ -f "$folder/points.json" ] || { echo "$folder has no points.json, so it is not a started sweep; name sweeps below runs/" >&2; exit 2; }
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
