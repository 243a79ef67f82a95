"""Sends what DDS participants of this host announce by multicast to another host's discovery ports, which were never announced to anybody here:
what a host of the network can do that knows how RTPS numbers its ports.

usage: relay.py INTERFACE_ADDRESS HOST DOMAIN    says `ready` once it has heard an announcement, goes on until its stdin ends, and prints
how many datagrams somebody at HOST was listening for
"""

import select
import socket
import sys
import time

GROUP = "239.255.0.1"


def main():
    own, host, first_port = sys.argv[1], sys.argv[2], 7400 + 250 * int(sys.argv[3])
    hears = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    hears.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    hears.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
    hears.bind((GROUP, first_port))
    hears.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, socket.inet_aton(GROUP) + socket.inet_aton(own))
    hears.settimeout(30)
    announcement = hears.recv(1 << 16)
    print("ready", flush=True)
    ports = []
    for participant in range(4):
        port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        port.connect((host, first_port + 10 + 2 * participant))
        ports.append(port)
    taken = 0
    while not select.select([sys.stdin], [], [], 0)[0]:
        for port in ports:
            try:
                port.send(announcement)
                time.sleep(0.01)
                # Where nobody listens the host has said so by now.
                taken += port.getsockopt(socket.SOL_SOCKET, socket.SO_ERROR) == 0
            except ConnectionRefusedError:
                pass
    print(taken, flush=True)


main()
