# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Functions of a space at quadrature points: what spaces of shells and cores hand to assembly.

All arrays hold for bodies in space (d = 3) and in the plane (d = 2; mm² for mm³, mm for mm²).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse


@dataclass(frozen=True)
class Samples:
    """Functions of a space at quadrature points of some elements.

    Attributes
    ----------
    element : (ne,) int array
        Numbers of the elements, as in `Shell.element_patch` for a space over the shell's layers.
    unknowns : (ne, nl) int array
        Unknowns whose functions do not vanish there.
    points : (ne, nq, d) array
        mm
    values : (ne, nq, nl) array
    gradients : (ne, nq, d, nl) array
        1/mm
    measure : (ne, nq) array
        det J times the weight of the quadrature, mm³.
    """

    element: np.ndarray
    unknowns: np.ndarray
    points: np.ndarray
    values: np.ndarray
    gradients: np.ndarray
    measure: np.ndarray

    @property
    def dimension(self) -> int:
        """2 in the plane, 3 in space."""
        return self.points.shape[-1]


@dataclass(frozen=True)
class BoundarySamples:
    """Quadrature points on the outer boundary.

    Attributes
    ----------
    points, normals : (m, d) arrays
        mm; unit normals out of the body.
    values : (m, columns) sparse matrix
        Functions of the outer boundary there, those of the unknowns ``outer`` of the space.
    measure : (m,) array
        Area times the weight of the quadrature, mm².
    """

    points: np.ndarray
    normals: np.ndarray
    values: sparse.csr_matrix
    measure: np.ndarray


@dataclass(frozen=True)
class FaceSamples:
    """Functions of the core at m quadrature points on the interface.

    Attributes
    ----------
    patch : (m,) int array
    uv : (m, d - 1) array
        Where the shell is beside them: parameters on the patch,
    w : (m,) array
        and through the shell.
    points : (m, d) array
        The quadrature points themselves, on the core's side, mm.
    values : (m, size) sparse matrix
    gradients : d (m, size) sparse matrices
        1/mm
    normal : (m, d) array
        Unit normals out of the core.
    measure : (m,) array
        Area times the weight of the quadrature, mm².
    bound : (m,) array
        C_F: the integral of a squared slope over the face is at most C_F times that of the
        squared gradient over its element, 1/mm.
    """

    patch: np.ndarray
    uv: np.ndarray
    w: np.ndarray
    points: np.ndarray
    values: sparse.csr_matrix
    gradients: tuple[sparse.csr_matrix, ...]
    normal: np.ndarray
    measure: np.ndarray
    bound: np.ndarray

    @property
    def slopes(self) -> sparse.csr_matrix:
        """Derivatives along the normals, (m, size) sparse matrix, 1/mm."""
        return sum(
            sparse.diags(n) @ gradient
            for n, gradient in zip(self.normal.T, self.gradients, strict=True)
        ).tocsr()
