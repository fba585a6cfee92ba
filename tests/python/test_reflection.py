"""Promise: a client that knows nothing of the interface learns it from the server (reflection) and has a surface remeshed.

Run by reflection.sh, which starts a server: test_reflection.py ADDRESS
"""

import base64
import hashlib
import math
import sys

import google_crc32c
import grpc
from grpc_requests import Client

JOBS, BLOBS, STREAMS = (f"tessera.v1.{name}Service" for name in ("Job", "Blob", "Remesh"))
TENANT = [("tessera-tenant", "reflection")]


def torus(n, m):
    """Positions and facets."""
    points, facets = [], []
    for i in range(n):
        for j in range(m):
            u, v = 2 * math.pi * i / n, 2 * math.pi * j / m
            r = 1 + 0.4 * math.cos(v)
            points.append((r * math.cos(u), r * math.sin(u), 0.4 * math.sin(v)))
            a, b, c, d = (((i + di) % n) * m + (j + dj) % m for di, dj in ((0, 0), (1, 0), (1, 1), (0, 1)))
            facets += [(a, b, c), (a, c, d)]
    return points, facets


def off(points, facets):
    lines = ["OFF", f"{len(points)} {len(facets)} 0"]
    lines += [" ".join(map(repr, p)) for p in points] + ["3 " + " ".join(map(str, f)) for f in facets]
    return ("\n".join(lines) + "\n").encode()


def main(address):
    client = Client.get_by_endpoint(address)
    known = set(client.service_names)
    assert {JOBS, BLOBS, STREAMS, "tessera.v1.ServerService", "grpc.health.v1.Health"} <= known, known

    def ask(service, method, request):
        # Bytes travel as base64, as JSON has none.
        return client.request(service, method, request, metadata=TENANT)

    info = ask("tessera.v1.ServerService", "GetServerInfo", {})
    assert info["readiness"]["ready"], info

    data = off(*torus(40, 20))
    digest = hashlib.sha256(data).hexdigest()
    piece = {
        "digest": digest,
        "size_bytes": len(data),
        "data": base64.b64encode(data).decode(),
        "crc32c": google_crc32c.value(data),
        "finish": True,
    }
    assert ask(BLOBS, "Write", [piece])["complete"]

    spec = {
        "mesh": {"file": {"digest": digest, "format": "MESH_FORMAT_OFF"}},
        "remesh": {"points": 150, "lloyd": 3, "newton": 2},
        "result": {"file": "MESH_FORMAT_OFF"},
    }
    job = ask(JOBS, "CreateJob", {"spec": spec})["job"]["id"]
    events = list(ask(JOBS, "WatchJob", {"id": job}))
    assert events[-1]["event"]["state"]["state"] == "JOB_STATE_SUCCEEDED", events[-1]
    results = ask(JOBS, "GetJob", {"id": job})["job"]["results"]
    mesh = next(result["digest"] for result in results if result["name"] == "mesh")
    pieces = ask(BLOBS, "Read", {"digest": mesh})
    text = b"".join(base64.b64decode(piece["data"]) for piece in pieces).decode()
    counts = next(line for line in text.splitlines()[1:] if line and not line.startswith("#")).split()
    vertices, facets = int(counts[0]), int(counts[1])
    assert 140 <= vertices <= 160 and facets == 2 * vertices, (vertices, facets)
    print(f"reflection: {len(known)} services, {len(events)} events, {vertices} vertices, {facets} facets")

    try:
        ask(JOBS, "GetJob", {"id": "0" * 32})
        raise AssertionError("there is no such job")
    except grpc.RpcError as error:
        assert error.code() == grpc.StatusCode.NOT_FOUND, error
    ask(JOBS, "DeleteJob", {"id": job})


if __name__ == "__main__":
    main(sys.argv[1])
