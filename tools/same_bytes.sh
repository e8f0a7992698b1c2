#!/usr/bin/env bash
# Does this tree still write the bytes of an earlier revision? The check behind every refactoring.
#
#     tools/same_bytes.sh REV                          # everything; a few minutes once REV's outputs are kept
#     tools/same_bytes.sh REV --only 'train/*' mesh    # some cases
#     tools/same_bytes.sh REV --list                   # their names
#     tools/same_bytes.sh REV --keep DIR               # leave both sides' files in DIR/old and DIR/new, to look at
#
# It builds REV in a git worktree and this tree, both `--release`, runs the same small commands with both programs, one after the
# other, and compares all that they leave and say, byte for byte: settings, checkpoints, metrics, tables, figures, meshes, points
# of sweeps, exit codes, messages. Each file that differs is named with its first line or offset that does. The exit code is 0
# if nothing differs, 1 if something does, 2 if a case cannot be run.
#
# What is not compared: numbers in timing.json, timing.csv, run.lock and event files' clocks; the code's revision; seconds and
# rates in messages (same_bytes/compare.py). Intended differences stand in same_bytes.allow with their reasons. The commands are
# in same_bytes/cases.py; only such as REV knows, too.
#
# Scenes: $AUGNERF_DATA and $AUGNERF_LPIPS_WEIGHTS, or ../shared/data and ../shared/weights/lpips beside the checkout. Cases that
# lack theirs are skipped and counted. REV's program and outputs are kept in $AUGNERF_SAME_BYTES_CACHE (default
# target/same_bytes); an output is made again when its commands, its scenes or the processor change. Needs git, cargo, bash,
# Python 3.9 and no package of it.
set -euo pipefail
exec python3 -B "$(dirname "$0")/same_bytes" "$@"
