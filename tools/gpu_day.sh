#!/usr/bin/env bash
# What a machine with a GPU says of this program: prepared where it is built, run there unattended.
#
#   tools/gpu_day.sh prepare DATA [CUDA]   # lays programs, loaders, fern of DATA and peers into .gpu_day (under 64 MiB)
#   bash .gpu_day/gpu_day.sh run OUT       # on the machine: at most ten minutes; leaves archives and OUT/index
#   bash .gpu_day/gpu_day.sh rehearse OUT  # the same blocks in small sizes, without peers, on any device
#
# CUDA is a program that was built with --features cuda, to be timed as well. `prepare` needs no GPU, and `run` no network. As
# root, on a machine without a Vulkan loader, `run` installs the one that was prepared. WITHOUT_PEERS="nerf aug-nerf" leaves out
# PyTorch and CUDA, MOST_SECONDS=300 ends the day earlier, and BLOCKS="right terms" runs those blocks.
set -uo pipefail

# The tests of the device, by their files.
tests="augnerf_gpu step renderer density"
# The blocks of a day. `precision` fits in with NETWORK_STEPS=1000; with more it takes the place of the others.
all="right speed terms trainings precision paper"

prepare() {
  local data=$1 cuda=${2:-} day=.gpu_day
  cd "$(dirname "$0")/.." || exit
  rm -rf $day
  mkdir -p $day/fern/images_8
  cp tools/gpu_day.sh benches/torch_peer.py $day/
  cp "$data"/nerf_llff_data/fern/poses_bounds.npy $day/fern/
  cp "$data"/nerf_llff_data/fern/images_8/* $day/fern/images_8/
  cargo build --release --features gpu || exit
  cp target/release/augnerf $day/
  cargo test --release -p augnerf -p augnerf-gpu --lib --test step --test renderer --test density --no-run 2>&1 | tee $day/built || exit
  local test
  for test in $tests; do
    cp "$(sed -n "s/.*(\(target.*\/$test-[0-9a-f]*\))/\1/p" $day/built)" "$day/test-$test" || exit
  done
  rm $day/built
  [[ -n $cuda ]] && cp "$cuda" $day/augnerf-cuda
  strip $day/augnerf $day/test-* $day/augnerf-cuda 2> /dev/null
  (
    cd $day || exit
    apt-get download libvulkan1 libx11-6 libxcb1 libxext6 libxau6 libxdmcp6 libbsd0 libmd0 libegl1 libglvnd0 libopengl0 libgl1 \
      libglx0 libgles2
    # Names that any copy keeps.
    for deb in *.deb; do
      plain=$(tr -c 'A-Za-z0-9._\n' - <<< "${deb//%3a/-}")
      [[ $plain == "$deb" ]] || mv "$deb" "$plain"
    done
    xz -T0 -6 augnerf test-* augnerf-cuda 2> /dev/null
  )
  du -sh $day
}

# try LIMIT NAME COMMAND...: a block of the day. Its output goes to OUT/NAME, its exit code and the seconds so far to OUT/index.
# It ends when the time until `deadline` is up, and is left out if none is left.
try() {
  local limit=$(($1 * slower)) name=$2 left=$((deadline - SECONDS))
  shift 2
  if ((left < 5)); then
    echo "$name left-out $SECONDS" | tee -a "$out/index"
    return
  fi
  timeout $((limit < left ? limit : left)) "$@" > "$out/$name" 2>&1
  echo "$name $? $SECONDS" | tee -a "$out/index"
}

run() {
  out=$(realpath -m "$1")
  mkdir -p "$out"
  cd "$(dirname "$0")" || exit
  for packed in *.xz; do [[ -e $packed ]] && xz -dkf "$packed"; done
  chmod +x augnerf test-* augnerf-cuda 2> /dev/null
  if [[ $EUID == 0 ]] && ! ldconfig -p | grep -q libvulkan; then
    for deb in *.deb; do dpkg -x "$deb" /; done
    ldconfig
  fi
  local cuda
  cuda=$(python3 -c 'import nvidia, glob; print(":".join(glob.glob(nvidia.__path__[0] + "/*/lib")))' 2> /dev/null)
  export LD_LIBRARY_PATH=$cuda:/usr/local/nvidia/lib64:${LD_LIBRARY_PATH:-} RUST_BACKTRACE=1 PYTHONUNBUFFERED=1
  # The paper's training has the last two minutes, and packing the last seconds.
  local most=${MOST_SECONDS:-570} blocks=${BLOCKS:-$all}
  deadline=$most
  [[ $blocks == *paper* ]] && deadline=$((most - 120))
  # 0. The devices.
  try 15 0-smi nvidia-smi
  try 15 0-devices ./augnerf bench --devices
  local block
  for block in $blocks; do "$block"; done
  cd "$out" || exit
  # Tables of hash grids are large; the last training's checkpoint is for `resume`.
  for folder in */; do
    [[ -d $folder ]] || continue
    [[ $folder == fern-paper/ ]] || rm -rf "$folder/checkpoints"
    tar cf - --exclude='*.mp4' --exclude='*.gif' "$folder" | gzip -1 > "${folder%/}.tgz" && rm -r "$folder"
  done
  # One file for what was printed: some places bring few files back.
  tar czf printed.tgz [0-9]-* && rm [0-9]-*
}

# 1. Is it right?
right() {
  local test
  for test in $tests; do try 90 "1-$test" "./test-$test" --test-threads=1 --nocapture --include-ignored; done
}

# 2. How fast, in turn with PyTorch.
speed() {
  local bench="--rays $rays --coarse 64 --fine 128 --steps $steps"
  local hash="--rays $rays --coarse 48 --fine 32 --width 64 --steps $steps --set field.encoding=hash"
  local method as device
  # As many queries as NeRF's.
  for method in mip-nerf aug-mip-nerf; do
    try 20 "2-$method" ./augnerf bench --device gpu --method $method --rays $rays --coarse 128 --fine 128 --steps $steps
  done
  for method in nerf aug-nerf; do
    try 20 "2-$method" ./augnerf bench --device gpu --method $method $bench
    try 20 "2-$method-f16" ./augnerf bench --device gpu --method $method $bench --set field.precision=f16
    try 20 "2-$method-hash" ./augnerf bench --device gpu --method $method $hash
    [[ " ${WITHOUT_PEERS:-} " == *" $method "* ]] && continue
    for as in "" --tf32 --bf16 "--bf16 --compile"; do
      try 30 "2-$method-torch${as// /}" python3 torch_peer.py --device cuda --method ${method%-nerf} --rays 1024 --coarse 64 --fine 128 \
        --steps 10 $as
    done
    for device in cuda cuda-tf32; do
      [[ -x augnerf-cuda ]] && try 20 "2-$method-$device" ./augnerf-cuda bench --device $device --method $method $bench
    done
  done
}

# What the terms and the openings cost, on hash grids and on networks.
terms() {
  local field term
  local -A sizes=(
    [hash]="--rays $rays --coarse 48 --fine 32 --width 64 --steps $steps --set field.encoding=hash --set field.hash.interpolation=smoothstep"
    [network]="--rays $rays --coarse 64 --fine 64 --steps $steps"
  )
  for field in hash network; do
    # [] is no term.
    for term in [] l1 tv laplacian distortion occlusion entropy cauchy opacity-prior; do
      try 20 "2-term-$field-${term/\[\]/none}" ./augnerf bench --device gpu ${sizes[$field]} --set regularizer.kind=$term
    done
    try 20 "2-term-$field-frequencies" ./augnerf bench --device gpu ${sizes[$field]} --set field.frequency_steps=100
  done
}

# 3. Trainings that end, with their views, and a surface.
trainings() {
  local method
  for method in nerf aug-nerf; do
    try 60 "3-builtin-$method" ./augnerf train --method $method --device gpu --out "$out/builtin-$method" $small
    try 60 "3-fern-$method" ./augnerf train --data fern --preset fast --method $method --device gpu --out "$out/fern-$method" $small
  done
  # FreeNeRF's settings and its field, from few views.
  try 60 3-fern-freenerf ./augnerf train --data fern --preset fast --device gpu --out "$out/fern-freenerf" $small \
    --set data.train_views="3 even" --set regularizer.kind=occlusion --set field.frequency_steps=$opening
  try 30 3-builtin-mesh ./augnerf mesh "$out/builtin-nerf" --device gpu --resolution $resolution $surface --picture "$out/builtin-mesh.png"
  try 30 3-builtin-measure ./augnerf eval --smoothness "$out/builtin-nerf" --device gpu
  [[ -x augnerf-cuda ]] && try 30 3-builtin-cuda ./augnerf-cuda train --device cuda --out "$out/builtin-cuda" --set train.steps=50 \
    --set train.chunk=1024 --set eval.chunk=4096
}

# A network, shortened, in both precisions: are the pictures the same?
precision() {
  local precision
  for precision in f16 f32; do
    try 400 "3-fern-network-$precision" ./augnerf train --data fern --preset paper-llff --device gpu --out "$out/fern-$precision" \
      --set train.steps=$network_steps --set field.precision=$precision $small_paper
  done
}

# 4. The paper's own settings on fern, until the time is up. `augnerf resume` goes on from the checkpoint.
paper() {
  deadline=$most
  try $((most / slower)) 4-fern-paper ./augnerf train --data fern --preset paper-llff --device gpu --out "$out/fern-paper" \
    --set train.log_every=$log_every $small_paper
}

# Sizes of the day, and of its rehearsal.
rays=1024 steps=20 network_steps=${NETWORK_STEPS:-1000} resolution=256 log_every=200 slower=1 opening=900 small="" small_paper="" surface=""

rehearse() {
  rays=8 steps=1 network_steps=2 resolution=24 log_every=1 slower=4 opening=10 surface="--threshold 0.3"
  small="--set train.rays=32 --set train.steps=20 --set train.decay_steps=20 --set data.width=32"
  small_paper="--set train.rays=4 --set data.width=32 --set field.width=32"
  WITHOUT_PEERS="nerf aug-nerf" MOST_SECONDS=${MOST_SECONDS:-900} run "$1"
}

case ${1:-} in
  prepare) prepare "${2:?the folder with nerf_llff_data}" "${3:-}" ;;
  rehearse) rehearse "${2:?folder for what comes back}" ;;
  run) run "${2:?folder for what comes back}" ;;
  *) sed -n '2,11s/^# \?//p' "$0" ;;
esac
