#!/usr/bin/env python3
"""A simulator that owes nothing to this project but the page docs/src/hil.md, written with pymavlink.

An aircraft stands on the runway and looks east. The program listens, says where as one line of JSON, exchanges HIL messages with the
flight computer that comes, and ends with its standard input, saying what it saw as another line.
"""

import argparse
import json
import random
import select
import socket
import sys

from pymavlink.dialects.v20 import common as mavlink

FIELD_NED_GAUSS = (0.09584, -0.04861, -0.22624)
LATITUDE_DEG, LONGITUDE_DEG, ALTITUDE_M = -34.0466050, 18.7402978, 0.0
ALL_FIELDS = 0x1FFF
SYSTEM, COMPONENT = 51, 7


def arguments():
    parser = argparse.ArgumentParser()
    parser.add_argument("--transport", choices=["udp", "tcp"], required=True)
    parser.add_argument("--lose", type=float, default=0.0, help="share of questions, and of answers, that are lost")
    parser.add_argument("--own-steps-ms", type=int, default=0, help="advance by steps of one's own, on a clock of one's own")
    parser.add_argument("--hostile", action="store_true", help="send what must not be believed beside each answer")
    parser.add_argument("--version", type=int, choices=[1, 2], default=2, help="of the protocol")
    parser.add_argument("--hang-up-after", type=int, default=0, help="answers after which the connection is closed once")
    parser.add_argument("--without", type=lambda word: int(word, 0), default=0, help="fields_updated bits that are never set")
    return parser.parse_args()


class Aircraft:
    """Stands still; knows what it was told last."""

    def __init__(self, options):
        self.options = options
        self.encoder = mavlink.MAVLink(None, srcSystem=SYSTEM, srcComponent=COMPONENT)
        self.own_us = 1_600_000_000_000_000
        self.fix_us = 0
        self.answer_to = None
        self.answer = b""

    def pack(self, message):
        # The connection numbers the messages; pack() alone does not.
        data = message.pack(self.encoder, force_mavlink1=self.options.version == 1)
        self.encoder.seq = (self.encoder.seq + 1) % 256
        return data

    def time_us(self, asked_us):
        if self.options.own_steps_ms:
            self.own_us += 1000 * self.options.own_steps_ms
            return self.own_us
        return asked_us

    def sensors(self, time_us, **changes):
        north, east, down = FIELD_NED_GAUSS
        values = dict(
            time_usec=time_us,
            xacc=0.0, yacc=0.0, zacc=-9.797,
            xgyro=0.0, ygyro=0.0, zgyro=0.0,
            xmag=east, ymag=-north, zmag=down,
            abs_pressure=1013.25, diff_pressure=0.0, pressure_alt=0.0, temperature=15.0,
            fields_updated=ALL_FIELDS & ~self.options.without,
        )
        values.update(changes)
        return mavlink.MAVLink_hil_sensor_message(**values)

    def fix(self, time_us):
        return mavlink.MAVLink_hil_gps_message(
            time_usec=time_us, fix_type=3,
            lat=round(LATITUDE_DEG * 1e7), lon=round(LONGITUDE_DEG * 1e7), alt=round(ALTITUDE_M * 1e3),
            eph=150, epv=250, vel=0, vn=0, ve=0, vd=0, cog=65535, satellites_visible=14,
        )

    def sticks(self, time_us):
        return mavlink.MAVLink_hil_rc_inputs_raw_message(
            time_usec=time_us, chan1_raw=1520, chan2_raw=1480, chan3_raw=1100, chan4_raw=1510,
            chan5_raw=65535, chan6_raw=65535, chan7_raw=65535, chan8_raw=65535,
            chan9_raw=65535, chan10_raw=65535, chan11_raw=65535, chan12_raw=65535, rssi=255,
        )

    def respond(self, asked_us):
        """The answer to a question; the same bytes when the same question comes again."""
        if asked_us == self.answer_to and not self.options.own_steps_ms:
            return self.answer
        time_us = self.time_us(asked_us)
        parts = []
        if time_us - self.fix_us >= 200_000:
            self.fix_us = time_us
            parts.append(self.pack(self.fix(time_us)))
        parts.append(self.pack(self.sticks(time_us)))
        parts.append(self.pack(self.sensors(time_us)))
        self.answer_to, self.answer = asked_us, b"".join(parts)
        return self.answer

    def hostility(self, asked_us, number):
        """Datagrams that must not be believed: one of each kind, in turn."""
        bad = bytearray(self.pack(self.sensors(asked_us, xgyro=5.0)))
        bad[20] ^= 0x55
        stranger = mavlink.MAVLink(None, srcSystem=99, srcComponent=1)
        foreign = self.sensors(asked_us, xgyro=5.0).pack(stranger)
        # No gyroscope says this; the bits say that it is new.
        nonsense = self.pack(self.sensors(max(asked_us - 5_000, 0), xgyro=float("nan"), zacc=float("inf")))
        future = self.pack(self.sensors(asked_us + 3_600_000_000, xgyro=5.0))
        old = self.pack(self.sensors(max(asked_us - 400_000, 0), xgyro=5.0))
        unknown = bytearray(foreign)
        unknown[7:10] = b"\xf0\xff\x7f"
        half = bytes(foreign[:25])
        chatter = self.pack(mavlink.MAVLink_heartbeat_message(2, 8, 0, 0, 4, 3))
        empty = self.pack(self.sensors(max(asked_us - 4_000, 0), fields_updated=0, xgyro=5.0))
        kinds = [bytes(bad), foreign, nonsense, future, old, bytes(unknown), half, chatter, empty, b"garbage", b""]
        return kinds[number % len(kinds)]


class Seen:
    """What came from the flight computer."""

    def __init__(self):
        self.decoder = mavlink.MAVLink(None)
        self.decoder.robust_parsing = True
        self.report = dict(
            questions=0, repeated=0, heartbeats=0, other=0, bad=0, systems=[], flags=[], modes=[],
            least_control=1.0, greatest_control=-1.0, finite=True, first_us=None, last_us=None, steps_us={}, connections=0, used=[],
        )

    def take(self, data):
        asked = []
        for message in self.decoder.parse_buffer(data) or []:
            kind = message.get_type()
            report = self.report
            if kind == "HIL_ACTUATOR_CONTROLS":
                asked.append(message.time_usec)
                self.question(message)
            elif kind == "HEARTBEAT":
                report["heartbeats"] += 1
            elif kind == "BAD_DATA":
                report["bad"] += 1
            else:
                report["other"] += 1
        return asked

    def question(self, message):
        report = self.report
        report["questions"] += 1
        for name, value in [("systems", [message.get_srcSystem(), message.get_srcComponent()]), ("flags", message.flags), ("modes", message.mode)]:
            if value not in report[name]:
                report[name].append(value)
        report["finite"] &= all(value == value and abs(value) <= 1.0 for value in message.controls)
        report["least_control"] = min([report["least_control"], *message.controls])
        report["greatest_control"] = max([report["greatest_control"], *message.controls])
        report["used"] = sorted(set(report["used"]) | {place for place, value in enumerate(message.controls) if value != 0.0})
        report["controls"] = [round(value, 6) for value in message.controls[:5]]
        if report["first_us"] is None:
            report["first_us"] = message.time_usec
        elif message.time_usec == report["last_us"]:
            report["repeated"] += 1
        else:
            step = str(message.time_usec - report["last_us"])
            report["steps_us"][step] = report["steps_us"].get(step, 0) + 1
        report["last_us"] = message.time_usec


def main():
    options = arguments()
    chance = random.Random(7)
    aircraft, seen = Aircraft(options), Seen()
    kind = socket.SOCK_DGRAM if options.transport == "udp" else socket.SOCK_STREAM
    listener = socket.socket(socket.AF_INET, kind)
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    listener.bind(("127.0.0.1", 0))
    if options.transport == "tcp":
        listener.listen()
    print(json.dumps({"listening": "%s:%d" % listener.getsockname()}), flush=True)
    client, answers = None, 0
    while True:
        watched = [sys.stdin, listener] + ([client] if client else [])
        ready = select.select(watched, [], [])[0]
        if sys.stdin in ready and not sys.stdin.readline():
            break
        data, reply = b"", None
        if listener in ready:
            if options.transport == "tcp":
                client = listener.accept()[0]
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                seen.report["connections"] += 1
                continue
            data, sender = listener.recvfrom(4096)
            reply = lambda answer: listener.sendto(answer, sender)
        elif client and client in ready:
            try:
                data = client.recv(4096)
            except ConnectionError:
                data = b""
            if not data:
                client = None
                continue
            reply = client.sendall
        for asked_us in seen.take(data):
            if chance.random() < options.lose:
                continue
            answer = aircraft.respond(asked_us)
            answers += 1
            if options.hostile and answers > 25:
                before = aircraft.hostility(asked_us, answers)
                after = aircraft.hostility(asked_us, answers + 5)
                for one in [before, answer, answer if answers % 3 == 0 else b"", after]:
                    if chance.random() >= options.lose:
                        reply(one)
            elif chance.random() >= options.lose:
                reply(answer)
            if options.hang_up_after and answers == options.hang_up_after and client:
                client.close()
                client = None
                break
    print(json.dumps(seen.report), flush=True)


if __name__ == "__main__":
    main()
