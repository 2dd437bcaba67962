# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Paths along the gradient from the control net, and the levels W on them (sections 3.1 to 3.5).

:mod:`.paper` says what of it is the paper's and what is decided here.
"""

from __future__ import annotations

import logging

import numpy as np
from scipy import sparse
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize

from . import bspline
from .harmonic import HarmonicField
from .shell import Shell
from .surface import PatchSurface
from .tetmesh.door import enclosed_volume

logger = logging.getLogger(__name__)

STEP = 1.0 / 24.0
"""Largest difference of level in a step of the paths."""
FEWEST = 4
"""Steps of paths at least."""
SMOOTHING = 0.1
"""Share of the way to the mean of its neighbours that an end moves in a step."""
ROUNDS = 60
"""Corrections in which an end is brought to its isosurface."""
NEAR = 1e-5
"""Distance from the level, as a share of it, at which an end stands on its isosurface."""
ROUNDS_OF_LEVELS = 5
"""Corrections of the levels W by the volumes of the layers that they give."""
EVEN = 0.01
"""Difference of the layers' volumes, as a share, that is small enough."""


def control_net(surface: PatchSurface) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of the control net, each cell cut along its shorter diagonal (section 3.1).

    Returns
    -------
    triangles : (t, 3) int array
        Numbers of control points; oriented outward.
    patch : (t,) int array
    """
    x = surface.control_points
    cells = [
        np.stack([g[:-1, :-1], g[1:, :-1], g[1:, 1:], g[:-1, 1:]], axis=-1).reshape(-1, 4)
        for g in (patch.index for patch in surface.patches)
    ]
    patch = np.repeat(np.arange(len(cells)), [2 * len(c) for c in cells])
    quads = np.concatenate(cells)
    along = np.linalg.norm(x[quads[:, 2]] - x[quads[:, 0]], axis=1)
    across = np.linalg.norm(x[quads[:, 3]] - x[quads[:, 1]], axis=1)
    other = (across < along * (1.0 - 1e-9))[:, None]
    first = np.where(other, quads[:, [0, 1, 3]], quads[:, [0, 1, 2]])
    second = np.where(other, quads[:, [1, 2, 3]], quads[:, [0, 2, 3]])
    return np.stack([first, second], axis=1).reshape(-1, 3), patch


def trace_paths(
    surface: PatchSurface, field: HarmonicField, w0: float
) -> tuple[np.ndarray, np.ndarray]:
    """Paths along the gradient from all control points, their front smoothed (3.2 and 3.5).

    Parameters
    ----------
    surface : PatchSurface
    field : HarmonicField
        In the control net.
    w0 : float

    Returns
    -------
    paths : (steps + 1, n, 3) array
        Ends of the paths at levels 0, w0 / steps, ..., w0; the control points come first.
    lost : (m,) int array
        Control points whose paths do not end on the isosurface.
    """
    mean = _net_means(surface)
    x = surface.control_points
    paths = [x]
    lost = np.zeros(0, dtype=int)
    steps = max(FEWEST, int(np.ceil(w0 / STEP)))
    for level in w0 * np.arange(1, steps + 1) / steps:
        x, _ = _to_level(field, x, level, surface.diagonal)
        x, lost = _to_level(field, x + SMOOTHING * (mean @ x - x), level, surface.diagonal)
        paths.append(x)
    return np.array(paths), lost


def swept_shell(
    surface: PatchSurface,
    field: HarmonicField,
    paths: np.ndarray,
    levels: np.ndarray,
    knots: np.ndarray,
) -> Shell:
    """The shell whose control points stand where the paths pass some levels (Eq. 3).

    Parameters
    ----------
    surface : PatchSurface
    field : HarmonicField
    paths : (steps + 1, n, 3) array
        From :func:`trace_paths`.
    levels : (nw,) array
        From 0 to the level at which the paths end.
    knots : array
        Clamped, on [0, 1].
    """
    place = levels / levels[-1] * (len(paths) - 1)
    low = np.minimum(place.astype(int), len(paths) - 2)
    share = (place - low)[:, None, None]
    points = (1.0 - share) * paths[low] + share * paths[low + 1]
    between = np.flatnonzero(np.abs(place - np.round(place)) > 1e-9)
    for k in between:
        points[k], _ = _to_level(field, points[k], levels[k], surface.diagonal)
    points[0] = surface.control_points
    degree = len(knots) - len(levels) - 1
    return Shell(surface, points, degree, knots)


def equal_volume_levels(
    surface: PatchSurface,
    field: HarmonicField,
    paths: np.ndarray,
    w0: float,
    degree: int,
    knots: np.ndarray,
) -> tuple[np.ndarray, float]:
    """The set W: one for all paths, such that the layers have equal volumes.

    Parameters
    ----------
    surface, field, paths
        As for :func:`swept_shell`.
    w0 : float
        The level at which the paths end.
    degree : int
    knots : array
        Clamped, on [0, 1]; each of their spans is a layer.

    Returns
    -------
    levels : (nw,) array
        From 0 to w0; equally spaced where there is a single layer, or no better ones are found.
    spread : float
        Difference between the largest and the smallest layer's volume, in units of their mean.
    """
    count = len(knots) - degree - 1
    best, least = w0 * np.arange(count) / (count - 1), 0.0
    breaks = bspline.breakpoints(knots)
    triangles, _ = control_net(surface)
    volume = np.array([enclosed_volume(x, triangles) for x in paths])
    taken = (volume[0] - volume) / (volume[0] - volume[-1])
    if len(breaks) == 2:
        return best, least
    least = np.inf
    if not (np.diff(taken) > 0.0).all():
        return best, least
    # the control nets tell the volume below a level well enough to begin with; then the elements do
    below = PchipInterpolator(taken, w0 * np.arange(len(paths)) / (len(paths) - 1))
    splines = bspline.basis_matrix(degree, knots, breaks[1:-1]).toarray()
    wanted = breaks.copy()
    for _ in range(ROUNDS_OF_LEVELS):
        levels = _smoothest(splines, below(wanted[1:-1]) / w0)
        if levels is None:
            break
        sizes = swept_shell(surface, field, paths, w0 * levels, knots).element_volumes()
        layer = sizes.reshape(-1, len(breaks) - 1).sum(axis=0)
        spread = float(np.ptp(layer) / layer.mean())
        if spread < least:
            best, least = w0 * levels, spread
        if spread < EVEN:
            break
        reached = np.concatenate([[0.0], np.cumsum(layer)]) / layer.sum()
        wanted = wanted + breaks - reached
        if not (np.diff(wanted) > 0.0).all():
            break
    logger.info("levels W: volumes of the layers differ by %.2g", least)
    return best, least


def _net_means(surface: PatchSurface) -> sparse.csr_matrix:
    """Means over the neighbours in the control net, with weights dual length over length."""
    n = len(surface.control_points)
    rows, columns, values = [], [], []
    for patch in surface.patches:
        grid = patch.index
        x = surface.control_points[grid]
        du = np.linalg.norm(np.diff(x, axis=0), axis=2)
        dv = np.linalg.norm(np.diff(x, axis=1), axis=2)
        across_u, across_v = 0.5 * (dv[:-1] + dv[1:]), 0.5 * (du[:, :-1] + du[:, 1:])
        dual_u = 0.5 * (np.pad(across_u, ((0, 0), (0, 1))) + np.pad(across_u, ((0, 0), (1, 0))))
        dual_v = 0.5 * (np.pad(across_v, ((0, 1), (0, 0))) + np.pad(across_v, ((1, 0), (0, 0))))
        for a, b, dual, length in (
            (grid[:-1], grid[1:], dual_u, du),
            (grid[:, :-1], grid[:, 1:], dual_v, dv),
        ):
            weight = (dual / np.maximum(length, 1e-9 * surface.diagonal)).ravel()
            rows += [a.ravel(), b.ravel()]
            columns += [b.ravel(), a.ravel()]
            values += [weight, weight]
    places = (np.concatenate(rows), np.concatenate(columns))
    matrix = sparse.csr_matrix((np.concatenate(values), places), shape=(n, n))
    return sparse.diags(1.0 / np.asarray(matrix.sum(axis=1)).ravel()) @ matrix


def _to_level(
    field: HarmonicField, points: np.ndarray, level: float | np.ndarray, diagonal: float
) -> tuple[np.ndarray, np.ndarray]:
    """Bring points along the gradient to their levels; numbers of those that do not come near.

    A point that jumps over its level goes back by half of what the gradient says, and so on: the
    slope of w itself is not the interpolated one.
    """
    x = points.copy()
    level = np.broadcast_to(np.asarray(level, dtype=float), len(x))
    share, last = np.ones(len(x)), np.zeros(len(x))
    active = np.arange(len(x))
    longest = 0.02 * diagonal
    for _ in range(ROUNDS):
        w, gradient, _ = field.evaluate(x[active])
        gap = level[active] - w
        far = np.abs(gap) > NEAR * level[active]
        active, gap, gradient = active[far], gap[far], gradient[far]
        if not len(active):
            break
        share[active] *= np.where(gap * last[active] < 0.0, 0.5, 1.0)
        last[active] = gap
        slope = np.linalg.norm(gradient, axis=1)
        # where w is flat a point stays
        step = np.clip(gap, -longest * slope, longest * slope) / np.where(slope > 0.0, slope, 1.0)
        unit = gradient / np.where(slope > 0.0, slope, 1.0)[:, None]
        x[active] += (share[active] * step)[:, None] * unit
    return x, active


def _smoothest(splines: np.ndarray, values: np.ndarray) -> np.ndarray | None:
    """Rising spline coefficients from 0 to 1 with given values, their steps as even as can be.

    The steps are a geometric row where that is enough: few values leave the coefficients open.

    Parameters
    ----------
    splines : (m, n) array
        The basis functions at m places.
    values : (m,) array

    Returns
    -------
    (n,) array, or None where there are none
    """

    def coefficients(logarithms: np.ndarray) -> np.ndarray:
        steps = np.exp(logarithms - logarithms.max())
        return np.concatenate([[0.0], np.cumsum(steps) / steps.sum()])

    def uneven(logarithms: np.ndarray) -> float:
        return float((np.diff(logarithms, 2) ** 2).sum() + 1e-3 * (np.diff(logarithms) ** 2).sum())

    found = minimize(
        uneven,
        np.zeros(splines.shape[1] - 1),
        method="SLSQP",
        constraints={
            "type": "eq",
            "fun": lambda logarithms: splines @ coefficients(logarithms) - values,
        },
        options={"maxiter": 200, "ftol": 1e-8},
    )
    levels = coefficients(found.x)
    near = np.abs(splines @ levels - values).max() < 1e-3
    return levels if near and (np.diff(levels) > 0.0).all() else None
