#!/usr/bin/env python3
"""Draws the dashboard as a page of HTML, from its file and from figures of a Prometheus. Chromium makes a picture of the page.

This is not Grafana. It reads `dashboards/tessera.json` and draws what is used there: layout, titles, units, legends, stacks and
thresholds. So a change of the dashboard can be seen, and shown, where there is no Grafana. It needs Python alone.
"""

import argparse
import html
import itertools
import json
import math
import pathlib
import re
import shutil
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.parse
import urllib.request

FILE = pathlib.Path(__file__).parent / "dashboards" / "tessera.json"
WIDTH, CELL, GAP = 1600, 38, 8  # pixels: of the page, of a row of Grafana's grid, and between panels
TITLE, LEGEND, LETTER = 34, 18, 6.3  # pixels: heights of a title and of a line of a legend, width of a letter
PALETTE = "#73bf69 #f2cc0c #8ab8ff #ff780a #f2495c #3f7de8 #b877d9 #4fc8c2 #b7a17a #ff9ecb #37872d #a8e05f #c15c17 #d8d9da".split()
COLOURS = {"text": "#e6e7ea", "green": "#73bf69", "orange": "#ff9830", "red": "#f2495c"}
# What Grafana shows for its units: factors with their names, and what follows.
COUNT = [(1, ""), (1e3, " K"), (1e6, " M"), (1e9, " G")]
UNITS = {
    "short": (COUNT, ""),
    "ops": (COUNT, " ops/s"),
    "reqps": (COUNT, " req/s"),
    "percentunit": ([(0.01, "%")], ""),
    "bytes": ([(1, " B"), (2**10, " KiB"), (2**20, " MiB"), (2**30, " GiB"), (2**40, " TiB")], ""),
    "s": ([(1e-6, " µs"), (1e-3, " ms"), (1, " s"), (60, " min"), (3600, " h"), (86400, " d")], ""),
}
STYLE = f"""
body {{ margin: 0; width: {WIDTH}px; background: #111217; color: #ccccdc; font: 13px Inter, Roboto, Arial, sans-serif }}
header {{ position: absolute; left: 16px; right: 16px; top: 14px; display: flex; gap: 24px; font-size: 14px; color: #9fa1a8 }}
header b {{ flex: 1; font-size: 18px; color: #e6e7ea }}
h2, section {{ position: absolute; box-sizing: border-box; margin: 0; overflow: hidden }}
h2 {{ font-size: 16px; line-height: {CELL - GAP}px; font-weight: 600; color: #e6e7ea }}
section {{ background: #181b1f; border: 1px solid #2a2d34; border-radius: 3px }}
h3 {{ margin: 0 10px; font-size: 14px; font-weight: 600; line-height: {TITLE}px; white-space: nowrap }}
svg {{ display: block }} svg text {{ fill: #a4a6ad; font-size: 12px }}
ul {{ margin: 0 10px; padding: 0; display: flex; flex-wrap: wrap; list-style: none }}
li {{ white-space: nowrap; font-size: 12px; line-height: {LEGEND}px }}
i {{ display: inline-block; width: 14px; height: 4px; margin: 0 6px 2px 0; border-radius: 2px }}
p {{ margin: 0; text-align: center; font-weight: 600; white-space: nowrap }}
table {{ margin: 0 10px; border-collapse: collapse }} th, td {{ padding: 6px 40px 6px 0; text-align: left }}
"""


class Prometheus:
    def __init__(self, url, seconds, end, variables):
        self.url = url.rstrip("/")
        self.end = end
        watched = [target for target in self.get("targets")["activeTargets"] if target["labels"]["job"] == variables["job"]]
        if not watched:
            sys.exit(f"the Prometheus at {self.url} watches no job {variables['job']}")
        scrape = max(seconds_of(target["scrapeInterval"]) for target in watched)
        # As Grafana does: about a point for each pixel, but none between two looks, and four looks at least for a rate.
        self.step = max(scrape, math.ceil(seconds / 480))
        self.times = [end - seconds + at * self.step for at in range(int(seconds / self.step) + 1)]
        self.variables = variables | {"__rate_interval": f"{math.ceil(max(self.step + scrape, 4 * scrape))}s"}

    def get(self, what, **arguments):
        try:
            with urllib.request.urlopen(f"{self.url}/api/v1/{what}?{urllib.parse.urlencode(arguments)}", timeout=30) as answer:
                return json.load(answer)["data"]
        except urllib.error.HTTPError as error:
            sys.exit(f"{self.url} refuses {arguments.get('query', what)}: {error} {error.read().decode(errors='replace')}")
        except (OSError, ValueError, KeyError) as error:
            sys.exit(f"no Prometheus answers at {self.url}: {error}")

    def ask(self, target, what, **arguments):
        """The series of a query: their names, labels and answers."""
        query = re.sub(r"\$([a-z_]+)", lambda found: self.variables[found[1]], target["expr"])
        for series in self.get(what, query=query, **arguments)["result"]:
            name = target["legendFormat"]
            for label, value in series["metric"].items():
                name = name.replace("{{" + label + "}}", value)
            yield name, series["metric"], series

    def now(self, target):
        return [(labels, float(series["value"][1])) for _, labels, series in self.ask(target, "query", time=self.end)]

    def lines(self, target):
        """Names with a value, or None, for each of `times`."""
        span = {"start": self.times[0], "end": self.times[-1], "step": self.step}
        for name, _, series in self.ask(target, "query_range", **span):
            there = {round((at - self.times[0]) / self.step): float(value) for at, value in series["values"]}
            yield name, [there[at] if math.isfinite(there.get(at, math.nan)) else None for at in range(len(self.times))]


def seconds_of(text):
    parts = re.findall(r"(\d+)(ms|[smhd])", text)
    return sum(int(number) * {"ms": 1e-3, "s": 1, "m": 60, "h": 3600, "d": 86400}[unit] for number, unit in parts)


def scale(unit, figure):
    """The factor and the words that fit a figure."""
    factors, follows = UNITS[unit]
    fits = [entry for entry in factors if entry[0] <= (figure or 1)]
    factor, name = fits[-1] if fits else factors[0]
    return factor, name + follows


def shown(figure, unit, decimals=None):
    factor, words = scale(unit, figure)
    return f"{figure / factor:{'.3g' if decimals is None else f'.{decimals}f'}}{words}"


def ticks(unit, largest):
    """Round figures from 0 to the first beyond the largest one, with their labels."""
    factor, words = scale(unit, largest)
    top = largest / factor or 1
    rough = top / 4.5
    if unit == "bytes":
        step = 2.0 ** math.ceil(math.log2(rough))
    else:
        power = 10.0 ** math.floor(math.log10(rough))
        step = next(power * part for part in (1, 2, 2.5, 5, 10) if power * part >= rough * 0.999)
    decimals = next(digits for digits in range(9) if math.isclose(round(step, digits), step, rel_tol=1e-6))
    above = [(at * step * factor, f"{at * step:.{decimals}f}{words}") for at in range(1, math.ceil(top / step * 0.999) + 1)]
    return [(0, shown(0, unit)), *above]


def chart(panel, prometheus, width, height):
    series = [line for target in panel["targets"] for line in prometheus.lines(target)]
    if not any(value is not None for _, values in series for value in values):
        return None
    defaults = panel["fieldConfig"]["defaults"]
    stacked = "stacking" in defaults["custom"]
    # Lines with what each stands on.
    drawn, base = [], [0.0] * len(prometheus.times)
    for _, values in series:
        floor = base
        if stacked:
            base = [below + (value or 0) for below, value in zip(floor, values)]
            values = [None if value is None else above for value, above in zip(values, base)]
        drawn.append((values, floor))
    largest = defaults.get("max", max(value for values, _ in drawn for value in values if value is not None))
    labels = ticks(defaults["unit"], largest)

    legend, lines, used = [], 1, 0
    for (name, _), colour in zip(series, itertools.cycle(PALETTE)):
        wanted = round(len(name) * LETTER + sum(map(str.isupper, name)) * 2 + 32)
        lines, used = (lines + 1, wanted) if used and used + wanted > width - 20 else (lines, used + wanted)
        legend.append(f'<li style="width:{wanted}px"><i style="background:{colour}"></i>{html.escape(name)}</li>')
    left = 22 + max(len(text) for _, text in labels) * LETTER
    right, low = width - 14, height - TITLE - lines * LEGEND - 6 - 26
    begin, end = prometheus.times[0], prometheus.times[-1]

    def x(at):
        return left + (at - begin) / (end - begin) * (right - left)

    def y(value):
        return low - value / labels[-1][0] * (low - 8)

    said = []
    for value, text in labels:
        said.append(f'<path d="M{left:.0f} {y(value):.1f}H{right}" stroke="#2b2e35"/>')
        said.append(f'<text x="{left - 8:.0f}" y="{y(value) + 4:.1f}" text-anchor="end">{text}</text>')
    steps = (15, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 14400)
    every = next((step for step in steps if step * 6 > end - begin), 86400)
    for at in range(math.ceil(begin / every) * every, math.floor(end) + 1, every):
        text = time.strftime("%H:%M" if every >= 60 else "%H:%M:%S", time.localtime(at))
        said.append(f'<path d="M{x(at):.1f} 8V{low}" stroke="#23262c"/>')
        if x(at) < right - 16:
            said.append(f'<text x="{x(at):.1f}" y="{low + 19}" text-anchor="middle">{text}</text>')
    for (values, floor), colour in reversed(list(zip(drawn, itertools.cycle(PALETTE)))):
        # A line is interrupted where there is no figure. What stands alone becomes a point.
        for there, run in itertools.groupby(zip(prometheus.times, values, floor), lambda point: point[1] is not None):
            if there:
                run = list(run)
                over = "L".join(f"{x(at):.1f} {y(value):.1f}" for at, value, _ in run)
                under = "L".join(f"{x(at):.1f} {y(bottom):.1f}" for at, _, bottom in reversed(run))
                said.append(f'<path d="M{over}L{under}" fill="{colour}" opacity="{defaults["custom"]["fillOpacity"] / 100}"/>')
                said.append(f'<path d="M{over}h0" fill="none" stroke="{colour}" stroke-width="1.6" stroke-linecap="round"/>')
    return f'<svg width="{width}" height="{low + 26}">{"".join(said)}</svg><ul>{"".join(legend)}</ul>'


def stat(panel, prometheus, _, height):
    figures = [figure for target in panel["targets"] for _, figure in prometheus.now(target) if math.isfinite(figure)]
    if not figures:
        return None
    defaults = panel["fieldConfig"]["defaults"]
    reached = [step["color"] for step in defaults["thresholds"]["steps"] if step["value"] is None or figures[0] >= step["value"]]
    text = shown(figures[0], defaults["unit"], defaults.get("decimals"))
    look = f"font-size:36px;line-height:{height - TITLE - 16}px;color:{COLOURS[reached[-1]]}"
    return f'<p style="{look}">{text}</p>'


def table(panel, prometheus, *_):
    rows = [labels | {"Value": f"{figure:g}"} for target in panel["targets"] for labels, figure in prometheus.now(target)]
    if not rows:
        return None
    names = list(rows[0])
    cells = ["".join(f"<td>{html.escape(row.get(name, ''))}</td>" for name in names) for row in rows]
    return f"<table><tr><th>{'<th>'.join(map(html.escape, names))}</tr><tr>{'</tr><tr>'.join(cells)}</tr></table>"


KINDS = {"timeseries": chart, "stat": stat, "table": table}


def page(dashboard, rows, prometheus):
    """The page, its height, and the titles of panels that have no figures."""
    said, empty, top, bottom, chosen = [], [], 0, 52, False
    for panel in dashboard["panels"]:
        place = panel["gridPos"]
        if panel["type"] == "row":
            chosen = not rows or panel["title"] in rows
            top = bottom - place["y"] * CELL
        if not chosen:
            continue
        across = (WIDTH - 2 * GAP) / 24
        left, width = GAP + place["x"] * across, place["w"] * across
        box = f"left:{left + GAP / 2:.0f}px;top:{top + place['y'] * CELL}px;"
        box += f"width:{width - GAP:.0f}px;height:{place['h'] * CELL - GAP}px"
        bottom = max(bottom, top + (place["y"] + place["h"]) * CELL)
        title = html.escape(panel["title"])
        if panel["type"] == "row":
            said.append(f'<h2 style="{box}">{title}</h2>')
            continue
        for what, known in ((panel["type"], KINDS), (panel["fieldConfig"]["defaults"]["unit"], UNITS)):
            if what not in known:
                sys.exit(f"the panel {panel['title']} has {what}, which preview.py cannot draw yet: it draws {', '.join(known)}")
        inside = KINDS[panel["type"]](panel, prometheus, round(width - GAP - 2), place["h"] * CELL - GAP - 2)
        if inside is None:
            empty.append(panel["title"])
        inside = inside or '<p style="padding-top:30px;color:#9fa1a8">No data</p>'
        said.append(f'<section style="{box}" title="{html.escape(panel["description"])}"><h3>{title}</h3>{inside}</section>')
    begin, end = (time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(at)) for at in (prometheus.times[0], prometheus.end))
    variables = prometheus.variables
    name, servers = html.escape(dashboard["title"]), html.escape(variables["instance"].replace(".*", "all"))
    head = f"<b>{name}</b><span>Job: {html.escape(variables['job'])}</span><span>Servers: {servers}</span>"
    head += f"<span>{begin} to {end[11:]}</span>"
    text = f'<!doctype html><meta charset="utf-8"><title>{name}</title><style>{STYLE}</style><header>{head}</header>'
    return f"{text}{''.join(said)}\n", bottom + GAP, empty


def picture(chromium, text, height, file):
    """Chromium's look at the page, in a folder of its own."""
    program = shutil.which(chromium) or sys.exit(f"there is no {chromium}: install Debian's chromium, or name it with --chromium")
    with tempfile.TemporaryDirectory() as folder:
        place = pathlib.Path(folder)
        (place / "page.html").write_text(text, encoding="utf-8")
        quiet = "--no-first-run --disable-background-networking --disable-component-update --disable-sync --disable-quic"
        said = subprocess.run(
            [program, "--headless", "--no-sandbox", "--disable-gpu", *quiet.split(), "--hide-scrollbars",
             f"--user-data-dir={place}/user", f"--window-size={WIDTH},{height}", f"--screenshot={place}/page.png",
             f"file://{place}/page.html"], capture_output=True, text=True, timeout=120, check=False)
        if not (place / "page.png").exists():
            sys.exit(f"{program} made no picture:\n{said.stderr}")
        shutil.copyfile(place / "page.png", file)


def main():
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("--prometheus", metavar="URL", default="http://127.0.0.1:9091", help="whom to ask (%(default)s)")
    words.add_argument("--minutes", type=float, default=60, help="how long ago the charts begin (%(default)s)")
    words.add_argument("--end", metavar="SECONDS", type=float, help="when they end, since 1970; now if not given")
    words.add_argument("--job", default="tessera", help="the job of Prometheus (%(default)s)")
    words.add_argument("--instance", metavar="REGEX", default=".*", help="the servers (all)")
    words.add_argument("--rows", metavar="TITLES", help="draw these rows of the dashboard alone, such as 'Now,Jobs'")
    words.add_argument("--page", metavar="FILE.html", type=pathlib.Path, help="write the page there")
    words.add_argument("--picture", metavar="FILE.png", type=pathlib.Path, help="have Chromium make a picture of it there")
    words.add_argument("--chromium", metavar="PROGRAM", default="chromium", help="the program (%(default)s)")
    words.add_argument("--check", action="store_true", help="fail if a panel has no figures")
    given = words.parse_args()
    if not (given.page or given.picture or given.check):
        words.error("nothing to do: give --page, --picture or --check")
    dashboard = json.loads(FILE.read_text(encoding="utf-8"))
    rows = given.rows.split(",") if given.rows else []
    unknown = set(rows) - {panel["title"] for panel in dashboard["panels"] if panel["type"] == "row"}
    if unknown:
        words.error(f"the dashboard has no row {', '.join(sorted(unknown))}")
    variables = {"job": given.job, "instance": given.instance, "datasource": ""}
    prometheus = Prometheus(given.prometheus, given.minutes * 60, given.end or time.time(), variables)
    text, height, empty = page(dashboard, rows, prometheus)
    if given.page:
        given.page.write_text(text, encoding="utf-8")
    if given.picture:
        picture(given.chromium, text, height, given.picture)
    if given.check and empty:
        sys.exit(f"panels without figures: {', '.join(empty)}")


if __name__ == "__main__":
    main()
