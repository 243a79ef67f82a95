#!/usr/bin/env bash
# Records every topic of a running stack into a new bag until SIGINT or SIGTERM.
usage="usage: record.sh DIR [--namespace /NAME] [--params FILE] [--domain N] [--prefix DIR] [--print]
  DIR: folder of the bag; must not exist or be empty. The options are those of bringup.sh."
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=launch_scripts/find_executable.sh
source "$here/find_executable.sh"

fail() { echo "record.sh: $*" >&2; exit 2; }

directory='' namespace=/patchmill params=$here/config/patchmill.yaml prefix='' print=''
while [ $# -gt 0 ]; do
  case $1 in
    --help | -h) echo "$usage"; exit 0 ;;
    --print) print='echo'; shift; continue ;;
    --namespace | --params | --domain | --prefix) [ $# -ge 2 ] || fail "$1 needs a value" ;;
    -*) fail "unknown argument '$1'"$'\n'"$usage" ;;
    *) [ -z "$directory" ] || fail "one folder was expected"; directory=$1; shift; continue ;;
  esac
  case $1 in
    --namespace) namespace=$2 ;;
    --params) params=$2 ;;
    --domain) export ROS_DOMAIN_ID=$2 ;;
    --prefix) prefix=$2 ;;
  esac
  shift 2
done
[ -n "$directory" ] || fail "the bag's folder is missing"$'\n'"$usage"
[ -f "$params" ] || fail "there is no parameter file $params"
recorder=$(find_executable bag_recorder "$prefix")
exec $print "$recorder" --ros-args -r __node:=bag_recorder -r "__ns:=$namespace" --params-file "$params" -p "directory:=$directory"
