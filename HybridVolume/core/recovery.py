# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Strain and stress at the nodes, straight from the displacements.

CalculiX extrapolates the stress of 15-node wedges from nine Gauss points that see the triangle as
linear; at the boundary, where stress counts, most of the accuracy of the element is lost by that.
Here the strain is the derivative of the displacement at the node itself, averaged over the elements
around it that are of one material.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .elements import jacobians, reference, shape_gradients

COMPONENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Order of the components of strain and stress; shear strains are those of the tensor."""

_CHUNK = 20_000


@dataclass(frozen=True)
class Material:
    """An isotropic linear elastic material.

    Attributes
    ----------
    young : float
        Young's modulus, MPa.
    poisson : float
        Poisson's ratio, in (-1, .5).

    Raises
    ------
    InputError
        A value is out of its range.
    """

    young: float
    poisson: float

    def __post_init__(self) -> None:
        if not 0.0 < self.young < np.inf:
            raise InputError(
                f"Young's modulus is {self.young:g} MPa", remedy="give the material one above 0"
            )
        if not -1.0 < self.poisson < 0.5:
            raise InputError(
                f"Poisson's ratio is {self.poisson:g}", remedy="give the material one below 0.5"
            )

    def stress(self, strain: np.ndarray) -> np.ndarray:
        """Stress of a strain, both (..., 6) in the order of `COMPONENTS`, MPa."""
        shear = self.young / (2.0 * (1.0 + self.poisson))
        lame = self.young * self.poisson / ((1.0 + self.poisson) * (1.0 - 2.0 * self.poisson))
        stress = 2.0 * shear * np.asarray(strain, dtype=float)
        stress[..., :3] += lame * np.sum(strain[..., :3], axis=-1, keepdims=True)
        return stress


@dataclass(frozen=True)
class NodalStress:
    """Strain and stress at nodes of one material.

    Attributes
    ----------
    nodes : (m,) int array
        Numbers of the nodes, sorted.
    strain, stress : (m, 6) array
        In the order of `COMPONENTS`; stress in MPa.
    """

    nodes: np.ndarray
    strain: np.ndarray
    stress: np.ndarray

    @property
    def von_mises(self) -> np.ndarray:
        """Equivalent stress, (m,), MPa."""
        return von_mises(self.stress)

    @property
    def principal(self) -> np.ndarray:
        """Principal stresses, largest first, (m, 3), MPa."""
        return np.linalg.eigvalsh(tensor(self.stress))[:, ::-1]


def tensor(components: np.ndarray) -> np.ndarray:
    """Symmetric tensors (m, 3, 3) of (m, 6) components."""
    return np.asarray(components)[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Equivalent stress of (m, 6) components, (m,)."""
    normal, shear = stress[:, :3], stress[:, 3:]
    deviator = normal - normal.mean(axis=1, keepdims=True)
    return np.sqrt(1.5 * np.sum(deviator**2, axis=1) + 3.0 * np.sum(shear**2, axis=1))


def element_strain(
    kind: str, nodes: np.ndarray, connectivity: np.ndarray, displacement: np.ndarray
) -> np.ndarray:
    """Strain of every element at each of its nodes.

    Parameters
    ----------
    kind : str
        Of `HybridVolume.core.elements`, e.g. ``"penta15"``.
    nodes, displacement : (n, 3) arrays
        mm.
    connectivity : (ne, k) int array

    Returns
    -------
    (ne, k, 6) array
    """
    places = reference(kind).nodes
    gradients = shape_gradients(kind, places)
    parts = [np.zeros((0, len(places), 6))]
    for start in range(0, len(connectivity), _CHUNK):
        rows = connectivity[start : start + _CHUNK]
        # dx/dxi and du/dxi at the same places; du/dx = du/dxi dxi/dx
        x = jacobians(kind, nodes[rows], places)
        u = np.einsum("enc,mnd->emcd", displacement[rows], gradients, optimize=True)
        slope = np.einsum("emcd,emdk->emck", u, np.linalg.inv(x))
        symmetric = 0.5 * (slope + np.swapaxes(slope, 2, 3))
        parts.append(symmetric[..., [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    return np.concatenate(parts)


def recover(
    nodes: np.ndarray,
    elements: Sequence[tuple[str, np.ndarray]],
    displacement: np.ndarray,
    material: Material,
) -> NodalStress:
    """Strain and stress at the nodes of all elements of one material.

    Parameters
    ----------
    nodes, displacement : (n, 3) arrays
        mm.
    elements : sequence of (str, (ne, k) int array)
        Kinds and connectivities.
    material : Material

    Returns
    -------
    NodalStress

    Raises
    ------
    InputError
        There are displacements for another number of nodes, or some are not finite.
    """
    nodes, displacement = np.asarray(nodes, dtype=float), np.asarray(displacement, dtype=float)
    if displacement.shape != nodes.shape:
        raise InputError(
            f"{len(displacement)} displacements do not belong to {len(nodes)} nodes",
            remedy="take the result of this mesh",
        )
    used = [np.unique(connectivity) for _, connectivity in elements]
    used = np.unique(np.concatenate([np.zeros(0, dtype=int), *used]))
    if not np.isfinite(displacement[used]).all():
        raise InputError(
            "some displacements are not finite numbers",
            figure=float(np.count_nonzero(~np.isfinite(displacement[used]).all(axis=1))),
            remedy="look at the solver's messages and at the supports",
        )
    total, count = np.zeros((len(nodes), 6)), np.zeros(len(nodes))
    for kind, connectivity in elements:
        strain = element_strain(kind, nodes, connectivity, displacement)
        flat = connectivity.ravel()
        count += np.bincount(flat, minlength=len(nodes))
        for component in range(6):
            total[:, component] += np.bincount(
                flat, strain[..., component].ravel(), minlength=len(nodes)
            )
    strain = total[used] / count[used, None]
    return NodalStress(used, strain, material.stress(strain))
