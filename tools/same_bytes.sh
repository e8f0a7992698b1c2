#!/usr/bin/env bash
# Checks whether this tree writes the same bytes as an earlier revision. Run it after every refactoring.
#
#     tools/same_bytes.sh REV                          # everything; a few minutes once REV's outputs are kept
#     tools/same_bytes.sh REV --only 'train/*' mesh    # some cases
#     tools/same_bytes.sh REV --list                   # their names
#     tools/same_bytes.sh REV --keep DIR               # keep both sides' files in DIR/old and DIR/new
#
# The script builds REV in a git worktree and this tree, both with `--release`. It runs the same small commands with both
# programs and compares all files and messages byte for byte: settings, checkpoints, metrics, tables, figures, meshes, points
# of sweeps, exit codes. Each differing file is printed with its first differing line or offset. The exit code is 0 if nothing
# differs, 1 if something does, 2 if a case cannot be run.
#
# Not compared: numbers in timing.json, timing.csv, run.lock; the code's revision; seconds and
# rates in messages (same_bytes/compare.py). Intended differences are in same_bytes.allow with their reasons. The commands are
# in same_bytes/cases.py; REV must have them too.
#
# Scenes: $AUGNERF_DATA and $AUGNERF_LPIPS_WEIGHTS, or ../shared/data and ../shared/weights/lpips next to the checkout. Cases
# without their scenes are skipped and counted. REV's program and outputs are kept in $AUGNERF_SAME_BYTES_CACHE (default
# target/same_bytes). An output is made again if its commands, its scenes or the CPU change. Needs git, cargo, bash and
# Python 3.9 without packages.
set -euo pipefail
exec python3 -B "$(dirname "$0")/same_bytes" "$@"
