# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Surfaces of many patches: exact figures of a torus of quads, and no loop over its patches."""

from __future__ import annotations

import cProfile
import json
import pstats
from pathlib import Path

import numpy as np
import pytest

from HybridVolume import exchange, report
from HybridVolume.core import bspline, intersection
from HybridVolume.core.assembly import build_surface, direction_strips
from HybridVolume.core.check import check_surface, check_uncut
from HybridVolume.core.cones import in_half_space
from HybridVolume.core.embedding_proof import prove_embedded
from HybridVolume.core.levels import _area_vectors
from HybridVolume.core.reached import _between_nodes
from HybridVolume.core.refinement import divide_faces, flatten_spans
from HybridVolume.core.shell import Shell
from HybridVolume.core.surface import SplineFace
from HybridVolume.errors import FaultError

LINE = np.array([0.0, 0.0, 1.0, 1.0])


def quads(along, across):
    """A torus (mm) around z as bilinear faces; every third face is given turned over."""
    a = 2.0 * np.pi * np.arange(along) / along
    b = 2.0 * np.pi * np.arange(across) / across
    out, high = 14.0 + 4.0 * np.cos(b), 4.0 * np.sin(b)
    x = np.stack(
        [np.outer(np.cos(a), out), np.outer(np.sin(a), out), np.tile(high, (along, 1))], axis=-1
    )
    x = np.pad(x, ((0, 1), (0, 1), (0, 0)), mode="wrap")
    faces = []
    for number, (i, j) in enumerate(np.ndindex(along, across)):
        net = x[i : i + 2, j : j + 2]
        net = net.transpose(1, 0, 2) if number % 3 else net
        name = f"Face{number + 1}"
        faces.append(SplineFace(name, (1, 1), (LINE, LINE), net.copy(), np.ones((2, 2)), False))
    return faces


def exact_volume(along, across):
    """Facets between two meridians are swept linearly: m sin(2 pi / m) times the first moment."""
    b = 2.0 * np.pi * np.arange(across) / across
    x, z = 14.0 + 4.0 * np.cos(b), 4.0 * np.sin(b)
    cross = x * np.roll(z, -1) - np.roll(x, -1) * z
    moment = float(((x + np.roll(x, -1)) * cross).sum() / 6.0)
    return along * np.sin(2.0 * np.pi / along) * moment


@pytest.fixture(scope="module")
def torus():
    return build_surface(quads(48, 20))


def test_a_thousand_quads_close_a_torus(torus):
    assert torus.genus == (1,) and len(torus.control_points) == 960
    assert torus.volume() == pytest.approx(exact_volume(48, 20), rel=1e-13)
    assert prove_embedded(torus).proved


def test_strips_go_once_around_either_way(torus):
    label, turn, symmetric = direction_strips(torus.neighbour, torus.reversed)
    # 20 rows of 48 faces must agree along the torus, and 48 rings of 20 around the tube
    assert sorted(np.bincount(label.ravel())) == [20] * 48 + [48] * 20
    assert not any(symmetric)
    # neighbours run alike or against each other as their common side says
    other, side = torus.neighbour[..., 0], torus.neighbour[..., 1]
    along = np.array([1, 1, 0, 0])
    here, there = turn[:, along], turn[other, along[side]]
    assert np.array_equal(here ^ there, torus.reversed)


def test_area_vectors_of_a_closed_net_add_up(torus):
    area = _area_vectors(torus, torus.control_points)
    assert np.abs(area.sum(axis=0)).max() < 1e-10
    ring = np.linalg.norm(area, axis=1).reshape(-1)
    assert len(np.unique(np.round(ring, 9))) == 11  # as many as rows that mirror each other


def test_values_between_nodes_are_bilinear(torus):
    mesh = torus.triangulation(4)
    for axis in range(3):
        found = _between_nodes(torus, mesh, torus.control_points[:, axis])
        assert np.abs(found - mesh.vertices[:, axis]).max() < 1e-13


def test_elements_of_some_spans_are_those_of_all(torus):
    middle = torus.control_points * [1.0, 1.0, 0.0]
    middle *= 14.0 / np.linalg.norm(middle, axis=1, keepdims=True)
    knots = bspline.clamped_knots(3, 2)
    heights = 0.5 * bspline.greville(3, knots)[:, None, None]
    layers = torus.control_points + heights * (middle - torus.control_points)
    shell = Shell(torus, layers, 3, knots)
    chosen = np.random.default_rng(1).random(torus.element_count) < 0.1
    every = {
        n: x
        for b in shell.bezier_elements()
        for n, x in zip(b.element, b.control_points, strict=True)
    }
    some = {
        n: x
        for b in shell.bezier_elements(chosen)
        for n, x in zip(b.element, b.control_points, strict=True)
    }
    assert sorted(some) == [n for n in sorted(every) if chosen[n // 2]] and len(every) == 1920
    assert all(np.array_equal(some[n], every[n]) for n in some)
    assert shell.bezier_elements(np.zeros(torus.element_count, dtype=bool)) == []


def test_faces_travel_bit_for_bit(tmp_path):
    faces = quads(6, 5)
    faces[3] = SplineFace(
        "Face4",
        (2, 1),
        (np.array([0.0, 0.0, 0.0, 1 / 3, 1.0, 1.0, 1.0]), LINE),
        np.random.default_rng(0).normal(size=(4, 2, 3)),
        np.random.default_rng(1).uniform(0.5, 2.0, (4, 2)),
        True,
    )
    path = Path(tmp_path) / "surface.npz"
    exchange.write_surface(path, faces)
    again = exchange.read_surface(path)
    for face, other in zip(faces, again, strict=True):
        assert (face.name, face.degrees, face.exact) == (other.name, other.degrees, other.exact)
        assert all(map(np.array_equal, face.knots, other.knots))
        assert np.array_equal(face.control_points, other.control_points)
        assert np.array_equal(face.weights, other.weights)


def test_reports_of_many_faces_have_a_line_a_face(tmp_path):
    rows = [{"face": f"Face{k}", "w0": {"min": 0.1 * k, "max": k}, "why": ""} for k in range(3000)]
    figures = {
        "shell": {"faces": rows, "levels": [0.1, 1 / 3, 1e-300], "none": None, "notes": []},
        "volumes": [{"input": {"file": 'a "b" ä', "rows": rows[:9]}}, {"input": {}}],
    }
    path = tmp_path / "report.json"
    report.write(figures, path)
    text = path.read_text(encoding="utf-8")
    assert json.loads(text) == figures
    assert 3000 < text.count("\n") < 3050
    rows[1234]["w0"]["max"] = float("nan")
    path.unlink()
    with pytest.raises(FaultError, match=r"not finite: shell.faces\[1234\].w0.max"):
        report.write(figures, path)
    assert not path.exists()


@pytest.mark.parametrize("half", [0.1, 0.7, 1.2, 1.5])
def test_half_spaces_of_vectors_of_known_angle(half):
    """Three vectors at one angle from an axis: their best direction is the axis."""
    turn, _ = np.linalg.qr(np.random.default_rng(7).normal(size=(3, 3)))
    around = 2.0 * np.pi * np.arange(3) / 3
    cone = np.column_stack(
        [np.sin(half) * np.cos(around), np.sin(half) * np.sin(around), np.full(3, np.cos(half))]
    )
    inside = np.array([[0.0, 0.0, 1.0], [np.sin(half / 2), 0.0, np.cos(half / 2)]])
    vectors = (np.concatenate([cone, inside]) @ turn.T)[None]
    assert in_half_space(vectors, 0.9 * np.cos(half))[0]
    assert not in_half_space(vectors, np.cos(half) + 1e-9)[0]
    both = np.concatenate([vectors, -vectors], axis=1)
    many = np.concatenate([np.concatenate([vectors, vectors], axis=1), both])
    assert in_half_space(many, 1e-7).tolist() == [True, False]


def test_python_does_not_loop_over_patches():
    """Calls grow with the patches by what is read and named, not by arithmetic."""

    def calls(along, across):
        faces = quads(along, across)
        profile = cProfile.Profile()
        profile.enable()
        surface = flatten_spans(divide_faces(build_surface(faces), []))
        check_surface(surface)
        check_uncut(surface)
        assert prove_embedded(surface).proved
        mesh = surface.triangulation(3)
        _between_nodes(surface, mesh, surface.control_points[:, 0])
        _area_vectors(surface, surface.control_points)
        direction_strips(surface.neighbour, surface.reversed)
        surface.volume()
        profile.disable()
        return pstats.Stats(profile).total_calls

    calls(8, 6)
    grown = calls(48, 20) - calls(24, 10)
    # reading, checking and naming a face take 185 to 200 calls; arrays for each patch in one of
    # these functions would add some tens
    assert grown / (960 - 240) < 220


def test_crossings_of_states_that_differ_in_places(torus, monkeypatch):
    """As from the start, whatever has moved, been turned over or lost its area since."""
    mesh = torus.triangulation(1)
    rng = np.random.default_rng(5)
    known = intersection.CrossingPairs()
    compared = []
    full = intersection._prepare
    monkeypatch.setattr(
        intersection, "_prepare", lambda x, rows: compared.append(len(rows)) or full(x, rows)
    )
    x, triangles = mesh.vertices.copy(), mesh.triangles.copy()
    seen = 0
    for state, count in enumerate([0, 8, 12, 2, 500, 0, 15, 0, 9]):
        moved = rng.choice(len(x), count, replace=False)
        x = mesh.vertices.copy()
        x[moved] += rng.normal(scale=0.9, size=(len(moved), 3))
        if state == 3:
            triangles = triangles.copy()
            triangles[100, 1] = triangles[100, 0]
        if state == 6:
            x *= 1e12
        compared.clear()
        found = known.find(x, triangles)
        mine = list(compared)
        expected = intersection.self_intersections(x, triangles)
        assert np.array_equal(found, expected)
        seen += len(found)
        # some of the 1920 triangles only are looked at where little has moved
        assert (mine[0] < 300) == (state in (1, 2, 3, 8))
    assert seen > 60
