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
import scipy.sparse.linalg as sparse_linalg

from .boundary_surface import BoundarySurface
from .elements import gauss_line, jacobians, quadrature, shape_functions, shape_gradients

logger = logging.getLogger(__name__)

_CHUNK = 20_000
_EXACT, _NEAR = 1e-3, 5e-3
"""Remaining traction as a share of the stress at which a simple load is taken at once, and at
which the best plain one is taken: workbenches spread forces over curved faces not quite evenly."""
_FLAT = 1e-6
"""Difference of the normals of a plane."""
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
        MPa, at the surface's points, along the three axes of their frames; nan where not known.
    kinds : tuple of str
        By face: "free", "pressure", "force", "mixed" (pressure and force), "linear" (a pressure
        that is linear in the position, and a force), "sliding" (a plane without shear), "uneven"
        (of any shape, on a surface without sharp edges), or "unknown".
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
    shared = np.bincount(surface.point_node, minlength=len(force))
    shared[surface.others] += 1
    traction = np.full((len(surface.point_node), 3), np.nan)
    kinds = []
    for face in range(surface.faces):
        points = np.flatnonzero(surface.point_face == face)
        rows = surface.point_node[points]
        inner = rows[shared[rows] == 1]
        pressure = surface.pressure[points]
        frame, normal = surface.frame[points], surface.normal[points]
        if np.isfinite(pressure).all():
            kinds.append("pressure" if pressure.any() else "free")
            traction[points] = -pressure[:, None] * [0.0, 0.0, 1.0]
            continue
        kind, value = "unknown", None
        area = surface.node_area[inner]
        unsure = np.sqrt(np.mean(noise[inner] ** 2 / area) / np.mean(area)) if len(inner) else 0.0
        if len(inner) and unsure < _NEAR * level[face]:
            measure = _Measure(force[inner], area, unsure, level[face])
            kind, value = measure.simplest(_models(surface, points, inner))
            if value is None and np.ptp(normal, axis=0).max() < _FLAT:
                across = force[inner] - (force[inner] @ normal[0])[:, None] * normal[0]
                if measure.left(across / np.sqrt(area)[:, None]) <= _EXACT:
                    kind, traction[points, :2] = "sliding", 0.0
        if value is not None:
            traction[points] = np.einsum("pkc,pc->pk", frame, value)
        kinds.append(kind)
    if "unknown" in kinds:
        _add_uneven(surface, force, noise, level, shared, traction, kinds)
    logger.debug("loads of the faces: %s", kinds)
    return FaceLoads(traction, tuple(kinds))


def _add_uneven(
    surface: BoundarySurface,
    force: np.ndarray,
    noise: np.ndarray,
    level: np.ndarray,
    shared: np.ndarray,
    traction: np.ndarray,
    kinds: list[str],
) -> None:
    """Solve for tractions of any shape on surfaces without sharp edges; changes the last two.

    There each node's force is a share of one surface's traction only, and the equations say it all.
    """
    whole = surface.whole if surface.whole is not None else surface
    seen = np.bincount(whole.point_node, minlength=len(force))
    # as many points as nodes, and no other face touches them
    split = (seen[whole.point_node] > 1) | np.isin(whole.point_node, surface.others)
    sharp = np.bincount(whole.point_face, split, minlength=whole.faces) > 0
    inside = {face for face, kind in enumerate(kinds) if kind == "unknown"}
    joined = np.full(len(force), -1)
    joined[whole.point_node] = whole.point_face
    parts = {joined[surface.point_node[surface.point_face == face][0]] for face in inside}
    for part in sorted(parts):
        points = np.flatnonzero(whole.point_face == part)
        nodes = whole.point_node[points]
        faces = [face for face in inside if joined[_a_node(surface, face)] == part]
        area = surface.node_area[nodes]
        unsure = np.sqrt(np.mean(noise[nodes] ** 2 / area) / np.mean(area))
        if sharp[part] or unsure >= _NEAR * min(level[face] for face in faces):
            continue
        mass = whole.mass[nodes][:, points].tocsc()
        found = np.full((len(force), 3), np.nan)
        found[nodes] = sparse_linalg.splu(mass).solve(force[nodes])
        for face in faces:
            own = surface.point_face == face
            value = found[surface.point_node[own]]
            traction[own] = np.einsum("pkc,pc->pk", surface.frame[own], value)
            kinds[face] = "uneven"


def _a_node(surface: BoundarySurface, face: int) -> int:
    """Some node of a face."""
    return int(surface.point_node[np.argmax(surface.point_face == face)])


class _Measure:
    """How well tractions explain the forces on the nodes inside one face."""

    def __init__(self, force: np.ndarray, area: np.ndarray, unsure: float, level: float) -> None:
        self.root = np.sqrt(area)[:, None]
        self.wanted = force / self.root
        self.unsure, self.level = unsure, max(level, np.finfo(float).tiny)

    def left(self, rest: np.ndarray) -> float:
        """Mean remaining traction beyond the noise, as a share of the stress.

        ``rest`` are forces over the root of the nodes' areas.
        """
        mean = np.sqrt(np.mean(np.sum(rest**2, axis=1)) / np.mean(self.root**2))
        return max(0.0, mean - 2.0 * self.unsure) / self.level

    def simplest(
        self, models: Iterator[tuple[str, np.ndarray, np.ndarray]]
    ) -> tuple[str, np.ndarray | None]:
        """Kind and tractions (np, 3) of the simplest load that fits; None if none does."""
        best: tuple[float, str, np.ndarray] | None = None
        equations = 3 * len(self.wanted)
        for kind, basis, forces in models:
            unknowns = basis.shape[1]
            if unknowns and equations < _MARGIN * unknowns + 3:
                continue
            rest, value = self.wanted, np.zeros((len(basis), 3))
            if unknowns:
                act = (forces / self.root[..., None]).transpose(0, 2, 1).reshape(-1, unknowns)
                found = np.linalg.lstsq(act, self.wanted.ravel(), rcond=1e-8)[0]
                rest = self.wanted - (act @ found).reshape(-1, 3)
                value = np.einsum("pkc,k->pc", basis, found)
            left = self.left(rest)
            if best is None or left < 0.5 * best[0]:
                best = (left, kind, value)
            if best[0] <= _EXACT:
                break
        if best is None or best[0] > (_NEAR if best[1] in _PLAIN else _EXACT):
            return "unknown", None
        return best[1:]


def _models(
    surface: BoundarySurface, points: np.ndarray, inner: np.ndarray
) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Simple tractions on a face, the simplest first.

    Yields
    ------
    kind : str
    tractions : (np, k, 3) array
        At the face's points, of k unknowns.
    forces : (ni, k, 3) array
        On the nodes inside, of the same.
    """
    count = len(points)
    yield "free", np.zeros((count, 0, 3)), np.zeros((len(inner), 0, 3))
    normal = surface.normal[points][:, None, :]
    even, linear = (forces[inner] for forces in surface.pressure_forces)
    even = even[:, None, :]
    yield "pressure", normal, even
    # a solver presses on the triangles; who gives exact tractions presses along exact normals
    own = surface.mass[inner][:, points]
    yield "pressure", normal, (own @ normal[:, 0])[:, None, :]
    axes = np.broadcast_to(np.eye(3), (count, 3, 3))
    whole = np.asarray(surface.mass[inner].sum(axis=1)).ravel()
    shares = whole[:, None, None] * np.eye(3)
    yield "force", axes, shares
    basis, forces = np.concatenate([normal, axes], axis=1), np.concatenate([even, shares], axis=1)
    yield "mixed", basis, forces
    place = surface.position[points]
    middle, size = place.mean(axis=0), max(np.ptp(place, axis=0).max(), np.finfo(float).tiny)
    liquid = ((place - middle) / size)[:, :, None] * normal
    forces = np.concatenate([(linear - middle[:, None] * even) / size, forces], axis=1)
    yield "linear", np.concatenate([liquid, basis], axis=1), forces
