# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Volume of the gaps and overlaps between the facets of the interface and the inner surface."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FaultError
from . import bspline
from .elements import gauss_line, shape_functions, shape_gradients
from .shell import Shell
from .surface import PatchSurface

if TYPE_CHECKING:
    from .interior import Interface, Interior

logger = logging.getLogger(__name__)

BALANCE = 1e-9
"""Largest share of the volume by which shell, core and gap may miss the body."""


def check_balance(body: PatchSurface, shell: Shell, interior: Interior, gap: float) -> None:
    """Shell, core and gap, each integrated on its own, must add up to the body.

    Raises
    ------
    FaultError
    """
    volume = body.volume()
    off = shell.volume() + interior.volume + gap - volume
    logger.info("shell + core + gap - body = %.3g of the volume", off / volume)
    # what rounding of coordinates far from the origin makes of it
    far = float(np.abs(body.control_points).max()) * body.diagonal**2 * np.finfo(float).eps
    if abs(off) > BALANCE * volume + far:
        raise FaultError(f"shell, core and gap miss the body's volume by {off / volume:.2g} of it")


def gap_volume(interface: Interface, shell: Shell, curved: bool = False) -> float:
    """Signed volume between the facets of the interface and the inner surface, mm³.

    Positive where the core's facets lie inside the inner surface, so that shell + core + gap is
    the body's volume. It is integrated over the parameter triangles, not taken as a difference.

    Parameters
    ----------
    interface : Interface
    shell : Shell
    curved : bool
        Facets as quadratic triangles through the mid nodes instead of flat ones.
    """
    return float(triangle_gaps(interface, shell, curved).sum())


def triangle_gaps(interface: Interface, shell: Shell, curved: bool = False) -> np.ndarray:
    """Signed volume between each facet and the inner surface, (m,), mm³.

    The space between a facet f(t) and the surface s(t) over the same parameter triangle is swept
    by f + a (s - f), 0 <= a <= 1; its determinant is integrated exactly: in a in closed form, over
    the triangle by Gauss points on the pieces that the knot lines cut it into.
    """
    inner = shell.inner_surface()
    gaps = np.zeros(len(interface.triangles))
    kind = "tri6" if curved else "tri3"
    nodes = interface.vertices[interface.triangles]
    if curved:
        nodes = np.concatenate([nodes, interface.midpoints[interface.triangle_edges]], axis=1)
    number, _ = inner.stack_of
    for k, stack in enumerate(inner.stacks):
        chosen = np.flatnonzero(number[interface.triangle_patch] == k)
        # The determinant has degree 3 d - 1 in each parameter; along a strip the powers of v and
        # the height of the band come on top.
        p, q = (max(d, 2) for d in stack.degrees)
        counts = (3 * (p + q)) // 2 + 1, (3 * q) // 2 + 1
        step = max(1, 100_000 // (counts[0] * counts[1]))
        for start in range(0, len(chosen), step):
            part = chosen[start : start + step]
            corners = interface.triangle_uv[part]
            uv, weights = _pieces(corners, stack.knots, counts)
            gaps[part] = _swept(
                inner, interface.triangle_patch[part], kind, nodes[part], corners, uv, weights
            )
    return gaps


def _pieces(
    corners: np.ndarray, knots: tuple[np.ndarray, np.ndarray], counts: tuple[int, int]
) -> tuple[np.ndarray, np.ndarray]:
    """Quadrature points of right-angled parameter triangles, cut along knot lines.

    A triangle is cut into strips in u, at the knots and where its long side meets knots of v; in a
    strip, bands in v lie between knot lines, legs and the long side. Strips and bands that a
    triangle does not have are empty.

    Returns
    -------
    uv : (m, q, 2) array
    weights : (m, q) array
        They add up to each triangle's parameter area.
    """
    low, high = corners.min(axis=1), corners.max(axis=1)
    # the long side joins the two corners other than the right-angled one
    right = np.argmin(np.abs(np.roll(corners, -1, 1) - corners).min(2)
                      + np.abs(np.roll(corners, 1, 1) - corners).min(2), axis=1)  # fmt: skip
    rows = np.arange(len(corners))
    vertex = corners[rows, right]
    at_u, at_v = corners[rows, (right + 1) % 3], corners[rows, (right + 2) % 3]
    swap = np.abs(at_u[:, 0] - vertex[:, 0]) < np.abs(at_v[:, 0] - vertex[:, 0])
    at_u, at_v = np.where(swap[:, None], at_v, at_u), np.where(swap[:, None], at_u, at_v)
    # along the long side: v = at_v.v at u = vertex.u, v = vertex.v at u = at_u.u
    slope = (vertex[:, 1] - at_v[:, 1]) / (at_u[:, 0] - vertex[:, 0])

    def inside(values: np.ndarray, axis: int) -> np.ndarray:
        lines = bspline.breakpoints(values)
        first = np.searchsorted(lines, low[:, axis], side="right")
        most = int((np.searchsorted(lines, high[:, axis], side="left") - first).max(initial=0))
        picked = lines[np.minimum(first[:, None] + np.arange(most), len(lines) - 1)]
        return np.clip(picked, low[:, axis, None], high[:, axis, None])

    u_lines, v_lines = inside(knots[0], 0), inside(knots[1], 1)
    crossing = vertex[:, :1] + (v_lines - at_v[:, 1:]) / slope[:, None]
    strips = np.concatenate(
        [low[:, :1], high[:, :1], u_lines, np.clip(crossing, low[:, :1], high[:, :1])], axis=1
    )
    strips.sort(axis=1)
    bands = np.sort(np.concatenate([low[:, 1:], high[:, 1:], v_lines], axis=1), axis=1)
    (x, w), (y, w_v) = (gauss_line(count) for count in counts)
    width = np.diff(strips, axis=1)
    u = strips[:, :-1, None] + width[:, :, None] * x  # (m, strips, points)
    long_side = at_v[:, 1, None, None] + slope[:, None, None] * (u - vertex[:, 0, None, None])
    floor = np.minimum(vertex[:, 1, None, None], long_side)[:, :, None]
    roof = np.maximum(vertex[:, 1, None, None], long_side)[:, :, None]
    bottom = np.clip(bands[:, None, :-1, None], floor, roof)
    height = np.clip(bands[:, None, 1:, None], floor, roof) - bottom
    v = bottom[..., None] + height[..., None] * y  # (m, strips, bands, points, points)
    u = np.broadcast_to(u[:, :, None, :, None], v.shape)
    weights = (width[:, :, None] * w)[:, :, None, :, None] * height[..., None] * w_v
    uv = np.stack([u, v], axis=-1).reshape(len(corners), -1, 2)
    return uv, weights.reshape(len(corners), -1)


def _swept(
    inner: PatchSurface,
    patch: np.ndarray,
    kind: str,
    nodes: np.ndarray,
    corners: np.ndarray,
    uv: np.ndarray,
    weights: np.ndarray,
) -> np.ndarray:
    """Integral over each parameter triangle of the determinant of f + a (s - f)."""
    m, q = weights.shape
    used = np.abs(weights) > 0.0
    legs = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    inverse = np.linalg.inv(legs)
    local = np.einsum("mij,mqj->mqi", inverse, uv - corners[:, :1])
    values = shape_functions(kind, local.reshape(-1, 2)).reshape(m, q, -1)
    gradients = shape_gradients(kind, local.reshape(-1, 2)).reshape(m, q, -1, 2)
    f = np.einsum("mqn,mnc->mqc", values, nodes)
    f_uv = np.einsum("mqnd,mnc,mde->mqce", gradients, nodes, inverse, optimize=True)
    s, s_u, s_v = inner.evaluate_at(np.repeat(patch, q), *uv.reshape(-1, 2).T, 1)
    gap = s.reshape(m, q, 3) - f
    gap_u = s_u.reshape(m, q, 3) - f_uv[..., 0]
    gap_v = s_v.reshape(m, q, 3) - f_uv[..., 1]
    normal = np.cross(f_uv[..., 0], f_uv[..., 1])
    normal += 0.5 * (np.cross(f_uv[..., 0], gap_v) + np.cross(gap_u, f_uv[..., 1]))
    normal += np.cross(gap_u, gap_v) / 3.0
    return np.einsum("mqc,mqc,mq->m", gap, normal, np.where(used, weights, 0.0))
