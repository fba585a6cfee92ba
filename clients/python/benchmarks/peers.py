"""Remeshes surfaces with Tessera and with other programs, measures all results alike, and prints tables in Markdown.

Usage: python peers.py COMMAND FOLDER [VORPALITE]
COMMAND is `tessera`. FOLDER holds rocker-arm.obj, fandisk.obj and nefertiti.obj. VORPALITE is geogram's program, if there is one.
The environment that `tests/python/venv.sh` makes has the other programs; mmgs comes with mmgpy.

Each program is called as its documentation shows, with its defaults; mmgs is allowed a distance of 1 % of the diagonal, since
less makes it add vertices. Programs that take an edge length are called again with another length until
the number of vertices is within 2 %, and the last call counts. The least time of three runs counts. It is without reading and
writing, except for mmgs and vorpalite, which do both themselves. `tessera measure` measures all results.
"""

from __future__ import annotations

import importlib.metadata
import json
import math
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import meshio
import mmgpy
import numpy as np
import pyacvd
import pymeshlab
import pyvista

# Seconds since some time.
Clock = Callable[[], float]

SURFACES = {"rocker-arm": 5000, "fandisk": 3000, "nefertiti": 50000}
ROUNDS = 3
COLUMNS = {
    "s": ("seconds", "{:.2f}"),
    "Q min": ("q_min", "{:.2f}"),
    "Q mean": ("q_avg", "{:.3f}"),
    "smallest angle": ("theta_min_deg", "{:.1f}°"),
    "valence 5-7": ("v567_percent", "{:.1f} %"),
    "Hausdorff": ("hausdorff_percent", "{:.3f} %"),
    "RMS": ("rms_percent", "{:.3f} %"),
}


class Surface:
    """A surface in the forms that programs take."""

    def __init__(self, path: Path, points: int, work: Path) -> None:
        self.path, self.points, self.work = path, points, work
        mesh = meshio.read(path)
        self.vertices = np.ascontiguousarray(mesh.points)
        self.faces = np.ascontiguousarray(mesh.cells_dict["triangle"])
        self.medit = work / "in.mesh"
        meshio.Mesh(self.vertices, [("triangle", self.faces)]).write(self.medit)
        self.diagonal = float(np.linalg.norm(np.ptp(self.vertices, axis=0)))
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        area = 0.5 * float(np.linalg.norm(np.cross(b - a, c - a), axis=1).sum())
        # Of equilateral triangles, of which there are twice as many as vertices.
        self.edge = math.sqrt(2 * area / (math.sqrt(3) * points))

    def write(self, vertices: np.ndarray, faces: np.ndarray) -> Path:
        path = self.work / "out.ply"
        meshio.Mesh(np.asarray(vertices, dtype=float), [("triangle", np.asarray(faces, dtype=np.int32))]).write(path)
        return path


def by_length(surface: Surface, remesh: Callable[[float], tuple[Path, int]]) -> Path:
    """Calls with other lengths until the number of vertices is as wanted."""
    length = surface.edge
    for _ in range(8):
        path, count = remesh(length)
        if abs(count / surface.points - 1) < 0.02:
            break
        length *= math.sqrt(count / surface.points)
    return path


def tessera(command: str, surface: Surface) -> tuple[Path, float]:
    out, report = surface.work / "out.ply", surface.work / "report.json"
    arguments = [command, "remesh", surface.path, "--points", str(surface.points), "--backend", "parallel", "--quiet"]
    subprocess.run([*arguments, "-o", out, "--report", report], check=True)
    times = json.loads(report.read_text())["timings_ms"]
    return out, 1e-3 * (times["total"] - times["read"] - times["write"])


def with_pyacvd(surface: Surface) -> tuple[Path, float]:
    mesh = pyvista.PolyData.from_regular_faces(surface.vertices, surface.faces)
    start = time.perf_counter()
    clustering = pyacvd.Clustering(mesh)
    # As its examples do: at least ten vertices a cluster.
    while clustering.mesh.n_points < 10 * surface.points:
        clustering.subdivide(1)
    clustering.cluster(surface.points)
    result = clustering.create_mesh()
    taken = time.perf_counter() - start
    return surface.write(result.points, result.regular_faces), taken


def with_meshlab(surface: Surface, clock: Clock = time.perf_counter) -> tuple[Path, float]:
    taken = 0.0

    def remesh(length: float) -> tuple[Path, int]:
        nonlocal taken
        meshes = pymeshlab.MeshSet()
        meshes.add_mesh(pymeshlab.Mesh(surface.vertices, surface.faces))
        start = clock()
        meshes.meshing_isotropic_explicit_remeshing(targetlen=pymeshlab.PureValue(length))
        taken = clock() - start
        mesh = meshes.current_mesh()
        return surface.write(mesh.vertex_matrix(), mesh.face_matrix()), mesh.vertex_number()

    return by_length(surface, remesh), taken


def with_mmgs(surface: Surface, *further: str, clock: Clock = time.perf_counter) -> tuple[Path, float]:
    taken = 0.0
    program = Path(sys.executable).with_name("mmgs")

    def remesh(length: float) -> tuple[Path, int]:
        nonlocal taken
        out = surface.work / "out.mesh"
        options = ["-v", "0", "-hausd", 1e-2 * surface.diagonal, "-hsiz", length, *further]
        start = clock()
        subprocess.run([program, *map(str, options), surface.medit, out], check=True, capture_output=True)
        taken = clock() - start
        mesh = meshio.read(out)
        return surface.write(mesh.points, mesh.cells_dict["triangle"]), len(mesh.points)

    return by_length(surface, remesh), taken


def with_geogram(program: str, surface: Surface) -> tuple[Path, float]:
    out = surface.work / "out.obj"
    options = ["profile=scan", "remesh=true", "remesh:anisotropy=0", "post=false", f"remesh:nb_pts={surface.points}"]
    start = time.perf_counter()
    subprocess.run([program, *options, surface.path, out], check=True, capture_output=True)
    return out, time.perf_counter() - start


def version(package: str) -> str:
    """The first two numbers."""
    return ".".join(importlib.metadata.version(package).split(".")[:2])


def measured(command: str, surface: Surface, path: Path) -> dict[str, float]:
    out = subprocess.run([command, "measure", surface.path, path, "--json"], check=True, capture_output=True).stdout
    told = json.loads(out)
    return {"vertices": told["remesh"]["vertices"], **told["quality"]}


def row(first: list[str], found: dict[str, float]) -> str:
    return "| " + " | ".join([*first, *(form.format(found[key]) for key, form in COLUMNS.values())]) + " |"


def table(first: list[str], rows: list[str]) -> None:
    heads = [*first, *COLUMNS]
    print("| " + " | ".join(heads) + " |", "| " + " | ".join("---" for _ in heads) + " |", *rows, "", sep="\n")


def main() -> None:
    command, folder = sys.argv[1], Path(sys.argv[2])
    programs: dict[str, Callable[[Surface], tuple[Path, float]]] = {
        "tessera": lambda surface: tessera(command, surface),
        f"pyacvd {version('pyacvd')}": with_pyacvd,
        f"MeshLab {version('pymeshlab')}": with_meshlab,
        f"mmgs {'.'.join(mmgpy.MMG_VERSION.split('.')[:2])}": with_mmgs,
    }
    if len(sys.argv) > 3:
        programs["geogram"] = lambda surface: with_geogram(sys.argv[3], surface)
    found: dict[str, list[dict[str, float]]] = {name: [] for name in programs}
    rows = []
    for mesh, points in SURFACES.items():
        for name, program in programs.items():
            with tempfile.TemporaryDirectory() as work:
                surface = Surface(folder / f"{mesh}.obj", points, Path(work))
                runs = [program(surface) for _ in range(ROUNDS)]
                figures = {"seconds": min(taken for _, taken in runs), **measured(command, surface, runs[-1][0])}
            found[name].append(figures)
            rows.append(row([f"{mesh}, {points:,}", name, f"{figures['vertices']:,}"], figures))
            print(rows[-1], file=sys.stderr)
    keys = [key for key, _ in COLUMNS.values()]
    medians = {name: {key: statistics.median(one[key] for one in all_of) for key in keys} for name, all_of in found.items()}
    table(["median of three"], [row([name], figures) for name, figures in medians.items()])
    table(["mesh, points", "program", "vertices"], rows)


if __name__ == "__main__":
    main()
