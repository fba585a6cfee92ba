"""Calls to servers, and the jobs of a trial.

Purpose: [`call`] is one request; [`Work`] submits jobs at random servers until they are acknowledged, and checks what became of
them. Invariant: a job counts as acknowledged once its id was answered, and only its request id is repeated.
Must not know: processes.
"""

from __future__ import annotations

import http.client
import json
import math
import random
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any
from urllib.parse import urlencode

#: What a caller may take for "not done, or not known: once more".
AGAIN = {503}


@dataclass
class Answer:
    status: int
    headers: dict[str, str]
    body: bytes
    seconds: float

    def json(self) -> Any:
        return json.loads(self.body or b"null")

    def __str__(self) -> str:
        return f"{self.status} {self.body[:300].decode(errors='replace')}"


class Lost(Exception):
    """The connection was refused or cut: what became of the call is not known."""


def call(
    address: str, method: str, path: str, body: bytes | Any = None, tenant: str = "trial", timeout: float = 30,
    key: str | None = None,
) -> Answer:
    """One request on a connection of its own. A body that is not bytes is sent as JSON."""
    if not address:
        raise Lost("the server is not there")
    host, port = address.rsplit(":", 1)
    connection = http.client.HTTPConnection(host, int(port), timeout=timeout)
    data = body if body is None or isinstance(body, bytes) else json.dumps(body).encode()
    headers = {"tessera-tenant": tenant, **({"authorization": f"Bearer {key}"} if key else {})}
    begin = time.monotonic()
    try:
        connection.request(method, path, data, headers)
        answer = connection.getresponse()
        return Answer(
            answer.status, {name.lower(): value for name, value in answer.getheaders()}, answer.read(),
            time.monotonic() - begin,
        )  # fmt: skip
    except (OSError, http.client.HTTPException) as error:
        raise Lost(f"{method} {path}: {error!r}") from error
    finally:
        connection.close()


def torus(rings: int) -> bytes:
    """A torus of `rings` * `rings` facets, as an OBJ file."""
    sides, lines = rings // 2, []
    for i in range(rings):
        for j in range(sides):
            u, v = math.tau * i / rings, math.tau * j / sides
            r = 2 + 0.7 * math.cos(v)
            lines.append(f"v {r * math.cos(u):.9f} {r * math.sin(u):.9f} {0.7 * math.sin(v):.9f}")
    vertex = lambda i, j: 1 + (i % rings) * sides + j % sides  # noqa: E731
    for i in range(rings):
        for j in range(sides):
            a, b, c, d = vertex(i, j), vertex(i + 1, j), vertex(i + 1, j + 1), vertex(i, j + 1)
            lines += [f"f {a} {b} {c}", f"f {a} {c} {d}"]
    return "\n".join(lines).encode() + b"\n"


def session_of(steps: int) -> dict[str, Any]:
    """A job of `steps` cheap steps: about 8,000 a second."""
    step = {"step": {"iterations": steps, "seeds": "SEEDS_WANTED_LAST"}}
    return {"cvt": {"options": {"points": 60, "seed": 3}, "commands": [step]}}


#: Jobs of all kinds, each of them small.
MIXED: list[dict[str, Any]] = [
    {"remesh": {"points": 40 + 20 * size, "seed": seed}} for size in range(3) for seed in (1, 2)
]
MIXED += [
    {"rvd": {"points": 50, "seed": 5, "outputs": ["RVD_OUTPUT_CENTROIDS", "RVD_OUTPUT_SUMS"]}},
    {"rvd": {"points": 80, "seed": 6, "outputs": ["RVD_OUTPUT_CELLS"]}},
]
MIXED += [session_of(20), session_of(60)]


@dataclass
class Given:
    """An acknowledged job."""

    id: str
    tenant: str
    request_id: str
    kind: str
    at: float


@dataclass
class Work:
    """Jobs that were submitted at servers, with one label."""

    name: str
    addresses: Callable[[], list[str]]
    mesh: bytes
    tenants: list[str] = field(default_factory=lambda: ["trial"])
    given: list[Given] = field(default_factory=list)
    problems: list[str] = field(default_factory=list)
    refusals: Counter[str] = field(default_factory=Counter)
    longest_s: float = 0.0

    def upload(self) -> None:
        """Gives the surface to each tenant."""
        for tenant in self.tenants:
            answer = self.patiently("POST", "/v1/blobs", self.mesh, tenant)
            self.digest = answer.json()["digest"]

    def patiently(self, method: str, path: str, body: Any, tenant: str, patience: float = 150) -> Answer:
        """Tries servers at random, until one answers with a success. Other refusals than "later" are problems."""
        end = time.monotonic() + patience
        while True:
            try:
                answer = call(random.choice(self.addresses()), method, path, body, tenant)
                if answer.status < 300:
                    return answer
                self.refusals[f"{answer.status} {answer.json().get('reason')}"] += 1
                if answer.status not in AGAIN:
                    raise RuntimeError(f"{self.name}: {method} {path}: {answer}")
            except Lost as error:
                self.refusals[str(error).split("(")[0]] += 1
            if time.monotonic() > end:
                raise RuntimeError(f"{self.name}: {method} {path}: not done within {patience:.0f} s: {self.refusals}")
            time.sleep(0.1)

    def body(self, work: dict[str, Any], request_id: str, **more: Any) -> dict[str, Any]:
        mesh = {"file": {"digest": self.digest, "format": "MESH_FORMAT_OBJ"}}
        return {"mesh": mesh, **work, "labels": {"trial": self.name}, "request_id": request_id, **more}

    def submit(self, work: dict[str, Any], tenant: str | None = None) -> Given:
        """Submits a job until it is acknowledged."""
        tenant = tenant or random.choice(self.tenants)
        request_id = f"{self.name}-{random.getrandbits(64):016x}"
        begin = time.monotonic()
        answer = self.patiently("POST", "/v1/jobs", self.body(work, request_id), tenant)
        self.longest_s = max(self.longest_s, answer.seconds)
        given = Given(answer.json()["id"], tenant, request_id, json.dumps(work), begin)
        self.given.append(given)
        return given

    def submit_all(self, jobs: Sequence[tuple[dict[str, Any], str | None]], pause: float = 0, threads: int = 2) -> threading.Thread:
        """Submits jobs in the background, in order. Join what it gives."""
        waiting: Iterator[tuple[dict[str, Any], str | None]] = iter(jobs)
        lock = threading.Lock()

        def one() -> None:
            while True:
                with lock:
                    job = next(waiting, None)
                if job is None:
                    return
                try:
                    self.submit(*job)
                except Exception as error:  # noqa: BLE001
                    self.problems.append(str(error))
                time.sleep(pause)

        def all_of_them() -> None:
            each = [threading.Thread(target=one, daemon=True) for _ in range(threads)]
            for thread in each:
                thread.start()
            for thread in each:
                thread.join()

        thread = threading.Thread(target=all_of_them, daemon=True)
        thread.start()
        return thread

    def jobs(self) -> dict[str, dict[str, Any]]:
        """All jobs with the label, as a server lists them now."""
        found: dict[str, dict[str, Any]] = {}
        for tenant in self.tenants:
            token = ""
            while True:
                query = {"label": f"trial={self.name}", "page_size": 500, **({"page_token": token} if token else {})}
                page = self.patiently("GET", f"/v1/jobs?{urlencode(query)}", None, tenant).json()
                found.update({job["id"]: job for job in page["jobs"]})
                token = page["next_page_token"]
                if not token:
                    break
        return found

    def get(self, given: Given) -> dict[str, Any]:
        return self.patiently("GET", f"/v1/jobs/{given.id}", None, given.tenant).json()

    def ended(self, patience: float) -> dict[str, dict[str, Any]]:
        """Waits until all acknowledged jobs have ended, and gives all jobs with the label."""
        end = time.monotonic() + patience
        while True:
            jobs = self.jobs()
            open_jobs = [job for job in jobs.values() if job["state"] in ("queued", "running")]
            if not open_jobs:
                return jobs
            if time.monotonic() > end:
                states = Counter(job["state"] for job in jobs.values())
                self.problems.append(f"after {patience:.0f} s not all have ended: {dict(states)}, {open_jobs[0]['id']} for example")
                return jobs
            time.sleep(0.25)

    def verify(self, expected: dict[str, dict[str, str]], patience: float = 120) -> dict[str, dict[str, Any]]:
        """Every acknowledged job has succeeded, once and with the expected results, and there is no other one."""
        jobs = self.ended(patience)
        for given in self.given:
            job = jobs.get(given.id)
            if job is None:
                self.problems.append(f"lost: {given}")
            elif job["state"] != "succeeded":
                self.problems.append(f"{given.id} is {job['state']}: {job['failure']} {job['expired_by']}")
            elif given.kind in expected and not results_agree(job["results"], expected[given.kind]):
                self.problems.append(f"other results than of one process: {job['results']}, {expected[given.kind]}")
        known = {given.id for given in self.given}
        twice = [job["id"] for job in jobs.values() if job["id"] not in known]
        if twice:
            self.problems.append(f"{len(twice)} jobs more than were acknowledged, {twice[0]} for example")
        return jobs


def results_agree(one: dict[str, str], other: dict[str, str]) -> bool:
    """A report has times."""
    return {name: digest for name, digest in one.items() if name != "report"} == {
        name: digest for name, digest in other.items() if name != "report"
    }
