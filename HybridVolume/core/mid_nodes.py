# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Where mid nodes stand on faces whose own derivative vanishes somewhere."""

from __future__ import annotations

import numpy as np

from .columns import evaluate_columns
from .elements import jacobians, reference
from .interior import Interface
from .shell import Shell

_OFF_CENTRE = 0.05
"""Share of the edges from which on a mid node is moved."""
_SHARES = 0.5 + np.linspace(-0.2, 0.2, 17)
"""Where a mid node may stand between the ends of its edge, in parameters."""
_OPEN = 0.1
"""Smallest over mean area at a triangle's nodes that is enough."""
_SWEEPS = 6
"""Most rounds over the mid nodes around corners that are closed."""


def outer_mids(
    shell: Shell, interface: Interface, mids: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places of the outer mid nodes; on singular faces such that the triangles there are open.

    Returns
    -------
    mids : (e, 3) array
        mm
    patch : (e,) int array
    uv : (e, 2) array
        Parameters on that patch.
    """
    mids, patch, uv = mids.copy(), interface.edge_patch.copy(), interface.edge_uv.copy()
    flags = shell.surface.singular_flags.any(axis=(1, 2))
    if flags.any():
        singular = np.unique(shell.surface.element_patch[flags])
        _centre(shell, interface, mids, patch, uv, singular)
        _open(shell, interface, mids, patch, uv, singular)
    return mids, patch, uv


def _centre(
    shell: Shell,
    interface: Interface,
    mids: np.ndarray,
    edge_patch: np.ndarray,
    edge_uv: np.ndarray,
    singular: np.ndarray,
) -> None:
    """Move outer mid nodes of singular patches that stand far from the middle of their edge.

    They stay on the CAD face, and on its sides. Where the surface's derivative vanishes at an end
    the middle in parameters is a quarter of the way, and a quadratic element that has its mid node
    there is singular. The arrays are changed in place.
    """
    row, side, patch, uv = _edges(interface)
    outer = np.zeros(1)
    start, end = (evaluate_columns(shell, patch, uv[:, k], outer)[0] for k in (0, 1))
    middle, chord = 0.5 * (start + end), end - start
    length = np.linalg.norm(chord, axis=1)
    way = mids - middle
    off = np.abs(np.einsum("ei,ei->e", way, chord)) / np.maximum(length, 1e-300) ** 2
    # sides run along u or v; on a diagonal what is off in either direction counts, by the sides
    diagonal = (uv[:, 0] != uv[:, 1]).all(axis=1)
    tip = evaluate_columns(shell, interface.vertex_patch, interface.vertex_uv, outer)[0]
    tip = tip[interface.triangles[row, (side + 2) % 3]]
    frame = np.stack([tip - start, tip - end], axis=2)
    shares = np.linalg.pinv(frame[diagonal]) @ way[diagonal][..., None]
    off[diagonal] = np.abs(shares).max(axis=(1, 2))
    chosen = np.flatnonzero((off > _OFF_CENTRE) & np.isin(patch, singular))
    if not len(chosen):
        return
    # the place of the edge's rectangle that is nearest to the middle, by ever smaller grids
    steps = np.linspace(-0.5, 0.5, 17)
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2)
    low, high = uv[chosen].min(axis=1), uv[chosen].max(axis=1)
    place, width = 0.5 * (low + high), high - low
    for _ in range(8):
        tries = np.clip(place[:, None] + grid * width[:, None], low[:, None], high[:, None])
        points = evaluate_columns(
            shell, np.repeat(patch[chosen], len(grid)), tries.reshape(-1, 2), outer
        )[0].reshape(len(chosen), -1, 3)
        best = np.linalg.norm(points - middle[chosen][:, None], axis=2).argmin(axis=1)
        rows = np.arange(len(chosen))
        place, width = tries[rows, best], 0.25 * width
    mids[chosen] = points[rows, best]
    edge_patch[chosen] = patch[chosen]
    edge_uv[chosen] = place


def _open(
    shell: Shell,
    interface: Interface,
    mids: np.ndarray,
    edge_patch: np.ndarray,
    edge_uv: np.ndarray,
    singular: np.ndarray,
) -> None:
    """Move mid nodes along their edges until triangles in corners of 0 degrees are open.

    Two sides that touch in a corner have quadratic ones that touch, or cross, where the mid nodes
    stand half-way. Nearer to the corner on one of them, farther from it on the other, they open the
    triangle, and stay on the CAD face and its sides. The arrays are changed in place.
    """
    outer = np.zeros(1)
    ends = evaluate_columns(
        shell, interface.vertex_patch, interface.vertex_uv, np.array([0.0, 1.0])
    )
    corners, columns = ends[0], ends[1] - ends[0]
    columns /= np.maximum(np.linalg.norm(columns, axis=1, keepdims=True), 1e-300)
    places = reference("tri6").nodes

    def openness(rows: np.ndarray, middles: np.ndarray) -> np.ndarray:
        """Smallest over mean area across the columns at nodes, for mid nodes (..., m, 3, 3).

        Only the columns tell: in a corner of 0 degrees the sides' planes may have any direction.
        """
        own = interface.triangles[rows]
        nodes = np.broadcast_to(corners[own], middles.shape)
        nodes = np.concatenate([nodes, middles], axis=-2)
        j = jacobians("tri6", nodes.reshape(-1, 6, 3), places)
        normal = np.cross(j[..., 0], j[..., 1]).reshape(*middles.shape[:-2], 6, 3)
        ways = columns[own]
        ways = np.concatenate([ways, 0.5 * (ways + np.roll(ways, -1, axis=-2))], axis=-2)
        along = -np.einsum("...nc,...nc->...n", normal, ways)
        return along.min(axis=-1) / np.maximum(np.abs(along).mean(axis=-1), 1e-300)

    own = interface.triangle_edges
    near = np.flatnonzero(np.isin(interface.triangle_patch, singular))
    closed = near[openness(near, mids[own[near]]) < _OPEN]
    if not len(closed):
        return
    edges = np.unique(own[closed])
    _, _, patch, uv = _edges(interface)
    tries = uv[edges, :1] + _SHARES[:, None] * (uv[edges, 1:] - uv[edges, :1])
    points = evaluate_columns(
        shell, np.repeat(patch[edges], len(_SHARES)), tries.reshape(-1, 2), outer
    )[0].reshape(len(edges), -1, 3)
    beside = [np.flatnonzero((own == edge).any(axis=1)) for edge in edges]
    away = np.abs(_SHARES - 0.5)
    for _ in range(_SWEEPS):
        moved = False
        for k, edge in enumerate(edges.tolist()):
            rows = beside[k]
            middles = np.tile(mids[own[rows]], (len(_SHARES) + 1, 1, 1, 1))
            middles[:-1][:, own[rows] == edge] = points[k][:, None]
            found = openness(rows, middles).min(axis=1)
            best = int(np.argmax(np.minimum(found[:-1], _OPEN) - 1e-3 * away))
            if min(found[best], _OPEN) > min(found[-1], _OPEN) + 1e-6:
                mids[edge], edge_patch[edge] = points[k][best], patch[edge]
                edge_uv[edge], moved = tries[k][best], True
        if not moved:
            break


def _edges(interface: Interface) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """A triangle of each edge, its side there, its patch, and the ends' parameters, (e, 2, 2)."""
    _, first = np.unique(interface.triangle_edges, return_index=True)
    row, side = np.divmod(first, 3)
    ends = [interface.triangle_uv[row, side], interface.triangle_uv[row, (side + 1) % 3]]
    return row, side, interface.triangle_patch[row], np.stack(ends, axis=1)
