#!/usr/bin/env python3
"""Takes one mesh from patchmill by rclpy: manifest and chunks from their topics, what is missing by the service. Checks the content hash.

usage: large_products.py
Prints one JSON object: clock at the start and when the mesh was whole, number of chunks, how many came by the topic and by the service.
"""

import hashlib
import json
import os
import time

BEGAN = time.time()

import numpy  # noqa: E402
import rclpy  # noqa: E402
from patchmill_msgs.msg import MeshChunk, MeshManifest  # noqa: E402
from patchmill_msgs.srv import GetMeshChunk  # noqa: E402
from rclpy.qos import DurabilityPolicy, QoSProfile  # noqa: E402

QUIET, ATTEMPT, PATIENCE = 0.3, 2.0, 120.0


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
        self.node.create_subscription(MeshChunk, "/patchmill/surface/mesh/chunks", self.take_chunk, deep)
        self.node.create_subscription(MeshManifest, "/patchmill/surface/mesh", self.take_manifest, latched)

    def take_manifest(self, manifest):
        self.manifest, self.touched = manifest, time.monotonic()

    def take_chunk(self, chunk):
        self.touched = time.monotonic()
        if chunk.index not in self.chunks:
            self.chunks[chunk.index] = chunk
            self.by_topic += 1

    def missing(self):
        return [index for index in range(self.manifest.chunk_count) if index not in self.chunks]

    def ask(self, index):
        """One chunk by the service; a first call can be lost, so it is repeated."""
        request = GetMeshChunk.Request(id=self.manifest.surface_id, index=index)
        for _ in range(5):
            future = self.client.call_async(request)
            rclpy.spin_until_future_complete(self.node, future, timeout_sec=ATTEMPT)
            if future.done() and future.result().code == 0:
                if index not in self.chunks:
                    self.chunks[index] = future.result().chunk
                    self.by_service += 1
                return
        raise TimeoutError(f"chunk {index} did not come by the service")

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
                    self.ask(index)
        return False

    def content_hash(self):
        """As patchmill_products computes it: little-endian numbers, every list after its length."""
        chunks = [self.chunks[index] for index in range(self.manifest.chunk_count)]
        vectors = [[(v.x, v.y, v.z) for c in chunks for v in getattr(c, field)] for field in ("vertices", "normals")]
        triangles = [t.vertex_indices for c in chunks for t in c.triangles]
        digest = hashlib.sha256(numpy.array([self.manifest.chord_error], "<f8").tobytes())
        for values, kind in [(vectors[0], "<f8"), (vectors[1], "<f8"), (triangles, "<u4")]:
            digest.update(numpy.array([len(values)], "<u8").tobytes())
            digest.update(numpy.array(values, kind).tobytes())
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
    os._exit(0)


if __name__ == "__main__":
    main()
