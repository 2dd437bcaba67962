# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One conforming finite element mesh of shell and core.

Every column of the shell over an interface triangle is cut into wedges, one a Bézier layer; their
triangles are the faces of the core's tets, so that nodes are shared and nothing is tied. Quadratic
elements have their mid nodes on the exact map of the shell; on the outer boundary that is the CAD
face itself. Nodes are merged by topology, never by distance, and every element's Jacobian is
proved positive.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ..errors import FaultError, MesherError
from .density import Density
from .diagonals import flip_at, flip_flat, refine_at, wedges_over
from .element_jacobians import relative_bound, volumes
from .elements import EDGES, FACES, quadrature, shape_functions, shape_gradients
from .interior import Interface, Interior, crossing_triangles, fill_interior
from .long_cells import better_mesh, shorter_cells
from .repairs import Elements, straighten, untangle_inside
from .shell import Shell
from .sizes import wanted_lines
from .strips import GridLines
from .wedges import Wedges
from .withdrawal import thicken, withdraw_at, withdraw_poor, withdraw_under

logger = logging.getLogger(__name__)

_FLIPS = 2
"""Rounds of flipped diagonals before a grid is made finer."""
_FEW = 20
"""Unproved elements up to which they are untangled before columns are shortened."""
_SHORTENED, _PATIENCE = 8, 2
"""Rounds of shortened columns before a grid is made finer, and those without fewer unproved
elements."""
REPAIRS = ("straightened", "untangled", "flipped", "refined", "withdrawn")
"""Kinds of repairs that are counted."""


@dataclass(frozen=True)
class FiniteElementMesh:
    """Wedges of the shell and tets of the core on shared nodes, in the node order of Abaqus.

    Attributes
    ----------
    order : int
        1 or 2: six-node wedges and four-node tets, or fifteen and ten nodes.
    nodes : (n, 3) array
        mm
    wedges : (m, 15) or (m, 6) int array
        Bottom towards the core, top towards the outer boundary.
    wedge_patch, wedge_layer : (m,) int arrays
        Patch of the shell, and Bézier layer (0 is the outermost).
    tets : (k, 10) or (k, 4) int array
    boundary : (nf, 6) or (nf, 3) int array
        Triangles of the outer boundary, oriented outward: tops of wedges.
    boundary_face : (nf,) int array
        Position of each in ``face_names``.
    boundary_wedge : (nf,) int array
        Wedge under each.
    interface : (ni, 6) or (ni, 3) int array
        Triangles between shell and core, oriented out of the core.
    face_names : tuple of str
        CAD faces.
    wedge_quality, tet_quality : (m,), (k,) arrays
        Smallest scaled Jacobian of each element.
    wedge_bound, tet_bound : (m,), (k,) arrays
        Proved lower bound of det J over the mean edge product of each element.
    repairs : mapping of str to int
        What was done so that all elements are valid: "straightened" mid nodes (moved towards the
        middle of their edge), "untangled" nodes, "flipped" diagonals of cells, "refined" cells (cut
        finer than was wanted), and "withdrawn" columns (shortened where the inner surface's
        triangles cut each other).
    density : Density
        As it was wanted.
    surface_nodes : (nb,) int array
        Nodes of the outer boundary, mid nodes too.
    surface_patch : (nb,) int array
        A patch that each lies on.
    surface_uv : (nb, 2) array
        Its parameters there, on the shell's surface: positions and normals can be evaluated.
    """

    order: int
    nodes: np.ndarray
    wedges: np.ndarray
    wedge_patch: np.ndarray
    wedge_layer: np.ndarray
    tets: np.ndarray
    boundary: np.ndarray
    boundary_face: np.ndarray
    boundary_wedge: np.ndarray
    interface: np.ndarray
    face_names: tuple[str, ...]
    wedge_quality: np.ndarray
    tet_quality: np.ndarray
    wedge_bound: np.ndarray
    tet_bound: np.ndarray
    repairs: Mapping[str, int] = field(default_factory=lambda: dict.fromkeys(REPAIRS, 0))
    density: Density = field(default_factory=Density)
    surface_nodes: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    surface_patch: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    surface_uv: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def wedge_kind(self) -> str:
        """Kind of the wedges in `elements`."""
        return "penta15" if self.order == 2 else "penta6"

    @property
    def tet_kind(self) -> str:
        """Kind of the tets in `elements`."""
        return "tet10" if self.order == 2 else "tet4"

    @property
    def face_kind(self) -> str:
        """Kind of the boundary and interface triangles in `elements`."""
        return "tri6" if self.order == 2 else "tri3"

    @property
    def min_scaled_jacobian(self) -> float:
        """Smallest scaled Jacobian of all elements."""
        return float(min(self.wedge_quality.min(), self.tet_quality.min()))

    @property
    def volume(self) -> float:
        """Sum of the elements' exact volumes, mm³."""
        return self.shell_volume + self.core_volume

    @property
    def shell_volume(self) -> float:
        """Volume of the wedges, mm³."""
        return float(volumes(self.wedge_kind, self.nodes[self.wedges]).sum())

    @property
    def core_volume(self) -> float:
        """Volume of the tets, mm³."""
        return float(volumes(self.tet_kind, self.nodes[self.tets]).sum())

    @property
    def boundary_volume(self) -> float:
        """Volume that the boundary triangles enclose, mm³; an independent sum."""
        return enclosed_volume(self.face_kind, self.nodes, self.boundary)

    def face_triangles(self, name: str) -> np.ndarray:
        """Boundary triangles of a CAD face, (nt, 6) or (nt, 3)."""
        return self.boundary[self.boundary_face == self.face_names.index(name)]

    def face_nodes(self, name: str) -> np.ndarray:
        """Nodes on a CAD face, mid nodes included, sorted."""
        return np.unique(self.face_triangles(name))


def enclosed_volume(kind: str, nodes: np.ndarray, triangles: np.ndarray) -> float:
    """Volume inside closed triangles ("tri3" or "tri6") that are oriented outward, mm³."""
    points, weights = quadrature("tri", 4)
    x = nodes[triangles] - nodes[triangles].mean(axis=(0, 1))
    position = np.einsum("qn,tnc->tqc", shape_functions(kind, points), x)
    tangents = np.einsum("qnd,tnc->tqcd", shape_gradients(kind, points), x)
    normal = np.cross(tangents[..., 0], tangents[..., 1])
    return float(np.einsum("tqc,tqc,q->", position, normal, weights) / 3.0)


def conforming_mesh(
    shell: Shell,
    interface: Interface,
    interior: Interior,
    order: int = 2,
    density: Density | None = None,
) -> FiniteElementMesh:
    """Wedges and tets on shared nodes (decision 10 of the design).

    Parameters
    ----------
    shell : Shell
    interface : Interface
    interior : Interior
    order : {1, 2}
    density : Density, optional
        What the interface was made for.

    Raises
    ------
    MesherError
        Elements stay unproved with straight inner edges; the faces over them are named.
    FaultError
        Faces of elements do not match, or the volumes do not add up.
    """
    if order not in (1, 2):
        raise ValueError(f"order is 1 or 2, not {order}")
    density = density or Density(interface.nodes, interface.subdivide)
    wedges = Wedges(shell, interface, density, order)
    return _mesh(shell, wedges, interior, density)


def _mesh(
    shell: Shell, wedges: Wedges, interior: Interior, density: Density, most: int | None = None
) -> FiniteElementMesh:
    """Wedges and the tets of the core on shared nodes, repaired, proved and checked.

    Where more than ``most`` elements are unproved once edges are straight, none is untangled.
    """
    interface, order = wedges.interface, wedges.order
    nodes, tets, core = _with_core(wedges, interior)
    kinds = [(wedges.kind, wedges.elements), ("tet10" if order == 2 else "tet4", tets)]
    elements = Elements(nodes, kinds)
    repairs = dict.fromkeys(REPAIRS, 0)
    if order == 2 and len(interface.triangles):
        movable, ends = wedges.curved_inside()
        repairs["straightened"] = straighten(elements, movable, ends)
        may_move = np.zeros(len(nodes), dtype=bool)
        may_move[movable] = True
        may_move[core:] = True
        if most is None or elements.unproved <= most:
            repairs["untangled"] = untangle_inside(elements, may_move)
    if not elements.all_proved:
        raise _unproved(shell, wedges, interior, elements)
    names = tuple(dict.fromkeys(patch.face for patch in shell.surface.patches))
    place = {name: k for k, name in enumerate(names)}
    position = np.array([place[patch.face] for patch in shell.surface.patches])
    bounds = [
        relative_bound(kind, elements.nodes[c], bound)
        for (kind, c), bound in zip(kinds, elements.lower_bound, strict=True)
    ]
    count = len(interface.triangles)
    mesh = FiniteElementMesh(
        order=order,
        nodes=elements.nodes,
        wedges=wedges.elements,
        wedge_patch=np.tile(interface.triangle_patch, wedges.layers),
        wedge_layer=np.repeat(np.arange(wedges.layers), count),
        tets=tets,
        boundary=wedges.triangles(0),
        boundary_face=position[interface.triangle_patch],
        boundary_wedge=np.arange(count),
        interface=wedges.triangles(wedges.layers),
        face_names=names,
        wedge_quality=elements.quality[0],
        tet_quality=elements.quality[1],
        wedge_bound=bounds[0],
        tet_bound=bounds[1],
        repairs=repairs,
        density=density,
        surface_nodes=wedges.outer_nodes,
        surface_patch=wedges.patch,
        surface_uv=wedges.uv,
    )
    _check(mesh)
    return mesh


def _shortened_until_proved(
    shell: Shell,
    lines: GridLines,
    density: Density,
    wedges: Wedges,
    flipped: np.ndarray,
    interior: Interior,
) -> tuple[Wedges, Interior, FiniteElementMesh]:
    """The mesh; columns under elements that stay unproved are shortened, the core moves along.

    Many unproved elements are shortened at once, since untangling them takes long; few are
    untangled first.
    """
    fewest, since = np.inf, 0
    for _ in range(_SHORTENED):
        try:
            return wedges, interior, _mesh(shell, wedges, interior, density, _FEW)
        except MesherError as error:
            logger.info("%s", error.line)
            since = 0 if error.figure < fewest else since + 1
            fewest = min(fewest, error.figure)
            if since == _PATIENCE:
                break
            found = withdraw_under(
                shell, lines, density, wedges, flipped, interior, error.triangles
            )
            if found is None:
                break
            wedges, interior = found
    return wedges, interior, _mesh(shell, wedges, interior, density)


def _with_core(wedges: Wedges, interior: Interior) -> tuple[np.ndarray, np.ndarray, int]:
    """All nodes, the tets, and the first node inside the core."""
    interface = wedges.interface
    n, start = len(interface.vertices), len(wedges.nodes)
    inner = interior.mesh.vertices[n:]
    number = np.append(wedges.vertices(wedges.layers), start + np.arange(len(inner)))
    nodes = np.concatenate([wedges.nodes, inner])
    tets = interior.mesh.tets
    if wedges.order == 1:
        return nodes, number[tets], start
    count = len(interior.mesh.vertices)
    ends = np.sort(tets[:, np.array(EDGES["tet10"])], axis=2).reshape(-1, 2)
    keys, inverse = np.unique(ends[:, 0] * count + ends[:, 1], return_inverse=True)
    known = interface.edges[:, 0] * count + interface.edges[:, 1]
    order = np.argsort(known)
    place = np.clip(np.searchsorted(known[order], keys), 0, len(known) - 1)
    shared = known[order][place] == keys
    if np.count_nonzero(shared) != len(known):
        raise FaultError(
            f"the core has {np.count_nonzero(shared)} of {len(known)} interface edges",
            remedy="take another mesher",
        )
    mids = np.empty(len(keys), dtype=np.int64)
    mids[shared] = wedges.edge_mids(wedges.layers)[order[place[shared]]]
    mids[~shared] = len(nodes) + np.arange(np.count_nonzero(~shared))
    corners = np.column_stack([keys // count, keys % count])[~shared]
    nodes = np.concatenate([nodes, interior.mesh.vertices[corners].mean(axis=1)])
    return nodes, np.hstack([number[tets], mids[inverse.reshape(-1, 6)]]), start


def _unproved(shell: Shell, wedges: Wedges, interior: Interior, elements: Elements) -> MesherError:
    """The error that names the faces over elements that are not proved."""
    triangles = wedges.interface.triangles
    bad_wedges, bad_tets = (np.flatnonzero(~p) for p in elements.proved)
    at_interface = np.isin(triangles, interior.mesh.tets[bad_tets]).any(axis=1)
    bad = np.union1d(bad_wedges % len(triangles), np.flatnonzero(at_interface))
    patches = np.unique(wedges.interface.triangle_patch[bad])
    error = MesherError(
        f"{len(bad_wedges)} wedges and {len(bad_tets)} tets of order {wedges.order} are not"
        " proved valid",
        faces=list(dict.fromkeys(shell.surface.patches[k].face for k in patches)),
        figure=float(len(bad_wedges) + len(bad_tets)),
        remedy="subdivide the interface or choose a smaller w0",
    )
    error.triangles = bad
    return error


def build_finite_elements(
    shell: Shell,
    density: Density | None = None,
    *,
    order: int = 2,
    finest: int = 4,
    engine: str = "auto",
    free: bool | None = None,
    max_size: float | None = None,
    time_limit: float = 120.0,
) -> tuple[Interface, Interior, FiniteElementMesh]:
    """Interface, core and conforming mesh; the interface is refined until all three hold.

    A coarse grid may give facets that cut each other, or elements that cannot be proved, although
    the shell is certified. Then the diagonals of the cells at fault are flipped, columns under
    facets that cut each other are shortened, and the columns at fault are cut finer, with the
    strips that they belong to. Where no density is wished for, so are long cells at needles.

    Parameters
    ----------
    shell : Shell
    density : Density, optional
        Wanted density; by default the cells and layers of the shell.
    order : {1, 2}
    finest : int
        Into how many parts a side of a wanted cell may be cut by repairs.
    engine, free, max_size, time_limit
        As for `fill_interior`.

    Raises
    ------
    InputError
        The density does not fit the body.
    MesherError
        The last reason, when the finest grid failed too.
    """
    if order not in (1, 2):
        raise ValueError(f"order is 1 or 2, not {order}")
    density = density or Density()
    options = {"engine": engine, "max_size": max_size, "free": free, "time_limit": time_limit}
    wanted = lines = wanted_lines(shell.surface, density)
    best = found = _searched(shell, density, order, finest, wanted, lines, options)
    while density.plain:
        finer = shorter_cells(found.lines, wanted, found.wedges, found.interior, found.mesh, finest)
        if finer is None:
            break
        try:
            found = _searched(shell, density, order, finest, wanted, finer, options)
        except MesherError as error:
            logger.info("shorter cells: %s", error.line)
            break
        best = better_mesh(best, found)
    repairs = {
        "flipped": int(np.count_nonzero(best.flipped)),
        "refined": best.lines.within(wanted),
        "withdrawn": int(np.count_nonzero(best.wedges.interface.vertex_w < 1.0)),
    }
    mesh = replace(best.mesh, repairs={**best.mesh.repairs, **repairs})
    logger.info(
        "finite elements: %d nodes, %d wedges, %d tets, smallest scaled Jacobian %.4f, %s",
        len(mesh.nodes),
        len(mesh.wedges),
        len(mesh.tets),
        mesh.min_scaled_jacobian,
        ", ".join(f"{count} {kind}" for kind, count in mesh.repairs.items()),
    )
    return best.wedges.interface, best.interior, mesh


@dataclass(frozen=True, eq=False)
class _Found:
    """A mesh, with the grid and the repairs that it came from."""

    lines: GridLines
    flipped: np.ndarray
    wedges: Wedges
    interior: Interior
    mesh: FiniteElementMesh


def _searched(
    shell: Shell,
    density: Density,
    order: int,
    finest: int,
    wanted: GridLines,
    lines: GridLines,
    options: Mapping[str, Any],
) -> _Found:
    """The mesh over a grid, which is refined until core and elements are proved."""
    flipped: np.ndarray | None = None
    reach: np.ndarray | None = None
    tries = 0
    while True:
        wedges, finer = None, None
        try:
            wedges, flipped = wedges_over(shell, lines, density, order, flipped, reach)
            folded = wedges.folded()
            if len(folded):
                logger.info("%d outer triangles are folded", len(folded))
                finer = refine_at(lines, wanted, folded, finest, wedges.cell_sides())
            if finer is None:
                if reach is None:
                    wedges, reach = withdraw_poor(shell, lines, density, wedges, flipped)
                interior = fill_interior(wedges.interface, surface=shell.surface, **options)
                wedges, flipped, interior = flip_flat(
                    shell, lines, density, wedges, flipped, reach, interior
                )
                wedges, interior = thicken(shell, lines, density, wedges, flipped, interior)
                wedges, interior, mesh = _shortened_until_proved(
                    shell, lines, density, wedges, flipped, interior
                )
                return _Found(lines, flipped, wedges, interior, mesh)
        except MesherError as error:
            logger.info("interface of %d cells: %s", lines.cells, error.line)
            sides = None
            if wedges is not None:
                sides = wedges.cell_sides()
                if tries < _FLIPS:
                    more = flip_at(shell, lines, density, wedges, flipped, error.triangles, reach)
                    if more is not None:
                        flipped, tries = more, tries + 1
                        continue
                crossing = crossing_triangles(wedges.interface)
                if len(crossing):
                    shorter = withdraw_at(wedges.interface, crossing)
                    if shorter is not None:
                        reach = shorter
                        continue
            finer = refine_at(lines, wanted, error.triangles, finest, sides)
            if finer is None:
                raise
        lines, flipped, reach, tries = finer, None, None, 0


def _check(mesh: FiniteElementMesh) -> None:
    """Every face belongs to two elements or to the boundary, and the volumes add up."""
    for size in {len(f) for kind in (mesh.wedge_kind, mesh.tet_kind) for f in FACES[kind]}:
        rows = [
            connectivity[:, face]
            for kind, connectivity in ((mesh.wedge_kind, mesh.wedges), (mesh.tet_kind, mesh.tets))
            for face in FACES[kind]
            if len(face) == size
        ]
        if size == mesh.boundary.shape[1]:
            rows.append(mesh.boundary)
        rows = np.sort(np.concatenate(rows), axis=1)
        rows = np.ascontiguousarray(rows[np.lexsort(rows.T)])
        if len(rows) % 2 or not np.array_equal(rows[::2], rows[1::2]):
            raise FaultError("faces of the finite elements do not match in pairs")
        if (rows[1:-1:2] == rows[2::2]).all(axis=1).any():
            raise FaultError("more than two finite elements share a face")
    volume, enclosed = mesh.volume, mesh.boundary_volume
    if abs(volume - enclosed) > 1e-10 * abs(enclosed):
        raise FaultError(
            f"the finite elements have {volume:.12g} mm³, their boundary encloses"
            f" {enclosed:.12g} mm³",
            figure=volume - enclosed,
        )
