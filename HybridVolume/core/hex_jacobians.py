# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Proved positivity, volume and quality of curved hexahedra of 20 nodes.

In Bernstein form they are elements of degree two in each direction, which are judged as those of
the shell are.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from .bezier import BezierElements
from .elements import jacobians, quadrature, shape_functions
from .validity import certify
from .validity import scaled_jacobian as bezier_scaled_jacobian


def bezier_hexahedra(coordinates: np.ndarray) -> BezierElements:
    """The same hexahedra in Bernstein form, of degree two in each direction.

    Parameters
    ----------
    coordinates : (ne, 20, 3) array
        mm

    Returns
    -------
    BezierElements
        Their first node lies at the origin, so that nothing is rounded by where they are.
    """
    local = coordinates - coordinates[:, :1]
    points = (local.transpose(0, 2, 1) @ _to_bernstein()).transpose(0, 2, 1)
    number = np.arange(len(coordinates))
    return BezierElements(
        (2, 2, 2), points.reshape(-1, 3, 3, 3, 3), None, number, np.zeros_like(number)
    )


@cache
def _to_bernstein() -> np.ndarray:
    """Matrix (20, 27) from the nodes of a hexahedron to its control points."""
    line = np.array([0.0, 0.5, 1.0])
    lattice = np.stack(np.meshgrid(line, line, line, indexing="ij"), axis=-1).reshape(-1, 3)
    values = shape_functions("hex20", lattice).reshape(3, 3, 3, 20)
    one = np.array([[1.0, 0.0, 0.0], [-0.5, 2.0, -0.5], [0.0, 0.0, 1.0]])
    return np.einsum("ai,bj,ck,ijkn->nabc", one, one, one, values).reshape(20, 27)


def prove_hexahedra(coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Whether det J > 0 everywhere in each element, and a lower bound of it.

    Parameters
    ----------
    coordinates : (ne, 20, 3) array
        mm

    Returns
    -------
    status : (ne,) int array
        1: proved; -1: negative somewhere; 0: neither.
    lower_bound : (ne,) array
        mm³; -inf where there is none.
    """
    if not len(coordinates):
        return np.zeros(0, dtype=int), np.zeros(0)
    elements = bezier_hexahedra(coordinates)
    certificate = certify([elements])
    # the certificate's bound is one over the mean lengths of the control polygons
    size = np.ones(len(coordinates))
    for axis in (1, 2, 3):
        steps = np.linalg.norm(np.diff(elements.control_points, axis=axis), axis=4)
        size *= steps.sum(axis=axis).mean(axis=(1, 2))
    return certificate.status.astype(int), certificate.min_bernstein * size * (1.0 - 1e-12)


def hexahedron_volumes(coordinates: np.ndarray) -> np.ndarray:
    """Signed volume of each element, (ne,), mm³; exact but for rounding."""
    # det J is of degree five in each direction
    points, weights = quadrature("hex", 3)
    local = coordinates - coordinates[:, :1]
    return np.linalg.det(jacobians("hex20", local, points)) @ weights


def hexahedron_quality(coordinates: np.ndarray) -> np.ndarray:
    """Smallest scaled Jacobian of each element over 6³ points, (ne,); 1 for a box."""
    if not len(coordinates):
        return np.zeros(0)
    return bezier_scaled_jacobian([bezier_hexahedra(coordinates)])
