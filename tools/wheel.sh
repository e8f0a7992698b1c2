#!/usr/bin/env bash
# wheel.sh [FEATURES]: builds the program for Linux systems with an older glibc, and packs it as a wheel into target/wheels.
# FEATURES are cargo's: --features gpu. GLIBC=2.28 is the oldest glibc that the program must start on. Prints the glibc and the
# libraries that the program needs.
# Needs Rust with its linker, Python 3 and objdump, but no C compiler: zig links the program. The first call
# installs maturin and zig from PyPI into target/wheel-tools.
set -euo pipefail
cd "$(dirname "$0")/.."

glibc=${GLIBC:-2.28}
tools=$PWD/target/wheel-tools
if [[ ! -x $tools/bin/maturin ]]; then
  python3 -m venv "$tools"
  "$tools/bin/pip" install --quiet --disable-pip-version-check maturin==1.16.0 ziglang==0.17.1
fi
export PATH=$tools/bin:$PATH CARGO_TARGET_DIR=${CARGO_TARGET_DIR:-$PWD/target/wheel-build}

# zig links against the symbols of the named glibc, whatever this system has.
target=$(rustc -vV | sed -n 's/^host: //p')
out=target/wheels
rm -rf "$out"
maturin build --release --locked --zig --target "$target" --compatibility "manylinux_${glibc/./_}" --out "$out" "$@"
wheel=$(echo "$out"/*.whl)

# The program as it is in the wheel.
program=$CARGO_TARGET_DIR/wheel-program/augnerf
mkdir -p "${program%/*}"
python3 -c 'import sys, zipfile; archive = zipfile.ZipFile(sys.argv[1])
sys.stdout.buffer.write(archive.read(next(name for name in archive.namelist() if name.endswith("/scripts/augnerf"))))' \
  "$wheel" > "$program"
chmod +x "$program"

needed=$(objdump -p "$program" | awk '/NEEDED/ { print $2 }')
if foreign=$(grep -Ev '^(lib(c|m|dl|rt|pthread|util)\.so\.[0-9]+|ld-linux.*)$' <<< "$needed"); then
  echo "$program needs" $foreign "besides glibc, which other machines may lack" >&2
  exit 1
fi
"$program" --version
(cd "$out" && sha256sum ./*.whl)
echo "$wheel: $(stat -c %s "$wheel") bytes, $program: $(stat -c %s "$program") bytes"
echo "needs glibc $(objdump -T "$program" | grep -o 'GLIBC_[0-9.]*' | sort -Vu | tail -1 | cut -d_ -f2) or newer, and these libraries:" $needed
