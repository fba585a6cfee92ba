"""Promise: objects of trimesh, pyvista and meshio come in and go out, with what they carry."""

from __future__ import annotations

import sys

import numpy as np
import pytest
import tessera_remesh

from conftest import torus


def test_trimesh(surface):
    trimesh = pytest.importorskip("trimesh")
    mesh = trimesh.Trimesh(*surface, process=False)
    mesh.visual.vertex_colors = np.tile([10, 20, 30, 255], (len(mesh.vertices), 1)).astype(np.uint8)
    mesh.vertex_attributes["heat"] = surface[0][:, 2]
    result = tessera_remesh.remesh(mesh, points=300)
    out = result.mesh
    assert isinstance(out, trimesh.Trimesh) and out.is_watertight
    assert (np.asarray(out.visual.vertex_colors)[:, :3] == [10, 20, 30]).all()
    assert np.abs(out.vertex_attributes["heat"] - out.vertices[:, 2]).max() < 0.2
    assert np.array_equal(result.vertices, tessera_remesh.remesh(*surface, points=300).vertices)


def test_pyvista(surface):
    pyvista = pytest.importorskip("pyvista")
    mesh = pyvista.PolyData.from_regular_faces(*surface)
    mesh.point_data["heat"] = surface[0][:, 2]
    mesh.point_data["a name"] = surface[0][:, 1]
    result = tessera_remesh.remesh(mesh, points=300)
    out = result.mesh
    assert isinstance(out, pyvista.PolyData) and out.is_all_triangles and out.is_manifold
    assert np.abs(out.point_data["heat"] - out.points[:, 2]).max() < 0.2
    assert "a_name" in out.point_data
    # Polygons are divided, and volumes have a surface.
    for other in (pyvista.Cube(), pyvista.ImageData(dimensions=(4, 4, 4))):
        assert tessera_remesh.remesh(other, points=100).report.euler == 2
    # Found by itself.
    again = mesh.tessera.remesh(300)
    assert np.array_equal(again.points, out.points)
    assert mesh.tessera.rvd(points=20).n_cells >= 20
    assert next(mesh.tessera.cvt(20)).seeds.shape == (20, 3)


def test_meshio(surface):
    meshio = pytest.importorskip("meshio")
    mesh = meshio.Mesh(surface[0], [("triangle", surface[1])], point_data={"flow": surface[0]})
    out = tessera_remesh.remesh(mesh, points=300).mesh
    assert isinstance(out, meshio.Mesh) and out.cells[0].type == "triangle"
    assert set(out.point_data) == {"flow_0", "flow_1", "flow_2"}
    quads = meshio.Mesh([[0, 0], [1, 0], [1, 1], [0, 1]], [("quad", [[0, 1, 2, 3]])])
    assert tessera_remesh.remesh(quads, points=50).report.boundary_loops == 1
    with pytest.raises(tessera_remesh.InputError, match="line"):
        tessera_remesh.remesh(meshio.Mesh([[0, 0, 0], [1, 0, 0]], [("line", [[0, 1]])]), points=10)


def test_arrays_need_none_of_these():
    import subprocess

    code = (
        "import sys, numpy, tessera_remesh\n"
        "tessera_remesh.remesh(numpy.array([(0,0,0),(1,0,0),(0,1,0)], dtype=float), [(0,1,2)], points=20)\n"
        "assert not {'trimesh','pyvista','meshio','matplotlib','grpc','tqdm'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


def test_plots(surface):
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    result = tessera_remesh.remesh(*torus(20, 10), points=50)
    assert result.plot() is not None and result.plot_energies() is not None
