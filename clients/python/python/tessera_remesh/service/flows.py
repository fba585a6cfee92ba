"""What a client says, without saying it: generators that yield calls and get answers.

A flow knows no connection, so that the same one serves the blocking client and the one for asyncio. It yields `Unary`,
`Upload`, `Each` and `Sleep`; whoever drives it sends the answer back, or throws the `ServerError`.
"""

from __future__ import annotations

import hashlib
import json
import secrets
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from typing import Any, Union

import google_crc32c
import numpy as np

from .._engine import InputError
from ..meshes import Attributes, Surface
from ..progress import Engine
from ._stubs import blob_pb2, job_pb2, remesh_pb2
from .errors import ConnectionLost, JobFailed, ServerError, by_keyword

PIECE_BYTES = 1 << 20
#: Waits between tries where the server does not say how long.
FIRST_WAIT_S, LONGEST_WAIT_S = 0.2, 5.0
#: Whether an earlier job may be the answer to a new one.
REUSES = ("never", "same_bits")


@dataclass
class Unary:
    """A call with one answer."""

    method: str
    request: Any
    answer: Any


@dataclass
class Upload:
    """A stream of requests with one answer."""

    method: str
    requests: Callable[[], Iterator[Any]]
    answer: Any


@dataclass
class Each:
    """A stream of answers; `hear` is called with each, and the answer is None."""

    method: str
    request: Any
    answer: Any
    hear: Callable[[Any], object]


@dataclass
class Sleep:
    seconds: float


Call = Union[Unary, Upload, Each, Sleep]
Flow = Generator[Call, Any, Any]


def again(begin: Callable[[], Flow], patience: float) -> Flow:
    """Does a flow again where the server says that another try may succeed, and where the connection is lost."""
    wait, waited = FIRST_WAIT_S, 0.0
    while True:
        try:
            return (yield from begin())
        except ServerError as error:
            lost = isinstance(error, ConnectionLost) and error.code == "UNAVAILABLE"
            if error.retry_after is None and not lost:
                raise
            pause = wait if error.retry_after is None else max(error.retry_after, 0.01)
            if waited + pause > patience:
                raise
            yield Sleep(pause)
            waited, wait = waited + pause, min(2 * wait, LONGEST_WAIT_S)


def put(data: bytes, patience: float) -> Flow:
    """Stores bytes, or goes on with an upload that was cut; gives their digest."""
    digest = hashlib.sha256(data).hexdigest()

    def flow() -> Flow:
        missing = blob_pb2.FindMissingRequest(digests=[digest])
        if not (yield Unary("BlobService/FindMissing", missing, blob_pb2.FindMissingResponse)).digests:
            return digest
        kept = 0
        try:
            asked = blob_pb2.QueryWriteStatusRequest(digest=digest, size_bytes=len(data))
            kept = (yield Unary("BlobService/QueryWriteStatus", asked, blob_pb2.QueryWriteStatusResponse)).kept_bytes
        except ServerError as error:
            if error.code != "NOT_FOUND":
                raise
        yield Upload("BlobService/Write", lambda: _pieces(data, digest, kept), blob_pb2.WriteResponse)
        return digest

    return (yield from again(flow, patience))


def _pieces(data: bytes, digest: str, start: int) -> Iterator[Any]:
    for offset in range(start, len(data), PIECE_BYTES) or [start]:
        piece = bytes(data[offset : offset + PIECE_BYTES])
        yield blob_pb2.WriteRequest(
            digest=digest,
            size_bytes=len(data),
            offset=offset,
            data=piece,
            crc32c=google_crc32c.value(piece),
            finish=offset + len(piece) == len(data),
        )


def read(digest: str, patience: float) -> Flow:
    """The bytes of a blob. A cut is no loss: the rest is asked for."""
    data = bytearray()

    def flow() -> Flow:
        asked = blob_pb2.ReadRequest(digest=digest, offset=len(data))
        yield Each("BlobService/Read", asked, blob_pb2.ReadResponse, lambda answer: data.extend(answer.data))
        if hashlib.sha256(data).hexdigest() != digest:
            data.clear()
            raise ServerError("DATA_LOSS", f"blob {digest} was damaged on its way", {}, 0.0)
        return bytes(data)

    return (yield from again(flow, patience))


def create(spec: Any, request_id: str, patience: float, reuse: str = "never") -> Flow:
    """Creates a job and gives it. Where the answer is lost, the same job is asked for again."""
    if reuse not in REUSES:
        raise InputError(f"reuse is {reuse!r}; it must be {' or '.join(REUSES)}")
    request = job_pb2.CreateJobRequest(
        spec=spec, request_id=request_id or secrets.token_hex(16), reuse=f"REUSE_POLICY_{reuse.upper()}"
    )
    answer = yield from again(lambda: _unary("CreateJob", request, job_pb2.CreateJobResponse), patience)
    return answer.job


def get(job: str, patience: float) -> Flow:
    """A job as it is now."""
    request = job_pb2.GetJobRequest(id=job)
    return (yield from again(lambda: _unary("GetJob", request, job_pb2.GetJobResponse), patience)).job


def cancel(job: str, patience: float) -> Flow:
    """Cancels a job."""
    request = job_pb2.CancelJobRequest(id=job)
    return (yield from again(lambda: _unary("CancelJob", request, job_pb2.CancelJobResponse), patience)).job


def delete(job: str, patience: float) -> Flow:
    """Forgets a job that has ended."""
    yield from again(lambda: _unary("DeleteJob", job_pb2.DeleteJobRequest(id=job), job_pb2.DeleteJobResponse), patience)


def _unary(method: str, request: Any, answer: Any) -> Flow:
    return (yield Unary(f"JobService/{method}", request, answer))


def watch(job: str, hear: Callable[[Any], object], patience: float) -> Flow:
    """Hears of a job's events until it has ended, each once; a lost connection is made again."""
    after = 0

    def one(answer: Any) -> None:
        nonlocal after
        after = answer.event.number
        hear(answer.event)

    def flow() -> Flow:
        request = job_pb2.WatchJobRequest(id=job, after=after)
        yield Each("JobService/WatchJob", request, job_pb2.WatchJobResponse, one)

    while True:
        seen = after
        try:
            return (yield from again(flow, patience))
        except ConnectionLost:
            # Patience begins again with each event that comes.
            if after == seen:
                raise


def result(job: str, patience: float) -> Flow:
    """The digests of an ended job's result, by name."""
    ended = yield from get(job, patience)
    state = job_pb2.JobState.Name(ended.state).removeprefix("JOB_STATE_").lower()
    if state != "succeeded":
        kind = job_pb2.JobFailureKind.Name(ended.failure.kind).removeprefix("JOB_FAILURE_KIND_").lower()
        message = by_keyword(ended.failure.message) or ended.expired_by
        raise JobFailed(job, state, "" if kind == "unspecified" else kind, message)
    return {blob.name: blob.digest for blob in ended.results}


def teller(listen: Engine | None) -> Callable[[Any], None]:
    """Tells a progress callback of a job's events."""

    def hear(event: Any) -> None:
        if listen is None:
            return
        what = event.WhichOneof("what")
        if what == "stage":
            listen(event.stage.name, None, None, None)
        elif what == "iteration":
            step = event.iteration
            listen("iterations", step.index + 1, step.total or None, step.energy)
        elif what == "state" and event.state.state == job_pb2.JOB_STATE_QUEUED:
            listen("queue", None, None, None)

    return hear


def done(spec: Any, listen: Engine | None, started: Callable[[str], object], patience: float) -> Flow:
    """Creates a job, watches it to its end, and gives all blobs of its result."""
    job = (yield from create(spec, "", patience)).id
    started(job)

    yield from watch(job, teller(listen), patience)
    digests = yield from result(job, patience)
    if listen is not None:
        listen("transfer", None, None, None)
    blobs = {}
    for name, digest in digests.items():
        blobs[name] = yield from read(digest, patience)
    return blobs


def _dtype(form: str) -> np.dtype[Any]:
    """Of a word as "F64": packed, little-endian."""
    return np.dtype(f"<{form[0].lower()}{int(form[1:]) // 8}")


def _array(values: Any, form: str, patience: float) -> Flow:
    array = np.ascontiguousarray(values, dtype=_dtype(form))
    digest = yield from put(array.tobytes(), patience)
    count = len(array)
    return job_pb2.ArrayRef(digest=digest, form=job_pb2.ArrayForm.Value(f"ARRAY_FORM_{form}"), count=count)


def _floats(values: Any, patience: float) -> Flow:
    return (yield from _array(values, "F32" if np.asarray(values).dtype == np.float32 else "F64", patience))


def _doubles(values: Any, patience: float) -> Flow:
    return (yield from _array(values, "F64", patience))


def _indices(values: Any, patience: float) -> Flow:
    array = np.asarray(values)
    if array.size and (array.min() < 0 or array.max() >= 2**31):
        raise InputError("an index is negative or too large")
    return (yield from _array(array, "U32", patience))


def _mesh(surface: Surface, carried: Attributes | None, patience: float) -> Flow:
    arrays = job_pb2.MeshArrays(
        positions=(yield from _floats(surface.vertices, patience)),
        facets=(yield from _indices(surface.faces, patience)),
    )
    if carried is not None:
        given = carried._to_engine()

        def add(kind: Any, name: str, values: Any, corners: Any, components: int = 0) -> None:
            arrays.attributes.append(
                job_pb2.AttributeArrays(kind=kind, name=name, values=values, corners=corners, components=components)
            )

        if given["normals"] is not None:
            corners = None
            if given["normal_corners"] is not None:
                corners = yield from _indices(given["normal_corners"], patience)
            values = yield from _floats(given["normals"], patience)
            add(remesh_pb2.ATTRIBUTE_KIND_NORMALS, "", values, corners)
        if given["texture"] is not None:
            of = given["texture_corners"] if given["texture_corners"] is not None else surface.faces
            corners = yield from _indices(of, patience)
            values = yield from _floats(given["texture"], patience)
            add(remesh_pb2.ATTRIBUTE_KIND_TEXTURE_COORDINATES, "", values, corners)
        if given.get("colours") is not None:
            eight = given["colours_of_eight_bits"]
            colours = np.rint(given["colours"] * 255) if eight else given["colours"]
            values = yield from (_array(colours, "U8", patience) if eight else _floats(colours, patience))
            add(remesh_pb2.ATTRIBUTE_KIND_COLOURS, "", values, None)
        if given.get("regions") is not None:
            regions = yield from _array(given["regions"], "I64", patience)
            add(remesh_pb2.ATTRIBUTE_KIND_REGIONS, "", regions, None)
            named = (remesh_pb2.Region(number=number, name=name) for number, name in given["region_names"])
            arrays.attributes[-1].regions.extend(named)
        for name, (numbers, form, components) in given["scalars"].items():
            values = yield from _array(numbers.reshape(-1, components), form, patience)
            add(remesh_pb2.ATTRIBUTE_KIND_SCALAR, name, values, None, components)
    return job_pb2.JobMesh(arrays=arrays)


def set_option(message: Any, name: str, value: Any, keyword: str = "") -> None:
    """Sets a field, unless the value is None. The words of an enum are the ends of its values' names, but for the first."""
    if value is None:
        return
    keyword, given = keyword or name, value
    enum = message.DESCRIPTOR.fields_by_name[name].enum_type
    if enum is not None:
        prefix = enum.values[0].name.removesuffix("UNSPECIFIED")
        words = {known.name.removeprefix(prefix).lower(): known.number for known in enum.values[1:]}
        if not isinstance(value, str) or value not in words:
            raise InputError(f"{keyword} is {value!r}; it is one of {', '.join(words)}")
        given = words[value]
    try:
        if isinstance(given, list):
            getattr(message, name).extend(given)
        else:
            setattr(message, name, given)
    except (TypeError, ValueError) as error:
        raise InputError(f"{keyword} is {value!r}: {error}") from None


def set_options(message: Any, options: dict[str, Any]) -> Any:
    """Sets the fields that are called as an option, and gives the message. Options of the density lie beside the others."""
    for field in message.DESCRIPTOR.fields:
        if field.name != "density":
            set_option(message, field.name, options.get(field.name))
            continue
        for inner in field.message_type.fields:
            keyword = "density" if inner.name == "source" else inner.name
            set_option(message.density, inner.name, options.get(keyword), keyword)
    return message


#: Arrays beside a surface, their keywords, and how they are sent.
BESIDE = (
    ("seeds", "seeds", _floats),
    ("edge_lengths", "sizes", _doubles),
    ("weights", "weights", _doubles),
    ("metric", "metric", _doubles),
    ("creases", "creases", _indices),
)


def _spec(surface: Surface, carried: Attributes | None, options: dict[str, Any], patience: float, **work: Any) -> Flow:
    """Uploads what a job needs, and gives its specification."""
    spec = job_pb2.JobSpec(result=job_pb2.ResultFormat(arrays=True), **work)
    set_option(spec, "backend", options.get("backend"))
    spec.mesh.CopyFrom((yield from _mesh(surface, carried, patience)))
    for name, keyword, send in BESIDE:
        if options.get(keyword) is not None:
            getattr(spec.arrays, name).CopyFrom((yield from send(options[keyword], patience)))
    return spec


def remesh_spec(surface: Surface, options: dict[str, Any], carried: Attributes | None, patience: float) -> Flow:
    """Uploads what a remesh needs, and gives its specification."""
    measure = "topology" if options.get("measure") is False else None
    work = set_options(remesh_pb2.RemeshOptions(), {**options, "measure": measure})
    return (yield from _spec(surface, carried, options, patience, remesh=work))


def remesh(
    surface: Surface,
    options: dict[str, Any],
    carried: Attributes | None,
    listen: Engine | None,
    started: Callable[[str], object],
    patience: float,
) -> Flow:
    """A remesh; gives what the engine's call gives."""
    spec = yield from remesh_spec(surface, options, carried, patience)
    return remesh_arrays((yield from done(spec, listen, started, patience)))


def remesh_arrays(blobs: dict[str, bytes]) -> dict[str, Any]:
    """The arrays of a remesh, of the blobs of its result."""
    made: dict[str, Any] = {
        "vertices": _table(blobs["positions"], "<f8", 3),
        "faces": _table(blobs["facets"], "<u4", 3).astype(np.int32),
        "vertex_seeds": np.frombuffer(blobs["vertex_seeds"], "<u4").astype(np.int32),
        "creases": _table(blobs["creases"], "<u4", 2).astype(np.int32),
        "seeds": _table(blobs["seeds"], "<f8", 3),
        "report": blobs["report"],
    }
    attributes: dict[str, Any] = {}
    for name, form, columns, to in (
        ("normals", "<f8", 3, "normals"),
        ("normal_corners", "<u4", 3, "normal_corners"),
        ("texture_coordinates", "<f8", 2, "texture"),
        ("texture_corners", "<u4", 3, "texture_corners"),
    ):
        if name in blobs:
            table = _table(blobs[name], form, columns)
            attributes[to] = table.astype(np.int32) if form == "<u4" else table
    if "colours" in blobs:
        eight = len(blobs["colours"]) == 4 * len(made["vertices"])
        colours = _table(blobs["colours"], "u1" if eight else "<f8", 4)
        attributes["colours"] = colours / 255.0 if eight else colours
        attributes["colours_of_eight_bits"] = eight
    if "regions" in blobs:
        attributes["regions"] = np.frombuffer(blobs["regions"], "<i8")
        named = json.loads(blobs["region_names"])
        attributes["region_names"] = [(region["number"], region["name"]) for region in named]
    scalars = {}
    for name, data in blobs.items():
        if name.startswith("scalar."):
            # Its name, and where it is no double a vertex, the form and how many numbers a vertex has.
            _, name, form, components = [*name.split("."), "F64", "1"][:4]
            scalars[name] = (np.frombuffer(data, _dtype(form)), form, int(components))
    if attributes or scalars:
        made["attributes"] = {**attributes, "scalars": scalars}
    return made


def rvd(surface: Surface, options: dict[str, Any], started: Callable[[str], object], patience: float) -> Flow:
    """A diagram; gives what the engine's call gives."""
    outputs = [remesh_pb2.RVD_OUTPUT_CENTROIDS, remesh_pb2.RVD_OUTPUT_SUMS]
    if options["pieces"]:
        outputs.append(remesh_pb2.RVD_OUTPUT_CELLS)
    work = set_options(remesh_pb2.DiagramOptions(outputs=outputs), options)
    spec = yield from _spec(surface, None, options, patience, rvd=work)
    blobs = yield from done(spec, None, started, patience)
    given = options["seeds"]
    made: dict[str, Any] = {
        "seeds": _table(blobs["seeds"], "<f8", 3) if given is None else np.asarray(given, dtype=np.float64),
        "centroids": _table(blobs["centroids"], "<f8", 3),
    }
    for name in ("masses", "areas", "energies"):
        made[name] = np.frombuffer(blobs[name], "<f8")
    if options["pieces"]:
        made.update(_cells(blobs["cells"]))
    return made


def _table(data: bytes, form: str, columns: int) -> Any:
    return np.frombuffer(data, form).reshape(-1, columns)


def _cells(data: bytes) -> dict[str, Any]:
    """The pieces in a binary PLY file of polygons, as the service writes it."""
    header, _, body = data.partition(b"end_header\n")
    lines = [line.split() for line in header.decode("ascii").splitlines()]
    counts = {line[1]: int(line[2]) for line in lines if line and line[0] == "element"}
    element = ""
    names: dict[str, list[list[str]]] = {}
    for line in lines:
        if line[0] == "element":
            element = line[1]
        elif line[0] == "property":
            names.setdefault(element, []).append(line[1:])
    kinds = {"double": "<f8", "float": "<f4", "uchar": "u1", "uint": "<u4", "int": "<i4"}
    vertex = np.dtype([(prop[1], kinds[prop[0]]) for prop in names["vertex"]])
    vertices = np.frombuffer(body, vertex, counts["vertex"])
    at = counts["vertex"] * vertex.itemsize
    rest = [(prop[1], kinds[prop[0]]) for prop in names["face"] if prop[0] != "list"]
    size, index = (np.dtype(kinds[name]) for name in next(p for p in names["face"] if p[0] == "list")[1:3])
    tail = np.dtype(rest)
    corners, faces, seeds = [], [], []
    for _ in range(counts["face"]):
        many = int(np.frombuffer(body, size, 1, at)[0])
        at += size.itemsize
        corners.append(np.frombuffer(body, index, many, at))
        at += many * index.itemsize
        values = np.frombuffer(body, tail, 1, at)[0]
        at += tail.itemsize
        faces.append(values["facet"])
        seeds.append(values["seed"])
    positions = np.column_stack([vertices["x"], vertices["y"], vertices["z"]])
    order = np.concatenate(corners) if corners else np.zeros(0, dtype=np.int64)
    offsets = np.concatenate([[0], np.cumsum([len(c) for c in corners])])
    return {
        "piece_faces": np.array(faces, dtype=np.int32),
        "piece_seeds": np.array(seeds, dtype=np.int32),
        "piece_offsets": offsets.astype(np.int32),
        "piece_vertices": positions[order],
    }
