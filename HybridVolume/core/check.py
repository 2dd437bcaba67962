# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Refusal of surfaces that no shell can follow, before any work is done on them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .. import errors
from .cones import most_inward
from .front import column_frame
from .surface import PatchSurface

MARGIN = 5e-3
"""Smallest n . d at which a direction d counts as inward of a normal n."""


def check_surface(surface: PatchSurface) -> None:
    """Refuse patches that no shell can follow: folded, singular, or without an inward direction.

    A straight column has one direction at each place, so the inward normals of a knot span, and
    those of all patches at a control point, must leave one direction that is inward for all.

    Raises
    ------
    SingularSurfaceError
        Naming the faces, with the place in parameters.
    """
    x = np.linspace(0.0, 1.0, 9)
    samples = surface.element_samples(x, x)
    _, x_u, x_v = samples.surface(surface.control_points)
    normals = -np.cross(x_u, x_v).reshape(-1, samples.count, 3)
    size = np.linalg.norm(normals, axis=2)
    singular = size.min(axis=1) < 1e-6 * size.max(axis=1)
    unit = normals / np.maximum(size, 1e-300)[..., None]
    mean = unit.mean(axis=1)
    margin = np.einsum("eki,ei->ek", unit, mean).min(axis=1)
    doubtful = np.flatnonzero((margin < 0.1) & ~singular)
    if len(doubtful):
        found = most_inward(unit[doubtful], np.ones((len(doubtful), samples.count), dtype=bool))
        margin[doubtful] = np.einsum("eki,ei->ek", unit[doubtful], found).min(axis=1)
    bad = singular | (margin <= MARGIN)
    if bad.any():
        raise _singular(surface, np.flatnonzero(bad), singular, size, x)
    frame = column_frame(surface)
    stuck = np.flatnonzero(frame.margin <= MARGIN)
    if len(stuck):
        faces = [p.face for p in surface.patches if np.isin(p.index, stuck).any()]
        where = ", ".join(f"({a:.4g}, {b:.4g}, {c:.4g})" for a, b, c in frame.nodes[stuck[:3]])
        raise errors.SingularSurfaceError(
            f"no direction is inward for all faces that meet at {where} mm"
            f" (best n . d = {frame.margin[stuck].min():.2g})",
            faces=_unique(faces),
            figure=float(frame.margin[stuck].min()),
            remedy="open the corner or split the body there",
        )


def _singular(
    surface: PatchSurface, bad: np.ndarray, singular: np.ndarray, size: np.ndarray, x: np.ndarray
) -> errors.SingularSurfaceError:
    places: dict[str, str] = {}
    for group in surface.groups:
        for row in np.flatnonzero(np.isin(group.element, bad)):
            element = group.element[row]
            face = surface.patches[group.patch[row]].face
            if face in places:
                continue
            i, j = np.unravel_index(size[element].argmin(), (len(x), len(x)))
            u, v = group.low[row] + np.array([x[i], x[j]]) * (group.high[row] - group.low[row])
            what = "the derivative vanishes" if singular[element] else "the normal turns over"
            places[face] = f"{what} near u = {u:.4g}, v = {v:.4g}"
    faces = sorted(places, key=lambda name: (len(name), name))
    return errors.SingularSurfaceError(
        f"{len(bad)} knot spans are folded or singular, no shell can follow them"
        f" ({places[faces[0]]} of {faces[0]})",
        faces=faces,
        figure=float(len(bad)),
        remedy="rebuild these faces with a regular parametrisation",
    )


def _unique(names: Sequence[str]) -> list[str]:
    return sorted(set(names), key=lambda name: (len(name), name))
