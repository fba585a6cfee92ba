#!/usr/bin/env python3
"""Writes the dashboard of Tessera, `dashboards/tessera.json`, from the panels below.

Usage: dashboard.py          writes the file
       dashboard.py --check  fails if the file is not what would be written

Grafana's own JSON has 50 lines a panel. Change the panels here, not there. `deploy/check_queries.py` runs every query against a
real Prometheus.
"""

import json
import sys
from pathlib import Path

FILE = Path(__file__).parent / "dashboards" / "tessera.json"
SOURCE = {"type": "prometheus", "uid": "${datasource}"}
# The servers that are chosen at the top.
ON = 'job="$job", instance=~"$instance"'
RATE = "$__rate_interval"


def panel(title, kind, width, targets, *, unit="short", help="", stack=False, most=None, height=8, **options):
    """`targets` are (legend, query) pairs; the width is of 24."""
    custom = {"fillOpacity": 30 if stack else 8, "lineWidth": 1, "showPoints": "never", "spanNulls": False}
    if stack:
        custom["stacking"] = {"mode": "normal", "group": "A"}
    defaults = {"unit": unit, "min": 0, "custom": custom if kind == "timeseries" else {}}
    if most is not None:
        defaults["max"] = most
    defaults |= options.pop("defaults", {})
    return {
        "title": title,
        "description": help,
        "type": kind,
        "datasource": SOURCE,
        "size": (width, height),
        "fieldConfig": {"defaults": defaults, "overrides": []},
        "options": {"tooltip": {"mode": "multi", "sort": "desc"}, "legend": {"displayMode": "list", "placement": "bottom"}}
        if kind == "timeseries"
        else options.pop("options", {}),
        "targets": [
            {"refId": chr(ord("A") + i), "datasource": SOURCE, "expr": query, "legendFormat": legend}
            | options.get("target", {})
            for i, (legend, query) in enumerate(targets)
        ],
    }


def lines(title, width, targets, **options):
    return panel(title, "timeseries", width, targets, **options)


def number(title, width, query, *, colours=None, **options):
    thresholds = {"mode": "absolute", "steps": colours or [{"color": "text", "value": None}]}
    shown = {"reduceOptions": {"calcs": ["lastNotNull"]}, "colorMode": "value", "graphMode": "none", "textMode": "value"}
    defaults = {"thresholds": thresholds} | options.pop("defaults", {})
    return panel(title, "stat", width, [("", query)], height=4, options=shown, defaults=defaults, **options)


def quantiles(metric, by, part):
    return f"histogram_quantile({part}, sum by ({by}, le) (rate({metric}_bucket{{{ON}}}[{RATE}])))"


def by_method(query):
    """`JobService/GetJob` for `tessera.v1.JobService/GetJob`: so the legend has room beside the chart."""
    return f'label_replace({query}, "rpc_method", "$1", "rpc_method", "tessera.v1.(.*)")'


def of_cluster(metric, by):
    """All nodes say the same, some a little later than others."""
    return f"max by ({by}) ({metric}{{{ON}}})"


def by_node(query):
    """By the names of nodes. The series of one that started anew with the same name goes on."""
    return f"sum by (node) ({query} * on (job, instance) group_left (node) max by (job, instance, node) (tessera_node_info{{{ON}}}))"


GOOD_AT_0 = [{"color": "green", "value": None}, {"color": "red", "value": 1}]

ROWS = [
    ("Now", [
        number("Servers", 3, f"count(up{{{ON}}} == 1)", help="Servers that answer Prometheus."),
        number("Not ready", 3, f"sum(max by (instance) (tessera_not_ready{{{ON}}}))", colours=GOOD_AT_0,
               help="Servers whose health is NOT_SERVING."),
        number("Jobs at work", 3, f'sum(tessera_jobs{{{ON}, state="running"}})'),
        number("Jobs that wait", 3, f'sum(tessera_jobs{{{ON}, state="waiting"}})'),
        number("Jobs done, per minute", 3,
               f'60 * sum(rate(tessera_jobs_ended_total{{{ON}, outcome="done"}}[{RATE}]))', defaults={"decimals": 1}),
        number("Refused, per minute", 3, f"60 * sum(rate(tessera_refusals_total{{{ON}}}[{RATE}]))",
               colours=[{"color": "green", "value": None}, {"color": "orange", "value": 0.1}], defaults={"decimals": 1}),
        number("GPU busy", 3, f"avg(rate(tessera_device_busy_seconds_total{{{ON}}}[{RATE}]))", unit="percentunit",
               help="0 without a GPU."),
        number("Shortest uptime", 3, f"time() - max(process_start_time_seconds{{{ON}}})", unit="s"),
    ]),
    ("Jobs", [
        lines("Jobs that ended", 8,
              [("{{outcome}}", f"sum by (outcome) (rate(tessera_jobs_ended_total{{{ON}}}[{RATE}]))")],
              unit="ops", stack=True, help="A second, by how they ended."),
        lines("Jobs in the server", 8, [("{{state}} {{kind}}", f"sum by (state, kind) (tessera_jobs{{{ON}}})")],
              stack=True),
        lines("Time in the queue", 8,
              [("median", quantiles("tessera_queue_seconds", "job", 0.5)),
               ("95 %", quantiles("tessera_queue_seconds", "job", 0.95)),
               ("mean", f"sum(rate(tessera_queue_seconds_sum{{{ON}}}[{RATE}]))"
                        f" / sum(rate(tessera_queue_seconds_count{{{ON}}}[{RATE}]))")],
              unit="s", help="Of jobs that began in the interval."),
        lines("Work by stage", 8,
              [("{{stage}}", f"sum by (stage) (rate(tessera_stage_seconds_sum{{{ON}}}[{RATE}]))")],
              unit="s", stack=True, help="Seconds of work a second: 2 means that two jobs were at work all the time."),
        lines("Mean time of a stage", 8,
              [("{{stage}}", f"sum by (stage) (rate(tessera_stage_seconds_sum{{{ON}}}[{RATE}]))"
                             f" / sum by (stage) (rate(tessera_stage_seconds_count{{{ON}}}[{RATE}]))")], unit="s"),
        lines("Facets and seeds of jobs done", 8,
              [("facets", f"sum(rate(tessera_facets_total{{{ON}}}[{RATE}]))"),
               ("seeds", f"sum(rate(tessera_seeds_total{{{ON}}}[{RATE}]))")], unit="ops", help="A second."),
    ]),
    ("Device", [
        lines("GPU busy", 8,
              [("{{instance}}", f"sum by (instance) (rate(tessera_device_busy_seconds_total{{{ON}}}[{RATE}]))")],
              unit="percentunit", most=1, help="Part of the time that the GPU worked. 0 without a GPU."),
        lines("GPU memory", 8, [("{{kind}} {{instance}}", f"sum by (kind, instance) (tessera_device_bytes{{{ON}}})")],
              unit="bytes", help="Planned by open sessions, and allocated as the driver says. 0 without a GPU."),
        lines("Passes and iterations", 8,
              [("passes, {{backend}}", f"sum by (backend) (rate(tessera_passes_total{{{ON}}}[{RATE}]))"),
               ("iterations", f"sum(rate(tessera_iterations_total{{{ON}}}[{RATE}]))")], unit="ops", help="A second."),
    ]),
    ("Calls", [
        lines("Calls by method", 8,
              [("{{rpc_method}}",
                by_method(f"sum by (rpc_method) (rate(rpc_server_call_duration_seconds_count{{{ON}}}[{RATE}]))"))],
              unit="reqps", stack=True),
        lines("Calls by status", 8,
              [("{{rpc_response_status_code}}", "sum by (rpc_response_status_code) "
                f"(rate(rpc_server_call_duration_seconds_count{{{ON}}}[{RATE}]))")], unit="reqps", stack=True),
        lines("Latency by method, 95 %", 8,
              [("{{rpc_method}}", by_method(quantiles("rpc_server_call_duration_seconds", "rpc_method", 0.95)))],
              unit="s", help="To the end of the answer. A stream lasts as long as its job."),
        lines("Latency by method, mean", 8,
              [("{{rpc_method}}",
                by_method(f"sum by (rpc_method) (rate(rpc_server_call_duration_seconds_sum{{{ON}}}[{RATE}]))"
                          f" / sum by (rpc_method) (rate(rpc_server_call_duration_seconds_count{{{ON}}}[{RATE}]))"))], unit="s"),
        lines("Open calls", 8, [("{{rpc_method}}", by_method(f"sum by (rpc_method) (tessera_open_streams{{{ON}}})"))], stack=True),
        lines("Open connections", 8,
              [("{{instance}}", f"sum by (instance) (tessera_open_connections{{{ON}}})")], stack=True),
    ]),
    ("Refusals and health", [
        lines("Refusals", 8, [("{{reason}}", f"sum by (reason) (rate(tessera_refusals_total{{{ON}}}[{RATE}]))")],
              unit="ops", stack=True, help="A second, by what was missing."),
        lines("Servers that are not ready or degraded", 8,
              [("{{reason}}", f"sum by (reason) (tessera_not_ready{{{ON}}})"),
               ("degraded: {{reason}}", f"sum by (reason) (tessera_degraded{{{ON}}})")],
              stack=True, help="By reason; a server may have several."),
        lines("Probes and lost devices", 8,
              [("probes {{outcome}}", f"sum by (outcome) (increase(tessera_probes_total{{{ON}}}[{RATE}]))"),
               ("devices lost", f"sum(increase(tessera_device_losses_total{{{ON}}}[{RATE}]))")],
              help="Probes run while nothing else does."),
    ]),
    ("Storage and memory", [
        lines("Blobs", 8, [("{{kind}} {{instance}}", f"sum by (kind, instance) (tessera_blob_bytes{{{ON}}})")],
              unit="bytes", help="Kept, and the limit --blobs-mib."),
        lines("Uploads and answers that wait", 8,
              [("{{kind}} {{instance}}", f"sum by (kind, instance) (tessera_memory_bytes{{{ON}}})")],
              unit="bytes", help="Used, and the limit --memory-mib."),
        lines("Resident memory", 8,
              [("{{instance}}", f"sum by (instance) (process_resident_memory_bytes{{{ON}}})")], unit="bytes"),
        lines("Processors", 8,
              [("{{instance}}", f"sum by (instance) (rate(process_cpu_seconds_total{{{ON}}}[{RATE}]))")],
              help="How many are busy with the server."),
        lines("File descriptors", 8,
              [("{{instance}}", f"sum by (instance) (process_open_fds{{{ON}}})"
                                f" / sum by (instance) (process_max_fds{{{ON}}})")], unit="percentunit", most=1),
        lines("Threads", 8, [("{{instance}}", f"sum by (instance) (process_threads{{{ON}}})")]),
        lines("Steps of the start", 12, [("{{step}}", f"max by (step) (tessera_step_seconds{{{ON}}})")], unit="s",
              help="Of the slowest server. Steps of the shutdown show while a server drains."),
        panel("Versions", "table", 12,
              [("", f"max by (instance, version, revision) (tessera_build_info{{{ON}}})")], height=8,
              target={"format": "table", "instant": True},
              options={"showHeader": True}),
    ]),
    # Empty for servers that share no database.
    ("Cluster", [
        lines("Nodes", 8, [("{{state}}", of_cluster("tessera_cluster_nodes", "state"))], stack=True,
              help="Servers that share the database, as it knows them. Those that drain take no new jobs."),
        lines("Jobs in the cluster", 8,
              [("{{state}}", of_cluster("tessera_cluster_jobs", "state")),
               ("capacity", of_cluster("tessera_cluster_capacity", "job"))],
              help="All nodes together. Capacity: jobs that can run at once."),
        lines("Oldest job in the queue", 8, [("oldest", of_cluster("tessera_cluster_oldest_queued_seconds", "job"))], unit="s",
              help="How long it has waited. Beside free capacity it fits no node, or no node takes jobs."),
        lines("Jobs at work by node", 12,
              [("{{node}}", by_node(f'sum by (job, instance) (tessera_jobs{{{ON}, state="running"}})'))], stack=True),
        lines("Jobs done by node", 12,
              [("{{node}}", by_node(f'sum by (job, instance) (rate(tessera_jobs_ended_total{{{ON}, outcome="done"}}[{RATE}]))'))],
              unit="ops", stack=True, help="A second."),
    ]),
]


def variable(name, label, query):
    return {
        "name": name,
        "label": label,
        "type": "query",
        "datasource": SOURCE,
        "query": {"query": query, "refId": name},
        "definition": query,
        "refresh": 2,
        "sort": 1,
        "multi": name == "instance",
        "includeAll": name == "instance",
        "current": {"selected": True, "text": "All", "value": "$__all"} if name == "instance" else {},
    }


def dashboard():
    panels, y = [], 0
    for title, row in ROWS:
        panels.append({"type": "row", "title": title, "collapsed": False, "panels": [], "id": len(panels) + 1,
                       "gridPos": {"x": 0, "y": y, "w": 24, "h": 1}})
        y, x = y + 1, 0
        for made in row:
            width, height = made["size"]
            if x + width > 24:
                x, y = 0, y + height
            panels.append({"id": len(panels) + 1, "gridPos": {"x": x, "y": y, "w": width, "h": height}}
                          | {key: value for key, value in made.items() if key != "size"})
            x += width
        y += height
    return {
        "uid": "tessera",
        "title": "Tessera",
        "description": "Jobs, device, calls and health of Tessera servers",
        "tags": ["tessera"],
        "schemaVersion": 39,
        "editable": True,
        "graphTooltip": 1,
        "refresh": "15s",
        "time": {"from": "now-1h", "to": "now"},
        "templating": {"list": [
            {"name": "datasource", "label": "Source", "type": "datasource", "query": "prometheus", "current": {}},
            variable("job", "Job", "label_values(tessera_build_info, job)"),
            variable("instance", "Server", 'label_values(tessera_build_info{job="$job"}, instance)'),
        ]},
        "annotations": {"list": [{
            "name": "Restarts", "enable": True, "iconColor": "orange", "datasource": SOURCE,
            "expr": f"resets(process_cpu_seconds_total{{{ON}}}[1m]) > 0", "titleFormat": "{{instance}} was started",
        }]},
        "panels": panels,
    }


def main():
    text = json.dumps(dashboard(), indent=1) + "\n"
    if sys.argv[1:] == ["--check"]:
        if not FILE.exists() or FILE.read_text(encoding="utf-8") != text:
            sys.exit(f"{FILE} is not what dashboard.py writes; run it")
    else:
        FILE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
