# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Self-intersections, contact between surfaces and inside tests, against exact fractions."""

import time
from fractions import Fraction

import numpy as np
import pytest

from HybridVolume.core.boxtree import BoxTree
from HybridVolume.core.intersection import (
    points_inside,
    self_intersections,
    surfaces_intersect,
    winding_numbers,
)
from HybridVolume.core.predicates import orientation_2d, orientation_3d
from HybridVolume.errors import FaultError

# ---- an independent answer: clipping in fractions ---------------------------------------------


def dot(a, b):
    return sum(x * y for x, y in zip(a, b, strict=True))


def minus(a, b):
    return tuple(x - y for x, y in zip(a, b, strict=True))


def cross(a, b):
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def clip(polygon, normal, offset):
    """Part of a polygon (also a segment or point) in the closed half space n.x >= offset."""
    values = [dot(normal, p) - offset for p in polygon]
    out = []
    for i, (p, value) in enumerate(zip(polygon, values, strict=True)):
        if value >= 0:
            out.append(p)
        q, other = polygon[(i + 1) % len(polygon)], values[(i + 1) % len(polygon)]
        if value * other < 0:
            t = value / (value - other)
            out.append(tuple(a + t * (b - a) for a, b in zip(p, q, strict=True)))
    return out


def exact_crossing(points, one, two):
    """Whether two triangles (vertex numbers) meet outside the simplex they share."""
    a, b, c = (points[k] for k in two)
    normal = cross(minus(b, a), minus(c, a))
    polygon = [points[k] for k in one]
    halves = [(normal, dot(normal, a)), (tuple(-x for x in normal), -dot(normal, a))]
    for p, q in ((a, b), (b, c), (c, a)):
        inward = cross(normal, minus(q, p))
        halves.append((inward, dot(inward, p)))
    for half in halves:
        polygon = clip(polygon, *half)
        if not polygon:
            return False
    shared = [points[k] for k in set(one) & set(two)]
    if not shared or len(shared) == 3:
        return True
    if len(shared) == 1:
        return any(p != shared[0] for p in polygon)
    side = minus(shared[1], shared[0])
    return any(any(cross(side, minus(p, shared[0]))) for p in polygon)


def brute_force(vertices, triangles):
    points = [tuple(Fraction(float(x)) for x in p) for p in vertices]
    rows, usable = [], []
    for i, (a, b, c) in enumerate(triangles):
        if any(cross(minus(points[b], points[a]), minus(points[c], points[a]))):
            usable.append(i)
        else:
            rows.append((i, i))
    for n, i in enumerate(usable):
        for j in usable[n + 1 :]:
            if exact_crossing(points, triangles[i].tolist(), triangles[j].tolist()):
                rows.append((i, j))
    return sorted(rows)


@pytest.mark.parametrize(
    ("kind", "seed"),
    [(kind, seed) for kind in ("grid", "plane", "floats", "near") for seed in (1, 2)],
)
def test_random_soups_against_fractions(kind, seed):
    rng = np.random.default_rng(seed)
    if kind == "grid":  # small integers: every degenerate contact there is
        vertices = np.unique(rng.integers(0, 4, (28, 3)), axis=0).astype(float)
    elif kind == "plane":  # all in one oblique plane, exactly
        uv = np.unique(rng.integers(-5, 6, (26, 2)), axis=0).astype(float)
        vertices = uv @ np.array([[1.0, 0.25, 0.5], [-0.5, 1.0, 3.0]]) + [100.0, -7.0, 0.125]
    elif kind == "floats":
        vertices = rng.normal(size=(30, 3)) * [1e3, 1.0, 1e-2] + [1e5, 0, 0]
    else:  # a grid off by single roundings
        vertices = np.unique(rng.integers(0, 4, (28, 3)), axis=0) / 3.0
        vertices = vertices * (1 + rng.integers(-1, 2, vertices.shape) * 2.0**-52)
    triangles = np.array([rng.choice(len(vertices), 3, replace=False) for _ in range(40)])
    expected = brute_force(vertices, triangles)
    assert 5 < len(expected) < 40 * 39 / 2
    assert [tuple(r) for r in self_intersections(vertices, triangles).tolist()] == expected

    # The same soup against a moved copy: no vertex is shared then.
    half = len(triangles) // 2
    both = surfaces_intersect(vertices, triangles[:half], vertices, triangles[half:])
    points = [tuple(Fraction(float(x)) for x in p) for p in vertices]
    shift = len(points)
    points += points
    usable = {i for i in range(len(triangles))} - {i for i, j in expected if i == j}
    pairs = [
        (i, j - half)
        for i in range(half)
        for j in range(half, len(triangles))
        if {i, j} <= usable
        and exact_crossing(points, triangles[i].tolist(), (triangles[j] + shift).tolist())
    ]
    assert [tuple(r) for r in both.tolist()] == sorted(pairs)


# ---- single contacts --------------------------------------------------------------------------

FLAT = [[0.0, 0.0, 0.0], [4.0, 0.0, 0.0], [0.0, 4.0, 0.0]]


@pytest.mark.parametrize(
    ("name", "vertices", "triangles", "crosses"),
    [
        ("pierced", [*FLAT, [1, 1, -1], [1, 1, 1], [2, 9, 1]], [[0, 1, 2], [3, 4, 5]], True),
        ("beside", [*FLAT, [5, 5, -1], [5, 5, 1], [6, 9, 1]], [[0, 1, 2], [3, 4, 5]], False),
        ("tip on face", [*FLAT, [1, 1, 0], [1, 2, 3], [2, 1, 3]], [[0, 1, 2], [3, 4, 5]], True),
        (
            "tip one rounding above",
            [*FLAT, [1, 1, 5e-324], [1, 2, 3], [2, 1, 3]],
            [[0, 1, 2], [3, 4, 5]],
            False,
        ),
        ("common side, folded", [*FLAT, [1, 1, 0]], [[0, 1, 2], [0, 1, 3]], True),
        ("common side, hinge", [*FLAT, [1, 1, 1e-30]], [[0, 1, 2], [0, 1, 3]], False),
        ("common side, flat", [*FLAT, [1, -1, 0]], [[0, 1, 2], [1, 0, 3]], False),
        ("common corner", [*FLAT, [-1, 1, 1], [-1, -1, 1]], [[0, 1, 2], [0, 3, 4]], False),
        ("common corner, flat", [*FLAT, [-1, 0, 0], [-1, -1, 0]], [[0, 1, 2], [0, 3, 4]], False),
        ("corner, same side", [*FLAT, [2, 0, 0], [1, -1, 0]], [[0, 1, 2], [0, 3, 4]], True),
        ("corner, through", [*FLAT, [2, 2, 1], [2, 2, -1]], [[0, 1, 2], [0, 3, 4]], True),
        ("corner, within", [*FLAT, [2, 1, 0], [1, 2, 0]], [[0, 1, 2], [0, 3, 4]], True),
        (
            "same point twice",
            [*FLAT, [0, 0, 0], [-1, 0, 0], [0, -1, 0]],
            [[0, 1, 2], [3, 4, 5]],
            True,
        ),
        ("twice the same", FLAT, [[0, 1, 2], [2, 1, 0]], True),
        ("inside, flat", [*FLAT, [1, 1, 0], [2, 1, 0], [1, 2, 0]], [[0, 1, 2], [3, 4, 5]], True),
        ("flat, apart", [*FLAT, [3, 3, 0], [4, 3, 0], [3, 4, 0]], [[0, 1, 2], [3, 4, 5]], False),
    ],
)
@pytest.mark.parametrize("motion", ["as is", "turned", "far", "small"])
def test_single_contacts(name, vertices, triangles, crosses, motion):
    vertices = np.array(vertices, dtype=float)
    triangles = np.array(triangles)
    if motion == "turned":  # exact: axes exchanged and mirrored
        vertices = vertices[:, [2, 0, 1]] * [-1, 1, -1]
    elif motion == "far":
        if np.any((vertices != 0) & (np.abs(vertices) < 1)):
            return  # the small offset would be lost
        vertices = vertices + 2.0**40
    elif motion == "small":
        vertices = vertices * 2.0**-30
        if "rounding" in name:
            return
    expected = [[0, 1]] if crosses else []
    assert self_intersections(vertices, triangles).tolist() == expected
    assert self_intersections(vertices, triangles[::-1, ::-1]).tolist() == expected
    assert [tuple(r) for r in expected] == brute_force(vertices, triangles)


def test_contact_to_the_last_bit():
    # The plane x + y = 3 z, and a tip at (1.5, 0.75, 0.75) on it, one float above and below.
    vertices = np.array(
        [[0, 0, 0], [3, 0, 1], [0, 3, 1], [1.5, 0.75, 0.75], [1, 1, 9], [2, 1, 9]], dtype=float
    )
    triangles = np.array([[0, 1, 2], [3, 4, 5]])
    for offset, hits in ((0.0, 1), (1.0, 0), (-1.0, 1)):
        moved = vertices.copy()
        if offset:
            moved[3, 2] = np.nextafter(0.75, 0.75 + offset)
        assert len(self_intersections(moved, triangles)) == hits
        assert len(surfaces_intersect(moved, triangles[:1], moved, triangles[1:])) == hits


def test_triangles_without_area_are_reported():
    vertices = np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0], [0, 0, 0]], dtype=float)
    triangles = np.array([[0, 1, 3], [0, 1, 2], [0, 1, 1], [0, 3, 4]])
    assert self_intersections(vertices, triangles).tolist() == [[1, 1], [2, 2], [3, 3]]
    thin = np.array([[0, 0, 0], [1, 0, 0], [2, 5e-324, 0]], dtype=float)
    assert len(self_intersections(thin, np.array([[0, 1, 2]]))) == 0


def test_predicates_against_fractions():
    rng = np.random.default_rng(2)
    a, b, c = rng.normal(size=(3, 400, 3)) + [1e4, 0, 0]
    t = rng.uniform(-1, 1, (2, 400, 1))
    d = a + t[0] * (b - a) + t[1] * (c - a)  # in the plane but for a rounding
    d[::4] = b[::4]
    sign = orientation_3d(a, b, c, d)
    flat = orientation_2d(a[:, :2], b[:, :2], (a + t[0] * (b - a))[:, :2])
    p = [[tuple(Fraction(float(x)) for x in row) for row in x] for x in (a, b, c, d)]
    q = [tuple(Fraction(float(x)) for x in row) for row in a + t[0] * (b - a)]
    for k in range(400):
        value = dot(
            cross(minus(p[1][k], p[0][k]), minus(p[2][k], p[0][k])), minus(p[3][k], p[0][k])
        )
        assert sign[k] == (value > 0) - (value < 0)
        u, v = minus(p[1][k], p[0][k]), minus(q[k], p[0][k])
        value = u[0] * v[1] - u[1] * v[0]
        assert flat[k] == (value > 0) - (value < 0)
    assert set(np.unique(sign)) == {-1, 0, 1}
    small = 2.0**-352  # products underflow
    a, b, c, d = (x - [1e4, 0, 0] for x in (a, b, c, d))
    sign = orientation_3d(a, b, c, d)
    assert np.array_equal(orientation_3d(a * small, b * small, c * small, d * small), sign)
    extreme = np.array([[1e-300, 0, 0], [1e300, 0, 0], [0, 1e-300, 0], [0, 0, 1e-300]])
    with np.errstate(over="ignore", invalid="ignore"):
        assert orientation_3d(*(extreme[k : k + 1] for k in range(4)))[0] != 0


def test_box_tree_against_all_pairs():
    rng = np.random.default_rng(9)
    for count in (0, 1, 2, 3, 50, 129):
        low = rng.integers(0, 20, (count, 3)).astype(float)
        high = low + rng.integers(0, 4, (count, 3))
        meet = np.all((low[:, None] <= high) & (low <= high[:, None]), axis=2)
        expected = [list(r) for r in np.argwhere(np.triu(meet, 1))]
        assert sorted(BoxTree(low, high).self_pairs().tolist()) == expected
        half = count // 3
        found = BoxTree(low[:half], high[:half]).pairs(BoxTree(low[half:], high[half:]))
        expected = [list(r) for r in np.argwhere(meet[:half, half:])]
        assert sorted(found.tolist()) == expected


# ---- surfaces ---------------------------------------------------------------------------------


def box(n, size=(1.0, 1.0, 1.0), origin=(0.0, 0.0, 0.0)):
    """Welded surface of a box, n x n squares a face, oriented outward."""
    grid = np.arange(n + 1)
    u, v = np.meshgrid(grid, grid, indexing="ij")
    number = np.arange((n + 1) ** 2).reshape(n + 1, n + 1)
    a, b, c, d = number[:-1, :-1], number[1:, :-1], number[1:, 1:], number[:-1, 1:]
    face = np.concatenate([np.stack(x, axis=-1).reshape(-1, 3) for x in ((a, b, c), (a, c, d))])
    points, triangles = [], []
    for axis in range(3):
        for end in (0, n):
            x = np.empty((n + 1, n + 1, 3), dtype=int)
            x[..., axis], x[..., (axis + 1) % 3], x[..., (axis + 2) % 3] = end, u, v
            triangles.append((face if end else face[:, ::-1]) + len(points) * (n + 1) ** 2)
            points.append(x.reshape(-1, 3))
    points, inverse = np.unique(np.concatenate(points), axis=0, return_inverse=True)
    triangles = inverse.reshape(-1)[np.concatenate(triangles)]
    return points / n * np.array(size) + np.array(origin), triangles


def sphere(n, radius=1.0, centre=(0.0, 0.0, 0.0)):
    points, triangles = box(n, (2.0, 2.0, 2.0), (-1.0, -1.0, -1.0))
    points = np.tan(points * np.pi / 4)
    return points / np.linalg.norm(points, axis=1)[:, None] * radius + np.array(centre), triangles


def torus(n, m, major=2.0, minor=0.7):
    u, v = np.arange(n) * 2 * np.pi / n, np.arange(m) * 2 * np.pi / m
    u, v = np.meshgrid(u, v, indexing="ij")
    ring = major + minor * np.cos(v)
    points = np.stack([ring * np.cos(u), ring * np.sin(u), minor * np.sin(v)], axis=-1)
    number = np.arange(n * m).reshape(n, m)
    b, d = np.roll(number, -1, 0), np.roll(number, -1, 1)
    c = np.roll(b, -1, 1)
    triangles = [np.stack(x, axis=-1).reshape(-1, 3) for x in ((number, b, c), (number, c, d))]
    return points.reshape(-1, 3), np.concatenate(triangles)


def joined(*surfaces):
    offset, points, triangles = 0, [], []
    for p, t in surfaces:
        points.append(p)
        triangles.append(t + offset)
        offset += len(p)
    return np.concatenate(points), np.concatenate(triangles)


def turned(points, seed=0):
    q, _ = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))
    return points @ q.T


def test_embedded_surfaces_have_none():
    for points, triangles in (box(9), sphere(9), torus(40, 16)):
        for moved in (
            points,
            turned(points),
            points * 1e-3,
            points * 1e3 + 1e5,
            turned(points) * [1, 1, 1e-4],
        ):
            assert len(self_intersections(moved, triangles)) == 0
    assert len(self_intersections(*joined(sphere(8), sphere(8, 0.9)))) == 0


def test_crossing_surfaces():
    first, second = sphere(10), sphere(10, centre=(1.2, 0.1, 0.05))
    pairs = surfaces_intersect(*first, *second)
    assert len(pairs) > 50
    both = joined(first, second)
    inside = self_intersections(*both)
    assert np.array_equal(inside - [0, len(first[1])], pairs)
    # All crossings lie near the circle in which the spheres meet.
    centres = first[0][first[1][pairs[:, 0]]].mean(axis=1)
    offset = np.array([1.2, 0.1, 0.05])
    plane = centres @ offset / np.linalg.norm(offset) - np.linalg.norm(offset) / 2
    assert np.abs(plane).max() < 0.15
    assert len(surfaces_intersect(*first, *sphere(10, 0.95))) == 0
    assert len(surfaces_intersect(*first, *sphere(10, centre=(2.01, 0, 0)))) == 0


def test_boxes_that_touch():
    base = box(4)
    beside = box(4, origin=(1.0, 0.0, 0.0))
    # Each of the 32 triangles of the common face meets its twin and the twin's neighbours only.
    pairs = surfaces_intersect(*base, *beside)
    x = base[0][base[1]][:, :, 0]
    on_face = np.flatnonzero((x == 1.0).all(axis=1))
    touching = np.flatnonzero((x == 1.0).any(axis=1))
    assert set(pairs[:, 0]) == set(touching)
    assert set(on_face) < set(touching)
    gap = (base[0] + [1.0 + 2.0**-52, 0, 0], base[1])
    assert len(surfaces_intersect(*base, *gap)) == 0
    corner = box(4, origin=(1.0, 1.0, 1.0))
    pairs = surfaces_intersect(*base, *corner)
    at = np.argmax(base[0].sum(axis=1)), np.argmin(corner[0].sum(axis=1))
    incident = [
        np.flatnonzero((s[1] == k).any(axis=1)) for s, k in zip((base, corner), at, strict=True)
    ]
    assert len(pairs) == len(incident[0]) * len(incident[1])


def test_folded_sheet():
    points, triangles = box(12)
    pulled = points.copy()
    centre = np.argmin(np.linalg.norm(points - [0.5, 0.5, 1.0], axis=1))
    pulled[centre] = [0.5, 0.5, -0.2]  # a spike through the bottom
    pairs = self_intersections(pulled, triangles)
    spike = np.flatnonzero((triangles == centre).any(axis=1))
    assert len(pairs) > 0
    assert np.all(np.isin(pairs, spike).any(axis=1))
    folded = points.copy()
    folded[centre] = points[centre] + [1.5 / 12, 0.0, 0.0]  # within the plane of the top
    assert len(self_intersections(folded, triangles)) > 0
    folded[centre] = points[centre] + [0.5 / 12, 0.2 / 12, 0.0]
    assert len(self_intersections(folded, triangles)) == 0


def test_fifty_thousand_triangles():
    points, triangles = torus(250, 100)
    start = time.perf_counter()
    assert len(self_intersections(points, triangles)) == 0
    # 0.6 s on a quiet core; the limit leaves room for a busy machine.
    assert time.perf_counter() - start < 6
    flat, triangles = box(60)
    start = time.perf_counter()
    assert len(self_intersections(turned(flat), triangles)) == 0
    assert time.perf_counter() - start < 6


def test_points_inside():
    rng = np.random.default_rng(6)
    points, triangles = torus(60, 30)
    sample = rng.uniform(-3, 3, (4000, 3))
    ring = np.hypot(np.hypot(sample[:, 0], sample[:, 1]) - 2.0, sample[:, 2])
    inside = points_inside(points, triangles, sample)
    assert np.all(inside[ring < 0.7 * 0.97])
    assert not np.any(inside[ring > 0.7])
    assert set(winding_numbers(points, triangles, sample)) == {0, 1}
    assert set(winding_numbers(points, triangles[:, ::-1], sample)) == {0, -1}
    far = points_inside(points + 1e5, triangles, sample + 1e5)
    assert np.mean(far != inside) < 1e-3


def test_rays_through_edges_and_vertices():
    # Points whose vertical rays run through vertices, along sides and within faces of the box.
    points, triangles = box(4)
    grid = np.array([-0.5, -0.25, 0.125, 0.25, 0.5, 0.75, 1.25])
    sample = np.stack(np.meshgrid(grid, grid, grid, indexing="ij"), axis=-1).reshape(-1, 3)
    expected = np.all((sample > 0) & (sample < 1), axis=1)
    assert np.array_equal(points_inside(points, triangles, sample), expected)
    above = np.stack([sample[:, 0], sample[:, 1], np.full(len(sample), -1.0)], axis=1)
    assert not points_inside(points, triangles, above).any()
    # Hollow: the cavity's shell points into the cavity.
    shell = joined(box(4), (0.5 * points + 0.25, triangles[:, ::-1]))
    hollow = expected & ~np.all((sample >= 0.25) & (sample <= 0.75), axis=1)
    strict = np.all(sample != 0.25, axis=1) & np.all(sample != 0.75, axis=1)
    assert np.array_equal(points_inside(*shell, sample)[strict], hollow[strict])
    assert points_inside(points, triangles, np.zeros((0, 3))).shape == (0,)


def test_faults():
    points, triangles = box(1)
    broken = points.copy()
    broken[0, 0] = np.nan
    for call in (
        lambda: self_intersections(broken, triangles),
        lambda: self_intersections(points, triangles + 1),
        lambda: points_inside(points, triangles, [[np.inf, 0, 0]]),
    ):
        with pytest.raises(FaultError):
            call()
    assert self_intersections(np.zeros((0, 3)), np.zeros((0, 3), int)).shape == (0, 2)
    assert surfaces_intersect(points, triangles, points[:0], triangles[:0]).shape == (0, 2)


# ---- against CGAL -----------------------------------------------------------------------------


def cgal_triangles(kernel, vertices, triangles):
    points = [kernel.Point_3(*map(float, p)) for p in vertices]
    return [kernel.Triangle_3(*(points[k] for k in row)) for row in triangles]


@pytest.mark.parametrize(("scale", "shift"), [(1.0, 0.0), (1e-3, 1e2), (1e3, 1e6)])
def test_nasty_pairs_of_triangles_against_cgal(scale, shift):
    """CGAL decides with exact predicates of its own, for the same floats."""
    kernel = pytest.importorskip("CGAL.CGAL_Kernel")
    rng = np.random.default_rng(int(10 * scale))
    grid = rng.integers(0, 4, (70, 3)).astype(float)
    plane = rng.integers(-5, 6, (70, 2)) @ np.array([[1.0, 0.25, 0.5], [-0.5, 1.0, 3.0]])
    kinds = {
        "free": rng.normal(size=(70, 3)),
        "grid": grid,
        "grid off by roundings": grid / 3.0 * (1 + rng.integers(-1, 2, grid.shape) * 2.0**-52),
        "plane with bumps": plane + np.where(rng.uniform(size=(70, 1)) < 0.3, 1e-16, 0.0),
        "almost flat": rng.normal(size=(70, 3)) * [1.0, 1.0, 1e-15],
    }
    for kind, vertices in kinds.items():
        vertices = vertices * scale + shift
        one, two = rng.integers(0, 70, (2, 40, 3))
        # triangles without area are another matter
        one, two = (
            np.delete(t, [i for i, j in self_intersections(vertices, t) if i == j], axis=0)
            for t in (one, two)
        )
        found = np.zeros((len(one), len(two)), dtype=bool)
        found[tuple(surfaces_intersect(vertices, one, vertices, two).T)] = True
        first, second = (cgal_triangles(kernel, vertices, t) for t in (one, two))
        expected = np.array([[kernel.do_intersect(a, b) for b in second] for a in first])
        assert expected.any(), kind
        assert np.array_equal(found, expected), kind


@pytest.mark.parametrize("noise", [0.1, 0.3, 1.0])
def test_noisy_torus_against_cgal(noise):
    """Closed surfaces, where most pairs of triangles share a vertex or a side."""
    kernel = pytest.importorskip("CGAL.CGAL_Kernel")
    from CGAL.CGAL_Polygon_mesh_processing import self_intersections as cgal_pairs
    from CGAL.CGAL_Polyhedron_3 import Polyhedron_3, Polyhedron_modifier

    vertices, triangles = torus(48, 24)
    vertices += noise * 2.0 * np.pi / 48 * np.random.default_rng(4).normal(size=vertices.shape)
    build = Polyhedron_modifier()
    build.begin_surface(len(vertices), len(triangles))
    for point in vertices:
        build.add_vertex(kernel.Point_3(*map(float, point)))
    for row in triangles:
        build.begin_facet()
        for vertex in row:
            build.add_vertex_to_facet(int(vertex))
        build.end_facet()
    build.end_surface()
    body, pairs = Polyhedron_3(), []
    body.delegate(build)
    cgal_pairs(body, pairs)
    found = self_intersections(vertices, triangles)
    assert len(found) == len(pairs)
    assert (len(pairs) > 0) == (noise > 0.2)


def test_work_grows_little_more_than_the_triangles():
    times = []
    for size in (40, 120):
        vertices, triangles = torus(size, size // 2)
        runs = []
        for _ in range(3):
            start = time.process_time()
            assert len(self_intersections(vertices, triangles)) == 0
            runs.append(time.process_time() - start)
        times.append(min(runs))
    assert times[1] < 3.0 * 9 * times[0]
