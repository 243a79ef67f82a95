"""Counts words in the RTPS datagrams of a ROS domain on the loopback: what anybody reads there who may capture packets. Needs CAP_NET_RAW.

usage: wire.py DOMAIN WORD...    says `ready`, captures until its stdin ends, and prints one JSON document
"""

import json
import select
import socket
import sys

ETHERTYPE_IP, UDP, SENT_BY_US = 0x0800, 17, 4


def main():
    domain, words = int(sys.argv[1]), [word.encode() for word in sys.argv[2:]]
    ports = range(7400 + 250 * domain, 7400 + 250 * (domain + 1))
    capture = socket.socket(socket.AF_PACKET, socket.SOCK_DGRAM, socket.htons(ETHERTYPE_IP))
    capture.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 24)
    capture.bind(("lo", 0))
    print("ready", flush=True)
    datagrams, found = 0, dict.fromkeys(sys.argv[2:], 0)
    while True:
        readable, _, _ = select.select([capture, sys.stdin], [], [])
        if sys.stdin in readable and not sys.stdin.readline():
            break
        if capture not in readable:
            continue
        packet, address = capture.recvfrom(1 << 16)
        header = (packet[0] & 15) * 4
        port = int.from_bytes(packet[header + 2 : header + 4], "big")
        # On the loopback every packet is seen twice: sent and received.
        if address[2] == SENT_BY_US or packet[9] != UDP or port not in ports or packet[header + 8 : header + 12] != b"RTPS":
            continue
        datagrams += 1
        for word in words:
            found[word.decode()] += word in packet
    print(json.dumps({"datagrams": datagrams, "found": found}), flush=True)


main()
