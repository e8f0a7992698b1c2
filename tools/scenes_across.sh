#!/bin/bash
# Makes the tables of the comparison over scenes (results/few_views/PLAN.md, "Analysis") in results/few_views/over_*, once all points
# have ended. AUGNERF names the program. SCENES and OVER name other results and another prefix for a trial.
#
#   tools/scenes_across.sh
set -euo pipefail
cd "$(dirname "$0")/.."
augnerf=${AUGNERF:-target/release/augnerf}
results=${SCENES:-results/few_views/scenes}
over=${OVER:-results/few_views/over}
[[ -f $results/points.csv ]] || { echo "$results has no points.csv; scenes are compared once all points have ended" >&2; exit 2; }

# Prints the scenes that $1 (awk, of the scene's name s) takes, with commas between.
scenes() { awk -F, "NR > 1 { print \$2 }" "$results/points.csv" | sort -u | awk "{ s = \$1 } $1" | paste -sd ,; }

# compare NAME N [OPTION]...: one comparison, of N scenes. A trial may have fewer.
compare() {
  local name=$1 count=$2 found
  shift 2
  if [[ " $* " == *" --scenes  "* ]]; then echo "$name: none of its scenes is here"; return; fi
  "$augnerf" sweep across "$results" --unit scene "$@" --out "${over}_$name"
  found=$(awk -F, 'NR > 1 { print $1 }' "${over}_$name/scenes.csv" | sort -u | wc -l)
  if [[ -z ${SCENES:-} && $found != "$count" ]]; then
    echo "${over}_$name has $found scenes; the plan has $count" >&2
    exit 1
  fi
}

compare scenes 24
compare ssim 24 --metric ssim
compare lpips 24 --metric lpips_squeeze
# Dependence, and what the plan shows apart.
compare captures 12 --scenes "$(scenes 's !~ /^(blender|builtin)/')"
compare others 12 --scenes "$(scenes 's ~ /^(blender|builtin)/')"
compare same_unit 23 --scenes "$(scenes 's != "capture_fruit"')"
compare authors 9 --scenes "$(scenes 's ~ /^(capture_fruit|colmap_canclip|dtu_scan24|llff_ethiopianhead|llff_flower|llff_milk|llff_orbit77|blender_bike|builtin-1)$/')"
compare new_authors 11 --scenes "$(scenes 's !~ /^(llff_(flower|fortress|horns|trex)|blender_mic|builtin.*)$/')"
# What isolates the worst case.
compare worst_case 24 --baseline "Aug-NeRF calibrated" --rows "Draws, as far,Smoothing of positions"
# Rows that help, against stopping early: Holm's p below 0.05, above NeRF.
helping=$(python3 - "${over}_scenes/over_scenes.csv" <<'P'
import csv, sys
rows = csv.DictReader(open(sys.argv[1], newline=""))
print(",".join(row["row"] for row in rows if row["verdict"] == "higher" and row["row"] != "NeRF, fewer steps"))
P
)
if [[ -n $helping ]]; then
  compare early 24 --baseline "NeRF, fewer steps" --rows "$helping"
else
  echo "no row helps; none is compared with stopping early"
fi
