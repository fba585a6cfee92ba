"""`mesh.tessera` of pyvista meshes (pyvista 0.48 or newer finds it by itself)."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pyvista

from .calls import cvt, remesh, rvd
from .results import CvtStep


@pyvista.register_dataset_accessor("tessera", pyvista.DataSet)
class TesseraAccessor:
    """Remeshes and diagrams of the mesh."""

    def __init__(self, mesh: pyvista.DataSet) -> None:
        self._mesh = mesh

    def remesh(self, points: float | str | None = None, **options: Any) -> Any:
        """A remesh, a `pyvista.PolyData`; the options are those of `tessera_remesh.remesh`."""
        return remesh(self._mesh, points=points, **options).to_pyvista()

    def rvd(self, **options: Any) -> Any:
        """The pieces of a restricted Voronoi diagram, with the cell array `seed`; options as of `tessera_remesh.rvd`."""
        return rvd(self._mesh, **options).to_pyvista()

    def cvt(self, points: float | str | None = None, **options: Any) -> Iterator[CvtStep]:
        """Centroidal iterations; options as of `tessera_remesh.cvt`."""
        return cvt(self._mesh, points=points, **options)
