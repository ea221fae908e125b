#!/usr/bin/env python3
"""A satellite receiver of u-blox as pyubx2 encodes it, at the other end of a pseudo terminal or behind a TCP port: answers orders
(CFG-RATE and CFG-MSG, or with `newer` CFG-VALSET alone) and then sends solutions. Its first line says where it is. A line on
standard input changes what it does: {"silent": true}, {"fix": 0}, {"noise": true}, {"hang_up": true},
{"vanish": true}: the converter neither hears nor says anything on the connection that it has, as if it had been switched off, and takes
another one."""

import json
import math
import os
import select
import socket
import sys
import time
import tty

from pyubx2 import GET, SET, UBXMessage, UBXReader

LATITUDE, LONGITUDE, ALTITUDE = -34.046605, 18.7402978, 160.25


def answer(message, granted):
    kind = "ACK-ACK" if granted else "ACK-NAK"
    return UBXMessage("ACK", kind, GET, clsID=message.msg_cls[0], msgID=message.msg_id[0]).serialize()


def solution(itow, fix):
    return UBXMessage(
        "NAV", "NAV-PVT", GET,
        iTOW=itow, year=2026, month=6, day=1, validDate=1, validTime=1, fullyResolved=1, fixType=fix, gnssFixOk=1 if fix else 0, numSV=11,
        lon=LONGITUDE, lat=LATITUDE, height=int((ALTITUDE + 32) * 1000), hMSL=int(ALTITUDE * 1000), hAcc=1500, vAcc=2500,
        velN=21900, velE=-400, velD=120, gSpeed=21904, headMot=358.9, sAcc=150, headAcc=1.0, pDOP=1.5,
    ).serialize()


def main():
    newer = "newer" in sys.argv[2:]
    listener = None
    if sys.argv[1] == "tcp":
        listener = socket.create_server(("127.0.0.1", 0))
        place = "tcp:127.0.0.1:%d" % listener.getsockname()[1]
        line = None
    else:
        line, far = os.openpty()
        tty.setraw(far)
        place = os.ttyname(far)
        os.chmod(place, 0o666)  # the driver is another user
    print(json.dumps({"listening": place}), flush=True)
    state = {"silent": False, "fix": 3, "noise": False}
    period, granted, asked, sent, received, vanished = None, set(), [], 0, b"", []
    begun = time.monotonic()
    next_at = begun
    while True:
        watched = [sys.stdin] + ([line] if line is not None else [listener])
        ready, _, _ = select.select(watched, [], [], 0.01)
        if sys.stdin in ready:
            text = sys.stdin.readline()
            if not text:
                break
            state.update(json.loads(text))
            if state.pop("hang_up", False) and listener is not None:
                os.close(line)
                line, period, granted = None, None, set()
            if state.pop("vanish", False) and listener is not None:
                vanished.append(line)  # not closed: the other side is told nothing
                line, granted, received = None, set(), b""
        if line is None:
            if listener in ready:
                line = listener.accept()[0].detach()
            continue
        if line in ready:
            try:
                came = os.read(line, 4096)
            except OSError:
                came = b""
            if not came and listener is not None:  # the module has ended; a converter waits for the next one
                line, granted, received = None, set(), b""
                continue
            received += came
            while len(received) >= 8 and len(received) >= 8 + int.from_bytes(received[4:6], "little"):
                length = 8 + int.from_bytes(received[4:6], "little")
                message = UBXReader.parse(received[:length], msgmode=SET)
                received = received[length:]
                asked.append(message.identity)
                is_newer = message.identity == "CFG-VALSET"
                # As a u-blox M10: it has neither USB nor a second serial port, and refuses an order that names one.
                lacks = any(hasattr(message, "CFG_MSGOUT_UBX_NAV_PVT_" + port) for port in ("USB", "UART2"))
                takes = is_newer == newer and not lacks
                os.write(line, answer(message, takes))
                if takes:
                    granted.add(message.identity)
                if message.identity == "CFG-RATE" and not newer:
                    period = message.measRate / 1000
                if is_newer and takes:
                    period = message.CFG_RATE_MEAS / 1000
        wanted = {"CFG-VALSET"} if newer else {"CFG-RATE", "CFG-MSG"}
        now = time.monotonic()
        if granted >= wanted and now >= next_at and not state["silent"]:
            next_at = max(next_at + period, now - period)
            data = solution(int(345600000 + (now - begun) * 1000), state["fix"])
            data = b"$GNGGA,noise*00\r\n" + (b"\xb5b\x01\x07\xff\x03" if state["noise"] else b"") + data
            try:
                os.write(line, data)
            except OSError:  # as above
                if listener is not None:
                    line, granted = None, set()
            sent += 1
    print(json.dumps({"sent": sent, "asked": sorted(set(asked)), "period": period, "uptime": math.floor(time.monotonic() - begun)}), flush=True)


main()
