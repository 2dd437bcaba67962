# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME.inp: a complete deck for CalculiX (and Abaqus) of the conforming mesh.

Sets: elements SHELL and CORE; for every CAD face, and for INTERFACE, the nodes N_<FACE>, the
elements of the shell E_<FACE> that touch it and their surface S_<FACE>. Units are mm, N, MPa, t.
Without loads the deck presses on the whole boundary with 1 MPa on a statically determinate support:
the exact answer is a stress of -1 MPa in all directions everywhere, a check of mesh and solver.

A mesh with hexahedra has the equations that join them to the core (`core.hexahedra`).
"""

from __future__ import annotations

import os
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
from HybridVolume.core.hexahedra import HexahedralMesh
from HybridVolume.errors import InputError

from .blocks import CORE, INTERFACE, SHELL, interface_wedges, plain_names

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh

_OUTER_SIDE, _INNER_SIDE = 2, 1
"""CalculiX's numbers of the top and the bottom of wedges and hexahedra."""


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


@dataclass(frozen=True)
class Deck:
    """What a deck says of a mesh.

    Attributes
    ----------
    nodes : (n, 3) array
        mm
    parts : list of (str, str, (m, k) int array)
        Group (Shell or Core), kind and connectivity; elements are numbered in this order.
    faces : dict of str to list of (str, (m, k) int array, (m,) int array)
        For each CAD face, kinds and nodes of the tops of elements, and these elements from 0.
    inner : (m,) int array
        Elements of the shell at the interface.
    interface : (m,) int array
        Nodes there.
    centres, followed, shares : (e,), (e, 8), (e, 8) arrays
        As of `HexahedralMesh`.
    """

    nodes: np.ndarray
    parts: list[tuple[str, str, np.ndarray]]
    faces: dict[str, list[tuple[str, np.ndarray, np.ndarray]]]
    inner: np.ndarray
    interface: np.ndarray
    centres: np.ndarray
    followed: np.ndarray
    shares: np.ndarray


def deck_of(mesh: FiniteElementMesh | HexahedralMesh) -> Deck:
    """Elements, faces and equations of either kind of mesh."""
    if isinstance(mesh, HexahedralMesh):
        return _hexahedral_deck(mesh)
    faces = {}
    for number, name in enumerate(mesh.face_names):
        own = mesh.boundary_face == number
        faces[name] = [(mesh.face_kind, mesh.boundary[own], mesh.boundary_wedge[own])]
    return Deck(
        nodes=mesh.nodes,
        parts=_filled(
            (SHELL, mesh.wedge_kind, mesh.wedges),
            (CORE, mesh.tet_kind, mesh.tets),
        ),
        faces=faces,
        inner=np.unique(interface_wedges(mesh)),
        interface=np.unique(mesh.interface),
        centres=np.zeros(0, dtype=int),
        followed=np.zeros((0, 8), dtype=int),
        shares=np.zeros((0, 8)),
    )


def _hexahedral_deck(mesh: HexahedralMesh) -> Deck:
    count = len(mesh.hexes)
    faces = {}
    for number, name in enumerate(mesh.face_names):
        quads, triangles = mesh.quad_face == number, mesh.triangle_face == number
        faces[name] = [
            ("quad8", mesh.quads[quads], mesh.quad_hex[quads]),
            ("tri6", mesh.triangles[triangles], count + mesh.triangle_wedge[triangles]),
        ]
    layers = np.concatenate([mesh.hex_layer, mesh.wedge_layer])
    return Deck(
        nodes=mesh.nodes,
        parts=_filled(
            (SHELL, "hex20", mesh.hexes),
            (SHELL, "penta15", mesh.wedges),
            (CORE, "tet10", mesh.tets),
        ),
        faces=faces,
        inner=np.flatnonzero(layers == layers.max()),
        interface=np.unique(mesh.interface),
        centres=mesh.centres,
        followed=mesh.followed,
        shares=mesh.shares,
    )


def _filled(*parts: tuple[str, str, np.ndarray]) -> list[tuple[str, str, np.ndarray]]:
    return [part for part in parts if len(part[2])]


def write_inp(
    path: str | os.PathLike,
    mesh: FiniteElementMesh | HexahedralMesh,
    *,
    material: Material | Mapping[str, Material] | None = None,
    fixed: Sequence[str] = (),
    pressure: Mapping[str, float] | None = None,
    force: Mapping[str, Sequence[float]] | None = None,
    title: str = "",
) -> None:
    """Write a deck with one linear static step.

    Parameters
    ----------
    path : path
    mesh : FiniteElementMesh or HexahedralMesh
    material : Material, or mapping of "Shell" and "Core" to Material, optional
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
        There is no such face, or a part has no material.
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
    deck = deck_of(mesh)
    materials = _materials(deck, material)
    names = set_names(mesh.face_names)
    with replacing(path) as file:
        for lines in (
            _model(deck, materials, names, title),
            _step(mesh, deck, names, fixed, pressure, force),
        ):
            for line in lines:
                file.write(line.encode("ascii", "replace") + b"\n")


def _materials(
    deck: Deck, material: Material | Mapping[str, Material] | None
) -> dict[str, Material]:
    """Material of each part."""
    parts = list(dict.fromkeys(part for part, _, _ in deck.parts))
    if not isinstance(material, Mapping):
        return dict.fromkeys(parts, material or Material())
    missing = [part for part in parts if part not in material]
    if missing:
        raise InputError(
            f"{missing[0]} has no material", remedy=f"give one for {' and '.join(parts)}"
        )
    named: dict[str, Material] = {}
    for part in parts:
        if named.setdefault(material[part].name.upper(), material[part]) != material[part]:
            raise InputError(
                f"two materials are named {material[part].name}", remedy="name them differently"
            )
    return {part: material[part] for part in parts}


def set_names(faces: Sequence[str]) -> dict[str, str]:
    """Name of each CAD face in sets: capitals, digits and underscores, each name once."""
    # the sets of the whole and of the interface have names of the same kind
    found = plain_names(("ALL", INTERFACE, *faces), capitals=True)
    return {face: found[face] for face in faces}


def _model(
    deck: Deck, materials: Mapping[str, Material], names: Mapping[str, str], title: str
) -> Iterator[str]:
    yield "*HEADING"
    yield f"{' '.join(title.split())[:70] or 'Hybrid volume'} (mm, N, MPa, t)"
    yield "*NODE, NSET=N_ALL"
    for number, place in enumerate(deck.nodes.tolist(), 1):
        yield f"{number},{','.join(map(_number, place))}"
    start = 1
    for part, kind, connectivity in deck.parts:
        yield f"*ELEMENT, TYPE={CALCULIX_NAMES[kind]}, ELSET={part.upper()}"
        for number, row in enumerate((connectivity + 1).tolist(), start):
            text = ",".join(map(str, (number, *row[:15])))
            # a line has 16 numbers at most
            yield text + "," if len(row) > 15 else text
            if len(row) > 15:
                yield ",".join(map(str, row[15:]))
        start += len(connectivity)
    for face, name in names.items():
        nodes = [rows.ravel() for _, rows, _ in deck.faces[face]]
        under = [elements for _, _, elements in deck.faces[face]]
        yield from _surface(name, np.concatenate(nodes), np.concatenate(under), _OUTER_SIDE)
    if len(deck.interface):
        yield from _surface(INTERFACE.upper(), deck.interface, deck.inner, _INNER_SIDE)
    for material in {one.name.upper(): one for one in materials.values()}.values():
        yield f"*MATERIAL, NAME={material.name}"
        yield "*ELASTIC"
        yield f"{material.young:.9g}, {material.poisson:.9g}"
        yield "*DENSITY"
        yield f"{material.density:.9g}"
    for part, material in materials.items():
        yield f"*SOLID SECTION, ELSET={part.upper()}, MATERIAL={material.name}"
    yield from _equations(deck)


def _number(value: float) -> str:
    """A number in the 20 characters that CalculiX reads: all its digits where they fit, or 14."""
    text = repr(value)
    if len(text) > 20 and text.lstrip("-").startswith("0."):
        text = text.replace("0.", ".", 1)
    return text if len(text) <= 20 else f"{value:.13e}"


def _surface(name: str, nodes: np.ndarray, elements: np.ndarray, side: int) -> Iterator[str]:
    yield f"*NSET, NSET=N_{name}"
    yield from _rows(np.unique(nodes) + 1)
    yield f"*ELSET, ELSET=E_{name}"
    yield from _rows(np.unique(elements) + 1)
    yield f"*SURFACE, NAME=S_{name}, TYPE=ELEMENT"
    yield f"E_{name}, S{side}"


def _equations(deck: Deck) -> Iterator[str]:
    """Each centre follows the nodes around it; an equation's first node depends on the others."""
    if len(deck.centres):
        yield "*EQUATION"
    rows = np.column_stack([deck.centres, deck.followed]) + 1
    factors = np.column_stack([np.ones(len(rows)), -deck.shares])
    for row, shares in zip(rows.tolist(), factors.tolist(), strict=True):
        texts = [_number(share) for share in shares]
        for axis in (1, 2, 3):
            terms = [f"{node},{axis},{text}" for node, text in zip(row, texts, strict=True)]
            yield str(len(terms))
            yield from (",".join(terms[i : i + 4]) for i in range(0, len(terms), 4))


def _rows(numbers: np.ndarray) -> Iterator[str]:
    numbers = np.asarray(numbers).tolist()
    yield from (",".join(map(str, numbers[i : i + 16])) for i in range(0, len(numbers), 16))


def _step(
    mesh: FiniteElementMesh | HexahedralMesh,
    deck: Deck,
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
    mesh: FiniteElementMesh | HexahedralMesh, face: str, force: Sequence[float]
) -> tuple[np.ndarray, np.ndarray]:
    """Forces on the nodes of a CAD face that are equal to an even traction.

    Returns
    -------
    nodes : (m,) int array
    loads : (m, 3) array
        N; they add up to the force.
    """
    total, whole = np.zeros(len(mesh.nodes)), 0.0
    for kind, rows, _ in deck_of(mesh).faces[face]:
        points, weights = quadrature(kind.rstrip("0123456789"), 5)
        tangents = np.einsum("qnd,tnc->tqcd", shape_gradients(kind, points), mesh.nodes[rows])
        area = np.linalg.norm(np.cross(tangents[..., 0], tangents[..., 1]), axis=2) * weights
        share = area @ shape_functions(kind, points)
        total += np.bincount(rows.ravel(), share.ravel(), len(total))
        whole += area.sum()
    nodes = np.unique(np.concatenate([rows.ravel() for _, rows, _ in deck_of(mesh).faces[face]]))
    return nodes, np.outer(total[nodes] / whole, np.asarray(force, dtype=float))


def support(mesh: FiniteElementMesh | HexahedralMesh) -> list[tuple[int, int]]:
    """Six (node, axis) pairs that hold the body without any strain: three, two and one at a node.

    The nodes are corners far apart, on the outer boundary where there is one.
    """
    deck = deck_of(mesh)
    parts = [(kind, rows) for face in deck.faces.values() for kind, rows, _ in face if len(rows)]
    parts = parts or [(kind, connectivity) for _, kind, connectivity in deck.parts]
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
