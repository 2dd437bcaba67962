# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Heights of the layers of a shell: even, graded, with a first layer in mm."""

from __future__ import annotations

from functools import cache

import bodies
import numpy as np
import pytest

from HybridVolume.core import bspline
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.growth import grow_shell
from HybridVolume.core.harmonic import solve_harmonic
from HybridVolume.core.levels import Spacing, spaced_layers, trials
from HybridVolume.core.midstructure import medial_axis
from HybridVolume.core.refinement import flatten_spans
from HybridVolume.core.shell import Shell
from HybridVolume.core.validity import certify
from HybridVolume.errors import InputError

SURFACE = build_surface(list(bodies.box().faces))


def shell_of(spacing: str, layers: int, degree: int) -> Shell:
    """A shell of the box, drawn to .6 of the way to its middle."""
    points = SURFACE.control_points
    displacement = 0.6 * (points.mean(axis=0) - points)
    knots = bspline.clamped_knots(degree, layers)
    spaced = spaced_layers(points, displacement, degree, knots, SURFACE, Spacing.parse(spacing))
    return Shell(SURFACE, spaced, degree, knots)


def heights(shell: Shell) -> np.ndarray:
    """Lengths of the pieces of the column at a patch's corner between its knots, mm."""
    w = bspline.breakpoints(shell.knots_w)
    x = shell.evaluate(0, np.zeros(len(w)), np.zeros(len(w)), w)
    return np.linalg.norm(np.diff(x, axis=0), axis=1)


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("layers", [1, 2, 5])
@pytest.mark.parametrize("ratio", [0.5, 1.0, 1.5, 3.0])
def test_every_layer_is_higher_by_the_ratio(degree, layers, ratio):
    shell = shell_of(f"{ratio}", layers, degree)
    found = heights(shell)
    assert found[1:] / found[:-1] == pytest.approx(np.full(layers - 1, ratio), rel=1e-9)
    corners = SURFACE.control_points
    whole = 0.6 * np.linalg.norm(corners.mean(axis=0) - corners[SURFACE.patches[0].index[0, 0]])
    assert found.sum() == pytest.approx(whole, rel=1e-12)
    assert certify(shell.bezier_elements()).all_valid


@pytest.mark.parametrize("degree", [1, 2, 3, 4])
@pytest.mark.parametrize("height", [0.02, 0.1, 0.3])
def test_the_first_layer_has_the_height_in_mm(degree, height):
    shell = shell_of(f"{height} mm", 4, degree)
    assert heights(shell)[0] == pytest.approx(height, rel=1e-6)
    assert certify(shell.bezier_elements()).all_valid


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_equal_distance_and_equal_volume(degree):
    assert np.ptp(heights(shell_of("distance", 4, degree))) < 1e-12
    # a column of a ball shrinks with the square of the distance from the centre: layers of equal
    # height would have volumes of 1.5 to .6 of the mean. The control net only comes near the ball.
    ball = flatten_spans(build_surface(list(bodies.sphere().faces)))
    knots = bspline.clamped_knots(degree, 3)
    inward = -0.6 * ball.control_points
    layers = spaced_layers(ball.control_points, inward, degree, knots, ball)
    x = Shell(ball, layers, degree, knots).evaluate(
        0, np.full(4, 0.5), np.full(4, 0.5), bspline.breakpoints(knots)
    )
    radius = np.linalg.norm(x, axis=1)
    volumes = -np.diff(radius**3)
    assert volumes / volumes.mean() == pytest.approx(np.ones(3), abs=0.1)


@cache
def grown(name: str) -> tuple:
    surface = flatten_spans(build_surface(list(BODIES[name].faces)))
    return surface, solve_harmonic(surface, medial_axis(surface, 4000))


BODIES = {
    "box": bodies.box((3.0, 2.0, 1.0), (4, 3, 2)),
    "sphere": bodies.sphere(spans=2),
    "wedge": bodies.wedge(30.0, spans=2),
}


@pytest.mark.parametrize(
    ("name", "degree", "layers"),
    [("box", 1, 20), ("box", 6, 1), ("sphere", 1, 20), ("sphere", 4, 20), ("wedge", 4, 20)],
)
def test_any_degree_and_number_of_layers_is_proved_and_fills_the_body(name, degree, layers):
    surface, field = grown(name)
    spacing = Spacing("ratio", 1.1) if layers > 1 else Spacing()
    shell, certificate = grow_shell(
        surface, field, 0.4, layers=layers, degree_w=degree, spacing=spacing
    )
    assert certificate.valid == len(certificate) == surface.element_count * layers
    assert not any("not all elements are proved" in note for note in shell.notes)
    whole = shell.volume() + shell.inner_surface().volume()
    assert whole == pytest.approx(BODIES[name].volume, rel=1e-9)


def test_layers_evened_out_lie_between_what_was_asked_and_equal_heights():
    points = SURFACE.control_points
    displacement = 0.6 * (points.mean(axis=0) - points)
    knots = bspline.clamped_knots(3, 4)
    whole = 0.6 * np.linalg.norm(points.mean(axis=0) - points[SURFACE.patches[0].index[0, 0]])
    for evened, first in ((0.0, 0.02), (0.5, 0.5 * (0.02 + 0.25 * whole)), (1.0, 0.25 * whole)):
        layers = spaced_layers(
            points, displacement, 3, knots, SURFACE, Spacing("first", 0.02), evened=evened
        )
        assert heights(Shell(SURFACE, layers, 3, knots))[0] == pytest.approx(first, rel=1e-6)
    assert [evened for evened, _ in trials(Spacing("ratio", 2.0))] == [0.0, 0.25, 0.5, 0.75, 1.0]
    assert trials(Spacing("distance")) == [(0.0, "")]


@pytest.mark.parametrize("text", ["volume", "distance", "ratio 1.5", "first 0.25 mm"])
def test_texts_of_spacings(text):
    assert Spacing.parse(text).text == text
    assert Spacing.parse(text.split(maxsplit=1)[-1]) == Spacing.parse(text.upper())


@pytest.mark.parametrize(
    "text", ["", "thin", "-1", "0", "20", "0 mm", "1 inch", "nan", "1.5 mm mm"]
)
def test_what_is_no_spacing_is_refused(text):
    with pytest.raises(InputError):
        Spacing.parse(text)
