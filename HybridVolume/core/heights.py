# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Where the layers of wedges stand on the columns of the shell."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np

from . import bspline
from .columns import evaluate_columns
from .density import LAYERS, Density
from .interior import Interface
from .shell import Shell

logger = logging.getLogger(__name__)

FIRST = 0.2
"""Height of the outermost layer as a share of the edges on the surface, where it is chosen."""
THINNEST = 0.125
"""Share below which no outermost layer shall come: stress at nodes is spoilt by thinner ones."""
_TYPICAL, _THIN = 0.5, 0.05
"""Shares of the area by which the number of layers is chosen, and which may be too thin for it."""
_STEPS = 16
"""Samples of a column in each Bézier layer."""
_EVENED = 4
"""Rounds in which neighbouring columns are brought near to each other."""


@dataclass(frozen=True, eq=False)
class Levels:
    """Parameters w of the levels between layers of wedges, from outside (0) to inside (1).

    Attributes
    ----------
    count : int
        Layers.
    vertices : (2 count + 1, n) array
        At the interface's vertices; every second level is half-way up a layer.
    edges : (count + 1, e) array
        At the middles of the interface's edges.
    """

    count: int
    vertices: np.ndarray
    edges: np.ndarray


def layer_levels(shell: Shell, interface: Interface, density: Density) -> Levels:
    """Levels of the layers, and of the mid nodes between them, for a wanted density.

    The shell's own Bézier layers, or layers that grow inward, so many that the outermost is about
    `FIRST` of the edges on the surface. Where that would make it thinner than `THINNEST` of them,
    the layers of these columns grow less.

    Parameters
    ----------
    shell : Shell
    interface : Interface
    density : Density
    """
    at_vertices = _Columns(shell, interface.vertex_patch, interface.vertex_uv, interface.vertex_w)
    if density.plain:
        w = bspline.breakpoints(shell.knots_w)
        ends = interface.edge_w if len(interface.edge_w) else np.ones(len(interface.edges))
        vertices = at_vertices.with_halves(w[:, None] * at_vertices.end)
        return Levels(len(w) - 1, vertices, w[:, None] * ends)
    at_edges = _Columns(shell, interface.edge_patch, interface.edge_uv, interface.edge_w)
    if density.layers:
        count, growth = density.layers, np.full(len(interface.vertices), density.growth)
    else:
        slender, area = _slenderness(shell, interface, at_vertices.height)
        count = _count(slender, area, density.growth)
        growth = _growth(slender, count, density.growth)
        first = _first_share(growth, count) * slender
        thin = area[first < 0.99 * THINNEST].sum() / area.sum()
        logger.info(
            "%d layers of wedges, the outermost %.2f of an edge (median), below %.3f on %.1f %%",
            count,
            _quantile(first, area, 0.5),
            THINNEST,
            100.0 * thin,
        )
    vertices = at_vertices.places(_shares(growth, count))
    edges = at_edges.places(_shares(growth[interface.edges].mean(axis=1), count))
    return Levels(count, at_vertices.with_halves(vertices), edges)


def _shares(growth: np.ndarray, count: int) -> np.ndarray:
    """Shares of the height at which the levels stand, (count + 1, m)."""
    heights = growth ** np.arange(count)[:, None]
    levels = np.concatenate([np.zeros((1, len(growth))), np.cumsum(heights, axis=0)])
    return levels / levels[-1]


def _first_share(growth: np.ndarray, count: int) -> np.ndarray:
    """Height of the first of so many layers, as a share of all."""
    return 1.0 / (growth ** np.arange(count)[:, None]).sum(axis=0)


def _slenderness(
    shell: Shell, interface: Interface, height: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Height of each column over the length of the edges around it, and its share of the area."""
    triangles = interface.triangles
    outer = shell.surface.evaluate_at(interface.vertex_patch, *interface.vertex_uv.T)
    corners = outer[triangles]
    area = 0.5 * np.linalg.norm(
        np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1
    )
    n, edges = len(outer), interface.edges
    around = np.bincount(triangles.ravel(), np.repeat(area, 3), n)
    length = np.linalg.norm(outer[edges[:, 0]] - outer[edges[:, 1]], axis=1)
    degree = np.bincount(edges.ravel(), minlength=n)
    slender = height * degree / np.bincount(edges.ravel(), np.repeat(length, 2), n)
    # layers of neighbours with different growths would tilt
    for _ in range(_EVENED):
        others = np.bincount(edges.ravel(), slender[edges[:, ::-1]].ravel(), n) / degree
        slender = 0.5 * (slender + others)
    return slender, around


def _quantile(values: np.ndarray, weights: np.ndarray, share: float) -> float:
    order = np.argsort(values)
    running = np.cumsum(weights[order])
    return float(values[order[np.searchsorted(running, share * running[-1])]])


def _count(slender: np.ndarray, area: np.ndarray, growth: float) -> int:
    """Layers that make the outermost `FIRST` of an edge on the typical column."""
    wanted = _quantile(slender, area, _TYPICAL) / FIRST
    if growth > 1.0 + 1e-9:
        wanted = np.log1p((growth - 1.0) * wanted) / np.log(growth)
    thinnest = _quantile(slender, area, _THIN) / THINNEST
    return int(np.clip(min(np.round(wanted), np.floor(thinnest)), 1, LAYERS[1]))


def _growth(slender: np.ndarray, count: int, growth: float) -> np.ndarray:
    """Growth on each column: as wanted, or less where the outermost layer would be too thin."""
    low, high = np.ones(len(slender)), np.full(len(slender), growth)
    enough = _first_share(high, count) * slender >= THINNEST
    for _ in range(40):
        middle = 0.5 * (low + high)
        thick = _first_share(middle, count) * slender >= THINNEST
        low, high = np.where(thick, middle, low), np.where(thick, high, middle)
    return np.where(enough, growth, low)


class _Columns:
    """Lengths along columns of the shell, from outside to inside."""

    def __init__(self, shell: Shell, patch: np.ndarray, uv: np.ndarray, end: np.ndarray) -> None:
        lines = bspline.breakpoints(shell.knots_w)
        share = np.arange(_STEPS) / _STEPS
        inner = lines[:-1, None] + np.diff(lines)[:, None] * share
        self.w = np.append(inner.ravel(), lines[-1])
        points = evaluate_columns(shell, patch, uv, self.w)
        steps = np.linalg.norm(np.diff(points, axis=0), axis=2)
        self.length = np.concatenate([np.zeros((1, len(patch))), np.cumsum(steps, axis=0)])
        self.end = end if len(end) else np.ones(len(patch))
        w = np.broadcast_to(self.w[:, None], self.length.shape)
        # as far as the interface, (m,), mm
        self.height = _interpolated(w, self.length, self.end[None])[0]

    def places(self, shares: np.ndarray) -> np.ndarray:
        """Parameters at shares (k, m) of the columns' heights."""
        found = _interpolated(self.length, self.w[:, None], shares * self.height)
        found[-1] = self.end
        return found

    def with_halves(self, w: np.ndarray) -> np.ndarray:
        """Levels (k, m) with those half-way up each layer between them, (2 k - 1, m)."""
        length = _interpolated(np.broadcast_to(self.w[:, None], self.length.shape), self.length, w)
        found = np.empty((2 * len(w) - 1, w.shape[1]))
        found[::2] = w
        halves = 0.5 * (length[1:] + length[:-1])
        found[1::2] = _interpolated(self.length, self.w[:, None], halves)
        return found


def _interpolated(x: np.ndarray, y: np.ndarray, at: np.ndarray) -> np.ndarray:
    """Piecewise linear y(x) of each column; x (n, m) increases, y (n, m) or (n, 1), at (k, m)."""
    y = np.broadcast_to(y, x.shape)
    rows = np.arange(x.shape[1])
    found = np.empty(at.shape)
    for k, level in enumerate(at):
        left = np.clip((x <= level).sum(axis=0) - 1, 0, len(x) - 2)
        x0, x1, y0, y1 = x[left, rows], x[left + 1, rows], y[left, rows], y[left + 1, rows]
        share = np.clip((level - x0) / (x1 - x0), 0.0, 1.0)
        found[k] = np.where(share == 1.0, y1, y0 + share * (y1 - y0))
    return found
