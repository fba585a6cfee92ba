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
    assert "a name" in out.point_data
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
    assert out.point_data["flow"].shape == (300, 3) and np.abs(out.point_data["flow"] - out.points).max() < 0.2
    quads = meshio.Mesh([[0, 0], [1, 0], [1, 1], [0, 1]], [("quad", [[0, 1, 2, 3]])])
    assert tessera_remesh.remesh(quads, points=50).report.boundary_loops == 1
    with pytest.raises(tessera_remesh.InputError, match="line"):
        tessera_remesh.remesh(meshio.Mesh([[0, 0, 0], [1, 0, 0]], [("line", [[0, 1]])]), points=10)


def test_face_data_are_those_of_the_face_below(surface):
    pyvista, trimesh, meshio = (pytest.importorskip(name) for name in ("pyvista", "trimesh", "meshio"))
    vertices, faces = surface
    side = np.where(vertices[faces].mean(axis=1)[:, 2] > 0, 7, -1).astype(np.int32)
    objects = [
        pyvista.PolyData.from_regular_faces(vertices, faces),
        trimesh.Trimesh(vertices, faces, process=False),
        meshio.Mesh(vertices, [("triangle", faces)], cell_data={"side": [side]}),
    ]
    objects[0].cell_data["side"], objects[1].face_attributes["side"] = side, side
    get = [
        lambda mesh: np.asarray(mesh.cell_data["side"]),
        lambda mesh: mesh.face_attributes["side"],
        lambda mesh: mesh.cell_data["side"][0],
    ]
    for mesh, data in zip(objects, get):
        result = tessera_remesh.remesh(mesh, points=400, newton=5)
        found, height = data(result.mesh), result.vertices[result.faces].mean(axis=1)[:, 2]
        assert found.dtype == np.int32 and len(found) == len(result.faces)
        clear = np.abs(height) > 0.05
        assert (found[clear] == np.where(height > 0, 7, -1)[clear]).all()
        assert not tessera_remesh.remesh(mesh, points=100, attributes=False).face_data
    # Two quadrilaterals become four triangles, each with its own.
    points = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [1, 1, 0], [2, 1, 0]]
    quads = meshio.Mesh(points, [("quad", [[0, 1, 4, 3], [1, 2, 5, 4]])], cell_data={"part": [[1, 2]]})
    result = tessera_remesh.remesh(quads, points=100)
    middle = result.vertices[result.faces].mean(axis=1)[:, 0]
    clear = np.abs(middle - 1) > 0.01
    assert (result.face_data["part"][clear] == np.where(middle < 1, 1, 2)[clear]).all()


def test_data_of_faces_may_be_regions(surface):
    pyvista, meshio = (pytest.importorskip(name) for name in ("pyvista", "meshio"))
    vertices, faces = surface
    # A slanted border, which no crease has.
    middle = vertices[faces].mean(axis=1)
    material = np.where(middle @ [1, 2, 3] > 0.7, 7, -1).astype(np.int16)
    objects = [pyvista.PolyData.from_regular_faces(vertices, faces), meshio.Mesh(vertices, [("triangle", faces)])]
    objects[0].cell_data["material"], objects[1].cell_data["material"] = material, [material.astype(float)]
    for mesh, get in zip(objects, (lambda mesh: mesh.cell_data["material"], lambda mesh: mesh.cell_data["material"][0])):
        result = tessera_remesh.remesh(mesh, points=600, regions="material")
        found = np.asarray(get(result.mesh))
        assert set(found) == {7, -1} and np.array_equal(found, result.attributes.regions)
        corners = result.vertices[result.faces]
        areas = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
        was = vertices[faces]
        were = np.linalg.norm(np.cross(was[:, 1] - was[:, 0], was[:, 2] - was[:, 0]), axis=1) / 2
        # Chords of 600 points lose less than this.
        assert abs(areas[found == 7].sum() / were[material == 7].sum() - 1) < 0.02
        report = result.report.raw["result"]["regions"]
        assert {region["number"] for region in report} == {7, -1}
    assert np.asarray(get(objects[1])).dtype == np.float64
    with pytest.raises(tessera_remesh.InputError, match="the faces have the data 'material'"):
        tessera_remesh.remesh(objects[0], points=100, regions="materials")
    objects[0].cell_data["height"] = middle[:, 2]
    with pytest.raises(tessera_remesh.InputError, match="integer is needed"):
        tessera_remesh.remesh(objects[0], points=100, regions="height")


def test_texture_and_normals_reach_the_libraries(surface):
    pyvista, trimesh = (pytest.importorskip(name) for name in ("pyvista", "trimesh"))
    sphere = pyvista.Sphere(theta_resolution=40, phi_resolution=40)
    sphere.active_texture_coordinates = np.asarray(sphere.points[:, :2]) * 0.3
    out = tessera_remesh.remesh(sphere, points=300).mesh
    assert np.abs(out.active_texture_coordinates - out.points[:, :2] * 0.3).max() < 0.01
    around = out.points / np.linalg.norm(out.points, axis=1)[:, None]
    assert (np.einsum("ij,ij->i", out.active_normals, around) > 0.98).all()
    vertices, faces = surface
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.visual = trimesh.visual.TextureVisuals(uv=vertices[:, :2] * 0.1)
    out = tessera_remesh.remesh(mesh, points=300).mesh
    assert np.abs(out.visual.uv - out.vertices[:, :2] * 0.1).max() < 0.05
    # A cube's corners have three normals each, and its faces texture of their own: the result has a vertex for each.
    out = tessera_remesh.remesh(pyvista.Cube(clean=False).triangulate(), points=300).mesh
    assert np.allclose(np.abs(out.active_normals).max(axis=1), 1) and out.n_points > 300
    assert out.clean(tolerance=1e-9).n_open_edges == 0


def test_what_cannot_be_carried_is_a_warning(surface):
    pyvista = pytest.importorskip("pyvista")
    mesh = pyvista.PolyData.from_regular_faces(*surface)
    count = mesh.n_points
    mesh.point_data["many"] = np.zeros((count, 65))
    mesh.point_data["id"] = np.arange(count) + 2**60
    mesh.point_data["a\tb"], mesh.point_data["a\x01b"] = np.zeros(count), np.ones(count)
    with pytest.warns(tessera_remesh.RemeshWarning) as caught:
        carried = tessera_remesh.remesh(mesh, points=100).attributes.scalars
    said = sorted(str(warning.message) for warning in caught)
    assert len(said) == 2 and "id" in said[0] and "many" in said[1]
    # Control characters are no part of a name.
    assert sorted(carried) == ["a_b", "a_b_2"] and (carried["a_b"] == 0).all() and (carried["a_b_2"] == 1).all()


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
