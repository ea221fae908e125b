#!/usr/bin/env python3
"""A ground station on pymavlink: hears an aircraft, asks and orders what QGroundControl does, and tells what came of it as one
line of JSON. Listens where its first line says, and begins with the aircraft's first heartbeat."""

import json
import socket
import struct
import sys
import time

from pymavlink import mavutil

mavlink = mavutil.mavlink
RUNWAY = (-34.0466050, 18.7402978)


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


class Ground:
    def __init__(self):
        port = free_port()
        self.line = mavutil.mavlink_connection("udpin:127.0.0.1:%d" % port, source_system=255, source_component=190)
        self.address = "127.0.0.1:%d" % port
        self.texts, self.kinds, self.latest = [], {}, {}
        self.answers_beats = False  # a heartbeat for each of the aircraft's: as often as module time goes

    def hear(self, wanted=None, seconds=5.0, where=lambda message: True):
        """Everything that comes, until a message of a kind `wanted` (one or a list)."""
        wanted = [wanted] if isinstance(wanted, str) else wanted or []
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            message = self.line.recv_match(blocking=True, timeout=0.1)
            if message is None:
                continue
            kind = message.get_type()
            self.kinds[kind] = self.kinds.get(kind, 0) + 1
            self.latest[kind] = message
            if kind == "HEARTBEAT" and self.answers_beats:
                self.line.mav.heartbeat_send(mavlink.MAV_TYPE_GCS, mavlink.MAV_AUTOPILOT_INVALID, 0, 0, mavlink.MAV_STATE_ACTIVE)
            if kind == "STATUSTEXT":
                self.texts.append(message.text)
            if kind in wanted and where(message):
                return message
        return None

    def command(self, command, *values):
        values = list(values) + [0.0] * (7 - len(values))
        self.line.mav.command_long_send(1, 1, command, 0, *values)
        answer = self.hear("COMMAND_ACK", where=lambda message: message.command == command)
        return None if answer is None else answer.result

    def upload(self, items, kind=mavlink.MAV_MISSION_TYPE_MISSION):
        self.line.mav.mission_count_send(1, 1, len(items), kind)
        while True:
            message = self.hear(["MISSION_REQUEST_INT", "MISSION_REQUEST", "MISSION_ACK"])
            if message is None:
                return None
            if message.get_type() == "MISSION_ACK":
                return message.type
            self.line.mav.mission_item_int_send(1, 1, message.seq, *items[message.seq], kind)

    def download(self):
        self.line.mav.mission_request_list_send(1, 1, mavlink.MAV_MISSION_TYPE_MISSION)
        count = self.hear("MISSION_COUNT")
        items = []
        for seq in range(count.count if count else 0):
            self.line.mav.mission_request_int_send(1, 1, seq, mavlink.MAV_MISSION_TYPE_MISSION)
            item = self.hear("MISSION_ITEM_INT", where=lambda message: message.seq == seq)
            items.append(None if item is None else [item.command, item.x, item.y, round(item.z, 3)])
        self.line.mav.mission_ack_send(1, 1, mavlink.MAV_MISSION_ACCEPTED, mavlink.MAV_MISSION_TYPE_MISSION)
        return items

    def parameters(self):
        self.line.mav.param_request_list_send(1, 1)
        found, count = {}, None
        while count is None or len(found) < count:
            value = self.hear("PARAM_VALUE", seconds=3.0)
            if value is None:
                break
            count = value.param_count
            found[value.param_index] = [value.param_id, number(value.param_value, value.param_type), value.param_type]
        return count, found

    def set_parameter(self, name, value, kind=mavlink.MAV_PARAM_TYPE_REAL32):
        """What stands then, and why not what was wanted."""
        sent = value if kind == mavlink.MAV_PARAM_TYPE_REAL32 else struct.unpack("<f", struct.pack("<i", value))[0]
        self.latest.pop("PARAM_ERROR", None)
        self.line.mav.param_set_send(1, 1, name.encode(), sent, kind)
        answer = self.hear("PARAM_VALUE", seconds=3.0, where=lambda message: message.param_id == name)
        error = self.latest.get("PARAM_ERROR")
        return [answer and number(answer.param_value, answer.param_type), error and error.error]


def number(value, kind):
    """The number in a parameter whose whole numbers are sent by their bits, as QGroundControl reads it."""
    if kind == mavlink.MAV_PARAM_TYPE_REAL32:
        return value
    bits = struct.pack("<f", value)
    return bits[0] if kind == mavlink.MAV_PARAM_TYPE_UINT8 else struct.unpack("<i", bits)[0]


def waypoint(latitude, longitude, altitude):
    return (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_CMD_NAV_WAYPOINT, 0, 1, 0.0, 0.0, 0.0, 0.0, round(latitude * 1e7), round(longitude * 1e7), altitude)


def corner(latitude, longitude, count):
    return (mavlink.MAV_FRAME_GLOBAL, mavlink.MAV_CMD_NAV_FENCE_POLYGON_VERTEX_INCLUSION, 0, 1, float(count), 0.0, 0.0, 0.0, round(latitude * 1e7), round(longitude * 1e7), 0.0)


def main():
    ground = Ground()
    print(json.dumps({"listening": ground.address}), flush=True)
    said = {}
    heartbeat = ground.hear("HEARTBEAT", seconds=60.0)
    if heartbeat is None:
        print(json.dumps({"heartbeat": None}), flush=True)
        return
    said["heartbeat"] = [heartbeat.get_srcSystem(), heartbeat.get_srcComponent(), heartbeat.type, heartbeat.base_mode]
    # No estimator knows anything yet.
    said["armed_too_early"] = ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 1)
    said["why_not_armed"] = list(ground.texts)
    said["version"] = ground.command(mavlink.MAV_CMD_REQUEST_MESSAGE, 148)
    said["version_heard"] = ground.hear("AUTOPILOT_VERSION", seconds=2.0) is not None or "AUTOPILOT_VERSION" in ground.kinds
    said["parachute"] = ground.command(mavlink.MAV_CMD_DO_PARACHUTE)
    count, found = ground.parameters()
    said["parameters"] = [count, sorted(found), {name: [value, kind] for name, value, kind in found.values()}]
    said["settable"] = ground.set_parameter("CMD_RATE_ATT", 20.0)
    said["out_of_range"] = ground.set_parameter("CMD_RATE_ATT", 1e9)
    said["laps"] = ground.set_parameter("CTL_LAPS", 3, mavlink.MAV_PARAM_TYPE_INT32)
    said["half_a_lap"] = ground.set_parameter("CTL_LAPS", 1.5)
    said["read_only"] = ground.set_parameter("CTL_MASS", 7.0)
    for garbage in [b"", b"hello", b"\xfd\x21\x00\x00", bytes(range(256))]:
        ground.line.write(garbage)
    said["calibrated"] = ground.command(mavlink.MAV_CMD_PREFLIGHT_CALIBRATION, 1, 0, 1)
    latitude, longitude = RUNWAY
    items = [waypoint(latitude + north, longitude + east, 160.0) for north, east in [(0.0045, 0.0), (0.0045, 0.0054), (0.0, 0.0054), (0.0, 0.0)]]
    said["uploaded"] = ground.upload(items)
    back = ground.download()
    said["came_back"] = [item is not None and item[0] == sent[1] and abs(item[1] - sent[8]) <= 1 and abs(item[2] - sent[9]) <= 1 and item[3] == sent[10] for item, sent in zip(back, items)]
    said["too_far"] = ground.upload(items[:1] + [waypoint(latitude + 2.0, longitude, 100.0)])
    said["too_many"] = ground.upload(items * 20)
    said["fence"] = ground.upload(items[:1], mavlink.MAV_MISSION_TYPE_FENCE)
    corners = [corner(latitude + north, longitude + east, 3) for north, east in [(-0.02, -0.02), (0.04, 0.0), (-0.02, 0.04)]]
    said["fenced"] = ground.upload(corners, mavlink.MAV_MISSION_TYPE_FENCE)
    said["runway_left_out"] = ground.upload([corner(latitude + north, longitude, 3) for north in (0.01, 0.02, 0.03)], mavlink.MAV_MISSION_TYPE_FENCE)
    rally = (mavlink.MAV_FRAME_GLOBAL_RELATIVE_ALT, mavlink.MAV_CMD_NAV_RALLY_POINT, 0, 1, 0.0, 0.0, 0.0, 0.0, round((latitude + 0.002) * 1e7), round(longitude * 1e7), 90.0)
    said["rally"] = ground.upload([rally], mavlink.MAV_MISSION_TYPE_RALLY)
    attitude = ground.hear("ATTITUDE", seconds=60.0)
    said["attitude"] = attitude and [attitude.roll, attitude.pitch, attitude.yaw]
    ground.hear("GLOBAL_POSITION_INT", seconds=5.0)
    position = ground.latest.get("GLOBAL_POSITION_INT")
    said["position"] = position and [position.lat * 1e-7 - latitude, position.lon * 1e-7 - longitude, position.relative_alt * 1e-3]
    ready = ground.hear("SYS_STATUS", seconds=60.0, where=lambda message: message.onboard_control_sensors_health & 0x200000)
    said["ready"] = ready is not None
    said["started"] = ground.command(mavlink.MAV_CMD_MISSION_START)
    flies = ground.hear("HEARTBEAT", seconds=6.0, where=lambda message: message.base_mode & 128)
    said["flies"] = flies and flies.base_mode
    said["disarmed"] = ground.command(mavlink.MAV_CMD_COMPONENT_ARM_DISARM, 0)
    rests = ground.hear("HEARTBEAT", seconds=6.0, where=lambda message: not message.base_mode & 128)
    said["rests"] = rests and rests.base_mode
    before = ground.kinds.get("ATTITUDE", 0)
    ground.hear(seconds=4.0)
    said["attitudes_in_4_s"] = ground.kinds.get("ATTITUDE", 0) - before
    said["kinds"] = sorted(ground.kinds)
    said["texts"] = ground.texts
    print(json.dumps(said), flush=True)
    sys.stdin.read()


if __name__ == "__main__":
    main()
