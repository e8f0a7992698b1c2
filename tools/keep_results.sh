#!/bin/bash
# Keeps a finished sweep's results in the repository: its tables and what they are made of, without figures and the page, which
# `augnerf verify --update --all` makes again. Then checks them. A page about them and a row in results/PROVENANCE.md are yours.
#
#   tools/keep_results.sh runs/few_views_llff_3/results few_views    # results/few_views/few_views_llff_3
#
# AUGNERF names a program to check with, in place of one that is built here.
set -euo pipefail
cd "$(dirname "$0")/.."
from=$1 group=$2
[[ -f $from/provenance.toml && -f $from/timing.csv ]] || { echo "$from has no provenance.toml and timing.csv: name a sweep's results" >&2; exit 2; }
name=$(sed -n 's/^name = "\(.*\)"$/\1/p' "$from/provenance.toml")
to=results/$group/$name
mkdir -p "$to"
for file in attack.csv points.csv points.json scalars.csv.gz sweep.toml table.csv table.md timing.csv; do
  [[ ! -e $from/$file ]] || cp "$from/$file" "$to/"
done
# [pinned] has the hashes of files that are not kept, and [inputs] lacks the clock times. Other parts stay, such as [[missing]].
awk -v timing="\"timing.csv\" = \"$(sha256sum < "$from/timing.csv" | cut -d ' ' -f 1)\"" '
  /^\[/ { part = $0 }
  part != "[pinned]" { print }
  $0 == "[inputs]" { print timing }
' "$from/provenance.toml" | cat -s > "$to/provenance.toml"
${AUGNERF:-cargo run --release --quiet --} verify "$to"
