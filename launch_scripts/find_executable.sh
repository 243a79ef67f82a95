# shellcheck shell=bash
# Sourced by the other scripts. Finds the executables: in the folder that was given, else in the checkout's target/release, else on PATH.

# find_executable NAME PREFIX: prints the path; PREFIX may be empty. Fails with a message when there is none.
find_executable() {
  local name=$1 prefix=$2 built
  built=$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)/target/release
  if [ -n "$prefix" ]; then
    if [ -x "$prefix/$name" ]; then
      (cd "$prefix" && echo "$PWD/$name")
      return
    fi
    echo "$(basename "$0"): there is no executable $name in $prefix" >&2
    return 1
  fi
  if [ -x "$built/$name" ]; then
    echo "$built/$name"
  elif ! type -P "$name"; then
    echo "$(basename "$0"): there is no executable $name in $built or on PATH: run cargo build --release --workspace" >&2
    return 1
  fi
}
