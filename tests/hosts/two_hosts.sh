#!/usr/bin/env bash
# Two hosts on one machine: two network namespaces joined by a veth pair, as two computers on one switch.
# usage: two_hosts.sh    needs root. Prints the names of the two namespaces on a line, keeps them until its stdin ends or it is signalled.
# Run a command on a host by: ip netns exec NAME COMMAND
set -euo pipefail

first=patchmill_$$_a second=patchmill_$$_b
remove() {
  trap - EXIT INT TERM
  for name in "$first" "$second"; do
    ip netns del "$name" 2>/dev/null || true
  done
}
trap remove EXIT
trap 'exit 1' INT TERM

refused() {
  echo "two_hosts.sh: network namespaces cannot be made here ($*): run as root, in a container with CAP_SYS_ADMIN and CAP_NET_ADMIN" >&2
  exit 1
}

command -v ip >/dev/null || refused "there is no ip command: package iproute2"
for name in "$first" "$second"; do
  message=$(ip netns add "$name" 2>&1) || refused "$message"
done
message=$(ip -n "$first" link add lan type veth peer name lan netns "$second" 2>&1) || refused "$message"
number=0
for name in "$first" "$second"; do
  number=$((number + 1))
  ip -n "$name" addr add "10.77.0.$number/24" dev lan
  ip -n "$name" link set lo up
  ip -n "$name" link set lo multicast on
  ip -n "$name" link set lan up
  # As on any host with a router: multicast without an interface of its own goes out on the network.
  ip -n "$name" route add default dev lan
done
echo "$first $second"
# Until whoever started this is done or gone.
cat >/dev/null
