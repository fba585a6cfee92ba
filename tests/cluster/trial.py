#!/usr/bin/env python3
"""A trial of a cluster: PostgreSQL, an S3 server and three servers as real processes of this machine, which are killed, frozen
and cut off while jobs run.

Purpose: one function a case; a line for each with its figures, and all of them in a JSON file. Invariant: a case passes only if
each job that was acknowledged ended once, with the result that one process alone gives, and the tables agree with each other.
Usage: tests/cluster/trial.py PROGRAM [--short|--long] [--json FILE] [CASE...]
Needs PostgreSQL, and the packages of tests/python/venv.sh. `disk` needs root, `clock` needs libfaketime; else they are left out.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any
from urllib.parse import quote

# No bytecode beside the sources.
sys.dont_write_bytecode = True

from client import MIXED, Answer, Given, Lost, Work, call, session_of, torus
from parts import BUCKET, Bucket, Folder, Postgres, Server, Switch, wait_for

ROOT = Path(__file__).resolve().parent.parent.parent
TENANTS = ["north", "east", "south"]
LEASE_S = 60
#: A lost lease is looked for every twelfth of its time.
RECOVERY_S = 5
#: A new job is refused within 2 s while a store is away. The rest is for a busy machine, as that of the short form is.
REFUSAL_S = (4.0, 2.5)
#: The longest that a transaction may take, and some time for a busy machine.
OPERATION_S = 8 + 2
#: Steps of sessions: less than a second, and more; longer than what is away in a short trial, and in a long one.
BRIEF, LONG, LONGER = 3_000, 12_000, (20_000, 600_000)


class LeftOut(Exception):
    """A case that this machine cannot run."""


class Trial:
    """The cluster, and what the cases share."""

    def __init__(self, program: Path, is_long: bool, has_small_disk: bool) -> None:
        self.program, self.is_long = program, is_long
        self.folder = Folder()
        self.generation = 0
        self.problems: list[str] = []
        self.random = random.Random(int(os.environ.get("TESSERA_TRIAL_SEED", time.time())))
        self.place = self.folder.small_disk("database") if has_small_disk else self.folder.path / "database"
        self.place.mkdir(exist_ok=True)

    def open(self) -> None:
        self.bucket = Bucket(self.folder)
        self.database = Postgres(self.folder, "database0", self.place)
        self.database.sql("create database trial")
        self.switch = Switch(self.database.port)
        self.bucket.make()
        # One process alone, for the results that the cluster has to give.
        common = ["--backend", "parallel", "--threads", 1, "--jobs-at-once", 1, "--max-iterations", 10**6]
        self.alone = Server(self.folder, "alone", self.program, common, {})
        # A job of a trial is killed more often than one of a user.
        shared = ["--store", f"postgres://tessera@127.0.0.1:{self.switch.port}/trial", "--blobs", f"s3://{BUCKET}"]
        options = [*common, *shared, "--max-crashes", 1000, "--grace-s", 1]
        self.servers = [
            Server(self.folder, name, self.program, [*options, "--node", name], self.bucket.variables()) for name in "abc"
        ]
        for server in (self.alone, *self.servers):
            server.await_ready()
        self.mesh = torus(16)
        self.longer = session_of(LONGER[self.is_long])
        self.expected = self.results_of_one()

    def results_of_one(self) -> dict[str, dict[str, str]]:
        """The results of each kind of job, as one process gives them."""
        work = Work("alone", lambda: [self.alone.http], self.mesh)
        work.upload()
        for kind in [*MIXED, session_of(BRIEF)]:
            work.submit(kind)
        jobs = work.verify({})
        self.alone.kill()
        if work.problems:
            raise RuntimeError(f"one process alone: {work.problems[:3]}")
        return {given.kind: jobs[given.id]["results"] for given in work.given}

    def check(self, is_so: object, otherwise: str) -> None:
        if not is_so:
            self.problems.append(otherwise)

    def sql(self, query: str) -> str:
        return self.database.sql(query, "trial")

    def number(self, query: str) -> int:
        return int(self.sql(query))

    def operate(self, *words: str) -> str:
        """A command of operators, which must succeed. Gives what it prints."""
        url = f"postgres://tessera@127.0.0.1:{self.switch.port}/trial"
        done = subprocess.run(
            [self.program, *words, "--store", url], capture_output=True, text=True, timeout=60, check=False
        )
        self.check(done.returncode == 0, f"{' '.join(words)}: {done.returncode} {done.stdout}{done.stderr}")
        return done.stdout

    def work(self, name: str, tenants: list[str] | None = None) -> Work:
        work = Work(name, lambda: [server.http for server in self.servers], self.mesh, tenants or ["trial"])
        work.upload()
        return work

    def run_of_mixed(
        self, name: str, count: int, kinds: list[dict[str, Any]] = MIXED, pause: float = 0
    ) -> tuple[Work, threading.Thread]:
        """Jobs of all kinds and tenants, which are submitted in the background, each of two threads one after a pause."""
        work = self.work(name, TENANTS)
        jobs = [(kinds[i % len(kinds)], TENANTS[i % 3]) for i in range(count)]
        return work, work.submit_all(jobs, pause)

    def finish(
        self, work: Work, submitting: threading.Thread | None = None, patience: float = 300
    ) -> dict[str, dict[str, Any]]:
        """Waits for all jobs, and checks them."""
        if submitting:
            submitting.join()
        if self.is_long:
            patience *= 3
        jobs = work.verify(self.expected, patience)
        # Each change of a job's state is in its log.
        ends = self.sql(
            "select count(*) from tessera.jobs where state = 2 and (select count(*) from jsonb_array_elements(log::jsonb) e "
            "where e->'what'->'state'->>'state' in ('succeeded', 'failed', 'cancelled', 'expired')) <> 1"
        )
        self.check(ends == "0", f"{ends} jobs did not end exactly once")
        self.problems += work.problems
        return jobs

    def check_tables(self) -> None:
        """What the tables say of each other, once nothing is at work."""
        for what, query in {
            "leases of jobs that do not run": "tessera.leases l where not exists (select from tessera.jobs j "
            "where j.id = l.job and j.state = 1)",
            "jobs that run without a lease": "tessera.jobs j where state = 1 and not exists "
            "(select from tessera.leases l where l.job = j.id)",
            "requests without a job": "tessera.requests r where not exists (select from tessera.jobs j where j.id = r.job)",
            "jobs without their request": "tessera.jobs j where request_id <> '' and not exists (select from tessera.requests r "
            "where r.job = j.id and r.request_id = j.request_id)",
            "pins of jobs that need none": "tessera.pins p where not exists (select from tessera.jobs j where "
            "p.name = case when state < 2 then 'input:' else 'result:' end || encode(id, 'hex') and state <= 2)",
            "results without a pin": "tessera.jobs j where state = 2 and not exists (select from tessera.pins p "
            "where p.name = 'result:' || encode(j.id, 'hex'))",
        }.items():
            count = self.number(f"select count(*) from {query}")
            self.check(count == 0, f"{count} {what}")
        self.operate("store", "check")
        indexed = set(self.sql("select encode(digest, 'hex') from tessera.blobs").split())
        stored = self.bucket.objects()
        gone = set(self.sql("select encode(digest, 'hex') from tessera.gone").split())
        self.check(indexed <= stored, f"{len(indexed - stored)} blobs of the index are not in the bucket")
        extra = stored - indexed - gone
        self.check(not extra, f"{len(extra)} objects of the bucket are not in the index")

    def age_leases(self, server: Server) -> None:
        """Short trials do not wait for a lease: those of a server that is gone or frozen are over at once."""
        if not self.is_long:
            self.sql(
                "update tessera.leases set until = tessera.now_ms() - 1, length = 1000 "
                f"where holder like '{server.holder()}'"
            )

    def lease_s(self) -> float:
        """How long the work of a server that is gone may stay where it was."""
        return LEASE_S + RECOVERY_S + 1 if self.is_long else 2 * RECOVERY_S

    def held_by(self, server: Server) -> list[str]:
        return self.sql(f"select encode(job, 'hex') from tessera.leases where holder like '{server.holder()}'").split()

    def at_work(self, given: Given) -> Server:
        """The server that does a job now."""
        found: list[Server] = []

        def is_found() -> bool:
            holder = self.sql(f"select holder from tessera.leases where job = '\\x{given.id}'")
            found.extend(server for server in self.servers if f"process {server.process.pid} " in holder)
            return bool(found)

        wait_for("the job is at work", is_found)
        return found[0]

    def states_of(self, given: Given) -> list[tuple[str, int]]:
        """The states that a job went through, and when, milliseconds since 1970."""
        log = json.loads(self.sql(f"select log from tessera.jobs where id = '\\x{given.id}'"))
        return [(event["what"]["state"]["state"], event["at"]) for event in log if "state" in event["what"]]

    def others(self, server: Server) -> list[Server]:
        return [other for other in self.servers if other is not server]


def mixed(trial: Trial) -> dict[str, Any]:
    """Jobs of three tenants at three servers have the results of one process; tenants get equal shares."""
    work = trial.work("mixed", TENANTS)
    # Large jobs, many small ones, and some of each.
    tastes = [("north", MIXED[:6]), *[("east", MIXED[6:])] * 3, ("south", MIXED)]
    jobs_to_give = []
    for number in range(500 if trial.is_long else 30):
        tenant, kinds = tastes[number % len(tastes)]
        jobs_to_give.append((kinds[number // len(tastes) % len(kinds)], tenant))
    submitting = work.submit_all(jobs_to_give)
    jobs = trial.finish(work, submitting)
    trial.check(all((job["attempts"], job["crashes"]) == (1, 0) for job in jobs.values()), "a job was begun twice")
    share, beyond = unfairness(work, jobs)
    # Few jobs say little.
    trial.check(not trial.is_long or beyond <= 0.1, f"shares differ by {beyond:.0%}, the longest job taken off")
    return {
        "jobs": len(jobs), "unfairness": round(share, 3), "without_the_longest_job": round(beyond, 3),
        "longest_create_s": round(work.longest_s, 3),
    }  # fmt: skip


def unfairness(work: Work, jobs: dict[str, dict[str, Any]]) -> tuple[float, float]:
    """By how much of an equal share the work of a tenant differed most, in the second half of the time in which all waited; and
    the same less the longest job, since a job that has begun is not cut."""
    tenant = {given.id: given.tenant for given in work.given}
    by_tenant: dict[str, list[dict[str, Any]]] = defaultdict(list)
    for id, job in jobs.items():
        by_tenant[tenant[id]].append(job)
    begin = max(min(job["created_ms"] for job in own) for own in by_tenant.values())
    end = min(max(job["started_ms"] for job in own) for own in by_tenant.values())
    longest = max(job["changed_ms"] - job["started_ms"] for job in jobs.values())
    worst, beyond = 0.0, 0.0
    for at in range((begin + end) // 2, end, 50):
        had = [
            sum(max(0, min(job["changed_ms"], at) - max(job["started_ms"], begin)) for job in own)
            for own in by_tenant.values()
        ]
        mean = sum(had) / len(had)
        if mean:
            difference = max(abs(one - mean) for one in had)
            worst, beyond = max(worst, difference / mean), max(beyond, (difference - longest) / mean)
    return worst, beyond


def kill(trial: Trial) -> dict[str, Any]:
    """Servers that are killed and started again lose no job, and their work goes on elsewhere within a lease."""
    kills = 50 if trial.is_long else 3
    work, submitting = trial.run_of_mixed("kill", 500 if trial.is_long else 18, [session_of(LONG), session_of(BRIEF), *MIXED])
    lost: list[tuple[str, float]] = []
    for _ in range(kills):
        server = trial.random.choice(trial.servers)
        time.sleep(trial.random.uniform(1, 4) if trial.is_long else trial.random.uniform(0.2, 0.8))
        server.kill()
        at = time.time()
        held = trial.held_by(server)
        lost += [(id, at) for id in held]
        trial.age_leases(server)
        server.start()
    jobs = trial.finish(work, submitting)
    recovery = []
    for id, at in lost:
        given = next(given for given in work.given if given.id == id)
        again = [when / 1000 - at for state, when in trial.states_of(given) if state == "queued" and when / 1000 > at]
        trial.check(again, f"{id} was not taken back")
        recovery += again[:1]
    longest = max(recovery, default=0.0)
    trial.check(longest <= trial.lease_s(), f"a job waited {longest:.1f} s for its recovery")
    crashes = sum(job["crashes"] for job in jobs.values())
    return {
        "jobs": len(jobs), "kills": kills, "lost_leases": len(lost), "crashes": crashes, "longest_recovery_s": round(longest, 1),
    }  # fmt: skip


def database(trial: Trial) -> dict[str, Any]:
    """Crashes of the database and of the S3 server under load cost nothing but time."""
    times = 10 if trial.is_long else 1
    work, submitting = trial.run_of_mixed("database", 300 if trial.is_long else 22, [*MIXED, session_of(LONG)], 0.2)
    for _ in range(times):
        for part in (trial.database, trial.bucket):
            time.sleep(trial.random.uniform(0.3, 2))
            part.stop_immediate()
            time.sleep(trial.random.uniform(0, 1))
            part.start()
    jobs = trial.finish(work, submitting)
    again = sum(job["attempts"] - 1 for job in jobs.values())
    return {"jobs": len(jobs), "restarts_of_each": times, "begun_again": again, "refusals": dict(work.refusals)}


def away(trial: Trial) -> dict[str, Any]:
    """While the database or the bucket is away, new jobs are refused soon and work goes on."""
    seconds = 60 if trial.is_long else 2
    figures: dict[str, Any] = {"seconds": seconds}
    soon = REFUSAL_S[trial.is_long]
    hung = lambda part: part.signal_all(signal.SIGSTOP)  # noqa: E731
    goes_on = lambda part: part.signal_all(signal.SIGCONT)  # noqa: E731
    for name, part, stop, start in [
        ("database", trial.database, Postgres.stop_immediate, Postgres.start),
        ("database that hangs", trial.database, hung, goes_on),
        ("bucket", trial.bucket, Bucket.stop_immediate, Bucket.start),
        ("bucket that hangs", trial.bucket, hung, goes_on),
    ]:
        figures[name] = away_once(trial, name, lambda: stop(part), lambda: start(part), seconds, soon, trial.servers)
    return figures


def away_once(
    trial: Trial, name: str, stop: Callable[[], None], start: Callable[[], None], seconds: float, soon: float, asked: list[Server]
) -> dict[str, Any]:
    """New jobs are refused `soon`, work goes on, and nothing is half-created."""
    work = trial.work("away-" + name.replace(" ", "-"))
    long = work.submit(trial.longer)
    trial.at_work(long)
    before = len(work.jobs())
    stop()
    others: dict[str, str] = {}
    calls: list[tuple[str, str, str, bytes | None]] = [
        ("list", "GET", "/v1/jobs?page_size=1", None),
        ("get", "GET", f"/v1/jobs/{long.id}", None),
        ("read", "GET", f"/v1/blobs/{work.digest}", None),
        ("upload", "POST", "/v1/blobs", work.name.encode()),
    ]
    probes = [threading.Thread(target=probe, args=(trial, others, *what)) for what in calls]
    for thread in probes:
        thread.start()
    refused, accepted, repeated = [], [], []
    end = time.monotonic() + seconds
    number = 0
    kind = MIXED[-2]
    while time.monotonic() < end:
        time.sleep(seconds / 10)
        for server in asked:
            number += 1
            body = work.body(kind, f"{work.name}-{number}")
            begin = time.monotonic()
            try:
                answer = call(server.http, "POST", "/v1/jobs", body)
            except Lost as error:
                trial.problems.append(f"{name} away: {error}")
                continue
            if answer.status < 300:
                accepted.append((number, answer))
            else:
                refused.append(time.monotonic() - begin)
                trial.check(answer.status == 503 and answer.headers.get("retry-after"), f"{name} away: create says {answer}")
                repeated.append((number, body))
    start()
    for thread in probes:
        thread.join()
    longest = max(refused, default=0.0)
    trial.check(longest <= soon, f"{name} away: a refusal took {longest:.1f} s")
    for number, answer in accepted:
        work.given.append(Given(answer.json()["id"], "trial", f"{work.name}-{number}", json.dumps(kind), 0))
    # What was refused may have been kept all the same: the same request gives the same job.
    for number, body in trial.random.sample(repeated, min(3, len(repeated))):
        answers = [work.patiently("POST", "/v1/jobs", body, "trial") for _ in range(2)]
        trial.check(answers[0].json()["id"] == answers[1].json()["id"], f"{name} away: one request gave two jobs")
        work.given.append(Given(answers[0].json()["id"], "trial", body["request_id"], json.dumps(kind), 0))
    known = {given.id for given in work.given}
    kept = [job for id, job in work.jobs().items() if id not in known]
    work.given += [Given(job["id"], "trial", job["request_id"], json.dumps(kind), 0) for job in kept]
    jobs = trial.finish(work)
    job = jobs.get(long.id, {})
    trial.check((job.get("attempts"), job.get("crashes")) == (1, 0), f"{name} away: running work was begun again: {job}")
    return {
        "refused": len(refused), "accepted": len(accepted), "refused_but_kept": len(kept), "jobs_before": before,
        "longest_refusal_s": round(longest, 2), "others": others,
    }  # fmt: skip


def probe(trial: Trial, said: dict[str, str], name: str, method: str, path: str, body: bytes | None) -> None:
    """Notes what a call says while something is away, and after how long."""
    begin = time.monotonic()
    try:
        word = str(call(trial.servers[0].http, method, path, body, timeout=90).status)
    except Lost as error:
        word = f"lost: {str(error)[-80:]}"
    said[name] = f"{word} in {time.monotonic() - begin:.1f} s"


def standby(trial: Trial) -> dict[str, Any]:
    """What was acknowledged is at the synchronous standby that takes over."""
    times = 5 if trial.is_long else 1
    second = next_standby(trial)
    work, submitting = trial.run_of_mixed("standby", 300 if trial.is_long else 22, [*MIXED, session_of(BRIEF)], 0.2)
    delays = []
    for _ in range(times):
        time.sleep(trial.random.uniform(0.5, 2))
        trial.database.stop_immediate()
        begin = time.monotonic()
        second.promote()
        trial.database = second
        trial.switch.to(second.port)
        # Nothing is acknowledged until there is a standby again.
        second = next_standby(trial)
        delays.append(time.monotonic() - begin)
    jobs = trial.finish(work, submitting)

    def stop() -> None:
        second.stop_immediate()

    def start() -> None:
        second.start()
        trial.database.wait_for_standby()

    # Nothing can be acknowledged without it: a commit waits, for as long as an operation may take.
    alone = away_once(trial, "standby", stop, start, 60 if trial.is_long else 1, OPERATION_S, trial.servers[:1])
    trial.check(not alone["accepted"], "jobs were acknowledged without a standby")
    trial.database.forget_standby()
    second.stop_immediate()
    return {
        "jobs": len(jobs), "promotions": times, "longest_delay_s": round(max(delays), 1), "refusals": dict(work.refusals),
        "without_a_standby": alone,
    }  # fmt: skip


def next_standby(trial: Trial) -> Postgres:
    trial.generation += 1
    made = Postgres(trial.folder, f"database{trial.generation}", trial.place, trial.database)
    trial.database.wait_for_standby()
    return made


def frozen(trial: Trial) -> dict[str, Any]:
    """A server that sleeps longer than a lease does not bring its job to an end when it wakes."""
    work = trial.work("frozen")
    given = work.submit(trial.longer)
    server = trial.at_work(given)
    shown = call(trial.servers[0].http, "GET", f"/v1/jobs/{given.id}", tenant=given.tenant).json()["server"]
    trial.check(shown == server.name, f"the job is shown at {shown}, and is at {server.name}")
    time.sleep(0.3)
    server.process.send_signal(signal.SIGSTOP)
    trial.age_leases(server)
    seconds = wait_for(
        "another server has the job", lambda: not trial.held_by(server) and trial.sql("select 1 from tessera.leases"), 120
    )
    trial.check(seconds <= trial.lease_s(), f"it took {seconds:.1f} s")
    server.process.send_signal(signal.SIGCONT)
    jobs = trial.finish(work)
    job = jobs.get(given.id, {})
    states = [state for state, _ in trial.states_of(given)]
    trial.check(states == ["queued", "running", "queued", "running", "succeeded"], f"it went through {states}")
    # The sleeper works again.
    answer = call(server.http, "GET", "/v1/jobs?page_size=1")
    trial.check(answer.status == 200, f"the server that slept says {answer}")
    return {"seconds_until_taken_over": round(seconds, 1), "attempts": job.get("attempts"), "crashes": job.get("crashes")}


def clock(trial: Trial) -> dict[str, Any]:
    """A server whose clock is an hour off works like any other."""
    library = next(iter(Path("/usr/lib").glob("*/faketime/libfaketimeMT.so.1")), None)
    if library is None:
        raise LeftOut("libfaketime is not installed")
    server, figures = trial.servers[0], {}
    # The times of signatures are checked by the bucket, which allows 15 minutes.
    faked = {"LD_PRELOAD": str(library), "FAKETIME_DONT_FAKE_MONOTONIC": "1", "AWS_SKIP_SIGNATURE": "true"}
    try:
        for offset in ("+1h", "-1h"):
            server.stop()
            before = server.ends()
            server.start(**faked, FAKETIME=offset)
            work, submitting = trial.run_of_mixed(f"clock{offset}", 100 if trial.is_long else 10)
            jobs = trial.finish(work, submitting)
            once = all((job["attempts"], job["crashes"]) == (1, 0) for job in jobs.values())
            trial.check(once, f"{offset}: a job was begun twice")
            ends = server.ends() - before
            trial.check(ends, f"{offset}: the others did it all")
            figures[offset] = {"jobs": len(jobs), "done_by_it": ends, "refusals": dict(work.refusals)}
    finally:
        server.stop()
        server.start()
    return figures


def twice(trial: Trial) -> dict[str, Any]:
    """One request id at two servers at once makes one job."""
    times = 1000 if trial.is_long else 50
    work = trial.work("twice")
    both = threading.Barrier(2)
    answers: list[list[Answer | None]] = [[None] * times, [None] * times]

    def create(side: int) -> None:
        for number in range(times):
            body = work.body(MIXED[-2], f"twice-{number}")
            both.wait()
            try:
                answers[side][number] = call(trial.servers[side].http, "POST", "/v1/jobs", body)
            except Lost as error:
                trial.problems.append(str(error))

    threads = [threading.Thread(target=create, args=(side,)) for side in (0, 1)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    for one, other in zip(*answers):
        if one is None or other is None:
            continue
        if one.status >= 300 or other.status >= 300:
            trial.problems.append(f"refused: {one}, {other}")
            continue
        same = one.json()["id"] == other.json()["id"]
        trial.check(same and {one.status, other.status} == {200, 201}, f"{one.status} {other.status}, same: {same}")
        work.given.append(Given(one.json()["id"], "trial", one.json()["request_id"], json.dumps(MIXED[-2]), 0))
    trial.finish(work)
    return {"requests": times}


def disk(trial: Trial) -> dict[str, Any]:
    """A full disk under PostgreSQL refuses jobs, loses none, and work goes on when there is room."""
    if not os.path.ismount(trial.place):
        raise LeftOut("only root can make a small disk")
    work = trial.work("disk")
    for _ in range(6):
        work.submit(session_of(BRIEF))
    ballast = trial.place / "ballast"
    refusals: dict[str, int] = defaultdict(int)
    unexpected = []
    try:
        with open(ballast, "wb", buffering=0) as file:
            fill(file)
            end = time.monotonic() + (60 if trial.is_long else 4)
            labels = {f"k{i}": "x" * 200 for i in range(60)}
            while time.monotonic() < end:
                fill(file)
                if trial.database.process.poll() is not None:
                    # As its supervisor does.
                    trial.database.begin()
                    time.sleep(0.5)
                try:
                    body = work.body(session_of(BRIEF), "")
                    body["labels"].update(labels)
                    answer = call(trial.random.choice(trial.servers).http, "POST", "/v1/jobs", body)
                except Lost as error:
                    unexpected.append(str(error))
                    continue
                time.sleep(0.05)
                if answer.status == 201:
                    work.given.append(Given(answer.json()["id"], "trial", "", json.dumps(session_of(BRIEF)), 0))
                else:
                    refusals[f"{answer.status} {answer.json().get('reason')}"] += 1
                    if answer.status != 503:
                        unexpected.append(str(answer))
    finally:
        ballast.unlink()
    if trial.database.process.poll() is not None:
        trial.database.begin()
    wait_for("PostgreSQL answers", trial.database.is_ready)
    trial.check(refusals, "the disk was never full")
    trial.problems += unexpected[:3]
    # Refused jobs without a request id may have been kept: nothing was acknowledged of them.
    known = {given.id for given in work.given}
    kept = [job for id, job in work.jobs().items() if id not in known]
    work.given += [Given(job["id"], "trial", "", json.dumps(session_of(BRIEF)), 0) for job in kept]
    jobs = trial.finish(work)
    return {"jobs": len(jobs), "refusals": dict(refusals), "refused_but_kept": len(kept)}


def fill(file: Any) -> None:
    """Writes until the disk is full."""
    for size in (1 << 20, 1 << 12):
        try:
            while True:
                if file.write(b"\0" * size) < size:
                    break
        except OSError:
            pass


def rolling(trial: Trial) -> dict[str, Any]:
    """Servers that are drained and replaced one after another under load fail no job."""
    rounds = 3 if trial.is_long else 1
    kinds = [session_of(2 * LONG), *MIXED, session_of(BRIEF)]
    work, submitting = trial.run_of_mixed("rolling", 300 if trial.is_long else 16, kinds, 0.2)
    slowest = 0.0
    for server in trial.servers * rounds:
        time.sleep(0.3)
        trial.operate("cluster", "drain", server.name)
        begin = time.monotonic()
        code = server.stop()
        slowest = max(slowest, time.monotonic() - begin)
        trial.check(code == 0, f"{server.name} ended with {code}: {server.tail(3)}")
        server.start()
    jobs = trial.finish(work, submitting)
    crashes = sum(job["crashes"] for job in jobs.values())
    trial.check(crashes == 0, f"{crashes} crashes were counted")
    again = sum(len(trial.states_of(given)) > 3 for given in work.given)
    return {"jobs": len(jobs), "given_back": again, "longest_stop_s": round(slowest, 1)}


#: Strings of a hostile tenant.
HOSTILE = [
    "'; drop table tessera.jobs; --", "\" or 1=1 --", "$1", "%s%n", "\\", "\0", "a\0b", "\ud800", "\u202egnp.exe", "١٢٣", "😀" * 20,
    "x" * 2**20, "null", "{}", "[]", "../../etc/passwd", "\r\nHost: evil", "%", "_", "E'\\\\x00'", "' union select 1 --",
]  # fmt: skip


def hostile(trial: Trial) -> dict[str, Any]:
    """Strings of any kind are refused or kept as they are, and no query of a tenant reads a whole table."""
    queries = 10_000 if trial.is_long else 300
    work = trial.work("hostile", ["mallory"])
    work.submit(MIXED[-2])
    trial.finish(work)
    # Tables with a few rows are read as a whole, rightly.
    crowd = 40_000 if trial.is_long else 20_000
    trial.sql(
        "insert into tessera.jobs (id, tenant, request_id, state, version, priority, host_bytes, device_bytes, created, changed, "
        "labels, spec, status, log) select decode(md5(i::text), 'hex'), 'crowd', i::text, 3, version, priority, host_bytes, "
        "device_bytes, created, changed, labels, spec, status, log "
        f"from tessera.jobs, generate_series(1, {crowd}) i where id = '\\x{work.given[0].id}'"
    )
    trial.sql("insert into tessera.requests select tenant, request_id, id from tessera.jobs where tenant = 'crowd'")
    trial.sql("analyze tessera.jobs, tessera.requests")
    try:
        return queries_of_mallory(trial, work, queries)
    finally:
        trial.sql("delete from tessera.requests where tenant = 'crowd'")
        trial.sql("delete from tessera.jobs where tenant = 'crowd'")


def rows_by_scans(trial: Trial) -> int:
    """How many rows of the tables of jobs were read by scans of the whole."""
    # Processes report what they did at most once a second, and before they wait for their client.
    time.sleep(1.5)
    return trial.number(
        "select sum(seq_tup_read) from pg_stat_user_tables where schemaname = 'tessera' and relname in ('jobs', 'requests')"
    )


def queries_of_mallory(trial: Trial, work: Work, queries: int) -> dict[str, Any]:
    before = rows_by_scans(trial)
    statuses: dict[int, int] = defaultdict(int)
    bad: list[str] = []

    def one(number: int) -> None:
        dice = random.Random(number)
        text = dice.choice(HOSTILE)
        quoted = json.dumps(text)
        in_query = quote(text.encode("utf-8", "surrogatepass"))
        if len(in_query) > 60_000:
            in_query = in_query[: dice.choice([200, 7000, 20000])]
        spec: dict[str, Any] = work.body(MIXED[-2], f"hostile-{number % 50}")
        kinds: list[tuple[str, str, Any]] = [
            ("POST", "/v1/jobs", {**spec, "request_id": text}),
            ("POST", "/v1/jobs", {**spec, "request_id": f"l{number}", "labels": {"k": text}}),
            ("POST", "/v1/jobs", {**spec, "request_id": f"k{number}", "labels": {text: "v"}}),
            ("POST", "/v1/jobs", {**spec, "mesh": {"file": {"digest": text, "format": "MESH_FORMAT_OBJ"}}}),
            ("POST", "/v1/jobs", f'{{"mesh": {quoted}, "format": {quoted}}}'.encode()),
            ("GET", f"/v1/jobs?label={in_query}", None),
            ("GET", f"/v1/jobs?label=k={in_query}&page_size=5", None),
            ("GET", "/v1/jobs?label=trial=hostile&page_size=2&states=queued", None),
            ("GET", f"/v1/jobs?page_token={in_query}", None),
            ("GET", f"/v1/jobs?page_size={in_query}", None),
            ("GET", f"/v1/jobs/{in_query}", None),
            ("GET", f"/v1/jobs/{number:032x}", None),
            ("GET", f"/v1/jobs/{in_query}/result?name={in_query}", None),
            ("POST", f"/v1/jobs/{number:032x}/cancel", None),
            ("DELETE", f"/v1/jobs/{number:032x}", None),
            ("GET", f"/v1/blobs/{in_query}", None),
            ("GET", f"/v1/blobs/{number:064x}", None),
            ("DELETE", f"/v1/blobs/{number:064x}", None),
            ("POST", f"/v1/blobs?digest={in_query}", b"x"),
        ]
        method, path, body = dice.choice(kinds)
        try:
            answer = call(dice.choice(trial.servers).http, method, path, body, "mallory")
        except Lost as error:
            # What is too long is not read to its end.
            if len(path) < 16_000:
                bad.append(f"{method} {path[:200]}: {str(error)[-200:]}")
            return
        statuses[answer.status] += 1
        if answer.status >= 500:
            bad.append(f"{method} {path[:200]} {str(body)[:200]}: {answer}")

    numbers = iter(range(queries))
    lock = threading.Lock()

    def many() -> None:
        while True:
            with lock:
                number = next(numbers, None)
            if number is None:
                return
            one(number)

    threads = [threading.Thread(target=many) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    trial.problems += bad[:5]
    read = rows_by_scans(trial) - before
    rows = trial.number("select count(*) from tessera.jobs")
    trial.check(read < rows, f"{read} rows were read by scans of tables with {rows} rows, for {queries} queries")
    wait_for("all jobs have ended", lambda: trial.number("select count(*) from tessera.jobs where state < 2") == 0, 300)
    return {"queries": queries, "statuses": dict(sorted(statuses.items())), "rows_by_scans": read, "rows": rows}


def upload(trial: Trial) -> dict[str, Any]:
    """An upload that began at a server that is killed goes on at another."""
    import google_crc32c
    import grpc

    sys.path.insert(0, str(ROOT / "clients/python/python/tessera_remesh/service"))
    from _stubs import blob_pb2

    piece = 1 << 20
    data = random.Random(7).randbytes((64 if trial.is_long else 24) * piece + 12345)
    digest = hashlib.sha256(data).hexdigest()

    def pieces(start: int, end: int) -> Any:
        for offset in range(start, end, piece):
            part = data[offset : min(offset + piece, end)]
            yield blob_pb2.WriteRequest(
                digest=digest, size_bytes=len(data), offset=offset, data=part, crc32c=google_crc32c.value(part),
                finish=offset + len(part) == len(data),
            )  # fmt: skip

    def methods(server: Server) -> tuple[Any, Any]:
        channel = grpc.insecure_channel(server.grpc)
        write = channel.stream_unary(
            "/tessera.v1.BlobService/Write", blob_pb2.WriteRequest.SerializeToString, blob_pb2.WriteResponse.FromString
        )
        ask = channel.unary_unary(
            "/tessera.v1.BlobService/QueryWriteStatus", blob_pb2.QueryWriteStatusRequest.SerializeToString,
            blob_pb2.QueryWriteStatusResponse.FromString,
        )  # fmt: skip
        return write, ask

    metadata = [("tessera-tenant", "uploader")]
    first, second = trial.servers[:2]
    write, ask = methods(first)
    half = len(data) // piece // 2 * piece
    write(pieces(0, half), metadata=metadata)
    question = blob_pb2.QueryWriteStatusRequest(digest=digest, size_bytes=len(data))
    before = ask(question, metadata=metadata).kept_bytes
    first.kill()
    write, ask = methods(second)
    try:
        kept = ask(question, metadata=metadata).kept_bytes
    except grpc.RpcError as error:
        trial.check(error.code() == grpc.StatusCode.NOT_FOUND, f"QueryWriteStatus: {error}")
        kept = 0
    done = write(pieces(kept, len(data)), metadata=metadata)
    trial.check(done.complete, "the upload is not complete")
    first.start()
    answer = call(first.http, "GET", f"/v1/blobs/{digest}", tenant="uploader")
    trial.check(answer.status == 200 and answer.body == data, f"read back: {answer.status}, {len(answer.body)} bytes")
    again = before - kept
    trial.check(again <= piece, f"{again} bytes had to be sent again")
    return {"bytes": len(data), "sent_before": half, "kept_before": before, "kept_after": kept, "sent_again": half - kept}


def keys(trial: Trial) -> dict[str, Any]:
    """A key that is made or revoked in the database counts at all servers soon."""

    def all_answer(status: int, key: str | None = None) -> bool:
        answers = [call(server.http, "GET", "/v1/jobs", tenant="keyed", key=key).status for server in trial.servers]
        return answers == [status] * len(answers)

    trial.check(all_answer(200), "a tenant without a key was refused")
    key = trial.operate("keys", "add", "keyed", "--role", "read").strip()
    # The tenant cannot be named without its key from now on.
    made = wait_for("the key counts", lambda: all_answer(401))
    trial.check(all_answer(200, key), "the key was refused")
    trial.operate("keys", "revoke", "keyed")
    revoked = wait_for("the key is revoked", lambda: all_answer(401, key))
    return {"seconds_until_made": round(made, 1), "seconds_until_revoked": round(revoked, 1)}


CASES: list[Callable[[Trial], dict[str, Any]]] = [
    mixed, kill, database, away, standby, frozen, clock, twice, disk, rolling, hostile, upload, keys,
]  # fmt: skip


def main() -> int:
    names = [case.__name__ for case in CASES]
    parser = argparse.ArgumentParser(description=str(__doc__).split("\n\n")[0])
    parser.add_argument("program", type=Path, help="the program tessera")
    parser.add_argument("cases", nargs="*", metavar="CASE", help=f"all if none is given: {', '.join(names)}")
    scale = parser.add_mutually_exclusive_group()
    scale.add_argument("--short", action="store_true", help="a minute in all; the default")
    scale.add_argument("--long", action="store_true", help="real leases and many repetitions")
    parser.add_argument("--json", type=Path, help="a file for the figures")
    parser.add_argument("--keep", type=Path, help="a folder for the logs")
    asked = parser.parse_intermixed_args()
    unknown = set(asked.cases) - set(names)
    if unknown:
        parser.error(f"no such case: {', '.join(sorted(unknown))}")

    def stop(*_: object) -> None:
        raise KeyboardInterrupt

    signal.signal(signal.SIGTERM, stop)
    chosen = [case for case in CASES if not asked.cases or case.__name__ in asked.cases]
    results, begin = [], time.monotonic()
    trial = Trial(asked.program.resolve(), asked.long, disk in chosen and os.geteuid() == 0)
    try:
        trial.open()
        print(f"opened in {time.monotonic() - begin:.1f} s", flush=True)
        for case in chosen:
            results.append(run(trial, case))
    except KeyboardInterrupt:
        return 130
    finally:
        if asked.keep:
            asked.keep.mkdir(parents=True, exist_ok=True)
            for log in trial.folder.path.glob("*.log"):
                shutil.copy(log, asked.keep)
        trial.folder.close()
        if asked.json:
            asked.json.write_text(json.dumps(results, indent=1) + "\n")
    failed = [result["case"] for result in results if result["passed"] is False]
    print(f"{len(results) - len(failed)} of {len(results)} in {time.monotonic() - begin:.0f} s, failed: {failed}")
    return 1 if failed else 0


def run(trial: Trial, case: Callable[[Trial], dict[str, Any]]) -> dict[str, Any]:
    """Runs a case, prints its line and gives its figures."""
    trial.problems, begin = [], time.monotonic()
    figures: dict[str, Any] = {}
    passed: bool | None = True
    try:
        figures = case(trial)
        trial.check_tables()
    except LeftOut as why:
        figures, passed = {"left_out": str(why)}, None
    except Exception as error:  # noqa: BLE001
        trial.problems.append(f"{type(error).__name__}: {error}")
    seconds = round(time.monotonic() - begin, 1)
    passed = passed and not trial.problems
    word = {True: "PASS", False: "FAIL", None: "LEFT OUT"}[passed]
    print(f"{word} {case.__name__} {seconds} s {json.dumps(figures)}", flush=True)
    for problem in trial.problems[:10]:
        print(f"     {problem[:2000]}", flush=True)
    return {"case": case.__name__, "passed": passed, "seconds": seconds, **figures, "problems": trial.problems[:50]}


if __name__ == "__main__":
    sys.exit(main())
