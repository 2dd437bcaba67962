# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Rational spans that polynomial layers follow, on thin rings: their volumes are formulas."""

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.column_state import ColumnSpace
from HybridVolume.core.even import Evenness, even_as_needed
from HybridVolume.core.rational_spans import SHARE, follow_rational, polynomial_distance
from HybridVolume.core.refinement import flatten_spans
from HybridVolume.core.surface import PatchSurface


def spans_of(body) -> PatchSurface:
    return even_as_needed(flatten_spans(build_surface(list(body.faces))), Evenness())


def unproved(surface: PatchSurface, height: float) -> int:
    """Elements that are not proved in a shell of straight columns of a height."""
    space = ColumnSpace(surface, None, 3)
    return int((space.certificate(space.rest + height * space.frame.direction).status < 1).sum())


@pytest.mark.parametrize("size", [1e-3])
def test_a_thin_ring_is_followed(size: float):
    body = bodies.ring(18.0 * size, 20.0 * size, 6.0 * size)
    surface = spans_of(body)
    # half the wall is 1: the polynomial through eighths of circles misses that by a fifth
    assert polynomial_distance(surface).max() > 0.2 * size
    finer = follow_rational(surface)
    assert polynomial_distance(finer).max() < SHARE * size
    assert finer.volume() == pytest.approx(np.pi * (20.0**2 - 18.0**2) * 6.0 * size**3, rel=1e-12)
    # lines that run across the wall bend nowhere: they are not cut
    assert finer.element_count <= 4 * surface.element_count
    heights = (0.2 * size, 0.5 * size)
    assert min(unproved(surface, h) for h in heights) > 0
    assert max(unproved(finer, h) for h in heights) == 0


@pytest.mark.parametrize("body", [bodies.box(), bodies.torus()], ids=["box", "torus"])
def test_bodies_without_thin_walls_stay_as_they_are(body):
    surface = spans_of(body)
    assert follow_rational(surface) is surface
