# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The paper's own way to a shell, for smooth bodies and for comparison (sections 3.1, 3.2, 3.5).

As written: the triangulated control net bounds the domain (3.1); w is harmonic in linear elements,
0 on the net and 1 on the midstructure (Eq. 2); from every control point c_l a path follows the
gradient of w to the isosurface w = w0 (3.2); all paths advance together in small steps, and in each
step the front of their ends is smoothed by a Laplacian and brought back to its isosurface (3.5);
the control points of the shell stand where the paths pass the levels W (Eq. 3), with weights 1
inside. The user is told where w0 has an isosurface of another genus than the body (3.2).

What the paper leaves open is decided so that its method does as well as it can:

* the midstructure is facets, fattened and mended as in :mod:`.harmonic_domain`: points alone are
  forgotten by a fine mesh; and edges between boundary vertices are split, or w would be 0 around
  them;
* the gradient is recovered at the vertices and interpolated. Along the gradient that is constant in
  each tetrahedron, paths meet at the tetrahedra's faces: without smoothing, a box of 352 elements
  then has 78 inverted ones at w0 = .3 instead of 1;
* a step is w0 / 24. The Laplacian has the weights dual length over length of the control net (the
  cotangents, on a net of rectangles), so that what is even on the surface stays as it is, and the
  ends move a tenth of the way. With equal weights a torus of 64 elements has 16 inverted ones; with
  three tenths of the way a ring of 64 has 8. With these weights and this share both have none, and
  a box of 352 has none or one at any level;
* W is found for all paths together ("determined through an optimization procedure"): from equally
  spaced values such that the layers of elements have equal volumes. A single layer leaves nothing
  to choose, and W stays equally spaced.

The paper trusts that inverted elements "generally do not occur". Here they are looked for: a shell
is handed out only where every element is proved valid and the inner surface does not cut itself.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse
from scipy.interpolate import PchipInterpolator
from scipy.optimize import minimize

from ..errors import (
    HybridVolumeError,
    InputError,
    Place,
    SelfIntersectionError,
    ThicknessError,
)
from . import bspline
from .front import column_frame
from .harmonic import HarmonicField, solve_on
from .harmonic_domain import domain_within
from .intersection import self_intersections
from .midstructure import Midstructure
from .shell import Shell
from .surface import PatchSurface
from .tetmesh.door import enclosed_volume
from .validity import Certificate, certify, scaled_jacobian

logger = logging.getLogger(__name__)

STEPS = 24
"""Steps of the paths."""
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
GRIDS = (1, 2)
"""Cells a knot span in the triangulations that are tested for crossings."""
MOST_PLACES = 200
"""Places that an error names."""
REMEDY = "use --method certified"
WHY = "its control points, not its points, are drawn to the level"
"""Why the inner surface of this method is not at its level."""


def check_wishes(thickness: str, face_factors: Mapping[str, float], spacing: str) -> None:
    """Refuse what the paper's method has no means for.

    Parameters
    ----------
    thickness, face_factors, spacing
        As in :class:`HybridVolume.core.pipeline.Options`.

    Raises
    ------
    InputError
    """
    if thickness:
        raise InputError(
            f"the paper's method knows levels w0 only, not a thickness of {thickness!r}",
            remedy=f"give w0, or {REMEDY}",
        )
    if face_factors:
        raise InputError(
            "the paper's method has one level w0 for all faces, no factors",
            faces=sorted(face_factors),
            remedy=f"leave the factors out, or {REMEDY}",
        )
    if spacing.strip().lower() != "volume":
        raise InputError(
            f"the paper's levels W give layers of equal volume, not the spacing {spacing!r}",
            remedy=f"leave the spacing out, or {REMEDY}",
        )


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


def paper_field(surface: PatchSurface, midstructure: Midstructure) -> HarmonicField:
    """The harmonic function in the control net (section 3.1).

    Parameters
    ----------
    surface : PatchSurface
    midstructure : Midstructure

    Raises
    ------
    SelfIntersectionError
        The control net cuts itself, so that it bounds nothing.
    MesherError
        No mesher could fill it.
    """
    triangles, patch = control_net(surface)
    x = surface.control_points
    pairs = self_intersections(x, triangles)
    if len(pairs):
        raise SelfIntersectionError(
            f"the control net, which bounds the domain in the paper's method, cuts itself in"
            f" {len(pairs)} places (the surface itself need not)",
            faces=_faces(surface, patch[pairs.ravel()]),
            figure=float(len(pairs)),
            remedy=REMEDY,
            places=_net_places(surface, triangles, patch, np.unique(pairs)),
        )
    return solve_on(domain_within((x, triangles), surface, midstructure), surface.genus)


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
    for level in w0 * np.arange(1, STEPS + 1) / STEPS:
        x, _ = _to_level(field, x, level, surface.diagonal)
        x, lost = _to_level(field, x + SMOOTHING * (mean @ x - x), level, surface.diagonal)
        paths.append(x)
    return np.array(paths), lost


def paper_shell(
    surface: PatchSurface,
    field: HarmonicField,
    w0: float,
    *,
    layers: int = 2,
    degree_w: int = 3,
    progress: Callable[[float, str], None] | None = None,
) -> tuple[Shell, Certificate]:
    """The shell of the paper's method, proved.

    Parameters
    ----------
    surface : PatchSurface
    field : HarmonicField
        From :func:`paper_field`.
    w0 : float
        Level of the inner boundary.
    layers : int
        Bézier layers.
    degree_w : int
        Degree across the shell.
    progress : callable, optional
        Called with a share of the work done and a text.

    Returns
    -------
    Shell, Certificate

    Raises
    ------
    ThicknessError
        An element is not proved valid, the inner surface cuts itself, a path does not reach the
        isosurface, or that has another genus than the body.
    """
    report = progress or (lambda share, text: None)
    level = field.largest_level(surface.genus, w0)
    if level < w0 * (1.0 - 1e-9):
        raise ThicknessError(
            f"the isosurface at w0 = {w0:.3g} has another genus than the body, which the paper's"
            f" method does not allow; the largest level with the right genus is {level:.3g}",
            figure=level,
            remedy=f"choose a smaller w0, or {REMEDY}",
        )
    report(0.1, f"isosurface has the body's genus; {len(surface.control_points)} paths")
    shell, lost = _traced_shell(surface, field, w0, layers, degree_w)
    report(0.7, "paths traced; certificate")
    certificate = certify(shell.bezier_elements())
    _refuse(shell, certificate, lost)
    pairs, patches = _crossings(shell)
    if pairs:
        raise ThicknessError(
            f"the inner surface of the paper's method cuts itself in {pairs} places at"
            f" w0 = {w0:.3g}",
            faces=_faces(surface, patches),
            figure=float(pairs),
            remedy=REMEDY,
        )
    return replace(shell, embedded=True), certificate


def paper_figures(
    surface: PatchSurface,
    midstructure: Midstructure,
    w0: float,
    *,
    layers: int = 2,
    degree: int = 3,
    field: HarmonicField | None = None,
) -> dict[str, Any]:
    """What the paper's method makes of a body, valid or not, for a table.

    Parameters
    ----------
    surface : PatchSurface
        Refined as for :func:`HybridVolume.core.pipeline.complete`.
    midstructure : Midstructure
    w0 : float
    layers, degree : int
        Across the shell.
    field : HarmonicField, optional
        From :func:`paper_field`, where it is known from another level.

    Returns
    -------
    dict
        ``elements``, ``valid``, ``invalid``, ``undecided``; ``crossing`` (pairs of triangles of the
        inner surface), ``lost`` (paths that do not reach the isosurface), ``w0`` (area mean of the
        level reached) and ``w0_rms``, ``min_scaled_jacobian``, ``seconds`` (of the processor, those
        of the meshers included) and ``error``: the sentence where there is no field, else empty.
        Figures that are not there are None.
    """
    started = os.times()
    found: dict[str, Any] = dict.fromkeys(
        ("elements", "valid", "invalid", "undecided", "crossing", "lost", "w0", "w0_rms")
        + ("min_scaled_jacobian",)
    )
    found["error"] = ""
    try:
        field = field or paper_field(surface, midstructure)
        shell, lost = _traced_shell(surface, field, w0, layers, degree)
    except HybridVolumeError as error:
        found["error"] = error.line
    else:
        batches = shell.bezier_elements()
        certificate = certify(batches)
        found.update(
            elements=len(certificate),
            valid=certificate.valid,
            invalid=certificate.invalid,
            undecided=certificate.undecided,
            crossing=_crossings(shell)[0],
            lost=len(lost),
            w0=shell.w0,
            w0_rms=shell.w0_rms,
            min_scaled_jacobian=float(scaled_jacobian(batches).min()),
        )
    found["seconds"] = sum(os.times()[:4]) - sum(started[:4])
    return found


# --------------------------------------------------------------------------- paths and levels


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
        slope = np.maximum(np.linalg.norm(gradient, axis=1), np.finfo(float).tiny)
        step = share[active] * np.clip(gap / slope, -longest, longest)
        x[active] += (step / slope)[:, None] * gradient
    return x, active


def _traced_shell(
    surface: PatchSurface, field: HarmonicField, w0: float, layers: int, degree: int
) -> tuple[Shell, np.ndarray]:
    """The shell as the paths give it, and the control points whose paths are lost."""
    paths, lost = trace_paths(surface, field, w0)
    knots = bspline.clamped_knots(degree, layers)
    shell = _swept(surface, field, paths, _levels(surface, field, paths, w0, degree, knots), knots)
    inner = shell.inner_surface().triangulation("greville").vertices
    w, _, _ = field.evaluate(inner)
    area = column_frame(surface).area
    area = area / area.sum()
    mean = float(area @ w)
    return replace(
        shell,
        w0_asked=float(w0),
        w0=mean,
        w0_rms=float(np.sqrt(area @ (w - mean) ** 2)),
        level=w,
        goal=np.full(len(w), float(w0)),
        notes=("made by the paper's own method; its field is that of the control net",),
    ), lost


def _swept(
    surface: PatchSurface,
    field: HarmonicField,
    paths: np.ndarray,
    levels: np.ndarray,
    knots: np.ndarray,
) -> Shell:
    """The shell whose control points stand where the paths pass some levels (Eq. 3)."""
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


def _levels(
    surface: PatchSurface,
    field: HarmonicField,
    paths: np.ndarray,
    w0: float,
    degree: int,
    knots: np.ndarray,
) -> np.ndarray:
    """The set W: one for all paths, such that the layers have equal volumes, (nw,)."""
    count = len(knots) - degree - 1
    best, least = w0 * np.arange(count) / (count - 1), np.inf
    breaks = bspline.breakpoints(knots)
    triangles, _ = control_net(surface)
    volume = np.array([enclosed_volume(x, triangles) for x in paths])
    taken = (volume[0] - volume) / (volume[0] - volume[-1])
    if len(breaks) == 2 or not (np.diff(taken) > 0.0).all():
        return best
    # the control nets tell the volume below a level well enough to begin with; then the elements do
    below = PchipInterpolator(taken, w0 * np.arange(len(paths)) / (len(paths) - 1))
    splines = bspline.basis_matrix(degree, knots, breaks[1:-1]).toarray()
    wanted = breaks.copy()
    for _ in range(ROUNDS_OF_LEVELS):
        levels = _smoothest(splines, below(wanted[1:-1]) / w0)
        if levels is None:
            break
        sizes = _swept(surface, field, paths, w0 * levels, knots).element_volumes()
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
    return best


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


# ------------------------------------------------------------------------------ what is refused


def _crossings(shell: Shell) -> tuple[int, np.ndarray]:
    """Pairs of triangles of the inner surface that cross, and their patches.

    Grids on which the outer surface's own coarse triangles cross tell nothing.
    """
    inner = shell.inner_surface()
    found, patches = 0, np.zeros(0, dtype=int)
    for cells in GRIDS:
        outer = shell.surface.triangulation(cells)
        if cells != GRIDS[-1] and len(self_intersections(outer.vertices, outer.triangles)):
            continue
        mesh = inner.triangulation(cells)
        pairs = self_intersections(mesh.vertices, mesh.triangles)
        found = max(found, len(pairs))
        patches = np.union1d(patches, mesh.triangle_patch[pairs.ravel()])
    return found, patches


def _refuse(shell: Shell, certificate: Certificate, lost: np.ndarray) -> None:
    """Refuse a shell whose elements are not all proved, or that does not reach its level.

    Raises
    ------
    ThicknessError
    """
    surface, w0 = shell.surface, shell.w0_asked
    if not certificate.all_valid:
        bad = certificate.status < 1
        spans = np.unique(certificate.element[bad] // shell.layer_count)
        raise ThicknessError(
            f"{int(bad.sum())} of {len(certificate)} elements that the paper's method makes at"
            f" w0 = {w0:.3g} are not proved valid ({certificate.invalid} are proved inverted)",
            faces=_faces(surface, certificate.patch[bad]),
            figure=float(bad.sum()),
            remedy=REMEDY,
            places=_element_places(surface, spans),
        )
    if len(lost):
        patches = [k for k, p in enumerate(surface.patches) if np.isin(p.index, lost).any()]
        raise ThicknessError(
            f"{len(lost)} of {len(surface.control_points)} paths do not reach w0 = {w0:.3g}",
            faces=_faces(surface, np.array(patches)),
            figure=float(len(lost)),
            remedy=REMEDY,
        )


def _faces(surface: PatchSurface, patches: np.ndarray) -> list[str]:
    names = {surface.patches[k].face for k in np.unique(patches)}
    return sorted(names, key=lambda name: (len(name), name))


def _element_places(surface: PatchSurface, elements: np.ndarray) -> list[Place]:
    """Middles of some knot spans."""
    places = []
    for group in surface.groups:
        for row in np.flatnonzero(np.isin(group.element, elements)):
            u, v = 0.5 * (group.low[row] + group.high[row])
            point = surface.evaluate(group.patch[row], np.array([u]), np.array([v]))[0]
            face = surface.patches[group.patch[row]].face
            what = "element not proved valid"
            places.append(Place(face, float(u), float(v), tuple(map(float, point)), what))
    return places[:MOST_PLACES]


def _net_places(
    surface: PatchSurface, triangles: np.ndarray, patch: np.ndarray, crossing: np.ndarray
) -> list[Place]:
    """Places on the surface over the first corners of some triangles of the control net."""
    places = []
    for k in crossing[:MOST_PLACES]:
        p = surface.patches[patch[k]]
        i, j = np.argwhere(p.index == triangles[k, 0])[0]
        u, v = (
            float(bspline.greville(d, t)[n])
            for d, t, n in zip(p.degrees, p.knots, (i, j), strict=True)
        )
        point = surface.evaluate(patch[k], np.array([u]), np.array([v]))[0]
        what = "control net cuts itself"
        places.append(Place(p.face, u, v, tuple(map(float, point)), what))
    return places
