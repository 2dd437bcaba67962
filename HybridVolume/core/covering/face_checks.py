# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Whether what a mesher gave on faces is what was asked for. Nothing of it is believed."""

from __future__ import annotations

import numpy as np

from ...errors import FaultError, InputError
from .outline import Outline

FLAT = float(np.cos(np.radians(150.0)))
"""Corners of a larger angle than this cosine's are flat."""


def grid_quads(numbers: np.ndarray) -> np.ndarray:
    """Quads of a grid of points, (m, 4), from their numbers (a, b)."""
    return np.stack(
        [numbers[:-1, :-1], numbers[1:, :-1], numbers[1:, 1:], numbers[:-1, 1:]], axis=-1
    ).reshape(-1, 4)


def worst_corners(
    points: np.ndarray, quads: np.ndarray, rim: np.ndarray | None = None
) -> np.ndarray:
    """Smallest sine of the corners of each quad, (m,); negative where one is turned over.

    Parameters
    ----------
    points : (n, 3) array
    quads : (m, 4) int array
    rim : (k, 2) int array, optional
        Sides on the rim as the face runs along them: flat corners between two of these are left
        out.
    """
    corners = points[quads]
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    ahead = np.roll(corners, -1, axis=1) - corners
    behind = np.roll(corners, 1, axis=1) - corners
    area = np.einsum("mcd,md->mc", np.cross(ahead, behind), normal)
    length = np.linalg.norm(ahead, axis=2) * np.linalg.norm(behind, axis=2)
    sine = area / np.maximum(length, 1e-300)
    if rim is not None:
        size = int(max(quads.max(), rim.max())) + 1
        keys = quads * size + np.roll(quads, -1, axis=1)
        on_rim = np.isin(keys, rim[:, 0] * size + rim[:, 1])
        cosine = np.einsum("mcd,mcd->mc", ahead, behind) / np.maximum(length, 1e-300)
        flat = on_rim & np.roll(on_rim, 1, axis=1) & (cosine < FLAT)
        sine = np.where(flat, 1.0, sine)
    return sine.min(axis=1)


def loops_of(outline: Outline) -> np.ndarray:
    """Number of loops of each face, (nf,)."""
    pairs = np.unique(np.column_stack([outline.face, outline.loop]), axis=0)
    return np.bincount(pairs[:, 0], minlength=outline.face_count)


def check_cover(
    quads: np.ndarray,
    face: np.ndarray,
    rim: np.ndarray,
    rim_edge: np.ndarray,
    outline: Outline,
    intervals: np.ndarray,
) -> None:
    """Check that quads close a body: two at each side, in opposite directions, every edge there.

    Parameters
    ----------
    quads, face, rim, rim_edge
        As in :class:`.quad_mesh.QuadCover`.
    outline : Outline
    intervals : (ne,) int array
        Sides of quads that each edge must have.

    Raises
    ------
    FaultError
        They do not; faces are named.
    InputError
        The body touches itself in a point of a face.
    """
    count = int(quads.max()) + 1
    one, other = quads.ravel(), np.roll(quads, -1, axis=1).ravel()
    keys = one * count + other
    values, times = np.unique(keys, return_counts=True)
    bad = np.isin(keys, values[times > 1]) | ~np.isin(other * count + one, values)
    if bad.any():
        _check_pinched(outline)
        raise _fault("the quads do not close the body", np.repeat(face, 4)[bad], bad.sum())
    used = np.unique(outline.edge)
    cut = np.bincount(rim_edge, minlength=len(intervals))
    wrong = used[cut[used] != intervals[used]]
    if len(wrong):
        faces = outline.face[np.isin(outline.edge, wrong)]
        raise _fault("edges are not cut as they were to be", faces, len(wrong))
    on_rim = np.isin(np.minimum(one, other) * count + np.maximum(one, other),
                     rim[:, 0] * count + rim[:, 1])  # fmt: skip
    neighbour = np.repeat(face, 4)[np.argsort(keys)][
        np.searchsorted(np.sort(keys), other * count + one)
    ]
    across = (neighbour != np.repeat(face, 4)) & ~on_rim
    if across.any():
        raise _fault("quads cross edges", np.repeat(face, 4)[across], across.sum())
    missing = np.setdiff1d(np.arange(outline.face_count), face)
    if len(missing):
        raise _fault("faces have no quads", missing, len(missing))
    wanted = len(np.unique(outline.edges[used])) - len(used) + (2 - loops_of(outline)).sum()
    found = len(np.unique(quads)) - len(values) // 2 + len(quads)
    if found != wanted:
        _check_pinched(outline)
        raise _fault(f"the quads' Euler number is {found}, the body's {wanted}", face[:0], found)


def _check_pinched(outline: Outline) -> None:
    """A face that comes to one vertex twice, or an edge of four faces, is where walls end."""
    begin = np.where(outline.forward, *outline.edges[outline.edge].T)
    values, times = np.unique(outline.face * len(outline.vertices) + begin, return_counts=True)
    pinched = values[times > 1] // len(outline.vertices)
    crowded = outline.face[np.bincount(outline.edge)[outline.edge] > 2]
    faces = np.unique(np.concatenate([pinched, crowded]))
    if len(faces):
        raise InputError(
            "the edges of these faces touch each other where the body has no thickness",
            faces=[f"Face{k + 1}" for k in faces.tolist()],
            figure=float(len(faces)),
            remedy="move the holes or steps apart that touch, in the CAD program",
        )


def _fault(what: str, faces: np.ndarray, figure: float) -> FaultError:
    return FaultError(
        what,
        faces=[f"Face{k + 1}" for k in np.unique(faces).tolist()],
        figure=float(figure),
        remedy="please report this body",
    )
