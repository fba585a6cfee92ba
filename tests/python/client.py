"""A small client of Tessera, to copy from. Needs grpcio, google-crc32c and the stubs:

    python -m grpc_tools.protoc -I proto --python_out=. --grpc_python_out=. proto/tessera/v1/remesh.proto

Points are sequences of (x, y, z), facets of (i, j, k).
"""

import array
import json
import queue
import struct

import google_crc32c
import grpc
from tessera.v1 import remesh_pb2 as pb
from tessera.v1 import remesh_pb2_grpc

CHUNK_BYTES = 1 << 20


def chunks(kind, data):
    """An array as messages of about a MiB."""
    for offset in range(0, len(data), CHUNK_BYTES):
        part = data[offset : offset + CHUNK_BYTES]
        yield pb.Chunk(kind=kind, offset=offset, data=part, crc32c=google_crc32c.value(part))


def pack(code, rows):
    """Rows of numbers as little-endian bytes; code 'd' for f64, 'I' for u32."""
    flat = [x for row in rows for x in row]
    return struct.pack(f"<{len(flat)}{code}", *flat)


def unpack(code, data):
    values = array.array(code, data)
    return values.tolist()


def rows(values, width=3):
    return [tuple(values[i : i + width]) for i in range(0, len(values), width)]


class Arrays:
    """Arrays that the server sends in chunks."""

    def __init__(self):
        self.data = {}
        self.total = {}

    def take(self, chunk):
        data = self.data.setdefault(chunk.kind, bytearray())
        if chunk.offset != len(data):
            raise ValueError("a part of an array is missing")
        if google_crc32c.value(chunk.data) != chunk.crc32c:
            raise ValueError("a chunk is damaged")
        data += chunk.data
        self.total[chunk.kind] = chunk.total_bytes

    def points(self, kind):
        return rows(unpack("d", self.whole(kind)))

    def numbers(self, kind):
        return unpack("d", self.whole(kind))

    def indices(self, kind):
        return unpack("I", self.whole(kind))

    def report(self, in_done):
        """The report: in the last message, or in chunks if it is long."""
        return json.loads(in_done or self.whole(pb.ARRAY_KIND_REPORT))

    def whole(self, kind):
        data = bytes(self.data[kind])
        if len(data) != self.total[kind]:
            raise ValueError("an array is not whole")
        return data


class Tessera:
    def __init__(self, address):
        options = [("grpc.max_receive_message_length", 8 << 20)]
        self.channel = grpc.insecure_channel(address, options=options)
        self.stub = remesh_pb2_grpc.RemeshServiceStub(self.channel)

    def close(self):
        self.channel.close()

    def rvd(self, points, facets, seeds, timeout=60):
        """Cells as a list of (facet, seed, [(x, y, z), ...]), centroids, and the report."""
        outputs = [pb.RVD_OUTPUT_CELLS, pb.RVD_OUTPUT_CENTROIDS]
        header = pb.ComputeRvdHeader(mesh=mesh(points, facets), seeds=given(seeds), outputs=outputs)
        cells, arrays, report = [], Arrays(), None
        for answer in self.stub.ComputeRvd(self._job(pb.ComputeRvdRequest, header, points, facets, seeds), timeout=timeout):
            which = answer.WhichOneof("message")
            if which == "cells":
                cells += list(pieces(answer.cells))
            elif which == "chunk":
                arrays.take(answer.chunk)
            elif which == "done":
                report = arrays.report(answer.done.report_json)
        return cells, arrays.points(pb.ARRAY_KIND_CENTROIDS), report

    def remesh(self, points, facets, count, lloyd_steps=5, random_seed=0, timeout=60):
        """Points and facets of the remesh, the iterations, and the report."""
        sampled = pb.SeedSource(sampled=pb.SampledSeeds(points=count, random_seed=random_seed))
        header = pb.RemeshHeader(mesh=mesh(points, facets), seeds=sampled, lloyd_steps=lloyd_steps)
        arrays, iterations, report = Arrays(), [], None
        for answer in self.stub.Remesh(self._job(pb.RemeshRequest, header, points, facets, []), timeout=timeout):
            which = answer.WhichOneof("message")
            if which == "iteration":
                iterations.append(answer.iteration)
            elif which == "chunk":
                arrays.take(answer.chunk)
            elif which == "done":
                report = arrays.report(answer.done.report_json)
        new_facets = rows(arrays.indices(pb.ARRAY_KIND_FACETS))
        return arrays.points(pb.ARRAY_KIND_POSITIONS), new_facets, iterations, report

    def session(self, points, facets, seeds, max_seeds=0):
        return Session(self, points, facets, seeds, max_seeds)

    def _job(self, request, header, points, facets, seeds):
        yield request(header=header)
        for chunk in upload(points, facets, seeds):
            yield request(chunk=chunk)
        yield request(finish=pb.Finish())


class Session:
    """An interactive CVT session."""

    def __init__(self, client, points, facets, seeds, max_seeds):
        self.requests = queue.SimpleQueue()
        header = pb.CvtHeader(mesh=mesh(points, facets), seeds=given(seeds), max_seeds=max_seeds)
        self.requests.put(pb.CvtRequest(header=header))
        for chunk in upload(points, facets, seeds):
            self.requests.put(pb.CvtRequest(chunk=chunk))
        self.requests.put(pb.CvtRequest(start=pb.CvtStart()))
        self.answers = client.stub.Cvt(iter(self.requests.get, None))
        self.backend = next(self.answers).accepted.backend

    def step(self, iterations=1):
        """Takes steps; returns their figures and the seeds after the last."""
        step = pb.CvtStep(iterations=iterations, seeds=pb.SEEDS_WANTED_LAST)
        self.requests.put(pb.CvtRequest(step=step))
        taken = [next(self.answers).iteration for _ in range(iterations)]
        return taken, self._seeds()

    def edit(self, edits):
        """Changes the seeds; returns them all."""
        edit = pb.CvtEdit(edits=edits, seeds=pb.SEEDS_WANTED_LAST)
        self.requests.put(pb.CvtRequest(edit=edit))
        assert next(self.answers).WhichOneof("message") == "edited"
        return self._seeds()

    def finish(self):
        """Ends the session; returns the last seeds."""
        self.requests.put(pb.CvtRequest(finish=pb.Finish()))
        self.requests.put(None)
        seeds = self._seeds()
        done = next(self.answers).done
        assert done.seeds == len(seeds)
        return seeds

    def _seeds(self):
        arrays = Arrays()
        while True:
            arrays.take(next(self.answers).chunk)
            kind = pb.ARRAY_KIND_SEEDS
            if len(arrays.data[kind]) == arrays.total[kind]:
                return arrays.points(kind)


def mesh(points, facets):
    return pb.MeshHeader(vertices=len(points), facets=len(facets), position_type=pb.POSITION_TYPE_F64)


def given(seeds):
    return pb.SeedSource(uploaded=len(seeds))


def upload(points, facets, seeds):
    yield from chunks(pb.ARRAY_KIND_POSITIONS, pack("d", points))
    yield from chunks(pb.ARRAY_KIND_FACETS, pack("I", facets))
    yield from chunks(pb.ARRAY_KIND_SEEDS, pack("d", seeds))


def pieces(cells):
    """The pieces of one message: (facet, seed, polygon)."""
    positions = rows(unpack("d", cells.positions))
    first = 0
    for facet, seed, count in zip(unpack("I", cells.facet), unpack("I", cells.seed), unpack("I", cells.vertex_count)):
        yield facet, seed, positions[first : first + count]
        first += count
