"""Promise: a foreign client (grpcio) can do everything the service offers.

Also: what it leaves open is what the command leaves open, and options are called as the command's.

Run by run.sh, which makes the stubs and starts a server: test_client.py ADDRESS PROGRAM
"""

import json
import math
import pathlib
import re
import subprocess
import sys
import tempfile

import grpc
from tessera.v1 import remesh_pb2 as pb

import client as tessera


def torus(n=48, m=24, big=1.0, small=0.4):
    points, facets = [], []
    for i in range(n):
        for j in range(m):
            u, v = 2 * math.pi * i / n, 2 * math.pi * j / m
            r = big + small * math.cos(v)
            points.append((r * math.cos(u), r * math.sin(u), small * math.sin(v)))
            a, b = i * m + j, (i + 1) % n * m + j
            c, d = (i + 1) % n * m + (j + 1) % m, i * m + (j + 1) % m
            facets += [(a, b, c), (a, c, d)]
    return points, facets


def cross_norm(a, b, c):
    u = [b[k] - a[k] for k in range(3)]
    v = [c[k] - a[k] for k in range(3)]
    w = (u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0])
    return math.sqrt(sum(x * x for x in w))


def polygon_area(polygon):
    return sum(0.5 * cross_norm(polygon[0], polygon[k - 1], polygon[k]) for k in range(2, len(polygon)))


# Options of the command that are no business of a server.
# The tenant is not in a header: the client is made with it.
LOCAL = (
    "tenant input-format output out-dir format overwrite report picture picture-size view up colour gpu-software threads endpoint ca client-cert client-key key-file quiet json "
    "log-format help"
)
# Options that are beside the message, and those of the message that the command has not.
BESIDE = "sizes creases backend no-attributes"
NOT_OF_COMMAND = {"max-deviation-length", "measure"}


def options_are_called_alike(program):
    """By the schema, and so by this client, and by the command."""
    names = {field.name for field in [*pb.RemeshOptions.DESCRIPTOR.fields, *pb.Density.DESCRIPTOR.fields]} - {"source"}
    text = subprocess.run([program, "remesh", "--help"], check=True, capture_output=True, text=True).stdout
    found = set(re.findall(r"^ +(?:-\w, )?--([a-z-]+)", text, re.MULTILINE))
    options = {name.replace("_", "-") for name in names} - NOT_OF_COMMAND | set(BESIDE.split())
    assert found == options | set(LOCAL.split()), found ^ (options | set(LOCAL.split()))


def the_command_gives_the_same(program, points, facets, count, remeshed):
    """Bit for bit, where neither sets an option."""
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        lines = [f"OFF {len(points)} {len(facets)} 0"]
        lines += [" ".join(repr(x) for x in p) for p in points] + ["3 " + " ".join(map(str, f)) for f in facets]
        (folder / "in.off").write_text("\n".join(lines) + "\n")
        line = [program, "remesh", "in.off", "-o", "out.off", "--points", str(count), "--json"]
        out = subprocess.run(line, cwd=folder, check=True, capture_output=True, text=True).stdout
        words = (folder / "out.off").read_text().split()
    vertices = int(words[1])
    numbers = [float(x) for x in words[4 : 4 + 3 * vertices]]
    assert [tuple(numbers[i : i + 3]) for i in range(0, len(numbers), 3)] == remeshed.points
    mine, its = json.loads(out), remeshed.report
    for block in ("result", "features", "density", "final", "converged", "seed"):
        assert mine[block] == its[block], block
    assert len(mine["iterations"]) == len(its["iterations"]) > 5


def attributes_come_back(client, points, facets):
    """What says where a vertex is says so of the result too."""
    sent = [
        tessera.Attribute("scalar", [x for x, _, _ in points], name="x"),
        tessera.Attribute("normals", [(0.0, 0.0, 1.0)], corners=[(0, 0, 0)] * len(facets)),
        tessera.Attribute("texture_coordinates", [(x, y) for x, y, _ in points], corners=facets),
        tessera.Attribute("colours", [(255, 0, 0, 255)] * len(points), type="u8"),
        tessera.Attribute("scalar", [z for _, _, z in points], name="z"),
    ]
    done = client.remesh(points, facets, 400, attributes=sent)
    assert [(a.kind, a.name) for a in done.attributes] == [(a.kind, a.name) for a in sent]
    scalar, normals, texture, colours, last = done.attributes
    assert all(abs(a - p[0]) < 0.05 for a, p in zip(scalar.values, done.points, strict=True))
    assert all(abs(a - p[2]) < 0.05 for a, p in zip(last.values, done.points, strict=True))
    assert set(colours.values) == {(255, 0, 0, 255)} and colours.type == "u8"
    assert all(abs(n[2] - 1) < 1e-9 for n in normals.values)
    for facet, corners in zip(done.facets, texture.corners, strict=True):
        for vertex, corner in zip(facet, corners):
            assert math.dist(done.points[vertex][:2], texture.values[corner]) < 0.05


def main(address, program):
    options_are_called_alike(program)
    print("options: called alike")
    client = tessera.Tessera(address)
    points, facets = torus()
    area = sum(0.5 * cross_norm(*(points[v] for v in f)) for f in facets)
    seeds = points[::7]

    cells, centroids, report = client.rvd(points, facets, seeds)
    assert abs(sum(polygon_area(p) for _, _, p in cells) - area) < 1e-6 * area
    assert {f for f, _, _ in cells} == set(range(len(facets)))
    assert len(centroids) == len(seeds)
    assert report["rvd"]["pairs"] == len(cells)
    print(f"rvd: {len(cells)} pieces by {report['backend']}")

    remeshed = client.remesh(points, facets, 400)
    new_points, new_facets, iterations, report, _ = remeshed
    edges = {tuple(sorted((f[k], f[(k + 1) % 3]))) for f in new_facets for k in range(3)}
    assert len(new_points) - len(edges) + len(new_facets) == 0, "a torus stays a torus"
    assert iterations[-1].energy < iterations[0].energy
    assert report["result"]["non_manifold_edges"] == 0
    assert report["result"]["q_avg"] > 0.88, "as good as the command's"
    print(f"remesh: {len(new_points)} vertices, E/E_hex {iterations[-1].energy_ratio:.4f}")
    the_command_gives_the_same(program, points, facets, 400, remeshed)
    print("defaults: the command's")

    plain = client.remesh(points, facets, 200, lloyd=0, newton=0, measure="topology", crease_angle=0)
    assert not plain.iterations and "q_avg" not in plain.report["result"], "0 is not the default"
    even = client.remesh(points, facets, 200, lloyd=1, newton=2, seeds=None, seed=7, backend="serial",
                         projection="surface", placement="surface", boundaries="free", thin="even", adaptivity=0.5,
                         gradation=0.2, density="curvature")
    assert len(even.iterations) == 3 and even.report["seed"] == 7 and even.report["backend"] == "serial"
    lengths = client.remesh(points, facets, edge_lengths=[0.15] * len(points), lloyd=2, newton=0)
    assert lengths.report["density"]["source"] == "sizes" and len(lengths.points) > 200
    close = client.remesh(points, facets, 100, lloyd=2, newton=0, max_deviation_length=0.02)
    assert 100 < len(close.points) <= 210, "at most about twice as many, where max_points is not given"
    weighted = client.remesh(points, facets, 200, weights=[1 + x * x for x, _, _ in points], lloyd=1, newton=0)
    assert weighted.report["density"]["source"] == "weights"
    creased = client.remesh(points, facets, 200, creases=[(0, 1)], lloyd=1, newton=0, max_deviation=None)
    assert creased.report["features"] != plain.report["features"]
    for wrong, error in [({"loyd": 1}, TypeError), ({"thin": "thick"}, AttributeError)]:
        try:
            client.remesh(points, facets, 200, **wrong)
        except error:
            continue
        raise AssertionError(f"{wrong} is no option")
    print("options: heard")
    attributes_come_back(client, points, facets)
    print("attributes: carried")

    session = client.session(points, facets, seeds, max_seeds=len(seeds) + 1)
    taken, moved = session.step(3)
    assert taken[2].energy < taken[0].energy and len(moved) == len(seeds)
    edited = session.edit([pb.SeedEdit(add=pb.Point(x=1.4, y=0.0, z=0.0))])
    assert len(edited) == len(seeds) + 1
    session.step()
    assert len(session.finish()) == len(seeds) + 1
    print("cvt: stepped and edited")

    bad = list(points)
    bad[5] = (math.nan, 0.0, 0.0)
    try:
        client.rvd(bad, facets, seeds)
    except grpc.RpcError as error:
        assert error.code() == grpc.StatusCode.INVALID_ARGUMENT and "vertex 5" in error.details()
        print(f"refused: {error.details()}")
    else:
        raise AssertionError("a NaN vertex is refused")
    client.close()


if __name__ == "__main__":
    main(*sys.argv[1:])
