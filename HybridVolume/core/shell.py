# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The shell V: trivariate NURBS patches between the surface and its offset (Eq. 3 and 4).

Layer 0 of the control points is the input, bit for bit, with its weights; all other weights are 1.
A patch of the shell has the parameters (v, u, w) of its surface patch: u and v change places, so
that (x_1, x_2, x_w) is right-handed while w grows from 0 at the surface inward and the surface's
normals point outward.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from . import bspline
from .bezier import BezierElements, bernstein
from .surface import PatchSurface


@dataclass(frozen=True)
class Shell:
    """Trivariate NURBS patches over global columns of control points.

    Attributes
    ----------
    surface : PatchSurface
        The outer boundary; its control points are ``layers[0]``.
    layers : (nw, n, 3) array
        Control points; ``layers[k, l]`` stands in column l, layer k. mm.
    degree_w : int
    knots_w : (nw + degree_w + 1,) array
        Clamped, on [0, 1].
    w0_asked, w0 : float
        Harmonic level that was asked for and the area mean of the one that was reached.
    w0_rms : float
        Root mean square deviation of the level over the inner surface from ``w0``.
    embedded : bool
        Whether the inner surface was found free of self-intersection.
    notes : tuple of str
        What the user should know about how the shell was made.
    level, goal : (n,) array
        Level that the inner surface's Greville point of each column has, and the one that was asked
        there; empty where they are not known.
    """

    surface: PatchSurface
    layers: np.ndarray
    degree_w: int
    knots_w: np.ndarray
    w0_asked: float = np.nan
    w0: float = np.nan
    w0_rms: float = np.nan
    embedded: bool = False
    notes: tuple[str, ...] = field(default=())
    level: np.ndarray = field(default_factory=lambda: np.zeros(0))
    goal: np.ndarray = field(default_factory=lambda: np.zeros(0))

    @property
    def layer_count(self) -> int:
        """Number of Bézier layers, i.e. of knot spans in w."""
        return len(bspline.breakpoints(self.knots_w)) - 1

    @property
    def element_count(self) -> int:
        """Number of trivariate Bézier elements."""
        return self.surface.element_count * self.layer_count

    @cached_property
    def element_patch(self) -> np.ndarray:
        """Patch of every element; element number = surface element * layers + layer."""
        return np.repeat(self.surface.element_patch, self.layer_count)

    def inner_surface(self) -> PatchSurface:
        """The inner boundary S̄: the same patches over the last layer, polynomial."""
        return self.surface.with_points(self.layers[-1], polynomial=True)

    def bezier_elements(self, spans: np.ndarray | None = None) -> list[BezierElements]:
        """Bézier elements, right-handed, in batches of one degree, rational ones apart.

        Parameters
        ----------
        spans : (ne,) bool array, optional
            Knot spans of the surface whose elements are wanted; all otherwise.
        """
        first, operators = bspline.bezier_extraction(self.degree_w, self.knots_w)
        batches: list[BezierElements] = []
        singular = self.surface.singular_flags
        for group in self.surface.groups:
            rows = slice(None) if spans is None else np.flatnonzero(spans[group.element])
            element, patch = group.element[rows], group.patch[rows]
            across_u, across_v = group.extraction_u[rows], group.extraction_v[rows]
            given = group.weights[rows]
            points = np.moveaxis(self.layers[:, group.index[rows]], 0, 3)
            flat = given.reshape(len(element), np.prod(given.shape[1:], dtype=int))
            rational = (np.ptp(flat, axis=1) > 0) | (flat[:, 0] != 1.0)
            for layer in range(self.layer_count):
                some = slice(first[layer], first[layer] + self.degree_w + 1)
                number = element * self.layer_count + layer
                weighted = rational if first[layer] == 0 else np.zeros_like(rational)
                for chosen, is_rational in ((~weighted, False), (weighted, True)):
                    if not chosen.any():
                        continue
                    part = points[chosen][..., some, :]  # (elements, p + 1, q + 1, r + 1, 3)
                    weights = None
                    if is_rational:
                        weights = np.ones(part.shape[:-1])
                        weights[..., 0] = given[chosen]
                        part = np.concatenate(
                            [part * weights[..., None], weights[..., None]], axis=-1
                        )
                    part = np.einsum("eai,eijkd->eajkd", across_u[chosen], part)
                    part = np.einsum("ebj,eajkd->eabkd", across_v[chosen], part)
                    part = np.einsum("ck,eabkd->ebacd", operators[layer], part)
                    if is_rational:
                        weights = np.ascontiguousarray(part[..., 3])
                        part = part[..., :3] / part[..., 3:]
                    p, q = group.degrees
                    flags = None
                    if layer == 0:
                        flags = np.swapaxes(singular[element[chosen]], 1, 2)
                    batches.append(
                        BezierElements(
                            (q, p, self.degree_w),
                            np.ascontiguousarray(part),
                            weights,
                            number[chosen],
                            patch[chosen],
                            flags if flags is not None and flags.any() else None,
                        )
                    )
        return batches

    def evaluate(
        self, patch: int, u: np.ndarray, v: np.ndarray, w: np.ndarray, derivative: int = 0
    ) -> np.ndarray | tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Points of the shell at m parameter triples, u and v as on the *surface* patch.

        Parameters
        ----------
        patch : int
        u, v, w : (m,) arrays
            w = 0 on the outer boundary, 1 on the inner one.
        derivative : {0, 1}

        Returns
        -------
        (m, 3) array, or with ``derivative=1`` the arrays x, x_u, x_v, x_w
        """
        p = self.surface.patches[patch]
        u, v, w = (np.asarray(a, dtype=float) for a in (u, v, w))
        fu, bu = bspline.basis_functions(p.degrees[0], p.knots[0], u)
        fv, bv = bspline.basis_functions(p.degrees[1], p.knots[1], v)
        fw, bw = bspline.basis_functions(self.degree_w, self.knots_w, w)
        iu = (fu[:, None] + np.arange(p.degrees[0] + 1))[:, :, None, None]
        iv = (fv[:, None] + np.arange(p.degrees[1] + 1))[:, None, :, None]
        iw = (fw[:, None] + np.arange(self.degree_w + 1))[:, None, None, :]
        iu, iv, iw = np.broadcast_arrays(iu, iv, iw)
        points = self.layers[iw, p.index[iu, iv]]
        weights = np.where(iw == 0, p.weights[iu, iv], 1.0)
        homogeneous = np.concatenate([points * weights[..., None], weights[..., None]], axis=-1)

        def combine(a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
            return np.einsum("ma,mb,mc,mabcd->md", a, b, c, homogeneous)

        value = combine(bu, bv, bw)
        weight = value[:, 3:]
        x = value[:, :3] / weight
        if not derivative:
            return x
        _, du = bspline.basis_functions(p.degrees[0], p.knots[0], u, 1)
        _, dv = bspline.basis_functions(p.degrees[1], p.knots[1], v, 1)
        _, dw = bspline.basis_functions(self.degree_w, self.knots_w, w, 1)
        parts = (combine(du, bv, bw), combine(bu, dv, bw), combine(bu, bv, dw))
        return (x, *((d[:, :3] - x * d[:, 3:]) / weight for d in parts))

    def element_volumes(self) -> np.ndarray:
        """Volume of every element by Gauss points, (element_count,), mm³."""
        volumes = np.zeros(self.element_count)
        for batch in self.bezier_elements():
            volumes[batch.element] = element_volumes(batch)
        return volumes

    def volume(self) -> float:
        """Volume of the shell, mm³, from its elements (not from its boundary)."""
        return float(self.element_volumes().sum())

    def thickness(self) -> np.ndarray:
        """Distance between both ends of the columns at the Greville points, (n,), mm."""
        outer = self.surface.triangulation("greville").vertices
        inner = self.inner_surface().triangulation("greville").vertices
        return np.linalg.norm(inner - outer, axis=1)


def element_volumes(batch: BezierElements) -> np.ndarray:
    """Signed volume of each element of a batch by Gauss points, (ne,), mm³.

    Polynomial elements are integrated exactly. Rational ones get more points until the volume
    stands to 1e-12.
    """
    if batch.weights is None:
        # det J has degree 3 d - 1 and n points are exact to 2 n - 1
        return _gauss_volumes(batch, [(3 * degree + 1) // 2 for degree in batch.degrees])
    volumes = _gauss_volumes(batch, [8] * 3)
    open_ones = np.arange(len(batch))
    for count in (12, 18, 27, 40):
        part = BezierElements(
            batch.degrees,
            batch.control_points[open_ones],
            batch.weights[open_ones],
            batch.element[open_ones],
            batch.patch[open_ones],
        )
        finer = _gauss_volumes(part, [count] * 3)
        changed = np.abs(finer - volumes[open_ones]) > 1e-12 * np.abs(finer)
        volumes[open_ones] = finer
        open_ones = open_ones[changed]
        if not len(open_ones):
            break
    return volumes


def _gauss_volumes(batch: BezierElements, counts: list[int]) -> np.ndarray:
    rules = []
    for count in counts:
        x, weight = np.polynomial.legendre.leggauss(count)
        rules.append((0.5 * (x + 1.0), 0.5 * weight))
    tables = [
        (bernstein(d, x), bernstein(d, x, 1))
        for d, (x, _) in zip(batch.degrees, rules, strict=True)
    ]
    weight = np.einsum("a,b,c->abc", *(w for _, w in rules))
    volumes = np.zeros(len(batch))
    step = max(1, 2_000_000 // weight.size)
    for start in range(0, len(batch), step):
        rows = slice(start, start + step)
        points = batch.control_points[rows]
        if batch.weights is not None:
            w = batch.weights[rows][..., None]
            points = np.concatenate([points * w, w], axis=-1)
        parts = [
            np.einsum(
                "ai,bj,ck,eijkd->eabcd",
                *(table[int(direction == axis)] for axis, table in enumerate(tables)),
                points,
                optimize=True,
            )
            for direction in (-1, 0, 1, 2)
        ]
        if batch.weights is not None:
            x = parts[0][..., :3] / parts[0][..., 3:]
            derivatives = [(d[..., :3] - x * d[..., 3:]) / parts[0][..., 3:] for d in parts[1:]]
        else:
            derivatives = parts[1:]
        det = np.einsum("...i,...i->...", np.cross(derivatives[0], derivatives[1]), derivatives[2])
        volumes[rows] = np.einsum("eabc,abc->e", det, weight)
    return volumes
