"""Time, memory and cancellation of `tessera_remesh.remesh` beside the command. Prints JSON.

Usage: python compare.py COMMAND MESH.obj POINTS [ROUNDS]
COMMAND is a `tessera` of the same code and profile. Needs Linux and meshio.
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
        assert process.wait() == 0
        with open(report, encoding="utf-8") as file:
            told = json.load(file)
    times = told["timings_ms"]
    return times["total"] - times["read"] - times["write"], told["memory"]["host_peak_bytes"]


def in_process(path: str, points: int) -> float:
    """Milliseconds here."""
    vertices, faces = load(path)
    start = time.perf_counter()
    tessera_remesh.remesh(vertices, faces, points=points, backend="parallel")
    return 1e3 * (time.perf_counter() - start)


def memory(path: str, points: int) -> dict[str, int]:
    """Bytes at the most in a process of its own, and before the call."""
    code = (
        "import re, sys, numpy as np, tessera_remesh\n"
        "data = np.load(sys.argv[1]); v, f = data['v'], data['f']\n"
        "peak = lambda: 1024 * int(re.search(r'VmHWM:\\s+(\\d+)', open('/proc/self/status').read())[1])\n"
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
    }, indent=1))


if __name__ == "__main__":
    main()
