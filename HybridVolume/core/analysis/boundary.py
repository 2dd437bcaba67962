# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Loads and given values on CAD faces: integrals over the exact outer boundary."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from ...errors import InputError
from ..elements import gauss_line
from .spline_space import SplineSpace

_BLOCK = 100_000
"""Places that are worked on at once, which bounds the memory."""


@dataclass(frozen=True)
class BoundarySamples:
    """Quadrature points on the outer boundary.

    Attributes
    ----------
    points, normals : (m, 3) arrays
        mm; unit normals out of the body.
    values : (m, columns) sparse matrix
        Functions of the outer boundary there.
    measure : (m,) array
        Area times the weight of the quadrature, mm².
    """

    points: np.ndarray
    normals: np.ndarray
    values: sparse.csr_matrix
    measure: np.ndarray


def boundary_samples(
    spline: SplineSpace, faces: Sequence[str] | None = None, points: int | None = None
) -> Iterator[BoundarySamples]:
    """Quadrature points on CAD faces, a block at a time.

    Parameters
    ----------
    spline : SplineSpace
    faces : sequence of str, optional
        All by default.
    points : int, optional
        Gauss points a direction; by default three more than the highest degree.

    Raises
    ------
    InputError
        There is no such face.
    """
    surface = spline.shell.surface
    chosen = np.ones(len(surface.patches), dtype=bool)
    if faces is not None:
        names = np.array([patch.face for patch in surface.patches])
        unknown = sorted(set(faces) - set(names.tolist()))
        if unknown:
            raise InputError(
                f"{', '.join(unknown)}: no such face",
                remedy=f"the body has {len(set(names.tolist()))} faces, such as {names[0]}",
            )
        chosen = np.isin(names, list(faces))
    elements = np.flatnonzero(chosen[surface.element_patch])
    x, weight = gauss_line(points or max(max(g.degrees) for g in surface.groups) + 3)
    weights = np.outer(weight, weight).ravel()
    for block in np.array_split(elements, 1 + len(elements) * len(weights) // _BLOCK):
        samples = surface.element_samples(x, x, block)
        at, along_u, along_v = samples.surface(surface.control_points)
        normal = np.cross(along_u, along_v)
        area = np.linalg.norm(normal, axis=1)
        yield BoundarySamples(
            at,
            normal / area[:, None],
            sparse.diags(1.0 / samples.weight) @ samples.weighted,
            area * np.tile(weights, len(block)),
        )


def boundary_projection(
    spline: SplineSpace, function: Callable, faces: Sequence[str] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients whose field is nearest to a function on faces, in L2.

    Parameters
    ----------
    spline : SplineSpace
    function : callable
        Takes (m, 3) points, mm, and returns (m,) or (m, c) values.
    faces : sequence of str, optional
        CAD faces, all by default.

    Returns
    -------
    unknowns : (k,) int array
        Those of the columns on these faces.
    coefficients : (k,) or (k, c) array
    """
    matrix = sparse.csr_matrix((spline.columns, spline.columns))
    right: np.ndarray | float = 0.0
    for s in boundary_samples(spline, faces):
        scaled = (sparse.diags(s.measure) @ s.values).T
        matrix = matrix + scaled @ s.values
        right = right + scaled @ function(s.points)
    there = np.flatnonzero(matrix.diagonal() > 0.0)
    found = spsolve(matrix.tocsr()[there][:, there].tocsc(), right[there])
    return spline.outer[there], found.reshape(right[there].shape)


def boundary_load(
    spline: SplineSpace, traction: Callable, faces: Sequence[str] | None = None
) -> np.ndarray:
    """Integrals of a traction times each function of the space, (size, 3), N.

    Parameters
    ----------
    spline : SplineSpace
    traction : callable
        Takes (m, 3) points, mm, and (m, 3) unit normals; returns (m, 3) tractions, MPa. A pressure
        p is ``lambda x, n: -p * n``.
    faces : sequence of str, optional
        CAD faces, all by default.
    """
    total = np.zeros((spline.size, 3))
    for s in boundary_samples(spline, faces):
        force = traction(s.points, s.normals) * s.measure[:, None]
        total[spline.outer] += s.values.T @ force
    return total
