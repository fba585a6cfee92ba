"""Remeshes mechanical parts with Tessera and with other programs, measures all results alike, and prints a table in Markdown.

Usage: python parts.py COMMAND [PARTS [POINTS,... [LINES]]]
COMMAND is `tessera`, PARTS the number of parts (42) of `tessera shape`, all kinds in turn, POINTS the numbers of vertices
(500,1500,5000). Each result is a line of JSON in the file LINES; a run that was ended goes on behind the lines there. The
environment that `tests/python/venv.sh` makes has the other programs; mmgs comes with mmgpy.

The programs are called as in `peers.py`; mmgs with creases from 30 degrees, as the others have. A crease of the input is an edge
above 40 degrees. It is kept where the result has an edge above 20 degrees within a quarter of an edge length. Folded
edges are those above 150 degrees where the input has none. Seconds are those of all cores, and not of
a clock, which other work delays; of Tessera and mmgs with reading and writing.
"""

from __future__ import annotations

import json
import math
import resource
import statistics
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import meshio
import mmgpy
import numpy as np
from peers import Surface, tessera, version, with_meshlab, with_mmgs
from pymeshlab import PyMeshLabException
from scipy.spatial import cKDTree

KINDS = "bracket filleted ribs letters thread gear frame perforated drilled steps cup enclosure wedge slots".split()
# Feature over edge length at 1,500 vertices is from about 3 to 1/10, at 500 vertices down to 1/20.
FEATURES = [0.1, 0.03, 0.01, 0.05, 0.02, 0.005]

Figures = dict[str, Any]


def angles(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges of two facets, and the angles between the normals of these, degrees."""
    corners = vertices[faces]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1), 1e-300)[:, None]
    edges = np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1)
    owner = np.tile(np.arange(len(faces)), 3)
    order = np.lexsort((edges[:, 1], edges[:, 0]))
    edges, owner = edges[order], owner[order]
    same = np.flatnonzero((edges[1:] == edges[:-1]).all(axis=1))
    cosines = np.einsum("ij,ij->i", normals[owner[same]], normals[owner[same + 1]])
    return edges[same], np.degrees(np.arccos(np.clip(cosines, -1, 1)))


def samples(vertices: np.ndarray, edges: np.ndarray, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Points along edges, at most a step apart, and the length that each stands for."""
    a, b = vertices[edges[:, 0]], vertices[edges[:, 1]]
    lengths = np.linalg.norm(b - a, axis=1)
    counts = np.maximum(np.ceil(lengths / step), 1).astype(int)
    at = (np.concatenate([np.arange(n) for n in counts]) + 0.5) / np.repeat(counts, counts)
    points = np.repeat(a, counts, axis=0) + at[:, None] * np.repeat(b - a, counts, axis=0)
    return points, np.repeat(lengths / counts, counts)


def creases_kept(surface: Surface, vertices: np.ndarray, faces: np.ndarray) -> float:
    """The share of the length of the input's creases that the result has."""
    edges, turns = angles(surface.vertices, surface.faces)
    if not (turns > 40).any():
        return 1.0
    corners = vertices[faces]
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum()
    edge = math.sqrt(4 / math.sqrt(3) * area / len(faces))
    points, lengths = samples(surface.vertices, edges[turns > 40], 0.25 * edge)
    edges, turns = angles(vertices, faces)
    if not (turns > 20).any():
        return 0.0
    # Samples this dense find each edge within a quarter of an edge length to 2 % of that.
    there, _ = samples(vertices, edges[turns > 20], 0.05 * edge)
    near = cKDTree(there).query(points, distance_upper_bound=0.25 * edge)[0] < math.inf
    return float(lengths[near].sum() / lengths.sum())


def cpu() -> float:
    """Seconds of all cores that programs have taken that this one called."""
    of = resource.getrusage(resource.RUSAGE_CHILDREN)
    return of.ru_utime + of.ru_stime


def of_tessera(command: str, surface: Surface) -> tuple[Path, float]:
    before = cpu()
    path, _ = tessera(command, surface)
    return path, cpu() - before


def figures(command: str, surface: Surface, program: Callable[[Surface], tuple[Path, float]]) -> Figures:
    try:
        path, taken = program(surface)
    except (subprocess.SubprocessError, OSError, PyMeshLabException) as error:
        return {"failed": str(error)}
    mesh = meshio.read(path)
    vertices, faces = np.asarray(mesh.points, dtype=float), mesh.cells_dict["triangle"]
    out = subprocess.run([command, "measure", surface.path, path, "--json"], check=True, capture_output=True).stdout
    given, found = (json.loads(out)[name] for name in ("original", "remesh"))
    return {
        "seconds": taken,
        "kept": 100 * creases_kept(surface, vertices, faces),
        "folded": int((angles(vertices, faces)[1] > 150).sum()),
        "given_folded": int((angles(surface.vertices, surface.faces)[1] > 150).sum()),
        "crossing": found["crossings"]["count"],
        "given_crossing": given["crossings"]["count"],
        "topology": all(found[key] == given[key] for key in ("euler", "components", "boundary_edges")),
        "vertices": found["vertices"],
        **json.loads(out)["quality"],
    }


def summary(rows: list[Figures], names: list[str]) -> None:
    """One line a program, over all parts and numbers of vertices; shares are of those that it made."""
    heads = ["crease length kept: median", "worst", "with folded edges", "with crossing facets", "topology changed"]
    heads += ["Hausdorff: tessera is nearer", "smallest angle", "median s"]
    print("| program | " + " | ".join(heads) + " |", "| " + " | ".join("---" for _ in [0, *heads]) + " |", sep="\n")
    for name in names:
        made = [row for row in rows if "failed" not in row[name]]
        of = [row[name] for row in made]
        ours = [row["tessera"] for row in made]

        def share(what: list[bool]) -> str:
            return f"{sum(what)} of {len(what)}"

        # Distances below the rounding of files are alike.
        nearer = [a["hausdorff_percent"] <= max(b["hausdorff_percent"], 1e-3) for a, b in zip(ours, of, strict=True)]
        print(
            f"| {name} | {statistics.median(f['kept'] for f in of):.2f} % | {min(f['kept'] for f in of):.1f} %"
            f" | {share([f['folded'] > 0 for f in of if f['given_folded'] == 0])}"
            f" | {share([f['crossing'] > 0 for f in of if f['given_crossing'] == 0])}"
            f" | {share([not f['topology'] for f in of])}"
            f" | {'–' if name == 'tessera' else share(nearer)}"
            f" | {statistics.median(f['theta_min_deg'] for f in of):.1f}°"
            f" | {statistics.median(f['seconds'] for f in of):.2f} |"
        )


def main() -> None:
    command = sys.argv[1]
    parts = int(sys.argv[2]) if len(sys.argv) > 2 else 42
    counts = [int(n) for n in (sys.argv[3] if len(sys.argv) > 3 else "500,1500,5000").split(",")]
    lines = Path(sys.argv[4]) if len(sys.argv) > 4 else Path("/dev/null")
    programs: dict[str, Callable[[Surface], tuple[Path, float]]] = {
        "tessera": lambda surface: of_tessera(command, surface),
        f"MeshLab {version('pymeshlab')}": lambda surface: with_meshlab(surface, time.process_time),
        f"mmgs {'.'.join(mmgpy.MMG_VERSION.split('.')[:2])}": lambda surface: with_mmgs(surface, "-ar", "30", clock=cpu),
    }
    rows = [json.loads(line) for line in lines.read_text(encoding="utf-8").splitlines()] if lines.is_file() else []
    known = {(row["seed"], row["points"]) for row in rows}
    with lines.open("a", encoding="utf-8") as file:
        for number in range(parts):
            kind, turn = KINDS[number % len(KINDS)], number // len(KINDS)
            feature = FEATURES[turn % len(FEATURES)]
            for points in counts:
                if (number, points) in known:
                    continue
                with tempfile.TemporaryDirectory() as work:
                    path = Path(work) / "part.obj"
                    shape = [command, "shape", kind, "--feature", str(feature), "--seed", str(number), "-o", path]
                    subprocess.run(shape, check=True, capture_output=True)
                    surface = Surface(path, points, Path(work))
                    found = {name: figures(command, surface, program) for name, program in programs.items()}
                rows.append({"part": kind, "feature": feature, "seed": number, "points": points, **found})
                print(json.dumps(rows[-1]), file=file, flush=True)
    summary(rows, list(programs))


if __name__ == "__main__":
    main()
