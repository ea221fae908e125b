#!/usr/bin/env python3
"""A whole flight by MAVLink alone: HIL mode, calibration, mission, take-off, two laps, and what was heard of them as one line of JSON.

Usage: flight.py [SIMULATOR]. The first line says where the aircraft has to send. SIMULATOR is the address of this project's
simulator, whose safety pilot takes off on NAV_TAKEOFF; without it, somebody has to."""

import json
import socket
import sys
import time

from pymavlink import mavutil

from ground import RUNWAY, Ground, mavlink, waypoint

HIL, AUTO, ARMED = mavlink.MAV_MODE_FLAG_HIL_ENABLED, mavlink.MAV_MODE_FLAG_AUTO_ENABLED, mavlink.MAV_MODE_FLAG_SAFETY_ARMED
AHRS = mavlink.MAV_SYS_STATUS_AHRS
ENGAGE_M = 60.0
LAPS = 2
# The corners of a square of 500 m, north and east of the runway, m.
CORNERS = [(500.0, 0.0), (500.0, 500.0), (0.0, 500.0), (0.0, 0.0)]
METRES_A_DEGREE = (110_922.0, 92_384.0)  # of latitude and longitude, there


def until_accepted(ground, command, *values, tries=60):
    """Gives a command again until it is taken: a function may not be ready yet."""
    for _ in range(tries):
        if ground.command(command, *values) == mavlink.MAV_RESULT_ACCEPTED:
            return True
        ground.hear(seconds=0.2)
    return False


def call_pilot(address):
    """Lets the simulated safety pilot take off; over UDP, so again until he has heard it."""
    host, port = address.rsplit(":", 1)
    words = mavlink.MAVLink(None, srcSystem=255, srcComponent=190)
    message = words.command_long_encode(0, 0, mavlink.MAV_CMD_NAV_TAKEOFF, 0, 0, 0, 0, 0, 0, 0, 0).pack(words)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as line:
        line.settimeout(0.2)
        for _ in range(20):
            line.sendto(message, (host, int(port)))
            try:
                line.recv(512)
                return True
            except socket.timeout:
                pass
    return False


def take_off(ground, simulator=None):
    """Everything until the autopilot has the aircraft, and what came of it."""
    said = {"heard": ground.hear("HEARTBEAT", seconds=60.0) is not None}
    said["hil"] = until_accepted(ground, mavlink.MAV_CMD_DO_SET_MODE, HIL)
    said["calibrated"] = until_accepted(ground, mavlink.MAV_CMD_PREFLIGHT_CALIBRATION, 1, 0, 1)
    said["laps"] = ground.set_parameter("CTL_LAPS", LAPS, mavlink.MAV_PARAM_TYPE_INT32)
    latitude, longitude = RUNWAY
    items = [waypoint(latitude + north / METRES_A_DEGREE[0], longitude + east / METRES_A_DEGREE[1], 160.0) for north, east in CORNERS]
    said["uploaded"] = ground.upload(items)
    ready = ground.hear("SYS_STATUS", seconds=60.0, where=lambda message: message.onboard_control_sensors_health & AHRS)
    said["ready"] = ready is not None
    said["auto"] = until_accepted(ground, mavlink.MAV_CMD_DO_SET_MODE, HIL | AUTO)
    said["pilot"] = call_pilot(simulator) if simulator else None
    climbing = ground.hear("GLOBAL_POSITION_INT", seconds=120.0, where=lambda message: message.relative_alt > 1e3 * ENGAGE_M and message.vz < 0)
    said["engaged_at"] = climbing and climbing.relative_alt * 1e-3
    said["armed"] = until_accepted(ground, mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    return said


def main():
    ground = Ground()
    print(json.dumps({"listening": ground.address}), flush=True)
    said = take_off(ground, *sys.argv[1:2])
    reached, heights, landed = [], [], set()
    end = time.monotonic() + 600.0
    while time.monotonic() < end and "the laps are flown" not in ground.texts:
        message = ground.hear(["MISSION_ITEM_REACHED", "GLOBAL_POSITION_INT", "EXTENDED_SYS_STATE", "STATUSTEXT"], seconds=5.0)
        if message is None:
            break
        kind = message.get_type()
        if kind == "MISSION_ITEM_REACHED":
            reached.append(message.seq)
        elif kind == "GLOBAL_POSITION_INT" and len(reached) > 2:
            heights.append(message.relative_alt * 1e-3)
        elif kind == "EXTENDED_SYS_STATE":
            landed.add(message.landed_state)
    said["reached"] = reached
    said["heights"] = [min(heights, default=0.0), max(heights, default=0.0)]
    said["landed_states"] = sorted(landed)
    said["mode"] = ground.latest["HEARTBEAT"].base_mode
    said["texts"] = ground.texts
    print(json.dumps(said), flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main()
