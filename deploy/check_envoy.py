"""Puts Envoy with the configuration that is shipped before two servers, and has them work.

Usage: check_envoy.py PROGRAM ENVOY

Streams go to both servers. A kept job is found again by whoever made it, over new connections. A server that ends takes no streams.
"""

import concurrent.futures
import pathlib
import re
import subprocess
import sys

import yaml

from servers import Place, free_port, get, wait_for

HERE = pathlib.Path(__file__).parent


def configuration(endpoints):
    """The file, with the addresses of this check."""
    rules = yaml.safe_load((HERE / "envoy/envoy.yaml").read_text())
    port, admin = free_port(), free_port()
    rules["admin"]["address"]["socket_address"]["port_value"] = admin
    rules["static_resources"]["listeners"][0]["address"]["socket_address"] = {"address": "127.0.0.1", "port_value": port}

    def place(endpoint):
        host, at = endpoint.removeprefix("http://").split(":")
        return {"endpoint": {"address": {"socket_address": {"address": host, "port_value": int(at)}}}}

    for cluster in rules["static_resources"]["clusters"]:
        cluster["load_assignment"]["endpoints"][0]["lb_endpoints"] = [place(endpoint) for endpoint in endpoints]
        for check in cluster.get("health_checks", []):
            check.update(interval="0.5s", no_traffic_interval="0.5s")
    return yaml.safe_dump(rules), f"http://127.0.0.1:{port}", f"http://127.0.0.1:{admin}"


def main(program, envoy):
    with Place() as place:
        servers = [place.server(program) for _ in range(2)]
        text, endpoint, admin = configuration([server[0] for server in servers])
        (place.folder / "envoy.yaml").write_text(text)
        place.start(envoy, "-c", place.folder / "envoy.yaml", "--log-level", "error", "--concurrency", "2",
                    "--base-id", free_port())
        wait_for(lambda: get(f"{admin}/ready").startswith("LIVE"), "Envoy")
        wait_for(lambda: get(f"{admin}/clusters").count("health_flags::healthy") == 4, "healthy servers")

        def run(*words, tenant="one"):
            said = subprocess.run([program, *words, "--endpoint", endpoint, "--tenant", tenant],
                                  stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
            if said.returncode != 0:
                sys.exit(f"{words}: {said.stderr}")
            return said.stdout.strip()

        def done(server):
            told = get(f"http://{server[1]}/metrics")
            return sum(int(count) for count in re.findall(r'^tessera_jobs_ended_total\{outcome="done".*\} (\d+)', told, re.M))

        mesh = place.folder / "torus.ply"
        subprocess.run([program, "shape", "torus", "--facets", "4000", "-o", mesh], check=True, capture_output=True)

        def stream(turn):
            run("remesh", mesh, "--points", "300", "-o", place.folder / f"{turn}.ply")

        with concurrent.futures.ThreadPoolExecutor(4) as pool:
            list(pool.map(stream, range(8)))
        spread = [done(server) for server in servers]
        if sum(spread) != 8 or min(spread) == 0:
            sys.exit(f"8 streams went {spread}")

        # Each command opens a connection of its own, and finds the job of its tenant. Which tenant goes where is chance: so many
        # are tried until both servers have one.
        before, tenants, jobs = spread, 0, [0, 0]
        while min(jobs) == 0 and tenants < 24:
            tenants += 1
            tenant = f"tenant{tenants}"
            job = run("jobs", "submit", "remesh", mesh, "--points", "300", tenant=tenant)
            run("jobs", "wait", job, tenant=tenant)
            for _ in range(4):
                run("jobs", "get", job, tenant=tenant)
            run("jobs", "fetch", job, "-o", place.folder / "job.ply", tenant=tenant)
            jobs = [done(server) - count for server, count in zip(servers, before)]
        if sum(jobs) != tenants or min(jobs) == 0:
            sys.exit(f"jobs of {tenants} tenants went {jobs}")
    print(f"streams went {spread[0]} : {spread[1]}, jobs of {tenants} tenants {jobs[0]} : {jobs[1]}, and each tenant finds its job")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2])
