# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The harmonic function w: 0 on the surface, 1 on the midstructure (section 3.1, Eq. 2)."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from .harmonic_domain import Domain, build_domain
from .harmonic_topology import mend
from .isosurface import genus_from_euler, isosurface_euler, largest_level
from .laplace import Laplace, hat_gradients
from .midstructure import Midstructure
from .surface import PatchSurface
from .tetmesh import TetMesh

log = logging.getLogger(__name__)

TETS = 40_000
"""Tetrahedra aimed at."""
TETS_A_HANDLE = 600
"""So many for each handle: in coarser fields isosurfaces close holes at low levels already."""

# Points are inside a tetrahedron down to this barycentric coordinate.
INSIDE = -1e-6


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
        return *self._at(tet, barycentric), inside

    def _at(self, tet: np.ndarray, barycentric: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """w and its gradient from barycentric coordinates."""
        corners = self.mesh.tets[tet]
        w = np.einsum("kj,kj->k", barycentric, self.w[corners])
        share = np.clip(barycentric, 0.0, 1.0)
        share /= share.sum(axis=1, keepdims=True)
        values = np.where(
            self.fixed[corners][..., None],
            self.tet_gradient[tet][:, None],
            self.gradient[corners],
        )
        return w, np.einsum("kj,kji->ki", share, values)

    def evaluate_near(
        self, points: np.ndarray, near: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """As :meth:`evaluate`, starting from the tetrahedra of an earlier call for as many points.

        Parameters
        ----------
        points : (k, 3) array
        near : (k,) int array or None
            The last array of that call.

        Returns
        -------
        w, gradient, inside
            As :meth:`evaluate` gives them.
        tet : (k,) int array
        """
        if near is None:
            tet, barycentric, inside = self.locate(points)
        else:
            tet, barycentric, inside = self._walk(points, near)
            # where the walk ends at the boundary the answer must not depend on its start
            lost = np.flatnonzero(~inside)
            if len(lost):
                tet[lost], barycentric[lost], inside[lost] = self.locate(points[lost])
        return *self._at(tet, barycentric), inside, tet

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
        return largest_level(self.mesh, self.w, genus_per_shell, asked)


def solve_harmonic(
    surface: PatchSurface,
    midstructure: Midstructure,
    *,
    tets: int = 0,
    engine: str = "auto",
    free: bool | None = None,
    time_limit: float = 15.0,
) -> HarmonicField:
    """Solve Laplace's equation between the surface and the midstructure.

    Parameters
    ----------
    surface : PatchSurface
    midstructure : Midstructure
    tets : int
        Tetrahedra aimed at; 0: `TETS`, or `TETS_A_HANDLE` for each of the body's handles where
        these are more.
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
    tets = tets or max(TETS, TETS_A_HANDLE * sum(surface.genus))
    domain = build_domain(
        surface, midstructure, tets=tets, engine=engine, free=free, time_limit=time_limit
    )
    return solve_on(domain, surface.genus)


def solve_on(domain: Domain, genus_per_shell: Sequence[int] | None = None) -> HarmonicField:
    """The field on a given domain.

    Parameters
    ----------
    domain : Domain
    genus_per_shell : sequence of int, optional
        Where given, the midstructure is mended until the isosurfaces look like that.
    """
    mesh = domain.mesh
    fixed = domain.inner & ~mesh.on_boundary
    laplace = Laplace(mesh)
    w = laplace.solve(fixed)
    if genus_per_shell is not None:
        w, fixed = mend(laplace, w, fixed, genus_per_shell)
    n = len(mesh.vertices)
    slope = np.einsum("mk,mki->mi", w[mesh.tets], hat_gradients(mesh))
    weight = np.bincount(mesh.tets.ravel(), np.repeat(mesh.volumes, 4), n)
    gradient = np.column_stack(
        [
            np.bincount(mesh.tets.ravel(), np.repeat(mesh.volumes * slope[:, i], 4), n)
            for i in range(3)
        ]
    ) / np.maximum(weight, np.finfo(float).tiny)[:, None]  # fmt: skip
    log.info("harmonic field: %d tetrahedra, %d vertices (%s)", len(mesh), n, mesh.engine)
    return HarmonicField(mesh, w, gradient, fixed, domain.embedded)
