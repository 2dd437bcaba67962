# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Refusal of surfaces that no shell can follow, before any work is done on them.

A straight column has one direction d at each place, and the shell on it is valid only where n . d
is positive for the inward normals n of all that meets there. So every knot span needs a direction
with n . d > 0 on all of it. That is proved by Bernstein coefficients (a fold between two samples is
found too), and n . d is not small at samples. Places where the normal itself is zero, corners of
180 degrees and vanishing derivatives, are let pass where everything around them is proved: there a
shell is valid but for these places themselves (:mod:`.singular`).
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from .. import errors
from .bezier import bernstein
from .bound import common_margin, place_numbers
from .cones import most_inward
from .intersection import self_intersections
from .jacobian import halving_matrix
from .singular import (
    HALF_CLASSES,
    NormalNets,
    class_indices,
    normal_nets,
    singular_flags,
)
from .surface import PatchSurface, SurfaceMesh

logger = logging.getLogger(__name__)

MARGIN = 5e-3
"""Smallest n . d at which a direction d counts as inward of a normal n."""
POINTS = 9
"""Samples a direction of every knot span."""
DEPTH = 7
"""Halvings of a knot span that is not proved at once."""
LINE = "the derivative vanishes along a line"
MOST_PLACES = 50
"""So many places an error keeps."""


@dataclass(frozen=True)
class SingularPlaces:
    """Where a surface that passed the check is singular itself.

    Attributes
    ----------
    places : tuple of Place
        One for each point; for a line that of its middle.
    lines : bool
        Whether the normal is zero along whole sides of knot spans somewhere.
    """

    places: tuple[errors.Place, ...] = ()
    lines: bool = False

    @property
    def sentence(self) -> str:
        """What a user should know; empty where there is nothing."""
        if not self.places:
            return ""
        faces = ", ".join(_names(place.face for place in self.places))
        what = "lines or points" if self.lines else "points"
        return (
            f"the surface itself is singular in {what} of {faces}"
            f" ({self.places[0].what}): det J is zero there and proved positive everywhere else"
        )


def check_surface(surface: PatchSurface, *, lines: bool = False) -> SingularPlaces:
    """Refuse patches that no shell can follow: folded, singular, or without an inward direction.

    Parameters
    ----------
    surface : PatchSurface
    lines : bool
        Also let normals pass that are zero along a whole side of a knot span, not in corners only.

    Returns
    -------
    SingularPlaces
        Singular corners (and lines) of the surface that the shell will have to keep.

    Raises
    ------
    SingularSurfaceError
        Naming the faces; its ``places`` say where on them.
    """
    found = _Findings(surface)
    flags = np.zeros((surface.element_count, 3, 3), dtype=bool)
    for nets in normal_nets(surface):
        own = singular_flags(nets)
        flags[nets.group.element] = own
        _check_spans(found, nets, own, lines)
    _check_meeting(found, flags)
    kept = _kept(surface, flags)
    if found.places:
        # whoever rebuilds the faces should know about these as well
        found.places += [(0.0, place) for place in kept.places]
        raise found.error()
    if kept.places:
        logger.warning("%s", kept.sentence)
    return kept


def check_uncut(surface: PatchSurface) -> None:
    """Refuse a body whose surface cuts itself.

    Parameters
    ----------
    surface : PatchSurface

    Raises
    ------
    SelfIntersectionError
        Naming the faces; its ``places`` say where.
    """
    # coarse triangles of a thin or sharp part may cut each other although the surface does not
    for cells in (2, 4, 8, 16):
        mesh = surface.triangulation(cells)
        pairs = self_intersections(mesh.vertices, mesh.triangles)
        if not len(pairs):
            return
    names = _names(surface.patches[k].face for k in mesh.triangle_patch[pairs.ravel()])
    raise errors.SelfIntersectionError(
        f"the surface cuts itself in {len(pairs)} places",
        faces=names,
        figure=float(len(pairs)),
        remedy="repair the body",
        places=_cuts(surface, mesh, pairs),
    )


def _cuts(surface: PatchSurface, mesh: SurfaceMesh, pairs: np.ndarray) -> list[errors.Place]:
    """Middles of triangles that cross others, far enough from each other."""
    found: list[tuple[float, errors.Place]] = []
    for triangle in np.unique(pairs):
        patch = mesh.triangle_patch[triangle]
        rows, columns = np.nonzero(np.isin(mesh.grids[patch], mesh.triangles[triangle]))
        uv = np.array([[mesh.grid_u[patch][rows].mean(), mesh.grid_v[patch][columns].mean()]])
        point = surface.evaluate(patch, uv[:, 0], uv[:, 1])[0]
        found.append((0.0, _place(surface, patch, uv[0], point, "cuts another part")))
        if len(found) == 40 * MOST_PLACES:
            break
    return _distinct(found, 0.02 * surface.diagonal)[:MOST_PLACES]


class _Findings:
    """Places that are refused, each with how bad it is."""

    def __init__(self, surface: PatchSurface) -> None:
        self.surface = surface
        self.places: list[tuple[float, errors.Place]] = []
        self.spans: set[int] = set()
        self.meeting = np.inf
        self.sharpest = ""
        self.only_lines = True

    def add(
        self, patch: int, uv: np.ndarray, what: str, badness: np.ndarray, spans: Sequence[int] = ()
    ) -> None:
        """Note places (m, 2) of a patch; of those close together the worst stays."""
        points = self.surface.evaluate(patch, uv[:, 0], uv[:, 1])
        for k in np.argsort(badness, kind="stable")[: 4 * MOST_PLACES]:
            place = _place(self.surface, patch, uv[k], points[k], what)
            self.places.append((float(badness[k]), place))
        self.spans.update(int(s) for s in spans)
        self.only_lines &= what == LINE

    def error(self) -> errors.SingularSurfaceError:
        """The refusal: the worst places, no two of a face next to each other."""
        kept = _distinct(self.places, 0.02 * self.surface.diagonal)
        faces = _names(place.face for _, place in self.places)
        first: dict[str, errors.Place] = {}
        for place in kept:
            first.setdefault(place.face, place)
        told = "; ".join(f"{p.what} at {p.where} of {p.face}" for p in list(first.values())[:3])
        if self.spans:
            count = len(self.spans)
            what = (
                f"{count} knot {'span is' if count == 1 else 'spans are'} folded or singular, no"
                f" shell can follow them ({told})"
            )
            figure, remedy = count, "rebuild these faces with a regular parametrisation"
            if self.only_lines:
                remedy += ", or let singular lines pass (--singular-lines)"
        else:
            x, y, z = kept[0].point
            what = (
                f"no direction is inward for all faces that meet (at ({x:.4g}, {y:.4g}, {z:.4g}) mm"
                f" {self.sharpest}the best n . d is {self.meeting:.2g}; {told})"
            )
            figure, remedy = self.meeting, "open the corner or split the body there"
        return errors.SingularSurfaceError(
            what, faces=faces, figure=float(figure), remedy=remedy, places=kept[:MOST_PLACES]
        )


def _check_spans(found: _Findings, nets: NormalNets, flags: np.ndarray, lines: bool) -> None:
    """Every knot span needs one inward direction, proved on all of it."""
    inward = -nets.coefficients
    size = np.sqrt(np.einsum("eabc,eabc->eab", inward, inward))
    largest = size.max(axis=(1, 2))
    direction = inward.sum(axis=(1, 2))
    direction /= np.maximum(np.linalg.norm(direction, axis=1, keepdims=True), 1e-300)
    along = np.einsum("eabc,ec->eab", inward, direction)
    least = along.min(axis=(1, 2)) - nets.error
    proved = least > MARGIN * largest
    rows = np.flatnonzero(~proved)
    if not len(rows):
        return
    x = np.linspace(0.0, 1.0, POINTS)
    tables = [bernstein(n - 1, x) for n in inward.shape[1:3]]
    values = np.einsum("ai,bj,eijc->eabc", *tables, inward[rows])
    length = np.linalg.norm(values, axis=3)
    counts = (length > 1e-6 * largest[rows, None, None]).reshape(len(rows), -1)
    unit = (values / np.maximum(length, 1e-300)[..., None]).reshape(len(rows), -1, 3)
    counts[~counts.any(axis=1)] = True
    direction = most_inward(unit, counts)
    cosine = np.where(counts, np.einsum("eki,ei->ek", unit, direction), np.inf)
    for k, row in enumerate(rows):
        uv, badness, kind = _bad_places(nets, row, flags[row], direction[k], cosine[k], x, lines)
        if len(uv):
            group = nets.group
            place = group.low[row] + uv * (group.high[row] - group.low[row])
            found.add(int(group.patch[row]), place, kind, badness, [group.element[row]])


def _bad_places(
    nets: NormalNets,
    row: int,
    flags: np.ndarray,
    direction: np.ndarray,
    cosine: np.ndarray,
    x: np.ndarray,
    lines: bool,
) -> tuple[np.ndarray, np.ndarray, str]:
    """Places (m, 2) in a span's own parameters that are refused, how bad, and what they are."""
    edges = [(0, 1), (2, 1), (1, 0), (1, 2)]
    sides = [flags[e] for e in edges]
    if any(sides) and not lines:
        middle = np.array([[0.0, 0.5], [1.0, 0.5], [0.5, 0.0], [0.5, 1.0]])[sides]
        return middle, np.full(len(middle), -2.0), LINE
    if cosine.min() <= MARGIN:
        bad = np.flatnonzero(cosine <= MARGIN)
        uv = np.column_stack([x[bad // len(x)], x[bad % len(x)]])
        return uv, cosine[bad], "the normal turns over"
    uv, value = unproved_places(
        -(nets.coefficients[row] @ direction), float(nets.error[row]), flags
    )
    largest = np.abs(nets.coefficients[row]).max()
    if not len(uv):
        return uv, value, ""
    if value.min() < -1e-6 * largest:
        return uv, value / largest, "the normal turns over"
    return uv, value / largest, "the derivative vanishes"


def unproved_places(
    coefficients: np.ndarray, error: float, flags: np.ndarray, depth: int = DEPTH
) -> tuple[np.ndarray, np.ndarray]:
    """Where a polynomial on the unit square is not proved positive.

    Parameters
    ----------
    coefficients : (n1, n2) array
        Bernstein coefficients.
    error : float
        No coefficient is wrong by more.
    flags : (3, 3) bool array
        Corners and sides where the polynomial may be zero, as of
        :func:`HybridVolume.core.singular.singular_flags`.
    depth : int
        Most halvings.

    Returns
    -------
    places : (m, 2) array
        Corners of boxes with a value that is not positive, or middles of boxes that stay open.
    values : (m,) array
        The polynomial there.
    """
    shape = coefficients.shape
    classes = [class_indices(n) for n in shape]
    halves = [halving_matrix(n - 1) for n in shape]
    corners = np.array([[0.0, 0.0], [0.0, 1.0], [1.0, 0.0], [1.0, 1.0]])
    boxes, low, width = coefficients[None], np.zeros((1, 2)), 1.0
    marks = flags[None]
    places, values = [np.zeros((0, 2))], [np.zeros(0)]
    for level in range(depth + 1):
        mask = marks[:, classes[0]][:, :, classes[1]]
        watched = np.where(mask, np.inf, boxes)
        open_ = ~(watched.min(axis=(1, 2)) > error)
        boxes, low, marks, watched = boxes[open_], low[open_], marks[open_], watched[open_]
        if not len(boxes):
            break
        ends = watched[:, [0, 0, -1, -1], [0, -1, 0, -1]]
        bad, which = np.nonzero(ends <= -error)
        places.append(low[bad] + width * corners[which])
        values.append(ends[bad, which])
        if len(bad):
            # a fold is a fold: only its surroundings are still of interest
            break
        if level == depth:
            places.append(low + 0.5 * width)
            values.append(boxes[:, shape[0] // 2, shape[1] // 2])
            break
        if len(boxes) > 4096:
            boxes, low, marks = boxes[:4096], low[:4096], marks[:4096]
        children = np.einsum("ai,bj,eij->eab", *halves, boxes)
        children = children.reshape(-1, 2, shape[0], 2, shape[1]).swapaxes(2, 3)
        boxes = children.reshape(-1, *shape)
        width *= 0.5
        steps = width * np.array([[[0.0, 0.0], [0.0, 1.0]], [[1.0, 0.0], [1.0, 1.0]]])
        low = (low[:, None, None] + steps).reshape(-1, 2)
        marks = marks[:, HALF_CLASSES][:, :, :, HALF_CLASSES].swapaxes(2, 3).reshape(-1, 3, 3)
    return np.concatenate(places), np.concatenate(values)


def _check_meeting(found: _Findings, flags: np.ndarray) -> None:
    """At every place of a side or corner one direction must be inward for all that meets there."""
    surface = found.surface
    x = np.linspace(0.0, 1.0, POINTS)
    _, x_u, x_v = surface.element_samples(x, x).surface(surface.control_points)
    normals = -np.cross(x_u, x_v)
    size = np.linalg.norm(normals, axis=1).reshape(-1, POINTS**2)
    counts = (size > 1e-6 * size.max(axis=1, keepdims=True)).ravel()
    place, count = place_numbers(surface, POINTS)
    place = place.ravel()
    used, number = np.unique(place[counts], return_inverse=True)
    number = number.reshape(-1)
    unit = normals[counts] / size.ravel()[counts, None]
    _, margin = common_margin(unit, number, len(used))
    stuck = np.flatnonzero(margin <= MARGIN)
    if not len(stuck):
        return
    worst = stuck[int(margin[stuck].argmin())]
    if margin[worst] < found.meeting:
        found.meeting = float(margin[worst])
        own = np.flatnonzero(number == worst)
        patches = surface.element_patch[np.flatnonzero(counts)[own] // POINTS**2]
        found.sharpest = _angle_of_two(unit[own], patches, found.meeting, surface)
    value = np.full(count, np.inf)
    value[used[stuck]] = margin[stuck]
    rows = np.flatnonzero(np.isfinite(value[place]))
    element, sample = np.divmod(rows, POINTS**2)
    low, high, patch = _spans(surface)
    own = np.column_stack([x[sample // POINTS], x[sample % POINTS]])
    uv = low[element] + own * (high - low)[element]
    what = "no inward direction"
    for k in np.unique(patch[element]):
        mine = patch[element] == k
        found.add(int(k), uv[mine], what, value[place[rows[mine]]])


def _angle_of_two(
    unit: np.ndarray, patches: np.ndarray, margin: float, surface: PatchSurface
) -> str:
    """The angle between two faces where it leaves no room; nothing where it takes more faces.

    Two planes that meet at an angle leave a direction with n . d = sin(angle / 2), inside as
    well as outside of the material.
    """
    a, b = np.unravel_index(int((unit @ unit.T).argmin()), (len(unit), len(unit)))
    half = 0.5 * float(np.linalg.norm(unit[a] + unit[b]))
    if abs(half - margin) > 1e-3 * MARGIN:
        return ""
    names = _names(surface.patches[patches[k]].face for k in (a, b))
    who = " and ".join(names) + (" meet" if len(names) > 1 else " meets itself")
    return f"{who} at an angle of {np.degrees(2.0 * np.arcsin(half)):.2g} degrees, "


def _spans(surface: PatchSurface) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners of all knot spans in their patch's parameters, and their patch."""
    low, high = np.zeros((surface.element_count, 2)), np.zeros((surface.element_count, 2))
    for group in surface.groups:
        low[group.element], high[group.element] = group.low, group.high
    return low, high, surface.element_patch


def _kept(surface: PatchSurface, flags: np.ndarray) -> SingularPlaces:
    """Singular corners and sides, each once."""
    low, high, patch = _spans(surface)
    sides = np.array([[0, 1], [2, 1], [1, 0], [1, 2]])
    corners = np.array([[0, 0], [0, 2], [2, 0], [2, 2]])
    found: list[tuple[float, errors.Place]] = []
    for which in (sides, corners):
        element, k = np.nonzero(flags[:, which[:, 0], which[:, 1]])
        for e, entry in zip(element, which[k], strict=True):
            if which is corners and _on_side(flags[e], entry):
                continue
            uv = low[e] + 0.5 * entry * (high[e] - low[e])
            x, x_u, x_v = (a[0] for a in surface.evaluate(patch[e], uv[:1], uv[1:], 1))
            lengths = sorted(np.linalg.norm([x_u, x_v], axis=1) * (high[e] - low[e]))
            flat = lengths[0] > 1e-6 * lengths[1]
            what = "a corner of 180 degrees" if flat else "the derivative vanishes"
            found.append((0.0, _place(surface, patch[e], uv, x, what)))
    kept = _distinct(found, 1e-6 * surface.diagonal)
    return SingularPlaces(tuple(kept), bool(flags[:, sides[:, 0], sides[:, 1]].any()))


def _place(
    surface: PatchSurface, patch: int, uv: np.ndarray, point: np.ndarray, what: str
) -> errors.Place:
    """A place (u, v) on a patch as one on its face."""
    face = surface.patches[patch].face
    at: list[float | None] = [None, None]
    # parameters of one of many patches say nothing about the face
    if sum(other.face == face for other in surface.patches) == 1:
        at = surface.face_parameters(patch, uv[None])[0].tolist()
    return errors.Place(face, *at, tuple(point.tolist()), what)


def _on_side(flags: np.ndarray, corner: np.ndarray) -> bool:
    i, j = corner
    return bool(flags[i, 1] or flags[1, j])


def _distinct(found: list[tuple[float, errors.Place]], distance: float) -> list[errors.Place]:
    """The places from the worst on, without those of a face that are near a worse one."""
    kept: list[errors.Place] = []
    points: dict[str, list[np.ndarray]] = {}
    for _, place in sorted(found, key=lambda item: item[0]):
        near = points.setdefault(place.face, [])
        x = np.array(place.point)
        if all(np.linalg.norm(x - other) > distance for other in near):
            near.append(x)
            kept.append(place)
    return kept


def _names(names: Sequence[str]) -> list[str]:
    return sorted(set(names), key=lambda name: (len(name), name))
