"""The functions, and where they go: to the engine in this process, or to a server."""

from __future__ import annotations

import inspect
import re
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import ArrayLike

from . import _engine, meshes
from .meshes import Attributes, Surface, warn
from .progress import ProgressLike, listener
from .results import CvtStep, Remesh, Report, Rvd

Density = Literal["uniform", "curvature", "lfs", "error", "error_max"]


def _density(given: Any) -> dict[str, Any]:
    """A name, or a weight for each vertex. "uniform" is as none: beside it there may be sizes."""
    if given is None:
        return {"density": None}
    if not isinstance(given, str):
        return {"weights": meshes._floats(given)}
    words = get_args(Density)
    if given not in words:
        raise _engine.InputError(f"density is {given!r}; it is one of {', '.join(words)}")
    return {"density": None if given == "uniform" else given}


def _carried(attributes: Any, surface: Surface) -> Attributes | None:
    """True: what the object carries; False: nothing."""
    if isinstance(attributes, Attributes):
        return attributes
    if isinstance(attributes, dict):
        return Attributes(scalars={name: np.asarray(values) for name, values in attributes.items()})
    if attributes is True:
        return surface.attributes
    if attributes is False or attributes is None:
        return None
    raise _engine.InputError("attributes is neither True, False, Attributes nor a dictionary of scalars")


def _edges(given: ArrayLike | None) -> Any:
    return None if given is None or np.size(given) == 0 else np.asarray(given)


def _tensors(given: ArrayLike | None) -> Any:
    """Symmetric matrices as six numbers each."""
    tensors = meshes._floats(given)
    if tensors is None or tensors.shape[1:] != (3, 3):
        return tensors
    if not np.allclose(tensors, tensors.transpose(0, 2, 1), rtol=1e-5, atol=0, equal_nan=True):
        raise _engine.InputError("metric has a matrix that is not symmetric")
    rows, columns = [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]
    return np.ascontiguousarray(tensors[:, rows, columns])


#: What a count may end with.
_UNITS = {"": 1, "k": 1_000, "m": 1_000_000}


def count(name: str, given: Any, vertices: int) -> Any:
    """A whole number as people write it: 10000, 1e4, "10k", "10,000"; "50%" is of the vertices."""
    if isinstance(given, (float, np.floating)) and float(given).is_integer():
        return int(given)
    if not isinstance(given, str):
        return given
    grouped = r"[0-9]{1,3}(?:,[0-9]{3})+|[0-9][0-9_]*\.?[0-9]*(?:e[0-9]+)?"
    found = re.fullmatch(rf"({grouped})\s*(k|m|%|)", given.strip().lower())
    if found is None:
        raise _engine.InputError(f'{name} is {given!r}; a number is needed, as 10000, "10k" or "50%"')
    number = float(re.sub("[,_]", "", found[1]))
    if found[2] == "%":
        return max(1, round(number / 100 * vertices))
    number *= _UNITS[found[2]]
    if not number.is_integer():
        raise _engine.InputError(f"{name} is {given!r}; a whole number is needed")
    return int(number)


def _one_size(edge_length: Any, **others: Any) -> None:
    """Edges have one length, or one for each vertex; a number of points or of faces may come with the latter."""
    for name, other in others.items():
        if edge_length is not None and other is not None:
            raise _engine.InputError(f"{name} and edge_length are given; give one of them")


def _counted(surface: Surface, given: dict[str, Any]) -> dict[str, Any]:
    """The same with its counts as whole numbers."""
    names = ("points", "facets", "max_points", "lloyd", "newton", "seed")
    counts = {name: count(name, given[name], len(surface.vertices)) for name in names if name in given}
    return {**given, **counts}


def _with_regions(attributes: Attributes | None, name: str | None, surface: Surface) -> Attributes | None:
    """The same with the data of faces of this name as regions."""
    if name is None:
        return attributes
    if name not in surface.face_data:
        known = ", ".join(repr(known) for known in surface.face_data) or "none"
        raise _engine.InputError(f"regions is {name!r}; the faces have the data {known}")
    regions = np.asarray(surface.face_data[name])
    if regions.dtype.kind == "f" and np.array_equal(regions, np.rint(regions)):
        regions = regions.astype(np.int64)
    carried = replace(attributes or Attributes(), regions=regions, regions_from=name)
    if attributes is surface.attributes:
        surface.attributes = carried
    return carried


def _parts(surface: Surface, name: str, given: Any) -> list[str] | None:
    """Parts as texts. An array is one part: numbers of faces, or whether each is of it."""
    if given is None:
        return None
    if isinstance(given, (str, np.ndarray)):
        given = [given]
    parts = list(given)
    if parts and all(isinstance(part, (int, np.integer, np.bool_)) for part in parts):
        parts = [np.asarray(parts)]
    return [part if isinstance(part, str) else _faces(surface, name, np.asarray(part)) for part in parts]


def _faces(surface: Surface, name: str, part: np.ndarray[Any, Any]) -> str:
    if part.dtype.kind == "b" and part.shape == (len(surface.faces),):
        part = np.flatnonzero(part)
    if part.ndim != 1 or part.dtype.kind not in "iu" or part.size == 0 or part.min() < 0:
        raise _engine.InputError(
            f"{name} has an array of shape {part.shape}; give numbers of faces, at least one, or whether each face is of the part"
        )
    return _numbers("facets", part)


def _numbers(kind: str, numbers: np.ndarray[Any, Any]) -> str:
    """A part that is a list of at least one number."""
    numbers = np.unique(numbers)
    ends = np.flatnonzero(np.diff(numbers) != 1)
    first, last = numbers[np.append(0, ends + 1)], numbers[np.append(ends, -1)]
    return f"{kind}:" + ",".join(f"{a}-{b}" for a, b in zip(first.tolist(), last.tolist(), strict=True))


def remesh_options(surface: Surface, given: dict[str, Any]) -> tuple[dict[str, Any], Attributes | None]:
    """What the engine and the service take, and what the surface carries. `given` are the arguments of `remesh`."""
    given = _counted(surface, given)
    _one_size(given["edge_length"], **{name: given[name] for name in ("points", "facets", "sizes", "metric")})
    named = None if given["attributes"] is False else surface.creases
    required = None if given["attributes"] is False else surface.required
    attributes = _with_regions(_carried(given.pop("attributes"), surface), given.pop("regions"), surface)
    given.update(_density(given.pop("density")))
    given["sizes"], given["seeds"] = meshes._floats(given["sizes"]), meshes._floats(given["seeds"])
    given["metric"] = _tensors(given["metric"])
    given["keep"], given["only"] = (_parts(surface, name, given[name]) for name in ("keep", "only"))
    if required is not None:
        if any(given[name] is not None for name in ("seeds", "metric", "mirror")) or given["periodic"]:
            others = "seeds, a metric, a mirror plane and periodic boundaries"
            meshes.warn(f"{len(required)} required vertices: {others} leave them aside")
        else:
            given["keep"] = [*(given["keep"] or []), _numbers("vertices", required)]
    for name in ("size_in", "periodic"):
        texts = given[name]
        given[name] = [texts] if isinstance(texts, str) else texts and list(texts)
    lists = [edges for edges in (named, _edges(given["creases"])) if edges is not None]
    given["creases"] = np.concatenate(lists) if len(lists) > 1 else next(iter(lists), None)
    return given, attributes


def remesh(
    mesh: Any,
    faces: ArrayLike | None = None,
    points: float | str | None = None,
    *,
    facets: float | str | None = None,
    edge_length: float | None = None,
    density: Density | ArrayLike = "uniform",
    sizes: ArrayLike | None = None,
    metric: ArrayLike | None = None,
    gradation: float | None = None,
    size_in: str | Sequence[str] | None = None,
    adaptivity: float | None = None,
    max_deviation: float | None = None,
    max_points: float | str | None = None,
    crease_angle: float | None = None,
    creases: ArrayLike | None = None,
    strict_creases: bool = False,
    weld: float | str | None = None,
    non_manifold: Literal["cut", "keep"] | None = None,
    keep: str | ArrayLike | Sequence[str | ArrayLike] | None = None,
    only: str | ArrayLike | Sequence[str | ArrayLike] | None = None,
    keep_rims: bool = False,
    mirror: str | None = None,
    periodic: str | Sequence[str] | None = None,
    source_map: bool = False,
    boundaries: Literal["keep", "free"] | None = None,
    thin: Literal["finer", "even"] | None = None,
    anisotropy: float | Literal["auto"] | None = None,
    placement: Literal["fitted", "surface", "centroids"] | None = None,
    lloyd: int | None = None,
    newton: int | None = None,
    projection: Literal["free", "surface"] | None = None,
    seed: int | None = None,
    seeds: ArrayLike | None = None,
    attributes: bool | Attributes | dict[str, ArrayLike] = True,
    regions: str | None = None,
    measure: bool = True,
    backend: Literal["auto", "gpu", "parallel", "serial"] | None = None,
    threads: int | None = None,
    progress: ProgressLike = None,
    endpoint: str | None = None,
    **server: Any,
) -> Remesh:
    """Remeshes a triangle surface: about `points` vertices and well-shaped triangles.

    >>> import numpy as np, tessera_remesh
    >>> vertices = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
    >>> result = tessera_remesh.remesh(vertices, [(0, 1, 2), (0, 2, 3)], points=200)
    >>> result.report.boundary_loops
    1
    >>> vertices, faces = result
    >>> faces.shape[1]
    3

    What is None has the default of the command `tessera remesh`; the same arguments give the same bits there, here and from a
    server on the same backend.

    Args:
        mesh: vertices, (n, 3) float; the name of a file; or an object of trimesh, pyvista or meshio.
        faces: (m, 3) integer indices from 0, with vertices only.
        points: number of seeds, about the number of vertices of the result: 10000, 1e4, "10k", or "50%" of the vertices. This,
            `facets`, `edge_length`, `sizes`, `metric` or `seeds` is needed.
        facets: about how many faces the result has, instead of `points`.
        edge_length: length of the edges in the mesh's units, instead of `points`.
        density: where short edges go: "uniform", "curvature" (where the surface bends), "lfs" (where it is thin, hollow or
            sharp); or (n,) float, a weight for each vertex, at least 0: an edge length h needs a weight proportional to h**-4.
        sizes: (n,) float above 0: length of the edges at each vertex. With `points` only the ratios are kept.
        metric: (n, 6) float, a metric tensor for each vertex: m11 m12 m22 m13 m23 m33; or (n, 3, 3). An edge e gets about length
            1, the root of e @ M @ e. With `points` the metric is scaled for their number.
        gradation: the most that edge lengths grow per distance, above 0.
        size_in: lengths of edges in parts: "PART=LENGTH" with a part as for `keep`, or several. Lengths around grow by `gradation`.
        adaptivity: 0 for edges of one length, 1 for lengths as `density` or `sizes` says.
        max_deviation: adds points where the result is farther than this from the mesh, percent of the diagonal of its box.
        max_points: the most points that `max_deviation` may come to; twice `points` if None.
        crease_angle: edges bent by more than this are creases that are kept, degrees from 0 (none) to 180.
        creases: (k, 2) integer: edges that are creases whatever their angle.
        strict_creases: whether a remesh that would drop a crease or a boundary is refused: an InputError in place of a warning.
        non_manifold: "cut": sheets that meet in an edge have vertices of their own there; or "keep": they have them in common.
        keep: parts that stay as they are, to the bit: "box:X0,Y0,Z0,X1,Y1,Z1", "sphere:X,Y,Z,R", each with the faces that touch it,
            a region by its name or number as text; an array of numbers of faces, or of whether each is of the part; "vertices:7,12"
            for vertices alone; or several. They come first in the result; `points` counts all of its vertices.
        only: parts that are remeshed, with the faces that are in a box or ball wholly; all else stays as it is.
        keep_rims: whether the vertices and edges of boundaries stay as they are.
        mirror: a plane at which the result is symmetric: "x", "-y", "z=0.5", or "NX,NY,NZ,D". The half that the normal points to is
            remeshed, and the other half is its mirror image, to the bit.
        periodic: motions that take boundaries to others: "translate:DX,DY,DZ" or "rotate:DEGREES,AXIS", or several. AXIS is "x", "y",
            "z", "DX,DY,DZ", or "DX,DY,DZ,PX,PY,PZ" through a place. Both get the same vertices and edges, moved.
        source_map: whether the result has the scalars "source_facet", the face of `mesh` on which a vertex lies, and
            "source_barycentric", its coordinates in that face.
        weld: boundaries that are at most this far apart are joined: a length, or percent of the diagonal as "0.01%".
        boundaries: "keep", or "free": the rim settles about half an edge inside.
        thin: "finer": shorter edges where the surface is too thin for its cells; or "even".
        anisotropy: longer facets where the surface bends less: how far normals lift it, as a share of its diagonal from 0
            (none) to 10, or "auto", by its curvature.
        placement: where vertices go: "fitted" (nearest to the surface in the mean), "surface", "centroids".
        lloyd: Lloyd steps.
        newton: quasi-Newton steps after them, at most.
        projection: where seeds go after each step: "free", or "surface".
        seed: random seed of the first points.
        seeds: (s, 3) float: first seeds, instead of `points`.
        attributes: True: the result carries what the object carries; False: nothing; or `Attributes`, or a dictionary of (n,)
            scalars, for vertices and faces.
        regions: the name of data of faces, as of `cell_data`, that are the regions of faces: whole numbers. A remesh keeps the
            borders between regions, and the result has the region of each face under the same name.
        measure: whether to measure quality and distance for the report.
        backend: "auto" (the GPU if there is one, else all cores), "gpu", "parallel", "serial".
        threads: threads of this call; all cores if None. Not for a server.
        progress: called with each `Progress`; True shows a bar. An exception that it raises cancels the work and comes back.
        endpoint: a server that does the work, such as "https://tessera.example.org:50051". Needs the extra `service`.
        **server: `key`, `tenant`, `ca`, `timeout`, as `tessera_remesh.service.Client` takes them.

    Raises:
        InputError: the mesh, an array or an option is wrong.
        BackendError: the backend is not here.
        TooLargeError: there is not enough memory.
        Cancelled: the work was cancelled.
        service.ServerError: the server said no.
        KeyboardInterrupt: Ctrl-C; the work has stopped.
    """
    values = locals()
    surface = meshes.surface(mesh, faces)
    options, carried = remesh_options(surface, {name: values[name] for name in OPTIONS})
    with listener(progress) as listen:
        if endpoint is not None:
            from .service import Client

            with Client(endpoint, **server) as client:
                return client._remesh(surface, options, carried, listen)
        _no_server(server)
        options["attributes"] = None if carried is None else carried._to_engine()
        done = _engine.remesh(surface.vertices, surface.faces, options, listen)
        return to_remesh(surface, carried, done)


#: The keywords of `remesh` that say what it does, and their defaults.
OPTIONS = {
    name: parameter.default
    for name, parameter in inspect.signature(remesh).parameters.items()
    if name not in ("mesh", "faces", "progress", "endpoint", "server")
}


def to_remesh(surface: Surface, carried: Attributes | None, done: dict[str, Any]) -> Remesh:
    """What the engine or a server gave back for `surface` with what it carries."""
    attributes = done.pop("attributes", None)
    report = Report.from_json(done.pop("report"))
    for warning in report.warnings:
        warn(warning["message"])
    made = None if attributes is None else Attributes._from_engine(attributes)._like(carried)
    # Given attributes take the place of all that the object carries.
    face_data = meshes.below(surface, done["vertices"], done["faces"]) if carried is surface.attributes else {}
    if made is not None and made.regions is not None and made.regions_from:
        face_data[made.regions_from] = made.regions
    return Remesh(report=report, attributes=made, library=surface.library, face_data=face_data, **done)


def _no_server(server: dict[str, Any]) -> None:
    for name in server:
        if name in ("key", "tenant", "ca", "timeout"):
            raise TypeError(f"{name} is for a server; give endpoint too")
        raise TypeError(f"there is no argument {name}")


def rvd_options(surface: Surface, given: dict[str, Any]) -> dict[str, Any]:
    """What the engine and the service take. `given` are the arguments of `rvd`."""
    given = _counted(surface, given)
    given["seeds"], given["weights"] = meshes._floats(given["seeds"]), meshes._floats(given["weights"])
    if given["seeds"] is None and given["points"] is None:
        raise _engine.InputError("seeds or points is needed")
    return given


def rvd(
    mesh: Any,
    faces: ArrayLike | None = None,
    *,
    seeds: ArrayLike | None = None,
    points: float | str | None = None,
    seed: int | None = None,
    weights: ArrayLike | None = None,
    pieces: bool = True,
    backend: Literal["auto", "gpu", "parallel", "serial"] | None = None,
    threads: int | None = None,
    endpoint: str | None = None,
    **server: Any,
) -> Rvd:
    """The restricted Voronoi diagram of seeds on a surface: exact cells, their centroids, areas and energies.

    >>> import numpy as np, tessera_remesh
    >>> square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
    >>> cells = tessera_remesh.rvd(square, [(0, 1, 2), (0, 2, 3)], seeds=[(0.25, 0.5, 0), (0.75, 0.5, 0)])
    >>> cells.areas.round(6).tolist()
    [0.5, 0.5]

    Args:
        mesh: vertices, (n, 3) float; or an object of trimesh, pyvista or meshio.
        faces: (m, 3) integer indices from 0, with vertices only.
        seeds: (s, 3) float, anywhere near the surface.
        points: draws so many seeds instead: 1000, "10k", or "50%" of the vertices.
        seed: random seed of drawn ones.
        weights: (n,) float at least 0, a weight for each vertex, linear in each face.
        pieces: whether to give the polygons in which cells meet faces.
        backend: "auto", "gpu", "parallel", "serial".
        threads: threads of this call; all cores if None.
        endpoint: a server that does the work.
        **server: `key`, `tenant`, `ca`, `timeout`.

    Raises:
        As `remesh`.
    """
    surface = meshes.surface(mesh, faces)
    given = {"seeds": seeds, "points": points, "seed": seed, "weights": weights, "pieces": pieces}
    options = rvd_options(surface, {**given, "backend": backend, "threads": threads})
    if endpoint is not None:
        from .service import Client

        with Client(endpoint, **server) as client:
            return client._rvd(surface, options)
    _no_server(server)
    return Rvd(**_engine.rvd(surface.vertices, surface.faces, options))


def cvt(
    mesh: Any,
    faces: ArrayLike | None = None,
    points: float | str | None = None,
    *,
    seeds: ArrayLike | None = None,
    seed: int | None = None,
    density: Density | ArrayLike = "uniform",
    sizes: ArrayLike | None = None,
    edge_length: float | None = None,
    gradation: float | None = None,
    adaptivity: float | None = None,
    projection: Literal["free", "surface"] | None = None,
    lloyd: int = 5,
    newton: int = 30,
    backend: Literal["auto", "gpu", "parallel", "serial"] | None = None,
    threads: int | None = None,
    endpoint: str | None = None,
    **server: Any,
) -> Iterator[CvtStep]:
    """Centroidal Voronoi iterations, one `CvtStep` at a time. The next step is taken when it is asked for.

    >>> import numpy as np, tessera_remesh
    >>> square = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], dtype=float)
    >>> steps = list(tessera_remesh.cvt(square, [(0, 1, 2), (0, 2, 3)], points=50, lloyd=3, newton=0))
    >>> steps[2].energy < steps[0].energy
    True
    >>> steps[2].seeds.shape
    (50, 3)

    Args:
        mesh, faces, points, seeds, seed, density, sizes, edge_length, gradation, adaptivity, projection, backend, threads,
            endpoint, **server: as of `remesh`.
        lloyd: Lloyd steps.
        newton: quasi-Newton steps after them, at most; they end when converged.

    Raises:
        As `remesh`, at the first step.
    """
    _one_size(edge_length, points=points, sizes=sizes)
    surface = meshes.surface(mesh, faces)
    options = {
        "points": points,
        "seeds": meshes._floats(seeds),
        "seed": seed,
        **_density(density),
        "sizes": meshes._floats(sizes),
        "edge_length": edge_length,
        "gradation": gradation,
        "adaptivity": adaptivity,
        "projection": projection,
        "backend": backend,
        "threads": threads,
    }
    options = _counted(surface, options)
    lloyd, newton = (count(name, steps, 0) for name, steps in (("lloyd", lloyd), ("newton", newton)))
    if lloyd < 0 or newton < 0:
        raise _engine.InputError("lloyd and newton are at least 0")
    if endpoint is not None:
        from .service import Client

        return Client(endpoint, **server)._cvt(surface, options, lloyd, newton)
    _no_server(server)
    return _steps(surface, options, lloyd, newton)


def _steps(surface: Surface, options: dict[str, Any], lloyd: int, newton: int) -> Iterator[CvtStep]:
    session = _engine.Cvt(surface.vertices, surface.faces, options)
    for kind in ["lloyd"] * lloyd + ["newton"] * newton:
        step = CvtStep(**session.step(kind))
        yield step
        if kind == "newton" and step.converged:
            return
