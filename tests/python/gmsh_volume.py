"""gmsh meshes the two chambers of a remesh whose membrane and shell have their vertices in common.

Usage: gmsh_volume.py CHAMBERS.msh, the file of docs/regions.md. Needs gmsh, of PyPI.
"""

import math
import sys

import gmsh
import numpy as np

gmsh.initialize()
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open(sys.argv[1])
names = sorted(gmsh.model.getPhysicalName(*group) for group in gmsh.model.getPhysicalGroups())
assert names == ["membrane", "shell"], names
(facets,) = [len(numbers) for kind, numbers in zip(*gmsh.model.mesh.getElements(2)[:2], strict=True) if kind == 2]

# Faces of the shell end at creases, and where the membrane is.
gmsh.model.mesh.classifySurfaces(math.radians(40), True, False, math.pi)
boxes = {surface: gmsh.model.getBoundingBox(2, surface) for _, surface in gmsh.model.getEntities(2)}
assert len(boxes) == 11, boxes
for low in (0, 1):
    around = [surface for surface, box in boxes.items() if low - 1e-6 < box[0] and box[3] < low + 1 + 1e-6]
    assert len(around) == 6, (low, around)
    gmsh.model.geo.addVolume([gmsh.model.geo.addSurfaceLoop(around)])
gmsh.model.geo.synchronize()
gmsh.model.mesh.generate(3)

volumes = []
for _, volume in gmsh.model.getEntities(3):
    kinds, _, corners = gmsh.model.mesh.getElements(3, volume)
    assert list(kinds) == [4], kinds
    places = np.array([gmsh.model.mesh.getNode(v)[0] for v in corners[0]]).reshape(-1, 4, 3)
    total = np.abs(np.linalg.det(places[:, 1:] - places[:, :1])).sum() / 6
    volumes.append((round(float(total), 9), len(places)))
assert [volume for volume, _ in volumes] == [1, 1], volumes
(after,) = [len(numbers) for kind, numbers in zip(*gmsh.model.mesh.getElements(2)[:2], strict=True) if kind == 2]
assert after == facets, (after, facets)
print(f"gmsh: {facets} facets, volumes of {' and '.join(f'{count} tetrahedra' for _, count in volumes)}")
gmsh.finalize()
