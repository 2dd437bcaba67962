# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Random solids of voxels bent by polynomial maps: exact patches, volume and genus of the cells."""

from __future__ import annotations

import numpy as np
from patches import Body, make_body

from HybridVolume.reproduce.voxels import PolynomialMap, bent_grid, random_voxels, voxel_genus


def bent_voxels(
    seed: int,
    degree: int = 2,
    *,
    cells: np.ndarray | None = None,
    merge: bool = True,
    spans: int = 1,
    strength: float = 0.4,
    name: str = "",
) -> Body:
    """Voxel solid bent by a random polynomial map; every boundary square is an exact patch.

    Parameters
    ----------
    seed : int
        Of the voxels and of the map.
    degree : int
        Of the map and the patches.
    cells : bool array, optional
        The voxels; random ones by default.
    merge : bool
        Join neighbouring layers of voxels that are equal; a patch then has a span a voxel.
    spans : int
        Spans of a voxel's edge.
    strength : float
        How much the map bends, below 1.
    """
    cells = random_voxels(seed) if cells is None else np.asarray(cells, dtype=bool)
    bend = PolynomialMap(seed, degree, cells.shape, strength)
    grid = bent_grid(cells, bend, degrees=(degree,) * 3, spans=(spans,) * 3, merge=merge)
    # the map's own volume, not the spline's
    volume = sum(bend.volume(cell, cell + 1.0) for cell in np.argwhere(cells).astype(float))
    title = name or f"bent voxels {seed} p{degree}"
    return make_body(title, grid.faces(), volume, (voxel_genus(cells),))
