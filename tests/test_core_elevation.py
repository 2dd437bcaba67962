# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Shells of a higher degree: the same volume, and functions that a coarse face does not have."""

import bodies
import numpy as np
import pytest
import shells

from HybridVolume.core.analysis.elevation import elevated_shell
from HybridVolume.core.analysis.refine import refine_shell
from HybridVolume.core.analysis.spline_space import SplineSpace
from HybridVolume.core.assembly import build_surface


@pytest.mark.parametrize(("name", "degree"), [("box", 3), ("torus", 3), ("hollow sphere", 5)])
def test_the_volume_stays_point_for_point(name, degree):
    shell = shells.make_shell(name)
    raised = elevated_shell(shell, degree)
    assert {p.degrees for p in raised.surface.patches} == {(degree, degree)}
    assert elevated_shell(raised, degree) is raised
    random = np.random.default_rng(5)
    for other in (raised, refine_shell(raised, 2)):
        for k in range(len(shell.surface.patches)):
            u, v, w = random.random((3, 20))
            off = other.evaluate(k, u, v, w) - shell.evaluate(k, u, v, w)
            assert np.abs(off).max() < 1e-13 * shell.surface.diagonal
    # neighbours still share their columns
    assert raised.surface.genus == shell.surface.genus
    assert raised.surface.volume() == pytest.approx(shell.surface.volume(), rel=1e-12)


def test_bilinear_faces_get_quadratic_fields():
    def faces():
        for number, face in enumerate(bodies.box((3.0, 2.0, 1.0), (1, 1, 1)).faces):
            corners = face.control_points[:: face.degrees[0], :: face.degrees[1]]
            knots = np.array([0.0, 0.0, 1.0, 1.0])
            yield type(face)(f"Face{number}", (1, 1), (knots, knots), corners, np.ones((2, 2)))

    def off(shell):
        """Of the quadratic field that is nearest on the top and bottom faces."""
        space = SplineSpace(shell)
        patch = np.repeat(np.arange(6), 50)
        uv, w = np.random.default_rng(2).random((300, 2)), np.zeros(300)
        basis = space.basis_at(patch, uv, w).toarray()[:, space.outer]
        x = basis @ space.control_points[space.outer]
        field = x[:, 0] * x[:, 1] - x[:, 2] ** 2
        best, *_ = np.linalg.lstsq(basis, field, rcond=None)
        return np.abs(basis @ best - field).max()

    surface = build_surface(list(faces()))
    shell = shells.shell_towards(surface, lambda x: x + 0.5 * ([1.5, 1.0, 0.5] - x), layers=1)
    assert off(shell) > 0.05
    assert off(elevated_shell(shell, 2)) < 1e-12
