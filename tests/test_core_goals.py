# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Thickness of the shell in mm and by faces, measured on the finished shell."""

from __future__ import annotations

from functools import cache

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.goals import Thickness, parse_factors
from HybridVolume.core.growth import grow_shell
from HybridVolume.core.harmonic import HarmonicField, solve_harmonic
from HybridVolume.core.midstructure import medial_axis
from HybridVolume.core.refinement import divide_faces, flatten_spans
from HybridVolume.core.surface import PatchSurface
from HybridVolume.core.thickness import distance_to_triangles, surface_places
from HybridVolume.errors import InputError

BODIES = {
    "box": bodies.box((3.0, 2.0, 1.0), (6, 4, 2)),
    "sphere": bodies.sphere(spans=2),
    "torus": bodies.torus(),
}


@cache
def problem(name: str) -> tuple[PatchSurface, HarmonicField]:
    surface = flatten_spans(build_surface(list(BODIES[name].faces)))
    return surface, solve_harmonic(surface, medial_axis(surface))


def distances(name: str, thickness: Thickness) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance from places of the surface to the inner boundary, their areas and patches."""
    surface, field = problem(name)
    shell, certificate = grow_shell(surface, field, thickness)
    assert certificate.all_valid
    inner = shell.inner_surface().triangulation(6)
    points, area, patch = surface_places(surface, 6000)
    return distance_to_triangles(points, inner.vertices, inner.triangles), area, patch


@pytest.mark.parametrize(("name", "length"), [("sphere", 0.3), ("torus", 0.25)])
def test_the_same_number_of_mm_everywhere_on_round_bodies(name, length):
    distance, _, _ = distances(name, Thickness.parse(f"{length} mm"))
    assert np.percentile(distance, [5, 95]) == pytest.approx([length] * 2, rel=0.12)
    assert np.median(distance) == pytest.approx(length, rel=0.05)


def test_the_same_number_of_mm_on_a_box_away_from_its_edges():
    surface, _ = problem("box")
    distance, _, _ = distances("box", Thickness.parse("0.2 mm"))
    points, _, _ = surface_places(surface, 6000)
    # how far a place of a face is from the nearest edge of the box 3x2x1
    low = np.minimum(points - points.min(axis=0), points.max(axis=0) - points)
    inside = np.sort(low, axis=1)[:, 1] > 0.3
    assert inside.any()
    # the knot spans are .5 wide, so the corner of the inner boundary reaches far
    assert np.median(distance[inside]) == pytest.approx(0.2, rel=0.05)
    assert np.percentile(distance[inside], [2, 90]) == pytest.approx([0.2, 0.2], rel=0.2)


@pytest.mark.parametrize("kind", ["mean", "min"])
def test_mean_and_smallest_thickness(kind):
    distance, area, _ = distances("torus", Thickness.parse(f"{kind} 0.3 mm"))
    found = np.average(distance, weights=area) if kind == "mean" else distance.min()
    assert found == pytest.approx(0.3, rel=0.1)


def test_a_factor_makes_the_shell_thinner_at_its_face_only():
    surface, _ = problem("box")
    face = surface.patches[0].face
    even, _, patch = distances("box", Thickness("w0", 0.4))
    less, _, _ = distances("box", Thickness("w0", 0.4, {face: 0.5}))
    ratio = [np.median(less[patch == k]) / np.median(even[patch == k]) for k in (0, 1)]
    assert ratio[0] < 0.8
    assert ratio[1] == pytest.approx(1.0, abs=0.05)


def test_too_much_for_the_body_is_said():
    surface, field = problem("box")
    shell, _ = grow_shell(surface, field, Thickness.parse("0.8 mm"))
    assert any("midstructure is nearer than 0.8 mm" in note for note in shell.notes)


@pytest.mark.parametrize(
    "text",
    ["", "0", "1.5", "-1 mm", "0 mm", "mean 0.5", "2 inch", "max 2 mm", "0 %", "96 %", "mean 30 %"],
)
def test_what_is_no_thickness_is_refused(text):
    with pytest.raises(InputError):
        Thickness.parse(text)


@pytest.mark.parametrize(
    ("text", "kind", "value"),
    [
        ("0.35", "w0", 0.35),
        ("2mm", "even", 2.0),
        ("mean 1.5e-3 mm", "mean", 1.5e-3),
        ("MIN .5 mm", "min", 0.5),
        ("12.5 %", "share", 0.125),
    ],
)
def test_texts_of_thicknesses(text, kind, value):
    found = Thickness.parse(text)
    assert (found.kind, found.value) == (kind, pytest.approx(value, rel=1e-15))
    assert Thickness.parse(found.text) == found


def test_factors_are_read_from_texts():
    assert parse_factors(["Face3 = 1.5", "Face12=0.5", " Face1:2 "]) == {
        "Face3": 1.5, "Face12": 0.5, "Face1": 2.0,
    }  # fmt: skip
    for texts in (["Face3"], ["Face3 = thick"], ["Face3 = 0"], ["= 2"], ["F = 1", "F = 2"]):
        with pytest.raises(InputError):
            parse_factors(texts)


def test_a_share_of_the_local_radius():
    distance, _, _ = distances("torus", Thickness.parse("30 %"))
    assert np.percentile(distance, [5, 50, 95]) == pytest.approx([0.3] * 3, rel=0.1)


def test_a_thin_shell_where_all_control_points_are_corners():
    # near a corner the level goes like the third power of the thickness
    surface = build_surface(list(bodies.box((3.0, 2.0, 1.0), (1, 1, 1), 1).faces))
    field = solve_harmonic(surface, medial_axis(surface, 3000))
    shell, _ = grow_shell(surface, field, Thickness.parse("0.05 mm"), layers=1)
    assert shell.w0 < 0.01
    inner = shell.inner_surface().control_points
    away = np.minimum(inner, np.array([3.0, 2.0, 1.0]) - inner)
    assert away.mean() == pytest.approx(0.05, rel=0.08)


def test_factors_are_for_faces_that_there_are():
    surface, field = problem("box")
    with pytest.raises(InputError, match="no such faces") as found:
        grow_shell(surface, field, Thickness("w0", 0.3, {"Face77": 2.0}))
    assert found.value.faces == ("Face77",) or list(found.value.faces) == ["Face77"]
    with pytest.raises(InputError, match="Face1"):
        Thickness("w0", 0.3, {"Face1": 0.0})


def test_a_plain_face_can_have_a_thickness_of_its_own():
    """Without knots all columns of a plain box stand on its corners, which faces share."""
    given = build_surface(list(bodies.box((3.0, 2.0, 1.0), (1, 1, 1), 1).faces))
    face = given.patches[0].face
    surface = divide_faces(given, [face])
    assert surface.volume() == pytest.approx(6.0, rel=1e-12)
    assert surface.element_count == 6 * 4 * 4
    assert divide_faces(surface, [face]) is surface and divide_faces(given, []) is given
    field = solve_harmonic(surface, medial_axis(surface, 3000))
    shell, _ = grow_shell(surface, field, Thickness.parse("0.2 mm", {face: 0.5}), layers=1)
    inner = shell.inner_surface()
    middle = [np.full(1, 0.5), np.full(1, 0.5)]
    away = [
        np.abs(inner.evaluate(k, *middle) - surface.evaluate(k, *middle)).max() for k in range(6)
    ]
    assert away[0] == pytest.approx(0.1, rel=0.2)
    assert away[1:] == pytest.approx([0.2] * 5, rel=0.15)
