# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How well core and shell meet: the gap between them, and what linear fields make of it."""

from __future__ import annotations

import numpy as np

from .coupling import CollocationSpace, NitscheSpace
from .poisson import solve_poisson


def gap_figures(space: CollocationSpace | NitscheSpace) -> dict[str, float]:
    """Gap between the core's faces and the inner boundary of the shell, over the interface.

    Both are compared at the same parameters, so that a distance along the boundary counts, too.
    Faces of degree k keep the gap O(h^(k+1)).

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace

    Returns
    -------
    dict
        ``h``: root of the interface's area over the number of its faces (in the plane: length over
        number), mm; ``rms`` and ``largest`` distance, mm; ``volume``: signed volume between both,
        mm³, positive where the faces lie inside the shell; ``transfer``: largest distance by which
        a node on the interface misses the shell's own point, mm.
    """
    faces = space.tets.face_samples()
    shell = space.spline.basis_at(faces.patch, faces.uv, faces.w) @ space.spline.control_points
    step = faces.points - shell
    size = faces.measure.sum()
    distance = np.linalg.norm(step, axis=1)
    core = space.tets
    place = core.interface_patch, core.interface_uv, core.interface_w
    missed = space.spline.basis_at(*place) @ space.spline.control_points
    missed -= core.nodes[core.interface]
    return {
        "h": float((size / len(core.faces)) ** (1.0 / (core.dimension - 1))),
        "rms": float(np.sqrt((distance**2 * faces.measure).sum() / size)),
        "largest": float(distance.max()),
        "volume": float((step * faces.normal).sum(axis=1) @ faces.measure),
        "transfer": float(np.linalg.norm(missed, axis=1).max()),
    }


def patch_deviation(
    space: CollocationSpace | NitscheSpace, slope: np.ndarray | None = None
) -> tuple[float, float]:
    """How far the solution of a linear problem is from the linear field that solves it.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
    slope : (d,) array, optional
        Gradient of the field; by default one that no direction of the axes is alike in.

    Returns
    -------
    float, float
        Deviation in L2 over the field's (about its mean over the outer boundary) and in the H1
        seminorm over the field's.
    """
    dim = space.dimension
    slope = np.array([0.9, -0.4, 1.3])[:dim] if slope is None else np.asarray(slope, dtype=float)
    middle = space.spline.control_points[space.spline.outer].mean(axis=0)

    def exact(x: np.ndarray) -> np.ndarray:
        return (x - middle) @ slope

    def gradient(x: np.ndarray) -> np.ndarray:
        return np.broadcast_to(slope, x.shape)

    found = solve_poisson(space, lambda x: np.zeros(len(x)), exact)
    off = np.array(found.errors(exact, gradient))
    # the errors of nothing are the norms of the field
    nothing = type(found)(space, np.zeros(space.size))
    return tuple((off / nothing.errors(exact, gradient)).tolist())
