#!/usr/bin/env python3
"""Draws the README's picture from tessera's own output (needs numpy, matplotlib).

usage: cells.py TESSERA MESH POINTS OUT.png
The cells of random seeds, after 1 and after 100 Lloyd steps (each step: `tessera rvd --centroids`,
fed back as seeds), and the remesh of the last seeds' surface.
"""
import colorsys, pathlib, subprocess, sys, tempfile
import numpy as np
import matplotlib
matplotlib.use("Agg")
import matplotlib.pyplot as plt
from matplotlib.collections import PolyCollection


def read_ply(path):
    """Polygons as arrays of points, and the seed of each (or None), of a PLY as tessera writes it."""
    data = pathlib.Path(path).read_bytes()
    head, body = data.split(b"end_header\n", 1)
    lines = head.decode().split("\n")
    count = {l.split()[1]: int(l.split()[2]) for l in lines if l.startswith("element")}
    points = np.frombuffer(body, "<f8", 3 * count["vertex"]).reshape(-1, 3)
    cells = any("seed" in l for l in lines)
    extra = [("seed", "<i4"), ("facet", "<i4"), ("rgb", "u1", 3)] if cells else []
    at, polygons, seeds = 24 * count["vertex"], [], []
    for _ in range(count["face"]):
        n = body[at]
        at += 1
        row = np.frombuffer(body, np.dtype([("v", "<i4", n)] + extra), 1, at)[0]
        at += row.dtype.itemsize
        polygons.append(points[row["v"]])
        seeds.append(int(row["seed"]) if extra else -1)
    return polygons, seeds


def draw(axes, polygons, colours, edges, title):
    # Bunny-like models have y up; look a little from above and from the side.
    yaw, pitch = np.radians(-20), np.radians(15)
    turn = np.array([[np.cos(yaw), 0, np.sin(yaw)], [0, 1, 0], [-np.sin(yaw), 0, np.cos(yaw)]])
    tilt = np.array([[1, 0, 0], [0, np.cos(pitch), -np.sin(pitch)], [0, np.sin(pitch), np.cos(pitch)]])
    view, light = tilt @ turn, np.array([0.3, 0.6, 0.75])
    light = light / np.linalg.norm(light)
    shown = []
    for polygon, colour in zip(polygons, colours):
        p = polygon @ view.T
        normal = sum(np.cross(p[k] - p[0], p[k + 1] - p[0]) for k in range(1, len(p) - 1))
        length = np.linalg.norm(normal)
        if length > 0 and normal[2] > 0:
            shade = 0.35 + 0.65 * max(0.0, normal @ light / length)
            shown.append((p[:, 2].mean(), p[:, :2], np.clip(np.array(colour) * shade, 0, 1)))
    shown.sort(key=lambda s: s[0])
    faces = [s[2] for s in shown]
    axes.add_collection(PolyCollection([s[1] for s in shown], facecolors=faces, linewidths=0.25,
                                       edgecolors="#303030" if edges else faces))
    axes.set_aspect("equal")
    axes.autoscale()
    axes.axis("off")
    axes.set_title(title, fontsize=11, y=-0.04)


def main():
    tessera, mesh, points, out = sys.argv[1:5]
    rng = np.random.default_rng(4)
    palette = [colorsys.hsv_to_rgb(h, s, v) for h, s, v in
               zip(rng.random(int(points)), 0.35 + 0.4 * rng.random(int(points)), 0.75 + 0.25 * rng.random(int(points)))]
    with tempfile.TemporaryDirectory() as folder, plt.rc_context({"savefig.facecolor": "white"}):
        run = lambda *a: subprocess.run([tessera, *a], check=True, capture_output=True)
        cells, seeds, remesh = f"{folder}/cells.ply", f"{folder}/seeds.xyz", f"{folder}/remesh.ply"
        figure, panels = plt.subplots(1, 4, figsize=(13, 3.5))
        for step in range(101):
            start = ["--seeds", seeds] if step else ["--points", points]
            wanted = ["-o", cells] if step in (0, 1, 100) else []
            run("rvd", mesh, *start, "--centroids", f"{folder}/next.xyz", "--backend", "parallel", *wanted)
            if wanted:
                polygons, owner = read_ply(cells)
                title = "random seeds" if step == 0 else f"{step} Lloyd step" + "s" * (step > 1)
                draw(panels[(0, 1, 100).index(step)], polygons, [palette[i] for i in owner], False, title)
            pathlib.Path(f"{folder}/next.xyz").rename(seeds)
        run("remesh", mesh, "--points", points, "--lloyd", "100", "-o", remesh, "--backend", "parallel")
        polygons, _ = read_ply(remesh)
        draw(panels[3], polygons, [(0.80, 0.84, 0.90)] * len(polygons), True, "remesh")
        figure.subplots_adjust(0.0, 0.06, 1.0, 1.0, 0.0, 0.0)
        figure.savefig(out, dpi=110)


main()
