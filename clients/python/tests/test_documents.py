"""Promise: examples in the docstrings run, and the types hold."""

from __future__ import annotations

import doctest
import re
import subprocess
import sys
from pathlib import Path

import pytest
import tessera_remesh
import tessera_remesh.calls


@pytest.mark.parametrize("module", [tessera_remesh, tessera_remesh.calls], ids=lambda m: m.__name__)
def test_examples_run(module):
    failed, tried = doctest.testmod(module)
    assert tried > 0 and failed == 0


def test_the_guide_runs(
    endpoint: str, capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    pytest.importorskip("grpc")
    # It writes files.
    monkeypatch.chdir(tmp_path)
    guide = (Path(__file__).parents[3] / "docs" / "python.md").read_text().replace("http://127.0.0.1:50051", endpoint)
    names: dict[str, object] = {"__name__": "guide"}
    for block in re.findall(r"^```python\n(.*?)^```$", guide, re.MULTILINE | re.DOTALL):
        exec(compile(block, "docs/python.md", "exec"), names)
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
