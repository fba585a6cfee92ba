"""Promise: examples in the docstrings run, and the types hold."""

from __future__ import annotations

import doctest
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tessera_remesh
import tessera_remesh.calls


@pytest.mark.parametrize("module", [tessera_remesh, tessera_remesh.calls], ids=lambda m: m.__name__)
def test_examples_run(module):
    failed, tried = doctest.testmod(module)
    assert tried > 0 and failed == 0


def run_blocks(page: str, instead: dict[str, str] | None = None) -> dict[str, Any]:
    """Runs the blocks of Python of a page, one after the other, and returns their variables."""
    text = (Path(__file__).parents[3] / "docs" / page).read_text()
    for old, new in (instead or {}).items():
        text = text.replace(old, new)
    names: dict[str, Any] = {"__name__": "guide"}
    for block in re.findall(r"^```python\n(.*?)^```$", text, re.MULTILINE | re.DOTALL):
        exec(compile(block, f"docs/{page}", "exec"), names)
    return names


def smallest_angle(mesh: Any) -> float:
    """Of a pyvista mesh, in degrees."""
    corners = np.asarray(mesh.points, dtype=float)[mesh.regular_faces]
    sides = [corners[:, (k + 1) % 3] - corners[:, k] for k in range(3)]
    units = [side / np.linalg.norm(side, axis=1, keepdims=True) for side in sides]
    return float(min(np.degrees(np.arccos(-(units[k] * units[k - 1]).sum(axis=1).clip(-1, 1))).min() for k in range(3)))


def test_snippets_of_other_packages_and_ours_do_the_same(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    pytest.importorskip("pyacvd")
    pytest.importorskip("pymeshlab")
    pyvista = pytest.importorskip("pyvista")
    monkeypatch.chdir(tmp_path)
    names = run_blocks("coming-from.md")
    assert abs(names["by_tessera"].n_points / names["by_pyacvd"].n_points - 1) < 0.02
    assert smallest_angle(names["by_tessera"]) > smallest_angle(names["by_pyacvd"])
    assert "height" in names["by_tessera"].point_data
    meshes = [pyvista.read(tmp_path / f"ring-by-{name}.ply") for name in ("meshlab", "tessera")]
    assert 0.7 < meshes[0].n_points / meshes[1].n_points < 1.4
    assert smallest_angle(meshes[1]) > smallest_angle(meshes[0])
    assert names["new_faces"].shape[1] == 3


def test_the_guide_runs(
    endpoint: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("grpc")
    # It writes files.
    monkeypatch.chdir(tmp_path)
    names = run_blocks("python.md", {"http://127.0.0.1:50051": endpoint})
    with capsys.disabled():
        assert names["there"].report.faces == names["result"].report.faces


def test_the_notebook_runs(tmp_path: Path):
    nbclient, nbformat = pytest.importorskip("nbclient"), pytest.importorskip("nbformat")
    pytest.importorskip("pyacvd")
    notebook = nbformat.read(Path(__file__).parents[1] / "examples" / "remeshing.ipynb", as_version=4)
    nbclient.NotebookClient(notebook, timeout=300, resources={"metadata": {"path": str(tmp_path)}}).execute()


def test_types_hold():
    pytest.importorskip("mypy")
    here = Path(__file__).parents[1]
    # The source, not what is installed: beside that, mypy takes the modules of others for ours.
    package = here / "python" / "tessera_remesh"
    command = [sys.executable, "-m", "mypy", "--config-file", str(here / "pyproject.toml"), str(package)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout
