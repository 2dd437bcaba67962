# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Pictures of fields on the true geometry: displacement, stress, temperature, whole or cut open.

Shell and core are sampled inside every element, by the functions that they were solved with, so
that curved faces are curved, and values between nodes are those of the solution.
"""

from __future__ import annotations

import os
from dataclasses import dataclass

import numpy as np

from HybridVolume.core.analysis.fields import Field, FieldSpace
from HybridVolume.core.analysis.simplex_space import shape_functions
from HybridVolume.core.section import cut_tets, cut_triangles
from HybridVolume.errors import FaultError, InputError

from .picture import write_scene
from .scene import Bar, Scene, Skin, Wire
from .slices import clipped

COLOURS = "turbo"
LINE, FAINT, SEAM = (0.10, 0.10, 0.12), (0.62, 0.64, 0.68), (1.0, 1.0, 1.0)
PLAIN = (0.8, 0.8, 0.8)

_POINTS = 150_000
"""Points of the shell's lattices aimed at."""
_TETS = 200_000
"""Small tetrahedra of the core aimed at."""
_MOST, _LEAST = 10, 2
"""Cells of a lattice along one direction."""
_SHOWN = 0.08
"""The largest displacement is shown as this share of the body's size, unless a factor is given."""


@dataclass(frozen=True)
class _Sampled:
    """Points (n, 3) with displacements (n, 3) and values (n,), as one (n, 7) array, and cells."""

    data: np.ndarray
    outer: np.ndarray
    inner: np.ndarray
    tets: np.ndarray
    rims: np.ndarray

    @property
    def points(self) -> np.ndarray:
        return self.data[:, :3]


def solution_scene(
    space: FieldSpace,
    values: Field,
    label: str,
    *,
    displacement: Field | None = None,
    factor: float | None = None,
    cut: bool = False,
    title: str = "",
    limits: tuple[float, float] | None = None,
    direction: np.ndarray | None = None,
    up: np.ndarray | None = None,
) -> Scene:
    """A body in the colours of a field.

    Parameters
    ----------
    space : FieldSpace
    values : Field
        One component, or several whose length counts.
    label : str
        What the colours stand for, with its unit.
    displacement : Field, optional
        Three components, mm; the body is drawn deformed by it, over faint lines of what it was.
    factor : float, optional
        By what the displacement is multiplied; by default so that it is seen.
    cut : bool
        Take the half in front away: across the body's second longest direction.
    title : str
    limits : (float, float), optional
        Values at the ends of the colours; by default those of the field.
    direction, up : (3,) arrays, optional
        Towards the eye, and upward.

    Raises
    ------
    InputError
        The displacement has other than three components.
    FaultError
        A value is not finite.
    """
    if displacement is not None and displacement.width != 3:
        raise InputError("a displacement has three components", remedy="give that field")
    sampled = _sample(space, values, displacement)
    if not np.isfinite(sampled.data).all():
        raise FaultError("the field is not finite at some points")
    x = sampled.points
    low, high = x.min(axis=0), x.max(axis=0)
    size = float(np.linalg.norm(high - low))
    if displacement is None:
        factor = 0.0
    elif factor is None:
        largest = float(np.linalg.norm(sampled.data[:, 3:6], axis=1).max())
        factor = _readable(_SHOWN * size / largest) if largest > 0.0 else 1.0
    axes = np.eye(3)[np.argsort(high - low)[::-1]]
    if direction is None:
        direction = 0.45 * axes[0] + 0.85 * axes[1] + 0.5 * axes[2]
    up = axes[2] if up is None else np.asarray(up, dtype=float)
    direction = np.asarray(direction, dtype=float) / np.linalg.norm(direction)
    surface, seams, skins = sampled.outer, sampled.rims, []
    data, wires = sampled.data, []
    if cut:
        normal = axes[1] if direction @ axes[1] > 0.0 else -axes[1]
        # a little off the middle, where planes of symmetry and sides of elements are
        height = (x - 0.5 * (low + high)) @ normal - 0.0137 * size
        section = cut_tets(x, sampled.tets, height)
        skins.append(_skin(section.values(data), section.parts, factor))
        line = cut_triangles(x, sampled.inner, height)
        wires.append(_wire(line.values(data)[line.parts], factor, SEAM, 2.0, direction, size))
        kept = (height[seams] < 0.0).all(axis=1)
        seams = seams[kept]
        data, surface = clipped(data, surface, height)
    skins.insert(0, _skin(data, surface, factor))
    wires.append(_wire(sampled.data[seams], factor, LINE, 1.6, direction, size))
    if factor:
        wires.append(_wire(sampled.data[sampled.rims], 0.0, FAINT, 1.2, direction, size))
    shown = np.concatenate([skin.values for skin in skins])
    least, most = limits or (float(shown.min()), float(shown.max()))
    place = int(np.argmax(sampled.data[:, 6]))
    lines = [f"from {sampled.data[:, 6].min():.4g} to {sampled.data[:, 6].max():.4g}, largest at "
             f"({', '.join(f'{c:.4g}' for c in x[place])}) mm"]  # fmt: skip
    if factor:
        lines.append(f"displacement shown {factor:.4g} times as large")
    # a constant field has a bar too
    room = 1e-9 * max(abs(least), abs(most), 1e-300)
    return Scene(
        tuple(skins),
        tuple(wire for wire in wires if len(wire.points)),
        direction,
        up,
        0.5 * size,
        title=title or label,
        lines=tuple(lines),
        bar=Bar(label, least - room * (most == least), most + room * (most == least), COLOURS),
        ruler=not factor,
    )


def write_solution_picture(path: str | os.PathLike, scene: Scene) -> None:
    """Draw a scene without a screen, by this Python or the worker's.

    Raises
    ------
    SetupError
        pyvista is not installed, or nothing on this system can draw.
    OSError
        The place cannot be written.
    """
    write_scene(path, scene, _drawing_python())


def _drawing_python() -> str:
    """An interpreter that has what draws."""
    import importlib.util

    from HybridVolume.core.tetmesh.door import interpreter
    from HybridVolume.worker_process import worker_python

    return interpreter() if importlib.util.find_spec("pyvista") else worker_python()


def _sample(space: FieldSpace, values: Field, displacement: Field | None) -> _Sampled:
    """Lattices of all elements."""
    cells, tets = space.cells, space.space.tets
    along = int(np.clip(np.sqrt(_POINTS / (len(cells) * 3)), _LEAST, _MOST))
    across = 3
    lines = (np.linspace(0.0, 1.0, along + 1),) * 2 + (np.linspace(0.0, 1.0, across + 1),)
    shape = (along + 1, along + 1, across + 1)
    size = int(np.prod(shape))
    data = np.zeros((len(cells), size, 7))
    for number, batch in enumerate(cells.batches):
        fields = [batch.points, values.shell[number]]
        if displacement is not None:
            fields.insert(1, displacement.shell[number])
        found, _ = batch.on_lattice(slice(None), lines, np.concatenate(fields, axis=-1))
        data[batch.element] = _columns(found.reshape(len(batch), size, -1), displacement)
    index = np.arange(size).reshape(shape)
    base = size * np.arange(len(cells))
    layer = np.arange(len(cells)) % cells.layers
    outer, inner = base[layer == 0], base[layer == cells.layers - 1]
    # v before u: the outside is seen from where u x v points
    quads = _quads(index[:, :, 0].T)
    rims = np.stack([index[0, :, 0], index[-1, :, 0], index[:, 0, 0], index[:, -1, 0]])
    shell_tets = _placed(base, _tets(index))
    # as fine at the interface as the shell beside it, where there are few
    halvings = int(np.clip(np.log(_TETS / len(tets.elements)) / np.log(8.0), 1, 3))
    fine, small = _small_tets(halvings if tets.degree > 1 else 0)
    core, _ = shape_functions(tets.degree, fine)
    fields = [tets.nodes, values.core]
    if displacement is not None:
        fields.insert(1, displacement.core)
    inside = core @ np.concatenate(fields, axis=-1)[tets.elements]
    inside = _columns(inside, displacement).reshape(-1, 7)
    start = len(cells) * size
    return _Sampled(
        np.concatenate([data.reshape(-1, 7), inside]),
        _placed(outer, quads),
        _placed(inner, _quads(index[:, :, -1].T)),
        np.concatenate(
            [shell_tets, start + _placed(len(fine) * np.arange(len(tets.elements)), small)]
        ),
        _placed(outer, rims),
    )


def _columns(found: np.ndarray, displacement: Field | None) -> np.ndarray:
    """Points, displacement and one value each, (..., 7)."""
    if displacement is None:
        found = np.concatenate([found[..., :3], np.zeros_like(found[..., :3]), found[..., 3:]], -1)
    several = found.shape[-1] > 7
    value = np.linalg.norm(found[..., 6:], axis=-1) if several else found[..., 6]
    return np.concatenate([found[..., :6], value[..., None]], axis=-1)


def _skin(data: np.ndarray, triangles: np.ndarray, factor: float) -> Skin:
    return Skin(data[:, :3] + factor * data[:, 3:6], None, triangles, PLAIN, values=data[:, 6])


def _wire(
    data: np.ndarray,
    factor: float,
    colour: tuple[float, float, float],
    width: float,
    direction: np.ndarray,
    size: float,
) -> Wire:
    """Lines (m, k, 7), a hair nearer to the eye than what they lie on."""
    points = data[..., :3] + factor * data[..., 3:6] + 1e-3 * size * direction
    return Wire(points, colour, width)


def _placed(base: np.ndarray, template: np.ndarray) -> np.ndarray:
    return (base[:, None, None] + template).reshape(-1, template.shape[1])


def _quads(plane: np.ndarray) -> np.ndarray:
    """Triangles over a grid of indices."""
    corners = plane[:-1, :-1], plane[1:, :-1], plane[1:, 1:], plane[:-1, 1:]
    a, b, c, d = (part.ravel() for part in corners)
    return np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])


def _tets(index: np.ndarray) -> np.ndarray:
    """Six tetrahedra to a cell of a lattice, all around its main diagonal."""
    found = []
    for order in ((0, 1, 2), (0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)):
        place = np.zeros(3, dtype=int)
        path = []
        for axis in (None, *order):
            if axis is not None:
                place[axis] = 1
            some = tuple(slice(p, n - 1 + p) for p, n in zip(place, index.shape, strict=True))
            path.append(index[some].ravel())
        found.append(np.stack(path, axis=-1))
    return np.concatenate(found)


def _small_tets(halvings: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of the reference tetrahedron, and the small tetrahedra that halvings cut it into."""
    parts = np.eye(4)[None]
    pairs = ((0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3))
    # corners 0 to 3, then the middles of the edges; the octahedron goes around 0-3 to 1-2
    small = [(0, 4, 5, 6), (1, 4, 7, 8), (2, 5, 7, 9), (3, 6, 8, 9)]
    small += [(6, 7, 4, 5), (6, 7, 5, 9), (6, 7, 9, 8), (6, 7, 8, 4)]
    for _ in range(halvings):
        middles = [0.5 * (parts[:, a] + parts[:, b]) for a, b in pairs]
        points = np.concatenate([parts, np.stack(middles, axis=1)], axis=1)
        parts = points[:, np.array(small)].reshape(-1, 4, 4)
    points, number = np.unique(parts.reshape(-1, 4), axis=0, return_inverse=True)
    return points[:, 1:], number.reshape(-1, 4)


def _readable(factor: float) -> float:
    """The largest of 1, 2, 5, 10, ... (and of .5, .2, ...) that is not above a factor."""
    power = 10.0 ** np.floor(np.log10(factor))
    return float(power * max(step for step in (1.0, 2.0, 5.0) if step * power <= factor * 1.0001))
