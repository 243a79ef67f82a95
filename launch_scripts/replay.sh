#!/usr/bin/env bash
# Feeds a recorded run into live nodes and compares what they give with what was recorded.
usage="usage: replay.sh BAG --from STAGE [--domain N] [other options of patchmill replay] [--prefix DIR] [--print]
  --prefix  folder of the executables; default target/release of this checkout, else PATH
  --print   print what would run"
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=launch_scripts/find_executable.sh
source "$here/find_executable.sh"

prefix='' print=''
arguments=()
while [ $# -gt 0 ]; do
  case $1 in
    --help | -h) echo "$usage"; exit 0 ;;
    --print) print='echo'; shift ;;
    --prefix) [ $# -ge 2 ] || { echo "replay.sh: --prefix needs a value" >&2; exit 2; }; prefix=$2; shift 2 ;;
    *) arguments+=("$1"); shift ;;
  esac
done
[ ${#arguments[@]} -gt 0 ] || { echo "$usage" >&2; exit 2; }
patchmill=$(find_executable patchmill "$prefix")
exec $print "$patchmill" replay "${arguments[@]}"
