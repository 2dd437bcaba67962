# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Hints: pieces, thickness against closed forms and the field, what is not reached."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import box, cylinder, l_bracket, plate, prism, sphere, torus, wedge

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.harmonic import solve_harmonic
from HybridVolume.core.midstructure import Midstructure, medial_axis
from HybridVolume.core.midstructure.hints import hints
from HybridVolume.core.midstructure.samples import probes
from HybridVolume.core.tetmesh import CONFORMING, available_engines
from HybridVolume.core.thickness import shell_thickness


def own(vertices, facets, radius, points=None, half=None):
    """A midstructure with everything kept."""
    vertices, facets = np.asarray(vertices, dtype=float), np.asarray(facets)
    return Midstructure(
        vertices,
        facets,
        np.zeros(len(facets), dtype=int),
        np.ones(len(facets), dtype=bool),
        np.broadcast_to(radius, len(vertices)).astype(float),
        (),
        "own",
        probe_points=points,
        probe_radius=None if points is None else np.broadcast_to(half, len(points)).astype(float),
    )


def thin_bracket(thickness=0.2, leg=2.0, width=2.0):
    t, a = thickness, leg
    corner = [(0, 0), (t, 0), (t, t), (0, t)]
    quads = [corner, [(t, 0), (a, 0), (a, t), (t, t)], [(0, t), (t, t), (t, a), (0, a)]]
    return prism(quads, width, (2 * a - t) * t * width, name="thin L")


def finned_block():
    """Cube of 2 with a plate .2 thick and 3 long on one side."""
    low, high = 0.9, 1.1
    quads = [
        [(0, 0), (2, 0), (2, low), (0, low)],
        [(0, low), (2, low), (2, high), (0, high)],
        [(0, high), (2, high), (2, 2), (0, 2)],
        [(2, low), (5, low), (5, high), (2, high)],
    ]
    return prism(quads, 2.0, 9.2, name="finned block")


# ------------------------------------------------------------------ thickness in closed form


@pytest.mark.parametrize("w0", [0.2, 0.5, 0.8])
def test_wall_with_a_sheet_in_its_middle(w0):
    # two large triangles: the middle of the wall is far from their corners
    sheet = own(
        [[-9, -9, 0], [9, -9, 0], [9, 9, 0], [-9, 9, 0]], [[0, 1, 2], [0, 2, 3]], 0.5,
        np.array([[0.3, 0.7, 0.5], [-2.1, 1.3, -0.5], [4.0, -4.0, 0.5]]), 0.5,
    )  # fmt: skip
    told = hints(sheet, w0)
    assert told.thinnest == pytest.approx(0.5 * w0, rel=0.02)
    assert told.thickest == pytest.approx(0.5 * w0, rel=0.02)
    assert told.pieces == 1
    assert told.unreached == ()


@pytest.mark.parametrize("w0", [0.2, 0.5, 0.8])
def test_round_bar_with_a_line(w0):
    # w = ln(r) / ln(b) towards a thin bar of radius b in the middle
    angle = np.linspace(0.0, 6.0, 30)
    points = np.column_stack([np.cos(angle), np.sin(angle), np.linspace(-3.0, 3.0, 30)])
    ends = np.linspace(-6.0, 6.0, 7)
    line = own(
        np.column_stack([0 * ends, 0 * ends, ends]),
        [[k, k + 1, k + 1] for k in range(6)],
        1.0,
        points,
        1.0,
    )
    told = hints(line, w0)
    low, high = (1.0 - b**w0 for b in (0.3, 0.2))
    assert low <= told.thinnest <= told.thickest <= high
    assert told.pieces == 1


@pytest.mark.parametrize("w0", [0.2, 0.5, 0.8])
def test_ball_with_a_point(w0):
    # w = (1/r - 1) / (1/b - 1) towards a small ball of radius b in the middle
    points = np.concatenate([np.eye(3), -np.eye(3)])
    point = own([[0.0, 0.0, 0.0]], [[0, 0, 0]], 1.0, points, 1.0)
    told = hints(point, w0)
    low, high = (1.0 - 1.0 / (1.0 + w0 * (1.0 / b - 1.0)) for b in (0.3, 0.2))
    assert low <= told.thinnest <= told.thickest <= high


# ---------------------------------------------------------------------------------- pieces


def test_pieces():
    square = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    facets = np.array([[0, 1, 2], [0, 2, 3]])
    far = np.vstack([square, square + [3.0, 0, 0]])
    both = np.vstack([facets, facets + 4])
    assert hints(own(far, both, 0.5)).pieces == 2
    near = np.vstack([square, square + [1.05, 0, 0]])
    assert hints(own(near, both, 0.5)).pieces == 1
    # a line and a point of their own, and one sheet hidden
    mixed = own(
        np.vstack([far, [[0.0, 5, 0], [1, 5, 0], [8, 8, 8]]]),
        np.vstack([both, [[8, 9, 9], [10, 10, 10]]]),
        0.5,
    )
    assert hints(mixed).pieces == 4
    assert hints(replace(mixed, kept=np.array([1, 1, 0, 0, 1, 0], dtype=bool))).pieces == 2


def test_nothing_kept():
    sheet = own(np.eye(3), [[0, 1, 2]], 0.5, np.eye(3), 0.5)
    sheet = replace(sheet, kept=np.zeros(1, dtype=bool), faces=("Face1", "Face2", "Face1"))
    told = hints(sheet)
    assert (told.pieces, told.thinnest, told.thickest) == (0, 0.0, 0.0)
    (region,) = told.unreached
    assert region.faces == ("Face1", "Face2")
    assert region.share == 1.0
    assert "as thick as the body" in str(region)


# ------------------------------------------------------------------------------ whole bodies


@pytest.mark.skipif(not set(CONFORMING) & set(available_engines()), reason="no exact mesher")
def test_estimates_are_near_the_field():
    surface = build_surface(box((4, 2, 1)).faces)
    midstructure = medial_axis(surface, 5000)
    field = solve_harmonic(surface, midstructure, tets=20_000)
    exact, told = shell_thickness(field, surface, 0.5), hints(midstructure, 0.5)
    assert told.thinnest == pytest.approx(exact["min"], rel=0.2)
    assert told.thickest == pytest.approx(exact["max"], rel=0.2)


BODIES = [box(), l_bracket(), plate(20.0), cylinder(), torus(), sphere(), wedge(20.0), wedge(12.0)]


@pytest.mark.parametrize("body", BODIES, ids=lambda b: b.name)
def test_no_false_alarm(body):
    told = hints(medial_axis(build_surface(body.faces), 4000), 0.5)
    assert told.unreached == ()
    assert told.pieces == 1
    assert 0.0 < told.thinnest <= told.thickest


def without(body, faces, samples=5000):
    """Hints without the largest sheet between two faces."""
    midstructure = medial_axis(build_surface(body.faces), samples)
    assert hints(midstructure).unreached == ()
    sheet = next(s for s in midstructure.sheets if set(s.faces) == set(faces))
    return hints(midstructure.choose(decisions=[f"remove {sheet.name}"]))


def test_leg_of_a_bracket_without_its_sheet():
    # faces 3, 4, 9, 10, 11 bound the leg along x, and no other face does
    told = without(thin_bracket(), ("Face9", "Face11"))
    (region,) = told.unreached
    assert region.faces == ("Face3", "Face4", "Face9", "Face10", "Face11")
    assert region.share == pytest.approx(0.45, abs=0.1)
    assert region.distance == pytest.approx(1.9, rel=0.1)
    assert told.thickest > 1.5
    assert "Face3, Face4" in str(region)


def test_thin_plate_without_its_sheet():
    told = without(finned_block(), ("Face16", "Face18"))
    (region,) = told.unreached
    assert region.faces == ("Face7", "Face8", "Face16", "Face17", "Face18")
    assert region.distance > 3.0


def test_a_corner_of_large_faces_is_named_by_them():
    # a line along one end of a square plate: the other end is far away
    points = np.stack(np.meshgrid(*[np.linspace(0.25, 9.75, 20)] * 2), axis=-1).reshape(-1, 2)
    points = np.column_stack([np.vstack([points, points]), np.repeat([0.5, -0.5], 400)])
    line = own([[0.5, 0, 0], [0.5, 10, 0]], [[0, 1, 1]], 0.5, points, 0.5)
    line = replace(line, faces=("Face1", "Face2"), probe_patch=np.repeat([0, 1], 400))
    (region,) = hints(line).unreached
    assert region.faces == ("Face1", "Face2")
    # beyond 2.5 half thicknesses, 1.25 mm, from the line
    assert region.share == pytest.approx(0.83, abs=0.05)
    assert region.distance == pytest.approx(np.hypot(9.25, 0.5), rel=1e-3)


def test_scale_changes_lengths_only():
    told = []
    for scale in (1.0, 1e-3, 1e3):
        faces = [
            replace(face, control_points=scale * (face.control_points + 7.0))
            for face in thin_bracket().faces
        ]
        found = hints(medial_axis(build_surface(faces), 3000))
        assert found.unreached == ()
        told.append((found.pieces, found.thinnest / scale, found.thickest / scale))
    assert told[1] == pytest.approx(told[0], rel=0.1)
    assert told[2] == pytest.approx(told[0], rel=0.1)


def test_probes_know_the_thickness():
    points, half, patch = probes(build_surface(plate(50.0).faces))
    flat = np.abs(points[:, :2] - 25.0).max(axis=1) < 24.0
    assert half[flat] == pytest.approx(0.5, rel=0.05)
    assert set(patch) == set(range(6))
