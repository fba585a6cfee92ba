"""Surfaces and a server for the tests."""

from __future__ import annotations

import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest


def torus(around: int = 60, across: int = 30) -> tuple[np.ndarray, np.ndarray]:
    """A torus: (n, 3) float64 and (m, 3) int64."""
    u, v = np.meshgrid(
        np.arange(around) * 2 * np.pi / around, np.arange(across) * 2 * np.pi / across, indexing="ij"
    )
    r = 2 + np.cos(v)
    vertices = np.stack([r * np.cos(u), r * np.sin(u), np.sin(v)], axis=-1).reshape(-1, 3)
    i, j = np.meshgrid(np.arange(around), np.arange(across), indexing="ij")
    a, b = i * across + j, (i + 1) % around * across + j
    c, d = (i + 1) % around * across + (j + 1) % across, i * across + (j + 1) % across
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([a, c, d], -1).reshape(-1, 3)])
    return vertices, faces


@pytest.fixture
def surface() -> tuple[np.ndarray, np.ndarray]:
    return torus()


@pytest.fixture(scope="session")
def program() -> str:
    """The command `tessera`, which the environment variable TESSERA names."""
    path = os.environ.get("TESSERA")
    if not path:
        pytest.skip("TESSERA does not name the command")
    return str(Path(path).resolve())


@pytest.fixture(scope="session")
def endpoint(program: str, tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """A server on a loopback port."""
    folder = tmp_path_factory.mktemp("server")
    arguments = [program, "serve", "--data-dir", str(folder / "data"), "--listen", "127.0.0.1:0", "--backend", "parallel"]
    with open(folder / "log", "wb") as log:
        server = subprocess.Popen(arguments, stdout=subprocess.PIPE, stderr=log, text=True)
    assert server.stdout is not None
    try:
        for line in server.stdout:
            if line.startswith("tessera listens on "):
                yield f"http://{line.split()[-1]}"
                break
        else:
            pytest.fail((folder / "log").read_text())
    finally:
        server.terminate()
        assert server.wait(timeout=60) == 0
