# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Kept facets as an even triangle complex that tetrahedra can have as inner faces (section 5)."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from .contacts import join_contacts
from .curves import smooth_curves
from .embedding import FOLD, make_embeddable
from .given import Given
from .pieces import in_pieces
from .remesh import Remesher
from .sheets import Midstructure

log = logging.getLogger(__name__)

# Rounds of splits, collapses, flips and smoothing.
ROUNDS = 6
# In the second half of them: triangles with a smaller angle are collapsed, degrees; and what comes
# nearer than this share of the wanted length touches.
POOR = 15.0
CONTACT = 0.15


@dataclass(frozen=True)
class Complex:
    """Even triangles in place of the kept facets, and what they do not reach.

    Attributes
    ----------
    vertices : (m, 3) array
        mm.
    triangles : (f, 3) int array
        They meet only in shared vertices and edges.
    rest : (k, 3) array
        Points of lines and specks of the midstructure, mm.
    rest_radius : (k,) array
        Distance to the surface there, mm.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    rest: np.ndarray
    rest_radius: np.ndarray


def resample(
    midstructure: Midstructure,
    size: Callable[[np.ndarray], np.ndarray],
    boundary: tuple[np.ndarray, np.ndarray],
) -> Complex:
    """Even triangles for the kept facets.

    Vertices nearer than a share of the wanted length become one; then edges are split, collapsed
    and flipped, and vertices smoothed within their sheets and along rims, seams and creases
    (section 5). Triangles that cross each other or the boundary, where that cannot be mended, are
    left out.

    Parameters
    ----------
    midstructure : Midstructure
        Triangles, lines (a, b, b) and points (a, a, a).
    size : callable
        Wanted edge length, mm, where the surface is (k,) mm away.
    boundary : (vertices (n, 3), triangles (t, 3))
        The closed triangles that will surround it, mm.
    """
    given = Given(in_pieces(midstructure, boundary), size)
    mesh = given.coarse()
    dropped = 0
    if len(mesh.t):
        _even(mesh, given)
        dropped = make_embeddable(mesh, given, boundary)
    rest, radius = given.rest(mesh)
    log.info(
        "midstructure: %d facets became %d triangles and %d balls, %d triangles were left out",
        int(midstructure.kept.sum()),
        len(mesh.t),
        len(rest),
        dropped,
    )
    return Complex(mesh.x, mesh.t, rest, radius)


def _even(mesh: Remesher, given: Given) -> None:
    """Make triangles even, on the given facets."""
    mesh.relax(given.back)
    mesh.unfold(FOLD)
    curves = smooth_curves(mesh, given.back)
    back_to_curve = (lambda points: curves.closest(points)[0]) if len(curves) else given.back
    mesh.collapse()
    for k in range(ROUNDS):
        late = k >= ROUNDS // 2
        mesh.split()
        if late:
            join_contacts(mesh, CONTACT)
        mesh.collapse(rounds=6, worst=POOR if late else 0.0)
        mesh.flip()
        mesh.smooth(given.back, back_to_curve)
    mesh.move(given.back(mesh.x))
