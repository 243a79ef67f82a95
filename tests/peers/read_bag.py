#!/usr/bin/env python3
"""Decodes every message of a bag with two independent readers, using only the definitions that the bag carries.

usage: read_bag.py BAG_FOLDER [--expect TOPIC ...]
Prints one JSON object: topic -> {type, messages}. Exit 1 when a message does not decode, the readers disagree on a count, the
metadata is wrong, or an expected topic has no message.
"""
import argparse
import json
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from ruamel.yaml import YAML


def with_rosbags(bag: Path) -> dict:
    found = {}
    with AnyReader([bag]) as reader:
        # A store without any predefined type: everything must come out of the bag's own definitions.
        store = get_typestore(Stores.EMPTY)
        for connection in reader.connections:
            store.register({k: v for k, v in get_types_from_msg(connection.msgdef.data, connection.msgtype).items()
                            if k not in store.fielddefs})
        for connection in reader.connections:
            # AnyReader itself holds the hash against that of the definition.
            if not connection.digest.startswith("RIHS01_"):
                raise ValueError(f"{connection.topic}: no type hash in metadata.yaml")
        for connection, _, raw in reader.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            again = bytes(store.serialize_cdr(message, connection.msgtype))
            if again != bytes(raw):
                raise ValueError(f"{connection.topic}: rosbags' own CDR of the decoded message differs from the recorded bytes")
            entry = found.setdefault(connection.topic, {"type": connection.msgtype, "messages": 0})
            entry["messages"] += 1
    return found


def with_mcap(bag: Path) -> dict:
    found = {}
    told = {}
    metadata = YAML(typ="safe").load(bag / "metadata.yaml")["rosbag2_bagfile_information"]
    for topic in metadata["topics_with_message_count"]:
        told[topic["topic_metadata"]["name"]] = topic
    if sorted(metadata["relative_file_paths"]) != sorted(path.name for path in bag.glob("*.mcap")):
        raise ValueError(f"metadata.yaml names {metadata['relative_file_paths']}")
    for file in metadata["files"]:
        with open(bag / file["path"], "rb") as stream:
            reader = make_reader(stream, validate_crcs=True, decoder_factories=[DecoderFactory()])
            statistics = reader.get_summary().statistics
            times = file["starting_time"]["nanoseconds_since_epoch"], file["duration"]["nanoseconds"]
            if (statistics.message_count, statistics.message_start_time, statistics.message_end_time) != (
                    file["message_count"], times[0], times[0] + times[1]):
                raise ValueError(f"{file['path']}: metadata.yaml says {file}, the file {statistics}")
            for schema, channel, _, _ in reader.iter_decoded_messages():
                if channel.metadata["topic_type_hash"] != told[channel.topic]["topic_metadata"]["type_description_hash"]:
                    raise ValueError(f"{channel.topic}: the file's type hash is not that of metadata.yaml")
                entry = found.setdefault(channel.topic, {"type": schema.name, "messages": 0})
                entry["messages"] += 1
    if {name: entry["messages"] for name, entry in found.items()} != {name: topic["message_count"] for name, topic in told.items()}:
        raise ValueError(f"metadata.yaml counts other messages than {found}")
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--expect", nargs="*", default=[])
    arguments = parser.parse_args()
    first, second = with_rosbags(arguments.bag), with_mcap(arguments.bag)
    print(json.dumps(first, indent=1, sort_keys=True))
    if first != second:
        print(f"the readers disagree: rosbags {first}, mcap-ros2-support {second}", file=sys.stderr)
        return 1
    missing = [topic for topic in arguments.expect if topic not in first]
    if missing:
        print(f"no message on {', '.join(missing)}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
