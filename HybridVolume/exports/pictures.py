# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``--pictures``: what each stage made, like the paper's Figs. 3, 4 and 8, and how good it is.

Each picture is a scene (or a chart) of arrays; :mod:`.render` draws them all in one process.
"""

from __future__ import annotations

import importlib.util
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.core.bound import scaled_jacobian_bound
from HybridVolume.core.columns import evaluate_columns
from HybridVolume.core.quality import ElementQuality, element_quality
from HybridVolume.core.reached import inner_figures
from HybridVolume.core.section import cut_tets, cut_triangles
from HybridVolume.core.tetmesh.door import interpreter
from HybridVolume.core.thickness import distance_to_triangles
from HybridVolume.errors import SetupError

from .fem_pictures import fem_histogram
from .picture import write_scenes
from .scene import (
    DARK,
    EDGE,
    GLASS,
    INNER,
    OUTER,
    SIDES,
    Bar,
    Chart,
    Cut,
    Label,
    Scene,
    Skin,
    Wire,
    glass,
    outline,
    quads,
)
from .slices import clipped, isolines

if TYPE_CHECKING:
    from HybridVolume.core.harmonic import HarmonicField
    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.shell import Shell
    from HybridVolume.core.surface import SurfaceMesh

SHEET = (0.85, 0.22, 0.16)
COLUMN = (0.12, 0.27, 0.62)
BODY = (0.80, 0.83, 0.88)
BAD = (0.86, 0.10, 0.10)
STEPS = np.linspace(0.1, 0.9, 9)
"""Levels of the isolines."""
WORST = 10
BINS = 20


def write_pictures(
    folder: str | os.PathLike, name: str, volume: HybridVolume, field: HarmonicField
) -> list[str]:
    """Draw all pictures of a body without a screen.

    Parameters
    ----------
    folder : path
    name : str
        Stem of the files.
    volume : HybridVolume
    field : HarmonicField
        The one that the shell was made by.

    Returns
    -------
    list of str
        Names of the files.

    Raises
    ------
    SetupError
        pyvista is not installed, or nothing on this system can draw.
    OSError
        The place cannot be written.
    """
    if importlib.util.find_spec("pyvista") is None:
        raise SetupError("pyvista is not installed: no pictures", remedy="install pyvista")
    scenes = all_pictures(name, volume, field)
    paths = {Path(folder) / f"{name}_{key}.png": scene for key, scene in scenes.items()}
    write_scenes(paths, interpreter())
    return [path.name for path in paths]


def all_pictures(
    name: str, volume: HybridVolume, field: HarmonicField
) -> Mapping[str, Scene | Chart]:
    """Every picture under its name in :data:`HybridVolume.job.PICTURES`."""
    quality = element_quality(volume)
    return {
        "field": field_picture(name, volume, field),
        "columns": columns_picture(name, volume),
        "shell": shell_picture(name, volume),
        "level": level_picture(name, volume, field),
        "thickness": thickness_picture(name, volume),
        "histogram": histogram(name, volume, quality),
        "worst": worst_picture(name, volume, quality),
        "fem_histogram": fem_histogram(name, volume.fem),
    }


# --------------------------------------------------------------------------------- the field


def field_picture(name: str, volume: HybridVolume, field: HarmonicField) -> Scene:
    """A cut through the body: w in colours, its isolines, midstructure and inner boundary."""
    shell, mesh = volume.shell, field.mesh
    low, high = _box(volume)
    across, along, up = _axes(low, high)
    # a little off the middle, where planes of symmetry and their triangles are
    at = 0.5 * (low + high) + 0.0137 * (high - low)
    skins, wires = [], []
    body = volume.surface.triangulation(_cells(volume, 40_000))
    points, triangles = clipped(body.vertices, body.triangles, (body.vertices - at) @ across)
    skins.append(Skin(points, None, triangles, BODY))
    section = cut_tets(mesh.vertices, mesh.tets, (mesh.vertices - at) @ across)
    w = np.clip(section.values(field.w), 0.0, 1.0)
    skins.append(Skin(section.points, None, section.parts, BODY, values=w, lit=False))
    # lines lie on the section, a hair nearer to the eye
    lift = 1e-3 * np.linalg.norm(high - low) * across
    for level in STEPS:
        lines = isolines(section.points, section.parts, w, level)
        wires.append(Wire(lines + lift, (1.0, 1.0, 1.0), 1.3))
    inner = shell.inner_surface().triangulation(_cells(volume, 60_000))
    cut = cut_triangles(inner.vertices, inner.triangles, (inner.vertices - at) @ across)
    wires.append(Wire(cut.points[cut.parts] + 2 * lift, (0.05, 0.05, 0.05), 4.0))
    outer = cut_triangles(body.vertices, body.triangles, (body.vertices - at) @ across)
    wires.append(Wire(outer.points[outer.parts] + lift, EDGE, 2.0))
    wires += _sheets(volume, at, across, lift)
    direction = across + 0.18 * up + 0.12 * along
    reached = f"mean level reached {shell.w0:.3f} of {shell.w0_asked:.3f} asked"
    return Scene(
        tuple(skins),
        tuple(wire for wire in wires if len(wire.points)),
        direction / np.linalg.norm(direction),
        up,
        0.5 * float(np.linalg.norm(high - low)),
        title=f"{name}: harmonic field in a cut through the body",
        lines=(f"isolines of w = 0.1 to 0.9; {reached}; {len(mesh.tets)} tetrahedra",),
        bar=Bar("w", 0.0, 1.0, marks=((float(shell.w0), "reached"),)),
        legend=(
            ((0.05, 0.05, 0.05), "inner boundary of the shell"),
            (SHEET, "midstructure (w = 1)"),
            (EDGE, "surface (w = 0)"),
        ),
        ruler=True,
    )


def _sheets(
    volume: HybridVolume, at: np.ndarray, across: np.ndarray, lift: np.ndarray
) -> list[Wire]:
    """Kept facets where the plane cuts them, thick."""
    middle = volume.midstructure
    facets = middle.facets[middle.kept]
    if not len(facets):
        return []
    cut = cut_triangles(middle.vertices, facets, (middle.vertices - at) @ across)
    wires = [Wire(cut.points[cut.parts] + 3 * lift, SHEET, 5.0)]
    extent = np.ptp(middle.vertices[facets].reshape(-1, 3), axis=0).max()
    if not len(cut.parts) and extent < 1e-3 * volume.surface.diagonal:
        # a single point: a small cross where it is seen on the section
        point = middle.vertices[facets].mean(axis=(0, 1))
        point = point + ((at - point) @ across) * across
        arm = 0.01 * volume.surface.diagonal * np.eye(3)
        wires = [Wire(np.stack([point - arm, point + arm], axis=1) + 3 * lift, SHEET, 5.0)]
    return wires


# ------------------------------------------------------------------------- columns and shell


def columns_picture(name: str, volume: HybridVolume) -> Scene:
    """Columns from the surface to the inner boundary; the shell is whole on one side."""
    cut = Cut(volume)
    shell = volume.shell
    away = np.flatnonzero(~cut.kept)
    x, normals = cut.lattice(cut.inner_surface, away)
    skins = [*cut.outer(), *cut.sides(), quads(x, normals, INNER)]
    wires = [*cut.wires, *_knot_wires(x, cut, away, (0.05, 0.36, 0.12), (0.02, 0.20, 0.05))]
    grid = volume.surface.triangulation("greville")
    bare = ~np.isin(np.arange(len(grid.vertices)), _covered(cut, grid))
    w = np.linspace(0.0, 1.0, 9)
    lines = evaluate_columns(shell, grid.vertex_patch[bare], grid.vertex_uv[bare], w)
    lines = np.moveaxis(lines, 0, 1)
    wires.append(Wire(lines, COLUMN, 1.8))
    wires.append(_dots(lines[:, 0], volume, COLUMN))
    wires.append(outline(volume.surface))
    length = np.linalg.norm(lines[:, -1] - lines[:, 0], axis=1)
    return _view(
        volume,
        skins,
        wires,
        title=f"{name}: columns from the surface to the inner boundary",
        lines=(
            f"{len(volume.surface.control_points)} columns, one a control point, shown where the "
            f"shell is taken away; {length.min():.3g} to {length.max():.3g} mm long",
        ),
        legend=(
            (OUTER, "CAD faces"),
            (SIDES[0], "elements of the shell"),
            (COLUMN, "columns"),
            (INNER, "inner boundary"),
        ),
        ruler=True,
    )


def _covered(cut: Cut, grid: SurfaceMesh) -> np.ndarray:
    """Vertices of a grid on the patches' parts where the shell stays."""
    along = cut.along(grid.vertices)
    ends = cut.along(evaluate_columns(cut.volume.shell, cut.patch[cut.kept],
                                      cut.uv[cut.kept, 1, 1], np.zeros(1))[0])  # fmt: skip
    return np.flatnonzero(along < ends.max(initial=0.0))


def _dots(points: np.ndarray, volume: HybridVolume, colour: tuple[float, float, float]) -> Wire:
    """Short crosses at points: where columns begin."""
    arm = 0.0015 * volume.surface.diagonal * np.eye(3)
    ends = np.stack([points[:, None] - arm, points[:, None] + arm], axis=2)
    return Wire(ends.reshape(-1, 2, 3), colour, 2.5)


def shell_picture(name: str, volume: HybridVolume) -> Scene:
    """The shell's elements laid open, with the core's tetrahedra behind them."""
    cut = Cut(volume, 0.55, 0.62)
    # between the core's ragged end and the shell one looks at the inner boundary from inside
    behind = quads(*cut.lattice(cut.inner_surface, np.flatnonzero(cut.kept)), INNER)
    skins = [*cut.outer(), *cut.sides(), *cut.inner(), behind, *cut.core()]
    shell, fem = volume.shell, volume.fem
    return _view(
        volume,
        skins,
        cut.wires,
        title=f"{name}: shell and core, cut open",
        lines=(
            f"{shell.element_count} Bézier elements in {shell.layer_count} layers, all proved "
            f"valid; {len(fem.tets)} tetrahedra",
        ),
        legend=(
            (OUTER, "CAD faces"),
            *((SIDES[k % 2], f"layer {k + 1}") for k in range(min(shell.layer_count, 2))),
            (INNER, "inner boundary"),
            ((0.80, 0.81, 0.83), "tetrahedra of the core"),
        ),
        ruler=True,
    )


# ------------------------------------------------------------------------ the inner boundary


def level_picture(name: str, volume: HybridVolume, field: HarmonicField) -> Scene:
    """The inner boundary in the colours of the level that it reaches."""
    shell = volume.shell
    values, scene = _on_inner(volume, lambda x: field.evaluate(x)[0], 60_000)
    # at least half of the level: small deviations shall look small
    low = min(values.min(), 0.5 * shell.w0_asked)
    high = max(values.max(), 1.05 * shell.w0_asked)
    return scene(
        title=f"{name}: level w reached on the inner boundary",
        lines=(f"asked {shell.w0_asked:.3g}; mean {shell.w0:.3f}, root mean square deviation "
               f"{shell.w0_rms:.3f}, from {values.min():.3f} to {values.max():.3f}",),
        bar=Bar("w", float(low), float(high), marks=((float(shell.w0_asked), "asked"),)),
    )  # fmt: skip


def thickness_picture(name: str, volume: HybridVolume) -> Scene:
    """The inner boundary in the colours of its distance from the surface."""
    body = volume.surface.triangulation(_cells(volume, 20_000))
    values, scene = _on_inner(
        volume, lambda x: distance_to_triangles(x, body.vertices, body.triangles), 15_000
    )
    # as the report tells it, whatever places the picture has
    inner = inner_figures(volume.shell)
    mean = float(np.average(inner.thickness, weights=inner.area))
    return scene(
        title=f"{name}: thickness of the shell",
        lines=(f"distance of the inner boundary from the surface: {inner.thickness.min():.3g} to "
               f"{inner.thickness.max():.3g} mm, mean {mean:.3g} mm",),
        bar=Bar("mm", 0.0, float(values.max()), "plasma", ((mean, "mean"),)),
    )  # fmt: skip


def _on_inner(
    volume: HybridVolume, of: Callable[[np.ndarray], np.ndarray], places: int
) -> tuple[np.ndarray, Callable[..., Scene]]:
    """Values at about so many places of the inner boundary, and what makes the scene of them."""
    cut = Cut(volume)
    every = np.arange(len(cut.cells))
    cut.steps = int(np.clip(np.sqrt(places / len(every)), 2, 12))
    x, normals = cut.lattice(cut.inner_surface, every)
    skin = quads(x, normals, INNER)
    values = of(skin.points)
    skin = Skin(skin.points, skin.normals, skin.triangles, INNER, values=values)
    wires = [*_knot_wires(x, cut, every, (0.25, 0.25, 0.25), DARK, 0.8, 2.2)]
    wires.append(outline(volume.surface))

    def scene(**words: Any) -> Scene:
        legend = ((DARK, "sides of the patches on the inner boundary"), (EDGE, "on the surface"))
        return _view(volume, [skin], wires, legend=legend, ruler=True, **words)

    return values, scene


# --------------------------------------------------------------------------------- how good


def histogram(name: str, volume: HybridVolume, quality: ElementQuality) -> Chart:
    """How many elements have which scaled Jacobian."""
    scaled = quality.scaled_jacobian
    bound = float(scaled_jacobian_bound(volume.surface).min())
    edges = np.linspace(0.0, 1.0, BINS + 1)
    counts, _ = np.histogram(np.clip(scaled, 0.0, 1.0), edges)
    return Chart(
        f"{name}: scaled Jacobian of {len(scaled)} elements",
        (f"smallest {scaled.min():.3f}, 1 % are below {quality.share(1.0):.3f}, "
         f"half below {np.median(scaled):.3f}; all proved valid",),
        edges,
        counts,
        "smallest scaled Jacobian of an element (1: a box, 0: flat)",
        "elements",
        ((float(scaled.min()), f"smallest {scaled.min():.3f}"),
         (bound, f"bound that the surface sets {bound:.3f}")),
    )  # fmt: skip


def worst_picture(name: str, volume: HybridVolume, quality: ElementQuality) -> Scene:
    """The worst elements in a body of glass, with their faces."""
    shell = volume.shell
    chosen = quality.worst(WORST)
    skins, wires, labels = [glass(volume.surface)], [outline(volume.surface)], []
    outward = np.zeros((len(chosen), 3))
    for rank, element in enumerate(chosen):
        sides, rims, middle, normal = _element(shell, int(element))
        skins.append(quads(sides, None, BAD))
        wires.append(Wire(rims, (0.25, 0.0, 0.0), 1.5))
        outward[rank] = normal
        face = quality.faces[quality.face[element]]
        text = f"{face}, layer {quality.layer[element] + 1}: {quality.scaled_jacobian[element]:.3f}"
        labels.append(Label(middle, text, (0.55, 0.05, 0.05)))
    scene = _view(
        volume,
        skins,
        wires,
        direction=_facing(volume, outward),
        title=f"{name}: the {len(chosen)} worst of {len(quality)} elements",
        lines=("scaled Jacobian of each beside its CAD face and its layer, 1 is the outermost",),
        labels=tuple(labels),
        legend=((BAD, "worst elements"), (GLASS, "body")),
        ruler=True,
    )
    return scene


def _element(shell: Shell, element: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Six sides (6, s, s, 3), twelve edges (12, s, 3), middle and outward normal of an element."""
    base, layer = divmod(element, shell.layer_count)
    group = next(g for g in shell.surface.groups if base in g.element)
    row = int(np.flatnonzero(group.element == base)[0])
    w = np.unique(shell.knots_w)[layer : layer + 2]
    low = np.array([*group.low[row], w[0]])
    high = np.array([*group.high[row], w[1]])
    patch = int(group.patch[row])
    t = np.linspace(0.0, 1.0, 9)

    def at(share: np.ndarray) -> np.ndarray:
        place = low + share * (high - low)
        return shell.evaluate(patch, *place.reshape(-1, 3).T).reshape(share.shape)

    sides, edges = [], []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        for end in (0.0, 1.0):
            share = np.full((len(t), len(t), 3), end)
            share[..., others[0]], share[..., others[1]] = np.meshgrid(t, t, indexing="ij")
            sides.append(at(share))
            for other in (0.0, 1.0):
                line = np.full((len(t), 3), end)
                line[:, others[0]], line[:, others[1]] = t, other
                edges.append(at(line))
    middle = at(np.full((1, 3), 0.5))[0]
    ends = at(np.array([[0.5, 0.5, 0.0], [0.5, 0.5, 1.0]]))
    return np.array(sides), np.array(edges), middle, ends[0] - ends[1]


def _facing(volume: HybridVolume, outward: np.ndarray) -> np.ndarray:
    """The direction, of eight oblique ones, from which most of some sides are seen."""
    low, high = _box(volume)
    across, along, up = _axes(low, high)
    unit = outward / np.maximum(np.linalg.norm(outward, axis=1, keepdims=True), 1e-300)
    best, most = across, -np.inf
    for one in (1.0, -1.0):
        for two in (1.0, -1.0):
            for three in (1.0, -1.0):
                view = 0.75 * one * along + 0.5 * two * up + 0.8 * three * across
                seen = float(np.clip(unit @ view, 0.0, None).sum()) + 1e-6 * two
                if seen > most:
                    best, most = view, seen
    return best


# ---------------------------------------------------------------------------------- together


def _view(
    volume: HybridVolume,
    skins: list[Skin],
    wires: list[Wire],
    *,
    direction: np.ndarray | None = None,
    **words: Any,
) -> Scene:
    """A scene seen from the body's oblique front, like the paper's Fig. 8."""
    low, high = _box(volume)
    across, along, up = _axes(low, high)
    if direction is None:
        direction = 0.75 * along + 0.50 * up + 0.62 * np.cross(up, along)
    return Scene(
        tuple(skin for skin in skins if len(skin.triangles)),
        tuple(wire for wire in wires if len(wire.points)),
        direction / np.linalg.norm(direction),
        up,
        0.5 * float(np.linalg.norm(high - low)),
        **words,
    )


def _box(volume: HybridVolume) -> tuple[np.ndarray, np.ndarray]:
    points = volume.surface.triangulation(2).vertices
    return points.min(axis=0), points.max(axis=0)


def _axes(low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Unit vectors along the middle, the longest and the shortest extent; right-handed."""
    # the same choice as in the cut, also where two extents are equal
    extent = high - low
    longest = int(np.argmax(extent))
    shortest = int(np.argmin(np.where(np.arange(3) == longest, np.inf, extent)))
    along, up = np.eye(3)[longest], np.eye(3)[shortest]
    return np.cross(along, up), along, up


def _cells(volume: HybridVolume, triangles: int) -> int:
    """Cells a knot span for about so many triangles."""
    return int(np.clip(np.sqrt(triangles / (2 * volume.surface.element_count)), 1, 16))


def _knot_wires(
    x: np.ndarray,
    cut: Cut,
    cells: np.ndarray,
    thin: tuple[float, float, float],
    thick: tuple[float, float, float],
    *widths: float,
) -> list[Wire]:
    """Sides of cells; those on sides of patches thick."""
    sides = (x[:, 0], x[:, -1], x[:, :, 0], x[:, :, -1])
    low, high = cut.uv[cells, 0, 0], cut.uv[cells, 2, 2]
    rim = (low[:, 0] == 0.0, high[:, 0] == 1.0, low[:, 1] == 0.0, high[:, 1] == 1.0)
    widths = widths or (1.6, 3.2)
    return [
        Wire(np.concatenate([s[~r] for s, r in zip(sides, rim, strict=True)]), thin, widths[0]),
        Wire(np.concatenate([s[r] for s, r in zip(sides, rim, strict=True)]), thick, widths[1]),
    ]
