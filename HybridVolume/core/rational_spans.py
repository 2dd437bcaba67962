# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Knot spans of rational surfaces that polynomials can follow.

All layers of a shell but the outermost are polynomial (section 3.2): they stand on the polynomial
surface through the rational surface's Greville points. Between these points the two differ, and
where they differ by as much as the shell is thick, no shell holds, however thin. On a quarter of a
ring as one quadratic span the difference is a hundredth of its radius: nothing in a solid ring, a
third of the half thickness of a pipe's wall. Halving a span of degree p divides it by 2^(p+1).
"""

from __future__ import annotations

import logging

import numpy as np

from .column_state import nodal_matrix, polynomial_correction
from .front import column_frame
from .goals import local_radius
from .refinement import cut_spans
from .surface import PatchSurface

logger = logging.getLogger(__name__)

SHARE = 0.1
"""Distance between the rational surface and the polynomial one, as a share of half the body's
thickness, from which on spans are halved."""
THINNEST = 1e-3
"""Half a thickness, as a share of the diagonal, below which it is not looked for: differences that
matter only to thinner walls are left alone."""
ROUNDS = 4
"""Most halvings."""
_SAMPLES = np.linspace(0.0, 1.0, 7)


def follow_rational(surface: PatchSurface, rounds: int = ROUNDS) -> PatchSurface:
    """Halve the knot spans of rational patches that polynomials do not follow closely enough.

    Parameters
    ----------
    surface : PatchSurface
    rounds : int
        Most halvings.

    Returns
    -------
    PatchSurface
        The same surface, point for point; itself where nothing is to be done.
    """
    for _ in range(rounds):
        if not surface.rational:
            break
        off = polynomial_distance(surface)
        far = off > SHARE * THINNEST * surface.diagonal
        if not far.any():
            break
        half = local_radius(surface, column_frame(surface))
        least = np.full(surface.element_count, np.inf)
        for group in surface.groups:
            least[group.element] = half[group.index].min(axis=(1, 2))
        far &= off > SHARE * np.maximum(least, THINNEST * surface.diagonal)
        if not far.any():
            break
        bent = _residuals(surface)
        chosen = far[:, None] & (bent >= 0.5 * bent.max(axis=1, keepdims=True))
        before = surface.element_count
        surface = cut_spans(surface, 1 + chosen)
        logger.info(
            "knot spans halved where polynomials do not follow them: %d, were %d",
            surface.element_count,
            before,
        )
    return surface


def polynomial_distance(surface: PatchSurface) -> np.ndarray:
    """How far the polynomial surface through the Greville points is off each span, (ne,), mm."""
    frame = column_frame(surface)
    feet = surface.control_points + polynomial_correction(
        surface, frame.nodes, nodal_matrix(surface)
    )
    samples = surface.element_samples(_SAMPLES, _SAMPLES)
    exact = samples.surface(surface.control_points)[0]
    inner = surface.with_points(feet, polynomial=True)
    off = inner.element_samples(_SAMPLES, _SAMPLES).surface(feet)[0] - exact
    return np.linalg.norm(off, axis=-1).reshape(surface.element_count, -1).max(axis=1)


def _residuals(surface: PatchSurface) -> np.ndarray:
    """How far each span's lines along u and v are off polynomials of their degree, (ne, 2), mm."""
    found = np.zeros((surface.element_count, 2))
    degrees = np.array([patch.degrees for patch in surface.patches])[surface.element_patch]
    count = int(degrees.max()) + 4
    # Chebyshev's places: least squares there is near to the best approximation
    places = 0.5 - 0.5 * np.cos(np.pi * (np.arange(count) + 0.5) / count)
    samples = surface.element_samples(places, places)
    x = samples.surface(surface.control_points)[0]
    x = x.reshape(surface.element_count, count, count, 3)
    for way in range(2):
        lines = np.moveaxis(x, 1 + way, 1)
        for degree in np.unique(degrees[:, way]):
            rows = np.flatnonzero(degrees[:, way] == degree)
            basis = np.linalg.qr(np.vander(places, degree + 1))[0]
            part = lines[rows]
            left = part - np.einsum("sk,tk,etjc->esjc", basis, basis, part)
            found[rows, way] = np.linalg.norm(left, axis=-1).max(axis=(1, 2))
    return found
