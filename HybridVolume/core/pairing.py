# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Which sides of the faces meet, and why a side has no partner."""

from __future__ import annotations

from collections.abc import Hashable, Iterable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from .. import errors
from . import bspline
from .surface import SIDE_DIRECTION, SplineFace, side_of

_SAMPLES = np.array([0.0, 0.2, 0.4, 0.5, 0.6, 0.8, 1.0])


@dataclass
class Net:
    """A face on its way to a patch: homogeneous coordinates, knots on [0, 1]."""

    name: str
    degrees: list[int]
    knots: list[np.ndarray]
    points: np.ndarray
    weights: np.ndarray
    exact: bool

    def refine(self, direction: int, matrix: np.ndarray) -> None:
        """Apply an exact refinement matrix along one direction."""
        homogeneous = np.concatenate(
            [self.points * self.weights[..., None], self.weights[..., None]], axis=-1
        )
        axes = ([1], [direction])
        raised = np.moveaxis(np.tensordot(matrix, homogeneous, axes), 0, direction)
        self.weights = raised[..., 3]
        self.points = raised[..., :3] / raised[..., 3:]
        self.exact = True

    def side_points(self, side: int, t: np.ndarray) -> np.ndarray:
        """Points of a side's curve."""
        direction = SIDE_DIRECTION[side]
        basis = bspline.basis_matrix(self.degrees[direction], self.knots[direction], t)
        w = side_of(self.weights, side)[:, None]
        return (basis @ (side_of(self.points, side) * w)) / (basis @ w)


@lru_cache(maxsize=1024)
def _cleaned_knots(degree: int, given: bytes, size: int) -> np.ndarray | tuple[str, str]:
    """Knots on [0, 1], or what is wrong with them and what to do.

    Parameters
    ----------
    degree : int
    given : bytes
        Of the knots as float64.
    size : int
        Number of control points.
    """
    raw = np.frombuffer(given)
    if len(raw) != size + degree + 1 or np.any(np.diff(raw) < 0):
        return (
            f"{len(raw)} knots do not fit {size} control points of degree {degree}",
            "repair the file",
        )
    span = raw[-1] - raw[0]
    if span <= 0 or np.any(raw[: degree + 1] != raw[0]) or np.any(raw[-degree - 1 :] != raw[-1]):
        return "the knots are not clamped", "export clamped NURBS"
    unit = raw if raw[0] == 0.0 and raw[-1] == 1.0 else (raw - raw[0]) / span
    # knots that differ by rounding only are one knot
    close = np.concatenate([[False], np.diff(unit) < bspline.KNOT_TOLERANCE])
    while np.any(close & (unit != np.concatenate([[unit[0]], unit[:-1]]))):
        unit = np.where(close, np.concatenate([[unit[0]], unit[:-1]]), unit)
    unit = unit.copy()
    unit[-degree - 1 :] = 1.0
    torn = bspline.torn_knots(degree, unit)
    if len(torn):
        return f"the face is torn at the inner knot {torn[0]:.6g}", "split the face there"
    # many faces share it
    unit.setflags(write=False)
    return unit


def _unit_knots(name: str, degree: int, given: bytes, size: int) -> np.ndarray:
    found = _cleaned_knots(degree, given, size)
    if isinstance(found, tuple):
        raise errors.InputError(found[0], faces=[name], remedy=found[1])
    return found


def make_net(face: SplineFace) -> Net:
    """Check a face's arrays and bring its knots to [0, 1].

    Raises
    ------
    InputError
        Knots that do not fit or are not clamped, torn faces, weights that are not positive.
    """
    knots = [
        _unit_knots(
            face.name, face.degrees[d], np.asarray(face.knots[d], dtype=float).tobytes(), size
        )
        for d, size in enumerate(face.control_points.shape[:2])
    ]
    weights = np.asarray(face.weights, dtype=float)
    points = np.asarray(face.control_points, dtype=float)
    if not (np.all(np.isfinite(points)) and np.all(np.isfinite(weights))):
        raise errors.InputError(
            "control points or weights are not finite", faces=[face.name], remedy="repair the file"
        )
    if np.any(weights <= 0):
        raise errors.InputError(
            f"weight {weights.min():.3g} is not positive",
            faces=[face.name],
            figure=float(weights.min()),
            remedy="export NURBS with positive weights",
        )
    return Net(face.name, list(face.degrees), knots, points, weights, face.exact)


def check_sides(nets: list[Net], gap: float) -> None:
    """Refuse sides without length (DegenerateSideError); ``gap`` in mm."""
    degenerate = []
    for members in _same(net.weights.shape for net in nets):
        points = np.stack([nets[k].points for k in members])
        flat = np.zeros(len(members), dtype=bool)
        for side in (points[:, 0], points[:, -1], points[:, :, 0], points[:, :, -1]):
            flat |= np.linalg.norm(np.ptp(side, axis=1), axis=1) <= gap
        degenerate += [nets[members[k]].name for k in np.flatnonzero(flat)]
    if degenerate:
        raise errors.DegenerateSideError(
            "a side has no length (a pole)",
            faces=natural_order(set(degenerate)),
            remedy="split the face so that every patch has four sides",
        )


def pair_sides(nets: list[Net], gap: float) -> tuple[np.ndarray, np.ndarray]:
    """Find the partner of every side.

    Parameters
    ----------
    nets : list of Net
    gap : float
        Largest distance of sides that meet, mm.

    Returns
    -------
    partner : (np, 4, 2) int array
        Patch and side.
    reverse : (np, 4) bool array
        Whether the partner runs the other way.

    Raises
    ------
    NonManifoldError, SeamError, TJunctionError, GapError, OpenBodyError
    """
    samples = _side_samples(nets, _SAMPLES)
    middle = samples[:, len(_SAMPLES) // 2]
    tree = cKDTree(middle)
    pairs = tree.query_pairs(4.0 * gap, output_type="ndarray")
    same = np.abs(samples[pairs[:, 0]] - samples[pairs[:, 1]]).max(axis=(1, 2))
    turned = np.abs(samples[pairs[:, 0]] - samples[pairs[:, 1], ::-1]).max(axis=(1, 2))
    meets = np.minimum(same, turned) <= gap
    pairs, turned = pairs[meets], (turned < same)[meets]
    total = len(samples)
    degree = np.bincount(pairs.ravel(), minlength=total)
    if np.any(degree > 1):
        crowded = sorted({int(s) // 4 for s in np.flatnonzero(degree > 1)})
        raise errors.NonManifoldError(
            f"more than two sides meet in one curve ({int(degree.max()) + 1} sides)",
            faces=[nets[k].name for k in crowded],
            remedy="give solids that are joined in faces, or separate solids",
        )
    own = pairs[:, 0] // 4 == pairs[:, 1] // 4
    if np.any(own):
        raise errors.SeamError(
            "the face meets itself along a side (a seam)",
            faces=[nets[k].name for k in sorted(set((pairs[own, 0] // 4).tolist()))],
            remedy="split the face there",
        )
    if np.any(degree == 0):
        _refuse_lonely(nets, samples, np.flatnonzero(degree == 0), gap)
    partner = np.zeros((total, 2), dtype=int)
    reverse = np.zeros(total, dtype=bool)
    for a, b in ((0, 1), (1, 0)):
        partner[pairs[:, a], 0] = pairs[:, b] // 4
        partner[pairs[:, a], 1] = pairs[:, b] % 4
        reverse[pairs[:, a]] = turned
    return partner.reshape(-1, 4, 2), reverse.reshape(-1, 4)


def _side_samples(nets: list[Net], t: np.ndarray) -> np.ndarray:
    """Points of the curves of all sides, (4 np, samples, 3)."""
    samples = np.empty((len(nets), 4, len(t), 3))
    kinds = ((net.weights.shape, *net.degrees, *(k.tobytes() for k in net.knots)) for net in nets)
    for members in _same(kinds):
        net = nets[members[0]]
        weights = np.stack([nets[k].weights for k in members])
        points = np.stack([nets[k].points for k in members]) * weights[..., None]
        for side in range(4):
            d = SIDE_DIRECTION[side]
            basis = bspline.basis_matrix(net.degrees[d], net.knots[d], t).toarray()
            w, x = (side_of(np.moveaxis(a, 0, 2), side) for a in (weights, points))
            value = np.einsum("tn,nmc->mtc", basis, x)
            samples[members, side] = value / np.einsum("tn,nm->mt", basis, w)[..., None]
    return samples.reshape(-1, len(t), 3)


def _same(kinds: Iterable[Hashable]) -> list[np.ndarray]:
    """Positions of equal things, each kind once."""
    found: dict[Hashable, list[int]] = {}
    for k, kind in enumerate(kinds):
        found.setdefault(kind, []).append(k)
    return [np.array(members) for members in found.values()]


def _refuse_lonely(nets: list[Net], samples: np.ndarray, lonely: np.ndarray, gap: float) -> None:
    """Say why sides have no partner: a T-junction, a gap, another speed, or a hole."""
    names = [nets[s // 4].name for s in lonely]
    curves = [nets[s // 4].side_points(s % 4, np.linspace(0.0, 1.0, 401)) for s in lonely]
    length = np.array([np.linalg.norm(np.diff(c, axis=0), axis=1).sum() for c in curves])
    ends = samples[lonely][:, [0, -1]]
    t_faces: set[str] = set()
    speed: list[tuple[float, str, str]] = []
    gaps: list[tuple[float, str, str]] = []
    low = np.array([c.min(axis=0) for c in curves])
    high = np.array([c.max(axis=0) for c in curves])
    for i in range(len(lonely)):
        # an end of another side in the middle of this one
        spacing = length[i] / 400
        reach = max(gap, spacing)
        close = np.all((ends >= low[i] - reach) & (ends <= high[i] + reach), axis=2).any(axis=1)
        close[i] = False
        others = np.flatnonzero(close)
        if len(others):
            tree = cKDTree(curves[i])
            away, place = tree.query(ends[others])
            inside = (away <= reach) & (np.minimum(place, 400 - place) > 4)
            for other in others[inside.any(axis=1)]:
                along, _ = tree.query(curves[other])
                if np.median(along) <= reach:
                    t_faces |= {names[i], names[other]}
            if inside.any():
                continue
        straight = np.linalg.norm(ends - ends[i], axis=2).max(axis=1)
        turned = np.linalg.norm(ends - ends[i, ::-1], axis=2).max(axis=1)
        near = np.minimum(straight, turned) <= 0.05 * np.minimum(length[i], length)
        near[: i + 1] = False
        for j in np.flatnonzero(near):
            other = curves[j] if straight[j] <= turned[j] else curves[j][::-1]
            pointwise = float(np.linalg.norm(curves[i] - other, axis=1).max())
            if pointwise > 0.25 * length[i]:
                continue
            if pointwise > 10.0 * max(gap, _polyline_distance(curves[i], other)):
                speed.append((pointwise, names[i], names[j]))
            else:
                gaps.append((pointwise, names[i], names[j]))
    if t_faces:
        raise errors.TJunctionError(
            "a side is shared by two neighbours (T-junction)",
            faces=natural_order(t_faces),
            remedy="split the longer side's face at the vertex",
        )
    for found, what in ((gaps, "side gap"), (speed, "the sides run at different speed, off by")):
        if found:
            worst = max(found)
            raise errors.GapError(
                f"{what} {worst[0]:.2g} mm exceeds {gap:.2g} mm",
                faces=natural_order({n for _, a, b in found for n in (a, b)}),
                figure=worst[0],
                remedy="heal the body or raise --tolerance",
            )
    raise errors.OpenBodyError(
        f"the body is open: {len(lonely)} sides have no neighbour",
        faces=natural_order(set(names)),
        remedy="give a closed solid",
    )


def _polyline_distance(line: np.ndarray, points: np.ndarray) -> float:
    """Largest distance of points from a polyline."""
    _, nearest = cKDTree(line).query(points)
    best = np.full(len(points), np.inf)
    for shift in (-1, 0):
        start = np.clip(nearest + shift, 0, len(line) - 2)
        a, chord = line[start], line[start + 1] - line[start]
        square = np.maximum(np.einsum("ij,ij->i", chord, chord), 1e-300)
        share = np.clip(np.einsum("ij,ij->i", points - a, chord) / square, 0.0, 1.0)
        away = np.linalg.norm(points - a - share[:, None] * chord, axis=1)
        best = np.minimum(best, away)
    return float(best.max())


def natural_order(names: set[str]) -> list[str]:
    """Names with Face9 before Face10."""
    return sorted(names, key=lambda name: (len(name), name))
