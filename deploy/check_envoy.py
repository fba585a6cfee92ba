"""Puts Envoy with the configurations that are shipped before servers, and has them work.

Usage: check_envoy.py PROGRAM ENVOY

Servers by themselves: streams go to both, and a kept job is found again by whoever made it, over new connections. Servers that share
a database and a bucket: any of them answers for any job, over gRPC and HTTP, and one that is killed takes no job with it.
"""

import concurrent.futures
import json
import pathlib
import re
import subprocess
import sys

import yaml

from servers import Place, free_port, get, wait_for

HERE = pathlib.Path(__file__).parent


class Proxied(Place):
    """A folder with Envoy before servers of it."""

    def proxy(self, envoy, file, ports):
        """Envoy with a configuration. `ports` gives the servers' addresses for each port of the file."""
        # By way of JSON, in which parts of the file that are said once and used twice are two.
        rules = json.loads(json.dumps(yaml.safe_load((HERE / "envoy" / file).read_text())))
        port, admin = free_port(), free_port()
        rules["admin"]["address"]["socket_address"]["port_value"] = admin
        (listener,) = rules["static_resources"]["listeners"]
        listener["address"]["socket_address"] = {"address": "127.0.0.1", "port_value": port}
        for cluster in rules["static_resources"]["clusters"]:
            endpoints = cluster["load_assignment"]["endpoints"][0]
            (shipped,) = endpoints["lb_endpoints"]
            found = ports[shipped["endpoint"]["address"]["socket_address"]["port_value"]]
            endpoints["lb_endpoints"] = [
                {"endpoint": {"address": {"socket_address": {"address": host, "port_value": int(at)}}}}
                for host, at in (address.removeprefix("http://").split(":") for address in found)
            ]
            for check in cluster.get("health_checks", []):
                check.update(interval="0.5s", no_traffic_interval="0.5s")
        (self.folder / "envoy.yaml").write_text(yaml.safe_dump(rules))
        self.start(envoy, "-c", self.folder / "envoy.yaml", "--log-level", "error", "--concurrency", "2", "--base-id", free_port())
        wait_for(lambda: get(f"http://127.0.0.1:{admin}/ready").startswith("LIVE"), "Envoy")
        healthy = sum(map(len, ports.values())) * len(rules["static_resources"]["clusters"]) // len(ports)
        wait_for(lambda: get(f"http://127.0.0.1:{admin}/clusters").count("health_flags::healthy") == healthy, "healthy servers")
        return f"http://127.0.0.1:{port}"


def run(program, endpoint, *words, tenant="one"):
    """What the command prints. Each opens a connection of its own."""
    said = subprocess.run([program, *words, "--endpoint", endpoint, "--tenant", tenant],
                          stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    if said.returncode != 0:
        sys.exit(f"{words}: {said.stderr}")
    return said.stdout.strip()


def counted(server, series):
    """The sum of a counter's series whose labels match."""
    return sum(int(count) for count in re.findall(rf"^{series}.*}} (\d+)", get(f"http://{server.admin}/metrics"), re.M))


def done(server):
    return counted(server, r'tessera_jobs_ended_total\{outcome="done"')


def torus(program, folder):
    mesh = folder / "torus.ply"
    subprocess.run([program, "shape", "torus", "--facets", "2000", "-o", mesh], check=True, capture_output=True)
    return mesh


def streams(program, endpoint, mesh):
    """Eight at once, four at a time."""

    def stream(turn):
        run(program, endpoint, "remesh", mesh, "--points", "300", "-o", mesh.with_name(f"{turn}.ply"))

    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        list(pool.map(stream, range(8)))


def by_themselves(program, envoy):
    with Proxied() as place:
        servers = [place.server(program) for _ in range(2)]
        endpoint = place.proxy(envoy, "envoy.yaml", {50051: [server.endpoint for server in servers]})
        mesh = torus(program, place.folder)
        streams(program, endpoint, mesh)
        spread = [done(server) for server in servers]
        if sum(spread) != 8 or min(spread) == 0:
            sys.exit(f"8 streams went {spread}")

        # Each command finds the job of its tenant. Which tenant goes where is chance: so many are tried until both servers have one.
        before, tenants, jobs = spread, 0, [0, 0]
        while min(jobs) == 0 and tenants < 24:
            tenants += 1
            tenant = f"tenant{tenants}"
            job = run(program, endpoint, "jobs", "submit", "remesh", mesh, "--points", "300", tenant=tenant)
            run(program, endpoint, "jobs", "wait", job, tenant=tenant)
            for _ in range(4):
                run(program, endpoint, "jobs", "get", job, tenant=tenant)
            run(program, endpoint, "jobs", "fetch", job, "-o", place.folder / "job.ply", tenant=tenant)
            jobs = [done(server) - count for server, count in zip(servers, before)]
        if sum(jobs) != tenants or min(jobs) == 0:
            sys.exit(f"jobs of {tenants} tenants went {jobs}")
    print(f"streams went {spread[0]} : {spread[1]}, jobs of {tenants} tenants {jobs[0]} : {jobs[1]}, and each tenant finds its job")


def of_a_cluster(program, envoy):
    with Proxied() as place:
        shared = place.shared()
        servers = [place.server(program, shared=shared) for _ in range(3)]
        ports = {50051: [server.endpoint for server in servers], 8080: [server.http for server in servers]}
        endpoint = place.proxy(envoy, "cluster.yaml", ports)
        mesh = torus(program, place.folder)
        streams(program, endpoint, mesh)
        run(program, endpoint, "blobs", "put", mesh)

        def kept(points):
            """Submitted, waited for and fetched at whatever server."""
            job = run(program, endpoint, "jobs", "submit", "remesh", mesh, "--points", str(points))
            run(program, endpoint, "jobs", "wait", job)
            # Over HTTP too.
            said = json.loads(get(f"{endpoint}/v1/jobs/{job}", {"tessera-tenant": "one"}))
            if said["state"] != "succeeded":
                sys.exit(f"HTTP says that job {job} is {said['state']}")
            run(program, endpoint, "jobs", "fetch", job, "-o", place.folder / f"{points}.ply")

        with concurrent.futures.ThreadPoolExecutor(3) as pool:
            list(pool.map(kept, range(300, 306)))
        jobs = [done(server) for server in servers]
        calls = [counted(server, r"rpc_server_call_duration_seconds_count\{.*JobService") for server in servers]
        requests = [counted(server, r"http_server_request_duration_seconds_count\{.*v1/jobs") for server in servers]
        if sum(jobs) != 14 or min(calls) == 0 or sum(requests) != 6:
            sys.exit(f"8 streams and 6 jobs went {jobs}, calls {calls}, requests {requests}")

        servers[0].process.kill()
        # A call that reaches a server as it dies is answered by the proxy, and the command cannot know what became of it.
        servers[0].process.wait()
        with concurrent.futures.ThreadPoolExecutor(3) as pool:
            list(pool.map(kept, range(400, 403)))
    print(f"a cluster: streams and jobs went {' : '.join(map(str, jobs))}, and 3 jobs more without the first server")


if __name__ == "__main__":
    by_themselves(sys.argv[1], sys.argv[2])
    of_a_cluster(sys.argv[1], sys.argv[2])
