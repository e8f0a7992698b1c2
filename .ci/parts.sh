# What .ci/run and .ci/nightly share: named parts, a table of what each took, and what was left out. Sourced by both.
set -euo pipefail
cd "$(dirname "${BASH_SOURCE[0]}")/.."
root=$PWD

# Real scenes and LPIPS weights, if a folder `shared` next to the checkout has them (CONTRIBUTING.md).
shared="$root/../shared"
[[ -d $shared/data ]] && export AUGNERF_DATA="$shared/data"
[[ -d $shared/weights/lpips ]] && export AUGNERF_LPIPS_WEIGHTS="$shared/weights/lpips"

if ! command -v cargo > /dev/null; then
  echo "cargo is missing: install Rust 1.89 or newer from https://rustup.rs" >&2
  exit 1
fi

# A fresh checkout is built once: what incremental builds keep would not be used.
[[ -d target ]] || export CARGO_INCREMENTAL=0

gate=.ci/$(basename "$0")
scratch=$(mktemp -d)
table=$scratch/table
touch "$table"
begun=$SECONDS

finish() {
  local status=$?
  ((status == 0)) && status=$failed
  printf '\n%-28s %8s\n' part seconds
  cat "$table"
  printf '%-28s %8d\n' "in all" $((SECONDS - begun))
  rm -rf "$scratch"
  ((status == 0)) && echo "$gate: passed" || echo "$gate: NOT PASSED"
  exit $status
}
trap finish EXIT
# A stopped run has not passed.
trap 'exit 130' INT
trap 'exit 143' TERM

# part NAME COMMAND...: runs a command and notes how long it took. A part that fails does not keep the next from running.
failed=0
part() {
  local name=$1 started=$SECONDS status=0
  shift
  printf '\n== %s: %s\n' "$name" "$*"
  "$@" || status=$?
  printf '%-28s %8d%s\n' "$name" $((SECONDS - started)) "$( ((status == 0)) || echo "  FAILED")" >> "$table"
  ((status == 0)) || failed=1
}

# left_out NAME REASON
left_out() {
  printf '\n== %s: LEFT OUT, %s\n' "$1" "$2"
  printf '%-28s %8s  LEFT OUT: %s\n' "$1" - "$2" >> "$table"
}

# has PROGRAM [PACKAGE]: whether a program is there; a package that has it is installed if that is possible.
has() {
  command -v "$1" > /dev/null && return 0
  [[ -n ${2:-} ]] && apt-get install -y --no-install-recommends "$2" > "$scratch/$1.log" 2>&1 || true
  command -v "$1" > /dev/null
}

# slow_tests: the names of tests that are ignored because they are slow. The nightly run has them.
slow_tests() {
  sed -n '/#\[ignore = "slow"\]/{n;s/^fn \([a-z0-9_]*\).*/\1/p}' tests/it/*.rs
}

# device: is there one for `--device gpu`? Mesa's driver plays one on the processor. A machine with a card sets AUGNERF_GPU=1, and
# then must have it.
device() {
  local driver
  [[ -n ${AUGNERF_GPU:-} ]] && return
  for driver in /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json; do [[ -e $driver ]] && return; done
  [[ $EUID == 0 ]] && command -v apt-get > /dev/null || return
  (apt-get update && apt-get install -y mesa-vulkan-drivers libvulkan1) > "$scratch/mesa" 2>&1 || return
}
