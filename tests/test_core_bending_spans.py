# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A box around a ball-shaped cavity: six faces of one bilinear span each cannot bend around it."""

from dataclasses import replace

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.bending_spans import bending_spans, grown_again
from HybridVolume.core.growth import grow_shell
from HybridVolume.core.harmonic import solve_harmonic
from HybridVolume.core.midstructure import medial_axis
from HybridVolume.core.refinement import flatten_spans


def test_a_box_with_a_round_cavity_reaches_its_level():
    outer = bodies.box((20.0, 20.0, 20.0), (1, 1, 1), degree=1)
    ball = bodies.hollow_sphere(20.0, 6.0)
    # the faces of the hollow ball's cavity come first
    inner = [replace(face, control_points=face.control_points + 10.0) for face in ball.faces[:6]]
    surface = flatten_spans(build_surface([*outer.faces, *inner]))
    volume = 8000.0 - 4.0 / 3.0 * np.pi * 6.0**3
    assert surface.volume() == pytest.approx(volume, rel=1e-12)
    field = solve_harmonic(surface, medial_axis(surface, 12_000), tets=8_000)

    def grow(body):
        return grow_shell(body, field, 0.5)

    first = grow(surface)
    assert first[0].w0 < 0.42
    finer, shell, certificate = grown_again(surface, first, 0.5, grow)
    assert shell.w0 > 0.47
    assert certificate.all_valid
    assert shell.surface is finer
    # four spans a face of the box, the ball as it was; not a point of either has moved
    assert finer.element_count == surface.element_count + 3 * 6
    assert finer.volume() == pytest.approx(volume, rel=1e-12)


def test_what_is_near_its_level_or_can_bend_stays():
    surface = flatten_spans(build_surface(list(bodies.sphere().faces)))
    assert bending_spans(surface) is surface
    shell = type("Near", (), {"w0": 0.49})()
    assert grown_again(surface, (shell, None), 0.5, lambda body: 1 / 0)[1] is shell
