"""Promise: arrays come in as they are and go out as documented; wrong ones are told by name."""

from __future__ import annotations

import _thread
import os
import subprocess
import sys
import threading
import time
import warnings

import numpy as np
import pytest
import tessera_remesh
from tessera_remesh import Attributes, Cancelled, InputError, Progress, surroundings

from conftest import torus


def test_a_remesh_is_what_its_report_says(surface):
    result = tessera_remesh.remesh(*surface, points=500)
    vertices, faces = result
    assert vertices.dtype == np.float64 and faces.dtype == np.int32
    assert (len(vertices), len(faces)) == (result.report.vertices, result.report.faces)
    assert abs(len(vertices) - 500) <= 10
    assert result.report.euler == 0 and result.report.boundary_loops == 0
    assert faces.min() == 0 and faces.max() == len(vertices) - 1
    assert result.vertex_seeds.shape == (len(vertices),)
    assert result.seeds.shape == (500, 3)
    assert result.report.smallest_angle > 25
    # On the surface of the torus, up to its own edges.
    x, y, z = vertices.T
    assert np.abs(np.hypot(np.hypot(x, y) - 2, z) - 1).max() < 0.05


@pytest.mark.parametrize("floats", ["f8", "f4", ">f8", ">f4"])
@pytest.mark.parametrize("whole", ["i4", "i8", "u4", "u8", "i2", ">i4", ">u8"])
def test_types_of_arrays_make_no_difference(floats, whole):
    vertices, faces = torus(24, 12)
    vertices = np.round(vertices * 1024) / 1024  # the same in single precision
    expected = tessera_remesh.remesh(vertices, faces, points=100)
    got = tessera_remesh.remesh(vertices.astype(floats), faces.astype(whole), points=100)
    assert np.array_equal(got.vertices, expected.vertices) and np.array_equal(got.faces, expected.faces)


def test_strides_make_no_difference(surface):
    vertices, faces = surface
    expected = tessera_remesh.remesh(vertices, faces, points=100)
    wide = np.zeros((len(vertices), 7))
    wide[:, 1:6:2] = vertices
    views = wide[:, 1:6:2], np.asfortranarray(faces)
    got = tessera_remesh.remesh(*views, points=100)
    assert np.array_equal(got.vertices, expected.vertices) and np.array_equal(got.faces, expected.faces)
    # Lists are arrays too.
    got = tessera_remesh.remesh(vertices.tolist(), faces.tolist(), points=100)
    assert np.array_equal(got.vertices, expected.vertices)


def test_input_is_left_as_it_is(surface):
    vertices, faces = (array.copy() for array in surface)
    vertices.flags.writeable = faces.flags.writeable = False
    tessera_remesh.remesh(vertices, faces, points=100)
    assert np.array_equal(vertices, surface[0]) and np.array_equal(faces, surface[1])


def test_threads_make_no_difference(surface):
    results = [tessera_remesh.remesh(*surface, points=300, threads=threads, backend="parallel") for threads in (1, 2, 3)]
    for other in results[1:]:
        assert np.array_equal(other.vertices, results[0].vertices) and np.array_equal(other.faces, results[0].faces)


def test_what_stays_comes_first(surface):
    vertices, faces = surface
    result = tessera_remesh.remesh(vertices, faces, points=1200, keep="box:0.9,-9,-9,9,9,9", source_map=True)
    stays = faces[(vertices[faces][:, :, 0] >= 0.9).any(axis=1)]
    assert result.report.raw["result"]["kept"]["further_facets"] == 0
    assert np.array_equal(result.vertices[result.faces[: len(stays)]], vertices[stays])
    there = result.attributes.scalars["source_facet"].astype(int), result.attributes.scalars["source_barycentric"]
    places = (vertices[faces[there[0]]] * there[1][:, :, None]).sum(axis=1)
    assert np.abs(places - result.vertices).max() < 0.1


WRONG = [
    ({"points": 0}, "points"),
    ({"points": -1}, "points"),
    ({"points": 2.5}, "points"),
    ({}, "points"),
    ({"edge_length": -1.0}, "edge length"),
    ({"points": 100, "edge_length": 1.0}, "points and edge_length"),
    ({"edge_length": 1.0, "sizes": np.ones(1800)}, "sizes and edge_length"),
    ({"points": 100, "density": "thick"}, "density"),
    ({"points": 100, "density": np.ones(3)}, "weights"),
    ({"points": 100, "sizes": np.zeros(1800)}, "edge length"),
    ({"metric": np.ones((1800, 5))}, "metric has the shape"),
    ({"metric": np.zeros((1800, 6))}, "vertex 0 is not positive definite"),
    ({"metric": np.full((1800, 6), np.nan)}, "vertex 0 has a number that is not finite"),
    ({"metric": np.tile(np.eye(3) + np.eye(3, k=1), (1800, 1, 1))}, "not symmetric"),
    ({"metric": np.tile(np.eye(3), (9, 1, 1))}, "9 metric tensors"),
    ({"metric": np.tile(np.eye(3), (1800, 1, 1)), "density": "curvature"}, "exclude each other"),
    ({"metric": np.tile(np.eye(3), (1800, 1, 1)), "gradation": 0.3}, "gradation"),
    ({"metric": np.tile(np.eye(3), (1800, 1, 1)), "anisotropy": "auto"}, "anisotropy"),
    ({"points": 100, "placement": "here"}, "placement"),
    ({"points": 100, "creases": [[0, 5000]]}, "5000"),
    ({"points": 100, "creases": [[0, 1, 2]]}, "creases"),
    ({"points": 100, "strict_creases": "yes"}, "strict_creases"),
    ({"points": 100, "crease_angle": 200.0}, "crease_angle"),
    ({"points": 100, "max_points": 200}, "max_points"),
    ({"points": 100, "max_deviation": 0.0}, "max_deviation"),
    ({"points": 100, "backend": "abacus"}, "backend"),
    ({"points": 100, "threads": 0}, "threads"),
    ({"points": 100, "threads": 10**6}, "threads"),
    ({"points": 100, "seed": -1}, "seed"),
    ({"points": 100, "seeds": np.zeros((3, 3))}, "seeds"),
    ({"points": 100, "attributes": {"height": np.zeros(3)}}, "height"),
    ({"points": 100, "attributes": {"\theight": np.zeros(1800)}}, "name"),
    ({"points": 100, "attributes": 7}, "attributes"),
    ({"points": 100, "keep": ["box:1"]}, "keep"),
    ({"points": 100, "only": "steel"}, "no region"),
    ({"points": 100, "size_in": "steel"}, "size_in"),
    ({"points": 100, "mirror": "w"}, "mirror"),
    ({"points": 100, "mirror": ["x"]}, "mirror"),
    ({"points": 100, "periodic": "rotate:360,z"}, "periodic"),
    ({"metric": np.tile(np.eye(3), (1800, 1, 1)), "size_in": "box:0,0,0,1,1,1=1"}, "size_in"),
]


@pytest.mark.parametrize(("options", "words"), WRONG, ids=[repr(sorted(o))[:40] + str(i) for i, (o, _) in enumerate(WRONG)])
def test_wrong_options_are_told_by_name(surface, options, words):
    with pytest.raises(InputError, match=words):
        tessera_remesh.remesh(*surface, **options)


WRONG_ARRAYS = [
    (np.zeros((4, 2)), [[0, 1, 2]], "vertices"),
    (np.zeros(12), [[0, 1, 2]], "vertices"),
    ([["a", "b", "c"]], [[0, 0, 0]], "vertices"),
    (np.zeros((4, 3)), [[0, 1, 2, 3]], "faces"),
    (np.zeros((4, 3)), [[0, 1], [0, 1, 2]], "faces"),
    (np.zeros((4, 3)), [[0.0, 1.0, 2.0]], "faces"),
    (np.zeros((4, 3)), [[0, 1, -2]], "negative"),
    (np.zeros((4, 3)), [[0, 1, 4]], "4"),
    (np.zeros((4, 3)), np.zeros((0, 3), dtype=int), "."),
    (np.full((4, 3), np.nan), [[0, 1, 2]], "finite"),
    (np.zeros((4, 3), dtype=complex), [[0, 1, 2]], "real"),
    (np.zeros((4, 3)), [[0, 1, 2]], "."),
]


@pytest.mark.parametrize(("vertices", "faces", "words"), WRONG_ARRAYS)
def test_wrong_arrays_are_told_by_name(vertices, faces, words):
    with pytest.raises(InputError, match=words):
        tessera_remesh.remesh(vertices, faces, points=10)


def test_a_misspelt_argument_is_refused(surface):
    with pytest.raises(TypeError, match="pionts"):
        tessera_remesh.remesh(*surface, pionts=100)
    with pytest.raises(TypeError, match="endpoint"):
        tessera_remesh.remesh(*surface, points=100, key="tsr_x")
    with pytest.raises(InputError, match="is no surface"):
        tessera_remesh.remesh(42, points=100)
    with pytest.raises(FileNotFoundError, match="bunny.obj"):
        tessera_remesh.remesh("bunny.obj", points=100)


def test_attributes_are_carried(surface):
    vertices, faces = surface
    attributes = Attributes(
        scalars={"height": vertices[:, 2].copy()},
        colours=np.tile(np.array([[200, 100, 50]], dtype=np.uint8), (len(vertices), 1)),
        normals=vertices.copy(),
        texture=vertices[:, :2].copy(),
    )
    result = tessera_remesh.remesh(vertices, faces, points=800, attributes=attributes)
    carried = result.attributes
    assert np.abs(carried.scalars["height"] - result.vertices[:, 2]).max() < 0.1
    assert carried.colours.dtype == np.uint8 and (carried.colours == [200, 100, 50, 255]).all()
    assert np.allclose(np.linalg.norm(carried.normals, axis=1), 1)
    assert carried.texture_corners.shape == result.faces.shape
    assert result.source_faces.shape == (len(result.vertices),) and result.source_faces.max() < len(faces)
    assert np.allclose(result.source_barycentric.sum(axis=1), 1)
    assert tessera_remesh.remesh(vertices, faces, points=100).attributes is None


@pytest.mark.parametrize("points", [300.0, "300", "0.3k", "3e2", np.float64(300)])
def test_counts_are_written_as_people_do(surface, points):
    assert len(tessera_remesh.remesh(*surface, points=points, newton=0).seeds) == 300


def test_a_share_of_the_vertices_is_a_count(surface):
    half = tessera_remesh.remesh(*surface, points="50%", newton=0)
    assert len(half.seeds) == len(surface[0]) // 2
    facets = tessera_remesh.remesh(*surface, facets="0.6k")
    assert abs(len(facets.faces) - 600) <= 12
    with pytest.raises(InputError, match="facets"):
        tessera_remesh.remesh(*surface, facets=600, points=300)
    for points in ("many", "10.5", "-3", 10.5, "5 %%", "1,5"):
        with pytest.raises(InputError, match="points"):
            tessera_remesh.remesh(*surface, points=points)


def test_diagrams_and_steps_count_as_a_remesh_does(surface):
    assert len(tessera_remesh.rvd(*surface, points="50%", pieces=False).areas) == len(surface[0]) // 2
    assert len(tessera_remesh.rvd(*surface, points="0.1k", seed="7", pieces=False).areas) == 100
    assert len(next(tessera_remesh.cvt(*surface, points="50%", lloyd=1.0)).seeds) == len(surface[0]) // 2
    for wrong in ("many", 10.5, "0.5"):
        with pytest.raises(InputError, match="points"):
            tessera_remesh.rvd(*surface, points=wrong)
        with pytest.raises(InputError, match="points"):
            next(tessera_remesh.cvt(*surface, points=wrong))


def test_files_come_and_go(surface, tmp_path):
    result = tessera_remesh.remesh(*surface, points=300, newton=0, attributes={"height": surface[0][:, 2]})
    for name in ("a.ply", "b.vtp", "c.ply.gz"):
        result.save(tmp_path / name)
        back = tessera_remesh.read(tmp_path / name)
        assert np.array_equal(back.vertices, result.vertices) and np.array_equal(back.faces, result.faces)
        assert np.array_equal(back.attributes.scalars["height"], result.attributes.scalars["height"])
    with pytest.warns(tessera_remesh.RemeshWarning, match="cannot hold: scalar height") as caught:
        result.save(tmp_path / "d.stl")
    assert caught[0].filename == __file__
    again = tessera_remesh.remesh(str(tmp_path / "a.ply"), points=100)
    assert len(again.vertices) == 100 and "height" in again.attributes.scalars
    with pytest.raises(OSError, match="none.ply"):
        tessera_remesh.read(tmp_path / "none.ply")
    (tmp_path / "bad.ply").write_text("no mesh")
    with pytest.raises(ValueError, match="bad.ply"):
        tessera_remesh.read(tmp_path / "bad.ply")


def test_results_are_shown_in_a_line(surface):
    result = tessera_remesh.remesh(*surface, points=300)
    assert repr(result).startswith("Remesh(vertices 300, faces 600, mean quality 0.") and len(repr(result)) < 200
    assert "<td>300</td>" in result._repr_html_() and repr(result.report).startswith("Report(vertices 300")
    assert len(repr(tessera_remesh.rvd(*surface, points=50))) < 60


def test_labels_keep_their_values_and_their_type(surface):
    vertices, _ = surface
    given = {
        "label": np.where(vertices[:, 0] > 0, 3, -40).astype(np.int8),
        "inside": vertices[:, 1] > 0,
        "id": np.arange(len(vertices)),
        "velocity": vertices * 2,
        "column": np.arange(len(vertices))[:, None],
    }
    carried = tessera_remesh.remesh(*surface, points=300, attributes=given).attributes.scalars
    for name, values in given.items():
        assert carried[name].dtype == values.dtype and carried[name].shape[1:] == values.shape[1:], name
        # Nothing that was not there.
        assert name == "velocity" or set(carried[name].ravel().tolist()) <= set(values.ravel().tolist()), name
    for first in (2**53 + 1, 2**60):
        with pytest.raises(InputError, match="not below 2\\^53"):
            tessera_remesh.remesh(*surface, points=300, attributes={"id": given["id"] + first})
    for columns in (0, 65):
        with pytest.raises(InputError, match="numbers a vertex"):
            tessera_remesh.remesh(*surface, points=300, attributes={"wide": np.zeros((len(vertices), columns))})


def test_regions_come_and_go(surface, tmp_path):
    vertices, faces = surface
    regions = np.where(vertices[faces].mean(axis=1)[:, 0] > 0.3, 5, 2)
    given = tessera_remesh.Attributes(regions=regions, region_names={5: "steel"})
    result = tessera_remesh.remesh(*surface, points=300, attributes=given)
    assert set(result.attributes.regions) == {5, 2} and result.attributes.region_names == {5: "steel"}
    assert not result.face_data and repr(result.attributes) == "Attributes(regions)"
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        result.save(tmp_path / "regions.msh")
        again = tessera_remesh.remesh(tessera_remesh.read(tmp_path / "regions.msh"), points=300)
    assert set(again.attributes.regions) == {5, 2} and not again.face_data
    kept = tessera_remesh.remesh(*surface, points=4000, attributes=given, keep="steel")
    # They come first, with what had to stay beside them.
    stayed = kept.report.raw["result"]["kept"]["facets"]
    assert (kept.attributes.regions[:stayed] == 5).sum() == (regions == 5).sum()
    for wrong, words in ((regions[1:], "regions"), (regions + 2**53, r"2\^53"), (regions * 1.5, "integer"), (regions[:, None], "shape")):
        with pytest.raises(InputError, match=words):
            tessera_remesh.remesh(*surface, points=300, attributes=tessera_remesh.Attributes(regions=wrong))


def test_gaps_of_a_scalar_stay_gaps(surface):
    vertices, _ = surface
    height = np.where(vertices[:, 0] > 0, np.nan, 1.0)
    result = tessera_remesh.remesh(*surface, points=300, attributes={"height": height})
    carried, x = result.attributes.scalars["height"], result.vertices[:, 0]
    assert np.isnan(carried[x > 0.3]).all() and (carried[x < -0.3] == 1.0).all()


def test_colours_of_another_range_are_kept_and_told(surface):
    light = np.tile([0.5, 0.25, 1.0], (len(surface[0]), 1))
    light[0] = [2, 0.5, 0]
    bytes_of = np.tile([255, 51, 0], (len(surface[0]), 1))
    for colours, most in ((bytes_of, 1), (bytes_of.astype(float), 1)):
        kept = tessera_remesh.remesh(*surface, points=100, attributes=tessera_remesh.Attributes(colours=colours))
        assert np.asarray(kept.attributes.colours).max() in (most, 255 * most)
    with pytest.warns(tessera_remesh.RemeshWarning, match="neither from 0 to 1"):
        kept = tessera_remesh.remesh(*surface, points=100, attributes=tessera_remesh.Attributes(colours=light))
    assert kept.attributes.colours.max() >= 1


def test_density_moves_points(surface):
    vertices, faces = surface
    weights = np.where(vertices[:, 0] > 0, 256.0, 1.0)
    result = tessera_remesh.remesh(vertices, faces, points=500, density=weights)
    assert (result.vertices[:, 0] > 0).mean() > 0.7
    sizes = np.where(vertices[:, 0] > 0, 0.1, 0.4)
    result = tessera_remesh.remesh(vertices, faces, sizes=sizes)
    assert (result.vertices[:, 0] > 0).mean() > 0.7


def test_edges_have_length_one_in_a_metric(surface):
    vertices, faces = surface
    short, long = 0.08, 0.4
    metric = np.tile(np.diag([short**-2, long**-2, long**-2]), (len(vertices), 1, 1))
    result = tessera_remesh.remesh(vertices, faces, metric=metric)
    again = tessera_remesh.remesh(vertices, faces, metric=metric[:, [0, 0, 1, 0, 1, 2], [0, 1, 1, 2, 2, 2]])
    assert np.array_equal(result.vertices, again.vertices)
    assert result.report.raw["result"]["metric"]["unit_edges_percent"] > 90
    edges = result.vertices[result.faces] - result.vertices[np.roll(result.faces, 1, axis=1)]
    lengths = np.sqrt(np.einsum("fei,ij,fej->fe", edges, metric[0], edges))
    assert ((lengths > 0.71) & (lengths < 1.41)).mean() > 0.9
    fewer = tessera_remesh.remesh(vertices, faces, 300, metric=metric)
    assert abs(len(fewer.vertices) - 300) < 15


def test_progress_is_heard_and_may_cancel(surface):
    heard: list[Progress] = []
    tessera_remesh.remesh(*surface, points=100, progress=heard.append)
    stages = [event.stage for event in heard if event.step is None]
    assert stages[:3] == ["prepare", "sample", "iterations"]
    steps = [event for event in heard if event.step is not None]
    assert steps[0].step == 1 and steps[0].steps == 35 and steps[-1].energy < steps[0].energy

    def stop(event: Progress) -> None:
        if event.step == 2:
            raise RuntimeError("enough")

    with pytest.raises(RuntimeError, match="enough"):
        tessera_remesh.remesh(*surface, points=100, progress=stop)
    tessera_remesh.remesh(*surface, points=50, progress=True)


def test_ctrl_c_ends_it_soon():
    vertices, faces = torus(600, 300)
    begun = threading.Event()
    times = []

    def press() -> None:
        begun.wait()
        time.sleep(0.3)
        times.append(time.monotonic())
        _thread.interrupt_main()

    thread = threading.Thread(target=press)
    thread.start()
    with pytest.raises(KeyboardInterrupt):
        tessera_remesh.remesh(vertices, faces, points=200_000, progress=lambda event: begun.set())
    took = time.monotonic() - times[0]
    thread.join()
    # The bar is 200 ms on a machine that does nothing else; this one may be busy.
    assert took < 5, took


def test_others_run_meanwhile():
    vertices, faces = torus(200, 100)
    counted = 0
    over = threading.Event()

    def count() -> None:
        nonlocal counted
        while not over.is_set():
            counted += 1
            time.sleep(0.001)

    thread = threading.Thread(target=count)
    thread.start()
    tessera_remesh.remesh(vertices, faces, points=20_000)
    over.set()
    thread.join()
    assert counted > 10, "the interpreter's lock is free while the engine works"


def test_calls_from_several_threads(surface):
    expected = tessera_remesh.remesh(*surface, points=200)
    results = []
    threads = [
        threading.Thread(target=lambda: results.append(tessera_remesh.remesh(*surface, points=200))) for _ in range(4)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(results) == 4
    assert all(np.array_equal(result.vertices, expected.vertices) for result in results)


def _in_child(queue, surface) -> None:
    queue.put(tessera_remesh.remesh(*surface, points=200).vertices)


def test_a_forked_process_has_threads_of_its_own(surface):
    import multiprocessing

    if "fork" not in multiprocessing.get_all_start_methods():
        pytest.skip("no fork here")
    expected = tessera_remesh.remesh(*surface, points=200)
    context = multiprocessing.get_context("fork")
    queue = context.Queue()
    child = context.Process(target=_in_child, args=(queue, surface))
    child.start()
    assert np.array_equal(queue.get(timeout=120), expected.vertices)
    child.join(timeout=60)
    assert child.exitcode == 0


def test_cells_cover_the_surface(surface):
    vertices, faces = surface
    seeds = tessera_remesh.remesh(vertices, faces, points=50).seeds
    cells = tessera_remesh.rvd(vertices, faces, seeds=seeds)
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2
    assert np.isclose(cells.areas.sum(), area, rtol=1e-5)
    assert cells.piece_offsets[0] == 0 and cells.piece_offsets[-1] == len(cells.piece_vertices)
    assert set(cells.piece_faces) == set(range(len(faces)))
    assert tessera_remesh.rvd(vertices, faces, points=10, pieces=False).piece_faces is None
    with pytest.raises(InputError, match="seeds or points"):
        tessera_remesh.rvd(vertices, faces)


def test_iterations_converge(surface):
    steps = list(tessera_remesh.cvt(*surface, points=200, lloyd=3, newton=10))
    assert [step.kind for step in steps[:4]] == ["lloyd"] * 3 + ["lbfgs"]
    assert steps[-1].energy < steps[0].energy and steps[-1].energy_ratio < 1.2
    assert all(step.seeds.shape == (200, 3) for step in steps)
    with pytest.raises(InputError):
        next(tessera_remesh.cvt(*surface))


def test_seeds_may_be_given(surface):
    seeds = surface[0][::20]
    result = tessera_remesh.remesh(*surface, seeds=seeds, lloyd=0, newton=0, placement="surface")
    assert len(result.seeds) == len(seeds)


def test_cancelled_is_an_error_of_the_package():
    assert issubclass(Cancelled, tessera_remesh.TesseraError)


@pytest.mark.skipif(sys.platform != "linux", reason="the layer is Mesa's for Linux")
def test_drivers_say_nothing_where_there_is_no_desktop():
    for alone in ({}, {"XDG_RUNTIME_DIR": ""}, {"XDG_RUNTIME_DIR": "run", "WAYLAND_DISPLAY": "wayland-0"}):
        variables = dict(alone)
        surroundings.prepare(variables)
        assert variables == {**alone, "NODEVICE_SELECT": "1"}
    for other in ("XDG_RUNTIME_DIR", "WAYLAND_DISPLAY", "WAYLAND_SOCKET", "NODEVICE_SELECT", "MESA_VK_DEVICE_SELECT", "DRI_PRIME"):
        variables = {other: "/run/user/1000"}
        surroundings.prepare(variables)
        assert variables == {other: "/run/user/1000"}

    desktop = ("XDG_RUNTIME_DIR", "WAYLAND_DISPLAY", "DISPLAY", "NODEVICE_SELECT")
    without = {name: value for name, value in os.environ.items() if name not in desktop}
    code = "import tessera_remesh as t; t.remesh([(0, 0, 0), (1, 0, 0), (0, 1, 0)], [(0, 1, 2)], points=20)"
    done = subprocess.run([sys.executable, "-c", code], env=without, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
