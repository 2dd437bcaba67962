# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The same shell as 20-node hexahedra on the core's tets, joined by equations.

The two wedges over a cell of the interface, layer by layer, become one hexahedron. Its bottom side
has eight nodes where the core's two triangles have nine: the node in the middle of the diagonal.
That one follows the eight others, by shares that let every constant stress pass from one part to
the other (`side_equations`); elements that only share the nodes miss it by their own size.

Edges of hexahedra at the interface are straight where that is valid, else half or as much curved as
the wedges'. A column whose hexahedra, or the elements beside them, are not proved valid in any way
stays wedges: above all where one tet has both triangles of a cell, which is flat once these are
nearly one smooth side.

Fewer nodes than with wedges, and CalculiX integrates curved hexahedra with enough points, as it
does not with wedges; but equations are taken by few programs besides CalculiX and Abaqus, and the
FEM workbench has none: hence the finite element mesh itself is made of wedges.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from ..errors import FaultError, InputError
from .element_jacobians import prove_positive, scaled_jacobian, volumes
from .elements import (
    quadrature,
    shape_functions,
    shape_gradients,
)
from .finite_elements import FiniteElementMesh
from .interior import Interface
from .side_equations import consistent_middles

logger = logging.getLogger(__name__)

_BOTTOM, _TOP = [0, 1, 2, 3, 8, 9, 10, 11], [4, 5, 6, 7, 12, 13, 14, 15]
"""Places of the nodes of two sides in a hexahedron, both seen from outside the body."""

_KEPT_QUALITY = 0.5
"""Share of their scaled Jacobian that tets and wedges beside hexahedra keep at least, and that the
hexahedra have of their wedges'."""

_CURVED = (0.0, 0.5, 1.0)
"""Shares of the wedges' curvature that are tried for edges at the interface, one after another."""


@dataclass(frozen=True)
class HexahedralMesh:
    """Hexahedra and wedges of the shell and tets of the core, in the node order of Abaqus.

    Attributes
    ----------
    nodes : (n, 3) array
        mm
    hexes : (m, 20) int array
        Bottom (the first four nodes) towards the core, top towards the outer boundary.
    hex_patch, hex_layer : (m,) int arrays
        As of `FiniteElementMesh`.
    wedges : (k, 15) int array
        Columns that have no valid hexahedra.
    wedge_patch, wedge_layer : (k,) int arrays
    tets : (t, 10) int array
    quads, triangles : (q, 8), (r, 6) int arrays
        Tops of hexahedra and of wedges on the outer boundary, oriented outward.
    quad_face, triangle_face : (q,), (r,) int arrays
        Position of each in ``face_names``.
    quad_hex, triangle_wedge : (q,), (r,) int arrays
        The element under each.
    centres : (e,) int array
        Nodes in the middle of the hexahedra's sides at the interface, which only the tets have.
    followed : (e, 8) int array
        Corners and mid nodes that each follows.
    shares : (e, 8) array
        By how much; they add up to 1.
    interface : (ni, 6) int array
        Triangles of the core's boundary, oriented out of the core.
    face_names : tuple of str
    hex_quality, wedge_quality, tet_quality : arrays
        Smallest scaled Jacobian of each element.
    """

    nodes: np.ndarray
    hexes: np.ndarray
    hex_patch: np.ndarray
    hex_layer: np.ndarray
    wedges: np.ndarray
    wedge_patch: np.ndarray
    wedge_layer: np.ndarray
    tets: np.ndarray
    quads: np.ndarray
    quad_face: np.ndarray
    quad_hex: np.ndarray
    triangles: np.ndarray
    triangle_face: np.ndarray
    triangle_wedge: np.ndarray
    centres: np.ndarray
    followed: np.ndarray
    shares: np.ndarray
    interface: np.ndarray
    face_names: tuple[str, ...]
    hex_quality: np.ndarray
    wedge_quality: np.ndarray
    tet_quality: np.ndarray

    @property
    def elements(self) -> list[tuple[str, np.ndarray]]:
        """Kinds and connectivities of all volume elements."""
        return [("hex20", self.hexes), ("penta15", self.wedges), ("tet10", self.tets)]

    @property
    def volume(self) -> float:
        """Sum of the elements' exact volumes, mm³."""
        return float(sum(volumes(kind, self.nodes[c]).sum() for kind, c in self.elements))

    @property
    def boundary_volume(self) -> float:
        """Volume that the outer boundary encloses, mm³; an independent sum."""
        origin = self.nodes.mean(axis=0)
        return sum(
            float(swept_volumes(kind, self.nodes[rows] - origin).sum())
            for kind, rows in (("quad8", self.quads), ("tri6", self.triangles))
        )

    @property
    def min_scaled_jacobian(self) -> float:
        """Smallest scaled Jacobian of all elements."""
        qualities = (self.hex_quality, self.wedge_quality, self.tet_quality)
        return float(min(q.min(initial=np.inf) for q in qualities))

    def figures(self) -> dict[str, float | int]:
        """Counts and quality, as they stand in the report."""
        used = [np.unique(rows) for _, rows in self.elements]
        return {
            "nodes": int(len(np.unique(np.concatenate(used)))),
            "hex20": len(self.hexes),
            "penta15": len(self.wedges),
            "tet10": len(self.tets),
            "equations": 3 * len(self.centres),
            "min_scaled_jacobian": self.min_scaled_jacobian,
            "volume": self.volume,
        }


def swept_volumes(kind: str, coordinates: np.ndarray) -> np.ndarray:
    """Volume of the cone from the origin over each face ("quad8" or "tri6"), (nf,), mm³."""
    points, weights = quadrature(kind.rstrip("0123456789"), 5)
    position = np.einsum("qn,enc->eqc", shape_functions(kind, points), coordinates)
    j = np.einsum("qnd,enc->eqcd", shape_gradients(kind, points), coordinates)
    normal = np.cross(j[..., 0], j[..., 1])
    return np.einsum("eqc,eqc,q->e", position, normal, weights) / 3.0


def hexahedral_mesh(mesh: FiniteElementMesh, interface: Interface) -> HexahedralMesh:
    """Join the wedges of each cell to hexahedra, where these are valid.

    Parameters
    ----------
    mesh : FiniteElementMesh
        Of second order.
    interface : Interface
        The one that it was made with.

    Raises
    ------
    InputError
        The mesh is of first order.
    FaultError
        The mesh is not one over the interface, or the volumes do not add up.
    """
    if mesh.order != 2:
        raise InputError("hexahedra are made of second order only", remedy="choose order 2")
    builder = _Builder(mesh, interface)
    builder.choose()
    found = builder.result()
    volume, enclosed = found.volume, found.boundary_volume
    # the places of the middles are rounded as coordinates are
    size = np.linalg.norm(np.ptp(found.nodes, axis=0))
    rounding = 8.0 * np.finfo(float).eps * np.abs(found.nodes).max() * size**2
    if abs(volume - enclosed) > 1e-10 * abs(enclosed) + rounding:
        raise FaultError(
            f"hexahedra, wedges and tets have {volume:.12g} mm³, their boundary encloses"
            f" {enclosed:.12g} mm³",
            figure=volume - enclosed,
        )
    logger.info(
        "hexahedra: %d, %d wedges where they are not valid, smallest scaled Jacobian %.3f",
        len(found.hexes),
        len(found.wedges),
        found.min_scaled_jacobian,
    )
    return found


class _Builder:
    """Cells of the interface, the hexahedra over them, and which of them are taken."""

    def __init__(self, mesh: FiniteElementMesh, interface: Interface) -> None:
        self.mesh = mesh
        self.columns = _columns(mesh)
        self.first, self.second, turn = _cells(interface)
        self.hexes = _join(self.columns, self.first, self.second, turn)
        # node in the middle of the diagonal of each layer's boundary, from inside outwards
        across = np.arange(len(turn)), turn[:, 0]
        own = self.columns[:, self.first]
        bottoms = own[:, :, 6:9][(slice(None), *across)]
        tops = own[:, :, 9:12][(slice(None), *across)]
        self.diagonals = np.concatenate([bottoms, tops[-1:]])
        self.level = np.zeros(len(self.first), dtype=int)
        self.nodes = mesh.nodes
        self.shares = np.zeros((0, 8))
        self.placed = np.zeros(0, dtype=bool)

    @property
    def taken(self) -> np.ndarray:
        """Cells over which there are hexahedra, (c,) bool."""
        return self.level < len(_CURVED)

    def choose(self) -> None:
        """Curve the interface, or give up hexahedra, until all elements are proved."""
        mesh = self.mesh
        own = mesh.wedge_quality[self._wedge_numbers()]
        least = _KEPT_QUALITY * np.minimum(own[:, self.first], own[:, self.second])
        while self.taken.any():
            self._place()
            lost = self._lost()
            chosen = np.flatnonzero(self.taken)
            rows = self.hexes[:, chosen].reshape(-1, 20)
            good = prove_positive("hex20", self.nodes[rows]).proved
            good &= scaled_jacobian("hex20", self.nodes[rows]) >= least[:, chosen].ravel()
            bad = ~good.reshape(-1, len(chosen)).all(axis=0) | ~self.placed
            # what they moved: the middle of the bottom, and its mid nodes
            bad |= lost[self.hexes[0, chosen, 8:12]].any(axis=1)
            bad |= lost[self.diagonals[0, chosen]]
            if not bad.any():
                return
            self.level[chosen[bad]] += 1
        self._place()

    def _lost(self) -> np.ndarray:
        """Moved nodes to blame for a tet or wedge that is not proved, or poor, (n,) bool.

        Where an element has the middle of a diagonal, that is to blame and no other of its nodes.
        """
        mesh = self.mesh
        staying = self._staying()
        moved = (self.nodes != mesh.nodes).any(axis=1)
        lost = np.zeros(len(moved), dtype=bool)
        middle = np.zeros(len(moved), dtype=bool)
        middle[self.diagonals[0, self.taken]] = True
        for kind, rows, quality in (
            ("tet10", mesh.tets, mesh.tet_quality),
            ("penta15", mesh.wedges[staying], mesh.wedge_quality[staying]),
        ):
            touched = np.flatnonzero(moved[rows].any(axis=1))
            x = self.nodes[rows[touched]]
            bad = ~prove_positive(kind, x).proved
            bad |= scaled_jacobian(kind, x) < _KEPT_QUALITY * quality[touched]
            blamed = rows[touched[bad]]
            middles = (middle & moved)[blamed]
            lost[blamed[middles]] = True
            lost[blamed[~middles.any(axis=1)]] = True
        return lost & moved

    def _place(self) -> None:
        """Edges under the hexahedra as curved as they may be, and the diagonals' middles."""
        given = self.mesh.nodes
        self.nodes = given.copy()
        bottom = self.hexes[0, self.taken]
        mids = bottom[:, 8:12]
        share = np.zeros(len(given))
        np.maximum.at(share, mids, np.array(_CURVED)[self.level[self.taken], None])
        ends = np.stack([bottom[:, :4], np.roll(bottom[:, :4], -1, axis=1)], axis=2)
        mix = share[mids][..., None]
        self.nodes[mids] = mix * given[mids] + (1.0 - mix) * given[ends].mean(axis=2)
        self.shares, middles, self.placed = consistent_middles(self.nodes[bottom[:, _BOTTOM]])
        # where no place is found the column is given up for another reason than its elements
        there = self.diagonals[0, self.taken][self.placed]
        self.nodes[there] = middles[self.placed]

    def _staying(self) -> np.ndarray:
        """Which wedges of the mesh stay wedges, (m,) bool."""
        gone = np.concatenate([self.first[self.taken], self.second[self.taken]])
        staying = np.ones(len(self.mesh.wedges), dtype=bool)
        staying[self._wedge_numbers()[:, gone]] = False
        return staying

    def _wedge_numbers(self) -> np.ndarray:
        """Wedges by layer from inside outwards and by triangle of the interface."""
        layers, count = self.columns.shape[:2]
        return np.arange(layers * count).reshape(layers, count)[::-1]

    def result(self) -> HexahedralMesh:
        """The mesh without the nodes that nothing has any more."""
        mesh, staying = self.mesh, self._staying()
        layers = len(self.columns)
        numbers = self._wedge_numbers()
        chosen = np.flatnonzero(self.taken)
        hexes = self.hexes[::-1, chosen].reshape(-1, 20)
        owner = numbers[::-1, self.first[chosen]].ravel()
        wedges = mesh.wedges[staying]
        under = np.full(len(mesh.wedges), -1)
        under[staying] = np.arange(len(wedges))
        triangles = np.flatnonzero(staying[mesh.boundary_wedge])
        face_of = np.full(len(mesh.wedges), -1)
        face_of[mesh.boundary_wedge] = mesh.boundary_face
        top = numbers[-1, self.first[chosen]]
        bottom = self.hexes[0, chosen]
        blocks = {
            "hexes": hexes,
            "wedges": wedges,
            "tets": mesh.tets,
            "quads": hexes[: len(chosen)][:, _TOP],
            "triangles": mesh.boundary[triangles],
            "centres": self.diagonals[0, chosen],
            "followed": bottom[:, _BOTTOM],
            "interface": mesh.interface,
        }
        used = np.zeros(len(self.nodes), dtype=bool)
        for name in ("hexes", "wedges", "tets"):
            used[blocks[name]] = True
        place = np.cumsum(used) - 1
        nodes = self.nodes[used]
        blocks = {name: place[rows] for name, rows in blocks.items()}
        return HexahedralMesh(
            nodes=nodes,
            **blocks,
            shares=self.shares,
            hex_patch=mesh.wedge_patch[owner],
            hex_layer=np.repeat(np.arange(layers), len(chosen)),
            wedge_patch=mesh.wedge_patch[staying],
            wedge_layer=mesh.wedge_layer[staying],
            quad_face=face_of[top],
            quad_hex=np.arange(len(chosen)),
            triangle_face=mesh.boundary_face[triangles],
            triangle_wedge=under[mesh.boundary_wedge[triangles]],
            face_names=mesh.face_names,
            hex_quality=scaled_jacobian("hex20", nodes[blocks["hexes"]]),
            wedge_quality=scaled_jacobian("penta15", nodes[blocks["wedges"]]),
            tet_quality=scaled_jacobian("tet10", nodes[blocks["tets"]]),
        )


def _columns(mesh: FiniteElementMesh) -> np.ndarray:
    """Wedges by layer from inside outwards and by triangle of the interface, (layers, m, 15)."""
    count = len(mesh.interface)
    if not count or len(mesh.wedges) % count:
        raise FaultError("the wedges do not stand in columns over the interface")
    columns = mesh.wedges.reshape(-1, count, 15)[::-1]
    bottoms, tops = columns[:, :, [0, 1, 2, 6, 7, 8]], columns[:, :, [3, 4, 5, 9, 10, 11]]
    levels = [mesh.interface, *tops]
    if not all(np.array_equal(a, b) for a, b in zip(levels, bottoms, strict=False)):
        raise FaultError("the wedges do not stand in columns over the interface")
    return columns


def _cells(interface: Interface) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pairs of triangles over one cell of the parameters' grid.

    Returns
    -------
    first, second : (c,) int arrays
        Triangles that have the cell's diagonal in common.
    turn : (c, 2) int array
        Which edge (0-1, 1-2 or 2-0) of each is that diagonal.
    """
    uv = interface.triangle_uv
    along = (np.roll(uv, -1, axis=1) != uv).all(axis=2)
    side = np.argmax(along, axis=1)
    rows = np.flatnonzero(along.sum(axis=1) == 1)
    edge = interface.triangle_edges[rows, side[rows]]
    order = np.lexsort([rows, edge])
    rows, edge = rows[order], edge[order]
    pair = np.flatnonzero(edge[1:] == edge[:-1])
    first, second = rows[pair], rows[pair + 1]
    # a cell lies in one patch, and its corners are four
    patch = interface.triangle_patch
    tips = [interface.triangles[t, (side[t] + 2) % 3] for t in (first, second)]
    good = (patch[first] == patch[second]) & (tips[0] != tips[1])
    first, second = first[good], second[good]
    return first, second, np.stack([side[first], side[second]], axis=1)


def _join(
    columns: np.ndarray, first: np.ndarray, second: np.ndarray, turn: np.ndarray
) -> np.ndarray:
    """Hexahedra over the cells by layer, (layers, c, 20).

    The first triangle of a cell is a, b, c and the second c, d, a, where the diagonal is c-a.
    """
    cells = np.arange(len(first))
    sides = [(turn[:, :1] + shift) % 3 for shift in (0, 1, 2)]
    others = [(turn[:, 1:] + shift) % 3 for shift in (0, 1, 2)]
    a, b, c, d = sides[1], sides[2], sides[0], others[2]
    # edges of a triangle are named by where they begin
    ab, bc, cd, da = sides[1], sides[2], others[1], others[2]
    one, two = columns[:, first], columns[:, second]

    def pick(rows: np.ndarray, place: np.ndarray) -> np.ndarray:
        return rows[:, cells, place[:, 0]][..., None]

    parts = []
    for start in (0, 3):
        parts += [pick(one, start + p) for p in (a, b, c)] + [pick(two, start + d)]
    for start in (6, 9):
        parts += [pick(one, start + ab), pick(one, start + bc)]
        parts += [pick(two, start + cd), pick(two, start + da)]
    parts += [pick(one, 12 + p) for p in (a, b, c)] + [pick(two, 12 + d)]
    return np.concatenate(parts, axis=2)
