"""The examples of pyacvd, and the lines that change. Times both, and measures both results with the command. Prints JSON.

Usage: python from_pyacvd.py COMMAND [COW]
COMMAND is `tessera`. COW is a file that meshio reads, such as `cow.off` of Debian's package libcgal-demo; without it pyvista downloads its own.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time

import meshio
import numpy as np
import pyacvd
import pyvista
import tessera_remesh  # registers `mesh.tessera`


def load() -> pyvista.PolyData:
    if len(sys.argv) > 2:
        return pyvista.PolyData(pyvista.from_meshio(meshio.read(sys.argv[2])).extract_surface(algorithm="dataset_surface"))
    return pyvista.examples.download_cow()


def accessor_of_pyacvd(cow: pyvista.PolyData) -> pyvista.PolyData:
    remesh = cow.triangulate().acvd.remesh(20000, subdivide=3)
    return remesh


def accessor_of_tessera(cow: pyvista.PolyData) -> pyvista.PolyData:
    remesh = cow.triangulate().tessera.remesh(20000)  # this line: no subdivision is needed
    return remesh


def classic_of_pyacvd(cow: pyvista.PolyData) -> pyvista.PolyData:
    clus = pyacvd.Clustering(cow.triangulate())
    clus.subdivide(3)
    clus.cluster(20000)
    remesh = clus.create_mesh()
    return remesh


def classic_of_tessera(cow: pyvista.PolyData) -> pyvista.PolyData:
    # Three lines less: no clustering, no subdivision, no second mesh.
    remesh = tessera_remesh.remesh(cow.triangulate(), points=20000).mesh
    return remesh


def measured(command: str, cow: pyvista.PolyData, remesh: pyvista.PolyData) -> dict[str, float]:
    """What the command says of a remesh of the cow."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [os.path.join(folder, name) for name in ("cow.ply", "remesh.ply")]
        for path, mesh in zip(paths, (cow.triangulate(), remesh)):
            meshio.Mesh(np.asarray(mesh.points, dtype=float), [("triangle", mesh.regular_faces)]).write(path)
        out = subprocess.run([command, "measure", *paths, "--json"], check=True, capture_output=True)
    told = json.loads(out.stdout)
    keys = ("q_min", "q_avg", "theta_min_deg", "v567_percent", "hausdorff_percent", "rms_percent")
    return {"vertices": told["remesh"]["vertices"], **{key: told["quality"][key] for key in keys}}


def main() -> None:
    command, cow = sys.argv[1], load()
    found = {}
    for example in (accessor_of_pyacvd, accessor_of_tessera, classic_of_pyacvd, classic_of_tessera):
        taken = []
        for _ in range(3):
            given = cow.copy()
            start = time.perf_counter()
            remesh = example(given)
            taken.append(time.perf_counter() - start)
        found[example.__name__] = {"seconds": min(taken), **measured(command, cow, remesh)}
    print(json.dumps(found, indent=1))


if __name__ == "__main__":
    main()
