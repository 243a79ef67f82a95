#!/usr/bin/env bash
# Holds nodes/node_runtime/rustdds against the published crate: with rustdds.patch taken back, every file is that of rustdds 0.15.1.
# The recorded sum is of the published crate: (find src LICENSE.md README.md -type f | LC_ALL=C sort | xargs sha256sum) | sha256sum
set -euo pipefail
cd "$(dirname "$0")/../nodes/node_runtime/rustdds"
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
cp -r src LICENSE.md README.md "$scratch"
patch=$PWD/rustdds.patch
(cd "$scratch" && GIT_CEILING_DIRECTORIES=$(dirname "$scratch") git apply -R "$patch")
found=$(cd "$scratch" && find src LICENSE.md README.md -type f | LC_ALL=C sort | xargs sha256sum | sha256sum | cut -d' ' -f1)
if [ "$found" != "$(cat published.sha256)" ]; then
  echo "check_rustdds.sh: nodes/node_runtime/rustdds is not rustdds 0.15.1 with rustdds.patch" >&2
  exit 1
fi
