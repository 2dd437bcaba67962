# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Shells of higher degree and the same volume, for analysis.

A field over the shell has the degrees of its faces: over bilinear faces it converges no faster than
with linear elements, whatever the core does. Degree elevation is exact, so only the functions
become more.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from .. import bspline
from ..shell import Shell
from ..surface import Patch, PatchSurface


def elevated_shell(shell: Shell, degree: int) -> Shell:
    """Raise the degrees of a shell's patches along the surface, exactly.

    Parameters
    ----------
    shell : Shell
    degree : int
        Least degree along u and v; directions of a higher degree stay as they are, and so does the
        degree through the thickness.

    Returns
    -------
    Shell
        The same volume, point for point; the same object where nothing is to be raised. Its levels
        belong to columns of the given shell and are left out.
    """
    surface = shell.surface
    if all(min(patch.degrees) >= degree for patch in surface.patches):
        return shell
    lines: dict[tuple[int, bytes], tuple[np.ndarray, np.ndarray]] = {}

    def raised(p: int, knots: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        key = (p, knots.tobytes())
        if key not in lines:
            lines[key] = bspline.elevation_matrix(p, knots, max(degree - p, 0))
        return lines[key]

    along = [[raised(p, knots) for p, knots in zip(patch.degrees, patch.knots, strict=True)]
             for patch in surface.patches]  # fmt: skip
    shapes = [tuple(len(matrix) for matrix, _ in both) for both in along]
    grids, count = surface.shared_grid(shapes)
    layers = np.empty((len(shell.layers), count, 3))
    patches = []
    # patches give the points that they share to a rounding: the lowest patch's stay
    for k in reversed(range(len(surface.patches))):
        patch, ((left, knots_u), (right, knots_v)) = surface.patches[k], along[k]
        weights = left @ patch.weights @ right.T
        if not patch.rational:
            # sums of equal weights may miss them by a rounding
            weights = np.full(weights.shape, patch.weights[0, 0])
        inside = shell.layers[:, patch.index]
        inside = np.concatenate([inside[:1] * patch.weights[..., None], inside[1:]])
        fine = np.einsum("ai,bj,kijd->kabd", left, right, inside, optimize=True)
        fine[0] /= weights[..., None]
        layers[:, grids[k]] = fine
        degrees = tuple(max(p, degree) for p in patch.degrees)
        patches.append(Patch(patch.face, degrees, (knots_u, knots_v), grids[k], weights))
    outer = PatchSurface(
        layers[0],
        tuple(reversed(patches)),
        surface.neighbour,
        surface.reversed,
        surface.shell_of_patch,
        surface.moved,
        np.ones(len(patches), dtype=bool),
        surface.turned,
    )
    nothing = np.zeros(0)
    return replace(shell, surface=outer, layers=layers, level=nothing, goal=nothing)
