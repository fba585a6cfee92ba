"""Promise: a foreign client (grpcio) uploads a mesh once, has several jobs done on it, watches one again from where it was, and
fetches the results.

Run by run.sh, which makes the stubs and starts a server: test_jobs.py ADDRESS PROGRAM
"""

import hashlib
import json
import pathlib
import subprocess
import sys
import tempfile

import grpc
from tessera.v1 import blob_pb2, job_pb2

import jobs


def main(address, program):
    client = jobs.Jobs(address, tenant="python")
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "genus3.ply"
        subprocess.run([program, "shape", "genus3", "--facets", "3000", "-o", path], check=True, stdout=subprocess.DEVNULL)
        mesh = path.read_bytes()
        out = pathlib.Path(folder) / "out.ply"
        command = [program, "remesh", path, "-o", out, "--points", "300", "--seed", "1", "--quiet"]
        subprocess.run(command, check=True)
        expected = out.read_bytes()

    # An upload that is cut, and goes on.
    large = mesh + bytes(3 << 20)
    digest = hashlib.sha256(large).hexdigest()
    cut = client.blobs.Write(client.pieces(large, digest, end=2 << 20), metadata=client.metadata)
    assert not cut.complete and cut.kept_bytes == 2 << 20, cut
    asked = blob_pb2.QueryWriteStatusRequest(digest=digest, size_bytes=len(large))
    assert client.blobs.QueryWriteStatus(asked, metadata=client.metadata).kept_bytes == 2 << 20
    assert client.put(large) == digest and client.read(digest) == large
    print("blobs: cut, resumed, read")

    # Once uploaded, three jobs.
    digest = client.put(mesh)
    specs = [jobs.remesh(digest, 300, seed=seed) for seed in (1, 2, 3)]
    names = [client.submit(spec, request_id=f"job {seed}".replace(" ", "-")) for seed, spec in enumerate(specs)]
    assert len(set(names)) == 3 and client.submit(specs[0], request_id="job-0") == names[0], "the same request"
    results = [client.wait(name) for name in names]
    assert client.read(results[0]["mesh"]) == expected, "the same bytes as the command's"
    assert len({result["mesh"] for result in results}) == 3
    report = json.loads(client.read(results[0]["report"]))
    assert report["result"]["q_min"] > 0.3
    print("jobs: three on one upload")

    # Watched again from where it was.
    every = list(client.watch(names[0]))
    assert [event.number for event in every] == sorted(event.number for event in every)
    again = jobs.Jobs(address, tenant="python")
    later = list(again.watch(names[0], after=5))
    assert later == [event for event in every if event.number > 5] and later[-1].state.state == job_pb2.JOB_STATE_SUCCEEDED
    print(f"events: {len(every)}, {len(later)} of them after number 5")

    # What is wrong is said, and others see nothing.
    try:
        client.wait(client.submit(jobs.remesh(digest, 300, format="stl")))
    except grpc.RpcError as error:
        assert error.code() == grpc.StatusCode.INVALID_ARGUMENT, error
    else:
        raise AssertionError("a PLY file is no STL file")
    stranger = jobs.Jobs(address, tenant="stranger")
    try:
        stranger.get(names[0])
    except grpc.RpcError as error:
        assert error.code() == grpc.StatusCode.NOT_FOUND
    else:
        raise AssertionError("another tenant's job is not found")
    for each in (client, again, stranger):
        each.close()
    print("refusals: told")


if __name__ == "__main__":
    main(*sys.argv[1:])
