# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Evening out: spans of the size, shape and turn that are asked, on the very same surface."""

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.even import Evenness, even_out, span_figures
from HybridVolume.errors import InputError


def same_points(one, other):
    line = np.linspace(0.0, 1.0, 7)
    u, v = (a.ravel() for a in np.meshgrid(line, line))
    worst = 0.0
    for k, patch in enumerate(one.patches):
        at = [t[0] + s * (t[-1] - t[0]) for t, s in zip(patch.knots, (u, v), strict=True)]
        rows = np.full(len(u), k)
        worst = max(worst, np.abs(one.evaluate_at(rows, *at) - other.evaluate_at(rows, *at)).max())
    return worst


@pytest.mark.parametrize("body", [bodies.torus(), bodies.hollow_sphere(), bodies.plate(4.0, 2)])
@pytest.mark.parametrize("size", [0.9, 0.4])
def test_no_side_is_longer_than_asked(body, size):
    surface = build_surface(list(body.faces))
    even = even_out(surface, Evenness(size=size))
    figures = span_figures(even)
    assert figures.longest <= size * (1 + 1e-9)
    assert figures.spans > span_figures(surface).spans
    assert same_points(surface, even) < 1e-13 * surface.diagonal
    # not finer than need be: some side is longer than half of it
    assert figures.longest > 0.5 * size


def test_normals_turn_as_little_as_asked():
    # a quarter of the torus's tube turns by 90 degrees: eight spans of 11.25
    surface = build_surface(list(bodies.torus().faces))
    even = even_out(surface, Evenness(turn=12.0))
    assert 5.0 < span_figures(even).turn <= 12.0
    assert same_points(surface, even) < 1e-13 * surface.diagonal


def test_long_spans_become_rounder_and_nothing_else_is_cut():
    surface = build_surface(list(bodies.box((12.0, 1.0, 1.0), (1, 1, 1)).faces))
    assert span_figures(surface).aspect == pytest.approx(12.0)
    even = even_out(surface, Evenness(aspect=2.0))
    assert span_figures(even).aspect <= 2.0 + 1e-9
    # 12 is cut into six parts along the four long faces only
    assert span_figures(even).spans == 4 * 6 + 2
    assert even_out(even, Evenness(aspect=2.0)) is even


def test_what_cannot_be_is_refused():
    surface = build_surface(list(bodies.torus().faces))
    with pytest.raises(InputError, match="more than"):
        even_out(surface, Evenness(size=1e-3))
    for wrong in ({"size": -1.0}, {"aspect": 1.5}, {"turn": 0.1}, {"size": np.inf}):
        with pytest.raises(InputError):
            Evenness(**wrong)
