#!/usr/bin/env python3
"""What a FlightGear would be told, read by pymavlink's own reader of that format: says where it listens, and when its input closes every pose
that it has heard, as one line of JSON."""

import json
import socket
import sys
import threading

from pymavlink import fgFDM

FIELDS = ["version", "latitude", "longitude", "altitude", "agl", "phi", "theta", "psi", "vcas", "climb_rate", "v_north", "v_east", "rpm", "wow"]


def main():
    window = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    window.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 1 << 22)
    window.bind(("127.0.0.1", 0))
    window.settimeout(0.2)
    print(json.dumps({"listening": "127.0.0.1:%d" % window.getsockname()[1]}), flush=True)
    closed = threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), closed.set()), daemon=True).start()
    poses, reader = [], fgFDM.fgFDM()
    while True:
        try:
            datagram = window.recv(2048)
        except socket.timeout:
            if closed.is_set():
                break
            continue
        reader.parse(datagram)
        poses.append([reader.get(field) for field in FIELDS] + [len(datagram)])
    print(json.dumps({"fields": FIELDS + ["bytes"], "poses": poses}), flush=True)


if __name__ == "__main__":
    main()
