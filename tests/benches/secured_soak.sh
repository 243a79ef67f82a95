#!/usr/bin/env bash
# Plans one after the other with SROS2, a new stack each, and prints a line a plan and a summary. A plan is right when it ends well, says
# nothing on stderr, and its folder has the files of a plan without SROS2 and the same program. What failed is kept in target/secured_soak.
# usage: secured_soak.sh [PLANS [BUSY]]    PLANS: how many, default 60; BUSY: processes that do nothing but keep the processors busy
#                                          beside them, default one a processor; exits non-zero when a plan failed
# Needs what launch_scripts/test_security.sh needs to build.
set -euo pipefail
cd "$(dirname "$0")/../.."
plans=${1:-60} busy=${2:-$(nproc)}
[[ $plans =~ ^[1-9][0-9]*$ && $busy =~ ^[0-9]+$ ]] || { echo "secured_soak.sh: expected whole numbers: [PLANS [BUSY]]" >&2; exit 2; }
# Of one plan, nodes that are waited for included; more is a failure.
patience=120
cargo build --release --workspace --features security --target-dir target/security
patchmill=$PWD/target/security/release/patchmill
kept=$PWD/target/secured_soak
rm -rf "$kept"
mkdir -p "$kept"
scratch=$(mktemp -d) loops=()
trap 'kill "${loops[@]}" 2>/dev/null || true; rm -rf "$scratch"' EXIT
bash launch_scripts/keystore.sh "$scratch/keys" >/dev/null
export ROS_SECURITY_STRATEGY=Enforce ROS_SECURITY_KEYSTORE=$scratch/keys
unset ROS_SECURITY_ENCLAVE_OVERRIDE

# A plan of the smallest fixture: whether with SROS2, and its folder.
plan() {
  ROS_SECURITY_ENABLE=$1 timeout --kill-after 5 $patience "$patchmill" plan tests/fixtures/small_bezier.json --strategy rolling-ball \
    --patches 1..2 --out "$2/plan" >"$2/stdout" 2>"$2/stderr"
}
files() { (cd "$1/plan" 2>/dev/null && find . -type f | LC_ALL=C sort); }

# What is wrong with a plan, given its exit code and folder; nothing when it is right.
faults() {
  [ "$1" = 0 ] || echo "exit code $1"
  diff <(files "$scratch/open") <(files "$2") | sed -n 's/^< /missing: /p; s/^> /not expected: /p'
  [ "$1" != 0 ] || cmp -s {"$scratch/open","$2"}/plan/program.ngc || echo "another program"
  tail -n 1 "$2/stderr"
}

mkdir "$scratch/open"
plan false "$scratch/open" || { echo "secured_soak.sh: no plan without SROS2: $(cat "$scratch/open/stderr")" >&2; exit 1; }
for _ in $(seq "$busy"); do
  while :; do :; done &
  loops+=($!)
done
right=0 times=()
for i in $(seq "$plans"); do
  folder=$kept/$i
  mkdir "$folder"
  begin=$(date +%s%N) code=0
  plan true "$folder" || code=$?
  hundredths=$((($(date +%s%N) - begin) / 10000000))
  seconds=$((hundredths / 100)).$(printf %02d $((hundredths % 100)))
  times+=("$seconds")
  said=$(faults "$code" "$folder" | paste -sd ';')
  if [ -z "$said" ]; then
    right=$((right + 1))
    rm -rf "$folder"
    echo "$i: right, $seconds s"
  else
    echo "$i: FAILED, $seconds s: $said"
  fi
done
mapfile -t sorted < <(printf '%s\n' "${times[@]}" | sort -n)
echo "$right of $plans plans right, $busy busy processes on $(nproc) processors; seconds: ${sorted[0]} / ${sorted[$((plans / 2))]} / ${sorted[-1]} (least, median, most)"
[ "$right" = "$plans" ]
