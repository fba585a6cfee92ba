"""Asks every query of the dashboard and of the alerts of a real Prometheus that watches two servers of a cluster at work.

Usage: check_queries.py PROGRAM

Every query of the dashboard has to give figures, and `grafana/preview.py` has to draw them. An alert gives none as long as all is
well: its metrics, with their labels, have to be there. What KEDA asks has to be there too.
"""

import json
import math
import pathlib
import re
import subprocess
import sys
import textwrap
import urllib.parse

import yaml

from servers import Place, free_port, get, wait_for

HERE = pathlib.Path(__file__).parent
SELECTOR = re.compile(r"\b((?:tessera|rpc_server|process)_\w+|up)(\{[^}]*\})?")
# What a server that works does not have: its series begin with the first of their events.
RARE = re.compile(r'rpc_response_status_code=~"INTERNAL|reason="storage"')


class Prometheus:
    def __init__(self, place, servers):
        # The files that are shipped, but for the server's address and shorter pauses.
        for name in ("prometheus.yml", "alerts.yml"):
            text = (HERE / "prometheus" / name).read_text()
            (place.folder / name).write_text(text.replace("_interval: 15s", "_interval: 1s"))
        (place.folder / "targets.yml").write_text(yaml.safe_dump([{"targets": [server.admin for server in servers]}]))
        self.url = f"http://127.0.0.1:{free_port()}"
        place.start(
            "prometheus", f"--config.file={place.folder}/prometheus.yml", f"--storage.tsdb.path={place.folder}/data",
            f"--web.listen-address={self.url.removeprefix('http://')}", "--log.level=error",
        )

    def ask(self, query):
        found = json.loads(get(f"{self.url}/api/v1/query?" + urllib.parse.urlencode({"query": query})))
        return [float(entry["value"][1]) for entry in found["data"]["result"]]

    def rules(self):
        return json.loads(get(f"{self.url}/api/v1/rules"))["data"]["groups"][0]["rules"]


def work(program, endpoint, folder):
    """Some of each call, over about ten seconds."""

    def run(*words):
        said = subprocess.run([program, *words], check=True, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True)
        return said.stdout.strip()

    mesh, out = folder / "torus.ply", folder / "out.ply"
    run("shape", "torus", "--facets", "2000", "-o", mesh)
    there = ("--endpoint", endpoint)
    for turn in range(4):
        run("remesh", mesh, "--points", "200", "-o", out, *there)
        run("rvd", mesh, "--points", "200", "-o", out, *there)
        job = run("jobs", "submit", "remesh", mesh, "--points", str(200 + turn), *there)
        run("jobs", "wait", job, *there)
        run("jobs", "fetch", job, "-o", out, *there)


def check_scale(servers):
    """What the ScaledObject of the overlay `cluster` asks, while nothing is to do."""
    text = (HERE / "kubernetes/overlays/cluster/kustomization.yaml").read_text()
    (trigger,) = re.findall(r"^( +)- type: metrics-api\n\1  metadata:\n((?:\1    .+\n)+)", text, re.M)
    trigger = yaml.safe_load(textwrap.dedent(trigger[1]))
    path = urllib.parse.urlsplit(trigger["url"]).path
    try:
        said = json.loads(get(f"http://{servers[0].admin}{path}"))
        value, nodes, capacity = said[trigger["valueLocation"]], said["nodes"], said["capacity"]
    except (OSError, ValueError, KeyError) as error:
        return f"{path}: {error!r}"
    return None if (value, nodes) == (0, len(servers)) and capacity >= nodes else f"{path} says {said} of {len(servers)} idle nodes"


def in_panels():
    panels = json.loads((HERE / "grafana/dashboards/tessera.json").read_text())["panels"]
    for panel in panels:
        for target in panel.get("targets", []):
            query = target["expr"].replace("$__rate_interval", "1m").replace("$instance", ".*").replace("$job", "tessera")
            yield panel["title"], query


def main(program):
    with Place() as place:
        shared = place.shared()
        servers = [place.server(program, shared=shared) for _ in range(2)]
        prometheus = Prometheus(place, servers)
        wait_for(lambda: len(prometheus.ask("up == 1")) == len(servers), "Prometheus' first look at the servers")
        work(program, servers[0].endpoint, place.folder)
        wrong, asked = [], 0
        # A stream, a diagram and a kept job, four times each.
        wait_for(lambda: prometheus.ask('sum(tessera_jobs_ended_total{outcome="done"}) >= 12'), "figures of the work")
        for title, query in in_panels():
            asked += 1
            figures = prometheus.ask(query)
            if not any(map(math.isfinite, figures)):
                wrong.append(f"panel {title}: {figures or 'nothing'} for {query}")
        drawn = [sys.executable, HERE / "grafana/preview.py", "--prometheus", prometheus.url, "--minutes", "1", "--check"]
        if subprocess.run(drawn, check=False).returncode:
            wrong.append("preview.py does not draw the dashboard")
        # An overview is some seconds old: the last job may be in it still.
        wait_for(lambda: check_scale(servers) is None, lambda: check_scale(servers))
        selectors = set()
        for group in yaml.safe_load((HERE / "prometheus/alerts.yml").read_text())["groups"]:
            for rule in group["rules"]:
                selectors |= {(rule["alert"], name + (labels or "")) for name, labels in SELECTOR.findall(rule["expr"])}
        scaled = yaml.safe_load((HERE / "kubernetes/components/autoscaling/scaledobject.yaml").read_text())
        for trigger in scaled["spec"]["triggers"]:
            selectors |= {("autoscaling", name + labels) for name, labels in SELECTOR.findall(trigger["metadata"]["query"])}
        for alert, selector in sorted(selectors):
            asked += 1
            bare = selector.split("{")[0] if RARE.search(selector) else selector
            if not prometheus.ask(f"count({bare})"):
                wrong.append(f"{alert}: there is no {selector}")
        for rule in prometheus.rules():
            if rule["health"] != "ok":
                wrong.append(f"{rule['name']}: {rule.get('lastError')}")
            if rule["state"] != "inactive":
                wrong.append(f"{rule['name']} is {rule['state']}, though the server works")
    if wrong:
        sys.exit("\n".join(wrong))
    print(f"{asked} queries have figures, {len(selectors)} of them of alerts; no alert is raised")


if __name__ == "__main__":
    main(sys.argv[1])
