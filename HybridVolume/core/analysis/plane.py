# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Hybrid bodies in the plane: a ring of NURBS elements, triangles of degree 1 to 3 inside.

The paper's section 4 in general: any closed NURBS boundary, any number of layers, any depth. The
spaces are those of bodies in space (:mod:`.coupling`), so are the problems on them, and
:func:`.hybrid_space.refined` makes them finer. Figures are those of a slice of 1 mm; the strain of
elastic bodies is plane.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...errors import InputError
from .. import bspline
from ..elements import gauss_line
from .coupling import CollocationSpace, NitscheSpace
from .plane_curve import PlaneCurve
from .plane_mesh import crossing_edges, fill_polygon
from .plane_offset import inner_points
from .plane_rim import TriangleRim
from .plane_ring import PlaneRing
from .simplex_space import DEGREES, SimplexSpace, found_rows, lattice, lattice_keys
from .subdivision import interface_places
from .tet_space import check_valid
from .unfold import unfolded

COUPLINGS = ("collocation", "nitsche")
GREVILLE = "greville"
_SAMPLES = 8
"""Points on each span of an inner curve by which it is seen whether it crosses itself."""


def ring(
    boundary: PlaneCurve,
    depth: float,
    layers: int = 1,
    degree_w: int | None = None,
    inner: np.ndarray | None = None,
) -> PlaneRing:
    """A ring of NURBS elements along a boundary.

    Weights of the inner layers are 1, as in the paper's 3.2, and the layers are as thick as each
    other.

    Parameters
    ----------
    boundary : PlaneCurve
    depth : float
        Share of the way from the boundary to the middle of its area, in (0, 1).
    layers : int
        Elements through the ring.
    degree_w : int, optional
        Through the ring; the boundary's degree by default.
    inner : (n, 2) array, optional
        Control points of the inner curve, mm, one for each of the boundary's, in its place. By
        default they are the boundary's, scaled towards the middle of its area; if that folds the
        ring, those of :func:`.plane_offset.inner_points`.

    Raises
    ------
    InputError
        The depth or the number of layers is none, the ring is folded, or its inner curve crosses
        itself; arcs are named.
    """
    degree_w = boundary.degree if degree_w is None else degree_w
    if not 0.0 < depth < 1.0:
        raise InputError(f"a ring of depth {depth:g}", remedy="give a depth between 0 and 1")
    if layers < 1 or degree_w < 1:
        raise InputError(
            f"{layers} layers of degree {degree_w}", remedy="give at least one, of degree 1 or more"
        )
    outer = boundary.points[:, :2] / boundary.points[:, 2:]
    if inner is not None:
        if np.shape(inner) != outer.shape:
            raise InputError(f"{len(inner)} inner control points for {len(outer)} of the boundary")
        made = _between(boundary, outer, np.asarray(inner, dtype=float), layers, degree_w)
    else:
        scaled = outer + depth * (_middle(boundary) - outer)
        made = _between(boundary, outer, scaled, layers, degree_w)
        if not made.jacobian_bounds.min() > 0.0:
            found = [_between(boundary, outer, points, layers, degree_w)
                     for points in inner_points(boundary, depth)]  # fmt: skip
            made = max(found, key=lambda one: (not len(_crossed(one.inner_curve)), _evenness(one)))
    folded = (made.jacobian_bounds <= 0.0).any(axis=1)
    if folded.any():
        patches = np.unique(boundary.spans.patch[folded])
        raise InputError(
            f"{folded.sum()} spans of the ring are folded at depth {depth:g}",
            faces=[boundary.names[k] for k in patches],
            figure=float(folded.sum()),
            remedy="cut the boundary finer, change the depth, or give the inner control points",
        )
    crossed = _crossed(made.inner_curve)
    if len(crossed):
        raise InputError(
            "the ring's inner curve crosses itself",
            faces=[boundary.names[k] for k in crossed],
            figure=float(len(crossed)),
            remedy="make the ring thinner, or give the inner control points",
        )
    return made


def _crossed(curve: PlaneCurve) -> np.ndarray:
    """Arcs on which a curve crosses itself, as far as points on it show."""
    spans = curve.spans
    share = np.arange(_SAMPLES) / _SAMPLES
    u = (spans.ends[:, :1] + np.diff(spans.ends, axis=1) * share).ravel()
    crossed = crossing_edges(curve.evaluate(np.repeat(spans.patch, _SAMPLES), u))
    return np.unique(spans.patch[crossed // _SAMPLES])


def _between(
    boundary: PlaneCurve, outer: np.ndarray, inner: np.ndarray, layers: int, degree_w: int
) -> PlaneRing:
    """The ring between a boundary and the control points of its inner curve; it may be folded."""
    knots_w = bspline.clamped_knots(degree_w, layers)
    share = bspline.greville(degree_w, knots_w)[:, None, None]
    heavy = np.ones((len(share), len(outer), 1))
    net = np.concatenate([(1.0 - share) * outer + share * inner, heavy], axis=2)
    net[0] = boundary.points
    return PlaneRing(boundary, degree_w, knots_w, net)


def _evenness(ring: PlaneRing) -> float:
    """Smallest bound of det J over the size of its element at the boundary; larger is better."""
    bounds = ring.jacobian_bounds
    return float(bounds.min() / np.abs(bounds).max())


def plane_space(
    boundary: PlaneCurve,
    depth: float,
    layers: int = 1,
    degree: int = 1,
    coupling: str = "collocation",
    *,
    degree_w: int | None = None,
    nodes: float | str = 1,
    size: float | None = None,
    inner: np.ndarray | None = None,
) -> CollocationSpace | NitscheSpace:
    """A ring with triangles inside, coupled.

    Parameters
    ----------
    boundary : PlaneCurve
        Its spans are those of the ring; `PlaneCurve.refined` and `elevated` change them. Arcs of a
        lower degree than the triangles are raised to it: the ring would hold back the rates.
    depth, layers, degree_w, inner
        As for :func:`ring`.
    degree : {1, 2, 3}
        Of the triangles; 1 is the paper's.
    coupling : {"collocation", "nitsche"}
    nodes : int, 1 / int or "greville"
        Where corners of triangles stand on the inner curve: at its knots, with so many edges a
        span (1 / 2: an edge over two spans, which collocation does not converge with); or at the
        node locations t_l of its control points as in the paper.
    size : float, optional
        Longest edge of the triangles inside, mm; the longest edge on the inner curve by default.

    Raises
    ------
    InputError
        A word or a number is none of those, the ring or a triangle is folded.
    """
    if coupling not in COUPLINGS:
        raise InputError(f"coupling {coupling!r}", remedy=f"choose {' or '.join(COUPLINGS)}")
    if nodes != GREVILLE and not (isinstance(nodes, int | float) and nodes > 0):
        raise InputError(
            f"nodes {nodes!r}", remedy=f"give the number of edges a span, or {GREVILLE!r}"
        )
    if not boundary.smooth:
        boundary = boundary.elevated(max(boundary.degree, degree))
    spline = ring(boundary, depth, layers, degree_w, inner)
    curve = spline.inner_curve
    places = (
        curve.greville if nodes == GREVILLE else [_cut(breaks, nodes) for breaks in curve.breaks]
    )
    patch, ends = _edges(curve, places)
    core = triangle_space(curve, patch, ends, degree, size)
    check_valid(core, spline)
    return (CollocationSpace if coupling == "collocation" else NitscheSpace)(spline, core)


def triangles_only(
    boundary: PlaneCurve, size: float | None = None, degree: int = 1
) -> CollocationSpace:
    """The same kind of space without a ring: triangles up to the boundary.

    Parameters
    ----------
    boundary : PlaneCurve
    size : float, optional
        Longest edge, mm: each arc is cut into edges of one length. By default corners stand at the
        boundary's knots.
    degree : {1, 2, 3}

    Raises
    ------
    InputError
        The size is none, the degree is another, or a triangle is folded.
    """
    if size is not None and not 0.0 < size < np.inf:
        raise InputError(f"edges of {size:g} mm", remedy="give a size > 0")
    if size is None:
        places = [_cut(breaks, 1) for breaks in boundary.breaks]
    else:
        places = [_even(boundary, number, size) for number in range(len(boundary.knots))]
    patch, ends = _edges(boundary, places)
    core = triangle_space(boundary, patch, ends, degree, size)
    rim = _rim(core, boundary)
    check_valid(core, rim)
    return CollocationSpace(rim, core)


def triangle_space(
    curve: PlaneCurve, patch: np.ndarray, ends: np.ndarray, degree: int, size: float | None = None
) -> SimplexSpace:
    """Triangles inside a closed curve, whose nodes on it stand on the curve itself.

    Parameters
    ----------
    curve : PlaneCurve
    patch : (t,) int array
        Arcs of the edges on it, all around.
    ends : (t, 2) array
        Parameters of their ends; each begins where the last one ends.
    degree : {1, 2, 3}
    size : float, optional
        Longest edge inside, mm.

    Raises
    ------
    InputError
        The degree is another. Whether a triangle is folded is for the caller to see.
    """
    if degree not in DEGREES:
        raise InputError(f"triangles of degree {degree}", remedy="choose 1, 2 or 3")
    vertices, triangles = fill_polygon(curve.evaluate(patch, ends[:, 0]), size)
    keys = lattice_keys(triangles, degree)
    flat, inverse = np.unique(keys.reshape(-1, degree), axis=0, return_inverse=True)
    count = np.arange(len(patch))
    around = np.column_stack([count, np.roll(count, -1)])
    edge_keys = lattice_keys(around, degree)
    faces = found_rows(flat, edge_keys.reshape(-1, degree)).reshape(edge_keys.shape[:2])
    straight = vertices[flat].mean(axis=1)
    elements = inverse.reshape(keys.shape[:2])
    on, patches, u, w = interface_places(faces, patch, ends[..., None], np.ones(ends.shape), degree)
    nodes = straight.copy()
    nodes[on] = curve.evaluate(patches, u[:, 0])
    if degree == 3:
        _centre(nodes, straight, elements)
    sides = patch, ends[..., None], np.ones(ends.shape)
    made, _ = unfolded(SimplexSpace(degree, nodes, elements, on, patches, u, w, faces, *sides))
    return made


def _centre(nodes: np.ndarray, straight: np.ndarray, elements: np.ndarray) -> None:
    """Move the middles of cubic triangles with their edges, so that quadratic maps are kept."""
    moved = (nodes - straight)[elements]
    counts = lattice(2, 3)
    (inside,) = np.flatnonzero(counts.min(axis=1) == 1)
    edges = np.flatnonzero((counts.min(axis=1) == 0) & (counts.max(axis=1) == 2))
    nodes[elements[:, inside]] += 0.25 * moved[:, edges].sum(axis=1)


def _rim(core: SimplexSpace, boundary: PlaneCurve) -> TriangleRim:
    """The rim of triangles that reach up to the boundary."""
    return TriangleRim(
        core.degree,
        core.nodes[core.interface],
        np.searchsorted(core.interface, core.faces),
        core.face_patch,
        core.face_uv[..., 0],
        boundary,
    )


def _edges(curve: PlaneCurve, places: Sequence[np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Arcs and parameters of edges between places of all arcs, each of which starts its edge."""
    patch = np.repeat(np.arange(len(places)), [len(place) for place in places])
    ends = []
    for place in places:
        # an arc ends at 1; a smooth curve where its first edge begins, one turn later
        last = place[0] + 1.0 if curve.smooth else 1.0
        ends.append(np.column_stack([place, np.append(place[1:], last)]))
    return patch, np.concatenate(ends)


def _cut(breaks: np.ndarray, parts: float) -> np.ndarray:
    """Parameters that cut every span into equal parts, or join some, without the last one's end."""
    if parts < 1.0:
        return breaks[:-1][:: round(1.0 / parts)]
    count = round(parts)
    return (breaks[:-1, None] + np.diff(breaks)[:, None] * np.arange(count) / count).ravel()


def _even(curve: PlaneCurve, number: int, size: float) -> np.ndarray:
    """Parameters that cut an arc into edges of one length, without its end."""
    x, weight = gauss_line(8)
    breaks = curve.breaks[number]
    fine = np.unique(np.concatenate([breaks, np.linspace(0.0, 1.0, 65)]))
    step = np.diff(fine)
    u = (fine[:-1, None] + step[:, None] * x).ravel()
    speed = np.linalg.norm(curve.tangents(np.full(len(u), number), u), axis=1)
    length = np.concatenate([[0.0], np.cumsum(speed.reshape(-1, len(x)) @ weight * step)])
    count = max(int(np.ceil(length[-1] / size - 1e-9)), 3 if len(curve.knots) == 1 else 1)
    return np.interp(length[-1] * np.arange(count) / count, length, fine)


def _middle(curve: PlaneCurve) -> np.ndarray:
    """Centroid of the area that a curve encloses, mm."""
    spans = curve.spans
    x, weight = gauss_line(2 * curve.degree + 6)
    length = np.diff(spans.ends, axis=1)
    u = (spans.ends[:, :1] + length * x).ravel()
    patch = np.repeat(spans.patch, len(x))
    at, along = curve.evaluate(patch, u), curve.tangents(patch, u)
    origin = at.mean(axis=0)
    at = at - origin
    turned = (at[:, 0] * along[:, 1] - at[:, 1] * along[:, 0]) * (length * weight).ravel()
    return origin + (at * turned[:, None]).sum(axis=0) / (1.5 * turned.sum())
