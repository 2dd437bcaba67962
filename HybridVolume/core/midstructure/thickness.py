# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How thick the body is at places of its surface, from the largest balls that touch it inside."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from ...errors import FaultError
from .distances import SurfaceDistance
from .samples import Samples, inner_radius

# Places of the surface that are asked.
PLACES = 3000
# Samples that may stop a ball.
BALLS = 12_000
# Cosine between the normals of opposite sides, at most.
OPPOSITE = -0.6
# A ball tells the thickness of the surface within this many of its radii in front of it: the
# corner of a cube is 1.73 radii away.
REACH = 1.8


@dataclass(frozen=True)
class Thickness:
    """Half the local thickness.

    Attributes
    ----------
    points : (k, 3) array
        Places of the surface, mm.
    ball : (k,) array
        Radius of the largest ball that touches there, mm; small beside edges.
    centre : (k, 3) array
        Centres of these balls, mm.
    opposite : (k,) bool array
        Whether the ball touches the opposite side.
    half : (k,) array
        Half the thickness, also beside edges, mm.
    area : (k,) array
        Share of the surface, mm².
    of_sample : (s,) int array
        The place nearest to each sample of the distance.
    """

    points: np.ndarray
    ball: np.ndarray
    centre: np.ndarray
    opposite: np.ndarray
    half: np.ndarray
    area: np.ndarray
    of_sample: np.ndarray


def local_thickness(distance: SurfaceDistance) -> Thickness:
    """Measure the thickness at some thousand samples of a distance."""
    # samples come in order over the elements: every k-th of them is spread as they are
    good = np.flatnonzero(np.einsum("ki,ki->k", distance.normals, distance.normals) > 0.5)
    good = good[:: max(1, len(good) // BALLS)]
    points, normals = distance.samples[good] - distance.origin, distance.normals[good]
    samples = Samples(
        points=points,
        normals=normals,
        patch=distance.sample_patch[good],
        uv=distance.sample_uv[good],
        spacing=np.full(len(points), distance.spacing),
    )
    chosen = np.arange(0, len(points), max(1, len(points) // PLACES))
    limit = float(np.linalg.norm(np.ptp(points, axis=0)))
    ball, touched = inner_radius(samples, chosen, limit)
    facing = np.einsum("ki,ki->k", normals[chosen], normals[touched])
    opposite = (touched >= 0) & (facing < OPPOSITE)
    places, inward = points[chosen], -normals[chosen]
    ball = _shrunk(distance, places, inward, ball)
    centre = places + inward * ball[:, None]
    # a ball that nothing stopped has left the body
    real = (touched >= 0) & (cKDTree(points).query(centre)[0] > 0.9 * ball)
    if not real.any():
        raise FaultError("no ball inside the body was found")

    # one representative, the largest ball, in every cell of a fifth of its radius
    level = np.floor(np.log2(ball)).astype(int)
    cell = np.floor(centre / (0.2 * 2.0**level)[:, None]).astype(np.int64)
    _, label = np.unique(np.column_stack([level, cell]), axis=0, return_inverse=True)
    order = np.lexsort([-ball, label.ravel()])
    order = order[real[order]]
    some = order[np.unique(label.ravel()[order], return_index=True)[1]]
    half = np.where(real, ball, 0.0)
    tree = cKDTree(places)
    for part in np.array_split(some, max(1, len(some) // 200)):
        around = tree.query_ball_point(centre[part], REACH * ball[part])
        owner = np.repeat(part, [len(a) for a in around])
        near = np.concatenate([np.asarray(a, dtype=np.int64) for a in around])
        way = centre[owner] - places[near]
        ahead = np.einsum("ki,ki->k", way, inward[near])
        before = ahead > 0.5 * np.linalg.norm(way, axis=1)
        np.maximum.at(half, near[before], ball[owner[before]])
    half = np.where(opposite & real, ball, half)
    known = np.flatnonzero(half > 0.0)
    half = half[known[cKDTree(places[known]).query(places)[1]]]
    ball = np.where(real, ball, half)
    centre = places + inward * ball[:, None]
    _, of_sample = tree.query(distance.samples - distance.origin)
    area = np.bincount(of_sample, distance.area, len(places))
    return Thickness(
        places + distance.origin, ball, centre + distance.origin, opposite, half, area, of_sample
    )


def _shrunk(
    distance: SurfaceDistance, places: np.ndarray, inward: np.ndarray, ball: np.ndarray
) -> np.ndarray:
    """Balls that are small beside the distance of samples, shrunk until the surface is around."""
    ball = ball.copy()
    active = np.flatnonzero(ball < 6.0 * distance.spacing)
    for _ in range(4):
        centre = places[active] + inward[active] * ball[active, None]
        feet = distance.nearest(centre + distance.origin, candidates=2)
        way = places[active] - (feet.points - distance.origin)
        depth = -np.einsum("ki,ki->k", way, inward[active])
        length2 = np.einsum("ki,ki->k", way, way)
        near = (feet.distance < 0.99 * ball[active]) & (depth > 0.2 * np.sqrt(length2))
        active = active[near]
        if not len(active):
            break
        ball[active] = np.minimum(0.5 * length2[near] / depth[near], 0.99 * ball[active])
    return ball
