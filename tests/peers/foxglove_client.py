#!/usr/bin/env python3
"""A client of the Foxglove WebSocket (subprotocol foxglove.sdk.v1), as the Foxglove app is one: takes every topic that the server
advertises and decodes each message by nothing but the schema that came with it.

usage: foxglove_client.py ws://HOST:PORT --want TOPIC... [--moving TOPIC] [--seconds S]
Ends when every wanted topic has had a message and no topic but the streams has had another for two seconds; with --moving not
before ten different joint positions came on that topic. Prints "subscribed" on stderr when it listens, in the end one JSON object on
stdout: topic -> {type, messages, digest, …}. Exit 1 when something does not decode or what is wanted does not come in time.
"""
import argparse
import asyncio
import hashlib
import json
import struct
import sys

import websockets
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

STREAMS = {"sensor_msgs/msg/JointState", "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/PoseStamped",
           "diagnostic_msgs/msg/DiagnosticArray"}
ADD, DELETE, DELETEALL = 0, 2, 3
MESSAGE_DATA = 1
QUIET_S = 2.0


class Topic:
    """What has come on a topic."""

    def __init__(self, channel: dict):
        if (channel["encoding"], channel["schemaEncoding"]) != ("cdr", "ros2msg"):
            raise ValueError(f"{channel['topic']}: {channel['encoding']} by {channel['schemaEncoding']}, cdr by ros2msg was expected")
        self.name, self.type = channel["topic"], channel["schemaName"]
        # Without any predefined type: everything must come out of the schema.
        self.store = get_typestore(Stores.EMPTY)
        self.store.register(get_types_from_msg(channel["schema"], self.type))
        self.messages, self.raw, self.last, self.scene, self.positions = 0, b"", None, {}, set()

    def take(self, raw: bytes) -> None:
        message = self.store.deserialize_cdr(raw, self.type)
        if bytes(self.store.serialize_cdr(message, self.type)) != raw:
            raise ValueError(f"{self.name}: rosbags' own CDR of the decoded message differs from the bytes that came")
        self.messages, self.raw, self.last = self.messages + 1, raw, message
        if self.type == "visualization_msgs/msg/MarkerArray":
            self.draw(message.markers)
        elif self.type == "sensor_msgs/msg/JointState":
            self.positions.add(tuple(message.position))

    def draw(self, markers) -> None:
        for marker in markers:
            if marker.action == DELETEALL:
                self.scene.clear()
            elif marker.action == ADD:
                self.scene[marker.ns, marker.id] = marker
            elif marker.action == DELETE:
                self.scene.pop((marker.ns, marker.id), None)

    def seen(self) -> dict:
        found = {"type": self.type, "messages": self.messages}
        if self.scene:
            encode = lambda m: bytes(self.store.serialize_cdr(m, "visualization_msgs/msg/Marker"))
            state = b"".join(encode(self.scene[key]) for key in sorted(self.scene))
            found["namespaces"] = sorted({ns for ns, _ in self.scene})
            found["markers"] = len(self.scene)
            found["points"] = sum(len(m.points) for m in self.scene.values())
        else:
            state = self.raw
        if self.type == "sensor_msgs/msg/PointCloud2" and self.last:
            found["width"] = self.last.width
        if self.type == "std_msgs/msg/String" and self.last:
            found["text"] = self.last.data
        if self.type == "sensor_msgs/msg/JointState":
            found["positions"] = len(self.positions)
        if self.type == "patchmill_msgs/msg/Job" and self.last:
            found["job_id"] = self.last.job_id
        if self.type == "patchmill_msgs/msg/Evaluation" and self.last:
            found["chosen"] = self.last.chosen
        if self.type == "tf2_msgs/msg/TFMessage" and self.last:
            found["frames"] = sorted({t.child_frame_id for t in self.last.transforms})
        found["digest"] = hashlib.sha256(state).hexdigest()
        return found


async def advertised(socket, topics: dict) -> None:
    """Reads the server's greeting and subscribes to everything."""
    info = json.loads(await socket.recv())
    if info["op"] != "serverInfo" or not info["name"].startswith("patchmill"):
        raise ValueError(f"the server begins with {info}")
    while not topics:
        message = json.loads(await socket.recv())
        if message["op"] == "advertise":
            topics.update({channel["id"]: Topic(channel) for channel in message["channels"]})
    # Subscriptions are numbered by the client: another number than the channel's shows that they are not mixed up.
    subscriptions = [{"id": number + 1000, "channelId": number} for number in topics]
    await socket.send(json.dumps({"op": "subscribe", "subscriptions": subscriptions}))
    print("subscribed", file=sys.stderr, flush=True)


async def listen(arguments, topics: dict) -> None:
    loop = asyncio.get_running_loop()
    async with websockets.connect(arguments.url, subprotocols=["foxglove.sdk.v1"], max_size=None) as socket:
        if socket.subprotocol != "foxglove.sdk.v1":
            raise ValueError(f"the server speaks {socket.subprotocol}")
        await advertised(socket, topics)
        by_name = {topic.name: topic for topic in topics.values()}
        unknown = [name for name in arguments.want + arguments.moving if name not in by_name]
        if unknown:
            raise ValueError(f"{', '.join(unknown)} not among {', '.join(sorted(by_name))}")
        latest = loop.time()

        def complete() -> bool:
            return (all(by_name[name].messages for name in arguments.want)
                    and all(len(by_name[name].positions) >= 10 for name in arguments.moving)
                    and loop.time() - latest > QUIET_S)

        while not complete():
            try:
                frame = await asyncio.wait_for(socket.recv(), 0.2)
            except asyncio.TimeoutError:
                continue
            if isinstance(frame, str):
                status = json.loads(frame)
                if status["op"] == "status" and status["level"] > 0:
                    raise ValueError(f"the server complains: {status}")
                continue
            operation, subscription, _ = struct.unpack_from("<BIQ", frame)
            if operation != MESSAGE_DATA:
                raise ValueError(f"a frame of operation {operation}")
            topic = topics[subscription - 1000]
            topic.take(frame[struct.calcsize("<BIQ"):])
            if topic.type not in STREAMS:
                latest = loop.time()


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("url")
    parser.add_argument("--want", nargs="+", default=[])
    parser.add_argument("--moving", nargs="*", default=[])
    parser.add_argument("--seconds", type=float, default=60.0)
    arguments = parser.parse_args()
    topics = {}

    async def run():
        await asyncio.wait_for(listen(arguments, topics), arguments.seconds)

    try:
        asyncio.run(run())
    except asyncio.TimeoutError:
        missing = [topic.name for topic in topics.values() if topic.name in arguments.want and not topic.messages]
        print(f"within {arguments.seconds} s nothing on {missing} or no rest", file=sys.stderr)
        return 1
    except (ValueError, OSError, websockets.WebSocketException) as error:
        print(error, file=sys.stderr)
        return 1
    print(json.dumps({topic.name: topic.seen() for topic in topics.values()}, indent=1, sort_keys=True))
    return 0


if __name__ == "__main__":
    sys.exit(main())
