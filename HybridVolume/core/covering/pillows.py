# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Quads with two sides on one smooth edge are cut in five: their flat corner becomes two.

Such a corner is 180 degrees however fine the mesh is, and no shell can stand on it. The quad gets
a smaller one inside, joined to it by four others; its neighbours do not notice.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .outline import CORNER, Outline
from .quad_mesh import QuadCover
from .relaxing import sines

FLAT = np.radians(150.0)
"""Corners between two sides on edges count as flat from here on."""

_SHARES = (0.5, 0.4, 0.3, 0.6, 0.2)
"""How far the small quad's corners are drawn towards its middle; the best is taken."""


def pillow_flat_corners(
    cover: QuadCover, outline: Outline, kept: np.ndarray | None = None
) -> QuadCover:
    """Cut quads with a flat corner on the outline into five.

    Parameters
    ----------
    cover : QuadCover
    outline : Outline
    kept : (m,) bool array, optional
        Quads that stay as they are.

    Returns
    -------
    QuadCover
        Its new points are inside the quads, near the faces.
    """
    quads, points = cover.quads, cover.points
    sides = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=2), axis=2)
    on_rim = _rows_in(sides.reshape(-1, 2), cover.rim).reshape(-1, 4)
    angles = corner_angles(points[quads])
    flat = (angles > FLAT) & on_rim & np.roll(on_rim, 1, axis=1)
    # between chords of a coarsely cut arc the corner looks sharper than it is
    flat |= smooth_corners(cover, outline)
    if kept is not None:
        flat[kept] = False
    cut = np.flatnonzero(flat.any(axis=1))
    if not len(cut):
        return cover
    inner = _inner_corners(points[quads[cut]], flat[cut])
    count = len(points)
    new = (count + np.arange(4 * len(cut))).reshape(-1, 4)
    around = np.stack(
        [quads[cut], np.roll(quads[cut], -1, axis=1), np.roll(new, -1, axis=1), new], axis=2
    )
    kept = np.setdiff1d(np.arange(len(quads)), cut)
    all_quads = np.concatenate([quads[kept], new, around.reshape(-1, 4)])
    face = np.concatenate([cover.face[kept], cover.face[cut], np.repeat(cover.face[cut], 4)])
    order = np.argsort(
        np.concatenate([kept, cut, np.repeat(cut, 4)]), kind="stable"
    )  # every face's quads stay together
    return replace(
        cover,
        points=np.concatenate([points, inner.reshape(-1, 3)]),
        quads=all_quads[order],
        face=face[order],
    )


def smooth_corners(cover: QuadCover, outline: Outline) -> np.ndarray:
    """Corners of quads between two sides on edges that go on smoothly there, (m, 4) bool."""
    quads, count = cover.quads, len(cover.points)
    pairs = np.sort(np.stack([quads, np.roll(quads, -1, axis=1)], axis=2), axis=2)
    keys, table = (rows[..., 0] * count + rows[..., 1] for rows in (pairs, cover.rim))
    row = np.minimum(np.searchsorted(table, keys), len(table) - 1)
    ahead = np.where(table[row] == keys, cover.rim_edge[row], -1)
    behind = np.roll(ahead, 1, axis=1)
    both = (ahead >= 0) & (behind >= 0)
    # where edges of a face follow each other in a corner
    after = outline.following
    sharp = np.abs(outline.corner) > CORNER
    size = len(outline.edges)
    one, other = outline.edge[sharp], outline.edge[after[sharp]]
    meeting = (outline.face[sharp] * size + np.minimum(one, other)) * size + np.maximum(one, other)
    own = (cover.face[:, None] * size + np.minimum(ahead, behind)) * size
    own += np.maximum(ahead, behind)
    return both & ~np.isin(own, meeting)


def corner_angles(corners: np.ndarray) -> np.ndarray:
    """Angles of quads at their corners, (m, 4), rad, from their corners (m, 4, 3)."""
    ahead = np.roll(corners, -1, axis=1) - corners
    behind = np.roll(corners, 1, axis=1) - corners
    cross = np.linalg.norm(np.cross(ahead, behind), axis=2)
    return np.arctan2(cross, np.einsum("mcd,mcd->mc", ahead, behind))


def _inner_corners(corners: np.ndarray, flat: np.ndarray) -> np.ndarray:
    """Corners of the small quads, (m, 4, 3): of some positions those with the best angles."""
    middle = corners.mean(axis=1, keepdims=True)
    normal = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    trials, worst = [], []
    for share in _SHARES:
        for more in _SHARES:
            inner = corners + np.where(flat[..., None], more, share) * (middle - corners)
            around = np.stack(
                [corners, np.roll(corners, -1, 1), np.roll(inner, -1, 1), inner], axis=2
            )
            every = np.concatenate([around, inner[:, None]], axis=1)
            trials.append(inner)
            worst.append(sines(every, normal[:, None]).min(axis=(1, 2)))
    best = np.argmax(worst, axis=0)
    return np.stack(trials)[best, np.arange(len(corners))]


def _rows_in(rows: np.ndarray, table: np.ndarray) -> np.ndarray:
    """Which rows of pairs are rows of a table."""
    size = int(max(rows.max(), table.max())) + 1
    return np.isin(rows[:, 0] * size + rows[:, 1], table[:, 0] * size + table[:, 1])
