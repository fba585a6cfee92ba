"""Promise: with `--blobs s3://...` inputs and results lie in a bucket, and outlive the server's end."""

from __future__ import annotations

import os
import subprocess
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("grpc")
moto = pytest.importorskip("moto.server")

from tessera_remesh.service import Client, flows  # noqa: E402

BUCKET = "s3://meshes/tessera"


@pytest.fixture
def store() -> Iterator[str]:
    """The URL of a store that has the bucket."""
    server = moto.ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    urllib.request.urlopen(urllib.request.Request(f"http://{host}:{port}/meshes", method="PUT"))
    yield f"http://{host}:{port}"
    server.stop()


def command(program: str, folder: Path) -> list[str]:
    return [program, "serve", "--data-dir", str(folder), "--blobs", BUCKET, "--listen", "127.0.0.1:0", "--backend", "serial"]


def environment(store: str) -> dict[str, str]:
    keys = {"AWS_REGION": "us-east-1", "AWS_ACCESS_KEY_ID": "test", "AWS_SECRET_ACCESS_KEY": "test"}
    return {**os.environ, **keys, "AWS_ENDPOINT": store, "AWS_ALLOW_HTTP": "true"}


def test_blobs_in_a_bucket_outlive_the_server(surface, program, store, tmp_path: Path):
    def start() -> tuple[subprocess.Popen[str], Client]:
        server = subprocess.Popen(command(program, tmp_path), env=environment(store), stdout=subprocess.PIPE, text=True)
        assert server.stdout is not None
        line = server.stdout.readline()
        assert line.startswith("tessera listens on "), line
        return server, Client(f"http://{line.split()[-1]}", tenant="python")

    # Longer than a part of an upload to S3.
    large = np.random.default_rng(2).bytes(12 << 20)
    server, client = start()
    try:
        with client:
            digest = client.put(large)
            assert client.read(digest) == large
            job = client.submit(*surface, 200)
            before = client.result(job)
            positions = client._run(flows.result(job, 60.0))["positions"]
    finally:
        server.kill()
        server.wait()
    listing = urllib.request.urlopen(f"{store}/meshes?list-type=2").read().decode()
    assert positions in listing and "tessera/blobs/" in listing, listing
    assert not list(tmp_path.rglob(positions)), "no copy beside the journal"

    server, client = start()
    try:
        with client:
            assert np.array_equal(client.result(job).vertices, before.vertices) and client.read(digest) == large
    finally:
        server.terminate()
        assert server.wait(timeout=60) == 0


def test_a_server_without_its_store_does_not_start(program, tmp_path: Path):
    refused = subprocess.run(
        command(program, tmp_path), env=environment("http://127.0.0.1:9"), capture_output=True, text=True, timeout=300
    )
    assert refused.returncode == 69 and "--blobs" in refused.stderr, refused
