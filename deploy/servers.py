"""Starts the programs that the checks of deploy/ need, on free ports of this machine, and ends them."""

import contextlib
import pathlib
import socket
import subprocess
import sys
import tempfile
import time
import urllib.request


def free_port():
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        return place.getsockname()[1]


def get(url):
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.read().decode()


def wait_for(holds, what, seconds=30):
    """Calls `holds` until it is true. One that cannot be asked yet is not."""
    end = time.monotonic() + seconds
    while True:
        with contextlib.suppress(OSError):
            if holds():
                return
        if time.monotonic() > end:
            sys.exit(f"{what} did not come within {seconds} s")
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

    def server(self, program, *options):
        """A server without a folder: its endpoint and its admin port."""
        server = self.start(
            program, "serve", "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--ephemeral",
            "--backend", "parallel", *options, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )
        lines = [server.stdout.readline() for _ in range(2)]
        if not all(lines):
            sys.exit(f"{program} did not start")
        return ["http://" + lines[0].rsplit(" ", 1)[1].strip(), lines[1].rsplit(" ", 1)[1].strip()]
