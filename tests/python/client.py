"""A small client of Tessera, to copy from. Needs grpcio, google-crc32c and the stubs:

    python -m grpc_tools.protoc -I proto --python_out=. --grpc_python_out=. proto/tessera/v1/remesh.proto

Vertices and seeds are sequences of (x, y, z), facets of (i, j, k).
"""

import array
import itertools
import json
import queue
import struct
import typing

import google_crc32c
import grpc
from tessera.v1 import remesh_pb2 as pb
from tessera.v1 import remesh_pb2_grpc

CHUNK_BYTES = 1 << 20


def chunks(kind, data, attribute=None):
    """An array as messages of about a MiB."""
    for offset in range(0, len(data), CHUNK_BYTES):
        part = data[offset : offset + CHUNK_BYTES]
        yield pb.Chunk(kind=kind, offset=offset, data=part, crc32c=google_crc32c.value(part), attribute=attribute)


def pack(code, rows):
    """Rows of numbers as little-endian bytes; code 'd' for f64, 'I' for u32, 'B' for u8."""
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
        key = (chunk.kind, chunk.attribute if chunk.kind == pb.ARRAY_KIND_SCALARS else 0)
        data = self.data.setdefault(key, bytearray())
        if chunk.offset != len(data):
            raise ValueError("a part of an array is missing")
        if google_crc32c.value(chunk.data) != chunk.crc32c:
            raise ValueError("a chunk is damaged")
        data += chunk.data
        self.total[key] = chunk.total_bytes

    def points(self, kind):
        return rows(unpack("d", self.whole(kind)))

    def numbers(self, kind):
        return unpack("d", self.whole(kind))

    def indices(self, kind):
        return unpack("I", self.whole(kind))

    def report(self, in_done):
        """The report: in the last message, or in chunks if it is long."""
        return json.loads(in_done or self.whole(pb.ARRAY_KIND_REPORT))

    def has(self, kind):
        """Whether all of an array is there."""
        return (kind, 0) in self.data and len(self.data[kind, 0]) == self.total[kind, 0]

    def whole(self, kind, attribute=0):
        data = bytes(self.data[kind, attribute])
        if len(data) != self.total[kind, attribute]:
            raise ValueError("an array is not whole")
        return data


class Attribute(typing.NamedTuple):
    """What a surface carries.

    kind: "normals", "texture_coordinates", "colours", "scalar". values: rows of 3, 2, 4 numbers, or numbers.
    corners: for each facet the indices of its corners' values; None where values are by vertex (texture coordinates
    always have corners). name: a scalar's. type: "f64", and for colours also "u8".
    """

    kind: str
    values: list
    corners: list | None = None
    name: str = ""
    type: str = "f64"

    # Numbers in a value, its array, and the array of its corners.
    KINDS = {
        "normals": (3, pb.ARRAY_KIND_NORMALS, pb.ARRAY_KIND_NORMAL_CORNERS),
        "texture_coordinates": (2, pb.ARRAY_KIND_TEXTURE_COORDINATES, pb.ARRAY_KIND_TEXTURE_CORNERS),
        "colours": (4, pb.ARRAY_KIND_COLOURS, None),
        "scalar": (1, pb.ARRAY_KIND_SCALARS, None),
    }
    CODES = {"f64": "d", "u8": "B"}

    def header(self):
        return pb.AttributeHeader(
            kind=choice("ATTRIBUTE_KIND", self.kind),
            name=self.name,
            type=choice("ATTRIBUTE_TYPE", self.type),
            values=len(self.values),
            by_corner=self.corners is not None,
        )

    def upload(self, index):
        width, kind, corner_kind = self.KINDS[self.kind]
        values = self.values if width > 1 else [self.values]
        yield from chunks(kind, pack(self.CODES[self.type], values), index)
        if self.corners is not None:
            yield from chunks(corner_kind, pack("I", self.corners), index)

    @classmethod
    def take(cls, header, index, arrays):
        """The attribute of a result."""
        kind = pb.AttributeKind.Name(header.kind).removeprefix("ATTRIBUTE_KIND_").lower()
        type = pb.AttributeType.Name(header.type).removeprefix("ATTRIBUTE_TYPE_").lower()
        width, values_kind, corner_kind = cls.KINDS[kind]
        data = arrays.whole(values_kind, index if kind == "scalar" else 0)
        values = unpack(cls.CODES[type], data)
        corners = rows(arrays.indices(corner_kind)) if corner_kind and arrays.has(corner_kind) else None
        return cls(kind, rows(values, width) if width > 1 else values, corners, header.name, type)


class Remesh(typing.NamedTuple):
    """What `Tessera.remesh` gives."""

    points: list
    facets: list
    iterations: list
    report: dict
    attributes: list


class Tessera:
    """Every option is a keyword. One that is None is not sent, and then the server's default holds, which is the
    command's: 0 is a value like any other."""

    def __init__(self, address, tenant=None):
        # Whose work it is; without a tenant, the caller's address says so.
        self.metadata = [("tessera-tenant", tenant)] if tenant else []
        options = [("grpc.max_receive_message_length", 8 << 20)]
        self.channel = grpc.insecure_channel(address, options=options)
        self.stub = remesh_pb2_grpc.RemeshServiceStub(self.channel)

    def close(self):
        self.channel.close()

    def rvd(self, vertices, facets, seeds=None, *, points=None, seed=None, backend=None, weights=None, timeout=60):
        """Cells as a list of (facet, seed, [(x, y, z), ...]), centroids, and the report.

        Give seeds, or the number of points to draw.
        """
        outputs = [pb.RVD_OUTPUT_CELLS, pb.RVD_OUTPUT_CENTROIDS]
        header = pb.ComputeRvdHeader(
            mesh=mesh(vertices, facets, weights=weights),
            seeds=counted(seeds),
            backend=choice("BACKEND_CHOICE", backend),
            options=pb.DiagramOptions(points=points, seed=seed, outputs=outputs),
        )
        arrays_sent = upload(vertices, facets, seeds, weights=weights)
        cells, arrays, report = [], Arrays(), None
        for answer in self.stub.ComputeRvd(self._job(pb.ComputeRvdRequest, header, arrays_sent), timeout=timeout, metadata=self.metadata):
            which = answer.WhichOneof("message")
            if which == "cells":
                cells += list(pieces(answer.cells))
            elif which == "chunk":
                arrays.take(answer.chunk)
            elif which == "done":
                report = arrays.report(answer.done.report_json)
        return cells, arrays.points(pb.ARRAY_KIND_CENTROIDS), report

    def remesh(
        self,
        vertices,
        facets,
        points=None,
        *,
        seeds=None,
        edge_lengths=None,
        weights=None,
        creases=None,
        attributes=None,
        backend=None,
        timeout=60,
        **options,
    ):
        """Points and facets of the remesh, the iterations, the report, and the attributes.

        points: how many; or give seeds, edge_length or edge_lengths (one a vertex).
        weights: one a vertex. creases: pairs of vertices. backend: "auto", "gpu", "parallel", "serial".
        attributes: a list of `Attribute`, which the result carries too.
        options: see `message`; such as seed=7, density="lfs", edge_length=0.1, lloyd=3, crease_angle=40, max_deviation=1.
        """
        attributes = attributes or []
        header = pb.RemeshHeader(
            mesh=mesh(vertices, facets, weights, edge_lengths, creases, attributes),
            seeds=counted(seeds),
            backend=choice("BACKEND_CHOICE", backend),
            options=message(pb.RemeshOptions, points=points, **options),
        )
        arrays_sent = itertools.chain(
            upload(vertices, facets, seeds, weights=weights, edge_lengths=edge_lengths, creases=creases),
            *(attribute.upload(index) for index, attribute in enumerate(attributes)),
        )
        arrays, iterations, done = Arrays(), [], None
        for answer in self.stub.Remesh(self._job(pb.RemeshRequest, header, arrays_sent), timeout=timeout, metadata=self.metadata):
            which = answer.WhichOneof("message")
            if which == "iteration":
                iterations.append(answer.iteration)
            elif which == "chunk":
                arrays.take(answer.chunk)
            elif which == "done":
                done = answer.done
        return Remesh(
            arrays.points(pb.ARRAY_KIND_POSITIONS),
            rows(arrays.indices(pb.ARRAY_KIND_FACETS)),
            iterations,
            arrays.report(done.report_json),
            [Attribute.take(header, index, arrays) for index, header in enumerate(done.attributes)],
        )

    def session(self, vertices, facets, seeds=None, **options):
        """An interactive session; the options are those of `Session`."""
        return Session(self, vertices, facets, seeds, **options)

    def _job(self, request, header, arrays):
        yield request(header=header)
        for chunk in arrays:
            yield request(chunk=chunk)
        yield request(finish=pb.Finish())


class Session:
    """An interactive CVT session. Its options are the fields of CvtOptions: see `message`."""

    def __init__(
        self, client, vertices, facets, seeds=None, *, edge_lengths=None, weights=None, backend=None, **options
    ):
        self.requests = queue.SimpleQueue()
        header = pb.CvtHeader(
            mesh=mesh(vertices, facets, weights, edge_lengths),
            seeds=counted(seeds),
            backend=choice("BACKEND_CHOICE", backend),
            options=message(pb.CvtOptions, **options),
        )
        self.requests.put(pb.CvtRequest(header=header))
        for chunk in upload(vertices, facets, seeds, weights=weights, edge_lengths=edge_lengths):
            self.requests.put(pb.CvtRequest(chunk=chunk))
        self.requests.put(pb.CvtRequest(start=pb.CvtStart()))
        self.answers = client.stub.Cvt(iter(self.requests.get, None), metadata=client.metadata)
        self.backend = next(self.answers).accepted.backend

    def step(self, iterations=1, *, kind=None):
        """Takes steps, "lloyd" or "lbfgs"; returns their figures and the seeds after the last."""
        kind = choice("STEP_KIND", kind)
        step = pb.CvtStep(iterations=iterations, kind=kind, seeds=pb.SEEDS_WANTED_LAST)
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
        # To the end of the stream: grpcio may hang at the end of a program that leaves a call half read.
        for _ in self.answers:
            pass
        return seeds

    def _seeds(self):
        arrays = Arrays()
        while True:
            arrays.take(next(self.answers).chunk)
            if arrays.has(pb.ARRAY_KIND_SEEDS):
                return arrays.points(pb.ARRAY_KIND_SEEDS)


def mesh(vertices, facets, weights=None, edge_lengths=None, creases=None, attributes=()):
    """What is uploaded."""
    return pb.MeshHeader(
        vertices=len(vertices),
        facets=len(facets),
        position_type=pb.POSITION_TYPE_F64,
        weights=counted(weights),
        edge_lengths=counted(edge_lengths),
        creases=counted(creases),
        attributes=[attribute.header() for attribute in attributes],
    )


def choice(enum, name):
    """One of an enum's values by its name, in any case; None leaves it open."""
    if name is None:
        return None
    return getattr(pb, f"{enum}_{name.upper()}")


def counted(values):
    return None if values is None else len(values)


def message(kind, **options):
    """A message of options by the names of its fields, and of those of `Density`, whose source is called density.

    An enum's value is its last words, such as "surface" or "edge_lengths". One that is None is left open.
    """
    made = kind()
    fields = {field.name: (made, field) for field in kind.DESCRIPTOR.fields}
    if "density" in fields:
        inner = {field.name: (made.density, field) for field in pb.Density.DESCRIPTOR.fields}
        fields |= {"density": inner.pop("source"), **inner}
    for name, value in options.items():
        if name not in fields:
            raise TypeError(f"there is no option {name}")
        part, field = fields[name]
        if field.enum_type and value is not None:
            value = choice(field.enum_type.values[0].name.removesuffix("_UNSPECIFIED"), value)
        if value is not None:
            setattr(part, field.name, value)
    return made


def upload(vertices, facets, seeds=None, *, weights=None, edge_lengths=None, creases=None):
    yield from chunks(pb.ARRAY_KIND_POSITIONS, pack("d", vertices))
    yield from chunks(pb.ARRAY_KIND_FACETS, pack("I", facets))
    yield from chunks(pb.ARRAY_KIND_SEEDS, pack("d", seeds or []))
    yield from chunks(pb.ARRAY_KIND_WEIGHTS, pack("d", [weights or []]))
    yield from chunks(pb.ARRAY_KIND_EDGE_LENGTHS, pack("d", [edge_lengths or []]))
    yield from chunks(pb.ARRAY_KIND_CREASES, pack("I", creases or []))


def pieces(cells):
    """The pieces of one message: (facet, seed, polygon)."""
    positions = rows(unpack("d", cells.positions))
    first = 0
    for facet, seed, count in zip(unpack("I", cells.facet), unpack("I", cells.seed), unpack("I", cells.vertex_count)):
        yield facet, seed, positions[first : first + count]
        first += count
