"""Surfaces as people have them: arrays, trimesh, pyvista, meshio.

Each library is looked at only if the caller has imported it: an object of a library that is not imported cannot come in.
"""

from __future__ import annotations

import os
import sys
import unicodedata
import warnings
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
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
    #: (m,) integer: the region of each face, as a material or a physical group. A remesh keeps the borders between regions.
    regions: Array | None = None
    #: Names of regions, by their numbers.
    region_names: dict[int, str] = field(default_factory=dict)
    #: The name of the data of faces that the regions come from.
    regions_from: str | None = None
    #: (n,) or (n, k) each, under a name of at most 128 bytes. Float is interpolated; integer
    #: and bool are those of the nearest vertex, and keep their type.
    scalars: dict[str, Array] = field(default_factory=dict)

    def __repr__(self) -> str:
        named = [name for name in ("normals", "texture", "colours", "regions") if getattr(self, name) is not None]
        return f"Attributes({', '.join([*named, *(f'scalar {name}' for name in self.scalars)])})"

    def _to_engine(self) -> dict[str, Any]:
        given: dict[str, Any] = {
            "normals": _floats(self.normals),
            "normal_corners": self.normal_corners,
            "texture": _floats(self.texture),
            "texture_corners": self.texture_corners,
            "scalars": {name: _numbers(name, values) for name, values in self.scalars.items()},
        }
        if self.regions is not None:
            regions = np.asarray(self.regions)
            if regions.dtype.kind not in "iub" or regions.ndim != 1:
                raise InputError(f"regions has the type {regions.dtype} and the shape {regions.shape}; (m,) integer is needed")
            if regions.size and np.abs(regions.astype(np.float64)).max() >= 2**53:
                raise InputError("regions has numbers of 2^53 or more; give smaller ones")
            given["regions"] = regions.astype(np.float64)
            given["region_names"] = [(int(number), str(name)) for number, name in self.region_names.items()]
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
        given["scalars"] = {name: _array(*scalar) for name, scalar in given["scalars"].items()}
        if "regions" in given:
            given["regions"] = given["regions"].astype(np.int64)
            given["region_names"] = {number: name for number, name in given["region_names"] if name}
        return cls(**given)

    def _like(self, given: Attributes | None) -> Attributes:
        """With bool, with one column, and with small types of regions, where `given` has these: the engine knows none of them."""
        if given is not None and given.regions is not None and self.regions is not None:
            self.regions_from = given.regions_from
            self.regions = self.regions.astype(np.asarray(given.regions).dtype)
        for name, values in (given.scalars if given is not None else {}).items():
            was, carried = np.asarray(values), self.scalars.get(name)
            if carried is not None:
                carried = carried.astype(bool) if was.dtype == bool else carried
                self.scalars[name] = carried.reshape(-1, 1) if was.ndim == 2 and carried.ndim == 1 else carried
        return self


@dataclass(repr=False)
class Surface:
    """A surface in arrays, what it carries, and the library that it came from. Unpacks into its two arrays."""

    vertices: Array
    faces: Array
    attributes: Attributes | None
    #: "arrays", "trimesh", "pyvista" or "meshio".
    library: str = "arrays"
    #: (m, ...) each: what each face has. A face of a remesh takes it from the face below its centroid.
    face_data: dict[str, Array] = field(default_factory=dict)
    #: (k, 2) integer: edges that its file names, as ridges of Medit, which a remesh keeps.
    creases: Array | None = None
    #: (k,) integer: vertices that its file names, as required ones of Medit, which a remesh leaves where they are.
    required: Array | None = None

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
    required = np.asarray(held["required"], dtype=np.int64) if held["required"] else None
    return Surface(held["vertices"], held["faces"], attributes, creases=creases, required=required)


def save(path: str | os.PathLike[str], surface: Surface) -> None:
    """Writes a surface to a file, in the format of the name's ending. Warns of what the format cannot hold."""
    carried = None if surface.attributes is None else surface.attributes._to_engine()
    left_out = _engine.write(path, surface.vertices, surface.faces, carried)
    held = None if surface.attributes is None else surface.attributes.regions_from
    left_out += [f"data of faces {name}" for name in surface.face_data if name != held]
    if left_out:
        warn(f"{os.fspath(path)}: this format cannot hold: {', '.join(left_out)}")


def _numbers(name: str, values: ArrayLike) -> tuple[Array, str, int]:
    """A scalar as the engine takes it: all numbers, their type as "F64" or "I32", how many a vertex has."""
    array = np.asarray(values)
    if array.dtype.kind not in "fiub" or array.ndim not in (1, 2):
        raise InputError(f"scalar {name} has the type {array.dtype} and the shape {array.shape}; (n,) or (n, k) is needed")
    letter = {"f": "F", "i": "I", "u": "U", "b": "U"}[array.dtype.kind]
    form = "F64" if letter == "F" else f"{letter}{8 * array.dtype.itemsize}"
    components = array.shape[1] if array.ndim == 2 else 1
    if not 1 <= components <= MAX_COMPONENTS:
        raise InputError(f"scalar {name} has {components} numbers a vertex; 1 to {MAX_COMPONENTS} are possible")
    return np.ascontiguousarray(array, dtype=np.float64).reshape(-1), form, components


def _array(values: Array, form: str, components: int) -> Array:
    array = values.astype(f"{form[0].lower()}{int(form[1:]) // 8}", copy=False)
    return array if components == 1 else array.reshape(-1, components)


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
    face_data = {str(name): np.asarray(values) for name, values in mesh.face_attributes.items()}
    if visual.kind == "face":
        face_data[FACE_COLOURS] = np.asarray(visual.face_colors)
    return _surface(np.asarray(mesh.vertices), np.asarray(mesh.faces), attributes, "trimesh", face_data)


def _from_pyvista(mesh: Any, pyvista: Any) -> Surface | None:
    if not isinstance(mesh, pyvista.DataSet):
        return None
    given, added = {*mesh.point_data.keys(), *mesh.cell_data.keys()}, set()
    if not isinstance(mesh, pyvista.PolyData):
        mesh = mesh.extract_surface(algorithm="dataset_surface")
        added = {"vtkOriginalPointIds", "vtkOriginalCellIds"} - given
    if lines := mesh.n_verts + mesh.n_lines:
        warn(f"left aside: points and lines: there are {lines}; the surface is read alone")
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
        elif name not in added:
            _take_scalars(attributes, name, values, mesh.n_points)
    # Numbers that a filter of VTK adds are not the caller's.
    face_data = {name: np.asarray(mesh.cell_data[name]) for name in mesh.cell_data.keys() if name not in added}
    return _surface(np.asarray(mesh.points), mesh.regular_faces, attributes, "pyvista", face_data)


def _from_meshio(mesh: Any, meshio: Any) -> Surface | None:
    if not isinstance(mesh, meshio.Mesh):
        return None
    blocks = [_triangles(block.type, np.asarray(block.data)) for block in mesh.cells]
    faces = [block for block in blocks if block is not None]
    if not faces:
        kinds = ", ".join(sorted({block.type for block in mesh.cells})) or "nothing"
        raise InputError(f"the meshio mesh has no triangles and no quadrilaterals, but {kinds}")
    points = np.asarray(mesh.points, dtype=np.float64)
    if points.shape[1] == 2:
        points = np.column_stack([points, np.zeros(len(points))])
    attributes = Attributes()
    for name, values in mesh.point_data.items():
        _take_scalars(attributes, name, np.asarray(values), len(points))
    if others := sum(len(block.data) for block, found in zip(mesh.cells, blocks) if found is None):
        warn(f"left aside: {others} cells that are no faces; the surface is read alone")
    if sets := [*mesh.cell_sets, *mesh.point_sets]:
        warn(f"left aside: {', '.join(sets)}: sets are not carried")
    face_data = {}
    for name, given in mesh.cell_data.items():
        kept = [
            np.concatenate([values] * (len(block) // len(values))) if len(values) else np.asarray(values)
            for values, block in zip(given, blocks)
            if block is not None
        ]
        face_data[name] = np.concatenate(kept)
    return _surface(points, np.concatenate(faces), attributes, "meshio", face_data)


#: The name of colours by face, which trimesh keeps apart.
FACE_COLOURS = "face_colors"


def _surface(vertices: Array, faces: Array, attributes: Attributes, library: str, face_data: dict[str, Array]) -> Surface:
    for name in [name for name, values in face_data.items() if len(values) != len(faces)]:
        warn(f"left aside: {name}: it has {len(face_data.pop(name))} values for {len(faces)} faces")
    return Surface(vertices, faces, attributes, library, face_data)


def below(surface: Surface, vertices: Array, faces: Array) -> dict[str, Array]:
    """The data of faces, for other faces: each takes those of the face of `surface` that is nearest to its centroid."""
    if not surface.face_data:
        return {}
    nearest = _engine.nearest_faces(surface.vertices, surface.faces, vertices[faces].mean(axis=1))
    return {name: np.asarray(values)[nearest] for name, values in surface.face_data.items()}


def _triangles(kind: str, cells: Array) -> Array | None:
    if kind == "triangle":
        return cells
    if kind == "quad":
        return np.concatenate([cells[:, [0, 1, 2]], cells[:, [0, 2, 3]]])
    return None


#: The most numbers that a scalar has at each vertex, and the least whole number that may be another one rounded.
MAX_COMPONENTS, LEAST_INEXACT = 64, 2**53


def _take_scalars(attributes: Attributes, name: str, values: Array, vertices: int) -> None:
    """Numbers or vectors of each vertex. What cannot be carried is a warning."""

    def aside(why: str) -> None:
        warn(f"left aside: {name}: {why}")

    if len(values) != vertices:
        return aside(f"it has {len(values)} values for {vertices} vertices")
    if values.dtype.kind not in "fiub":
        return aside(f"it has the type {values.dtype}")
    if values.ndim > 2 and values.size == vertices * np.prod(values.shape[1:]):
        values = values.reshape(vertices, -1)
    if values.ndim == 2 and values.dtype == np.uint8 and values.shape[1] in (3, 4) and attributes.colours is None:
        attributes.colours = values
        return None
    if values.ndim == 2 and not 1 <= values.shape[1] <= MAX_COMPONENTS:
        return aside(f"it has {values.shape[1]} numbers a vertex, and 1 to {MAX_COMPONENTS} are carried")
    if values.dtype.kind == "f":
        infinite = np.isinf(values)
        if infinite.any():
            warn(f"scalar {name}: {infinite.sum()} infinite values are NaN")
            values = np.where(infinite, np.nan, values)
    elif values.size and values.dtype.itemsize == 8 and max(-int(values.min()), int(values.max())) >= LEAST_INEXACT:
        return aside("whole numbers from 2**53 on are rounded")
    attributes.scalars[_unlike(attributes.scalars, scalar_name(name))] = values
    return None


def _unlike(taken: dict[str, Array], name: str) -> str:
    """The name, or one after it: two arrays whose names differ in other characters are two all the same."""
    names = [name, *(f"{name[:120]}_{i}" for i in range(2, len(taken) + 3))]
    return next(free for free in names if free not in taken)


def scalar_name(name: str) -> str:
    """A name that the engine takes: control characters become _, and there are at most 128 bytes."""
    taken = "".join("_" if unicodedata.category(c) == "Cc" else c for c in name)
    return taken.encode()[:128].decode(errors="ignore").strip() or "_"


def _split(surface: Surface, attributes: Attributes) -> tuple[Surface, Attributes]:
    """With a vertex for each normal and each texture coordinate that it has: what libraries hold goes by vertices."""
    by_corner = [corners for corners in (attributes.normal_corners, attributes.texture_corners) if corners is not None]
    columns = np.column_stack([np.asarray(corners).reshape(-1) for corners in (surface.faces, *by_corner)])
    rows, of_corner = np.unique(columns, axis=0, return_inverse=True)
    vertex = rows[:, 0]
    split = Attributes(
        colours=None if attributes.colours is None else np.asarray(attributes.colours)[vertex],
        scalars={name: np.asarray(values)[vertex] for name, values in attributes.scalars.items()},
    )
    if attributes.normals is not None:
        split.normals = np.asarray(attributes.normals)[vertex if attributes.normal_corners is None else rows[:, 1]]
    if attributes.texture is not None:
        split.texture = np.asarray(attributes.texture)[vertex if attributes.texture_corners is None else rows[:, -1]]
    faces = of_corner.reshape(-1, 3).astype(surface.faces.dtype)
    return replace(surface, vertices=surface.vertices[vertex], faces=faces), split


def _by_vertex(surface: Surface) -> tuple[Surface, Attributes]:
    """The surface as a library holds it. Vertices are split along seams of texture, and where normals differ."""
    attributes = surface.attributes or Attributes()
    if attributes.normal_corners is None and attributes.texture_corners is None:
        return surface, attributes
    return _split(surface, attributes)


def to_trimesh(surface: Surface) -> Any:
    import trimesh

    surface, attributes = _by_vertex(surface)
    mesh = trimesh.Trimesh(surface.vertices, surface.faces, vertex_normals=attributes.normals, process=False)
    if attributes.texture is not None:
        mesh.visual = trimesh.visual.TextureVisuals(uv=attributes.texture)  # type: ignore[no-untyped-call]
        if attributes.colours is not None:
            mesh.vertex_attributes["color"] = attributes.colours
    elif attributes.colours is not None:
        mesh.visual = trimesh.visual.ColorVisuals(mesh, vertex_colors=attributes.colours)
    for name, values in attributes.scalars.items():
        mesh.vertex_attributes[name] = values
    for name, values in _data_of_faces(surface).items():
        if name != FACE_COLOURS:
            mesh.face_attributes[name] = values
        elif attributes.texture is None and attributes.colours is None:
            mesh.visual = trimesh.visual.ColorVisuals(mesh, face_colors=values)
    return mesh


def _data_of_faces(surface: Surface) -> dict[str, Array]:
    """With regions that come from no data of faces, as those of a file."""
    attributes = surface.attributes
    if attributes is None or attributes.regions is None or attributes.regions_from:
        return surface.face_data
    return {**surface.face_data, "regions": attributes.regions}


def to_pyvista(surface: Surface) -> Any:
    import pyvista

    surface, attributes = _by_vertex(surface)
    mesh = pyvista.PolyData.from_regular_faces(surface.vertices, surface.faces)
    for name, values in attributes.scalars.items():
        mesh.point_data[name] = values
    if attributes.colours is not None:
        mesh.point_data["RGBA"] = attributes.colours
    if attributes.normals is not None:
        mesh.point_data.active_normals = attributes.normals
    if attributes.texture is not None:
        mesh.active_texture_coordinates = attributes.texture
    for name, values in _data_of_faces(surface).items():
        mesh.cell_data[name] = values
    return mesh


def to_meshio(surface: Surface) -> Any:
    import meshio

    surface, attributes = _by_vertex(surface)
    data = dict(attributes.scalars)
    for name, values in (("RGBA", attributes.colours), ("Normals", attributes.normals), ("UV", attributes.texture)):
        if values is not None:
            data[name] = values
    cell_data = {name: [values] for name, values in _data_of_faces(surface).items()}
    return meshio.Mesh(surface.vertices, [("triangle", surface.faces)], point_data=data, cell_data=cell_data)
