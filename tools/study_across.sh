#!/bin/bash
# The study's comparisons over its blocks (results/study/PLAN.md), once all five are complete: results/study_primary and what is secondary. Where
# calibrated minus NeRF passes above 0, name those blocks, and they are compared with uniform draws and with equal evaluations, too:
#
#   tools/study_across.sh
#   tools/study_across.sh study_fern_noise study_fern_few
set -euo pipefail
cd "$(dirname "$0")/.."
augnerf=${AUGNERF:-target/release/augnerf}
chair=(study_chair_few study_chair_25 study_own_few)
blocks=(study_chair_few study_chair_25 study_fern_few study_fern_noise study_own_few)

# compare OUT ROW BASELINE METRIC BLOCK...
compare() {
  local out=$1 row=$2 baseline=$3 metric=$4
  shift 4
  "$augnerf" sweep across "${@/#/results/}" --row "$row" --baseline "$baseline" --metric "$metric" --out "results/$out"
}

calibrated="Aug-NeRF calibrated"
if (($#)); then
  compare study_worst_case "$calibrated" "Uniform draws, calibrated" psnr "$@"
  compare study_cost "$calibrated" "NeRF, equal evaluations" psnr "$@"
  exit
fi
compare study_primary "$calibrated" NeRF psnr "${blocks[@]}"
compare study_paper "Aug-NeRF, paper's geometry" NeRF psnr "${blocks[@]}"
compare study_tv "+ TV Reg." NeRF psnr "${blocks[@]}"
compare study_attack_tv "$calibrated" "+ TV Reg." psnr "${blocks[@]}"
compare study_second_look "$calibrated" "NeRF + second clean pass" psnr "${blocks[@]}"
compare study_ssim "$calibrated" NeRF ssim "${blocks[@]}"
compare study_lpips "$calibrated" NeRF lpips_squeeze "${blocks[@]}"
compare study_depth "$calibrated" NeRF depth_mae_common "${chair[@]}"
