"""Starts the programs that the checks of deploy/ need, on free ports of this machine, and ends them."""

import collections
import contextlib
import os
import pathlib
import pwd
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request

# Where it is called, where its admin port and its HTTP port are (if it was asked for), and its process.
Server = collections.namedtuple("Server", "endpoint admin http process")


# Sockets that hold ports, as long as this process lives.
HELD = []


def free_port():
    """A port for a server. A socket that is bound and does not listen keeps it from all but a server that names it."""
    held = socket.socket()
    held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    held.bind(("127.0.0.1", 0))
    HELD.append(held)
    return held.getsockname()[1]


def get(url, headers=None):
    with urllib.request.urlopen(urllib.request.Request(url, headers=headers or {}), timeout=10) as answer:
        return answer.read().decode()


def wait_for(holds, what, seconds=30):
    """Calls `holds` until it is true. One that cannot be asked yet is not. `what` is a text, or gives what is wrong."""
    end = time.monotonic() + seconds
    while True:
        with contextlib.suppress(OSError):
            if holds():
                return
        if time.monotonic() > end:
            sys.exit(f"{what()}, after {seconds} s" if callable(what) else f"{what} did not come within {seconds} s")
        time.sleep(0.1)


class Place(contextlib.ExitStack):
    """A folder, and programs that end with it."""

    def __init__(self):
        super().__init__()
        self.folder = pathlib.Path(self.enter_context(tempfile.TemporaryDirectory()))

    def start(self, *command, **options):
        process = subprocess.Popen([str(word) for word in command], **options)

        def end():
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

        self.callback(end)
        return process

    def database(self):
        """The URL of a new PostgreSQL server. Root may not run one: the user `postgres` does."""
        found = sorted(pathlib.Path("/usr/lib/postgresql").glob("*/bin/postgres"), key=lambda path: int(path.parts[-3]))
        if not found:
            sys.exit("PostgreSQL is not installed (Debian: postgresql)")
        folder = pathlib.Path(self.enter_context(tempfile.TemporaryDirectory(dir="/tmp")))
        user = {}
        if os.geteuid() == 0:
            entry = pwd.getpwnam("postgres")
            os.chown(folder, entry.pw_uid, entry.pw_gid)
            user = {"user": entry.pw_uid, "group": entry.pw_gid, "extra_groups": []}
        made = [found[-1].with_name("initdb"), "--pgdata", folder / "data", "--username=tessera", "--auth=trust", "--no-sync"]
        subprocess.run([*made, "--encoding=UTF8", "--locale=C"], check=True, stdout=subprocess.DEVNULL, **user)
        port = free_port()
        self.start(
            found[-1], "-D", folder / "data", "-p", port, "-c", "listen_addresses=127.0.0.1", "-c", "unix_socket_directories=",
            "-c", "fsync=off", stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, **user,
        )
        asked = [found[-1].with_name("pg_isready"), "--host=127.0.0.1", f"--port={port}", "--quiet"]
        wait_for(lambda: subprocess.run(asked, check=False).returncode == 0, "PostgreSQL")
        return f"postgres://tessera@127.0.0.1:{port}/postgres"

    def bucket(self):
        """The URL of a new S3 server that has the bucket `tessera`."""
        url = f"http://127.0.0.1:{free_port()}"
        self.start(
            sys.executable, "-c", "from moto.server import main; main()", "-p", url.rsplit(":", 1)[1],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )
        wait_for(lambda: get(f"{url}/moto-api/data.json"), "the S3 server")
        urllib.request.urlopen(urllib.request.Request(f"{url}/tessera", method="PUT")).close()
        return url

    def shared(self):
        """Variables of servers that share a new database and a new bucket."""
        return {
            "TESSERA_STORE": self.database(),
            "TESSERA_BLOBS": "s3://tessera",
            "AWS_ENDPOINT": self.bucket(),
            "AWS_ALLOW_HTTP": "true",
            "AWS_REGION": "us-east-1",
            "AWS_ACCESS_KEY_ID": "tessera",
            "AWS_SECRET_ACCESS_KEY": "tessera",
        }

    def server(self, program, *options, shared=None):
        """A server without a folder, or one of those with the variables `shared`."""
        where = ["--ephemeral"]
        if shared is not None:
            folder = tempfile.mkdtemp(dir=self.folder, prefix="node")
            where = ["--data-dir", folder, "--node", pathlib.Path(folder).name, "--http-listen", "127.0.0.1:0"]
        server = self.start(
            program, "serve", "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", *where, "--backend", "parallel", *options,
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True, env={**os.environ, **(shared or {})},
        )
        lines = [server.stdout.readline() for _ in range(2 if shared is None else 3)]
        if not all(lines):
            sys.exit(f"{program} did not start")
        endpoint, admin, http = [*(line.rsplit(" ", 1)[1].strip() for line in lines), None][:3]
        return Server(f"http://{endpoint}", admin, http, server)
