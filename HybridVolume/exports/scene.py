# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What the picture shows: a body cut open in two steps, like the paper's Fig. 8.

Along the body's longest direction the whole shell stands first, then the core's boundary alone,
then the tets of the core in a ragged cut. Everything here is arrays; exports.render draws them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from HybridVolume.core.columns import (
    doubled_grid,
    evaluate_columns,
    grid_cells,
    interface_lines,
    layer_parameters,
)
from HybridVolume.core.elements import FACES, shape_functions

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.surface import PatchSurface

OUTER = (0.84, 0.18, 0.15)
SIDES = ((0.97, 0.70, 0.62), (0.93, 0.56, 0.46))
INNER = (0.24, 0.68, 0.30)
CORE = (0.80, 0.81, 0.83)
DARK = (0.10, 0.08, 0.08)
GLASS = (0.62, 0.70, 0.80)
EDGE = (0.35, 0.40, 0.47)

SHELL_ENDS, CORE_ENDS = 0.45, 0.70
"""Where along the body the shell and the core are cut, as shares of its length."""

_POINTS = 400_000
"""Roughly how many points a picture may have; fine bodies get coarser patches of colour."""
_TRIANGLES = 60_000


@dataclass(frozen=True)
class Skin:
    """Triangles of one colour, or coloured by values.

    Attributes
    ----------
    points : (n, 3) array
    normals : (n, 3) array or None
        Unit normals for smooth shading; None shades every triangle flat.
    triangles : (m, 3) int array
    colour : (r, g, b)
    opacity : float
        1 hides what is behind.
    values : (n,) array or None
        Shown in the colours of the scene's bar, in place of the one colour.
    lit : bool
        False shows the plain colours, without light and shade.
    """

    points: np.ndarray
    normals: np.ndarray | None
    triangles: np.ndarray
    colour: tuple[float, float, float]
    opacity: float = 1.0
    values: np.ndarray | None = None
    lit: bool = True


@dataclass(frozen=True)
class Wire:
    """Polylines of one colour and width: (m, k, 3) points, k to a line; width in pixels."""

    points: np.ndarray
    colour: tuple[float, float, float]
    width: float


@dataclass(frozen=True)
class Bar:
    """What colours stand for.

    Attributes
    ----------
    label : str
    low, high : float
        Values at the ends.
    colours : str
        Name of a colour map of matplotlib.
    marks : tuple of (float, str)
        Values that are marked, and words for them.
    """

    label: str
    low: float
    high: float
    colours: str = "viridis"
    marks: tuple[tuple[float, str], ...] = ()


@dataclass(frozen=True)
class Label:
    """Words at the margin with a line to a place."""

    point: np.ndarray
    text: str
    colour: tuple[float, float, float] = (0.1, 0.1, 0.1)


@dataclass(frozen=True)
class Scene:
    """Skins and wires, where to look from, and what is written beside them.

    Attributes
    ----------
    skins : tuple of Skin
    wires : tuple of Wire
    direction : (3,) array
        Towards the eye.
    up : (3,) array
    radius : float
        Half of the body's diagonal.
    title : str
        In the first line; a scene with a title, a bar, labels, a legend or a ruler is drawn in
        parallel projection, with room for them.
    lines : tuple of str
        Below the title.
    bar : Bar or None
    labels : tuple of Label
    legend : tuple of ((r, g, b), str)
        Colours and what they show.
    ruler : bool
        Whether a length in mm is shown.
    """

    skins: tuple[Skin, ...]
    wires: tuple[Wire, ...]
    direction: np.ndarray
    up: np.ndarray
    radius: float
    title: str = ""
    lines: tuple[str, ...] = ()
    bar: Bar | None = None
    labels: tuple[Label, ...] = ()
    legend: tuple[tuple[tuple[float, float, float], str], ...] = ()
    ruler: bool = False

    @property
    def written(self) -> bool:
        """Whether anything is written beside the picture."""
        return bool(self.title or self.bar or self.labels or self.legend or self.ruler)


@dataclass(frozen=True)
class Chart:
    """Bars over a range.

    Attributes
    ----------
    title : str
    lines : tuple of str
    edges : (n + 1,) array
    counts : (n,) array
    x_label, y_label : str
    marks : tuple of (float, str)
        Values that get a line, and words for them.
    parts : tuple of (str, tuple of int, (r, g, b))
        What the bars consist of, from below: words for the legend, counts, colour.
    """

    title: str
    lines: tuple[str, ...]
    edges: np.ndarray
    counts: np.ndarray
    x_label: str
    y_label: str
    marks: tuple[tuple[float, str], ...] = ()
    parts: tuple[tuple[str, tuple[int, ...], tuple[float, float, float]], ...] = ()


def cutaway(volume: HybridVolume) -> Scene:
    """The body cut open."""
    cut = Cut(volume)
    skins = [*cut.outer(), *cut.sides(), *cut.inner(), *cut.core()]
    wires = [wire for wire in cut.wires if len(wire.points)]
    axes = np.eye(3)
    up = axes[cut.across]
    third = np.cross(up, axes[cut.axis])
    direction = 0.75 * axes[cut.axis] + 0.50 * up + 0.62 * third
    return Scene(
        tuple(skin for skin in skins if len(skin.triangles)),
        tuple(wires),
        direction / np.linalg.norm(direction),
        up,
        0.5 * float(np.linalg.norm(cut.high - cut.low)),
    )


class Cut:
    """The cells that stay, and the skins that they show.

    Parameters
    ----------
    volume : HybridVolume
    shell_end, core_end : float
        Where along the body the shell and the core are cut, as shares of its length.
    """

    def __init__(
        self, volume: HybridVolume, shell_end: float = SHELL_ENDS, core_end: float = CORE_ENDS
    ) -> None:
        self.volume = volume
        self.core_end = core_end
        shell = self.shell = volume.shell
        surface = shell.surface
        grid = doubled_grid(surface, *interface_lines(surface, "knots", 1))
        self.cells, self.patch, self.uv = grid_cells(grid)
        self.inner_surface = shell.inner_surface()
        middle = evaluate_columns(shell, self.patch, self.uv[:, 1, 1], np.zeros(1))[0]
        corners = evaluate_columns(shell, grid.owner, grid.uv, np.zeros(1))[0]
        self.low, self.high = corners.min(axis=0), corners.max(axis=0)
        length = self.high - self.low
        self.axis = int(np.argmax(length))
        # the shortest direction stands upright: flat bodies lie on their side
        self.across = int(np.argmin(np.where(np.arange(3) == self.axis, np.inf, length)))
        self.kept = self.along(middle) < shell_end
        if not self.kept.any() or self.kept.all():
            self.kept = self.along(middle) <= np.median(self.along(middle))
        self.steps = int(np.clip(np.sqrt(_POINTS / max(1, len(self.cells))), 2, 20))
        self.wires: list[Wire] = []

    def along(self, points: np.ndarray) -> np.ndarray:
        """Where points are along the body, as shares of its length."""
        return (points[..., self.axis] - self.low[self.axis]) / (self.high - self.low)[self.axis]

    def outer(self) -> list[Skin]:
        """Outer faces of the kept shell, with patch boundaries and knot lines."""
        kept = np.flatnonzero(self.kept)
        x, normals = self.lattice(self.shell.surface, kept)
        self._outline(x, kept)
        return [quads(x, normals, OUTER)]

    def inner(self) -> list[Skin]:
        """The core's boundary where the shell is away and the core stays."""
        interface = self.volume.interface
        alone = np.isin(interface.triangle_patch, self.patch[~self.kept])
        alone &= ~self._covered(interface.triangle_uv, interface.triangle_patch)
        alone &= self._under_kept_tets()
        chosen = np.flatnonzero(alone)
        bary, triangles = _triangle_lattice(max(2, self.steps // 2))
        uv = np.einsum("ka,tab->tkb", bary, interface.triangle_uv[chosen])
        x, normals = self._evaluate(self.inner_surface, interface.triangle_patch[chosen], uv)
        self._knot_lines(interface.triangle_uv[chosen], x, bary)
        cell = _repeat(triangles, len(x), len(bary))
        return [Skin(x.reshape(-1, 3), normals.reshape(-1, 3), cell, INNER)]

    def sides(self) -> list[Skin]:
        """Sides of kept shell elements whose neighbour is away, layer by layer."""
        kept = np.flatnonzero(self.kept)
        side_ids = self.cells[:, [0, 2, 1, 1], [1, 1, 0, 2]]
        count = np.bincount(side_ids[kept].ravel(), minlength=self.cells.max() + 1)
        cell, side = np.nonzero(count[side_ids[kept]] == 1)
        cell = kept[cell]
        low, high = self.uv[cell, 0, 0], self.uv[cell, 2, 2]
        t = np.linspace(0.0, 1.0, self.steps + 1)
        # sides 0 and 1 run along v, 2 and 3 along u; the order keeps the normals outward
        start = np.where((side % 2 == 0)[:, None], low, high)
        run = np.where((side < 2)[:, None], [0.0, 1.0], [1.0, 0.0]) * (high - low)
        origin = np.where(np.abs(run) > 0.0, low, start)
        uv = origin[:, None] + run[:, None] * t[:, None]
        layers = layer_parameters(self.shell, between=False)
        levels = max(2, self.steps // 2)
        w = np.concatenate([np.linspace(a, b, levels + 1) for a, b in
                            zip(layers[:-1], layers[1:], strict=True)])  # fmt: skip
        patch = np.repeat(self.patch[cell], len(t))
        x = evaluate_columns(self.shell, patch, uv.reshape(-1, 2), w)
        x = x.reshape(len(layers) - 1, levels + 1, len(cell), len(t), 3)
        edge = (0.30, 0.10, 0.08)
        self.wires.append(Wire(x[:, 0].reshape(-1, len(t), 3), edge, 2.0))
        self.wires.append(Wire(x[-1, -1], edge, 2.0))
        ends = np.moveaxis(x[..., [0, -1], :], 1, 3)
        self.wires.append(Wire(ends.reshape(-1, levels + 1, 3), edge, 2.0))
        # one layer is told from the next by its tint
        return [
            quads(np.moveaxis(layer, 1, 0), None, SIDES[number % len(SIDES)])
            for number, layer in enumerate(x)
        ]

    def core(self) -> list[Skin]:
        """Faces of the kept tets that the cut laid open."""
        fem = self.volume.fem
        kept = self._kept_tets()
        faces = np.array(FACES[fem.tet_kind])
        rows = fem.tets[kept][:, faces].reshape(-1, faces.shape[1])
        keys = np.sort(rows[:, :3], axis=1)
        boundary = np.sort(fem.interface[:, :3], axis=1)
        _, first, inverse, count = np.unique(
            np.concatenate([keys, boundary]),
            axis=0, return_index=True, return_inverse=True, return_counts=True,
        )  # fmt: skip
        open_ = count[inverse.reshape(-1)[: len(keys)]] == 1
        bary, triangles = _triangle_lattice(max(4, self.steps // 2) if fem.order == 2 else 1)
        values = shape_functions(fem.face_kind, bary[:, 1:])
        nodes = fem.nodes.copy()
        if fem.order == 2:
            # mid nodes that were moved inside stand off the inner surface that is drawn
            interface = self.volume.interface
            nodes[fem.interface[:, 3:]] = interface.midpoints[interface.triangle_edges]
        x = np.einsum("kn,tnc->tkc", values, nodes[rows[open_]])
        around = [np.flatnonzero(bary[:, corner] == 0.0) for corner in range(3)]
        edges = np.concatenate([x[:, a] for a in around])
        self.wires.append(Wire(edges, (0.28, 0.28, 0.31), 1.6))
        return [Skin(x.reshape(-1, 3), None, _repeat(triangles, len(x), len(bary)), CORE)]

    def _kept_tets(self) -> np.ndarray:
        fem = self.volume.fem
        return self.along(fem.nodes[fem.tets[:, :4]].mean(axis=1)) < self.core_end

    def _under_kept_tets(self) -> np.ndarray:
        """Whether the tet under each interface triangle stays, (m,)."""
        fem = self.volume.fem
        rows = fem.tets[self._kept_tets()][:, np.array(FACES["tet4"])].reshape(-1, 3)
        count = len(fem.nodes)

        def keys(triangles: np.ndarray) -> np.ndarray:
            a, b, c = np.sort(triangles, axis=1).astype(np.int64).T
            return (a * count + b) * count + c

        return np.isin(keys(fem.interface[:, :3]), keys(rows))

    def _covered(self, uv: np.ndarray, patch: np.ndarray) -> np.ndarray:
        """Whether the middle of each parameter triangle lies in a kept cell."""
        middle = uv.mean(axis=1)
        covered = np.zeros(len(uv), dtype=bool)
        cells = np.argsort(self.patch, kind="stable")
        surface = self.shell.surface
        start = np.searchsorted(self.patch[cells], np.arange(len(surface.patches)))
        number = surface.stack_of[0][patch]
        for k, stack in enumerate(surface.stacks):
            chosen = np.flatnonzero(number == k)
            lines = [np.unique(knots) for knots in stack.knots]
            i, j = (
                np.clip(np.searchsorted(x, m, side="right") - 1, 0, len(x) - 2)
                for x, m in zip(lines, middle[chosen].T, strict=True)
            )
            own = cells[start[patch[chosen]] + i * (len(lines[1]) - 1) + j]
            covered[chosen] = self.kept[own]
        return covered

    def _knot_lines(self, uv: np.ndarray, x: np.ndarray, bary: np.ndarray) -> None:
        """Sides of interface triangles without their diagonals; thick at patch boundaries."""
        thick, thin = [], []
        for corner in range(3):
            ends = uv[:, [(corner + 1) % 3, (corner + 2) % 3]]
            side = x[:, np.flatnonzero(bary[:, corner] == 0.0)]
            same = ends[:, 0] == ends[:, 1]
            rim = same & ((ends[:, 0] == 0.0) | (ends[:, 0] == 1.0))
            thick.append(side[rim.any(axis=1)])
            thin.append(side[same.any(axis=1) & ~rim.any(axis=1)])
        self.wires.append(Wire(np.concatenate(thin), (0.05, 0.36, 0.12), 1.6))
        self.wires.append(Wire(np.concatenate(thick), (0.02, 0.20, 0.05), 3.2))

    def lattice(self, surface, cells: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points and normals of cells, (nc, steps + 1, steps + 1, 3)."""
        t = np.linspace(0.0, 1.0, self.steps + 1)
        low, high = self.uv[cells, 0, 0], self.uv[cells, 2, 2]
        share = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
        uv = low[:, None] + (high - low)[:, None] * share
        x, normals = self._evaluate(surface, self.patch[cells], uv)
        shape = (len(cells), len(t), len(t), 3)
        return x.reshape(shape), normals.reshape(shape)

    def _evaluate(
        self, surface, patch: np.ndarray, uv: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points and unit normals at (m, k, 2) parameters of m patches."""
        shape = (*uv.shape[:2], 3)
        on = np.repeat(patch, uv.shape[1])
        x, x_u, x_v = surface.evaluate_at(on, *uv.reshape(-1, 2).T, derivative=1)
        normals = np.cross(x_u, x_v)
        length = np.linalg.norm(normals, axis=1, keepdims=True)
        normals /= np.maximum(length, np.finfo(float).tiny)
        return x.reshape(shape), normals.reshape(shape)

    def _outline(self, x: np.ndarray, cells: np.ndarray) -> None:
        """Sides of cells: boundaries of patches thick, knot lines thin."""
        sides = (x[:, 0], x[:, -1], x[:, :, 0], x[:, :, -1])
        low, high = self.uv[cells, 0, 0], self.uv[cells, 2, 2]
        rim = (low[:, 0] == 0.0, high[:, 0] == 1.0, low[:, 1] == 0.0, high[:, 1] == 1.0)
        thick = np.concatenate([s[r] for s, r in zip(sides, rim, strict=True)])
        thin = np.concatenate([s[~r] for s, r in zip(sides, rim, strict=True)])
        self.wires.append(Wire(thin, (0.42, 0.05, 0.04), 1.6))
        self.wires.append(Wire(thick, DARK, 4.0))


def glass(surface: PatchSurface) -> Skin:
    """The body as glass."""
    cells = int(np.clip(np.sqrt(_TRIANGLES / (2 * surface.element_count)), 1, 16))
    mesh = surface.triangulation(cells)
    return Skin(mesh.vertices, None, mesh.triangles, GLASS, 0.16)


def outline(surface: PatchSurface) -> Wire:
    """Sides of all patches."""
    t = np.linspace(0.0, 1.0, 33)
    zero, one = np.zeros(33), np.ones(33)
    u, v = np.concatenate([zero, one, t, t]), np.concatenate([t, t, zero, one])
    count = len(surface.patches)
    patch = np.repeat(np.arange(count), len(u))
    lines = surface.evaluate_at(patch, np.tile(u, count), np.tile(v, count))
    return Wire(lines.reshape(-1, 33, 3), EDGE, 1.2)


def quads(x: np.ndarray, normals: np.ndarray | None, colour: tuple[float, float, float]) -> Skin:
    """Triangles over (m, a, b, 3) lattices."""
    m, a, b = x.shape[:3]
    corner = (np.arange(a - 1)[:, None] * b + np.arange(b - 1)).ravel()
    cell = np.concatenate(
        [
            np.column_stack([corner, corner + b, corner + b + 1]),
            np.column_stack([corner, corner + b + 1, corner + 1]),
        ]
    )
    flat = None if normals is None else normals.reshape(-1, 3)
    return Skin(x.reshape(-1, 3), flat, _repeat(cell, m, a * b), colour)


def _repeat(cell: np.ndarray, times: int, size: int) -> np.ndarray:
    return (np.arange(times)[:, None, None] * size + cell).reshape(-1, 3)


def _triangle_lattice(steps: int) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric lattice of a triangle and its small triangles."""
    index = {}
    bary = []
    for i in range(steps + 1):
        for j in range(steps + 1 - i):
            index[i, j] = len(bary)
            bary.append([(steps - i - j) / steps, i / steps, j / steps])
    triangles = []
    for i in range(steps):
        for j in range(steps - i):
            triangles.append([index[i, j], index[i + 1, j], index[i, j + 1]])
            if i + j < steps - 1:
                triangles.append([index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]])
    return np.array(bary), np.array(triangles)
