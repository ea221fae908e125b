#!/usr/bin/env python3
"""A client of Foxglove's WebSocket protocol on somebody else's library: subscribes to every topic of the server at ADDRESS, decodes what comes
by the schemas that the server gave, and says for each topic how much that was, as one line of JSON, when its input closes.

Usage: foxglove.py ADDRESS"""

import asyncio
import collections
import json
import sys

from mcap_ros2._dynamic import generate_dynamic
from robo_ws_bridge import WebSocketBridgeClient


class Topic:
    def __init__(self, channel):
        self.channel = channel
        self.count = 0
        self.first_ns = self.last_ns = None
        self.gaps_ns = collections.Counter()
        self.last = None
        self.all = []  # of what is JSON: seldom, and small
        schema = channel["schemaName"]
        self.decode = json.loads
        if channel["encoding"] == "cdr":
            self.decode = generate_dynamic(schema, channel["schema"])[schema]

    def take(self, time_ns, payload):
        if self.last_ns is not None:
            self.gaps_ns[time_ns - self.last_ns] += 1
        else:
            self.first_ns = time_ns
        self.last_ns = time_ns
        self.count += 1
        self.last = self.decode(payload)
        if self.channel["encoding"] != "cdr":
            self.all.append(self.last)

    def said(self):
        last = self.last
        if last is not None and not isinstance(last, dict):
            last = {name: plain(getattr(last, name)) for name in last.__slots__}
        return {
            "encoding": self.channel["encoding"], "schema": self.channel["schemaName"], "count": self.count,
            "first_ns": self.first_ns, "last_ns": self.last_ns, "gaps_ns": sorted(self.gaps_ns), "last": last, "all": self.all,
        }


def plain(value):
    if hasattr(value, "__slots__"):
        return {name: plain(getattr(value, name)) for name in value.__slots__}
    if isinstance(value, (list, tuple)) or hasattr(value, "tolist"):
        return [plain(one) for one in value]
    if isinstance(value, (bytes, bytearray)):
        return list(value)
    return value


async def main():
    topics, times = {}, []

    async def advertised(channel):
        topics[channel["topic"]] = Topic(channel)
        await client.subscribe(channel["topic"])

    def came(channel, time_ns, payload):
        topics[channel["topic"]].take(time_ns, payload)

    client = WebSocketBridgeClient(sys.argv[1])
    client.on_advertised_channel(advertised)
    client.on_message(came)
    client.on_time_update(times.append)
    await client.connect()
    while client.server_info is None:
        await asyncio.sleep(0.05)
    print(json.dumps({"server": client.server_info}), flush=True)
    lines = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    while True:
        line = await lines.readline()
        said = {name: topic.said() for name, topic in topics.items()}
        print(json.dumps({"topics": said, "times": len(times), "time_ns": times[-1] if times else None}), flush=True)
        if not line:
            break
    await client.disconnect()


if __name__ == "__main__":
    asyncio.run(main())
