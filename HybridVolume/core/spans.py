# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The knot spans of all patches, in batches of one degree pair, and matrices that sample them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from . import bspline
from .bezier import bernstein

if TYPE_CHECKING:
    from .surface import Patch


@dataclass(frozen=True)
class ElementGroup:
    """All knot spans of one degree pair, ready for vectorised work.

    Attributes
    ----------
    degrees : (int, int)
    element : (ne,) int array
        Number of each element among all elements of the surface (patch by patch, u then v).
    patch : (ne,) int array
    index : (ne, p + 1, q + 1) int array
        Control points that act on each element.
    weights : (ne, p + 1, q + 1) array
        Their B-spline weights.
    extraction_u, extraction_v : (ne, p + 1, p + 1), (ne, q + 1, q + 1) arrays
    low, high : (ne, 2) arrays
        Corners of the knot span.
    """

    degrees: tuple[int, int]
    element: np.ndarray
    patch: np.ndarray
    index: np.ndarray
    weights: np.ndarray
    extraction_u: np.ndarray
    extraction_v: np.ndarray
    low: np.ndarray
    high: np.ndarray

    def bezier(self, values: np.ndarray) -> np.ndarray:
        """Bézier points of every element of B-spline coefficients given per element.

        Parameters
        ----------
        values : (ne, p + 1, q + 1, ...) array

        Returns
        -------
        array of the same shape
        """
        half = np.einsum("eai,eij...->eaj...", self.extraction_u, values)
        return np.einsum("ebj,eaj...->eab...", self.extraction_v, half)


@dataclass(frozen=True)
class ElementSamples:
    """Samples of every element as matrices on the control points.

    Rows run element by element, within an element over the (u, v) grid. Derivatives are per unit
    of the element's own parameter in [0, 1].

    Attributes
    ----------
    count : int
        Samples of one element.
    values, du, dv : (ne * count, n) sparse matrices
        Polynomial B-spline functions and derivatives.
    weighted, weighted_du, weighted_dv : sparse matrices
        The same, times the weight of each control point.
    weight, weight_du, weight_dv : (ne * count,) arrays
        The weight function and its derivatives.
    """

    count: int
    values: sparse.csr_matrix
    du: sparse.csr_matrix
    dv: sparse.csr_matrix
    weighted: sparse.csr_matrix
    weighted_du: sparse.csr_matrix
    weighted_dv: sparse.csr_matrix
    weight: np.ndarray
    weight_du: np.ndarray
    weight_dv: np.ndarray

    def surface(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rational surface points and both derivatives, three (ne * count, 3) arrays."""
        w = self.weight[:, None]
        x = (self.weighted @ points) / w
        x_u = (self.weighted_du @ points - x * self.weight_du[:, None]) / w
        x_v = (self.weighted_dv @ points - x * self.weight_dv[:, None]) / w
        return x, x_u, x_v


def alike(patches: Sequence[Patch]) -> list[np.ndarray]:
    """Numbers of patches that have the same degrees and knots, each such set once."""
    sets: dict[tuple, list[int]] = {}
    # knot vectors are often one object, and hashing the object's number is quick
    known: dict[int, bytes] = {}
    for k, patch in enumerate(patches):
        key = (patch.degrees, *(known.setdefault(id(t), t.tobytes()) for t in patch.knots))
        sets.setdefault(key, []).append(k)
    return [np.array(members) for members in sets.values()]


def element_groups(patches: Sequence[Patch]) -> tuple[ElementGroup, ...]:
    """Knot spans of patches, one group a degree pair, in the order of their numbers."""
    collected: dict[tuple[int, int], list] = {}
    counts = np.zeros(len(patches), dtype=int)
    for members in alike(patches):
        patch = patches[members[0]]
        p, q = patch.degrees
        lines = []
        for degree, knots in zip(patch.degrees, patch.knots, strict=True):
            lines.append((*bspline.bezier_extraction(degree, knots), np.unique(knots)))
        (fu, cu, bu), (fv, cv, bv) = lines
        eu, ev = (a.ravel() for a in np.indices((len(fu), len(fv))))
        counts[members] = len(eu)
        rows = fu[eu][:, None, None] + np.arange(p + 1)[:, None]
        columns = fv[ev][:, None, None] + np.arange(q + 1)
        index = np.stack([patches[k].index for k in members])[:, rows, columns]
        weights = np.stack([patches[k].weights for k in members])[:, rows, columns]
        times = len(members)
        collected.setdefault(patch.degrees, []).append(
            (
                np.tile(np.arange(len(eu)), times),
                np.repeat(members, len(eu)),
                index.reshape(-1, p + 1, q + 1),
                weights.reshape(-1, p + 1, q + 1),
                np.tile(cu[eu], (times, 1, 1)),
                np.tile(cv[ev], (times, 1, 1)),
                np.tile(np.column_stack([bu[eu], bv[ev]]), (times, 1)),
                np.tile(np.column_stack([bu[eu + 1], bv[ev + 1]]), (times, 1)),
            )
        )
    start = np.concatenate([[0], np.cumsum(counts)[:-1]])
    groups = []
    for degrees, rows in collected.items():
        parts = [np.concatenate(part) for part in zip(*rows, strict=True)]
        parts[0] += start[parts[1]]
        if len(rows) > 1:
            order = np.argsort(parts[0])
            parts = [part[order] for part in parts]
        groups.append(ElementGroup(degrees, *parts))
    return tuple(groups)


def _subset(group: ElementGroup, place_of: np.ndarray) -> ElementGroup:
    """The elements of a group that have a place, numbered by their places."""
    place = place_of[group.element]
    keep = place >= 0
    parts = (group.patch, group.index, group.weights, group.extraction_u, group.extraction_v)
    return ElementGroup(
        group.degrees, place[keep], *(a[keep] for a in parts), group.low[keep], group.high[keep]
    )


def element_samples(
    groups: Sequence[ElementGroup],
    n: int,
    u: np.ndarray,
    v: np.ndarray,
    elements: np.ndarray | None = None,
) -> ElementSamples:
    """Matrices that sample elements, see `PatchSurface.element_samples`.

    Parameters
    ----------
    groups : sequence of ElementGroup
    n : int
        Number of control points.
    u, v : (mu,), (mv,) arrays
    elements : (ne,) int array, optional
    """
    total = sum(len(group.element) for group in groups)
    if elements is None:
        elements = np.arange(total)
    ne = len(elements)
    count = len(u) * len(v)
    place_of = np.full(total, -1)
    place_of[elements] = np.arange(ne)
    groups = [_subset(group, place_of) for group in groups]
    counts = np.zeros(ne, dtype=int)
    for group in groups:
        counts[group.element] = group.index[0].size if len(group.element) else 0
    row_start = np.concatenate([[0], np.cumsum(np.repeat(counts, count))])
    size = row_start[-1]
    # one kind of index that all matrices share
    kind = np.int32 if max(size, n) < 2**31 else np.int64
    row_start = row_start.astype(kind)
    columns = np.zeros(size, dtype=kind)
    data = {name: np.zeros(size) for name in ("n", "u", "v")}
    factor = np.zeros(size)
    for group in groups:
        if not len(group.element):
            continue
        p, q = group.degrees
        local = (p + 1) * (q + 1)
        lines = {}
        for name, degree, x, c in (
            ("u", p, u, group.extraction_u),
            ("v", q, v, group.extraction_v),
        ):
            lines[name] = np.einsum("mi,eij->emj", bernstein(degree, x), c)
            lines["d" + name] = np.einsum("mi,eij->emj", bernstein(degree, x, 1), c)
        rows = (group.element[:, None] * count + np.arange(count)).ravel()
        place = row_start[rows][:, None] + np.arange(local)
        for name, left, right in (("n", "u", "v"), ("u", "du", "v"), ("v", "u", "dv")):
            values = np.einsum("emi,ekj->emkij", lines[left], lines[right])
            data[name][place] = values.reshape(-1, local)
        shape = (len(group.element), count, local)
        columns[place] = np.broadcast_to(
            group.index.reshape(-1, 1, local), shape
        ).reshape(-1, local)  # fmt: skip
        factor[place] = np.broadcast_to(
            group.weights.reshape(-1, 1, local), shape
        ).reshape(-1, local)  # fmt: skip

    def matrix(values: np.ndarray) -> sparse.csr_matrix:
        return sparse.csr_matrix((values, columns, row_start), shape=(ne * count, n))

    plain = {name: matrix(values) for name, values in data.items()}
    weighted = plain
    if (factor != 1.0).any():
        weighted = {name: matrix(values * factor) for name, values in data.items()}
    ones = np.ones(n)
    return ElementSamples(
        count,
        plain["n"],
        plain["u"],
        plain["v"],
        weighted["n"],
        weighted["u"],
        weighted["v"],
        weighted["n"] @ ones,
        weighted["u"] @ ones,
        weighted["v"] @ ones,
    )
