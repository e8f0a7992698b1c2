#!/bin/bash
# Makes the study's comparisons over its blocks (results/study/PLAN.md) in results/study/study_*, once all five blocks are complete:
# the primary one, the secondary ones, and those for the blocks where calibrated minus NeRF is significantly above 0. These
# blocks come from results/study/study_primary/across.csv. AUGNERF names the program.
#
#   results/study/study_across.sh
set -euo pipefail
cd "$(dirname "$0")/../.."
augnerf=${AUGNERF:-target/release/augnerf}
chair=(study_chair_few study_chair_25 study_own_few)
blocks=(study_fern_few study_fern_noise study_chair_few study_chair_25 study_own_few)
seeds=8
# What figures and pages call the sweeps.
declare -A label=(
  [study_fern_few]="fern, 8 views" [study_fern_noise]="fern, noise" [study_chair_few]="chair, 8 views"
  [study_chair_25]="chair, 25 views" [study_own_few]="chair, 4 views, NeRF's network"
)

# compare OUT ROW BASELINE METRIC BLOCK...: keeps figures and Markdown only if the repository has them.
compare() {
  local out=results/study/$1 row=$2 baseline=$3 metric=$4 labels=() block file
  shift 4
  for block; do labels+=(--label "$block=${label[$block]}"); done
  "$augnerf" sweep across "${@/#/results/study/}" --row "$row" --baseline "$baseline" --metric "$metric" "${labels[@]}" --out "$out"
  for file in "$out"/across*.{svg,png,txt,md}; do
    git ls-files --error-unmatch "$file" >/dev/null 2>&1 || rm -f "$file"
  done
}

# primary COLUMN: prints sweep and a column of the primary comparison, one line a block. No row's name has a comma.
primary() {
  awk -F, -v name="$1" 'NR == 1 { for (i = 1; i <= NF; i++) at[$i] = i; next } { print $at["sweep"], $at[name] }' \
    results/study/study_primary/across.csv
}

# The plan corrects over five complete blocks; with fewer blocks or seeds it would be another test.
for block in "${blocks[@]}"; do
  [[ -f results/study/$block/points.csv ]] || { echo "results/study/$block is missing; the study is compared once all of its blocks are complete" >&2; exit 2; }
done
calibrated="Aug-NeRF calibrated"
compare study_primary "$calibrated" NeRF psnr "${blocks[@]}"
if ! primary pairs | awk -v blocks=${#blocks[@]} -v seeds=$seeds '$2 != seeds { wrong = 1 } END { exit wrong || NR != blocks }'; then
  echo "results/study/study_primary needs $seeds seeds in each of ${#blocks[@]} blocks, but has: $(primary pairs | paste -sd ';')" >&2
  exit 1
fi
compare study_paper "Aug-NeRF, paper's geometry" NeRF psnr "${blocks[@]}"
compare study_tv "+ TV Reg." NeRF psnr "${blocks[@]}"
compare study_attack_tv "$calibrated" "+ TV Reg." psnr "${blocks[@]}"
compare study_second_look "$calibrated" "NeRF + second clean pass" psnr "${blocks[@]}"
compare study_ssim "$calibrated" NeRF ssim "${blocks[@]}"
compare study_lpips "$calibrated" NeRF lpips_squeeze "${blocks[@]}"
compare study_depth "$calibrated" NeRF depth_mae_common "${chair[@]}"

mapfile -t gains < <(primary verdict | awk '$2 == "higher" { print $1 }')
if ((${#gains[@]})); then
  compare study_worst_case "$calibrated" "Uniform draws, calibrated" psnr "${gains[@]}"
  compare study_cost "$calibrated" "NeRF, equal evaluations" psnr "${gains[@]}"
else
  echo "calibrated minus NeRF is significantly above 0 in no block; nothing is compared with uniform draws or equal evaluations"
fi
