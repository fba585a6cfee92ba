"""Promise: with `--blobs s3://...` inputs and results lie in a bucket, and outlive the server's end.

Run by run.sh, which installs the server of a bucket (moto): test_s3.py PROGRAM
"""

import hashlib
import os
import pathlib
import signal
import subprocess
import sys
import tempfile
import urllib.request

import jobs
from moto.server import ThreadedMotoServer


def start(program, folder, bucket, environment):
    """A server whose blobs are in the bucket, and its address."""
    command = [program, "serve", "--data-dir", folder, "--blobs", bucket, "--listen", "127.0.0.1:0", "--backend", "serial"]
    server = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
    line = server.stdout.readline()
    assert line.startswith("tessera listens on "), line
    return server, line.split()[-1]


def main(program):
    store = ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    store.start()
    host, port = store.get_host_and_port()
    endpoint = f"http://{host}:{port}"
    urllib.request.urlopen(urllib.request.Request(f"{endpoint}/meshes", method="PUT"))
    environment = {
        **os.environ,
        "AWS_ENDPOINT": endpoint,
        "AWS_ALLOW_HTTP": "true",
        "AWS_REGION": "us-east-1",
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
    }
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "torus.ply"
        subprocess.run([program, "shape", "torus", "--facets", "2000", "-o", path], check=True, stdout=subprocess.DEVNULL)
        mesh = path.read_bytes()
        data, bucket = pathlib.Path(folder) / "data", "s3://meshes/tessera"
        server, address = start(program, data, bucket, environment)
        client = jobs.Jobs(address, tenant="python")
        # Longer than a part of an upload to S3.
        large = mesh + bytes(12 << 20)
        digest = client.put(large)
        assert client.read(digest) == large
        name = client.submit(jobs.remesh(client.put(mesh), 200), request_id="once")
        result = client.wait(name)
        remeshed = client.read(result["mesh"])
        assert hashlib.sha256(remeshed).hexdigest() == result["mesh"]
        client.close()
        server.send_signal(signal.SIGKILL)
        server.wait()

        listing = urllib.request.urlopen(f"{endpoint}/meshes?list-type=2").read().decode()
        assert result["mesh"] in listing and "tessera/blobs/" in listing, listing
        assert not list(data.rglob(result["mesh"])), "no copy beside the journal"

        server, address = start(program, data, bucket, environment)
        client = jobs.Jobs(address, tenant="python")
        assert client.read(client.wait(name)["mesh"]) == remeshed and client.read(digest) == large
        client.close()
        server.send_signal(signal.SIGTERM)
        assert server.wait(60) == 0

        store.stop()
        refused = subprocess.run(
            [program, "serve", "--data-dir", data, "--blobs", bucket, "--listen", "127.0.0.1:0"],
            env={**environment, "AWS_ENDPOINT": "http://127.0.0.1:9"},
            capture_output=True,
            text=True,
            timeout=300,
        )
        assert refused.returncode == 69 and "--blobs" in refused.stderr, refused
    print("s3: stored, kept over a restart, refused without its store")


main(sys.argv[1])
