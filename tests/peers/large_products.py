#!/usr/bin/env python3
"""Takes one mesh from patchmill by rclpy: manifest and chunks from their topics, what is missing by the service. Checks the content hash.

The topic's chunks are taken as bytes and read with numpy: rclpy takes tens of milliseconds to make Python objects of one, which would be
measured instead of the transport. Answers of the service are made into objects by rclpy.

usage: large_products.py
Prints one JSON object: clock at the start and when the mesh was whole, number of chunks, how many came by the topic and by the service.
Exit code 1 when it did not come whole or has another hash than was announced.
"""

import hashlib
import json
import os
import struct
import time

BEGAN = time.time()

import numpy  # noqa: E402
import rclpy  # noqa: E402
from patchmill_msgs.msg import MeshChunk, MeshManifest  # noqa: E402
from patchmill_msgs.srv import GetMeshChunk  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402

QUIET, ATTEMPT, PATIENCE = 0.3, 2.0, 120.0


class Cdr:
    """Reads little-endian CDR after its header of four bytes."""

    def __init__(self, data):
        self.data, self.at = data[4:], 0

    def words(self, count):
        self.at += -self.at % 4
        self.at += 4 * count
        return struct.unpack_from(f"<{count}I", self.data, self.at - 4 * count)

    def text(self):
        (length,) = self.words(1)
        self.at += length
        return self.data[self.at - length : self.at - 1].decode()

    def rows(self, kind, size):
        """A sequence of three numbers each."""
        (count,) = self.words(1)
        if count == 0:
            return numpy.zeros((0, 3), kind)
        self.at += -self.at % size
        rows = numpy.frombuffer(self.data, kind, 3 * count, self.at).reshape(count, 3)
        self.at += 3 * size * count
        return rows

    def flags(self):
        """A sequence of booleans, as the whole numbers that the hash takes."""
        (count,) = self.words(1)
        self.at += count
        return numpy.frombuffer(self.data, "u1", count, self.at - count).astype("<u4")


def chunk_of_bytes(data):
    """Number and arrays of a MeshChunk."""
    cdr = Cdr(data)
    # The header's stamp and frame, the surface's id.
    cdr.words(2)
    cdr.text()
    cdr.text()
    index = cdr.words(4)[0]
    return index, (cdr.rows("<f8", 8), cdr.rows("<f8", 8), cdr.rows("<u4", 4), cdr.flags())


def arrays_of_message(chunk):
    """The same arrays of a MeshChunk that rclpy has made into objects."""
    def rows(values, kind):
        return numpy.array(values, kind).reshape(-1, 3)

    vertices, normals = (rows([(v.x, v.y, v.z) for v in field], "<f8") for field in (chunk.vertices, chunk.normals))
    return vertices, normals, rows([t.vertex_indices for t in chunk.triangles], "<u4"), numpy.array(chunk.check_only, "<u4")


class Reader:
    def __init__(self):
        self.node = rclpy.create_node("large_products")
        self.manifest, self.chunks = None, {}
        self.by_topic = self.by_service = 0
        self.touched = time.monotonic()
        latched = QoSProfile(depth=16, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        # Deep enough for all: what rclpy has not yet taken is not overwritten.
        deep = QoSProfile(depth=2000)
        self.client = self.node.create_client(GetMeshChunk, "/patchmill/surface_ingestion/get_mesh_chunk")
        self.node.create_subscription(MeshChunk, "/patchmill/surface/mesh/chunks", self.take_bytes, deep, raw=True)
        self.node.create_subscription(MeshManifest, "/patchmill/surface/mesh", self.take_manifest, latched)

    def take_manifest(self, manifest):
        self.manifest, self.touched = manifest, time.monotonic()

    def take_bytes(self, data):
        self.touched = time.monotonic()
        index, arrays = chunk_of_bytes(data)
        if index not in self.chunks:
            self.chunks[index] = arrays
            self.by_topic += 1

    def missing(self):
        return [index for index in range(self.manifest.chunk_count) if index not in self.chunks]

    def ask(self, index):
        """One chunk by the service. False when there was no answer."""
        request = GetMeshChunk.Request(id=self.manifest.surface_id, index=index)
        future = self.client.call_async(request)
        rclpy.spin_until_future_complete(self.node, future, timeout_sec=ATTEMPT)
        if not future.done() or future.result().code != 0:
            return False
        if index not in self.chunks:
            self.chunks[index] = arrays_of_message(future.result().chunk)
            self.by_service += 1
        return True

    def whole(self):
        end = time.monotonic() + PATIENCE
        while time.monotonic() < end:
            rclpy.spin_once(self.node, timeout_sec=0.05)
            if self.manifest is None:
                continue
            if len(self.chunks) >= self.manifest.chunk_count:
                return True
            if time.monotonic() - self.touched > QUIET:
                for index in self.missing():
                    if not self.ask(index):
                        break
        return False

    def content_hash(self):
        """As patchmill_products computes it: little-endian numbers, every list after its length."""
        digest = hashlib.sha256(numpy.array([self.manifest.chord_error], "<f8").tobytes())
        for part in range(4):
            rows = numpy.concatenate([self.chunks[index][part] for index in range(self.manifest.chunk_count)])
            digest.update(numpy.array([len(rows)], "<u8").tobytes())
            digest.update(rows.tobytes())
        return digest.hexdigest()


def main():
    rclpy.init()
    reader = Reader()
    arrived = reader.whole()
    end = time.time()
    report = {"began": BEGAN, "end": end, "whole": arrived and reader.content_hash() == reader.manifest.content_hash,
              "chunks": reader.manifest.chunk_count if reader.manifest else 0, "by_topic": reader.by_topic,
              "by_service": reader.by_service}
    print(json.dumps(report), flush=True)
    # The interpreter's own way out takes rclpy's threads down in no set order.
    os._exit(0 if report["whole"] else 1)


if __name__ == "__main__":
    main()
