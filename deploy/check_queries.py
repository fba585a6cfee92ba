"""Asks every query of the dashboard and every alert of a real Prometheus that watches a server at work.

usage: check_queries.py PROGRAM

Every query has to be understood, and every metric that it names has to exist. Queries without a result are listed: they are
those about things that have not happened.
"""

import json
import pathlib
import re
import socket
import subprocess
import sys
import tempfile
import time
import urllib.parse
import urllib.request

import yaml

HERE = pathlib.Path(__file__).parent
# Of things that a healthy server does not do.
RARE = re.compile(r"INTERNAL|> 0$|> 0\.\d+$|== 1$|== 0$|> 120$")


def free_port():
    with socket.socket() as place:
        place.bind(("127.0.0.1", 0))
        return place.getsockname()[1]


def get(url):
    with urllib.request.urlopen(url, timeout=10) as answer:
        return answer.read().decode()


def expressions():
    panels = json.loads((HERE / "grafana/dashboards/tessera.json").read_text())["panels"]
    for panel in panels:
        for target in panel.get("targets", []):
            yield f"dashboard: {panel['title']}", target["expr"]
    for group in yaml.safe_load((HERE / "prometheus/alerts.yml").read_text())["groups"]:
        for rule in group["rules"]:
            yield f"alert: {rule['alert']}", rule["expr"]


def main(program):
    children, folder = [], pathlib.Path(tempfile.mkdtemp())
    try:
        server = subprocess.Popen(
            [program, "serve", "--listen", "127.0.0.1:0", "--admin-listen", "127.0.0.1:0", "--ephemeral", "--backend", "parallel"],
            stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True,
        )
        children.append(server)
        endpoint = "http://" + server.stdout.readline().rsplit(" ", 1)[1].strip()
        admin = server.stdout.readline().rsplit(" ", 1)[1].strip()
        # The file that is shipped, with this server as its target and shorter pauses.
        config = yaml.safe_load((HERE / "prometheus/prometheus.yml").read_text())
        config["global"] = {"scrape_interval": "1s", "evaluation_interval": "1s"}
        config["rule_files"] = [str((HERE / "prometheus/alerts.yml").resolve())]
        config["scrape_configs"][0]["static_configs"][0]["targets"] = [admin]
        (folder / "prometheus.yml").write_text(yaml.safe_dump(config))
        port = free_port()
        children.append(subprocess.Popen(
            ["prometheus", f"--config.file={folder}/prometheus.yml", f"--storage.tsdb.path={folder}/data",
             f"--web.listen-address=127.0.0.1:{port}"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        ))
        mesh = folder / "torus.ply"
        subprocess.run([program, "shape", "torus", "--facets", "2000", "-o", mesh], check=True, capture_output=True)

        def work(*words):
            subprocess.run([program, *words, "--endpoint", endpoint, "--quiet"], check=True, capture_output=True)

        for _ in range(4):
            work("remesh", str(mesh), "--points", "200", "-o", str(folder / "out.ply"), "--overwrite")
            work("jobs", "submit", "remesh", str(mesh), "--points", "200")
            time.sleep(1)
        time.sleep(3)
        metrics = set(re.findall(r"^([a-z_]+)(?:\{| )", get(f"http://{admin}/metrics"), re.M))
        empty = 0
        for name, text in expressions():
            query = text.replace("$__rate_interval", "10s").replace("$instance", ".*")
            query = re.sub(r"\[\d+[mh]\]", "[10s]", query)
            for metric in set(re.findall(r"\b(?:tessera|process|rpc)_[a-z_]+", query)):
                assert metric in metrics, f"{name}: there is no {metric}"
            url = f"http://127.0.0.1:{port}/api/v1/query?" + urllib.parse.urlencode({"query": query})
            found = json.loads(get(url))
            assert found["status"] == "success", f"{name}: {found}"
            if not found["data"]["result"]:
                empty += 1
                assert RARE.search(text), f"{name}: no result for {query}"
        rules = json.loads(get(f"http://127.0.0.1:{port}/api/v1/rules"))["data"]["groups"][0]["rules"]
        assert all(rule["health"] == "ok" for rule in rules), rules
        firing = [rule["name"] for rule in rules if rule["state"] != "inactive"]
        assert not firing, f"alerts of a healthy server: {firing}"
        print(f"queries: {len(list(expressions()))} asked, {empty} about things that did not happen")
    finally:
        for child in children:
            child.terminate()
        for child in children:
            child.wait(20)


if __name__ == "__main__":
    main(sys.argv[1])
