# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Random bodies: solids of voxels under random smooth maps, the same for the same seed.

A body is drawn in three steps; what a rule forbids is drawn again.

1. *Voxels*: 2 to 5 a direction; straight tunnels, then voxels, are taken away. Rules: connected and
   manifold at every vertex, the genus that the seed asks for, 16 to 100 voxel faces, no full block,
   and **no vertex at which two faces look in opposite directions**: nothing is inward for both, so
   no shell of straight columns exists there, whatever the program.
2. *Sizes*: every layer of voxels has its own thickness; every third body is pressed flat.
3. *Map*: up to three of shear, taper, twist, bend, wave, polynomial, each one to one; a third of
   the bodies are rational, by an exact arc of a circle, a projective map, or both. Rules: the
   determinant of the map's unit columns is at least .3 at 5³ places of every knot span, and
   weights differ by a factor of ten at most.

Genus, degree and kind go round with the seed, so that any row of seeds has all of them. ``python -m
HybridVolume.reproduce.random_bodies`` prints what is known of the bodies.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from HybridVolume.core.surface import SplineFace

from .voxels import BentGrid, PolynomialMap, bent_grid, faces_one_way, is_manifold, voxel_genus

Map = Callable[[np.ndarray], np.ndarray]

SEEDS = {f"random-{seed:02d}": seed for seed in range(1, 31)}
BODIES = tuple(SEEDS)
"""Names of the thirty bodies."""

GENERA = (0, 1, 0, 2, 1, 3, 1)
"""Genus asked for, by the seed."""
FACES = (16, 100)
"""Voxel faces that a body may have."""
SHAPE = 0.3
"""Least determinant of the map's unit columns."""
WEIGHT = 0.1
"""Least weight, as a share of the largest."""


@dataclass(frozen=True)
class RandomBody:
    """A body with what is known about it from how it was made.

    Attributes
    ----------
    name : str
    voxels : bool array
    maps : tuple of str
        What bends it, in order.
    grid : BentGrid
    faces : tuple of SplineFace
    genus : int
        From the Euler number of the voxels.
    """

    name: str
    voxels: np.ndarray
    maps: tuple[str, ...]
    grid: BentGrid
    faces: tuple[SplineFace, ...]
    genus: int

    @property
    def degrees(self) -> tuple[int, ...]:
        """Of the spline in the three directions."""
        return tuple(line.degree for line in self.grid.lines)

    @property
    def rational(self) -> bool:
        """Whether weights differ."""
        return bool(np.ptp(self.grid.lattice[..., 3]) > 0.0)

    @property
    def spans(self) -> int:
        """Knot spans of all faces."""
        return sum(int(np.prod([len(np.unique(t)) - 1 for t in face.knots])) for face in self.faces)

    @property
    def diagonal(self) -> float:
        """Of the bounding box of the control points, mm."""
        points = np.concatenate([face.control_points.reshape(-1, 3) for face in self.faces])
        return float(np.linalg.norm(np.ptp(points, axis=0)))

    def thinnest(self) -> float:
        """Least straight way through the body along a middle line of solid cells, mm."""
        points, _, _, cell = self.grid.sampled(np.array([0.0, 0.5, 1.0]))
        corners = points.reshape(-1, 3, 3, 3, 3)
        least = np.inf
        for axis in range(3):
            ends = np.moveaxis(corners, 1 + axis, 1)[:, [0, -1], 1, 1]
            order = np.lexsort((cell[:, axis], *(cell[:, k] for k in range(3) if k != axis)))
            # spans of one column of cells follow each other where the end of one is the next start
            for start in order:
                end = start
                gap = np.linalg.norm(ends[:, 0] - ends[end, 1], axis=1)
                if np.linalg.norm(ends[:, 1] - ends[start, 0], axis=1).min() < 1e-9 * self.diagonal:
                    continue
                while gap.min() < 1e-9 * self.diagonal:
                    end = int(gap.argmin())
                    gap = np.linalg.norm(ends[:, 0] - ends[end, 1], axis=1)
                least = min(least, float(np.linalg.norm(ends[end, 1] - ends[start, 0])))
        return least


def build(name: str) -> tuple[SplineFace, ...]:
    """Faces of one of the thirty bodies.

    Parameters
    ----------
    name : str
        One of `BODIES`.
    """
    return random_body(SEEDS[name]).faces


@cache
def random_body(seed: int) -> RandomBody:
    """Draw a body.

    Parameters
    ----------
    seed : int
        Not negative. The thirty bodies have 1 to 30.
    """
    rng = np.random.default_rng([20120308, seed])
    genus = GENERA[seed % len(GENERA)]
    voxels = _voxels(rng, genus)
    planes = _planes(rng, voxels.shape, flat=seed % 3 == 1)
    base = 1 + seed // 2 % 3
    degrees = [base] * 3 if seed % 5 else [int(p) for p in rng.integers(1, 4, 3)]
    rational = seed % 3 == 2
    while True:
        grid, names = _bent(rng, voxels, planes, degrees, rational)
        weights = grid.lattice[..., 3]
        if weights.min() >= WEIGHT * weights.max() and grid.worst_shape() >= SHAPE:
            break
    size = float(rng.choice([1e-3, 1e3]) if seed % 4 == 3 else 10.0 ** rng.uniform(0.0, 1.5))
    grid = _placed(rng, grid, size)
    return RandomBody(f"random-{seed:02d}", voxels, names, grid, grid.faces(), genus)


# ---------------------------------------------------------------------------------------- voxels


def _voxels(rng: np.random.Generator, genus: int) -> np.ndarray:
    """Random voxels of a genus that keep all rules of step 1."""
    while True:
        shape = rng.integers(2, 6, 3)
        if genus and np.sort(shape)[1] < 3:
            continue
        cells = np.ones(shape, dtype=bool)
        for _ in range(genus):
            # inside of the cross section, which must have an inside
            axis = int(rng.choice([k for k in range(3) if np.delete(shape, k).min() > 2]))
            place: list[int | slice] = [int(rng.integers(1, max(n - 1, 2))) for n in shape]
            place[axis] = slice(None)
            cells[tuple(place)] = False
        if not is_manifold(cells) or voxel_genus(cells) != genus:
            continue
        target = rng.uniform(0.3, 0.9) * cells.size
        for flat in rng.permutation(cells.size):
            if cells.sum() <= target:
                break
            place = np.unravel_index(flat, shape)
            if not cells[place]:
                continue
            cells[place] = False
            if not is_manifold(cells) or voxel_genus(cells) != genus:
                cells[place] = True
        if (
            not cells.all()
            and cells.any(axis=(1, 2)).all()
            and cells.any(axis=(0, 2)).all()
            and cells.any(axis=(0, 1)).all()
            and FACES[0] <= _face_count(cells) <= FACES[1]
            and faces_one_way(cells)
        ):
            return cells


def _face_count(cells: np.ndarray) -> int:
    padded = np.pad(cells, 1)
    return sum(int((np.diff(padded.astype(int), axis=axis) != 0).sum()) for axis in range(3))


def _planes(rng: np.random.Generator, shape: Sequence[int], *, flat: bool) -> list[np.ndarray]:
    """Planes of the grid about the origin; layers differ by up to a factor of four."""
    planes = []
    for n in shape:
        width = 2.0 ** rng.uniform(-1.0, 1.0, n)
        planes.append(np.concatenate([[0.0], np.cumsum(width)]))
    if flat:
        # the shortest direction becomes a fifth to a tenth of the longest
        lengths = np.array([p[-1] for p in planes])
        axis = int(lengths.argmin())
        planes[axis] *= lengths.max() / lengths[axis] / rng.uniform(5.0, 10.0)
    return [p - 0.5 * p[-1] for p in planes]


# ------------------------------------------------------------------------------------------ maps


def _bent(
    rng: np.random.Generator,
    voxels: np.ndarray,
    planes: list[np.ndarray],
    degrees: list[int],
    rational: bool,
) -> tuple[BentGrid, tuple[str, ...]]:
    """A draw of maps, and the body under them."""
    half = np.array([p[-1] for p in planes])
    spans = [1 if p > 1 and n > 2 else 2 for p, n in zip(degrees, voxels.shape, strict=True)]
    degrees = list(degrees)
    steps: list[Map] = []
    names: list[str] = []
    kind = rng.integers(3) if rational else -1
    if kind in (-1, 1):
        for _ in range(int(rng.integers(2, 4))):
            name = str(rng.choice(list(_SMOOTH)))
            if name not in names:
                names.append(name)
                steps.append(_SMOOTH[name](rng, half))
    last: Map | None = None
    if kind in (0, 2):
        axis, name = int(half.argmax()), "arc"
        degrees[axis] = max(2, degrees[axis])
        last = _arc(rng, half, axis)
        names.append(name)
    if kind in (1, 2):
        last = _projective(rng, half, last)
        names.append("projective")

    def bend(x: np.ndarray) -> np.ndarray:
        for step in steps:
            x = step(x)
        return last(x) if last else x

    grid = bent_grid(
        voxels, bend, planes=planes, degrees=degrees, spans=spans, merge=bool(rng.random() < 0.7)
    )
    return grid, tuple(names)


def _axes(rng: np.random.Generator) -> tuple[int, int, int]:
    a, b, c = (int(k) for k in rng.permutation(3))
    return a, b, c


def _shear(rng: np.random.Generator, half: np.ndarray) -> Map:
    """Parallel layers slide along each other."""
    a, b, _ = _axes(rng)
    slope = rng.uniform(0.3, 0.9) * rng.choice([-1.0, 1.0])

    def moved(x: np.ndarray) -> np.ndarray:
        x = x.copy()
        x[..., a] += slope * x[..., b]
        return x

    return moved


def _taper(rng: np.random.Generator, half: np.ndarray) -> Map:
    """Cross sections shrink along an axis, to .4 at least of the largest."""
    a, b, c = _axes(rng)
    rate = rng.uniform(0.2, 0.45) * rng.choice([-1.0, 1.0]) / half[c]

    def tapered(x: np.ndarray) -> np.ndarray:
        x, scale = x.copy(), 1.0 + rate * x[..., c]
        x[..., a] *= scale
        x[..., b] *= scale
        return x

    return tapered


def _twist(rng: np.random.Generator, half: np.ndarray) -> Map:
    """Cross sections turn along the longest axis, by up to 160 degrees in all."""
    c = int(half.argmax())
    a, b = (c + 1) % 3, (c + 2) % 3
    rim = np.hypot(half[a], half[b])
    rate = min(rng.uniform(0.5, 1.3) / rim, np.radians(80.0) / half[c]) * rng.choice([-1.0, 1.0])

    def twisted(x: np.ndarray) -> np.ndarray:
        angle = rate * x[..., c]
        cosine, sine = np.cos(angle), np.sin(angle)
        return _put(x, {a: x[..., a] * cosine - x[..., b] * sine,
                        b: x[..., a] * sine + x[..., b] * cosine})  # fmt: skip

    return twisted


def _bend(rng: np.random.Generator, half: np.ndarray) -> Map:
    """The longest axis becomes an arc of up to 200 degrees."""
    c = int(half.argmax())
    a = (c + 1 + int(rng.integers(2))) % 3
    radius = max(half[a] * rng.uniform(1.6, 3.0), half[c] / np.radians(100.0))

    def bent(x: np.ndarray) -> np.ndarray:
        angle, reach = x[..., c] / radius, radius + x[..., a]
        return _put(x, {a: reach * np.cos(angle) - radius, c: reach * np.sin(angle)})

    return bent


def _wave(rng: np.random.Generator, half: np.ndarray) -> Map:
    """Layers slide by a sine, of half a period to one and a half over the body."""
    a, b, _ = _axes(rng)
    rate = np.pi * rng.uniform(0.5, 1.5) / half[b]
    high = rng.uniform(0.4, 0.8) / rate
    phase = rng.uniform(0.0, 2.0 * np.pi)

    def waved(x: np.ndarray) -> np.ndarray:
        return _put(x, {a: x[..., a] + high * np.sin(rate * x[..., b] + phase)})

    return waved


def _polynomial(rng: np.random.Generator, half: np.ndarray) -> Map:
    """A random polynomial map of degree 2 or 3."""
    # wider than the body, since other maps may have moved it
    box = 4.0 * half
    bend = PolynomialMap(rng, int(rng.integers(2, 4)), box, rng.uniform(0.5, 0.8))
    return lambda x: bend(x + 0.5 * box)


_SMOOTH: dict[str, Callable[[np.random.Generator, np.ndarray], Map]] = {
    "shear": _shear,
    "taper": _taper,
    "twist": _twist,
    "bend": _bend,
    "wave": _wave,
    "polynomial": _polynomial,
}


def _arc(rng: np.random.Generator, half: np.ndarray, c: int) -> Map:
    """An arc of a circle, exact: half the angle's tangent is linear in the parameter.

    With t = k x_c the point (r (1 - t²), 2 r t) / (1 + t²) runs on a circle of radius r, so the
    homogeneous map is of degree 2 in x_c and 1 in the others.
    """
    a = (c + 1 + int(rng.integers(2))) % 3
    radius = half[a] * rng.uniform(1.8, 3.5)
    rate = min(0.5 / radius, np.tan(np.radians(50.0)) / half[c])
    b = 3 - a - c

    def bent(x: np.ndarray) -> np.ndarray:
        t, reach = rate * x[..., c], radius + x[..., a]
        result = np.empty((*x.shape[:-1], 4))
        result[..., 3] = 1.0 + t**2
        result[..., a] = reach * (1.0 - t**2) - radius * result[..., 3]
        result[..., c] = 2.0 * reach * t
        result[..., b] = x[..., b] * result[..., 3]
        return result

    return bent


def _projective(rng: np.random.Generator, half: np.ndarray, before: Map | None) -> Map:
    """Straight lines stay straight, the far end shrinks."""
    toward = rng.normal(size=3)
    toward *= rng.uniform(0.15, 0.4) / np.linalg.norm(toward) / half.max()

    def seen(x: np.ndarray) -> np.ndarray:
        if before:
            result = before(x)
        else:
            result = np.concatenate([x, np.ones((*x.shape[:-1], 1))], axis=-1)
        result[..., 3] += result[..., :3] @ toward
        return result

    return seen


def _put(x: np.ndarray, fresh: dict[int, np.ndarray]) -> np.ndarray:
    x = x.copy()
    for axis, values in fresh.items():
        x[..., axis] = values
    return x


def _placed(rng: np.random.Generator, grid: BentGrid, size: float) -> BentGrid:
    """The body turned, scaled and moved; maps that act alike on control points and body."""
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    lattice = grid.lattice.copy()
    lattice[..., :3] = size * (lattice[..., :3] @ turn.T)
    lattice[..., :3] += lattice[..., 3:] * (size * rng.uniform(-20.0, 20.0, 3))
    return BentGrid(grid.cells, grid.lines, lattice)


# ----------------------------------------------------------------------------------------- table


def table(seeds: Sequence[int]) -> str:
    """What is known of bodies, as lines of Markdown."""
    rows = [
        "| body | voxels | genus | degrees | patches | spans | maps | volume, mm³ | thinnest |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for seed in seeds:
        body = random_body(seed)
        rows.append(
            f"| {body.name} | {int(body.voxels.sum())} of {'x'.join(map(str, body.voxels.shape))}"
            f" | {body.genus} | {''.join(map(str, body.degrees))}"
            f"{' rational' if body.rational else ''} | {len(body.faces)} | {body.spans}"
            f" | {', '.join(body.maps)} | {body.grid.volume():.4g}"
            f" | {body.thinnest() / body.diagonal:.3f} |"
        )
    return "\n".join(rows)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=1, help="first seed (default: 1)")
    parser.add_argument("--count", type=int, default=30, help="how many (default: 30)")
    options = parser.parse_args(arguments)
    print(table(range(options.first, options.first + options.count)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
