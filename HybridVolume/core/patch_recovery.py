# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Strain at the nodes from points inside the elements, where it is most accurate.

Two ways: the polynomial of each element through its points, averaged (what CalculiX does, and what
elements however thin do not spoil); and, for nodes inside the body, a polynomial over all elements
around a vertex (superconvergent patch recovery, Zienkiewicz and Zhu 1992).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import scipy.sparse as sp

from .elements import EDGES, gauss_line, jacobians, reference, shape_functions, shape_gradients
from .nodal_forces import solver_points

_CHUNK = 20_000
_BLOCK = 400_000
"""Pairs of a vertex and a point that are worked on at once."""
_MARGIN = 1.5
"""Points an unknown of a patch's polynomial."""
_FLATTEST = 1e-3
"""Smallest extent of a patch in a direction over its largest that is scaled away."""
_ECHO = 0.15
"""Largest share of a sample's error that comes back at a node whose polynomial is trusted."""
_SINGULAR = 1e-8
"""Smallest eigenvalue of a patch's equations over the largest."""


def sample_points(kind: str) -> np.ndarray:
    """Points of an element where the strain is most accurate, (m, 3)."""
    if kind == "penta15":
        # CalculiX has three points through the thickness; the strain is linear there
        points, _ = solver_points(kind)
        height, _ = gauss_line(2)
        return np.column_stack([np.tile(points[:3, :2], (2, 1)), np.repeat(height, 3)])
    if kind == "penta6":
        return np.full((1, 3), [1.0 / 3.0, 1.0 / 3.0, 0.5])
    if kind.startswith("hex"):
        height, _ = gauss_line(1 if kind == "hex8" else 2)
        grid = np.meshgrid(height, height, height, indexing="ij")
        return np.stack(grid, axis=-1).reshape(-1, 3)
    return solver_points(kind)[0]


def gradient_at(
    kind: str,
    nodes: np.ndarray,
    connectivity: np.ndarray,
    displacement: np.ndarray,
    points: np.ndarray,
) -> np.ndarray:
    """Derivatives of the displacement in every element at reference points.

    Parameters
    ----------
    kind : str
        Of `HybridVolume.core.elements`, e.g. ``"penta15"``.
    nodes, displacement : (n, 3) arrays
        mm.
    connectivity : (ne, k) int array
    points : (m, 3) array

    Returns
    -------
    (ne, m, 3, 3) array
        Component, direction.
    """
    gradients = shape_gradients(kind, points)
    parts = [np.zeros((0, len(points), 3, 3))]
    for start in range(0, len(connectivity), _CHUNK):
        rows = connectivity[start : start + _CHUNK]
        # dx/dxi and du/dxi at the same places; du/dx = du/dxi dxi/dx
        x = jacobians(kind, nodes[rows], points)
        u = np.einsum("enc,mnd->emcd", displacement[rows], gradients, optimize=True)
        parts.append(u @ np.linalg.inv(x))
    return np.concatenate(parts)


def strain_of(gradient: np.ndarray) -> np.ndarray:
    """Strain (..., 6) of derivatives (..., 3, 3) of the displacement."""
    symmetric = 0.5 * (gradient + np.swapaxes(gradient, -1, -2))
    return symmetric[..., [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def mean_at_nodes(count: int, parts: Sequence[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Mean of elements' values at their nodes, (count, ...); nan at nodes of no element.

    Parameters
    ----------
    count : int
    parts : sequence of ((ne, k) int array, (ne, k, ...) array)
        Connectivity and values.
    """
    shape = parts[0][1].shape[2:]
    total, number = np.zeros((count, *shape)), np.zeros(count)
    for connectivity, values in parts:
        flat = connectivity.ravel()
        number += np.bincount(flat, minlength=count)
        columns = values.reshape(len(flat), -1).T
        sums = [np.bincount(flat, column, minlength=count) for column in columns]
        total += np.stack(sums, axis=1).reshape(total.shape)
    with np.errstate(invalid="ignore"):
        return total / number.reshape(-1, *[1] * len(shape))


def extrapolated(
    nodes: np.ndarray, elements: Sequence[tuple[str, np.ndarray]], displacement: np.ndarray
) -> np.ndarray:
    """Derivatives at the nodes, carried there from each element's points and averaged, (n, 3, 3).

    Their stress is what CalculiX writes.
    """
    parts = []
    for kind, connectivity in elements:
        points = sample_points(kind)
        gradient = gradient_at(kind, nodes, connectivity, displacement, points)
        carry = np.ones((connectivity.shape[1], 1))
        if len(points) > 1:
            linear = {"tet": "tet4", "pen": "penta6", "hex": "hex8"}[kind[:3]]
            at_nodes = shape_functions(linear, reference(kind).nodes)
            carry = at_nodes @ np.linalg.inv(shape_functions(linear, points))
        parts.append((connectivity, np.einsum("mq,eqcd->emcd", carry, gradient)))
    return mean_at_nodes(len(nodes), parts)


def smooth_inside(
    nodes: np.ndarray,
    elements: Sequence[tuple[str, np.ndarray]],
    displacement: np.ndarray,
    rough: np.ndarray,
    boundary: np.ndarray,
) -> np.ndarray:
    """Strain at the nodes with polynomials over the elements around each vertex inside.

    Parameters
    ----------
    nodes, displacement : (n, 3) arrays
        mm.
    elements : sequence of (str, (ne, k) int array)
    rough : (n, 6) array
        Strain that stays where no patch says better.
    boundary : (n,) bool array
        Nodes of the boundary, whose patches would be one-sided.

    Returns
    -------
    (n, 6) array
    """
    count = len(nodes)
    places, strains, owners, corner_rows, corner_columns = [], [], [], [], []
    total, degree = 0, 1
    for kind, connectivity in elements:
        points = sample_points(kind)
        degree = max(degree, 2 if connectivity.shape[1] > 8 else 1)
        strain = strain_of(gradient_at(kind, nodes, connectivity, displacement, points))
        places.append(np.einsum("qn,enc->eqc", shape_functions(kind, points), nodes[connectivity]))
        strains.append(strain)
        owners.append(np.full(len(connectivity), len(points)))
        corners = connectivity[:, : reference(kind).corners]
        corner_rows.append(corners.ravel())
        corner_columns.append(np.repeat(total + np.arange(len(connectivity)), corners.shape[1]))
        total += len(connectivity)
    place = np.concatenate([part.reshape(-1, 3) for part in places])
    strain = np.concatenate([part.reshape(-1, 6) for part in strains])
    samples = np.concatenate(owners)
    first = np.cumsum(samples) - samples
    rows, columns = np.concatenate(corner_rows), np.concatenate(corner_columns)
    around = sp.csr_matrix((np.ones(len(rows)), (rows, columns)), (count, total))
    vertices = np.flatnonzero((np.diff(around.indptr) > 0) & ~boundary)
    exponents = _exponents(degree)
    per_vertex = around @ samples
    vertices = vertices[per_vertex[vertices] >= _MARGIN * len(exponents)]
    middles, ends = _middles(elements)
    summed, number = np.zeros((count, 6)), np.zeros(count)
    step = max(1, int(_BLOCK / max(1.0, per_vertex[vertices].max(initial=1.0))))
    vertices = vertices[np.argsort(per_vertex[vertices], kind="stable")]
    order = np.full(count, -1)
    order[vertices] = np.arange(len(vertices))
    for start in range(0, len(vertices), step):
        block = vertices[start : start + step]
        # the points around each vertex, in rows filled up with points of no weight
        patch = around[block]
        element = patch.indices
        size = samples[element]
        of_vertex = np.repeat(np.repeat(np.arange(len(block)), np.diff(patch.indptr)), size)
        offset = np.arange(len(of_vertex)) - np.repeat(np.cumsum(size) - size, size)
        sample = np.repeat(first[element], size) + offset
        length = np.bincount(of_vertex, minlength=len(block))
        column = np.arange(len(of_vertex)) - np.repeat(np.cumsum(length) - length, length)
        index = np.zeros((len(block), length.max()), dtype=np.int64)
        weight = np.zeros(index.shape)
        index[of_vertex, column], weight[of_vertex, column] = sample, 1.0
        fit = _Fit(nodes[block], place[index], weight, strain[index], exponents)
        for targets, patches in _targets(block, start, order, middles, ends):
            values, good = fit.at(nodes[targets], patches)
            targets, values = targets[good], values[good]
            number += np.bincount(targets, minlength=count)
            for component in range(6):
                summed[:, component] += np.bincount(targets, values[:, component], minlength=count)
    known = number > 0
    result = rough.copy()
    result[known] = summed[known] / number[known, None]
    return result


def _exponents(degree: int) -> np.ndarray:
    grid = np.stack(np.meshgrid(*[np.arange(degree + 1)] * 3, indexing="ij"), axis=-1)
    flat = grid.reshape(-1, 3)
    return flat[flat.sum(axis=1) <= degree]


def _middles(elements: Sequence[tuple[str, np.ndarray]]) -> tuple[np.ndarray, np.ndarray]:
    """Mid nodes, and the two corners of the edge of each."""
    parts = [np.zeros((0, 3), dtype=int)]
    for kind, connectivity in elements:
        corners = reference(kind).corners
        if connectivity.shape[1] > corners:
            for number, (a, b) in enumerate(EDGES[kind]):
                parts.append(connectivity[:, [corners + number, a, b]])
    found = np.concatenate(parts)
    _, first = np.unique(found[:, 0], return_index=True)
    return found[first, 0], found[first, 1:]


def _targets(block, start, order, middles, ends):
    """Nodes at which the polynomials of a block of vertices are wanted, and which polynomial."""
    yield block, np.arange(len(block))
    for column in (0, 1):
        patches = order[ends[:, column]] - start
        inside = (patches >= 0) & (patches < len(block)) & (order[ends[:, column]] >= 0)
        yield middles[inside], patches[inside]


class _Fit:
    """Polynomials through the points around many vertices, by least squares."""

    def __init__(
        self,
        centre: np.ndarray,
        points: np.ndarray,
        weight: np.ndarray,
        values: np.ndarray,
        exponents: np.ndarray,
    ) -> None:
        self.exponents, self.centre = exponents, centre
        # axes in which each patch is about as wide one way as another
        away = points - centre[:, None]
        count = weight.sum(axis=1)
        mean = np.einsum("vs,vsc->vc", weight, away) / count[:, None]
        spread = (away - mean[:, None]) * weight[..., None]
        extent, axes = np.linalg.eigh(np.swapaxes(spread, 1, 2) @ spread / count[:, None, None])
        extent = np.sqrt(np.maximum(extent, 0.0))
        extent = np.maximum(extent, _FLATTEST * extent[:, -1:])
        self.axes = axes / (2.0 * extent[:, None, :])
        basis = self._basis(away @ self.axes) * weight[..., None]
        matrix = np.swapaxes(basis, 1, 2) @ basis
        size, vectors = np.linalg.eigh(matrix)
        self.sound = size[:, 0] > _SINGULAR * size[:, -1]
        inverse = (vectors / np.maximum(size, _SINGULAR * size[:, -1:])[:, None]) @ np.swapaxes(
            vectors, 1, 2
        )
        self.inverse = inverse
        self.coefficients = inverse @ (np.swapaxes(basis, 1, 2) @ values)

    def _basis(self, places: np.ndarray) -> np.ndarray:
        powers = [np.ones_like(places), places, places**2]
        columns = [
            powers[a][..., 0] * powers[b][..., 1] * powers[c][..., 2]
            for a, b, c in self.exponents.tolist()
        ]
        return np.stack(columns, axis=-1)

    def at(self, points: np.ndarray, patches: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values of some polynomials at one point each, (m, 6), and which of them to trust, (m,).

        Where a point sees its patch from one side, an error of the samples comes back whole.
        """
        local = np.einsum("mc,mck->mk", points - self.centre[patches], self.axes[patches])
        basis = self._basis(local)
        echo = np.einsum("mk,mkl,ml->m", basis, self.inverse[patches], basis)
        values = np.einsum("mk,mks->ms", basis, self.coefficients[patches])
        return values, self.sound[patches] & (echo < _ECHO)
