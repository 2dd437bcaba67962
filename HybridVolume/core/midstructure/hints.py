# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What a choice of sheets will do to the shell, told at once and without a harmonic field."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .sheets import Midstructure

# What stands for lines and points of the midstructure in the harmonic field: balls of about this
# share of the distance to the surface. Parts nearer to each other than that are one.
BALL = 0.25
# Facets larger than this are divided, in thin half thicknesses of the body.
_SPACING = 0.25
# About the most samples of divided facets.
_MOST = 30_000
# A sheet covers at least this share of the square of its radius within half its radius, even in a
# corner of its rim; what covers less is a line, or a point where nothing else is near.
_SHEET = 0.08
# Places at which the kind is found out; the others take that of the nearest one.
_ASKED = 400
_NEIGHBOURS = 64
# Power of the covered share of the disc with which w rises towards a rim, fitted to fields.
_RIM = 0.35
# Uphill: where the body is thicker by this factor within its own thickness.
_GROWTH = 1.1
_AROUND = 24
# Nothing kept within so many half thicknesses of the thickest place uphill: not reached. The
# corners of a box are √3 away, the tip of a 60 degree edge 2.
_REACH = 2.5
# Fewer probes are no region, nor is a smaller share of the surface that is no good share of any
# face.
_FEWEST = 3
_LARGE = 0.02
# Smallest share of a face's own probes by which it belongs to a region.
_FACE_SHARE = 0.2


@dataclass(frozen=True)
class Unreached:
    """A part of the body without any midstructure.

    Attributes
    ----------
    faces : tuple of str
        The CAD faces around it.
    share : float
        Of the surface's probes.
    distance : float
        Largest distance to what is kept, mm.
    """

    faces: tuple[str, ...]
    share: float
    distance: float

    def __str__(self) -> str:
        shown = ", ".join(self.faces[:6])
        more = f" and {len(self.faces) - 6} more" if len(self.faces) > 6 else ""
        return (
            f"nothing kept reaches {shown or 'a part of the surface'}{more}: the shell there "
            "would be as thick as the body"
        )


@dataclass(frozen=True)
class Hints:
    """What a choice does.

    Attributes
    ----------
    pieces : int
        Connected parts of what is kept.
    thinnest, thickest : float
        Of the shell, estimated, mm; 0 where nothing is kept.
    unreached : tuple of Unreached
        Parts of the body without any midstructure, the largest first.
    """

    pieces: int
    thinnest: float
    thickest: float
    unreached: tuple[Unreached, ...]


def hints(midstructure: Midstructure, w0: float = 0.5) -> Hints:
    """Tell what the kept facets will do to the shell.

    Parameters
    ----------
    midstructure : Midstructure
        With probes; without them only the pieces are told.
    w0 : float
        Level of the inner boundary, in (0, 1).

    Returns
    -------
    Hints
        Pieces nearer to each other than a quarter of the body's half thickness count as one.
    """
    probes = midstructure.probe_points
    if not midstructure.kept.any():
        return _nothing(midstructure)
    kept = _Kept(midstructure)
    if probes is None or not len(probes):
        return Hints(kept.pieces(), 0.0, 0.0, ())
    distance, nearest = kept.tree.query(probes)
    thickness = kept.estimated_thickness(distance, nearest, w0)
    regions = _unreached(midstructure, distance)
    return Hints(kept.pieces(), float(thickness.min()), float(thickness.max()), regions)


def _nothing(midstructure: Midstructure) -> Hints:
    half = midstructure.probe_radius
    farthest = 2.0 * float(half.max()) if half is not None and len(half) else 0.0
    faces = tuple(dict.fromkeys(midstructure.faces))
    return Hints(0, 0.0, 0.0, (Unreached(faces, 1.0, farthest),))


class _Kept:
    """Samples of what is kept, and their tree.

    Attributes
    ----------
    points : (k, 3) array
        Corners of the facets, and centres of the facets or of their pieces; mm.
    radius, area : (k,) arrays
        Distance to the surface, mm, and what each sample stands for, mm².
    """

    def __init__(self, midstructure: Midstructure) -> None:
        self._facets = midstructure.facets[midstructure.kept]
        # parts of very many facets are dense enough
        step = max(1, len(self._facets) // _MOST)
        facets = self._facets[::step]
        used, local = np.unique(facets, return_inverse=True)
        local = local.reshape(facets.shape)
        corner, radius = midstructure.vertices[used], midstructure.radius[used]
        half = midstructure.probe_radius
        thin = float(np.quantile(radius if half is None or not len(half) else half, 0.1))
        x = corner[local]
        longest = np.linalg.norm(np.roll(x, 1, axis=1) - x, axis=2).max(axis=1)
        pieces = _pieces_of(longest, _SPACING * max(thin, 1e-3 * float(radius.max())))
        owner, share = _centres(pieces)
        rows = local[owner]
        self.points = np.concatenate([corner, np.einsum("kc,kci->ki", share, corner[rows])])
        self.radius = np.concatenate([radius, np.einsum("kc,kc->k", share, radius[rows])])
        area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)
        area *= step / pieces**2
        self.area = np.concatenate([np.zeros(len(corner)), area[owner]])
        self._vertex = np.concatenate([used, facets[owner, 0]])
        self.tree = cKDTree(self.points, balanced_tree=False, compact_nodes=False)

    def pieces(self) -> int:
        """Number of parts farther from each other than the balls that stand for points."""
        a, b = self._facets[:, [0, 1, 1, 2]].reshape(-1, 2).T
        _, label = _components(int(self._facets.max()) + 1, a, b)
        names, label = np.unique(label[self._vertex], return_inverse=True)
        if len(names) == 1:
            return 1
        label = label.ravel()
        first = np.bincount(label).argmax()
        rest = np.flatnonzero(label != first)
        rest = rest[:: -(-len(rest) // 2000)]
        at, reach = self.points[rest], BALL * self.radius[rest]
        near = cKDTree(self.points[label == first]).query(at)[0] < reach
        around = cKDTree(at).query_ball_point(at, reach)
        one = np.repeat(label[rest], [len(k) for k in around])
        two = label[rest[np.concatenate([np.asarray(k, dtype=np.int64) for k in around])]]
        one = np.concatenate([one, label[rest[near]]])
        two = np.concatenate([two, np.full(int(near.sum()), first)])
        return _components(len(names), one, two)[0]

    def estimated_thickness(
        self, distance: np.ndarray, nearest: np.ndarray, w0: float
    ) -> np.ndarray:
        """Distance from the surface to the level w = w0, about.

        Over a flat wall with a sheet in its middle the level lies at w0 d. Towards a line, w is
        logarithmic, towards a point a reciprocal. In a convex edge of angle a, w goes with the
        power pi / a of the distance from the edge; sin(a / 2) = r / d there, where r is the radius
        of the ball around what is kept. Rims of a sheet draw the level nearer. Compared with the
        field itself, on boxes, brackets, wedges, tubes and free-form bodies, this is within about
        a fifth for the thinnest and the thickest shell, mostly too thin.

        Parameters
        ----------
        distance : (k,) array
            From places of the surface to what is kept, mm.
        nearest : (k,) int array
            The nearest samples.
        w0 : float

        Returns
        -------
        (k,) array
            mm.
        """
        kind, cover = self._kinds(nearest)
        levels = np.array([w0, 1.0 - BALL**w0, 1.0 - 1.0 / (1.0 + w0 * (1.0 / BALL - 1.0))])
        sine = np.clip(self.radius[nearest] / np.maximum(distance, 1e-300), 1e-6, 1.0)
        edge = np.pi / (2.0 * np.arcsin(sine))
        # above the middle of a sheet there is no edge, wherever the nearest surface is
        power = np.where(
            kind == 0, cover**-_RIM * edge ** np.minimum(2.0 * (1.0 - cover), 1.0), edge
        )
        return distance * levels[kind] ** (1.0 / power)

    def _kinds(self, nearest: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What samples lie on, 0 for a sheet, 1 for a line, 2 for a lonely point, and the cover.

        The cover is the share of the disc of half the radius that the sheet takes, in [0.1, 1]: a
        half on a straight rim, a quarter in a corner.
        """
        used, which = np.unique(nearest, return_inverse=True)
        asked = used[:: -(-len(used) // _ASKED)]
        at, radius = self.points[asked], self.radius[asked]
        count = self.tree.query_ball_point(at, 0.5 * radius, return_length=True)
        number = min(_NEIGHBOURS, len(self.points))
        apart, near = self.tree.query(at, k=number)
        apart, near = apart.reshape(-1, number), near.reshape(-1, number)
        within = apart <= 0.5 * radius[:, None]
        mean = (self.area[near] * within).sum(axis=1) / np.maximum(within.sum(axis=1), 1)
        area = count * mean / radius**2
        more = self.tree.query_ball_point(at, radius, return_length=True)
        kind = np.where(area >= _SHEET, 0, np.where(more > count, 1, 2))
        cover = np.clip(area / (0.25 * np.pi), 0.1, 1.0)
        back = cKDTree(at).query(self.points[used])[1][which.ravel()]
        return kind[back], cover[back]


def _pieces_of(longest: np.ndarray, spacing: float) -> np.ndarray:
    """Pieces along each side into which facets are cut, not too many altogether."""
    while True:
        pieces = np.maximum(np.ceil(longest / spacing), 1.0)
        if (pieces[pieces > 1.0] ** 2).sum() <= _MOST:
            return pieces.astype(np.int64)
        spacing *= 1.25


def _centres(pieces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Facet and barycentric coordinates of the centres of all pieces, (k,) and (k, 3)."""
    owner, share = [], []
    for n in np.unique(pieces):
        i, j = (x.ravel() for x in np.indices((n, n)))
        upright = i + j < n
        # the upright triangles of the lattice, then those upside down
        a = np.concatenate([i[upright] + 1 / 3, i[i + j < n - 1] + 2 / 3]) / n
        b = np.concatenate([j[upright] + 1 / 3, j[i + j < n - 1] + 2 / 3]) / n
        mine = np.flatnonzero(pieces == n)
        owner.append(np.repeat(mine, len(a)))
        share.append(np.tile(np.column_stack([1.0 - a - b, a, b]), (len(mine), 1)))
    return np.concatenate(owner), np.concatenate(share)


def _components(count: int, one: np.ndarray, two: np.ndarray) -> tuple[int, np.ndarray]:
    ones = np.ones(len(one), dtype=np.int8)
    graph = coo_matrix((ones, (one, two)), shape=(count, count))
    return connected_components(graph, directed=False)


def _unreached(midstructure: Midstructure, distance: np.ndarray) -> tuple[Unreached, ...]:
    """Parts of the surface whose part of the body has nothing kept in it.

    The tip of a wedge is far from what is kept in units of its own thickness, and is still no
    part of its own: the body grows steadily thicker towards what is kept. So every far probe
    climbs to where the body is thicker as long as it is, and what is kept must be near the summit.
    """
    points = midstructure.probe_points
    tree = cKDTree(points)
    number = min(_AROUND, len(points))
    apart, near = (x.reshape(len(points), number) for x in tree.query(points, k=number))
    # probes at the very tip of a wedge see the thickness of other places: the lower quarter counts
    half = np.sort(midstructure.probe_radius[near[:, :9]], axis=1)[:, min(2, number - 1)]
    far = np.flatnonzero(distance > _REACH * half)
    if not len(far):
        return ()
    # where the body is thinner than the probes are apart, the next ones are looked at
    reach = np.maximum(3.0 * half, apart[:, -1])
    at = far
    for _ in range(20):
        here, which = np.unique(at, return_inverse=True)
        around = tree.query_ball_point(points[here], reach[here], return_sorted=False)
        best = np.array([max(near, key=half.__getitem__) for near in around])
        best = np.where(half[best] > _GROWTH * half[here], best, here)
        if (best == here).all():
            break
        at = best[which.ravel()]
    far = far[distance[at] > _REACH * half[at]]
    around = tree.query_ball_point(points[far], reach[far])
    one = np.repeat(far, [len(near) for near in around])
    two = np.concatenate([np.asarray(near, dtype=np.int64) for near in around] or [far])
    inside = np.isin(two, far)
    label = _components(len(points), one[inside], two[inside])[1][far]
    regions = []
    for part in np.unique(label):
        members = far[label == part]
        share = len(members) / len(points)
        faces, clear = _faces(midstructure, members)
        if len(members) >= _FEWEST and (clear or share > _LARGE):
            regions.append(Unreached(faces, share, float(distance[members].max())))
    return tuple(sorted(regions, key=lambda region: -region.share))


def _faces(midstructure: Midstructure, members: np.ndarray) -> tuple[tuple[str, ...], bool]:
    """Faces with a good share of their own probes among these, and whether there are any.

    Otherwise those that have a good share of these probes.
    """
    if midstructure.probe_patch is None or not midstructure.faces:
        return (), False
    names, number = np.unique(np.asarray(midstructure.faces), return_inverse=True)
    number = number.ravel()[midstructure.probe_patch]
    mine = np.bincount(number[members], minlength=len(names))
    every = np.bincount(number, minlength=len(names))
    good = mine >= _FACE_SHARE * np.maximum(every, 1)
    clear = bool(good.any())
    if not clear:
        good = mine >= _FACE_SHARE * len(members)
    found = [str(names[k]) for k in np.flatnonzero(good)]
    return tuple(sorted(found, key=lambda name: (len(name), name))), clear
