# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Patch tests of finite element meshes through CalculiX.

All nodes of the outer boundary get a displacement that is linear in space. A mesh that conforms
then has the same stress everywhere; how far the stress at CalculiX's Gauss points is from it tells
gaps, wrong nodes and wrong elements, and also where CalculiX does not integrate exactly.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import cache
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.core.density import Density
from HybridVolume.core.element_jacobians import prove_positive
from HybridVolume.core.elements import EDGES, quadrature, shape_gradients
from HybridVolume.core.recovery import Material
from HybridVolume.core.remesh import remesh
from HybridVolume.errors import HybridVolumeError

from .calculix import solve
from .fem_mesh import Meshed

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume

Bound = tuple[Meshed, Sequence[Sequence[tuple[int, int, float]]]]
"""A mesh and the equations that bind its nodes."""
MATERIAL = Material(210_000.0, 0.3)
SIZE_OF_STRAIN = 1e-3
LARGEST = 40_000
"""Nodes up to which a mesh with every cell cut in two is solved as well."""
_QUADRATIC = {"tet4": "tet10", "penta6": "penta15", "tri3": "tri6"}
_SIXTH, _ROOT = 1.0 / 6.0, 0.5 * np.sqrt(0.6)


def make(volume: HybridVolume, progress: Callable[[float, str], None]) -> dict[str, Any]:
    """Figures of the patch tests of a body, under the names of fem.json.

    Parameters
    ----------
    volume : HybridVolume
    progress : callable
        Called with the share of the work and a text.

    Returns
    -------
    dict
        ``rows``: one mesh each, as of `patch_row`; ``conforming``: as of `unbalanced` for the
        curved mesh, by exact integration and by CalculiX's points.
    """
    fem = volume.fem
    curved = Meshed.of(fem)
    rows = []

    @cache
    def straight() -> Meshed:
        return Meshed.of(remesh(volume, fem.density, order=1).fem)

    def add(share: float, name: str, mesh: Callable[[], Meshed | Bound]) -> None:
        progress(share, name)
        try:
            made = mesh()
            meshed, equations = (made, ()) if isinstance(made, Meshed) else made
            rows.append(patch_row(name, meshed, equations))
        except HybridVolumeError as error:
            rows.append({"mesh": name, "error": error.line})

    add(0.0, "curved", lambda: curved)
    add(0.15, "first order", straight)
    add(0.35, "straight", lambda: second_order(straight()))
    # four times as many columns, and more layers
    if 6 * len(fem.nodes) <= LARGEST:
        finer = Density(subdivide=2 * max(fem.density.subdivide, 1))
        add(0.5, "curved, cells in two", lambda: Meshed.of(remesh(volume, finer).fem))
    add(0.7, "hexahedra, curved", lambda: _hexahedra(volume))
    add(0.8, "Gmsh, curved", lambda: _gmsh(volume))
    return {
        "nodes": len(fem.nodes),
        "wedges": len(fem.wedges),
        "tets": len(fem.tets),
        "min_scaled_jacobian": fem.min_scaled_jacobian,
        "rows": rows,
        "conforming": {
            "exact": unbalanced(curved, exact_rule),
            "calculix": unbalanced(curved, calculix_rule),
        },
    }


def _gmsh(volume: HybridVolume) -> Meshed:
    """Curved tets of about as many nodes, for comparison."""
    from .fem_rivals import Sizes, tet10_mesh

    # edges of equal tets, of which there are about two to three nodes
    size = 2.5 * (volume.surface.volume() / len(volume.fem.nodes)) ** (1.0 / 3.0)
    return tet10_mesh(volume.surface, Sizes(size), mesher="gmsh")


def _hexahedra(volume: HybridVolume) -> Bound:
    """The shell of 20-node hexahedra, bound to the tets by equations."""
    from HybridVolume.core.hexahedra import hexahedral_mesh

    made = hexahedral_mesh(volume.fem, volume.interface)
    faces = {"quads": ("quad8", made.quads), "triangles": ("tri6", made.triangles)}
    meshed = Meshed(
        made.nodes,
        tuple((kind, rows) for kind, rows in made.elements if len(rows)),
        {name: group for name, group in faces.items() if len(group[1])},
        "hexahedra",
    )
    bound = [
        [(centre, axis, 1.0), *((node, axis, -part) for node, part in zip(*row, strict=True))]
        for centre, *row in zip(
            made.centres.tolist(), made.followed.tolist(), made.shares.tolist(), strict=True
        )
        for axis in range(3)
    ]
    return meshed, bound


def patch_row(
    name: str, mesh: Meshed, equations: Sequence[Sequence[tuple[int, int, float]]] = ()
) -> dict[str, Any]:
    """Solve one patch test.

    Parameters
    ----------
    name : str
    mesh : Meshed
    equations : as of `HybridVolume.reproduce.calculix.solve`

    Returns
    -------
    dict
        ``mesh``, ``nodes``, ``elements`` by kind, ``max`` and ``rms`` of the deviation over all
        Gauss points, the same by kind as ``by_kind``, ``displacement`` (largest deviation over the
        largest displacement) and ``seconds_cpu``.
    """
    row: dict[str, Any] = {
        "mesh": name,
        "nodes": len(mesh.nodes),
        "elements": {kind: len(rows) for kind, rows in mesh.elements},
        "unproved": unproved(mesh),
    }
    started = time.process_time()
    gradient = random_gradient()
    x = mesh.nodes - mesh.nodes.mean(axis=0)
    exact = x @ gradient.T
    outside = mesh.face_nodes(*mesh.faces)
    prescribed = np.full_like(exact, np.nan)
    prescribed[outside] = exact[outside]
    found = solve(mesh.nodes, mesh.elements, MATERIAL, prescribed, equations=equations)
    stress = stress_of(gradient)
    apart = {
        kind: size_of(values - stress) / size_of(stress)
        for (kind, _), values in zip(mesh.elements, found.gauss_stress, strict=True)
    }
    every = np.concatenate([values.ravel() for values in apart.values()])
    return {
        **row,
        "max": float(every.max()),
        "rms": float(np.sqrt(np.mean(every**2))),
        "by_kind": {kind: float(values.max()) for kind, values in apart.items()},
        "displacement": float(np.abs(found.displacement - exact).max() / np.abs(exact).max()),
        "warnings": list(found.warnings),
        "seconds_cpu": time.process_time() - started,
    }


def random_gradient() -> np.ndarray:
    """Gradient of the displacement, (3, 3): the same for all."""
    return SIZE_OF_STRAIN * np.random.default_rng(5).normal(size=(3, 3))


def stress_of(gradient: np.ndarray) -> np.ndarray:
    """Stress of a gradient, (6,), MPa."""
    strain = 0.5 * (gradient + gradient.T)
    return MATERIAL.stress(strain[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])


def size_of(stress: np.ndarray) -> np.ndarray:
    """Frobenius norm of (..., 6) components."""
    return np.sqrt(np.sum(stress[..., :3] ** 2, axis=-1) + 2.0 * np.sum(stress[..., 3:] ** 2, -1))


def unproved(mesh: Meshed) -> int:
    """Elements whose Jacobian is not proved positive."""
    proofs = [prove_positive(kind, mesh.nodes[rows]).proved for kind, rows in mesh.elements]
    return int(sum(np.count_nonzero(~proved) for proved in proofs))


def second_order(mesh: Meshed) -> Meshed:
    """A mesh of first order with a node in the middle of every edge."""
    groups = [*mesh.elements, *mesh.faces.values()]
    pairs = [np.sort(rows[:, np.array(EDGES[kind])], axis=2) for kind, rows in groups]
    edges, number = np.unique(
        np.concatenate([part.reshape(-1, 2) for part in pairs]), axis=0, return_inverse=True
    )
    nodes = np.concatenate([mesh.nodes, mesh.nodes[edges].mean(axis=1)])
    number = len(mesh.nodes) + number.ravel()
    full, start = [], 0
    for (kind, rows), part in zip(groups, pairs, strict=True):
        count = part.shape[0] * part.shape[1]
        mids = number[start : start + count].reshape(part.shape[:2])
        full.append((_QUADRATIC[kind], np.concatenate([rows, mids], axis=1)))
        start += count
    elements, faces = full[: len(mesh.elements)], full[len(mesh.elements) :]
    return Meshed(nodes, tuple(elements), dict(zip(mesh.faces, faces, strict=True)), mesh.name)


Rule = Callable[[str], tuple[np.ndarray, np.ndarray]]


@cache
def exact_rule(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """A rule that integrates the nodal forces of a constant stress in a curved element exactly."""
    return quadrature(kind.rstrip("0123456789"), 3)


@cache
def calculix_rule(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """CalculiX's points: 4 in a ten-node tet, 3 times 3 in a 15-node wedge."""
    if kind == "tet10":
        far, near = 0.25 * (1.0 + 0.6 * np.sqrt(5.0)), 0.25 * (1.0 - 0.2 * np.sqrt(5.0))
        return near + (far - near) * np.eye(4)[:, 1:], np.full(4, 1.0 / 24.0)
    if kind == "penta15":
        triangle = np.array([[1.0, 1.0], [4.0, 1.0], [1.0, 4.0]]) * _SIXTH
        height = 0.5 + _ROOT * np.array([-1.0, 0.0, 1.0])
        points = [[*place, w] for w in height for place in triangle]
        return np.array(points), np.repeat([5.0, 8.0, 5.0], 3) / 108.0
    raise ValueError(f"no rule for {kind!r}")


def unbalanced(mesh: Meshed, rule: Rule) -> float:
    """How far the nodal forces of a constant stress are from balance inside the body.

    At an inner node the integrals of its shape function's gradient over all elements around it add
    up to nothing, if the elements share their faces.

    Parameters
    ----------
    mesh : Meshed
        Of second order.
    rule : callable
        Points and weights for a kind of element.

    Returns
    -------
    float
        The largest sum over the largest sum of absolute values.
    """
    total, absolute = np.zeros((2, len(mesh.nodes), 3))
    for kind, rows in mesh.elements:
        points, weights = rule(kind)
        gradients = shape_gradients(kind, points)
        for part in np.array_split(rows, 1 + len(rows) // 5000):
            x = np.einsum("qnd,enc->eqcd", gradients, mesh.nodes[part], optimize=True)
            # the matrix of cofactors turns gradients and volumes into those of space
            cofactor = np.stack(
                [np.cross(x[..., (d + 1) % 3], x[..., (d + 2) % 3]) for d in range(3)], axis=-1
            )
            share = np.einsum("q,eqcd,qnd->enc", weights, cofactor, gradients, optimize=True)
            for axis in range(3):
                flat, values = part.ravel(), share[..., axis].ravel()
                total[:, axis] += np.bincount(flat, values, len(total))
                absolute[:, axis] += np.bincount(flat, np.abs(values), len(total))
    inside = np.setdiff1d(np.arange(len(mesh.nodes)), mesh.face_nodes(*mesh.faces))
    return float(np.abs(total[inside]).max() / absolute[inside].max())
