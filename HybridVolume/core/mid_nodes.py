# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Where mid nodes stand on faces whose own derivative vanishes somewhere."""

from __future__ import annotations

import numpy as np

from .columns import evaluate_columns
from .interior import Interface
from .shell import Shell

_OFF_CENTRE = 0.05
"""Share of the edges from which on a mid node is moved."""


def outer_mids(
    shell: Shell, interface: Interface, mids: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places of the outer mid nodes; on singular faces nearer to the middle of their edge.

    Returns
    -------
    mids : (e, 3) array
        mm
    patch : (e,) int array
    uv : (e, 2) array
        Parameters on that patch.
    """
    mids, patch, uv = mids.copy(), interface.edge_patch.copy(), interface.edge_uv.copy()
    _centre(shell, interface, mids, patch, uv)
    return mids, patch, uv


def _centre(
    shell: Shell,
    interface: Interface,
    mids: np.ndarray,
    edge_patch: np.ndarray,
    edge_uv: np.ndarray,
) -> None:
    """Move outer mid nodes of singular faces that stand far from the middle of their edge.

    They stay on the CAD face, and on its sides. Where the surface's derivative vanishes at an end
    the middle in parameters is a quarter of the way, and a quadratic element that has its mid node
    there is singular. The arrays are changed in place.
    """
    flags = shell.surface.singular_flags.any(axis=(1, 2))
    if not flags.any():
        return
    _, first = np.unique(interface.triangle_edges, return_index=True)
    row, side = np.divmod(first, 3)
    patch = interface.triangle_patch[row]
    uv = np.stack(
        [interface.triangle_uv[row, side], interface.triangle_uv[row, (side + 1) % 3]], axis=1
    )
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
    singular = np.unique(shell.surface.element_patch[flags])
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
