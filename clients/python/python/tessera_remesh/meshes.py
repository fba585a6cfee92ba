"""Surfaces as people have them: arrays, trimesh, pyvista, meshio.

Each library is looked at only if the caller has imported it: an object of a library that is not imported cannot come in.
"""

from __future__ import annotations

import os
import sys
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _engine
from ._engine import InputError

Array = NDArray[Any]


class RemeshWarning(UserWarning):
    """Something of the input was changed or dropped, or a request was missed. `Report.warnings` has all of a remesh."""


def warn(message: str) -> None:
    """Warns at the line that calls this package."""
    frame, level = sys._getframe(1), 2
    while frame.f_back is not None and frame.f_globals.get("__name__", "").startswith(__package__):
        frame, level = frame.f_back, level + 1
    warnings.warn(message, RemeshWarning, stacklevel=level)


@dataclass(repr=False)
class Attributes:
    """What a surface carries beside its shape. All arrays are optional.

    A remesh carries them over: each vertex of the result has what the input has at the closest point of its surface.
    """

    #: (n, 3) float: one for each vertex; or, with `normal_corners`, any number of them.
    normals: Array | None = None
    #: (m, 3) integer: which normal each corner of each face has.
    normal_corners: Array | None = None
    #: (k, 2) float: u and v. One for each vertex, or with `texture_corners` any number of them.
    texture: Array | None = None
    #: (m, 3) integer: which texture coordinates each corner of each face has.
    texture_corners: Array | None = None
    #: (n, 3) or (n, 4), red, green, blue and opacity of each vertex: float from 0 to 1, or uint8.
    colours: Array | None = None
    #: (n,) float each, under a name: ASCII letters, digits, _ and -, a letter or _ first.
    scalars: dict[str, Array] = field(default_factory=dict)

    def __repr__(self) -> str:
        named = [name for name in ("normals", "texture", "colours") if getattr(self, name) is not None]
        return f"Attributes({', '.join([*named, *(f'scalar {name}' for name in self.scalars)])})"

    def _to_engine(self) -> dict[str, Any]:
        given: dict[str, Any] = {
            "normals": _floats(self.normals),
            "normal_corners": self.normal_corners,
            "texture": _floats(self.texture),
            "texture_corners": self.texture_corners,
            "scalars": {name: _floats(values) for name, values in self.scalars.items()},
        }
        if self.colours is not None:
            colours = np.asarray(self.colours)
            given["colours_of_eight_bits"] = colours.dtype == np.uint8
            if colours.dtype == np.uint8:
                colours = colours / 255.0
            if colours.ndim == 2 and colours.shape[1] == 3:
                colours = np.column_stack([colours, np.ones(len(colours))])
            given["colours"] = _floats(colours)
        return given

    @classmethod
    def _from_engine(cls, given: dict[str, Any]) -> Attributes:
        given = dict(given)
        if given.pop("colours_of_eight_bits", False):
            given["colours"] = np.rint(np.clip(given["colours"], 0, 1) * 255).astype(np.uint8)
        return cls(**given)


@dataclass(repr=False)
class Surface:
    """A surface in arrays, what it carries, and the library that it came from. Unpacks into its two arrays."""

    vertices: Array
    faces: Array
    attributes: Attributes | None
    #: "arrays", "trimesh", "pyvista" or "meshio".
    library: str = "arrays"
    #: (k, 2) integer: edges that its file names, as ridges of Medit, which a remesh keeps.
    creases: Array | None = None

    def __iter__(self) -> Iterator[Array]:
        return iter((self.vertices, self.faces))

    def __repr__(self) -> str:
        return f"Surface({len(self.vertices):,} vertices, {len(self.faces):,} faces)"


def read(path: str | os.PathLike[str]) -> Surface:
    """A surface from a file: OBJ, PLY, STL, OFF, VTK, Gmsh, Medit, glTF or 3MF, by the ending of its name; `.gz` is unpacked.

    Warns of what is not read. Raises `InputError` for what is no surface, and `OSError` for a file that cannot be read.
    """
    held = _engine.read(path)
    for what in held["left_aside"]:
        warn(f"{os.fspath(path)}: left aside: {what}")
    carried = held.get("attributes")
    attributes = None if carried is None else Attributes._from_engine(carried)
    creases = held["creases"] if len(held["creases"]) else None
    return Surface(held["vertices"], held["faces"], attributes, creases=creases)


def save(path: str | os.PathLike[str], surface: Surface) -> None:
    """Writes a surface to a file, in the format of the name's ending. Warns of what the format cannot hold."""
    carried = None if surface.attributes is None else surface.attributes._to_engine()
    left_out = _engine.write(path, surface.vertices, surface.faces, carried)
    if left_out:
        warn(f"{os.fspath(path)}: this format cannot hold: {', '.join(left_out)}")


def _floats(array: ArrayLike | None) -> Array | None:
    """float64 or float32 as it is; anything else as float64."""
    if array is None:
        return None
    array = np.asarray(array)
    if array.dtype.kind == "c":
        raise InputError(f"an array has the type {array.dtype}; real numbers are needed")
    return array if array.dtype in (np.float64, np.float32) else array.astype(np.float64)


def surface(mesh: Any, faces: ArrayLike | None) -> Surface:
    """A surface of what a caller gives: vertices and faces, or an object of a library."""
    if faces is not None:
        return Surface(_vertices(mesh), _faces(faces), None)
    if isinstance(mesh, (str, os.PathLike)):
        return read(mesh)
    for library, convert in (("trimesh", _from_trimesh), ("pyvista", _from_pyvista), ("meshio", _from_meshio)):
        # An object's library is imported.
        module = sys.modules.get(library)
        found = convert(mesh, module) if module is not None else None
        if found is not None:
            return found
    if isinstance(mesh, Surface):
        return mesh
    kind = type(mesh)
    raise InputError(
        f"a {kind.__module__}.{kind.__qualname__} is no surface; give vertices and faces, the name of a file, "
        "or a mesh of trimesh, pyvista or meshio"
    )


def _vertices(given: ArrayLike) -> Array:
    try:
        array = _floats(given)
    except (TypeError, ValueError) as error:
        raise InputError(f"vertices: {error}") from None
    assert array is not None
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"vertices has the shape {array.shape}; (n, 3) is needed")
    return array


def _faces(given: ArrayLike) -> Array:
    try:
        array = np.asarray(given)
    except ValueError as error:
        raise InputError(f"faces: {error}; (m, 3) is needed, triangles alone") from None
    if array.ndim != 2 or array.shape[1] != 3:
        raise InputError(f"faces has the shape {array.shape}; (m, 3) is needed, triangles alone")
    if array.dtype.kind not in "iu":
        raise InputError(f"faces has the type {array.dtype}; whole numbers are needed")
    # In the processor's order of bytes.
    return array.astype(array.dtype.newbyteorder("=") if array.dtype.itemsize >= 4 else np.int32, copy=False)


def _from_trimesh(mesh: Any, trimesh: Any) -> Surface | None:
    if isinstance(mesh, trimesh.Scene):
        mesh = mesh.to_mesh()
    if not isinstance(mesh, trimesh.Trimesh):
        return None
    attributes = Attributes()
    visual = mesh.visual
    if visual.kind == "vertex":
        attributes.colours = np.asarray(visual.vertex_colors)
    elif visual.kind == "texture" and visual.uv is not None and len(visual.uv) == len(mesh.vertices):
        attributes.texture = np.asarray(visual.uv, dtype=np.float64)
    for name, values in mesh.vertex_attributes.items():
        _take_scalars(attributes, str(name), np.asarray(values), len(mesh.vertices))
    return Surface(np.asarray(mesh.vertices), np.asarray(mesh.faces), attributes, "trimesh")


def _from_pyvista(mesh: Any, pyvista: Any) -> Surface | None:
    if not isinstance(mesh, pyvista.DataSet):
        return None
    if not isinstance(mesh, pyvista.PolyData):
        mesh = mesh.extract_surface(algorithm="dataset_surface")
    if not mesh.is_all_triangles:
        mesh = mesh.triangulate()
    attributes = Attributes()
    active = mesh.GetPointData()
    normals, texture = active.GetNormals(), active.GetTCoords()
    for name in mesh.point_data.keys():
        values = np.asarray(mesh.point_data[name])
        if normals is not None and name == normals.GetName():
            attributes.normals = values
        elif texture is not None and name == texture.GetName() and values.ndim == 2:
            attributes.texture = values[:, :2]
        else:
            _take_scalars(attributes, name, values, mesh.n_points)
    return Surface(np.asarray(mesh.points), mesh.regular_faces, attributes, "pyvista")


def _from_meshio(mesh: Any, meshio: Any) -> Surface | None:
    if not isinstance(mesh, meshio.Mesh):
        return None
    split = (_split(block.type, np.asarray(block.data)) for block in mesh.cells)
    faces = [block for block in split if block is not None]
    if not faces:
        kinds = ", ".join(sorted({block.type for block in mesh.cells})) or "nothing"
        raise InputError(f"the meshio mesh has no triangles and no quadrilaterals, but {kinds}")
    points = np.asarray(mesh.points)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    attributes = Attributes()
    for name, values in mesh.point_data.items():
        _take_scalars(attributes, name, np.asarray(values), len(points))
    return Surface(points, np.concatenate(faces), attributes, "meshio")


def _split(kind: str, cells: Array) -> Array | None:
    if kind == "triangle":
        return cells
    if kind == "quad":
        return np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])
    return None


def _take_scalars(attributes: Attributes, name: str, values: Array, vertices: int) -> None:
    """Numbers of each vertex; vectors become one scalar for each of their coordinates."""
    if len(values) != vertices or values.dtype.kind not in "fiub":
        return
    if values.ndim == 1:
        attributes.scalars[scalar_name(name)] = _scalar(name, values)
    elif values.ndim == 2 and values.dtype == np.uint8 and values.shape[1] in (3, 4) and attributes.colours is None:
        attributes.colours = values
    elif values.ndim == 2:
        for i in range(values.shape[1]):
            attributes.scalars[scalar_name(f"{name}_{i}")] = _scalar(name, values[:, i])


def _scalar(name: str, values: Array) -> Array:
    floats = np.asarray(values, dtype=np.float64)
    infinite = np.isinf(floats)
    if infinite.any():
        warn(f"scalar {name}: {infinite.sum()} infinite values are NaN")
        floats = np.where(infinite, np.nan, floats)
    return floats


def scalar_name(name: str) -> str:
    """A name that the engine takes: other characters become _."""
    taken = "".join(c if c.isascii() and (c.isalnum() or c in "_-") else "_" for c in name)[:127]
    return taken if taken[:1].isalpha() or taken[:1] == "_" else f"_{taken}"


def to_trimesh(vertices: Array, faces: Array, attributes: Attributes | None) -> Any:
    import trimesh

    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if attributes is not None:
        if attributes.colours is not None:
            mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=attributes.colours)
        for name, values in attributes.scalars.items():
            mesh.vertex_attributes[name] = values
    return mesh


def to_pyvista(vertices: Array, faces: Array, attributes: Attributes | None) -> Any:
    import pyvista

    mesh = pyvista.PolyData.from_regular_faces(vertices, faces)
    if attributes is not None:
        for name, values in attributes.scalars.items():
            mesh.point_data[name] = values
        if attributes.colours is not None:
            mesh.point_data["RGBA"] = attributes.colours
        if attributes.normals is not None and attributes.normal_corners is None:
            mesh.point_data.active_normals = attributes.normals
    return mesh


def to_meshio(vertices: Array, faces: Array, attributes: Attributes | None) -> Any:
    import meshio

    data = dict(attributes.scalars) if attributes is not None else {}
    if attributes is not None and attributes.colours is not None:
        data["RGBA"] = attributes.colours
    return meshio.Mesh(vertices, [("triangle", faces)], point_data=data)
