#!/usr/bin/env bash
# Records the golden bag of the replay tests anew. Run it only when a change is meant to change what a stage gives, and say so in the commit.
set -euo pipefail
cd "$(dirname "$0")/.."
out=$(mktemp -d)
trap 'rm -rf "$out"' EXIT
cargo run --release -- plan tests/fixtures/small_bezier.json --out "$out/plan" --strategy rolling-ball --patches 1..2 --tool r1=6.7,r2=6,length=100
rm -rf tests/golden/small_bezier
mkdir -p tests/golden
cp -r "$out/plan/bag" tests/golden/small_bezier
du -sh tests/golden/small_bezier
