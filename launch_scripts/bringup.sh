#!/usr/bin/env bash
# Starts the nodes, a process each, and ends them together.
usage="usage: bringup.sh [--namespace /NAME] [--params FILE] [--domain N] [--only NODE,NODE] [--without NODE,NODE]
                  [--remap FROM:=TO]... [--prefix DIR] [--print]
  --namespace  of all nodes; default /patchmill
  --params     ROS 2 parameter file; default config/patchmill.yaml beside this script
  --domain     ROS domain; default ROS_DOMAIN_ID, else 0
  --only       start these nodes only; --without: all but these (both: names of config/nodes.txt, separated by commas)
  --remap      replace a topic, service or action name in all nodes; may be repeated
  --prefix     folder of the executables; default target/release of this checkout, else PATH
  --print      print what would run, a line a node, and start nothing
Nodes find each other in any order. SIGINT or SIGTERM ends all, with exit code 0. When a node ends with an error all are ended: the exit
code is that node's. A node that is ended without an error, by hand, is left out; the others go on."
set -euo pipefail
here=$(cd "$(dirname "$0")" && pwd)
# shellcheck source=launch_scripts/find_executable.sh
source "$here/find_executable.sh"

fail() { echo "bringup.sh: $*" >&2; exit 2; }

namespace=/patchmill params=$here/config/patchmill.yaml domain='' only='' without='' prefix='' print=''
remaps=()
while [ $# -gt 0 ]; do
  case $1 in
    --help | -h) echo "$usage"; exit 0 ;;
    --print) print=yes; shift; continue ;;
    --namespace | --params | --domain | --only | --without | --remap | --prefix) [ $# -ge 2 ] || fail "$1 needs a value" ;;
    *) fail "unknown argument '$1'"$'\n'"$usage" ;;
  esac
  case $1 in
    --namespace) namespace=$2 ;;
    --params) params=$2 ;;
    --domain) domain=$2 ;;
    --only) only=$2 ;;
    --without) without=$2 ;;
    --remap) remaps+=(-r "$2") ;;
    --prefix) prefix=$2 ;;
  esac
  shift 2
done
[ -z "$domain" ] || export ROS_DOMAIN_ID=$domain
[ -f "$params" ] || fail "there is no parameter file $params"
params=$(cd "$(dirname "$params")" && pwd)/$(basename "$params")

mapfile -t known < <(grep -v '^#' "$here/config/nodes.txt")
for name in ${only//,/ } ${without//,/ }; do
  printf '%s\n' "${known[@]}" | grep -qxF "$name" || fail "there is no node '$name': the nodes are ${known[*]}"
done
names=()
for name in "${known[@]}"; do
  if [ -n "$only" ] && [[ ,$only, != *,$name,* ]]; then continue; fi
  if [[ ,$without, == *,$name,* ]]; then continue; fi
  names+=("$name")
done
[ ${#names[@]} -gt 0 ] || fail "no node is left to start"

executables=()
for name in "${names[@]}"; do
  found=$(find_executable "$name" "$prefix")
  executables+=("$found")
done

# arguments_of NODE: sets `arguments`, as launch_ros passes them.
arguments_of() {
  arguments=(--ros-args -r "__node:=$1" -r "__ns:=$namespace" --params-file "$params")
  [ ${#remaps[@]} -eq 0 ] || arguments+=("${remaps[@]}")
}

if [ -n "$print" ]; then
  for i in "${!names[@]}"; do
    arguments_of "${names[$i]}"
    echo "${domain:+ROS_DOMAIN_ID=$domain }${executables[$i]} ${arguments[*]}"
  done
  exit 0
fi

# Lines of a node's output with its name; outlives the signals, so that nothing of the end is lost.
label() { trap '' INT TERM; exec sed -u "s/^/[$1] /" >&2; }

declare -A name_of
stopping='' failed=0

stop() {
  stopping=yes
  local pids=("${!name_of[@]}")
  [ ${#pids[@]} -eq 0 ] || kill -TERM "${pids[@]}" 2>/dev/null || true
}

# Whoever has not ended ten seconds after the signal is killed.
end_all() {
  stop
  local pid end=$((SECONDS + 10))
  while [ ${#name_of[@]} -gt 0 ] && [ $SECONDS -lt $end ]; do
    for pid in "${!name_of[@]}"; do
      kill -0 "$pid" 2>/dev/null || unset "name_of[$pid]"
    done
    [ ${#name_of[@]} -eq 0 ] || sleep 0.05
  done
  for pid in "${!name_of[@]}"; do
    echo "bringup.sh: ${name_of[$pid]} did not end within 10 s and is killed" >&2
    kill -KILL "$pid" 2>/dev/null || true
  done
  wait
}

trap stop INT TERM
for i in "${!names[@]}"; do
  arguments_of "${names[$i]}"
  "${executables[$i]}" "${arguments[@]}" > >(label "${names[$i]}") 2>&1 &
  name_of[$!]=${names[$i]}
done
echo "bringup.sh: started ${names[*]} in $namespace on ROS domain ${ROS_DOMAIN_ID:-0}; Ctrl-C ends them" >&2

while [ -z "$stopping" ] && [ ${#name_of[@]} -gt 0 ]; do
  ended='' code=0
  wait -n -p ended "${!name_of[@]}" || code=$?
  # A signal ends the wait without a process.
  [ -n "${ended:-}" ] || continue
  name=${name_of[$ended]}
  unset "name_of[$ended]"
  if [ -n "$stopping" ]; then
    continue
  elif [ "$code" -ne 0 ]; then
    echo "bringup.sh: $name ended with code $code: ending all" >&2
    failed=$code
    break
  fi
  echo "bringup.sh: $name has ended; the others go on" >&2
done
end_all
exit "$failed"
