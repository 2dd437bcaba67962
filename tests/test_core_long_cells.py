# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Needles of thin cores under long cells: plates whose volumes are known."""

import bodies
import numpy as np
import pytest
from shells import shell_towards

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.density import Density
from HybridVolume.core.finite_elements import build_finite_elements


def plate(size: float, spans: tuple[int, int, int]):
    """Shell of a plate of 24 x 24 x 1 that leaves a core of .35 between its sides."""
    middle = np.array([12.0, 12.0, 0.5]) * size
    left = np.array([23.0 / 24.0, 23.0 / 24.0, 0.35])
    body = bodies.box((24.0 * size, 24.0 * size, size), spans)
    surface = build_surface(list(body.faces))
    return shell_towards(surface, lambda x: middle + left * (x - middle))


@pytest.mark.parametrize("size", [1e-3])
def test_long_cells_at_needles_are_cut_across(size: float):
    shell = plate(size, (2, 8, 1))
    _, _, before = build_finite_elements(shell, finest=1)
    _, _, after = build_finite_elements(shell)
    # edges of 12, 3 and .35 at right angles: 2 ** .5 * 3 * .35 / 12 ** 2 = .010
    assert before.min_scaled_jacobian < 0.0115
    assert before.repairs["refined"] == 0
    assert after.min_scaled_jacobian > 1.5 * before.min_scaled_jacobian
    assert after.repairs["refined"] > 0
    for mesh in (before, after):
        assert mesh.volume == pytest.approx(576.0 * size**3, rel=1e-10)
    # no strip is cut of which no cell is long
    assert len(after.boundary) <= 4 * len(before.boundary)


def test_a_density_that_is_wished_for_is_kept():
    shell = plate(1.0, (2, 8, 1))
    _, _, mesh = build_finite_elements(shell, Density(layers=2))
    assert mesh.repairs["refined"] == 0
    assert len(mesh.boundary) == 2 * (2 * 16 + 2 * 2 + 2 * 8)
