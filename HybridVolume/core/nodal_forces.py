# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Loads of a solved body, found again in its displacements.

The forces by which the elements hold each node are its load: none inside, a consistent share of the
traction on the boundary. Most faces carry a simple one (none, a pressure, a force in one direction,
the pressure of a liquid), which a few numbers describe exactly; these are fitted to the forces on
the nodes inside the face. Faces that nothing simple fits, such as supports, stay unknown.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from .boundary_surface import BoundarySurface
from .elements import gauss_line, jacobians, quadrature, shape_functions, shape_gradients

logger = logging.getLogger(__name__)

_CHUNK = 20_000
_EXACT, _NEAR = 2e-3, 2e-2
"""Remaining traction as a share of the stress at which a simple load is taken at once, and at
which the best one is taken. A workbench spreads a force over curved faces to within a percent."""
_PLAIN = ("free", "pressure", "force")
"""Loads that are taken when they are near; with more unknowns supports would look like loads."""
_MARGIN = 2.0
"""Equations an unknown of a load, besides those of one node."""


def solver_points(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Points and weights by which CalculiX integrates the stiffness of an element.

    Forces from the displacements are in equilibrium with the loads by these only.

    Returns
    -------
    points : (m, 3) array
    weights : (m,) array
    """
    if kind.startswith("hex"):
        return quadrature("hex", 2 if kind == "hex8" else 3)
    if kind == "tet4":
        return np.full((1, 3), 0.25), np.full(1, 1.0 / 6.0)
    if kind == "tet10":
        near, far = (5.0 - 5.0**0.5) / 20.0, (5.0 + 3.0 * 5.0**0.5) / 20.0
        points = np.full((4, 3), near)
        points[[1, 2, 3], [0, 1, 2]] = far
        return points, np.full(4, 1.0 / 24.0)
    triangle = np.full((1, 2), 1.0 / 3.0)
    if kind == "penta15":
        triangle = np.array([[1.0, 1.0], [4.0, 1.0], [1.0, 4.0]]) / 6.0
    height, weight = gauss_line(2 if kind == "penta6" else 3)
    points = np.column_stack(
        [np.tile(triangle, (len(height), 1)), np.repeat(height, len(triangle))]
    )
    return points, np.repeat(weight, len(triangle)) * 0.5 / len(triangle)


@dataclass(frozen=True)
class NodalForces:
    """What the elements exert on the nodes.

    Attributes
    ----------
    force : (n, 3) array
        N, by which the elements would move; the load of a node in equilibrium.
    weight : (n,) array
        Integral of each node's shape function, mm³: its share of a constant body force.
    moment : (n, 3) array
        Integral of the shape function times the position, mm⁴: its share of a linear one.
    """

    force: np.ndarray
    weight: np.ndarray
    moment: np.ndarray


def nodal_forces(
    nodes: np.ndarray,
    elements: Sequence[tuple[str, np.ndarray]],
    displacement: np.ndarray,
    stress_of: Callable[[np.ndarray], np.ndarray],
) -> NodalForces:
    """Forces on the nodes of elements under given displacements.

    Parameters
    ----------
    nodes, displacement : (n, 3) arrays
        mm.
    elements : sequence of (str, (ne, k) int array)
    stress_of : callable
        Stress (..., 6), MPa, of a strain (..., 6), both in the order of
        `HybridVolume.core.recovery.COMPONENTS`.
    """
    force, weight, moment = np.zeros((len(nodes), 3)), np.zeros(len(nodes)), np.zeros_like(nodes)

    def add(target: np.ndarray, rows: np.ndarray, values: np.ndarray) -> None:
        np.add.at(target, rows.ravel(), values.reshape(-1, *target.shape[1:]))

    for kind, connectivity in elements:
        points, weights = solver_points(kind)
        values, slopes = shape_functions(kind, points), shape_gradients(kind, points)
        for start in range(0, len(connectivity), _CHUNK):
            rows = connectivity[start : start + _CHUNK]
            matrix = jacobians(kind, nodes[rows], points)
            inverse = np.linalg.inv(matrix)
            share = np.linalg.det(matrix) * weights
            slope = np.einsum("enc,qnd->eqcd", displacement[rows], slopes) @ inverse
            symmetric = 0.5 * (slope + np.swapaxes(slope, 2, 3))
            stress = stress_of(symmetric[..., [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
            full = stress[..., [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(*stress.shape[:2], 3, 3)
            # sum over points of dN/dx sigma
            flow = np.einsum("eqdk,eqck,eq->eqdc", inverse, full, share)
            add(force, rows, np.einsum("qnd,eqdc->enc", slopes, flow))
            add(weight, rows, share @ values)
            place = np.einsum("qn,enc->eqc", values, nodes[rows])
            add(moment, rows, np.einsum("qn,eqc,eq->enc", values, place, share))
    return NodalForces(force, weight, moment)


def without_body_force(forces: NodalForces, inside: np.ndarray) -> np.ndarray:
    """Forces less those of a body force that is linear in the position, found inside the body.

    Weight and centrifugal forces are of this kind.

    Parameters
    ----------
    forces : NodalForces
    inside : (m,) int array
        Nodes that no face touches.

    Returns
    -------
    (n, 3) array, N
    """
    basis = np.column_stack([forces.weight, forces.moment])
    if len(inside) <= basis.shape[1]:
        return forces.force
    scale = np.abs(basis[inside]).max(axis=0)
    scale[scale == 0.0] = 1.0
    found = np.linalg.lstsq(basis[inside] / scale, forces.force[inside], rcond=1e-10)[0]
    return forces.force - basis / scale @ found


@dataclass(frozen=True)
class FaceLoads:
    """Tractions on a boundary surface, as far as they are simple.

    Attributes
    ----------
    traction : (np, 3) array
        MPa, at the surface's points; nan where it is not known.
    kinds : tuple of str
        By face: "free", "pressure", "force", "mixed", "linear", or "unknown".
    """

    traction: np.ndarray
    kinds: tuple[str, ...]


def face_loads(
    surface: BoundarySurface, force: np.ndarray, noise: np.ndarray, level: np.ndarray
) -> FaceLoads:
    """Simple tractions that explain the forces on the nodes inside each face.

    Parameters
    ----------
    surface : BoundarySurface
    force : (n, 3) array
        N, on the nodes of the mesh, without body forces.
    noise : (n,) array
        Error of the forces that is expected from the digits of the displacements, N.
    level : (nf,) array
        Stress to compare with by face, MPa.
    """
    mass, size = surface.mass, surface.node_area
    shared = np.bincount(surface.point_node, minlength=mass.shape[0])
    shared[surface.others] += 1
    traction = np.full((len(surface.point_node), 3), np.nan)
    kinds = []
    for face in range(surface.faces):
        points = np.flatnonzero(surface.point_face == face)
        rows = surface.point_node[points]
        inner = rows[shared[rows] == 1]
        best: tuple[float, str, np.ndarray] | None = None
        if len(inner):
            own = mass[inner][:, points]
            root = np.sqrt(size[inner])[:, None, None]
            wanted = force[inner] / root[..., 0]
            allowed = np.sqrt(np.mean(noise[inner] ** 2 / size[inner]) / np.mean(size[inner]))
            for kind, basis in _models(surface.position[points], surface.normal[points]):
                unknowns = basis.shape[1]
                if 3 * len(inner) < _MARGIN * unknowns + 3 * (unknowns > 0):
                    continue
                rest, value = wanted, np.zeros((len(points), 3))
                if unknowns:
                    act = (own @ basis.reshape(len(points), -1)).reshape(-1, unknowns, 3)
                    act = (act / root).transpose(0, 2, 1).reshape(-1, unknowns)
                    found = np.linalg.lstsq(act, wanted.ravel(), rcond=1e-8)[0]
                    rest = wanted - (act @ found).reshape(-1, 3)
                    value = np.einsum("pkc,k->pc", basis, found)
                # a mean traction that remains: forces over roots of areas, over a root of an area
                left = np.sqrt(np.mean(np.sum(rest**2, axis=1)) / np.mean(size[inner]))
                left = max(0.0, left - 2.0 * allowed) / max(level[face], 1e-300)
                if best is None or left < 0.5 * best[0]:
                    best = (left, kind, value)
                if best[0] <= _EXACT:
                    break
        if best is not None and best[0] <= (_NEAR if best[1] in _PLAIN else _EXACT):
            traction[points] = best[2]
            kinds.append(best[1])
        else:
            kinds.append("unknown")
    logger.debug("loads of the faces: %s", kinds)
    return FaceLoads(traction, tuple(kinds))


def _models(position: np.ndarray, normal: np.ndarray) -> Iterator[tuple[str, np.ndarray]]:
    """Simple tractions, (np, k, 3) for k unknowns each, the simplest first."""
    count = len(position)
    yield "free", np.zeros((count, 0, 3))
    pressure = normal[:, None, :]
    yield "pressure", pressure
    axes = np.broadcast_to(np.eye(3), (count, 3, 3))
    yield "force", axes
    yield "mixed", np.concatenate([pressure, axes], axis=1)
    place = position - position.mean(axis=0)
    place = place / max(np.abs(place).max(), 1e-300)
    liquid = place[:, :, None] * normal[:, None, :]
    yield "linear", np.concatenate([pressure, liquid, axes], axis=1)
