#!/usr/bin/env python3
"""A node on a CAN bus, on python-can: opens a bus by one of that library's own interfaces, says so, sends frames, hears some, and
tells which as one line of JSON."""

import argparse
import json
import sys
import time

import can


def arguments():
    parser = argparse.ArgumentParser()
    parser.add_argument("--interface", choices=["socketcand", "slcan"], required=True)
    parser.add_argument("--channel", required=True)
    parser.add_argument("--port", type=int, default=0)
    parser.add_argument("--expect", type=int, required=True, help="frames to hear")
    return parser.parse_args()


def open_bus(options):
    if options.interface == "socketcand":
        return can.Bus(interface="socketcand", host="127.0.0.1", port=options.port, channel=options.channel)
    return can.Bus(interface="slcan", channel=options.channel, bitrate=500000, sleep_after_open=0.2)


def main():
    options = arguments()
    with open_bus(options) as bus:
        print(json.dumps({"open": True}), flush=True)
        for line in sys.stdin:
            frame = json.loads(line)
            if frame is None:
                break
            bus.send(can.Message(arbitration_id=frame["id"], is_extended_id=frame["extended"], data=frame["data"]))
        heard, end = [], time.monotonic() + 60.0
        while len(heard) < options.expect and time.monotonic() < end:
            message = bus.recv(timeout=0.5)
            if message is not None:
                heard.append({"id": message.arbitration_id, "extended": message.is_extended_id, "data": list(message.data)})
        print(json.dumps({"heard": heard}), flush=True)


if __name__ == "__main__":
    main()
