#!/usr/bin/env python3
"""A ground station on MAVLink that falls silent in flight, hears on, and speaks again; what the aircraft did, as one line of JSON.

Usage: silence.py SIMULATOR, as flight.py."""

import json
import math
import sys

from flight import CORNERS, METRES_A_DEGREE, take_off
from ground import RUNWAY, Ground

REACHED_BEFORE = 2
LOST_S = 90.0  # module time in which it flies by itself
JUDGED_S = 30.0  # the last part of that, when it has come back


def distance_m(position):
    north = (position.lat * 1e-7 - RUNWAY[0]) * METRES_A_DEGREE[0]
    east = (position.lon * 1e-7 - RUNWAY[1]) * METRES_A_DEGREE[1]
    return math.hypot(north, east)


def main():
    ground = Ground()
    print(json.dumps({"listening": ground.address}), flush=True)
    ground.answers_beats = True
    said = take_off(ground, sys.argv[1])
    reached = 0
    while reached < REACHED_BEFORE and ground.hear("MISSION_ITEM_REACHED", seconds=60.0):
        reached += 1
    said["reached"] = reached
    ground.answers_beats = False
    is_lost = lambda message: "not heard" in message.text
    said["told"] = ground.hear("STATUSTEXT", seconds=60.0, where=is_lost) is not None
    begun = ground.hear("GLOBAL_POSITION_INT").time_boot_ms
    passed, distances = [], []
    while True:
        message = ground.hear(["GLOBAL_POSITION_INT", "MISSION_ITEM_REACHED"], seconds=30.0)
        if message is None:
            break
        if message.get_type() == "MISSION_ITEM_REACHED":
            passed.append(message.seq)
            continue
        since_s = 1e-3 * (message.time_boot_ms - begun)
        if since_s > LOST_S:
            break
        if since_s > LOST_S - JUDGED_S:
            distances.append(distance_m(message))
    said["passed_while_lost"] = passed
    said["distances_m"] = [min(distances, default=None), max(distances, default=None)]
    ground.answers_beats = True
    heard_again = lambda message: "heard again" in message.text
    said["heard_again"] = ground.hear("STATUSTEXT", seconds=60.0, where=heard_again) is not None
    said["texts"] = ground.texts
    print(json.dumps(said), flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main()
