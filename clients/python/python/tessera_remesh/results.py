"""What the calls give back."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import meshes
from .meshes import Attributes

Array = NDArray[Any]


@dataclass(frozen=True, repr=False)
class Report:
    """How a remesh came about, and how good it is. `raw` has all figures, as `tessera remesh --report` writes them."""

    #: "serial", "parallel" or "gpu".
    backend: str
    #: Vertices of the result.
    vertices: int
    #: Faces of the result.
    faces: int
    #: Euler characteristic of the result.
    euler: int
    #: Connected components of the result.
    components: int
    #: Boundary loops of the result.
    boundary_loops: int
    #: What is not as in the input, one sentence each.
    topology_changes: list[str]
    #: What changed, was dropped or missed: each a `code`, a `message`, and where it applies a `count` and `places`.
    warnings: list[dict[str, Any]]
    #: Least quality of a triangle, 6/√3 · area / (half perimeter · longest edge): 1 is equilateral. None if not measured.
    q_min: float | None
    #: Mean quality.
    q_mean: float | None
    #: Smallest angle, degrees.
    smallest_angle: float | None
    #: Hausdorff distance between the two surfaces, percent of the diagonal of the input's box.
    hausdorff_percent: float | None
    #: Root mean square distance, percent of the diagonal.
    rms_percent: float | None
    #: Energy before each step, caller's units.
    energies: list[float]
    #: Wall-clock milliseconds of each stage.
    milliseconds: dict[str, float]
    #: All figures.
    raw: dict[str, Any] = field(repr=False)

    @classmethod
    def from_json(cls, text: str | bytes) -> Report:
        """Of the JSON that the command and the service write."""
        raw: dict[str, Any] = json.loads(text)
        result = raw["result"]
        return cls(
            backend=raw["backend"],
            vertices=result["vertices"],
            faces=result["facets"],
            euler=result["euler"],
            components=result["components"],
            boundary_loops=result["boundary_loops"],
            topology_changes=list(raw["topology_changes"]),
            # A server of an earlier version has none.
            warnings=list(raw.get("warnings", [])),
            q_min=result.get("q_min"),
            q_mean=result.get("q_avg"),
            smallest_angle=result.get("theta_min_deg"),
            hausdorff_percent=result.get("hausdorff_percent"),
            rms_percent=result.get("rms_percent"),
            energies=[step["energy"] for step in raw["iterations"]],
            milliseconds=dict(raw["timings_ms"]),
            raw=raw,
        )

    def _figures(self) -> dict[str, str]:
        """The figures that tell most, as they are shown."""
        figures = {"vertices": f"{self.vertices:,}", "faces": f"{self.faces:,}"}
        if self.q_mean is not None:
            figures["mean quality"] = f"{self.q_mean:.3f}"
        if self.smallest_angle is not None:
            figures["smallest angle"] = f"{self.smallest_angle:.1f}°"
        if self.hausdorff_percent is not None:
            figures["Hausdorff distance"] = f"{self.hausdorff_percent:.3f} % of the diagonal"
        if self.warnings:
            figures["warnings"] = str(len(self.warnings))
        return figures

    def __repr__(self) -> str:
        return f"Report({', '.join(f'{name} {figure}' for name, figure in self._figures().items())})"

    def _repr_html_(self) -> str:
        rows = "".join(f"<tr><th>{name}</th><td>{figure}</td></tr>" for name, figure in self._figures().items())
        return f"<table>{rows}</table>"


@dataclass(frozen=True, repr=False)
class Remesh:
    """A remesh. Unpacks into its two arrays: `vertices, faces = remesh(...)`."""

    #: (n, 3) float64.
    vertices: Array
    #: (m, 3) int32, counter-clockwise seen from outside, as the input.
    faces: Array
    #: (n,) int32: the seed whose cell each vertex stands for.
    vertex_seeds: Array
    #: (k, 2) int32: edges on creases and boundaries that were kept.
    creases: Array
    #: (s, 3) float64: the last seeds, on the surface.
    seeds: Array
    #: Figures.
    report: Report
    #: What the surface carries; None if the input carried nothing.
    attributes: Attributes | None = None
    #: (n,) int32: the face of the input below each vertex; with attributes only.
    source_faces: Array | None = None
    #: (n, 3) float64: barycentric coordinates in that face.
    source_barycentric: Array | None = None
    #: The library that the input came from: "arrays", "trimesh", "pyvista" or "meshio".
    library: str = "arrays"
    #: (m, ...) each: what each face has, from the face of the input below its centroid.
    face_data: dict[str, Array] = field(default_factory=dict)

    def __iter__(self) -> Iterator[Array]:
        return iter((self.vertices, self.faces))

    def __repr__(self) -> str:
        return f"Remesh({repr(self.report).removeprefix('Report(')}"

    def _repr_html_(self) -> str:
        return self.report._repr_html_()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Writes it to a file, in the format of the name's ending. Warns of what the format cannot hold."""
        meshes.save(path, self._surface())

    def _surface(self) -> meshes.Surface:
        return meshes.Surface(self.vertices, self.faces, self.attributes, self.library, self.face_data)

    @property
    def mesh(self) -> Any:
        """The remesh as an object of the library that the input came from; for arrays the pair (vertices, faces)."""
        if self.library == "arrays":
            return self.vertices, self.faces
        return getattr(self, f"to_{self.library}")()

    def to_trimesh(self) -> Any:
        """As a `trimesh.Trimesh`, with all that it carries. Vertices are split along seams of texture and of normals."""
        return meshes.to_trimesh(self._surface())

    def to_pyvista(self) -> Any:
        """As a `pyvista.PolyData`, with all that it carries. Vertices are split along seams of texture and of normals."""
        return meshes.to_pyvista(self._surface())

    def to_meshio(self) -> Any:
        """As a `meshio.Mesh`, with all that it carries. Vertices are split along seams of texture and of normals."""
        return meshes.to_meshio(self._surface())

    def plot(self, ax: Any = None, **kwargs: Any) -> Any:
        """Draws the remesh with matplotlib (`pip install tessera-remesh[plot]`) and returns the axes.

        Other keywords go to `Axes3D.plot_trisurf`.
        """
        import matplotlib.pyplot as plt

        if ax is None:
            ax = plt.figure().add_subplot(projection="3d")
        kwargs = {"color": "lightsteelblue", "edgecolor": "black", "linewidth": 0.1, **kwargs}
        x, y, z = self.vertices.T
        ax.plot_trisurf(x, y, z, triangles=self.faces, **kwargs)
        ax.set_box_aspect(np.ptp(self.vertices, axis=0))
        ax.set_axis_off()
        return ax

    def plot_energies(self, ax: Any = None) -> Any:
        """Draws the energy of the seeds before each step with matplotlib, and returns the axes."""
        import matplotlib.pyplot as plt

        if ax is None:
            ax = plt.figure().add_subplot()
        ax.plot(self.report.energies, marker=".")
        ax.set_xlabel("step")
        ax.set_ylabel("energy")
        return ax


@dataclass(frozen=True, repr=False)
class Rvd:
    """A restricted Voronoi diagram: sums over each cell, and the pieces in which cells meet faces."""

    #: (s, 3) float64.
    seeds: Array
    #: (s, 3) float64: centroid of each cell; an empty cell's is its seed.
    centroids: Array
    #: (s,) float64: integral of the weight, scaled so that the largest weight is above 1/2 and at most 1.
    masses: Array
    #: (s,) float64.
    areas: Array
    #: (s,) float64: integral of weight times squared distance from the seed.
    energies: Array
    #: (p,) int32: face of each piece, ascending; None if pieces were not asked for. With `sizes`, "curvature" or "lfs", faces
    #: are those of a finer mesh, since lengths are linear in each face.
    piece_faces: Array | None = None
    #: (p,) int32: seed of each piece.
    piece_seeds: Array | None = None
    #: (p + 1,) int32: first vertex of each piece, and their number at the end.
    piece_offsets: Array | None = None
    #: (v, 3) float64: the pieces' vertices, counter-clockwise.
    piece_vertices: Array | None = None

    def __repr__(self) -> str:
        pieces = "" if self.piece_faces is None else f", {len(self.piece_faces):,} pieces"
        return f"Rvd({len(self.seeds):,} seeds{pieces})"

    def to_pyvista(self) -> Any:
        """The pieces as a `pyvista.PolyData` of polygons, with the cell arrays `seed` and `face`."""
        import pyvista

        if self.piece_offsets is None or self.piece_vertices is None or self.piece_seeds is None:
            raise ValueError("the diagram was computed without its pieces; ask with pieces=True")
        sizes = np.diff(self.piece_offsets)
        faces = np.insert(np.arange(len(self.piece_vertices)), self.piece_offsets[:-1], sizes)
        mesh = pyvista.PolyData(self.piece_vertices, faces=faces)
        mesh.cell_data["seed"] = self.piece_seeds
        mesh.cell_data["face"] = np.asarray(self.piece_faces)
        return mesh


@dataclass(frozen=True)
class CvtStep:
    """A step of centroidal iterations. Energies are those of the seeds before it."""

    #: From 0.
    index: int
    #: "lloyd" or "lbfgs".
    kind: str
    #: Sum of weight times squared distance over all cells, caller's units.
    energy: float
    #: Over that of a hexagonal tiling: about 2 for random seeds, near 1 when converged.
    energy_ratio: float
    #: Euclidean norm of the energy's gradient.
    gradient_norm: float
    #: Cells without surface; their seeds were placed anew.
    empty_cells: int
    #: Wall-clock time.
    milliseconds: float
    #: Whether the convergence test ends the iterations here.
    converged: bool
    #: (s, 3) float64: the seeds after the step.
    seeds: Array = field(repr=False)
