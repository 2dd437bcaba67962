# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The harmonic function w: 0 on the surface, 1 on the midstructure (section 3.1, Eq. 2)."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial import cKDTree

from ..errors import FaultError
from .harmonic_domain import Domain, build_domain
from .isosurface import genus_from_euler, isosurface_euler
from .midstructure import Midstructure
from .surface import PatchSurface
from .tetmesh import TetMesh
from .tetmesh.mesh import EDGES, row_keys

log = logging.getLogger(__name__)

# Points are inside a tetrahedron down to this barycentric coordinate.
INSIDE = -1e-6
# What w may leave [0, 1] by before it is called wrong.
ROUNDING = 1e-8
# Volume of a flat tetrahedron in cubes of its edges.
FLAT = 1e-9


def hat_gradients(mesh: TetMesh) -> np.ndarray:
    """Gradients of the four linear functions of every tetrahedron, (m, 4, 3), 1/mm."""
    x = mesh.vertices[mesh.tets]
    a, b, c = (x[:, i] - x[:, 0] for i in (1, 2, 3))
    # flat tetrahedra count as a little thicker than they are: nothing is gained from their slopes
    longest = np.max([(v * v).sum(axis=1) for v in (a, b, c)], axis=0) ** 1.5
    six = 6.0 * np.maximum(mesh.volumes, FLAT * longest)[:, None]
    gradients = np.empty((len(mesh), 4, 3))
    gradients[:, 1] = np.cross(b, c) / six
    gradients[:, 2] = np.cross(c, a) / six
    gradients[:, 3] = np.cross(a, b) / six
    gradients[:, 0] = -gradients[:, 1:].sum(axis=1)
    return gradients


@dataclass(frozen=True)
class HarmonicField:
    """The function w on tetrahedra.

    Attributes
    ----------
    mesh : TetMesh
    w : (n,) array
        Value at every vertex, in [0, 1].
    gradient : (n, 3) array
        Recovered gradient at every vertex (means of the tetrahedra around, weighted by volume),
        1/mm.
    fixed : (n,) bool array
        Vertices of the midstructure, where w = 1.
    embedded : bool
        Whether the kept facets are faces of the tetrahedra.
    """

    mesh: TetMesh
    w: np.ndarray
    gradient: np.ndarray
    fixed: np.ndarray
    embedded: bool

    @cached_property
    def tet_gradient(self) -> np.ndarray:
        """The exact gradient of the piecewise linear w in every tetrahedron, (m, 3), 1/mm."""
        return np.einsum("mk,mki->mi", self.w[self.mesh.tets], self._hats)

    @cached_property
    def _hats(self) -> np.ndarray:
        return hat_gradients(self.mesh)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.mesh.vertices[self.mesh.tets].mean(axis=1))

    def locate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Tetrahedra that hold points, by walking from the nearest centroid through faces.

        Parameters
        ----------
        points : (k, 3) array

        Returns
        -------
        tet : (k,) int array
            For points outside, the one where the walk met the boundary.
        barycentric : (k, 4) array
        inside : (k,) bool array
        """
        points = np.asarray(points, dtype=float)
        tet, barycentric, inside = self._walk(points, self._tree.query(points)[1])
        lost = np.flatnonzero(~inside)
        if len(lost):
            # a walk can end at the boundary of a body that is not convex: start nearby again
            number = min(6, len(self.mesh))
            starts = self._tree.query(points[lost], k=number)[1].reshape(len(lost), -1)
            for column in range(1, starts.shape[1]):
                again, values, found = self._walk(points[lost], starts[:, column])
                better = values.min(axis=1) > barycentric[lost].min(axis=1)
                change = lost[better]
                tet[change], barycentric[change] = again[better], values[better]
                inside[change] = found[better]
                still = ~inside[lost]
                lost, starts = lost[still], starts[still]
                if not len(lost):
                    break
        return tet, barycentric, inside

    def _barycentric(self, points: np.ndarray, tet: np.ndarray) -> np.ndarray:
        origin = self.mesh.vertices[self.mesh.tets[tet, 0]]
        values = np.einsum("kji,ki->kj", self._hats[tet], points - origin)
        values[:, 0] += 1.0
        return values

    def _walk(
        self, points: np.ndarray, start: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        tet = np.array(start, dtype=np.int64)
        barycentric = np.empty((len(points), 4))
        inside = np.zeros(len(points), dtype=bool)
        active = np.arange(len(points))
        neighbours = self.mesh.neighbours
        for _ in range(500):
            values = self._barycentric(points[active], tet[active])
            barycentric[active] = values
            worst = values.argmin(axis=1)
            least = values[np.arange(len(active)), worst]
            inside[active] = least >= INSIDE
            following = neighbours[tet[active], worst]
            go = (least < INSIDE) & (following >= 0)
            active = active[go]
            if not len(active):
                break
            tet[active] = following[go]
        return tet, barycentric, inside

    def evaluate(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """w and its gradient at points.

        Parameters
        ----------
        points : (k, 3) array
            mm.

        Returns
        -------
        w : (k,) array
            Outside the tetrahedra extended linearly, negative as a rule.
        gradient : (k, 3) array
            Interpolated from the vertices; where vertices of the midstructure take part, their
            share comes from the tetrahedron itself, since the gradient jumps there. 1/mm.
        inside : (k,) bool array
        """
        tet, barycentric, inside = self.locate(points)
        corners = self.mesh.tets[tet]
        w = np.einsum("kj,kj->k", barycentric, self.w[corners])
        share = np.clip(barycentric, 0.0, 1.0)
        share /= share.sum(axis=1, keepdims=True)
        values = np.where(
            self.fixed[corners][..., None],
            self.tet_gradient[tet][:, None],
            self.gradient[corners],
        )
        return w, np.einsum("kj,kji->ki", share, values), inside

    def isosurface_euler(self, level: float) -> np.ndarray:
        """Euler characteristic of every component of {w = level}, the largest last."""
        return isosurface_euler(self.mesh, self.w, level)

    def isosurface_genus(self, level: float) -> tuple[int, ...]:
        """Genus of every component of {w = level}, sorted."""
        return genus_from_euler(self.isosurface_euler(level))

    def largest_level(self, genus_per_shell: Sequence[int], asked: float) -> float:
        """The largest level up to ``asked`` whose isosurface looks like the body's shells.

        Parameters
        ----------
        genus_per_shell : sequence of int
        asked : float

        Returns
        -------
        float
            0 when no level fits.
        """
        wanted = tuple(sorted(int(g) for g in genus_per_shell))
        if self.isosurface_genus(asked) == wanted:
            return float(asked)
        levels = np.linspace(0.0, asked, 41)[1:-1]
        for place in range(len(levels) - 1, -1, -1):
            if self.isosurface_genus(levels[place]) == wanted:
                break
        else:
            return 0.0
        low, high = levels[place], np.append(levels, asked)[place + 1]
        for _ in range(8):
            middle = 0.5 * (low + high)
            if self.isosurface_genus(middle) == wanted:
                low = middle
            else:
                high = middle
        return float(low)


def solve_harmonic(
    surface: PatchSurface,
    midstructure: Midstructure,
    *,
    tets: int = 40_000,
    engine: str = "auto",
    free: bool | None = None,
    time_limit: float = 30.0,
) -> HarmonicField:
    """Solve Laplace's equation between the surface and the midstructure.

    Parameters
    ----------
    surface : PatchSurface
    midstructure : Midstructure
    tets : int
        Tetrahedra aimed at.
    engine : {"auto", "gmsh", "netgen", "pytetwild"}
    free : bool, optional
        Use nothing under the GPL.
    time_limit : float
        Seconds for each mesher.

    Raises
    ------
    MesherError
        No mesher could fill the body.
    FaultError
        The linear system cannot be solved.
    """
    domain = build_domain(
        surface, midstructure, tets=tets, engine=engine, free=free, time_limit=time_limit
    )
    return solve_on(domain)


def solve_on(domain: Domain) -> HarmonicField:
    """The field on a given domain (see :func:`solve_harmonic`)."""
    mesh = domain.mesh
    n = len(mesh.vertices)
    hats = hat_gradients(mesh)
    local = np.einsum("mai,mbi->mab", hats, hats) * np.abs(mesh.volumes)[:, None, None]
    fixed = domain.inner & ~mesh.on_boundary
    w = _maximum_principle(mesh, local, fixed)
    tied = tie_parts(mesh, w, fixed)
    if len(tied):
        log.info("the midstructure lay in pieces: tied together by %d vertices", len(tied))
        fixed[tied] = True
        w = _maximum_principle(mesh, local, fixed)
    slope = np.einsum("mk,mki->mi", w[mesh.tets], hats)
    weight = np.bincount(mesh.tets.ravel(), np.repeat(mesh.volumes, 4), n)
    gradient = np.column_stack(
        [
            np.bincount(mesh.tets.ravel(), np.repeat(mesh.volumes * slope[:, i], 4), n)
            for i in range(3)
        ]
    ) / np.maximum(weight, np.finfo(float).tiny)[:, None]  # fmt: skip
    log.info("harmonic field: %d tetrahedra, %d vertices (%s)", len(mesh), n, mesh.engine)
    return HarmonicField(mesh, w, gradient, fixed, domain.embedded)


def release_islands(
    field: HarmonicField, level: float, share: float = 0.03
) -> tuple[HarmonicField, int]:
    """Let go of parts of the midstructure that only lift the field near themselves.

    Where a body is necked, {w > level} falls into pieces; a piece that holds next to none of the
    volume is no part of the core, and the inner boundary needs no hole around it.

    Parameters
    ----------
    field : HarmonicField
    level : float
    share : float
        Largest share of the volume of {w > level} that counts as next to none.

    Returns
    -------
    field : HarmonicField
        Solved anew where anything was let go.
    released : int
        Number of pieces that were let go.
    """
    mesh, released = field.mesh, 0
    inner = field.fixed.copy()
    for _ in range(3):
        above = field.w > level
        edges = mesh.edges[above[mesh.edges].all(axis=1)]
        n = len(mesh.vertices)
        graph = sparse.coo_matrix((np.ones(len(edges)), edges.T), shape=(n, n))
        _, piece = connected_components(graph, directed=False)
        volume = np.repeat(mesh.volumes / 4.0, 4)
        size = np.bincount(piece[mesh.tets.ravel()], volume * above[mesh.tets.ravel()], len(piece))
        pieces = np.unique(piece[above])
        slight = pieces[size[pieces] < share * size.sum()]
        gone = inner & np.isin(piece, slight)
        if not gone.any() or np.array_equal(gone, inner):
            break
        inner &= ~gone
        released += len(np.unique(piece[gone]))
        field = solve_on(Domain(mesh, inner, field.embedded))
    if released:
        log.info("%d parts of the midstructure let go: they only lift w near themselves", released)
    return field, released


def tie_parts(mesh: TetMesh, w: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Vertices that tie the parts of the midstructure together where they meet at the highest w.

    Where the midstructure lies in pieces, the isosurfaces near 1 do, too. Ties over the highest
    saddles join what would join at some lower level anyway, and add no handles.

    Parameters
    ----------
    mesh : TetMesh
    w : (n,) array
        The field without ties.
    fixed : (n,) bool array
        Vertices of the midstructure.
    """
    n = len(w)
    a, b = mesh.edges[~mesh.on_boundary[mesh.edges].any(axis=1)].T
    inside = fixed[a] & fixed[b]
    shape = (n, n)
    part = sparse.coo_matrix((np.ones(int(inside.sum())), (a[inside], b[inside])), shape=shape)
    if len(np.unique(connected_components(part, directed=False)[1][fixed])) <= 1:
        return np.zeros(0, dtype=np.int64)
    low = np.where(inside, 1.0, np.minimum(w[a], w[b]))
    # ties between equal values (flat tetrahedra) are broken by the length
    length = np.linalg.norm(mesh.vertices[a] - mesh.vertices[b], axis=1)
    cost = (1.0 - low) + 1e-6 * (length / length.max()) + 1e-9
    tree = minimum_spanning_tree(sparse.coo_matrix((cost, (a, b)), shape=shape)).tocoo()
    ends = np.column_stack([tree.row, tree.col])
    keep = fixed.copy()
    keep[ends] = True
    while True:
        # what hangs off the tree without a vertex of the midstructure is not needed
        degree = np.bincount(ends.ravel(), minlength=n)
        leaf = keep & ~fixed & (degree <= 1)
        if not leaf.any():
            break
        keep &= ~leaf
        ends = ends[keep[ends].all(axis=1)]
    return np.flatnonzero(keep & ~fixed)


def _maximum_principle(mesh: TetMesh, local: np.ndarray, fixed: np.ndarray) -> np.ndarray:
    """Solve with w = 1 at fixed vertices and w = 0 on the boundary, such that 0 <= w <= 1.

    Flat tetrahedra can give positive entries beside the diagonal, and then values beyond the
    boundary values. Edges around such values lose these entries until the principle holds; with
    none of them left it holds for certain.
    """
    n = len(mesh.vertices)
    edges = mesh.edges
    keys = row_keys(mesh.tets[:, EDGES].reshape(-1, 2), n)
    of_tet = np.searchsorted(row_keys(edges, n), keys)
    values = -local[:, EDGES[:, 0], EDGES[:, 1]].ravel()
    conductance = np.bincount(of_tet, values, len(edges))
    free = np.flatnonzero(~fixed & ~mesh.on_boundary)
    w = fixed.astype(float)
    if not len(free):
        return w
    for attempt in range(20):
        stiffness = _graph_laplacian(edges, conductance, n)
        w[free] = _solve(stiffness[free][:, free], -(stiffness[free][:, fixed] @ w[fixed]))
        wrong = (w < -ROUNDING) | (w > 1.0 + ROUNDING)
        if not wrong.any():
            break
        log.info(
            "w leaves [0, 1] by %.2g at %d vertices beside flat tetrahedra",
            max(-w.min(), w.max() - 1.0),
            int(wrong.sum()),
        )
        around = wrong[edges].any(axis=1)
        for _ in range(attempt):
            near = np.zeros(n, dtype=bool)
            near[edges[around]] = True
            around = near[edges].any(axis=1)
        conductance = np.where(around, np.maximum(conductance, 0.0), conductance)
    else:
        raise FaultError("the harmonic function leaves [0, 1]", remedy="refine the surface")
    return np.clip(w, 0.0, 1.0)


def _graph_laplacian(edges: np.ndarray, conductance: np.ndarray, n: int) -> sparse.csr_matrix:
    rows, columns = np.concatenate([edges, edges[:, ::-1]]).T
    values = np.tile(conductance, 2)
    off = sparse.coo_matrix((-values, (rows, columns)), shape=(n, n)).tocsr()
    return off + sparse.diags(np.bincount(rows, values, n))


def _solve(matrix: sparse.csr_matrix, right: np.ndarray) -> np.ndarray:
    """Conjugate gradients, preconditioned by pyamg where it is installed."""
    try:
        import pyamg
    except ImportError:
        diagonal = matrix.diagonal()
        step = LinearOperator(matrix.shape, matvec=lambda x: x / diagonal)
    else:
        step = pyamg.smoothed_aggregation_solver(matrix).aspreconditioner()
    scale = float(np.linalg.norm(right))
    # the relative tolerance is called tol up to scipy 1.11 and rtol later
    relative = "rtol" if "rtol" in inspect.signature(cg).parameters else "tol"
    options = {relative: 1e-10, "atol": 0.0, "M": step, "maxiter": 5000}
    solution, failed = cg(matrix, right, **options)
    residual = float(np.linalg.norm(matrix @ solution - right))
    if failed or not residual <= 1e-6 * scale:
        raise FaultError(
            f"the harmonic system did not converge (residual {residual:.2g})", figure=residual
        )
    return solution
