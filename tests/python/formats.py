"""Files of VTK, meshio and trimesh, and what they make of ours.

    python formats.py write FOLDER     # files in every format and dialect, and list.txt: what each of them holds
    TESSERA_FORMATS=FOLDER cargo test --test mesh -- --ignored files_of_other_libraries
    python formats.py check FOLDER     # reads what that test wrote to FOLDER/ours

A line of list.txt has the file's name, its vertices, its triangles, its area, and what its points carry besides.
clients/python/tests/run.sh does all three.
"""

import gzip
import itertools
import pathlib
import shutil
import sys

import meshio
import numpy as np
import pyvista
import trimesh
import vtk

# Files that are written, so that none is forgotten.
FILES = 117


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

    def holds(name, vertices=len(points), triangles=len(faces), size=whole, carried="-"):
        held.append(f"{name} {vertices} {triangles} {float(size)!r} {carried}")

    def legacy(name, source, writer, text, version):
        writer.SetFileName(str(folder / name))
        writer.SetInputData(source)
        writer.SetFileType(1 if text else 2)
        writer.SetFileVersion(version)
        writer.Write()

    grid = data.cast_to_unstructured_grid()
    quads = pyvista.Plane(i_resolution=5, j_resolution=4)
    strips = data.strip()
    every = "normals,texture,colours,scalars"
    for text, version in itertools.product([True, False], [42, 51]):
        end = f"{'text' if text else 'binary'}-{version}.vtk"
        legacy(f"poly-{end}", data, vtk.vtkPolyDataWriter(), text, version)
        holds(f"poly-{end}", carried=every)
        legacy(f"grid-{end}", grid, vtk.vtkUnstructuredGridWriter(), text, version)
        holds(f"grid-{end}", carried=every)
        legacy(f"quads-{end}", quads, vtk.vtkPolyDataWriter(), text, version)
        holds(f"quads-{end}", 30, 40, 1.0, "normals,texture")
        legacy(f"strips-{end}", strips, vtk.vtkPolyDataWriter(), text, version)
        holds(f"strips-{end}", carried=every)
    for mode, packed, big in itertools.product(["Ascii", "Binary", "AppendedRaw", "Appended64"], [0, 1], [0, 1]):
        for name, source, end in [("poly", data, "vtp"), ("strips", strips, "vtp"), ("grid", grid, "vtu")]:
            name = f"{name}-{mode}-{packed}-{big}.{end}"
            writer = vtk.vtkXMLPolyDataWriter() if end == "vtp" else vtk.vtkXMLUnstructuredGridWriter()
            writer.SetFileName(str(folder / name))
            writer.SetInputData(source)
            writer.SetDataMode(["Ascii", "Binary", "AppendedRaw"].index(mode) if mode in ("Ascii", "Binary") else 2)
            writer.SetEncodeAppendedData(mode == "Appended64")
            writer.SetCompressor(vtk.vtkZLibDataCompressor() if packed else None)
            writer.SetByteOrder(0 if big else 1)
            writer.SetHeaderTypeToUInt64() if big else writer.SetHeaderTypeToUInt32()
            writer.Write()
            holds(name, carried=every)

    # meshio 5.3 writes numbers as Python shows them, which numpy 2 changed to "np.float64(0.0)".
    if int(np.__version__.split(".")[0]) >= 2:
        np.set_printoptions(legacy="1.25")
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
        ("meshio-text.vtu", "vtu", {"binary": False}),
        ("meshio-binary.vtu", "vtu", {"binary": True, "compression": None}),
        ("meshio-zlib.vtu", "vtu", {"binary": True}),
        ("text.mesh", "medit", {}),
        ("binary.meshb", "medit", {}),
    ]:
        for part, it, counts in [("ball-", mesh, ()), ("mixed-", mixed, (6, 4, 2.0))]:
            if kind == "gmsh" and part == "mixed-":
                continue  # It asks for the parts of a model, which there are not.
            meshio.write(folder / (part + name), it, file_format=kind, **options)
            keeps = part == "ball-" and kind != "medit"
            holds(part + name, *counts, carried="scalars" if keeps else "-")
    for name, kind, options, carried in [
        ("meshio-text.ply", "ply", {"binary": False}, "scalars"),
        ("meshio-binary.ply", "ply", {"binary": True}, "scalars"),
        ("meshio-text.stl", "stl", {"binary": False}, "-"),
        ("meshio-binary.stl", "stl", {"binary": True}, "-"),
        ("meshio.obj", "obj", {}, "-"),
        ("meshio.off", "off", {}, "-"),
    ]:
        meshio.write(folder / name, mesh, file_format=kind, **options)
        holds(name, carried=carried)

    bare = pyvista.PolyData.from_regular_faces(points, faces)
    for name, binary in [("vtk-text", False), ("vtk-binary", True)]:
        for end in ["ply", "stl"]:
            bare.save(folder / f"{name}.{end}", binary=binary)
            holds(f"{name}.{end}", carried="normals" if end == "ply" else "-")

    ball = trimesh.Trimesh(points, faces, process=False)
    coloured = trimesh.Trimesh(points, faces, vertex_colors=data.point_data["RGB"], process=False)
    for name, options, carried in [
        ("trimesh-binary.ply", {}, "colours"),
        ("trimesh-text.ply", {"encoding": "ascii"}, "colours"),
        ("trimesh.obj", {}, "colours"),
        ("trimesh.off", {}, "-"),
        ("trimesh.stl", {}, "-"),
        ("trimesh.glb", {}, "colours"),
        ("trimesh-normals.glb", {"include_normals": True}, "normals,colours"),
    ]:
        coloured.export(folder / name, **options)
        holds(name, carried=carried)
    coloured.export(folder / "trimesh-text.stl", file_type="stl_ascii")
    holds("trimesh-text.stl")
    # With its data in files beside it.
    for name, content in trimesh.exchange.gltf.export_gltf(trimesh.Scene(coloured)).items():
        (folder / name.replace("model", "beside")).write_bytes(content)
    holds("beside.gltf", carried="normals,colours")
    textured = ball.copy()
    textured.visual = trimesh.visual.TextureVisuals(uv=points[:, :2])
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(textured), embed_buffers=True)
    (folder / "trimesh.gltf").write_bytes(files["model.gltf"])
    holds("trimesh.gltf", carried="texture")
    textured.export(folder / "trimesh-textured.glb")
    holds("trimesh-textured.glb", carried="texture")

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
    for name in ["poly-Binary-1-0.vtp", "poly-text-42.vtk", "ball-41-binary.msh", "ball-text.mesh", "ball.glb", "trimesh.obj"]:
        with open(folder / name, "rb") as plain, gzip.open(folder / f"{name}.gz", "wb") as packed:
            shutil.copyfileobj(plain, packed)
        line = next(line for line in held if line.startswith(f"{name} "))
        held.append(line.replace(f"{name} ", f"{name}.gz ", 1))
    (folder / "list.txt").write_text("\n".join(held) + "\n")
    assert len(held) == FILES and all((folder / line.split()[0]).is_file() for line in held), len(held)
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

    normals = points / np.linalg.norm(points, axis=1)[:, None]
    uv = points[:, :2]
    colours = np.stack([np.full(len(points), 51), np.where(points[:, 2] > 0, 255, 0), np.full(len(points), 102)], axis=1)
    assert np.allclose(wanted_normals(wanted), normals)
    assert np.array_equal(wanted.point_data["height"], points[:, 2])
    for k, name in enumerate(["red", "green", "blue"]):
        # meshio takes unsigned bytes as signed ones.
        assert np.array_equal(wanted.point_data[name].astype(np.uint8), colours[:, k]), name
    assert np.array_equal(np.stack([wanted.point_data["s"], wanted.point_data["t"]], axis=1), uv)
    print("a.ply is right")
    for name in ["a.vtk", "a.vtp", "a.vtu"]:
        found = pyvista.read(ours / name)
        if name == "a.vtu":
            read = meshio.read(ours / name)
            same(name, read.points, read.cells_dict["triangle"])
        # Of a grid, the count of corners stands before those of each cell.
        cells = found.cells.reshape(-1, 4)[:, 1:] if name == "a.vtu" else found.regular_faces
        same(name, found.points, cells)
        held = found.point_data
        assert np.array_equal(held["height"], points[:, 2]), name
        assert held["RGB"].dtype == np.uint8 and np.array_equal(held["RGB"], colours), name
        assert np.array_equal(held["Normals"], wanted_normals(wanted)), name
        assert np.allclose(held.active_texture_coordinates, uv), name
    for name in ["a.msh", "a.mesh", "a.meshb"]:
        found = meshio.read(ours / name)
        same(name, found.points, found.cells_dict["triangle"])
        if name == "a.msh":
            assert np.array_equal(found.point_data["height"].ravel(), points[:, 2])
    for name in ["a.glb", "a.gltf"]:
        found = trimesh.load(ours / name, process=False, force="mesh")
        same(name, found.vertices, found.faces, exact=False)
        block = pyvista.read(ours / name)
        found = next(part for part in block.recursive_iterator() if part is not None and part.n_points)
        same(name, found.points, found.regular_faces, exact=False)
        held = found.point_data
        assert np.allclose(held["NORMAL"], normals, atol=1e-6), name
        assert np.allclose(held["TEXCOORD_0"], np.stack([uv[:, 0], 1 - uv[:, 1]], axis=1), atol=1e-6), name
        found = held["COLOR_0"] if held["COLOR_0"].dtype == np.uint8 else np.rint(held["COLOR_0"] * 255)
        assert np.array_equal(found[:, :3], colours), name
    found = trimesh.load(ours / "a.obj", process=False, maintain_order=True)
    same("a.obj", found.vertices, found.faces)
    assert np.allclose(found.vertex_normals, normals, atol=1e-6) and np.allclose(found.visual.uv, uv)
    found = trimesh.load(ours / "a.off", process=False)
    same("a.off", found.vertices, found.faces)
    found = trimesh.load(ours / "a.stl", process=False)
    assert np.allclose(found.triangles, points[faces], atol=1e-6), "a.stl"
    print("a.stl is right")


def wanted_normals(mesh):
    return np.stack([mesh.point_data[name] for name in ("nx", "ny", "nz")], axis=1)


if __name__ == "__main__":
    {"write": write, "check": check}[sys.argv[1]](pathlib.Path(sys.argv[2]))
