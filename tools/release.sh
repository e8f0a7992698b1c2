#!/usr/bin/env bash
# release.sh [FEATURES]: builds the program for this Linux and packs it into target/release-package:
# augnerf-VERSION-TARGET.tar.gz with the program, README, licences, completions, and its SHA-256.
# FEATURES are cargo's: --no-default-features, --features cuda. Prints the glibc that the program needs. If the program needs
# any other library, except CUDA's, nothing is packed. PROGRAM=FILE packs that program instead of building one, such as
# wheel.sh's, which runs on older systems.
set -euo pipefail
cd "$(dirname "$0")/.."

# glibc, not musl: exp and log of another libm would give other bytes than builds from source.
target=$(rustc -vV | sed -n 's/^host: //p')
version=$(sed -n 's/^version = "\(.*\)"/\1/p' Cargo.toml | head -1)
name=augnerf-$version-$target
out=target/release-package
rm -rf "$out"
mkdir -p "$out/$name/completions"

if [[ -z ${PROGRAM:-} ]]; then
  # Links the compiler's library statically: the linker's first folder has only the archive.
  archives=$PWD/target/release-archives
  mkdir -p "$archives"
  archive=$(cc -print-file-name=libgcc_eh.a 2> /dev/null || true)
  [[ -e $archive ]] && ln -sf "$archive" "$archives/libgcc_s.a"
  export RUSTFLAGS="${RUSTFLAGS:-} -L native=$archives"
  CARGO_INCREMENTAL=0 cargo build --release --locked --target-dir target/release-build "$@"
  PROGRAM=target/release-build/release/augnerf
fi
cp "$PROGRAM" "$out/$name/augnerf"
strip "$out/$name/augnerf"

program=$out/$name/augnerf
needed=$(objdump -p "$program" | awk '/NEEDED/ { print $2 }')
own='^(lib(c|m|dl|rt|pthread|util)\.so\.[0-9]+|ld-linux.*)$'
[[ " $* " == *cuda* ]] && own="$own|^lib(cu|nv)"
if foreign=$(grep -Ev "$own" <<< "$needed"); then
  echo "$program needs" $foreign "besides glibc, which other machines may lack; install gcc with libgcc_eh.a" >&2
  rm -rf "$out"
  exit 1
fi

for shell in bash elvish fish zsh; do
  "$program" --completions "$shell" > "$out/$name/completions/augnerf.$shell"
done
cp README.md CHANGELOG.md CITATION.cff LICENSE-MIT LICENSE-APACHE "$out/$name/"
mkdir "$out/$name/fonts"
cp assets/fonts/README.md assets/fonts/OFL.txt "$out/$name/fonts/"

# Equal files give an equal archive: no owners, sorted names, the time of the commit.
when=$(git log -1 --format=%ct 2> /dev/null || echo 0)
tar --sort=name --owner=0 --group=0 --numeric-owner --mtime="@$when" -C "$out" -cf - "$name" | gzip -n9 > "$out/$name.tar.gz"
(cd "$out" && sha256sum "$name.tar.gz" | tee "$name.tar.gz.sha256")

"$program" --version
echo "needs glibc $(objdump -T "$program" | grep -o 'GLIBC_[0-9.]*' | sort -Vu | tail -1 | cut -d_ -f2) or newer, and these libraries:" $needed
