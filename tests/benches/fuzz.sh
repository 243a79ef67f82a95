#!/usr/bin/env bash
# Feeds mutated inputs to every parser, COUNT to each, and prints a JSON line a parser: inputs, finds, the slowest one and the most memory.
# A million each takes about an hour on two cores (STEP faces, which are meshed, get a hundredth). Finds are kept in target/fuzz.
# usage: fuzz.sh [COUNT [SEED]]    default: 1000000 1; exits non-zero when something was found
set -euo pipefail
cd "$(dirname "$0")/../.."
count=${1:-1000000}
seed=${2:-1}
cargo build --release -p patchmill_tests --example fuzz_parsers
fuzz=$PWD/target/release/examples/fuzz_parsers
lines=$(mktemp)
trap 'rm -f "$lines"' EXIT
# A parser that asks for more address space than that dies, which is a find.
ulimit -v 16000000
one() {
  case $1 in step_mesh) "$fuzz" "$1" $(( $2 / 100 )) --seed "$3" ;; *) "$fuzz" "$1" "$2" --seed "$3" ;; esac
}
export -f one
export fuzz
"$fuzz" list | xargs -P 2 -I NAME bash -c "one NAME $count $seed" | tee "$lines"
[ "$(wc -l < "$lines")" = "$("$fuzz" list | wc -l)" ] && ! grep -q '"number"' "$lines"
