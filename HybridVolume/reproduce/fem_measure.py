# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Loads of an accuracy case on any mesh, and the errors of its answer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..core.elements import jacobians, quadrature, shape_functions, shape_gradients
from ..core.recovery import tensor, von_mises
from ..errors import FaultError
from .fem_mesh import Meshed
from .fem_problems import Problem, Traction

_POINTS = 4
"""Gauss points a direction: exact to degree 5 in tets and 6 in triangles."""
_CHUNK = 4000
_VERTEX = 1e-7
"""Largest distance of a node from the vertex that is held, as a share of the body's size."""


@dataclass(frozen=True)
class Case:
    """A problem on a mesh, ready to be solved.

    Attributes
    ----------
    problem : Problem
    mesh : Meshed
    prescribed : (n, 3) array
        Displacements that are given, mm; elsewhere not a number.
    forces : (n, 3) array
        Consistent nodal forces of tractions and weight, N.
    """

    problem: Problem
    mesh: Meshed
    prescribed: np.ndarray
    forces: np.ndarray


def prepare(problem: Problem, mesh: Meshed) -> Case:
    """Supports and loads, integrated over the elements as they are.

    Raises
    ------
    FaultError
        The mesh has no node at a vertex that is held.
    """
    nodes = mesh.nodes
    prescribed = np.full(nodes.shape, np.nan)
    for role, components in problem.held.items():
        on = mesh.face_nodes(*problem.body.named(role))
        exact = problem.displacement(nodes[on])
        for component in components:
            prescribed[on, component] = exact[:, component]
    for point, components in problem.supports:
        distance = np.linalg.norm(nodes - point, axis=1)
        at = int(np.argmin(distance))
        if distance[at] > _VERTEX * np.ptp(nodes, axis=0).max():
            raise FaultError(
                f"{mesh.name}: the node nearest to the vertex {point} is {distance[at]:.2g} mm off",
                figure=float(distance[at]),
            )
        exact = problem.displacement(nodes[at : at + 1])[0]
        prescribed[at, list(components)] = exact[list(components)]
    forces = np.zeros_like(nodes)
    weight = np.zeros_like(nodes)
    if any(problem.weight):
        weight = _weight(mesh, np.asarray(problem.weight))
        forces += weight
    for role, traction in problem.tractions.items():
        push = traction_forces(nodes, *mesh.triangles(*problem.body.named(role)), traction)
        if role == problem.balance:
            way = np.asarray(problem.weight)
            push *= -(weight.sum(axis=0) @ way) / (push.sum(axis=0) @ way)
        forces += push
    return Case(problem, mesh, prescribed, forces)


def traction_forces(
    nodes: np.ndarray, kind: str, triangles: np.ndarray, traction: Traction
) -> np.ndarray:
    """Consistent nodal forces of a traction on curved triangles, (n, 3), N."""
    points, weights = quadrature("tri", _POINTS)
    shape = shape_functions(kind, points)
    x = np.einsum("qk,tkc->tqc", shape, nodes[triangles])
    slope = jacobians(kind, nodes[triangles], points)
    area = np.cross(slope[..., 0], slope[..., 1])
    size = np.linalg.norm(area, axis=2)
    value = traction(x.reshape(-1, 3), (area / size[..., None]).reshape(-1, 3)).reshape(x.shape)
    local = np.einsum("q,tq,tqc,qk->tkc", weights, size, value, shape, optimize=True)
    return _gathered(triangles, local, len(nodes))


def _weight(mesh: Meshed, density: np.ndarray) -> np.ndarray:
    """Consistent nodal forces of a constant force on each mm³, (n, 3), N."""
    forces = np.zeros_like(mesh.nodes)
    for part in _parts(mesh):
        local = np.einsum("eq,qk->ek", part.volume, part.shape)
        forces += _gathered(part.rows, local[..., None] * density, len(mesh.nodes))
    return forces


def _gathered(rows: np.ndarray, local: np.ndarray, count: int) -> np.ndarray:
    flat = rows.ravel()
    columns = [np.bincount(flat, local[..., c].ravel(), minlength=count) for c in range(3)]
    return np.column_stack(columns)


@dataclass(frozen=True)
class _Part:
    """Some elements of one kind at their integration points."""

    rows: np.ndarray
    shape: np.ndarray
    x: np.ndarray
    volume: np.ndarray
    gradients: np.ndarray


def _parts(mesh: Meshed) -> Iterator[_Part]:
    for kind, connectivity in mesh.elements:
        points, weights = quadrature(kind.rstrip("0123456789"), _POINTS)
        shape, slope = shape_functions(kind, points), shape_gradients(kind, points)
        for start in range(0, len(connectivity), _CHUNK):
            rows = connectivity[start : start + _CHUNK]
            corner = mesh.nodes[rows]
            matrix = np.einsum("enc,qnd->eqcd", corner, slope, optimize=True)
            x = np.einsum("qn,enc->eqc", shape, corner)
            gradients = np.einsum("qnd,eqdc->eqnc", slope, np.linalg.inv(matrix), optimize=True)
            yield _Part(rows, shape, x, weights * np.linalg.det(matrix), gradients)


def measure(
    case: Case, displacement: np.ndarray, stresses: Mapping[str, np.ndarray]
) -> dict[str, Any]:
    """Errors of a solution, all in per cent.

    Parameters
    ----------
    case : Case
    displacement : (n, 3) array
        mm.
    stresses : mapping of str to (n, 6) array
        Stress at the nodes, MPa, by the way that it was found.

    Returns
    -------
    dict
        ``nodes``, ``elements``; ``displacement``: L2 norm of its error over that of the exact one,
        without rigid motions where the body floats; ``energy``: the same of the energy norm; for
        each way ``rms`` and ``max``, the error of the stress tensor at the nodes of the judged
        faces (weighted with their area for the mean square) over its largest exact norm there,
        and ``peak``, by what the largest von Mises stress found there misses the exact one.
    """
    problem, mesh = case.problem, case.mesh
    figures: dict[str, Any] = {
        "nodes": len(mesh.nodes),
        "elements": sum(len(rows) for _, rows in mesh.elements),
        **_integrals(problem, mesh, displacement),
    }
    kind, triangles = mesh.triangles(*problem.body.named(*problem.stressed))
    on, area = _node_areas(mesh.nodes, kind, triangles)
    exact = problem.stress(mesh.nodes[on])
    for way, stress in stresses.items():
        off = np.linalg.norm(tensor(stress[on] - exact), axis=(1, 2)) / problem.scale
        figures[way] = {
            "rms": 100.0 * float(np.sqrt(np.average(off**2, weights=area))),
            "max": 100.0 * float(off.max()),
            "peak": 100.0 * float(von_mises(stress[on]).max() / problem.peak - 1.0),
        }
    return figures


def _node_areas(
    nodes: np.ndarray, kind: str, triangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of triangles, and the area that each stands for: equal shares of its triangles'."""
    points, weights = quadrature("tri", 3)
    slope = jacobians(kind, nodes[triangles], points)
    size = np.linalg.norm(np.cross(slope[..., 0], slope[..., 1]), axis=2) @ weights
    on, place = np.unique(triangles, return_inverse=True)
    shares = np.repeat(size / triangles.shape[1], triangles.shape[1])
    return on, np.bincount(place.ravel(), shares)


def _integrals(problem: Problem, mesh: Meshed, displacement: np.ndarray) -> dict[str, float]:
    rigid = _Rigid() if problem.floats else None
    energy = whole = 0.0
    parts = []
    for part in _parts(mesh):
        x, volume = part.x.reshape(-1, 3), part.volume.ravel()
        u = displacement[part.rows]
        slope = np.einsum("enc,eqnd->eqcd", u, part.gradients, optimize=True).reshape(-1, 3, 3)
        strain = 0.5 * (slope + slope.swapaxes(1, 2))[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
        exact = problem.stress(x)
        off = problem.material.stress(strain) - exact
        energy += volume @ _energy_density(problem, off)
        whole += volume @ _energy_density(problem, exact)
        wrong = np.einsum("qn,enc->eqc", part.shape, u).reshape(-1, 3) - problem.displacement(x)
        parts.append((x, volume, wrong, problem.displacement(x)))
    x, volume, wrong, exact = (np.concatenate(columns) for columns in zip(*parts, strict=True))
    if rigid is not None:
        wrong, exact = rigid.without(x, volume, wrong), rigid.without(x, volume, exact)
    share = (volume @ (wrong**2).sum(axis=1)) / (volume @ (exact**2).sum(axis=1))
    return {
        "displacement": 100.0 * float(np.sqrt(share)),
        "energy": 100.0 * float(np.sqrt(energy / whole)),
    }


def _energy_density(problem: Problem, stress: np.ndarray) -> np.ndarray:
    """Twice the elastic energy of a stress, (m,)."""
    young, nu = problem.material.young, problem.material.poisson
    square = (stress[:, :3] ** 2).sum(axis=1) + 2.0 * (stress[:, 3:] ** 2).sum(axis=1)
    return ((1.0 + nu) * square - nu * stress[:, :3].sum(axis=1) ** 2) / young


class _Rigid:
    """Takes out of a field the rigid motion that is nearest to it."""

    @staticmethod
    def without(x: np.ndarray, volume: np.ndarray, field: np.ndarray) -> np.ndarray:
        """The field less its rigid motion, by volume."""
        arm = x - np.average(x, axis=0, weights=volume)
        modes = np.zeros((6, len(x), 3))
        for k in range(3):
            modes[k, :, k] = 1.0
            modes[3 + k] = np.cross(np.eye(3)[k], arm)
        flat = modes.reshape(6, -1)
        weight = np.repeat(volume, 3)
        gram, right = (flat * weight) @ flat.T, (flat * weight) @ field.ravel()
        return field - (np.linalg.solve(gram, right) @ flat).reshape(field.shape)
