"""Promise: a foreign client (grpcio) can do everything the service offers.

Run by run.sh, which makes the stubs and starts a server: test_client.py ADDRESS
"""

import math
import sys

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


def main(address):
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

    new_points, new_facets, iterations, report = client.remesh(points, facets, 400)
    edges = {tuple(sorted((f[k], f[(k + 1) % 3]))) for f in new_facets for k in range(3)}
    assert len(new_points) - len(edges) + len(new_facets) == 0, "a torus stays a torus"
    assert iterations[-1].energy < iterations[0].energy
    assert report["result"]["non_manifold_edges"] == 0
    print(f"remesh: {len(new_points)} vertices, E/E_hex {iterations[-1].energy_ratio:.4f}")

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
    main(sys.argv[1])
