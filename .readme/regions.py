"""Surfaces for the pictures of docs/regions.md, as OBJ files in the present folder.

`regions.py` writes materials.obj, hole.obj, foam.obj and cell.obj. `regions.py copies IN OUT` writes a cell beside itself, twice along each
axis.
"""

import itertools
import math
import sys


class Surface:
    """Vertices by place, and triangles by region."""

    def __init__(self):
        self.numbers, self.vertices, self.facets = {}, [], {}

    def vertex(self, place):
        key = tuple(round(x, 9) for x in place)
        if key not in self.numbers:
            self.vertices.append(place)
            self.numbers[key] = len(self.vertices)
        return self.numbers[key]

    def triangle(self, region, *places):
        corners = [self.vertex(place) for place in places]
        if len(set(corners)) == 3:
            self.facets.setdefault(region, []).append(corners)

    def grid(self, region, place, rows, columns):
        """Triangles between the places of a grid."""
        for i, j in itertools.product(range(*rows), range(columns)):
            a, b, c, d = place(i, j), place(i + 1, j), place(i + 1, j + 1), place(i, j + 1)
            self.triangle(region, a, b, c)
            self.triangle(region, a, c, d)

    def write(self, path):
        lines = ["v %.12g %.12g %.12g" % place for place in self.vertices]
        for region, facets in self.facets.items():
            lines.append(f"usemtl {region}")
            lines += ["f %d %d %d" % tuple(corners) for corners in facets]
        with open(path, "w") as file:
            file.write("\n".join(lines) + "\n")


def materials():
    """A ball of two materials with a wave between them."""
    rows, columns = 40, 96

    def place(i, j):
        around = 2 * math.pi * (j % columns) / columns
        down = math.pi * i / rows
        down += 0.3 * math.sin(4 * around) * math.sin(down) ** 2
        return (math.sin(down) * math.cos(around), math.sin(down) * math.sin(around), math.cos(down))

    surface = Surface()
    surface.grid("steel", place, (0, rows // 2), columns)
    surface.grid("rubber", place, (rows // 2, rows), columns)
    surface.write("materials.obj")


def hole():
    """A plate with a hole, and a ring of fine facets around it."""
    columns = 40

    def place(i, j):
        around = 2 * math.pi * (j % columns) / columns
        x, y = math.cos(around), math.sin(around)
        square = 1 / max(abs(x), abs(y))
        radius = 0.3 + 0.06 * i / 2 if i <= 2 else 0.36 + (square - 0.36) * (i - 2) / 14
        return (radius * x, radius * y, 0.25 * math.sin(1.5 * radius * x))

    surface = Surface()
    surface.grid("ring", place, (0, 2), columns)
    surface.grid("plate", place, (2, 16), columns)
    surface.write("hole.obj")


def foam():
    """Cells of a foam: truncated octahedra that fill space, five of them."""
    corners = {
        tuple(sign * x for sign, x in zip(signs, order))
        for order in itertools.permutations((0, 1, 2))
        for signs in itertools.product((-1, 1), repeat=3)
    }
    squares = [tuple(2 * s if k == axis else 0 for k in range(3)) for axis in range(3) for s in (-1, 1)]
    hexagons = list(itertools.product((-1, 1), repeat=3))
    surface, seen = Surface(), set()
    divisions = 8
    for centre in [(0, 0, 0), (4, 0, 0), (0, 4, 0), (2, 2, -2), (2, 2, 2)]:
        for normal in squares + hexagons:
            most = max(sum(n * x for n, x in zip(normal, corner)) for corner in corners)
            face = [corner for corner in corners if sum(n * x for n, x in zip(normal, corner)) == most]
            middle = tuple(sum(corner[k] for corner in face) / len(face) for k in range(3))
            at = tuple(m + c for m, c in zip(middle, centre))
            if at in seen:
                continue
            seen.add(at)
            first = [x - m for x, m in zip(face[0], middle)]
            cross = [
                normal[(k + 1) % 3] * first[(k + 2) % 3] - normal[(k + 2) % 3] * first[(k + 1) % 3] for k in range(3)
            ]
            size = math.sqrt(sum(n * n for n in normal))

            def angle(corner):
                apart = [x - m for x, m in zip(corner, middle)]
                along = sum(a * f for a, f in zip(apart, first))
                return math.atan2(sum(a * c for a, c in zip(apart, cross)) / size, along)

            face.sort(key=angle)
            for one, other in zip(face, face[1:] + face[:1]):
                ends = [tuple(x + c for x, c in zip(corner, centre)) for corner in (one, other)]

                def place(i, j):
                    return tuple(
                        (m * (divisions - i - j) + a * i + b * j) / divisions for m, a, b in zip(at, ends[0], ends[1])
                    )

                for i, j in itertools.product(range(divisions), repeat=2):
                    if i + j < divisions:
                        surface.triangle(f"wall{len(seen)}", place(i, j), place(i + 1, j), place(i, j + 1))
                    if i + j < divisions - 1:
                        surface.triangle(f"wall{len(seen)}", place(i + 1, j), place(i + 1, j + 1), place(i, j + 1))
    surface.write("foam.obj")


def cell():
    """Schwarz's P surface in a cube, by tetrahedra."""
    n = 14
    surface = Surface()

    def value(p):
        return sum(math.cos(2 * math.pi * x / n) for x in p) + 1e-3

    def cut(p, q):
        share = value(p) / (value(p) - value(q))
        return tuple((a + share * (b - a)) / n for a, b in zip(p, q))

    def add(inside, a, b, c):
        """A triangle that faces away from a place inside."""
        (ux, uy, uz), (vx, vy, vz) = ([x - y for x, y in zip(p, a)] for p in (b, c))
        apart = [x / n - y for x, y in zip(inside, a)]
        normal = (uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx)
        faces = sum(x * y for x, y in zip(normal, apart)) < 0
        surface.triangle("cell", *((a, b, c) if faces else (a, c, b)))

    for base in itertools.product(range(n), repeat=3):
        for order in itertools.permutations(range(3)):
            corner, tetrahedron = list(base), [base]
            for axis in order:
                corner[axis] += 1
                tetrahedron.append(tuple(corner))
            inside = [p for p in tetrahedron if value(p) > 0]
            outside = [p for p in tetrahedron if value(p) <= 0]
            if len(inside) == 2:
                (a, b), (c, d) = inside, outside
                add(a, cut(a, c), cut(a, d), cut(b, d))
                add(a, cut(a, c), cut(b, d), cut(b, c))
            elif inside and outside:
                (alone,), others = (inside, outside) if len(inside) == 1 else (outside, inside)
                add(inside[0], *(cut(alone, p) for p in others))
    surface.write("cell.obj")


def copies(source, target):
    """Eight copies of a surface, a unit apart."""
    vertices, facets = [], []
    for line in open(source):
        words = line.split()
        if words[:1] == ["v"]:
            vertices.append([float(x) for x in words[1:4]])
        elif words[:1] == ["f"]:
            facets.append([int(word.split("/")[0]) for word in words[1:4]])
    with open(target, "w") as file:
        for number, by in enumerate(itertools.product((0, 1), repeat=3)):
            file.writelines("v %.12g %.12g %.12g\n" % tuple(x + b for x, b in zip(p, by)) for p in vertices)
            first = number * len(vertices)
            file.writelines("f %d %d %d\n" % tuple(v + first for v in corners) for corners in facets)


if sys.argv[1:2] == ["copies"]:
    copies(sys.argv[2], sys.argv[3])
else:
    for make in (materials, hole, foam, cell):
        make()
