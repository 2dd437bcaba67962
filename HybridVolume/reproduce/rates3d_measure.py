# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Problems solved on hybrid volumes and on tets alone, and the errors of their answers."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..core.analysis import linear
from ..core.analysis.assembly import elastic, load, stiffness
from ..core.analysis.coupling import CollocationSpace, NitscheSpace
from ..core.analysis.elasticity import solve_elasticity
from ..core.analysis.poisson import solve_poisson
from ..core.analysis.simplex_space import SimplexSpace, lattice
from ..core.analysis.spline_space import SplineSpace
from ..core.recovery import Material
from ..errors import FaultError
from .fem_measure import traction_forces
from .fem_mesh import Meshed
from .rates3d_problems import Problem

MORE = 3
"""Gauss points a direction beyond the degree, with which errors are integrated."""


@dataclass(frozen=True)
class Part:
    """Some elements of an answer.

    Attributes
    ----------
    space : SplineSpace or SimplexSpace
    coefficients : (size, components) array
    """

    space: SplineSpace | SimplexSpace
    coefficients: np.ndarray


def errors(parts: Mapping[str, Part], problem: Problem) -> dict[str, float]:
    """Errors over the elements as they are, as shares of the norms of the exact solution.

    Returns
    -------
    dict
        ``l2``; ``h1``, of the seminorm; ``energy``; ``volume`` of the elements, mm³; and, of more
        than one part, the shares of each in the square of the error of energy, ``energy_NAME``.

    Raises
    ------
    FaultError
        A figure is not finite, or an element has no volume.
    """
    off = {name: np.zeros(3) for name in parts}
    norm, volume = np.zeros(3), 0.0
    for name, part in parts.items():
        for s in part.space.samples(part.space.degree + MORE):
            if not s.measure.min() > 0.0:
                raise FaultError("an element is turned inside out", figure=float(s.measure.min()))
            x = s.points.reshape(-1, 3)
            shape = (*s.measure.shape, problem.components)
            inside = part.coefficients[s.unknowns]
            exact = problem.exact(x).reshape(shape)
            slope = problem.slope(x).reshape(*shape, 3)
            value = s.values @ inside - exact
            gradient = np.swapaxes(s.gradients @ inside[:, None], 2, 3) - slope
            for total, u, du in ((off[name], value, gradient), (norm, exact, slope)):
                total += [
                    ((u**2).sum(axis=2) * s.measure).sum(),
                    ((du**2).sum(axis=(2, 3)) * s.measure).sum(),
                    (problem.energy(du) * s.measure).sum(),
                ]
            volume += float(s.measure.sum())
    both = sum(off.values())
    found = np.sqrt(both / norm)
    if not np.isfinite(found).all():
        raise FaultError("an error is not finite")
    shares = {}
    if len(parts) > 1 and both[2] > 0.0:
        shares = {f"energy_{name}": float(one[2] / both[2]) for name, one in off.items()}
    names = dict(zip(("l2", "h1", "energy"), found.tolist(), strict=True))
    return {**names, "volume": volume, **shares}


def rigid_energy(space: CollocationSpace | NitscheSpace, material: Material) -> float:
    """Largest energy of a rigid motion, as a share of that of a stretch of the same size."""
    spline, core = space.spline.control_points, space.tets.nodes
    if isinstance(space, CollocationSpace):
        core = core[space.free_nodes]
    x = np.concatenate([spline, core])
    x = x - x.mean(axis=0)
    matrix = space.elasticity(material, material)
    motions = [np.broadcast_to(way, x.shape) * np.ptp(x) for way in np.eye(3)]
    motions += [np.cross(way, x) for way in np.eye(3)]
    flat = [motion.T.ravel() for motion in (x, *motions)]
    stretch, *found = (abs(float(u @ (matrix @ u))) for u in flat)
    return max(found) / stretch


def solved(
    space: CollocationSpace | NitscheSpace, problem: Problem
) -> tuple[dict[str, Any], np.ndarray]:
    """Solve on a hybrid volume; errors, number of unknowns and seconds.

    Returns
    -------
    figures : dict
        Of :func:`errors`, with ``unknowns``, ``unknowns_shell``, ``seconds``, ``seconds_cpu``, and
        ``solver``: figures of the linear solver.
    values : (size, ...) array
        The answer.
    """
    started = time.perf_counter(), time.process_time()
    if problem.components == 1:
        found = solve_poisson(
            space,
            lambda x: problem.source(x)[:, 0],
            lambda x: problem.exact(x)[:, 0],
        )
    else:
        pressed, held = _roles(space.spline, problem)
        found = solve_elasticity(
            space,
            problem.material,
            fixed=dict.fromkeys(held, problem.exact),
            tractions=dict.fromkeys(pressed, lambda x, n: -problem.pressed * n),
            body_force=problem.source,
        )
    spent = time.perf_counter() - started[0], time.process_time() - started[1]
    shell, core = space.parts(found.values)
    sides = {
        "shell": Part(space.spline, shell.reshape(len(shell), -1)),
        "core": Part(space.tets, core.reshape(len(core), -1)),
    }
    return {
        **errors(sides, problem),
        "unknowns": space.size * problem.components,
        "unknowns_shell": space.spline.size * problem.components,
        "spans": space.spline.shell.surface.element_count,
        "tets": len(space.tets.elements),
        "seconds": spent[0],
        "seconds_cpu": spent[1],
        "solver": asdict(found.figures),
    }, found.values


def _roles(spline: SplineSpace, problem: Problem) -> tuple[list[str], list[str]]:
    """Faces of cavities that a pressure acts on, and all others."""
    surface = spline.shell.surface
    pressed = [
        patch.face
        for patch, shell in zip(surface.patches, surface.shell_of_patch, strict=True)
        if problem.pressed and shell > 0
    ]
    held = [patch.face for patch in surface.patches if patch.face not in set(pressed)]
    return list(dict.fromkeys(pressed)), list(dict.fromkeys(held))


def tets_alone(mesh: Meshed) -> SimplexSpace:
    """Quadratic polynomials on curved ten-node tets of a whole body."""
    if [kind for kind, _ in mesh.elements] != ["tet10"]:
        raise ValueError("a mesh of ten-node tets is asked for")
    # Abaqus has the mid nodes of 01 12 20 03 13 23
    known = {(0, 1): 4, (1, 2): 5, (0, 2): 6, (0, 3): 7, (1, 3): 8, (2, 3): 9}
    order = []
    for counts in lattice(3, 2):
        ends = np.flatnonzero(counts)
        order.append(int(ends[0]) if len(ends) == 1 else known[tuple(ends.tolist())])
    nothing = np.zeros(0, dtype=int)
    return SimplexSpace(
        2,
        mesh.nodes,
        mesh.elements[0][1][:, order],
        nothing,
        nothing,
        np.zeros((0, 2)),
        np.zeros(0),
        np.zeros((0, 6), dtype=int),
        nothing,
        np.zeros((0, 3, 2)),
        np.zeros((0, 3)),
    )


def solved_alone(mesh: Meshed, pressed: Sequence[str], problem: Problem) -> dict[str, Any]:
    """Solve on tets alone; the same figures as of :func:`solved`.

    Parameters
    ----------
    mesh : Meshed
        Its mid nodes on the boundary lie on the CAD faces.
    pressed : sequence of str
        Faces that the problem's pressure acts on; values are given at the nodes of all others.
    problem : Problem
    """
    started = time.perf_counter(), time.process_time()
    space = tets_alone(mesh)
    count = problem.components
    if count == 1:
        matrix = stiffness(space)
    else:
        matrix = elastic(space, problem.material.lame, problem.material.shear)
    right = np.zeros((space.size, count))
    if problem.source is not None:
        for c in range(count):
            right[:, c] = load(space, lambda x, c=c: problem.source(x)[:, c], space.degree + 3)
    if pressed:
        right += traction_forces(
            mesh.nodes, *mesh.triangles(*pressed), lambda x, n: -problem.pressed * n
        )
    on = mesh.face_nodes(*(name for name in mesh.faces if name not in pressed))
    given = problem.exact(mesh.nodes[on])
    fixed = (on + np.arange(count)[:, None] * space.size).ravel()
    values, figures = linear.solved(matrix, right.T.ravel(), fixed, given.T.ravel())
    spent = time.perf_counter() - started[0], time.process_time() - started[1]
    return {
        **errors({"tets": Part(space, values.reshape(count, -1).T)}, problem),
        "unknowns": space.size * count,
        "unknowns_shell": 0,
        "spans": 0,
        "tets": len(space.elements),
        "seconds": spent[0],
        "seconds_cpu": spent[1],
        "solver": asdict(figures),
        "unproved": mesh.unproved,
    }
