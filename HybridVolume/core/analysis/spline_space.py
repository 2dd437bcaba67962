# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Splines of the shell as a space of unknowns: the same functions that map the shell.

An unknown belongs to a control point of the shell, column l and layer k: number k n + l, where n
is the number of columns. Its function is R = w N / W with the tensor B-splines N, the weights w
and W = sum w N, so that rigid motions and constant strains are in the space (isoparametric).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from ...errors import InputError
from .. import bspline
from ..bezier import bernstein
from ..elements import gauss_line
from ..shell import Shell
from ..spans import ElementGroup
from .refine import refine_shell
from .samples import BoundarySamples, Samples

_BLOCK = 2_000_000
"""Values of basis functions that are held at once, which bounds the memory."""
_PLACES = 100_000
"""Places on the boundary that are worked on at once, likewise."""


@dataclass(frozen=True)
class SplineSpace:
    """The space over a shell, made finer through the thickness if wanted.

    Attributes
    ----------
    shell : Shell
    parts : int
        Parts that each of the shell's layers is cut into.
    """

    shell: Shell
    parts: int = 1

    @cached_property
    def knots_w(self) -> np.ndarray:
        """Knots through the thickness."""
        knots = self.shell.knots_w
        lines = bspline.breakpoints(knots)
        share = np.arange(1, self.parts) / self.parts
        new = (lines[:-1, None] + np.diff(lines)[:, None] * share).ravel()
        return np.sort(np.concatenate([knots, new]))

    @cached_property
    def homogeneous(self) -> np.ndarray:
        """Control points (w x, w y, w z, w) of layers and columns, (nw, n, 4)."""
        surface = self.shell.surface
        points = np.concatenate([self.shell.layers, np.ones((*self.shell.layers.shape[:2], 1))], 2)
        weights = np.ones(len(surface.control_points))
        for patch in surface.patches:
            weights[patch.index] = patch.weights
        points[0] *= weights[:, None]
        matrix = bspline.insertion_matrix(self.shell.degree_w, self.shell.knots_w, self.knots_w)
        return np.tensordot(matrix, points, 1)

    @property
    def dimension(self) -> int:
        """3: a shell bounds a body in space."""
        return 3

    @cached_property
    def degree(self) -> int:
        """Highest degree of the surface's patches."""
        return max(max(group.degrees) for group in self.shell.surface.groups)

    @property
    def patch_faces(self) -> tuple[str, ...]:
        """CAD face of each patch."""
        return tuple(patch.face for patch in self.shell.surface.patches)

    @cached_property
    def face_names(self) -> tuple[str, ...]:
        """CAD faces, each once, in the order of their patches."""
        return tuple(dict.fromkeys(self.patch_faces))

    @cached_property
    def breaks(self) -> tuple[tuple[np.ndarray, ...], ...]:
        """Distinct knots of each patch along u and v."""
        return tuple(
            tuple(bspline.breakpoints(knots) for knots in patch.knots)
            for patch in self.shell.surface.patches
        )

    @property
    def columns(self) -> int:
        """Number of columns."""
        return self.homogeneous.shape[1]

    @property
    def size(self) -> int:
        """Number of unknowns (of one component)."""
        return self.homogeneous.shape[0] * self.columns

    @cached_property
    def control_points(self) -> np.ndarray:
        """Control points of all unknowns, (size, 3), mm: coefficients of the map itself."""
        points = self.homogeneous.reshape(-1, 4)
        return points[:, :3] / points[:, 3:]

    @cached_property
    def outer(self) -> np.ndarray:
        """Unknowns whose functions do not vanish on the outer boundary."""
        return np.arange(self.columns)

    @cached_property
    def inner(self) -> np.ndarray:
        """Unknowns whose functions do not vanish on the inner boundary."""
        return np.arange(self.size - self.columns, self.size)

    def refined(self) -> SplineSpace:
        """The space with all knot spans halved along u, v and w; it holds all of this one."""
        return SplineSpace(refine_shell(self.shell, 2), 2 * self.parts)

    def samples(self, points: int | None = None) -> Iterator[Samples]:
        """Functions at Gauss points of all elements, a block at a time.

        Parameters
        ----------
        points : int, optional
            Gauss points a direction; by default one more than the highest degree.
        """
        shell = self.shell
        spans = bspline.bezier_extraction(shell.degree_w, self.knots_w)
        for group in shell.surface.groups:
            degrees = (*group.degrees, shell.degree_w)
            count = points or max(degrees) + 1
            size = int(np.prod([d + 1 for d in degrees])) * count**3 * 4
            for rows in np.array_split(
                np.arange(len(group.element)), 1 + len(group.element) * size // _BLOCK
            ):
                for layer, (first, operator) in enumerate(zip(*spans, strict=True)):
                    yield self._sampled(group, rows, layer, int(first), operator, count)

    def _sampled(
        self,
        group: ElementGroup,
        rows: np.ndarray,
        layer: int,
        first: int,
        operator: np.ndarray,
        count: int,
    ) -> Samples:
        """Samples of one layer over some spans of the surface."""
        x, weight = gauss_line(count)
        tables = []
        for degree, extraction in (
            (group.degrees[0], group.extraction_u[rows]),
            (group.degrees[1], group.extraction_v[rows]),
            (self.shell.degree_w, operator[None]),
        ):
            tables.append([bernstein(degree, x, d) @ extraction for d in (0, 1)])
        index = group.index[rows]
        layers = first + np.arange(self.shell.degree_w + 1)
        unknowns = (layers * self.columns + index[..., None]).reshape(len(rows), -1)
        net = self.homogeneous.reshape(-1, 4)[unknowns]
        heavy = net[..., 3]
        # values and derivatives of w N along u, v and w at all points
        parts = [
            _products([table[int(axis == d)] for axis, table in enumerate(tables)])
            * heavy[:, None, :]
            for d in (-1, 0, 1, 2)
        ]
        euclidean = net[..., :3] / heavy[..., None]
        total = [part.sum(axis=2)[..., None] for part in parts]
        values = parts[0] / total[0]
        along = np.stack(
            [
                (part - values * sums) / total[0]
                for part, sums in zip(parts[1:], total[1:], strict=True)
            ],
            axis=2,
        )
        # u and v change places in the shell, so that det J is positive
        jacobian = along @ euclidean[:, None]
        determinant = -np.linalg.det(jacobian)
        number = self.parts * (len(bspline.breakpoints(self.shell.knots_w)) - 1)
        return Samples(
            group.element[rows] * number + layer,
            unknowns,
            values @ euclidean,
            values,
            np.linalg.inv(jacobian) @ along,
            determinant * _products([weight[None, None]] * 3)[0, 0],
        )

    def basis_at(self, patch: np.ndarray, uv: np.ndarray, w: np.ndarray) -> sparse.csr_matrix:
        """Functions of all unknowns at m places, (m, size).

        Parameters
        ----------
        patch : (m,) int array
        uv : (m, 2) array
            Parameters on the surface patch.
        w : (m,) array
            0 on the outer boundary, 1 on the inner one.
        """
        return self._at(patch, uv, w, False)[0]

    def gradients_at(
        self, patch: np.ndarray, uv: np.ndarray, w: np.ndarray
    ) -> tuple[sparse.csr_matrix, ...]:
        """Derivatives of all unknowns' functions along x, y and z at m places.

        Parameters as for :meth:`basis_at`.

        Returns
        -------
        three (m, size) sparse matrices
            1/mm
        """
        basis, *along = self._at(patch, uv, w, True)
        slopes = np.stack([part.data for part in along], axis=1)
        tangents = self._tangents(along)
        row = np.repeat(np.arange(len(w)), np.diff(basis.indptr))
        found = np.einsum("ecd,ed->ec", np.linalg.inv(tangents)[row], slopes)
        return tuple(
            sparse.csr_matrix((part, basis.indices, basis.indptr), shape=basis.shape)
            for part in np.ascontiguousarray(found.T)
        )

    def tangents_at(self, patch: np.ndarray, uv: np.ndarray, w: np.ndarray) -> np.ndarray:
        """Derivatives of the map along u, v and w, one in each row, (m, 3, 3), mm.

        Parameters as for :meth:`basis_at`.
        """
        return self._tangents(self._at(patch, uv, w, True)[1:])

    def _tangents(self, along: list[sparse.csr_matrix]) -> np.ndarray:
        return np.stack([part @ self.control_points for part in along], axis=1)

    def _at(
        self, patch: np.ndarray, uv: np.ndarray, w: np.ndarray, derivative: bool
    ) -> list[sparse.csr_matrix]:
        """Functions, and their derivatives along u, v and w if wanted, with the same entries."""
        along = self.shell.surface.basis_with_slopes(patch, *uv.T, int(derivative))
        first, across = bspline.basis_functions(self.shell.degree_w, self.knots_w, w)
        pointers = along[0].indptr
        row = np.repeat(np.arange(len(w)), np.diff(pointers))
        layers = first[row][:, None] + np.arange(self.shell.degree_w + 1)
        columns = layers * self.columns + along[0].indices[:, None]
        weights = self.homogeneous.reshape(-1, 4)[columns, 3]
        parts = [(part.data, across) for part in along]
        if derivative:
            _, steep = bspline.basis_functions(self.shell.degree_w, self.knots_w, w, 1)
            parts.append((along[0].data, steep))
        shape = (len(w), self.size)
        starts = pointers * (self.shell.degree_w + 1)
        made: list[np.ndarray] = []
        totals: list[np.ndarray] = []
        for data, through in parts:
            made.append(data[:, None] * through[row] * weights)
            totals.append(np.bincount(row, made[-1].sum(axis=1), len(w))[row][:, None])
        # (w N / W)' = ((w N)' - w N / W W') / W
        made[0] = made[0] / totals[0]
        for k in range(1, len(made)):
            made[k] = (made[k] - made[0] * totals[k]) / totals[0]
        return [
            sparse.csr_matrix((data.ravel(), columns.ravel(), starts), shape=shape) for data in made
        ]

    def boundary_samples(
        self, faces: Sequence[str] | None = None, points: int | None = None
    ) -> Iterator[BoundarySamples]:
        """Quadrature points on CAD faces, a block at a time.

        Parameters
        ----------
        faces : sequence of str, optional
            All by default.
        points : int, optional
            Gauss points a direction; by default three more than the highest degree.

        Raises
        ------
        InputError
            There is no such face.
        """
        surface = self.shell.surface
        chosen = np.ones(len(surface.patches), dtype=bool)
        if faces is not None:
            names = np.array(self.patch_faces)
            check_faces(self.face_names, faces)
            chosen = np.isin(names, list(faces))
        elements = np.flatnonzero(chosen[surface.element_patch])
        x, weight = gauss_line(points or self.degree + 3)
        weights = np.outer(weight, weight).ravel()
        for block in np.array_split(elements, 1 + len(elements) * len(weights) // _PLACES):
            samples = surface.element_samples(x, x, block)
            at, along_u, along_v = samples.surface(surface.control_points)
            normal = np.cross(along_u, along_v)
            area = np.linalg.norm(normal, axis=1)
            yield BoundarySamples(
                at,
                normal / area[:, None],
                sparse.diags(1.0 / samples.weight) @ samples.weighted,
                area * np.tile(weights, len(block)),
            )


def check_faces(known: Sequence[str], faces: Sequence[str]) -> None:
    """Refuse faces that a body does not have.

    Raises
    ------
    InputError
        There is no such face.
    """
    unknown = sorted(set(faces) - set(known))
    if unknown:
        raise InputError(
            f"{', '.join(unknown)}: no such face",
            remedy=f"the body has {len(known)} faces, such as {known[0]}",
        )


def _products(tables: list[np.ndarray]) -> np.ndarray:
    """Tensor products of three tables (ne or 1, n, m), as (ne, n³, m³)."""
    a, b, c = tables
    two = a[:, :, None, :, None] * b[:, None, :, None, :]
    two = two.reshape(len(two), a.shape[1] * b.shape[1], -1)
    three = two[:, :, None, :, None] * c[:, None, :, None, :]
    return three.reshape(len(three), two.shape[1] * c.shape[1], -1)
