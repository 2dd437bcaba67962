# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Points and derivatives of NURBS surfaces."""

from __future__ import annotations

import numpy as np

from .. import bspline
from ..surface import SplineFace


def evaluate(face: SplineFace, uv: np.ndarray, derivative: int = 0) -> list[np.ndarray]:
    """Points of a face at m places, and first (and second) derivatives.

    Parameters
    ----------
    face : SplineFace
    uv : (m, 2) array
    derivative : {0, 1, 2}

    Returns
    -------
    list of (m, 3) array
        The point; along u, v; along uu, uv, vv.
    """
    orders = [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)][: (1, 3, 6)[derivative]]
    tables = [
        [
            bspline.basis_functions(degree, knots, x, order)
            for order in range(min(derivative, 2) + 1)
        ]
        for degree, knots, x in zip(face.degrees, face.knots, np.asarray(uv).T, strict=True)
    ]
    rows = np.concatenate([face.control_points * face.weights[..., None],
                           face.weights[..., None]], axis=2)  # fmt: skip
    first = [table[0][0] for table in tables]
    local = rows[
        first[0][:, None, None] + np.arange(face.degrees[0] + 1)[:, None],
        first[1][:, None, None] + np.arange(face.degrees[1] + 1),
    ]
    across = np.matmul(
        np.stack([values for _, values in tables[0]], axis=1), local.reshape(*local.shape[:2], -1)
    ).reshape(len(local), len(tables[0]), face.degrees[1] + 1, 4)
    value = {(a, b): np.matmul(tables[1][b][1][:, None], across[:, a])[:, 0] for a, b in orders}
    weight = value[0, 0][:, 3:]
    x = value[0, 0][:, :3] / weight
    found = [x]
    if derivative:
        u, v = ((value[key][:, :3] - value[key][:, 3:] * x) / weight for key in ((1, 0), (0, 1)))
        found += [u, v]
    if derivative == 2:
        for key, (one, other) in zip(
            ((2, 0), (1, 1), (0, 2)), (((1, 0), (1, 0)), ((1, 0), (0, 1)), ((0, 1), (0, 1))),
            strict=True,
        ):  # fmt: skip
            slopes = {(1, 0): u, (0, 1): v}
            found.append(
                (
                    value[key][:, :3]
                    - value[key][:, 3:] * x
                    - value[one][:, 3:] * slopes[other]
                    - value[other][:, 3:] * slopes[one]
                )
                / weight
            )
    return found
