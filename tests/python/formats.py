"""Files of VTK, meshio and trimesh, and what they make of ours.

    python formats.py write FOLDER     # files in every format and dialect, and list.txt: what each of them holds
    TESSERA_FORMATS=FOLDER cargo test --test mesh -- --ignored files_of_other_libraries
    python formats.py check FOLDER     # reads what that test wrote to FOLDER/ours

A line of list.txt has the file's name, its vertices, its triangles and its area.
"""

import itertools
import pathlib
import sys

import meshio
import numpy as np
import pyvista
import trimesh
import vtk


def surface():
    """An ellipsoid of triangles, closed, with numbers, colours, normals and texture coordinates of its points."""
    ball = trimesh.creation.icosphere(subdivisions=2)
    points = ball.vertices * [1.0, 0.7, 1 / 3]
    faces = np.asarray(ball.faces)
    data = pyvista.PolyData.from_regular_faces(points, faces)
    data.point_data["height"] = points[:, 2]
    data.point_data["RGB"] = (np.abs(ball.vertices) * 255).astype(np.uint8)
    data.point_data["velocity"] = points * 2.0
    data.point_data.active_texture_coordinates = points[:, :2].copy()
    normals = ball.vertices.astype(np.float64)
    data.point_data["Normals"] = normals
    data.GetPointData().SetNormals(data.GetPointData().GetArray("Normals"))
    data.cell_data["part"] = np.arange(len(faces), dtype=np.int32)
    return points, faces, data


def area(points, faces):
    a, b, c = (points[faces[:, k]] for k in range(3))
    return 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum()


def write(folder):
    folder.mkdir(parents=True, exist_ok=True)
    points, faces, data = surface()
    whole = area(points, faces)
    held = []

    def holds(name, vertices=len(points), triangles=len(faces), size=whole):
        held.append(f"{name} {vertices} {triangles} {float(size)!r}")

    def legacy(name, source, writer, text, version):
        writer.SetFileName(str(folder / name))
        writer.SetInputData(source)
        writer.SetFileType(1 if text else 2)
        writer.SetFileVersion(version)
        writer.Write()

    grid = data.cast_to_unstructured_grid()
    quads = pyvista.Plane(i_resolution=5, j_resolution=4)
    strips = data.strip()
    for text, version in itertools.product([True, False], [42, 51]):
        end = f"{'text' if text else 'binary'}-{version}.vtk"
        legacy(f"poly-{end}", data, vtk.vtkPolyDataWriter(), text, version)
        holds(f"poly-{end}")
        legacy(f"grid-{end}", grid, vtk.vtkUnstructuredGridWriter(), text, version)
        holds(f"grid-{end}")
        legacy(f"quads-{end}", quads, vtk.vtkPolyDataWriter(), text, version)
        holds(f"quads-{end}", 30, 40, 1.0)
        legacy(f"strips-{end}", strips, vtk.vtkPolyDataWriter(), text, version)
        holds(f"strips-{end}")
    for mode, packed, big in itertools.product(["Ascii", "Binary", "AppendedRaw", "Appended64"], [0, 1], [0, 1]):
        for name, source in [("poly", data), ("strips", strips)]:
            name = f"{name}-{mode}-{packed}-{big}.vtp"
            writer = vtk.vtkXMLPolyDataWriter()
            writer.SetFileName(str(folder / name))
            writer.SetInputData(source)
            writer.SetDataMode(["Ascii", "Binary", "AppendedRaw"].index(mode) if mode in ("Ascii", "Binary") else 2)
            writer.SetEncodeAppendedData(mode == "Appended64")
            writer.SetCompressor(vtk.vtkZLibDataCompressor() if packed else None)
            writer.SetByteOrder(0 if big else 1)
            writer.SetHeaderTypeToUInt64() if big else writer.SetHeaderTypeToUInt32()
            writer.Write()
            holds(name)

    mesh = meshio.Mesh(points, [("triangle", faces)], point_data={"height": points[:, 2]})
    mixed = meshio.Mesh(
        np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0.0]]),
        [("line", [[0, 1], [1, 4]]), ("quad", [[0, 1, 2, 3]]), ("triangle", [[1, 4, 5], [1, 5, 2]])],
    )
    for name, kind, options in [
        ("22-text.msh", "gmsh22", {"binary": False}),
        ("22-binary.msh", "gmsh22", {"binary": True}),
        ("41-text.msh", "gmsh", {"binary": False}),
        ("41-binary.msh", "gmsh", {"binary": True}),
        ("meshio-text.vtk", "vtk42", {"binary": False}),
        ("meshio-binary.vtk", "vtk42", {"binary": True}),
        ("meshio-51-text.vtk", "vtk51", {"binary": False}),
        ("meshio-51-binary.vtk", "vtk51", {"binary": True}),
        ("text.mesh", "medit", {}),
        ("binary.meshb", "medit", {}),
    ]:
        for part, it, counts in [("ball-", mesh, ()), ("mixed-", mixed, (6, 4, 2.0))]:
            if kind == "gmsh" and part == "mixed-":
                continue  # It asks for the parts of a model, which there are not.
            meshio.write(folder / (part + name), it, file_format=kind, **options)
            holds(part + name, *counts)

    ball = trimesh.Trimesh(points, faces, process=False)
    ball.export(folder / "ball.glb")
    rounded = points.astype(np.float32).astype(np.float64)
    holds("ball.glb", size=area(rounded, faces))
    scene = trimesh.Scene()
    scene.add_geometry(ball, transform=trimesh.transformations.translation_matrix([5, 0, 0]))
    turned = trimesh.transformations.rotation_matrix(1.0, [1, 2, 3])
    scene.add_geometry(ball, transform=turned)
    mirrored = np.diag([-1.0, 1, 1, 1])
    scene.add_geometry(ball, transform=mirrored)
    scene.export(folder / "scene.glb")
    holds("scene.glb", 3 * len(points), 3 * len(faces), 3 * area(rounded, faces))
    (folder / "list.txt").write_text("\n".join(held) + "\n")
    print(f"{len(held)} files in {folder}")


def check(folder):
    ours = folder / "ours"
    wanted = meshio.read(ours / "a.ply")
    points, faces = wanted.points, wanted.cells_dict["triangle"]

    def same(name, found, cells, exact=True):
        found, cells = np.asarray(found), np.asarray(cells).reshape(-1, 3)
        right = np.array_equal(found, points) if exact else np.allclose(found, points, rtol=1e-6, atol=1e-7)
        assert right and np.array_equal(cells, faces), name
        print(name, "is right")

    for name in ["a.vtk", "a.vtp"]:
        found = pyvista.read(ours / name)
        same(name, found.points, found.regular_faces)
        held = found.point_data
        assert np.array_equal(held["height"], points[:, 2]), name
        assert held["RGB"].dtype == np.uint8 and held["RGB"].shape == (len(points), 3), name
        assert np.array_equal(held["Normals"], wanted_normals(wanted)), name
        assert np.allclose(held.active_texture_coordinates, points[:, :2]), name
    for name in ["a.msh", "a.mesh", "a.meshb"]:
        found = meshio.read(ours / name)
        same(name, found.points, found.cells_dict["triangle"])
        if name == "a.msh":
            assert np.array_equal(found.point_data["height"].ravel(), points[:, 2])
    for name in ["a.glb", "a.gltf"]:
        found = trimesh.load(ours / name, process=False, force="mesh")
        same(name, found.vertices, found.faces, exact=False)


def wanted_normals(mesh):
    return np.stack([mesh.point_data[name] for name in ("nx", "ny", "nz")], axis=1)


if __name__ == "__main__":
    {"write": write, "check": check}[sys.argv[1]](pathlib.Path(sys.argv[2]))
