"""Promise: a server gives the same bits as this process and the command; what it refuses is told; what is cut goes on."""

from __future__ import annotations

import asyncio
import hashlib
import subprocess
import threading
import time
from pathlib import Path

import numpy as np
import pytest
import tessera_remesh
from tessera_remesh import Attributes

pytest.importorskip("grpc")

from tessera_remesh.service import AsyncClient, Client, ConnectionLost, JobFailed, ServerError, flows  # noqa: E402
from tessera_remesh.service._stubs import blob_pb2, job_pb2  # noqa: E402

from conftest import torus  # noqa: E402


def same(a: tessera_remesh.Remesh, b: tessera_remesh.Remesh) -> bool:
    return np.array_equal(a.vertices, b.vertices) and np.array_equal(a.faces, b.faces) and np.array_equal(a.seeds, b.seeds)


def says(report: object, wanted: object) -> bool:
    """Whether a report has all of another. A server gives figures their names of before too."""
    if isinstance(wanted, dict):
        return isinstance(report, dict) and all(says(report.get(name), value) for name, value in wanted.items())
    return report == wanted


OPTIONS = [
    {"points": 300},
    {"points": 300, "seed": 7, "lloyd": 2, "newton": 3, "placement": "surface", "projection": "surface"},
    {"points": 200, "density": "curvature", "gradation": 0.5, "adaptivity": 0.5},
    {"edge_length": 0.4, "density": "lfs", "boundaries": "free", "thin": "even", "measure": False},
    {"points": 200, "density": np.linspace(1, 9, 1800)},
    {"sizes": np.linspace(0.2, 0.6, 1800)},
    {"metric": np.linspace([4, 0, 9, 0, 0, 4], [9, 1, 4, 0, 0, 9], 1800)},
    {"points": 200, "max_deviation": 1.0, "max_points": 400},
    {"points": 200, "max_deviation": 1.0, "sizes": np.linspace(1, 3, 1800)},
    {"points": 300, "creases": [[0, 30], [30, 60]], "crease_angle": 0.0},
    {"seeds": torus(10, 20)[0], "lloyd": 1, "newton": 0},
    {"points": 200, "attributes": {"height": np.arange(1800.0)}},
    {"facets": 500},
    {"points": 1200, "keep": ["box:0.9,-9,-9,9,9,9"], "source_map": True, "attributes": {"height": np.arange(1800.0)}},
    {"points": 600, "size_in": "box:0.9,-9,-9,9,9,9=0.4"},
    {"points": "20%"},
]


@pytest.mark.parametrize("options", OPTIONS, ids=[",".join(sorted(options)) for options in OPTIONS])
def test_the_same_bits_here_and_there(surface, endpoint, options):
    here = tessera_remesh.remesh(*surface, backend="parallel", **options)
    there = tessera_remesh.remesh(*surface, endpoint=endpoint, **options)
    assert same(here, there)
    assert says(there.report.raw["result"], here.report.raw["result"])
    if here.attributes is not None:
        assert np.array_equal(here.attributes.scalars["height"], there.attributes.scalars["height"])


def test_the_same_bits_by_the_command(surface, program, tmp_path: Path):
    meshio = pytest.importorskip("meshio")
    vertices, faces = surface
    # Not OBJ, whose vertices are numbered by their first use.
    meshio.Mesh(vertices, [("triangle", faces.astype(np.int32))]).write(tmp_path / "in.ply")
    command = [program, "remesh", "in.ply", "--points", "300", "--backend", "parallel", "-o", "out.ply", "--quiet"]
    subprocess.run(command, cwd=tmp_path, check=True)
    written = meshio.read(tmp_path / "out.ply")
    here = tessera_remesh.remesh(vertices, faces, points=300, backend="parallel")
    assert np.array_equal(written.points, here.vertices)
    assert np.array_equal(written.cells_dict["triangle"], here.faces)


def test_warnings_are_the_same_here_and_there(surface, endpoint):
    options = {"points": 60, "max_deviation": 1e-3, "max_points": 80, "backend": "serial"}
    with pytest.warns(tessera_remesh.RemeshWarning, match="the bound on the deviation is missed") as here:
        result = tessera_remesh.remesh(*surface, **options)
    with pytest.warns(tessera_remesh.RemeshWarning) as there:
        tessera_remesh.remesh(*surface, **options, endpoint=endpoint)
    assert [str(w.message) for w in here] == [str(w.message) for w in there]
    assert [w["message"] for w in result.report.warnings] == [str(w.message) for w in here]
    assert {w.filename for w in (*here, *there)} == {__file__}


def test_all_attributes_travel(surface, endpoint):
    vertices, faces = surface
    attributes = Attributes(
        normals=vertices.copy(),
        texture=vertices[:, :2].copy(),
        colours=np.tile(np.array([[1, 2, 3, 4]], dtype=np.uint8), (len(vertices), 1)),
        scalars={
            "a": vertices[:, 0].copy(),
            "label": np.where(vertices[:, 1] > 0, -7, 40).astype(np.int16),
            "inside": vertices[:, 2] > 0,
            "velocity": vertices * 2,
            "pair": np.tile([[3, 4]], (len(vertices), 1)),
        },
        regions=np.where(vertices[faces].sum(axis=1)[:, 2] > 0.4, 3, -200).astype(np.int16),
        region_names={3: "north", 8: "nowhere"},
    )
    here = tessera_remesh.remesh(vertices, faces, points=200, attributes=attributes, backend="parallel").attributes
    there = tessera_remesh.remesh(vertices, faces, points=200, attributes=attributes, endpoint=endpoint).attributes
    for name in ("normals", "texture", "texture_corners", "colours"):
        assert np.array_equal(getattr(here, name), getattr(there, name)), name
    assert here.colours.dtype == there.colours.dtype == np.uint8
    assert set(there.scalars) == set(attributes.scalars)
    for name, values in attributes.scalars.items():
        assert here.scalars[name].dtype == there.scalars[name].dtype == values.dtype, name
        assert np.array_equal(here.scalars[name], there.scalars[name]), name
        assert here.scalars[name].shape[1:] == values.shape[1:], name
    assert set(there.scalars["label"]) == {-7, 40} and (there.scalars["pair"] == [3, 4]).all()
    assert here.regions.dtype == there.regions.dtype == np.int16 and np.array_equal(here.regions, there.regions)
    assert set(there.regions) == {3, -200} and here.region_names == there.region_names == attributes.region_names


def test_diagrams_and_steps(surface, endpoint):
    here = tessera_remesh.rvd(*surface, points=50, backend="parallel")
    there = tessera_remesh.rvd(*surface, points=50.0, endpoint=endpoint)
    for name in ("seeds", "centroids", "areas", "energies", "masses", "piece_faces", "piece_seeds", "piece_offsets"):
        assert np.array_equal(getattr(here, name), getattr(there, name)), name
    assert np.allclose(here.piece_vertices, there.piece_vertices, atol=1e-12)
    options = {"points": 100, "lloyd": 2, "newton": 2}
    pairs = zip(
        tessera_remesh.cvt(*surface, backend="parallel", **options),
        tessera_remesh.cvt(*surface, endpoint=endpoint, **options),
        strict=True,
    )
    for a, b in pairs:
        assert a.energy == b.energy and np.array_equal(a.seeds, b.seeds)
    for options in (
        {"sizes": np.linspace(0.4, 0.8, 1800), "adaptivity": 0.5, "seed": 3},
        {"seeds": torus(10, 5)[0], "density": np.linspace(1, 9, 1800)},
        {"points": 60, "density": "curvature", "projection": "surface"},
    ):
        here = next(tessera_remesh.cvt(*surface, backend="parallel", **options))
        assert np.array_equal(here.seeds, next(tessera_remesh.cvt(*surface, endpoint=endpoint, **options)).seeds)
    weighted = {"seeds": torus(10, 5)[0], "weights": np.linspace(1, 9, 1800)}
    here = tessera_remesh.rvd(*surface, backend="parallel", **weighted)
    assert np.array_equal(here.masses, tessera_remesh.rvd(*surface, endpoint=endpoint, **weighted).masses)


def test_refusals_are_told(surface, endpoint):
    with pytest.raises(ServerError) as refused:
        tessera_remesh.remesh(*surface, points=100, crease_angle=500.0, endpoint=endpoint)
    assert refused.value.code == "INVALID_ARGUMENT" and "crease_angle" in refused.value.fields
    for options, word in (
        ({"max_points": 200}, "max_points"),
        ({"seeds": np.zeros((3, 3))}, "points"),
        ({"density": "lfs", "sizes": np.ones(1800)}, "density"),
    ):
        with pytest.raises(ServerError, match="INVALID_ARGUMENT: " + word):
            tessera_remesh.remesh(*surface, points=100, endpoint=endpoint, **options)
    with pytest.raises(JobFailed, match="failed: crease 0"):
        tessera_remesh.remesh(*surface, points=100, creases=[[0, 1700]], endpoint=endpoint)
    with pytest.raises(ServerError, match="INVALID_ARGUMENT: gradation"):
        next(tessera_remesh.cvt(*surface, points=100, gradation=-1.0, endpoint=endpoint))
    # What the schema does not have is not sent.
    for options in ({"density": "edge_lengths"}, {"thin": ""}, {"placement": ["fitted"]}, {"backend": "abacus"}, {"points": 2.5}, {"seed": -1}):
        with pytest.raises(tessera_remesh.InputError, match=next(iter(options)) + " is "):
            tessera_remesh.remesh(*surface, **{"points": 100, **options}, endpoint=endpoint)
    with pytest.raises(tessera_remesh.InputError, match="projection is 'up'; it is one of free, surface"):
        next(tessera_remesh.cvt(*surface, points=100, projection="up", endpoint=endpoint))
    with pytest.raises(ConnectionLost):
        with Client("http://127.0.0.1:9", patience=0.5) as client:
            client.remesh(*surface, 100)
    for wrong in ("127.0.0.1:50051", "ftp://x", "http://", "http://127.0.0.1:1/x"):
        with pytest.raises(tessera_remesh.InputError, match="endpoint"):
            Client(wrong)
    with pytest.raises(tessera_remesh.InputError, match="https"):
        Client("http://example.org:50051", key="tsr_x")


def test_jobs_outlive_the_connection(surface, endpoint):
    with Client(endpoint) as client:
        job = client.submit(*surface, 300, request_id="a")
        assert client.submit(*surface, 300, request_id="a") == job
        with pytest.raises(ServerError, match="ALREADY_EXISTS"):
            client.submit(*surface, 400, request_id="a")
    with Client(endpoint) as client:
        result = client.result(job)
        assert client.state(job) == "succeeded"
        assert client.submit(*surface, 300, reuse="same_bits") == job
        with pytest.raises(tessera_remesh.InputError, match="reuse"):
            client.submit(*surface, 300, reuse="always")
        client.delete(job)
        with pytest.raises(ServerError, match="NOT_FOUND"):
            client.state(job)
    assert same(result, tessera_remesh.remesh(*surface, points=300, backend="parallel"))


def test_a_cancelled_job_is_told(endpoint):
    with Client(endpoint) as client:
        job = client.submit(*torus(300, 150), 100_000)
        client.cancel(job)
        with pytest.raises(JobFailed) as failed:
            client.result(job)
    assert failed.value.state == "cancelled" and failed.value.job == job


def test_an_interrupted_call_cancels_its_job(endpoint):
    def stop(event: tessera_remesh.Progress) -> None:
        if event.step is not None:
            raise KeyboardInterrupt

    before = time.monotonic()
    with pytest.raises(KeyboardInterrupt):
        tessera_remesh.remesh(*torus(300, 150), points=100_000, endpoint=endpoint, progress=stop)
    assert time.monotonic() - before < 60


def test_asyncio(surface, endpoint):
    async def work() -> list[tessera_remesh.Remesh]:
        async with AsyncClient(endpoint) as client:
            assert await client.read(await client.put(b"bytes")) == b"bytes"
            cells = await client.rvd(*surface, points="2e1")
            assert len(cells.areas) == 20
            return await asyncio.gather(*(client.remesh(*surface, 200, seed=seed) for seed in (0, 0, 1)))

    first, second, third = asyncio.run(work())
    assert same(first, second) and not same(first, third)

    async def cancelled() -> None:
        async with AsyncClient(endpoint) as client:
            task = asyncio.create_task(client.remesh(*torus(300, 150), 100_000))
            await asyncio.sleep(1)
            task.cancel()
            with pytest.raises(asyncio.CancelledError):
                await task

    asyncio.run(cancelled())


def test_blobs(endpoint):
    data = np.random.default_rng(1).bytes(3 * (1 << 20) + 17)
    with Client(endpoint) as client:
        digest = client.put(data)
        assert client.put(data) == digest and client.read(digest) == data
        assert client.read(client.put(b"")) == b""
        with pytest.raises(ServerError, match="NOT_FOUND"):
            client.read("0" * 64)


def test_an_upload_that_was_cut_goes_on(endpoint, monkeypatch):
    data = np.random.default_rng(3).bytes(3 * (1 << 20) + 17)
    digest = hashlib.sha256(data).hexdigest()
    pieces, starts = flows._pieces, []
    monkeypatch.setattr(flows, "_pieces", lambda data, digest, start: starts.append(start) or pieces(data, digest, start))
    with Client(endpoint) as client:
        cut = flows.Upload("BlobService/Write", lambda: iter(list(pieces(data, digest, 0))[:2]), blob_pb2.WriteResponse)
        answer = client._do(cut, None)
        assert not answer.complete and answer.kept_bytes == 2 << 20
        assert client.put(data) == digest and client.read(digest) == data
    assert starts == [2 << 20]


def test_events_come_again_from_any_number(surface, endpoint):
    with Client(endpoint) as client:
        job = client.submit(*surface, 150)
        client.result(job)

        def events(after: int) -> list[job_pb2.JobEvent]:
            heard: list[job_pb2.JobEvent] = []
            asked = job_pb2.WatchJobRequest(id=job, after=after)
            hear = lambda answer: heard.append(answer.event)  # noqa: E731
            client._do(flows.Each("JobService/WatchJob", asked, job_pb2.WatchJobResponse, hear), None)
            return heard

        every = events(0)
        assert [event.number for event in every] == sorted({event.number for event in every})
        assert events(5) == [event for event in every if event.number > 5]
        assert every[-1].state.state == job_pb2.JOB_STATE_SUCCEEDED


def test_tenants_do_not_see_each_other(surface, endpoint):
    with Client(endpoint, tenant="one") as one, Client(endpoint, tenant="two") as two:
        job = one.submit(*surface, 100)
        with pytest.raises(ServerError, match="NOT_FOUND"):
            two.state(job)
        one.result(job)


def test_a_server_that_comes_back_is_waited_for(surface, program, tmp_path: Path):
    import socket

    # Bound and not listening, it keeps the port for the server.
    held = socket.socket()
    held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    held.bind(("127.0.0.1", 0))
    port = held.getsockname()[1]
    arguments = [program, "serve", "--data-dir", str(tmp_path / "data"), "--listen", f"127.0.0.1:{port}", "--backend", "parallel"]
    servers = []

    def start() -> None:
        servers.append(subprocess.Popen(arguments, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL))

    later = threading.Timer(2, start)
    later.start()
    try:
        with Client(f"http://127.0.0.1:{port}", patience=60) as client:
            killed = False

            def kill(event: tessera_remesh.Progress) -> None:
                nonlocal killed
                if event.step == 2 and not killed:
                    killed = True
                    servers[0].kill()
                    servers[0].wait()
                    start()

            result = client.remesh(*torus(200, 100), 20_000, progress=kill)
        assert killed
        assert same(result, tessera_remesh.remesh(*torus(200, 100), points=20_000, backend="parallel"))
    finally:
        later.join()
        for server in servers:
            server.terminate()
            server.wait(timeout=60)
        held.close()
