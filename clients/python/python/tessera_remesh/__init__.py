"""Tessera: remeshing of triangle surfaces.

>>> import tessera_remesh
>>> sorted(tessera_remesh.backend("parallel", threads=2))
['adapter', 'kind', 'threads']

`remesh` makes a surface of well-shaped triangles, `rvd` computes exact restricted Voronoi diagrams, `cvt` yields centroidal
iterations. Each works in this process, or with `endpoint=` on a server. `tessera_remesh.service` has clients for many calls to
one server, also for asyncio. A pyvista mesh has `mesh.tessera.remesh(10_000)` where this package is installed.
"""

from ._engine import BackendError, Cancelled, InputError, TesseraError, TooLargeError, __version__, backend
from .calls import cvt, remesh, rvd
from .meshes import Attributes, RemeshWarning, Surface, read
from .progress import Progress
from .results import CvtStep, Remesh, Report, Rvd
from .surroundings import prepare

prepare()
del prepare

__all__ = [
    "Attributes",
    "BackendError",
    "Cancelled",
    "CvtStep",
    "InputError",
    "Progress",
    "Remesh",
    "RemeshWarning",
    "Report",
    "Rvd",
    "Surface",
    "TesseraError",
    "TooLargeError",
    "__version__",
    "backend",
    "cvt",
    "read",
    "remesh",
    "rvd",
]

