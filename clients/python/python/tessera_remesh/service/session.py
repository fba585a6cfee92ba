"""Centroidal iterations on a server, one step at a time over one stream."""

from __future__ import annotations

import queue
from collections.abc import Iterator
from typing import Any

import google_crc32c
import numpy as np

from ..meshes import Surface
from ..results import CvtStep
from ._stubs import remesh_pb2
from .flows import PIECE_BYTES, set_option, set_options

#: As the engine's test of convergence: see `steps`.
_END = object()


def _arrays(surface: Surface, options: dict[str, Any]) -> Iterator[tuple[Any, Any]]:
    yield remesh_pb2.ARRAY_KIND_POSITIONS, np.ascontiguousarray(surface.vertices, dtype="<f8")
    yield remesh_pb2.ARRAY_KIND_FACETS, np.ascontiguousarray(surface.faces, dtype="<u4")
    for name, kind in (
        ("seeds", remesh_pb2.ARRAY_KIND_SEEDS),
        ("weights", remesh_pb2.ARRAY_KIND_WEIGHTS),
        ("sizes", remesh_pb2.ARRAY_KIND_EDGE_LENGTHS),
    ):
        if options.get(name) is not None:
            yield kind, np.ascontiguousarray(options[name], dtype="<f8")


def _header(surface: Surface, options: dict[str, Any]) -> Any:
    def count(name: str) -> int:
        return 0 if options.get(name) is None else len(options[name])

    mesh = remesh_pb2.MeshHeader(
        vertices=len(surface.vertices), facets=len(surface.faces), weights=count("weights"), edge_lengths=count("sizes")
    )
    taken = set_options(remesh_pb2.CvtOptions(), options)
    header = remesh_pb2.CvtHeader(mesh=mesh, seeds=count("seeds"), options=taken)
    set_option(header, "backend", options.get("backend"))
    return header


def steps(
    channel: Any, metadata: Any, surface: Surface, options: dict[str, Any], lloyd: int, newton: int
) -> Iterator[CvtStep]:
    """Takes steps as they are asked for."""
    requests: queue.SimpleQueue[Any] = queue.SimpleQueue()
    of = channel.stream_stream(
        "/tessera.v1.RemeshService/Cvt",
        lambda request: request.SerializeToString(),
        remesh_pb2.CvtResponse.FromString,
    )
    stream = of(iter(requests.get, _END), metadata=metadata)
    try:
        requests.put(remesh_pb2.CvtRequest(header=_header(surface, options)))
        for kind, array in _arrays(surface, options):
            data = array.tobytes()
            for offset in range(0, len(data), PIECE_BYTES):
                piece = data[offset : offset + PIECE_BYTES]
                chunk = remesh_pb2.Chunk(kind=kind, offset=offset, data=piece, crc32c=google_crc32c.value(piece))
                requests.put(remesh_pb2.CvtRequest(chunk=chunk))
        requests.put(remesh_pb2.CvtRequest(start=remesh_pb2.CvtStart()))
        kinds = [(remesh_pb2.STEP_KIND_LLOYD, lloyd), (remesh_pb2.STEP_KIND_LBFGS, newton)]
        for kind in [kind for kind, count in kinds for _ in range(count)]:
            seeds = remesh_pb2.SEEDS_WANTED_LAST
            requests.put(remesh_pb2.CvtRequest(step=remesh_pb2.CvtStep(iterations=1, kind=kind, seeds=seeds)))
            yield _step(stream)
        requests.put(remesh_pb2.CvtRequest(finish=remesh_pb2.Finish()))
    finally:
        requests.put(_END)
        stream.cancel()


def _step(stream: Any) -> CvtStep:
    """The next step, and the seeds after it."""
    step, data = None, bytearray()
    for answer in stream:
        what = answer.WhichOneof("message")
        if what == "iteration":
            step = answer.iteration
        elif what == "chunk":
            data += answer.chunk.data
            if step is not None and len(data) == answer.chunk.total_bytes:
                return CvtStep(
                    index=step.index,
                    kind=step.kind,
                    energy=step.energy,
                    energy_ratio=step.energy_ratio,
                    gradient_norm=step.gradient_norm,
                    empty_cells=step.empty_cells,
                    milliseconds=step.ms,
                    converged=False,
                    seeds=np.frombuffer(bytes(data), "<f8").reshape(-1, 3),
                )
    raise RuntimeError("the server ended the session")
