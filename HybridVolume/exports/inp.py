# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME.inp: a complete deck for CalculiX (and Abaqus) of the conforming mesh.

Sets: elements SHELL and CORE; for every CAD face the nodes N_<FACE>, the elements E_<FACE> under it
and the surface S_<FACE>; nodes N_INTERFACE. Units are mm, N, MPa, t. Without loads the deck presses
on the whole boundary with 1 MPa on a statically determinate support: the exact answer is a stress
of -1 MPa in all directions everywhere, a check of mesh and solver.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from HybridVolume.core.atomic import replacing
from HybridVolume.core.elements import (
    CALCULIX_NAMES,
    quadrature,
    reference,
    shape_functions,
    shape_gradients,
)
from HybridVolume.errors import InputError

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh

_OUTER_SIDE = 2
"""CalculiX's number of the top of a wedge, which is the outer side of ours."""


@dataclass(frozen=True)
class Material:
    """Linear elastic, isotropic.

    Attributes
    ----------
    name : str
    young : float
        MPa
    poisson : float
    density : float
        t/mm³
    """

    name: str = "STEEL"
    young: float = 210_000.0
    poisson: float = 0.3
    density: float = 7.85e-9


def write_inp(
    path: str | os.PathLike,
    mesh: FiniteElementMesh,
    *,
    material: Material | None = None,
    fixed: Sequence[str] = (),
    pressure: Mapping[str, float] | None = None,
    force: Mapping[str, Sequence[float]] | None = None,
    title: str = "",
) -> None:
    """Write a deck with one linear static step.

    Parameters
    ----------
    path : path
    mesh : FiniteElementMesh
    material : Material, optional
        Steel by default.
    fixed : sequence of str
        CAD faces without displacement; by default three nodes just hold the body.
    pressure : mapping of str to float, optional
        MPa on CAD faces, positive towards the body. Without pressure and force: 1 on all faces.
    force : mapping of str to (fx, fy, fz), optional
        N on CAD faces, spread evenly over the face.
    title : str
        Goes into the heading.

    Raises
    ------
    InputError
        There is no such face.
    OSError
        The place cannot be written.
    """
    pressure, force = dict(pressure or {}), dict(force or {})
    unknown = [n for n in (*fixed, *pressure, *force) if n not in mesh.face_names]
    if unknown:
        raise InputError(
            "there is no such face",
            faces=unknown,
            remedy=f"faces are {mesh.face_names[0]} to {mesh.face_names[-1]}"
            if mesh.face_names
            else "the mesh has no faces",
        )
    if not pressure and not force:
        pressure = dict.fromkeys(mesh.face_names, 1.0)
    names = set_names(mesh.face_names)
    with replacing(path) as file:
        for lines in (
            _model(mesh, material or Material(), names, title),
            _step(mesh, names, fixed, pressure, force),
        ):
            for line in lines:
                file.write(line.encode("ascii", "replace") + b"\n")


def set_names(faces: Sequence[str]) -> dict[str, str]:
    """Name of each CAD face in sets: capitals, digits and underscores, each name once."""
    found: dict[str, str] = {}
    for face in faces:
        name = base = re.sub(r"[^A-Z0-9_]", "_", face.upper())[:60] or "FACE"
        count = 1
        while name in found.values():
            count += 1
            name = f"{base}_{count}"
        found[face] = name
    return found


def _model(
    mesh: FiniteElementMesh, material: Material, names: Mapping[str, str], title: str
) -> Iterator[str]:
    yield "*HEADING"
    yield f"{' '.join(title.split())[:70] or 'Hybrid volume'} (mm, N, MPa, t)"
    yield "*NODE, NSET=N_ALL"
    # CalculiX reads 20 characters of a number
    yield from (
        f"{n},{x:.13e},{y:.13e},{z:.13e}" for n, (x, y, z) in enumerate(mesh.nodes.tolist(), 1)
    )
    start = 1
    for name, kind, connectivity in _parts(mesh):
        yield f"*ELEMENT, TYPE={CALCULIX_NAMES[kind]}, ELSET={name}"
        for number, row in enumerate((connectivity + 1).tolist(), start):
            yield f"{number}," + ",".join(map(str, row))
        start += len(connectivity)
    for face, name in names.items():
        under = mesh.boundary_wedge[mesh.boundary_face == mesh.face_names.index(face)] + 1
        yield f"*NSET, NSET=N_{name}"
        yield from _rows(mesh.face_nodes(face) + 1)
        yield f"*ELSET, ELSET=E_{name}"
        yield from _rows(under)
        yield f"*SURFACE, NAME=S_{name}, TYPE=ELEMENT"
        yield f"E_{name}, S{_OUTER_SIDE}"
    if len(mesh.interface):
        yield "*NSET, NSET=N_INTERFACE"
        yield from _rows(np.unique(mesh.interface) + 1)
    yield f"*MATERIAL, NAME={material.name}"
    yield "*ELASTIC"
    yield f"{material.young:.9g}, {material.poisson:.9g}"
    yield "*DENSITY"
    yield f"{material.density:.9g}"
    for name, _, _ in _parts(mesh):
        yield f"*SOLID SECTION, ELSET={name}, MATERIAL={material.name}"


def _parts(mesh: FiniteElementMesh) -> list[tuple[str, str, np.ndarray]]:
    """Element sets that are not empty, in the order of their numbers."""
    parts = [("SHELL", mesh.wedge_kind, mesh.wedges), ("CORE", mesh.tet_kind, mesh.tets)]
    return [part for part in parts if len(part[2])]


def _rows(numbers: np.ndarray) -> Iterator[str]:
    numbers = np.asarray(numbers).tolist()
    yield from (",".join(map(str, numbers[i : i + 16])) for i in range(0, len(numbers), 16))


def _step(
    mesh: FiniteElementMesh,
    names: Mapping[str, str],
    fixed: Sequence[str],
    pressure: Mapping[str, float],
    force: Mapping[str, Sequence[float]],
) -> Iterator[str]:
    yield "*STEP"
    yield "*STATIC"
    yield "*BOUNDARY"
    if fixed:
        yield from (f"N_{names[face]}, 1, 3" for face in fixed)
    else:
        yield from (f"{node + 1}, {axis + 1}, {axis + 1}" for node, axis in support(mesh))
    if pressure:
        yield "*DLOAD"
        yield from (
            f"E_{names[face]}, P{_OUTER_SIDE}, {value:.9g}" for face, value in pressure.items()
        )
    if force:
        yield "*CLOAD"
        for face, vector in force.items():
            nodes, loads = nodal_forces(mesh, face, vector)
            for node, load in zip((nodes + 1).tolist(), loads.tolist(), strict=True):
                yield from (f"{node}, {a}, {v:.12e}" for a, v in enumerate(load, 1) if v)
    yield "*NODE FILE"
    yield "U"
    yield "*EL FILE"
    yield "S"
    yield "*END STEP"


def nodal_forces(
    mesh: FiniteElementMesh, face: str, force: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Forces on the nodes of a CAD face that are equal to an even traction.

    Returns
    -------
    nodes : (m,) int array
    loads : (m, 3) array
        N; they add up to the force.
    """
    triangles = mesh.face_triangles(face)
    points, weights = quadrature("tri", 5)
    tangents = np.einsum(
        "qnd,tnc->tqcd", shape_gradients(mesh.face_kind, points), mesh.nodes[triangles]
    )
    area = np.linalg.norm(np.cross(tangents[..., 0], tangents[..., 1]), axis=2) * weights
    share = area @ shape_functions(mesh.face_kind, points)
    total = np.bincount(triangles.ravel(), share.ravel(), len(mesh.nodes))
    nodes = np.unique(triangles)
    return nodes, np.outer(total[nodes] / area.sum(), np.asarray(force, dtype=float))


def support(mesh: FiniteElementMesh) -> list[tuple[int, int]]:
    """Six (node, axis) pairs that hold the body without any strain: three, two and one at a node.

    The nodes are corners far apart, on the outer boundary where there is one.
    """
    parts = [(mesh.face_kind, mesh.boundary)] if len(mesh.boundary) else []
    parts = parts or [(kind, connectivity) for _, kind, connectivity in _parts(mesh)]
    corners = np.unique(np.concatenate([c[:, : reference(k).corners].ravel() for k, c in parts]))
    x = mesh.nodes[corners]
    first = int(np.argmax(np.linalg.norm(x - x.mean(axis=0), axis=1)))
    along = x - x[first]
    second = int(np.argmax(np.linalg.norm(along, axis=1)))
    direction = along[second] / np.linalg.norm(along[second])
    across = np.cross(direction, along)
    third = int(np.argmax(np.linalg.norm(across, axis=1)))
    main = int(np.argmax(np.abs(direction)))
    turning = int(np.argmax(np.abs(across[third])))
    pairs = [(first, axis) for axis in range(3)]
    pairs += [(second, axis) for axis in range(3) if axis != main]
    pairs.append((third, turning))
    return [(int(corners[node]), axis) for node, axis in pairs]
