# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The curvature by which columns are optimised is that of the energy, flat columns and all."""

from __future__ import annotations

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.column_state import ColumnSpace
from HybridVolume.core.refinement import flatten_spans


class NoField:
    """A field that draws nowhere."""

    def evaluate(self, points):
        return np.zeros(len(points)), np.ones((len(points), 3)), np.ones(len(points), dtype=bool)


@pytest.mark.parametrize("body", [bodies.plate(4.0, 3), bodies.ring()], ids=["polynomial", "arcs"])
def test_curvature_is_that_of_differences_of_gradients(body):
    surface = flatten_spans(build_surface(list(body.faces)))
    space = ColumnSpace(surface, NoField(), 3)
    spacing = space.frame.spacing.min()
    upright = space.rest + 0.3 * spacing * space.frame.direction
    rng = np.random.default_rng(1)
    k = int(np.argmax(space.frame.margin))
    stiffest = []
    for flat in (1.0, 0.1, 0.01, 0.001):
        d = upright + 0.02 * spacing * rng.normal(size=upright.shape)
        d[k] = space.rest[k] + flat * (d[k] - space.rest[k])
        energy = space.energy(d, np.zeros(len(d)), 0.0, like=upright)
        for _ in range(6):
            way = np.zeros_like(d)
            way[k] = rng.normal(size=3)
            way[k] /= np.linalg.norm(way[k])
            step = 1e-5 * spacing * flat * way.ravel()
            ahead, behind = (energy(d.ravel() + s)[1] for s in (step, -step))
            true = float(step @ (ahead - behind)) / 2.0 / float(step @ step)
            found = 0.0
            for samples, share in zip(energy.sets, energy.shares, strict=True):
                own = way[samples.index]
                stiff = samples.stiffness(d, energy.eps, share)
                found += np.einsum("eik,eij,ejk->", own, stiff, own)
            # without what couples the coordinates, and with the same for each of them
            assert 0.3 * true < found < 30.0 * true
            stiffest.append(true)
    # a bound by which the energy's convex part alone would be far too soft on arcs
    assert max(stiffest) > (1e6 if surface.rational else 0.5) * min(stiffest)
