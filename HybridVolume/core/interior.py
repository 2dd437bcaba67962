# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The interface I between shell and core, and the tetrahedra T that fill the core (section 3.3).

Interface nodes are points x_l = s_bar(t_l) of the inner surface over a parameter grid; two
triangles a grid cell join them. The same diagonals cut the shell's columns into wedges, so that one
conforming mesh of both can be made (finite_elements). Facets and inner surface do not coincide;
`gap_volume` integrates what lies between them.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, field

import numpy as np

from ..errors import FaultError, MesherError
from .columns import doubled_grid, evaluate_columns, grid_cells
from .element_jacobians import scaled_jacobian
from .elements import reference
from .gap import gap_volume, triangle_gaps
from .intersection import self_intersections
from .shell import Shell
from .strips import GridLines, base_lines
from .surface import PatchSurface
from .tetmesh import TetMesh, available_engines, enclosed_volume, fill, improve

__all__ = [
    "Interface",
    "Interior",
    "build_interface",
    "fill_interior",
    "gap_volume",
    "triangle_gaps",
]

logger = logging.getLogger(__name__)

GOOD_ANGLE = 1.0
"""Degrees; a mesher whose flattest tet has less is followed by the next one, the better stays."""

LARGE = 4000
"""Triangles of an interface from which on one mesher's answer is enough: a second one takes long,
and what is flat in it is so by the triangles."""

GRADING = 0.3
"""Growth of the core's edges away from the interface: with more the tets get flat."""

FLAT = 1e-10
"""A tet with less than this of the cube of its longest edge has no volume but by rounding."""


@dataclass(frozen=True)
class Interface:
    """Nodes and triangles on the inner surface.

    Attributes
    ----------
    vertices : (n, 3) array
        The x_l, mm. With ``nodes="greville"`` and no subdivision, vertex l belongs to control
        point l.
    vertex_patch : (n,) int array
        The lowest-numbered patch that has the vertex.
    vertex_uv : (n, 2) array
        Its parameters t_l there.
    triangles : (m, 3) int array
        Oriented out of the core (towards the outer boundary).
    triangle_patch : (m,) int array
    triangle_uv : (m, 3, 2) array
        Parameters of the corners on the triangle's own patch.
    edges : (e, 2) int array
        Ends of each edge.
    edge_patch : (e,) int array
    edge_uv : (e, 2) array
        Parameters of the middle of each edge.
    midpoints : (e, 3) array
        s_bar there: mid nodes of quadratic elements, mm.
    triangle_edges : (m, 3) int array
        Edges 0-1, 1-2, 2-0 of each triangle.
    nodes : str
        "knots" or "greville".
    subdivide : int
        Into how many parts each cell's sides were cut.
    vertex_w, edge_w : (n,), (e,) arrays
        Parameter w of each vertex and mid point on its column: 1 on the inner surface, less where
        its triangles would cut each other; empty where all are 1.
    """

    vertices: np.ndarray
    vertex_patch: np.ndarray
    vertex_uv: np.ndarray
    triangles: np.ndarray
    triangle_patch: np.ndarray
    triangle_uv: np.ndarray
    edges: np.ndarray
    edge_patch: np.ndarray
    edge_uv: np.ndarray
    midpoints: np.ndarray
    triangle_edges: np.ndarray
    nodes: str
    subdivide: int
    vertex_w: np.ndarray = field(default_factory=lambda: np.zeros(0))
    edge_w: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def volume(self) -> float:
        """Volume inside the flat facets, mm³."""
        return enclosed_volume(self.vertices, self.triangles)


def build_interface(
    shell: Shell,
    nodes: str = "knots",
    subdivide: int = 1,
    *,
    lines: GridLines | None = None,
    flipped: np.ndarray | None = None,
    reach: np.ndarray | None = None,
) -> Interface:
    """Nodes and triangles of the inner surface over a parameter grid (section 3.3, Fig. 5).

    Each grid cell is cut along the diagonal that gives the better wedges between inner and outer
    boundary.

    Parameters
    ----------
    shell : Shell
    nodes : {"knots", "greville"}
        Grid lines at the knots (triangles do not straddle knot lines) or at the Greville
        abscissae, the paper's node locations.
    subdivide : int
        Cut every cell into ``subdivide`` x ``subdivide``.
    lines : GridLines, optional
        Where the grid lines stand, instead.
    flipped : (nc,) bool array, optional
        Cells that are cut along the other diagonal; triangles 2 c and 2 c + 1 are those of cell c.
    reach : (n,) array, optional
        Parameter w of each vertex, by default 1 for all.

    Raises
    ------
    MesherError
        The grid is too coarse: two triangles or edges would have the same nodes.
    """
    surface = shell.surface
    if lines is None:
        lines = base_lines(surface, nodes)
        lines = lines.cut([np.full(len(p) - 1, subdivide) for p in lines.places])
    grid = doubled_grid(surface, *lines.lines())
    number, is_vertex = _node_numbers(
        grid.ids, surface if nodes == "greville" and lines.plain else None
    )
    cells, cell_patch, cell_uv = grid_cells(grid)
    levels = evaluate_columns(shell, grid.owner, grid.uv, np.array([0.0, 0.5, 1.0]))
    second = _better_diagonal(levels, cells)
    if flipped is not None:
        second = second ^ flipped

    # corners and mid nodes of both triangles of a cell, positions in its 3 x 3 grid points
    corner = np.where(second[:, None, None], _CORNERS[1], _CORNERS[0]).reshape(-1, 3)
    middle = np.where(second[:, None, None], _MIDDLES[1], _MIDDLES[0]).reshape(-1, 3)
    cell = np.repeat(np.arange(len(cells)), 2)[:, None]
    flat = cells.reshape(-1, 9)
    triangles = number[flat[cell, corner]]
    triangle_edges = number[flat[cell, middle]]
    triangle_uv = cell_uv.reshape(-1, 9, 2)[cell, corner]

    vertex_point = np.empty(np.count_nonzero(is_vertex), dtype=np.int64)
    vertex_point[number[is_vertex]] = np.flatnonzero(is_vertex)
    edge_point = np.empty(len(number) - len(vertex_point), dtype=np.int64)
    edge_point[number[~is_vertex]] = np.flatnonzero(~is_vertex)
    edges = np.empty((len(edge_point), 2), dtype=np.int64)
    ends = np.stack([triangles, np.roll(triangles, -1, axis=1)], axis=2)
    edges[triangle_edges.ravel()] = np.sort(ends.reshape(-1, 2), axis=1)
    _check_simplices(triangles, edges, np.repeat(cell_patch, 2), surface)
    vertices, midpoints = levels[-1, vertex_point], levels[-1, edge_point]
    ends: tuple[np.ndarray, ...] = ()
    if reach is not None:
        ends = (reach, reach[edges].mean(axis=1))
        for x, w, point in zip(
            (vertices, midpoints), ends, (vertex_point, edge_point), strict=True
        ):
            short = np.flatnonzero(w < 1.0)
            if not len(short):
                continue
            at = grid.owner[point[short]], grid.uv[point[short]]
            x[short] = evaluate_columns(shell, *at, w[None, short])[0]
    return Interface(
        vertices=vertices,
        vertex_patch=grid.owner[vertex_point],
        vertex_uv=grid.uv[vertex_point],
        triangles=triangles,
        triangle_patch=np.repeat(cell_patch, 2),
        triangle_uv=triangle_uv,
        edges=edges,
        edge_patch=grid.owner[edge_point],
        edge_uv=grid.uv[edge_point],
        midpoints=midpoints,
        triangle_edges=triangle_edges,
        nodes=nodes,
        subdivide=subdivide,
        **dict(zip(("vertex_w", "edge_w"), ends, strict=False)),
    )


# Grid points of a cell are numbered 3 * (half steps in u) + (half steps in v).
_CORNERS = np.array([[[0, 6, 8], [0, 8, 2]], [[0, 6, 2], [6, 8, 2]]])
_MIDDLES = np.array([[[3, 7, 4], [4, 5, 1]], [[3, 4, 1], [7, 5, 4]]])


def _node_numbers(
    ids: tuple[np.ndarray, ...], greville: PatchSurface | None
) -> tuple[np.ndarray, np.ndarray]:
    """Number of each grid point among the vertices or among the edges, and which it is."""
    count = 1 + max(int(g.max()) for g in ids)
    is_vertex = np.zeros(count, dtype=bool)
    for g in ids:
        is_vertex[g[::2, ::2]] = True
    number = np.where(is_vertex, np.cumsum(is_vertex), np.cumsum(~is_vertex)) - 1
    if greville is not None:
        for g, patch in zip(ids, greville.patches, strict=True):
            number[g[::2, ::2]] = patch.index
    return number, is_vertex


def _better_diagonal(levels: np.ndarray, cells: np.ndarray) -> np.ndarray:
    """Whether to cut each cell along its second diagonal, (nc,).

    By the worst scaled Jacobian of the quadratic wedges from the inner to the outer boundary, at
    their nodes; the shorter way where both are equal.
    """
    flat = cells.reshape(-1, 9)
    outer, half, inner = levels
    points = reference("penta15").nodes
    worst = []
    for way in range(2):
        corner, middle = flat[:, _CORNERS[way]], flat[:, _MIDDLES[way]]
        nodes = np.concatenate(
            [inner[corner], outer[corner], inner[middle], outer[middle], half[corner]], axis=2
        )
        quality = scaled_jacobian("penta15", nodes.reshape(-1, 15, 3), points)
        worst.append(quality.reshape(-1, 2).min(axis=1))
    length = [
        sum(np.linalg.norm(x[flat[:, a]] - x[flat[:, b]], axis=1) for x in (inner, outer))
        for a, b in ((0, 8), (6, 2))
    ]
    equal = np.abs(worst[0] - worst[1]) < 1e-6
    shorter = length[1] < length[0] * (1.0 - 1e-9)
    return np.where(equal, shorter, worst[1] > worst[0])


def _check_simplices(
    triangles: np.ndarray, edges: np.ndarray, patch: np.ndarray, surface: PatchSurface
) -> None:
    rows = np.sort(triangles, axis=1)
    _, inverse, count = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
    bad = count[inverse.reshape(-1)] > 1
    bad |= (np.diff(rows, axis=1) == 0).any(axis=1)
    _, inverse, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    twice = edges[count[inverse.reshape(-1)] > 1]
    bad |= np.isin(triangles, twice).sum(axis=1) > 1
    if len(twice) or bad.any():
        error = MesherError(
            "the grid of the interface is too coarse: different edges have the same ends",
            faces=_faces(surface, patch[bad]),
            figure=float(len(twice)),
            remedy="subdivide the interface",
        )
        error.triangles = np.flatnonzero(bad)
        raise error


def _faces(surface: PatchSurface, patches: np.ndarray) -> list[str]:
    return list(dict.fromkeys(surface.patches[k].face for k in np.unique(patches)))


@dataclass(frozen=True)
class Interior:
    """The core T.

    Attributes
    ----------
    mesh : TetMesh
        Its first vertices are those of the interface, bit for bit and in the same order.
    volume : float
        mm³
    min_dihedral : float
        Smallest dihedral angle, degrees.
    boundary_exact : bool
        Every vertex and triangle of the interface was found again, and no other boundary.
    """

    mesh: TetMesh
    volume: float
    min_dihedral: float
    boundary_exact: bool


def fill_interior(
    interface: Interface,
    engine: str = "auto",
    *,
    surface: PatchSurface | None = None,
    max_size: float | None = None,
    free: bool | None = None,
    time_limit: float = 120.0,
) -> Interior:
    """Fill the core with tetrahedra that keep every vertex and triangle of the interface.

    Parameters
    ----------
    interface : Interface
    engine : {"auto", "netgen", "gmsh"}
        "auto" tries the installed ones until one gives no nearly flat tets.
    surface : PatchSurface, optional
        Names the faces in an error.
    max_size : float, optional
        Wanted largest edge, mm.
    free : bool, optional
        Use no mesher under the GPL; by default as the environment says.
    time_limit : float
        Seconds for each mesher.

    Raises
    ------
    MesherError
        The facets cut each other, or no mesher filled the core.
    FaultError
        A mesher's answer does not keep the interface.
    """
    _check_embedded(interface, surface)
    engines = [engine]
    if engine == "auto":
        engines = [name for name in available_engines(free=free) if name != "pytetwild"] or engines
    best: Interior | None = None
    reasons = []
    for name in engines:
        try:
            mesh = fill(
                interface.vertices,
                interface.triangles,
                max_size=max_size,
                grading=GRADING,
                engine=name,
                free=free,
                time_limit=time_limit,
            )
        except MesherError as error:
            reasons.append(error.message)
            continue
        found = checked_interior(improve(mesh), interface)
        flat = _flatness(found.mesh).min()
        if flat < FLAT:
            reasons.append(f"{name} gave flat tets (volume {flat:.1e} of the longest edge's cube)")
            continue
        if best is None or found.min_dihedral > best.min_dihedral:
            best = found
        if best.min_dihedral >= GOOD_ANGLE or len(interface.triangles) > LARGE:
            break
    if best is None:
        raise MesherError("; ".join(reasons), remedy="subdivide the interface")
    logger.info(
        "core: %d tets by %s, smallest dihedral angle %.2f degrees",
        len(best.mesh),
        best.mesh.engine,
        best.min_dihedral,
    )
    return best


def crossing_triangles(interface: Interface) -> np.ndarray:
    """Triangles of the interface that cut or touch others which are not next to them, sorted."""
    return np.unique(self_intersections(interface.vertices, interface.triangles))


def _check_embedded(interface: Interface, surface: PatchSurface | None) -> None:
    pairs = self_intersections(interface.vertices, interface.triangles)
    if len(pairs):
        crossing = np.unique(pairs)
        patches = np.unique(interface.triangle_patch[crossing])
        error = MesherError(
            f"{len(pairs)} pairs of the core's boundary triangles cut each other",
            faces=_faces(surface, patches) if surface is not None else (),
            figure=float(len(pairs)),
            remedy="subdivide the interface or choose a smaller w0",
        )
        error.triangles = crossing
        raise error


def _flatness(mesh: TetMesh) -> np.ndarray:
    """Volume over the cube of the longest edge, (m,)."""
    x = mesh.vertices[mesh.tets]
    edges = x[:, [0, 1, 2, 0, 1, 2]] - x[:, [1, 2, 0, 3, 3, 3]]
    return mesh.volumes / np.linalg.norm(edges, axis=2).max(axis=1) ** 3


def checked_interior(mesh: TetMesh, interface: Interface) -> Interior:
    """A mesh of the core with its figures.

    Raises
    ------
    FaultError
        It does not keep the interface, or not all tets have a positive volume.
    """
    exact = _keeps_interface(mesh, interface)
    volume, wanted = mesh.volume, interface.volume
    if not exact or mesh.volumes.min() <= 0.0 or abs(volume - wanted) > 1e-10 * abs(wanted):
        raise FaultError(
            f"{mesh.engine} did not keep the interface: {volume:.12g} mm³ of {wanted:.12g} mm³,"
            f" smallest tet {mesh.volumes.min():.2g} mm³",
            figure=volume - wanted,
            remedy="take another mesher",
        )
    return Interior(mesh, volume, float(mesh.min_dihedral_angles().min()), exact)


def _keeps_interface(mesh: TetMesh, interface: Interface) -> bool:
    n = len(interface.vertices)
    if mesh.vertices[:n].tobytes() != np.ascontiguousarray(interface.vertices).tobytes():
        return False

    def rows(triangles: np.ndarray) -> np.ndarray:
        start = np.argmin(triangles, axis=1)[:, None]
        turned = np.take_along_axis(triangles, (start + np.arange(3)) % 3, axis=1)
        return turned[np.lexsort(turned.T)]

    # equal as oriented triangles
    return np.array_equal(rows(mesh.boundary_triangles), rows(interface.triangles))
