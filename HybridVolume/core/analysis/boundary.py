# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Loads and given values on CAD faces: integrals over the exact outer boundary."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import spsolve

from .samples import BoundarySamples
from .spline_space import SplineSpace

__all__ = [
    "BoundarySamples",
    "boundary_flux",
    "boundary_load",
    "boundary_projection",
    "given_on_faces",
]


def boundary_projection(
    spline: SplineSpace, function: Callable, faces: Sequence[str] | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients whose field is nearest to a function on faces, in L2.

    Parameters
    ----------
    spline : SplineSpace
    function : callable
        Takes (m, d) points, mm, and returns (m,) or (m, c) values.
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
    for s in spline.boundary_samples(faces):
        scaled = (sparse.diags(s.measure) @ s.values).T
        matrix = matrix + scaled @ s.values
        right = right + scaled @ function(s.points)
    there = np.flatnonzero(matrix.diagonal() > 0.0)
    found = spsolve(matrix.tocsr()[there][:, there].tocsc(), right[there])
    return spline.outer[there], found.reshape(right[there].shape)


def boundary_load(
    spline: SplineSpace, traction: Callable, faces: Sequence[str] | None = None
) -> np.ndarray:
    """Integrals of a traction times each function of the space, (size, d), N.

    Parameters
    ----------
    spline : SplineSpace
    traction : callable
        Takes (m, d) points, mm, and (m, d) unit normals; returns (m, d) tractions, MPa. A pressure
        p is ``lambda x, n: -p * n``.
    faces : sequence of str, optional
        CAD faces, all by default.
    """
    total = np.zeros(spline.control_points.shape)
    for s in spline.boundary_samples(faces):
        force = traction(s.points, s.normals) * s.measure[:, None]
        total[spline.outer] += s.values.T @ force
    return total


def boundary_flux(
    spline: SplineSpace, flux: Callable, faces: Sequence[str] | None = None
) -> np.ndarray:
    """Integrals of a scalar flux times each function of the space, (size,), W.

    Parameters
    ----------
    spline : SplineSpace
    flux : callable
        Takes (m, d) points, mm, and returns (m,) values: what flows into the body, W/mm².
    faces : sequence of str, optional
        CAD faces, all by default.
    """
    total = np.zeros(spline.size)
    for s in spline.boundary_samples(faces):
        total[spline.outer] += s.values.T @ (flux(s.points) * s.measure)
    return total


def given_on_faces(
    spline: SplineSpace, given: Mapping[str, Callable], components: int = 1
) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns with given values; faces with the same function are projected together.

    Where two functions meet, on the rim of their faces, the later one holds.

    Parameters
    ----------
    spline : SplineSpace
    given : mapping of str to callable
        By CAD face: take (m, d) points, mm, and return (m,) or (m, components) values; a component
        that is nan is not given.
    components : int

    Returns
    -------
    unknown, component : (k,) int arrays
    value : (k,) array
    """
    alike: dict[Callable, list[str]] = {}
    for face, function in given.items():
        alike.setdefault(function, []).append(face)
    known = np.full((spline.size, components), np.nan)
    for function, faces in alike.items():
        unknowns, found = boundary_projection(spline, function, faces)
        found = found.reshape(len(unknowns), components)
        known[unknowns] = np.where(np.isnan(found), known[unknowns], found)
    component, unknown = np.nonzero(~np.isnan(known.T))
    return unknown, component, known[unknown, component]
