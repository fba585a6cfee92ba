"""Time, memory and cancellation of `tessera_remesh.remesh` beside the command, and time and quality beside pyacvd. Prints JSON.

Usage: python compare.py COMMAND MESH.obj POINTS [ROUNDS]
COMMAND is a `tessera` of the same code and profile. Needs meshio, and pyvista and pyacvd for their part.
The command's time is that of its report without reading and writing. Rounds alternate; the least time of each counts.
"""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import threading
import time

import meshio
import numpy as np
import tessera_remesh


def load(path: str) -> tuple[np.ndarray, np.ndarray]:
    mesh = meshio.read(path)
    return np.ascontiguousarray(mesh.points), np.ascontiguousarray(mesh.cells_dict["triangle"])


def by_command(command: str, path: str, points: int) -> tuple[float, int]:
    """Milliseconds, and bytes at the most."""
    with tempfile.TemporaryDirectory() as folder:
        report = os.path.join(folder, "report.json")
        arguments = [command, "remesh", path, "--points", str(points), "--backend", "parallel", "--quiet"]
        process = subprocess.Popen([*arguments, "-o", os.path.join(folder, "out.ply"), "--report", report])
        _, status, usage = os.wait4(process.pid, 0)
        assert status == 0
        with open(report, encoding="utf-8") as file:
            times = json.load(file)["timings_ms"]
    return times["total"] - times["read"] - times["write"], usage.ru_maxrss * 1024


def in_process(path: str, points: int) -> float:
    """Milliseconds here."""
    vertices, faces = load(path)
    start = time.perf_counter()
    tessera_remesh.remesh(vertices, faces, points=points, backend="parallel")
    return 1e3 * (time.perf_counter() - start)


def memory(path: str, points: int) -> dict[str, int]:
    """Bytes at the most in a process of its own, and before the call."""
    code = (
        "import resource, sys, numpy as np, tessera_remesh\n"
        "data = np.load(sys.argv[1]); v, f = data['v'], data['f']\n"
        "peak = lambda: resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024\n"
        "before = peak(); tessera_remesh.remesh(v, f, points=int(sys.argv[2]), backend='parallel'); print(before, peak())"
    )
    with tempfile.TemporaryDirectory() as folder:
        vertices, faces = load(path)
        arrays = os.path.join(folder, "mesh.npz")
        np.savez(arrays, v=vertices, f=faces)
        out = subprocess.run([sys.executable, "-c", code, arrays, str(points)], check=True, capture_output=True, text=True)
    before, peak = map(int, out.stdout.split())
    return {"before_bytes": before, "peak_bytes": peak}


def cancels(path: str, points: int, rounds: int) -> list[float]:
    """Milliseconds from Ctrl-C until the exception, at random moments."""
    vertices, faces = load(path)
    late = []
    for _ in range(rounds):
        sent: list[float] = []

        def interrupt() -> None:
            sent.append(time.perf_counter())
            os.kill(os.getpid(), signal.SIGINT)

        timer = threading.Timer(random.uniform(0.01, 0.4), interrupt)
        timer.start()
        try:
            tessera_remesh.remesh(vertices, faces, points=points, backend="parallel")
            timer.join()
        except KeyboardInterrupt:
            late.append(1e3 * (time.perf_counter() - sent[0]))
    return sorted(late)


def quality(vertices: np.ndarray, faces: np.ndarray, original: str) -> dict[str, float]:
    corners = vertices[faces]
    u, v, w = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 1], corners[:, 0] - corners[:, 2]
    lengths = [np.linalg.norm(x, axis=1) for x in (u, v, w)]
    area = 0.5 * np.linalg.norm(np.cross(u, v), axis=1)
    q = 6 / 3**0.5 * area / (0.5 * sum(lengths) * np.max(lengths, axis=0))
    cosine = lambda x, y, a, b: np.clip(-(x * y).sum(axis=1) / (a * b), -1, 1)
    at = ((w, u, lengths[2], lengths[0]), (u, v, lengths[0], lengths[1]), (v, w, lengths[1], lengths[2]))
    angles = np.degrees(np.arccos([cosine(*corner) for corner in at]))
    import trimesh

    surface = trimesh.Trimesh(*load(original), process=False)
    result = trimesh.Trimesh(vertices, faces, process=False)
    there = trimesh.proximity.closest_point(surface, result.vertices)[1]
    back = trimesh.proximity.closest_point(result, surface.vertices)[1]
    diagonal = np.linalg.norm(np.ptp(surface.vertices, axis=0))
    faces_of_edge = np.unique(result.edges_sorted, axis=0, return_counts=True)[1]
    return {
        "vertices": len(vertices),
        "q_min": float(q.min()),
        "q_mean": float(q.mean()),
        "smallest_angle": float(np.min(angles)),
        "farthest_percent": float(100 * max(there.max(), back.max()) / diagonal),
        "edges_of_three_faces_or_more": int((faces_of_edge > 2).sum()),
    }


def beside_pyacvd(path: str, points: int) -> dict[str, dict[str, float]]:
    import pyacvd
    import pyvista

    vertices, faces = load(path)
    surface = pyvista.PolyData.from_regular_faces(vertices, faces)
    start = time.perf_counter()
    clustering = pyacvd.Clustering(surface)
    # As its examples do: at least ten vertices a cluster.
    while clustering.mesh.n_points < 10 * points:
        clustering.subdivide(1)
    clustering.cluster(points)
    made = clustering.create_mesh()
    theirs = time.perf_counter() - start
    start = time.perf_counter()
    ours = surface.tessera.remesh(points)
    here = time.perf_counter() - start
    of = lambda mesh: quality(np.asarray(mesh.points, dtype=float), mesh.regular_faces, path)
    return {"pyacvd": {"seconds": theirs, **of(made)}, "tessera": {"seconds": here, **of(ours)}}


def main() -> None:
    command, path, points = sys.argv[1], sys.argv[2], int(sys.argv[3])
    rounds = int(sys.argv[4]) if len(sys.argv) > 4 else 5
    there, here, most = [], [], []
    for _ in range(rounds):
        milliseconds, peak = by_command(command, path, points)
        there.append(milliseconds)
        most.append(peak)
        here.append(in_process(path, points))
    late = cancels(path, points, 20)
    print(json.dumps({
        "mesh": os.path.basename(path), "points": points,
        "command_ms": min(there), "remesh_ms": min(here), "ratio": min(here) / min(there),
        "command_peak_bytes": min(most), "python": memory(path, points),
        "cancelled": len(late), "cancel_ms_most": late[-1] if late else None,
        "beside": beside_pyacvd(path, points),
    }, indent=1))


if __name__ == "__main__":
    main()
