# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Points and derivatives of many patches at once."""

from __future__ import annotations

import numpy as np

from ..bezier import bernstein
from ..surface import ElementGroup, PatchSurface

# So many numbers are held at once.
CHUNK = 4_000_000


def evaluate_points(
    surface: PatchSurface, patch: np.ndarray, uv: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points of any patches, without a loop over the patches.

    Parameters
    ----------
    surface : PatchSurface
    patch : (m,) int array
    uv : (m, 2) array
        Parameters in [0, 1]².

    Returns
    -------
    x, x_u, x_v : (m, 3) arrays
        Points, mm, and their derivatives.
    """
    element = _elements(surface, patch, uv)
    place = np.full(surface.element_count, -1)
    result = np.empty((3, len(patch), 3))
    for group in surface.groups:
        place[:] = -1
        place[group.element] = np.arange(len(group.element))
        mine = np.flatnonzero(place[element] >= 0)
        step = max(1, CHUNK // (8 * group.index[0].size))
        for first in range(0, len(mine), step):
            rows = mine[first : first + step]
            result[:, rows] = _in_group(surface, group, place[element[rows]], uv[rows])
    return result[0], result[1], result[2]


def _elements(surface: PatchSurface, patch: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Element that each point lies in."""
    low = np.empty((surface.element_count, 2))
    for group in surface.groups:
        low[group.element] = group.low
    owner = surface.element_patch
    first = np.searchsorted(owner, np.arange(len(surface.patches) + 1))
    # elements run over u, then v: those of the first row tell v, the number of them the stride
    along_v = np.flatnonzero(low[:, 0] == low[first[owner], 0])
    stride = np.bincount(owner[along_v], minlength=len(surface.patches))
    along_u = np.flatnonzero(low[:, 1] == low[first[owner], 1])
    start = np.searchsorted(owner[along_u], np.arange(len(surface.patches)))
    place = []
    for rows, column, begin in (
        (along_u, 0, start),
        (along_v, 1, np.concatenate([[0], np.cumsum(stride)[:-1]])),
    ):
        # patches lie two apart on one line
        line = 2.0 * owner[rows] + low[rows, column]
        at = np.searchsorted(line, 2.0 * patch + uv[:, column], side="right") - 1
        place.append(np.maximum(at - begin[patch], 0))
    return first[patch] + place[0] * stride[patch] + place[1]


def _in_group(
    surface: PatchSurface, group: ElementGroup, row: np.ndarray, uv: np.ndarray
) -> np.ndarray:
    """x, x_u, x_v, (3, m, 3), of points in the given elements of one group."""
    size = group.high[row] - group.low[row]
    t = (uv - group.low[row]) / size
    basis = []
    for axis, extraction in enumerate((group.extraction_u, group.extraction_v)):
        degree = group.degrees[axis]
        for derivative in (0, 1):
            values = bernstein(degree, t[:, axis], derivative)
            values = np.einsum("mi,mij->mj", values, extraction[row])
            basis.append(values / size[:, axis : axis + 1] if derivative else values)
    u, du, v, dv = basis
    weights = group.weights[row]
    points = surface.control_points[group.index[row]]
    homogeneous = np.concatenate([points * weights[..., None], weights[..., None]], axis=-1)
    half = np.einsum("ma,mabd->mbd", u, homogeneous)
    value = np.einsum("mb,mbd->md", v, half)
    second = np.einsum("mb,mbd->md", dv, half)
    first = np.einsum("mb,mbd->md", v, np.einsum("ma,mabd->mbd", du, homogeneous))
    w = value[:, 3:]
    x = value[:, :3] / w
    return np.stack(
        [x, (first[:, :3] - x * first[:, 3:]) / w, (second[:, :3] - x * second[:, 3:]) / w]
    )
