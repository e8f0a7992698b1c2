#!/usr/bin/env bash
# What a machine with a GPU says of this program: prepared where it is built, run there unattended.
#
#   tools/gpu_day.sh prepare DATA [CUDA]   # lays programs, loaders, fern of DATA and peers into .gpu_day (under 64 MiB)
#   bash .gpu_day/gpu_day.sh run OUT       # on the machine: at most ten minutes; leaves files and OUT/index
#
# CUDA is a program that was built with --features cuda, to be timed as well. `prepare` needs no GPU, and `run` no network. As
# root, on a machine without a Vulkan loader, `run` installs the one that was prepared. WITHOUT_PEERS="nerf aug-nerf" leaves out
# PyTorch and CUDA, and MOST_SECONDS=300 ends the day earlier.
set -uo pipefail

prepare() {
  local data=$1 cuda=${2:-} day=.gpu_day
  cd "$(dirname "$0")/.." || exit
  rm -rf $day
  mkdir -p $day/fern/images_8
  cp tools/gpu_day.sh benches/torch_peer.py $day/
  cp "$data"/nerf_llff_data/fern/poses_bounds.npy $day/fern/
  cp "$data"/nerf_llff_data/fern/images_8/* $day/fern/images_8/
  cargo build --release --features gpu || exit
  cargo build --release -p augnerf-gpu --example time || exit
  cargo test --release -p augnerf-gpu --test step --no-run 2>&1 | tee $day/built || exit
  local steps
  steps=$(sed -n 's/.*(\(target.*step-[0-9a-f]*\))/\1/p' $day/built)
  rm $day/built
  cp target/release/augnerf target/release/examples/time $day/
  cp "$steps" $day/steps
  [[ -n $cuda ]] && cp "$cuda" $day/augnerf-cuda
  strip $day/augnerf $day/time $day/steps $day/augnerf-cuda 2> /dev/null
  (
    cd $day || exit
    apt-get download libvulkan1 libx11-6 libxcb1 libxext6 libxau6 libxdmcp6 libbsd0 libmd0 libegl1 libglvnd0 libopengl0 libgl1 \
      libglx0 libgles2
    # Names that any copy keeps.
    for deb in *.deb; do
      plain=$(tr -c 'A-Za-z0-9._\n' - <<< "${deb//%3a/-}")
      [[ $plain == "$deb" ]] || mv "$deb" "$plain"
    done
    xz -T0 -6 augnerf time steps augnerf-cuda 2> /dev/null
  )
  du -sh $day
}

# try LIMIT NAME COMMAND...: a block of the day. Its output goes to OUT/NAME, its exit code and the seconds so far to OUT/index.
try() {
  local limit=$1 name=$2
  shift 2
  timeout "$limit" "$@" > "$out/$name" 2>&1
  echo "$name $? $SECONDS" | tee -a "$out/index"
}

run() {
  out=$(realpath -m "$1")
  mkdir -p "$out"
  cd "$(dirname "$0")" || exit
  for packed in *.xz; do [[ -e $packed ]] && xz -dkf "$packed"; done
  chmod +x augnerf time steps augnerf-cuda 2> /dev/null
  if [[ $EUID == 0 ]] && ! ldconfig -p | grep -q libvulkan; then
    for deb in *.deb; do dpkg -x "$deb" /; done
    ldconfig
  fi
  local cuda
  cuda=$(python3 -c 'import nvidia, glob; print(":".join(glob.glob(nvidia.__path__[0] + "/*/lib")))' 2> /dev/null)
  export LD_LIBRARY_PATH=$cuda:/usr/local/nvidia/lib64:${LD_LIBRARY_PATH:-} RUST_BACKTRACE=1 PYTHONUNBUFFERED=1
  # 0. The devices.
  try 15 0-smi nvidia-smi
  try 15 0-devices ./augnerf devices
  # 1. Is it right?
  try 90 1-steps ./steps --test-threads=1 --nocapture
  # 2. How fast, in turn with PyTorch.
  local sizes="sampling.coarse=64 sampling.fine=128"
  local small="field.encoding=hash sampling.coarse=48 sampling.fine=32 field.width=64"
  for method in nerf aug-nerf; do
    try 20 "2-$method" ./time 0 20 method=$method $sizes
    try 20 "2-$method-f16" ./time 0 20 method=$method $sizes field.precision=f16
    try 20 "2-$method-hash" ./time 0 50 method=$method $small
    [[ " ${WITHOUT_PEERS:-} " == *" $method "* ]] && continue
    for as in "" --tf32 --bf16; do
      try 20 "2-$method-torch$as" python3 torch_peer.py --device cuda --method ${method%-nerf} --rays 1024 --coarse 64 --fine 128 \
        --steps 10 $as
    done
    for device in cuda cuda-tf32; do
      [[ -x augnerf-cuda ]] && try 20 "2-$method-$device" ./augnerf-cuda bench --device $device --method $method --rays 1024 \
        --coarse 64 --fine 128 --steps 10
    done
  done
  # 3. Trainings that end.
  for method in nerf aug-nerf; do
    try 60 "3-builtin-$method" ./augnerf train --method $method --device gpu --out "$out/builtin-$method"
    try 60 "3-fern-$method" ./augnerf train --data fern --preset fast --method $method --device gpu --out "$out/fern-$method"
  done
  # 4. The paper's own settings on fern, until the time is up. `augnerf resume` goes on from the checkpoint.
  local left=$((${MOST_SECONDS:-570} - SECONDS))
  ((left > 20)) && try $left 4-fern-paper ./augnerf train --data fern --preset paper-llff --device gpu --out "$out/fern-paper" \
    --set train.log_every=200
  cd "$out" || exit
  # Tables of hash grids are large; the last training's checkpoint is for `resume`.
  for folder in */; do
    [[ $folder == fern-paper/ ]] || rm -rf "$folder/checkpoints"
    tar cf - --exclude='*.mp4' --exclude='*.gif' "$folder" | gzip -1 > "${folder%/}.tgz" && rm -r "$folder"
  done
}

case ${1:-} in
  prepare) prepare "${2:?the folder with nerf_llff_data}" "${3:-}" ;;
  run) run "${2:?folder for what comes back}" ;;
  *) sed -n '2,9s/^# \?//p' "$0" ;;
esac
