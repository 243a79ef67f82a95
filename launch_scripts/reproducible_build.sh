#!/usr/bin/env bash
# Builds the release binaries of the last commit twice, from scratch and in folders of different names, and compares them byte by byte.
# Takes twice as long as a build. Exits non-zero when one differs.
# usage: reproducible_build.sh [PACKAGE...]    default: all packages of the workspace
set -euo pipefail
cd "$(dirname "$0")/.."
root=$PWD
packages=(--workspace)
if [ $# -gt 0 ]; then packages=(); for name in "$@"; do packages+=(-p "$name"); done; fi
# mimalloc's C names the time when it was compiled.
SOURCE_DATE_EPOCH=$(git log -1 --format=%ct)
export SOURCE_DATE_EPOCH
revision=$(git rev-parse HEAD)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

sums() { # FOLDER: name and sha256 of every binary built
  (cd "$1/target/release" && find . -maxdepth 1 -type f -executable -printf '%f\n' | LC_ALL=C sort | xargs sha256sum)
}
for folder in first the_second; do
  git clone -q "$root" "$scratch/$folder"
  git -C "$scratch/$folder" checkout -q --detach "$revision"
  # What a compiler writes of places on the disk: the sources' folder, and that of the crates.
  home=${CARGO_HOME:-$HOME/.cargo}
  (cd "$scratch/$folder" && \
    RUSTFLAGS="--remap-path-prefix=$PWD=/patchmill --remap-path-prefix=$home=/cargo" \
    CFLAGS="-ffile-prefix-map=$PWD=/patchmill -ffile-prefix-map=$home=/cargo" \
    cargo build --release --locked --bins "${packages[@]}")
  sums "$scratch/$folder" > "$scratch/$folder.sums"
done
if ! diff "$scratch/first.sums" "$scratch/the_second.sums"; then
  echo "reproducible_build.sh: these binaries differ from build to build (sha256 above, < first, > second)" >&2
  exit 1
fi
cat "$scratch/first.sums"
echo "the same, byte by byte, in two builds with $(rustc --version)"
