# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What a shell has become beside what was asked: its thickness by faces, and a sentence about it.

The thickness at a point of the inner boundary is its distance from the surface; means are weighted
by the area of the surface over it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from . import bspline
from .columns import evaluate_columns
from .front import ColumnFrame, column_frame, solve_front
from .goals import DEEPEST, SAMPLES, Thickness, goal_levels, usable_level, wanted_lengths
from .harmonic import HarmonicField
from .midstructure.distances import SurfaceDistance
from .shell import Shell
from .surface import PatchSurface, SurfaceMesh
from .thickness import HIGHEST, shell_thickness

NEAR = 0.05
"""Difference in the mean, as a share of what was asked, from which on it is told."""
LACKING = 0.8
"""Share of what was asked below which a single face is told."""
NAMED = 6
"""Faces, the worst, that a sentence names."""
SHARP = 0.65
"""Cosine between a column and the normals around it, at most, where an edge or corner is sharp."""

_POINTS = 20_000


@dataclass(frozen=True)
class InnerSurface:
    """The inner boundary of a shell as triangles, and what is known at their corners.

    Attributes
    ----------
    vertices : (n, 3) array
        mm.
    triangles : (m, 3) int array
        Oriented like the surface: their normals point away from the core.
    triangle_patch : (m,) int array
    face_names : tuple of str
        CAD face of each patch.
    level : (n,) array
        Level of the harmonic field that was reached.
    goal : (n,) array
        Level that was asked for.
    thickness : (n,) array
        Distance from the surface, mm.
    area : (n,) array
        Area of the surface over each vertex, mm².
    """

    vertices: np.ndarray
    triangles: np.ndarray
    triangle_patch: np.ndarray
    face_names: tuple[str, ...]
    level: np.ndarray
    goal: np.ndarray
    thickness: np.ndarray
    area: np.ndarray


def inner_figures(shell: Shell, cells: int | None = None) -> InnerSurface:
    """Levels and thickness over the inner boundary of a shell.

    Parameters
    ----------
    shell : Shell
        Without levels of columns (older files) its means stand for them.
    cells : int, optional
        Triangulated squares along each knot span; by the number of spans otherwise.
    """
    cells = cells or cells_along(shell.surface)
    outer = shell.surface.triangulation(cells)
    inner = shell.inner_surface().triangulation(cells)
    level, goal = _levels(shell)
    distance = SurfaceDistance(shell.surface, SAMPLES).nearest(inner.vertices).distance
    area = np.zeros(len(outer.vertices))
    np.add.at(area, outer.triangles.ravel(), np.repeat(_areas(outer) / 3.0, 3))
    return InnerSurface(
        vertices=inner.vertices,
        triangles=inner.triangles,
        triangle_patch=inner.triangle_patch,
        face_names=tuple(patch.face for patch in shell.surface.patches),
        level=_between_nodes(shell.surface, inner, level),
        goal=_between_nodes(shell.surface, inner, goal),
        thickness=distance,
        area=area,
    )


def figures_by_face(shell: Shell, inner: InnerSurface) -> list[dict[str, Any]]:
    """What was reached at each CAD face, as in the report.

    Parameters
    ----------
    shell : Shell
    inner : InnerSurface
        Of this shell, with the usual number of squares.

    Returns
    -------
    list of dict
        ``face``; ``w0`` and ``thickness`` (mm), each with ``min``, ``mean`` and ``max``;
        ``w0_asked``.
    """
    faces = _Faces(shell.surface, cells_along(shell.surface))
    columns = map(faces.figures, (inner.level, inner.goal, inner.thickness))
    return [
        {"face": face, "w0": level, "w0_asked": goal["mean"], "thickness": depth}
        for face, level, goal, depth in zip(faces.names, *columns, strict=True)
    ]


def reached_figures(
    shell: Shell, thickness: Thickness, why: str = "", used: float = np.inf
) -> dict[str, Any]:
    """What was asked and what was reached, as plain values for the report.

    Parameters
    ----------
    shell : Shell
    thickness : Thickness
        That was asked for.
    why : str
        The reason for all faces, where it is known from the way in which the shell was made.
    used : float
        Level that no column was drawn beyond, as isosurfaces there are not like the body.

    Returns
    -------
    dict
        ``asked``, ``thickness``, ``faces`` and ``sentence``, see docs/report.md.
    """
    surface = shell.surface
    inner = inner_figures(shell)
    faces = _Faces(surface, cells_along(surface))
    frame = column_frame(surface)
    lengths = wanted_lengths(thickness, surface, frame)
    wanted = None if lengths is None else _between_nodes(surface, faces.mesh, lengths)
    level, asked_level, depth = map(faces.figures, (inner.level, inner.goal, inner.thickness))
    asked_depth = None if wanted is None else faces.figures(wanted)
    rows = []
    for k, face in enumerate(faces.names):
        share = level[k]["mean"] / max(asked_level[k]["mean"], 1e-12)
        if asked_depth is not None:
            share = depth[k]["mean"] / max(asked_depth[k]["mean"], 1e-12 * surface.diagonal)
        rows.append(
            {
                "face": face,
                "w0": level[k],
                "w0_asked": asked_level[k]["mean"],
                "thickness": depth[k],
                "share": share,
                "reason": "",
            }
        )
    reasons = _reasons(shell, thickness, frame, faces.names, used)
    for row, reason in zip(rows, reasons, strict=True):
        if row["share"] < 1.0 - NEAR:
            row["reason"] = why or reason
    whole = faces.whole(inner.thickness)
    figures = {"w0": faces.whole(inner.level), "thickness": whole}
    wants = {"w0": faces.whole(inner.goal)["mean"]}
    if wanted is not None:
        wants["thickness"] = faces.whole(wanted)["mean"]
    return {
        "asked": asked_figures(thickness),
        "thickness": whole,
        "faces": rows,
        "sentence": sentence(thickness, figures, wants, rows),
    }


def sentence(
    thickness: Thickness,
    reached: dict[str, dict[str, float]],
    asked: dict[str, float],
    faces: Sequence[dict[str, Any]],
) -> str:
    """Tell in words where a shell is not what was asked; empty where it is.

    Parameters
    ----------
    thickness : Thickness
        That was asked for.
    reached : dict
        ``min``, ``mean``, ``max`` of ``w0`` and of the ``thickness``, mm.
    asked : dict
        Mean of the ``w0`` and, for kinds that ask for a length at every place, of the
        ``thickness``, mm.
    faces : sequence of dict
        As in the report.
    """
    depth, level = reached["thickness"], reached["w0"]
    if thickness.kind in ("mean", "min") and thickness.uniform:
        share = depth[thickness.kind] / thickness.value
    elif "thickness" in asked:
        share = depth["mean"] / asked["thickness"]
    else:
        share = level["mean"] / asked["w0"]
    thin = sorted((f for f in faces if f["share"] < 1.0 - NEAR), key=lambda f: f["share"])
    if abs(share - 1.0) <= NEAR and not (thin and thin[0]["share"] < LACKING):
        return ""
    unit, figures = ("", level) if thickness.kind == "w0" else (" mm", depth)
    words = f"asked {_asked(thickness, asked)}, reached "
    if thickness.kind == "min":
        words += f"{figures['min']:.3g} mm at the thinnest place ({figures['mean']:.3g} in the mean"
        words += f", up to {figures['max']:.3g})"
    else:
        words += f"{figures['mean']:.3g}{unit} in the mean"
        words += f" ({figures['min']:.3g} to {figures['max']:.3g})"
    if thickness.kind in ("mean", "min") and share < 1.0 and asked["w0"] > (1.0 - NEAR) * DEEPEST:
        words += "; the body is too thin for more"
    elif thin:
        words += f"; thinner than asked at {_listed(thin)}"
    thick = sorted((f for f in faces if f["share"] > 1.0 + NEAR), key=lambda f: -f["share"])
    if thick and share > 1.0 + NEAR:
        words += f"; thicker at {_listed(thick)}"
    return words


def _asked(thickness: Thickness, asked: dict[str, float]) -> str:
    varied = any(factor != 1.0 for factor in thickness.factors.values())
    if thickness.kind == "w0" and varied:
        return f"{thickness} with factors of faces ({asked['w0']:.3g} in the mean)"
    if thickness.kind == "share" or (thickness.kind == "even" and varied):
        with_factors = " with factors of faces" if varied else ""
        return f"{thickness}{with_factors} ({asked['thickness']:.3g} mm in the mean)"
    return f"{thickness}{' with factors of faces' if varied else ''}"


def _listed(faces: Sequence[dict[str, Any]]) -> str:
    """Faces with what they reached; a reason that all have is told once."""
    shown = faces[:NAMED]
    reasons = {face["reason"] for face in shown}
    words = []
    for face in shown:
        own = f", {face['reason']}" if len(reasons) > 1 and face["reason"] else ""
        words.append(f"{face['face']} ({100 * face['share']:.0f} %{own})")
    text = ", ".join(words)
    if len(faces) > len(shown):
        text += f" and {len(faces) - len(shown)} more"
    (reason,) = reasons if len(reasons) == 1 else ("",)
    return f"{text}: {reason}" if reason else text


def expected_figures(
    field: HarmonicField, surface: PatchSurface, thickness: Thickness
) -> dict[str, Any]:
    """How thick a shell will be, without making it.

    One level asked everywhere is answered from its isosurface, all else from the solved front:
    what a shell gives up for valid elements is not in it.

    Parameters
    ----------
    field : HarmonicField
    surface : PatchSurface
    thickness : Thickness

    Returns
    -------
    dict
        As of :func:`HybridVolume.core.thickness.shell_thickness`, with ``asked`` and
        ``isosurface`` as in the report, ``estimate`` (whether it comes from the front) and
        ``notes``. ``w0`` is the mean of the levels.

    Raises
    ------
    InputError
        A factor is for a face that the body has not.
    FaultError
        No level of the field looks like the body.
    """
    if thickness.kind == "w0" and thickness.uniform:
        figures = shell_thickness(field, surface, thickness.value)
        top, notes = thickness.value, []
    else:
        frame = column_frame(surface)
        goal, notes = goal_levels(thickness, surface, frame, field)
        top = float(goal.max())
        goal = np.minimum(goal, usable_level(field, surface.genus, top)[1])
        front = frame.nodes + solve_front(surface, frame, field, goal)
        reached = SurfaceDistance(surface, SAMPLES).nearest(front).distance
        faces = _Faces(surface, cells_along(surface))
        values = _between_nodes(surface, faces.mesh, reached)
        figures = {
            **faces.whole(values),
            "faces": [
                {"face": face, **row}
                for face, row in zip(faces.names, faces.figures(values), strict=True)
            ],
            "w0": float(np.average(goal, weights=frame.area)),
            "largest_w0": float(field.largest_level(surface.genus, HIGHEST)),
        }
    note = usable_level(field, surface.genus, top)[2]
    return {
        **figures,
        "asked": asked_figures(thickness),
        "isosurface": isosurface_figures(field, surface, top),
        "estimate": not (thickness.kind == "w0" and thickness.uniform),
        "notes": [*notes, note] if note else notes,
    }


def asked_figures(thickness: Thickness) -> dict[str, Any]:
    """A thickness as plain values."""
    return {
        "kind": thickness.kind,
        "value": float(thickness.value),
        "text": thickness.text,
        "factors": dict(thickness.factors),
    }


def isosurface_figures(field: HarmonicField, surface: PatchSurface, asked: float) -> dict[str, Any]:
    """Genus of the isosurface at a level beside the body's (section 3.2), for the report.

    Parameters
    ----------
    field : HarmonicField
    surface : PatchSurface
    asked : float
        The highest level that was asked for.

    Returns
    -------
    dict
        ``asked``, ``genus`` (of each part of the isosurface there), ``body`` (of each of its
        shells), ``largest_w0`` (the largest level up to the one asked with the body's genus),
        ``w0_used``.
    """
    largest, used, _ = usable_level(field, surface.genus, asked)
    return {
        "asked": float(asked),
        "genus": list(field.isosurface_genus(asked)),
        "body": sorted(surface.genus),
        "largest_w0": float(largest),
        "w0_used": float(used),
    }


def layer_heights(shell: Shell) -> list[float]:
    """Mean height of each layer across the surface, weighted by its area, outermost first, mm."""
    frame = column_frame(shell.surface)
    mesh = shell.surface.triangulation("greville")
    w = bspline.breakpoints(shell.knots_w)
    points = evaluate_columns(shell, mesh.vertex_patch, mesh.vertex_uv, w)
    return [
        float(np.average(frame.mean_normal_length(step), weights=frame.area))
        for step in np.diff(points, axis=0)
    ]


class _Faces:
    """Means and extremes over each CAD face."""

    def __init__(self, surface: PatchSurface, cells: int) -> None:
        self.mesh = surface.triangulation(cells)
        names = [patch.face for patch in surface.patches]
        self.names = list(dict.fromkeys(names))
        number = {name: k for k, name in enumerate(self.names)}
        self._face = np.array([number[name] for name in names])[self.mesh.triangle_patch]
        self._area = _areas(self.mesh)

    def figures(self, values: np.ndarray) -> list[dict[str, float]]:
        """``min``, ``mean``, ``max`` of each face."""
        corners = values[self.mesh.triangles]
        count = len(self.names)
        low, high = np.full(count, np.inf), np.full(count, -np.inf)
        np.minimum.at(low, self._face, corners.min(axis=1))
        np.maximum.at(high, self._face, corners.max(axis=1))
        # a face that has shrunk to a line has no area
        area = np.maximum(self._area, 1e-12 * self._area.max())
        mean = np.bincount(self._face, area * corners.mean(axis=1), count)
        mean /= np.bincount(self._face, area, count)
        return [
            {"min": float(a), "mean": float(b), "max": float(c)}
            for a, b, c in zip(low, mean, high, strict=True)
        ]

    def whole(self, values: np.ndarray) -> dict[str, float]:
        """``min``, ``mean``, ``max`` of all."""
        corners = values[self.mesh.triangles]
        return {
            "min": float(corners.min()),
            "mean": float(np.average(corners.mean(axis=1), weights=self._area)),
            "max": float(corners.max()),
        }


def _reasons(
    shell: Shell,
    thickness: Thickness,
    frame: ColumnFrame,
    faces: Sequence[str],
    used: float,
) -> list[str]:
    """Why each face is thinner than asked, by what holds back most of what is missing."""
    level, goal = _levels(shell)
    missing = frame.area * np.maximum(1.0 - level / np.maximum(goal, 1e-12), 0.0)
    # an edge also holds the columns beside it
    margin = frame.smooth(frame.margin, 2, least=True)
    thin = (goal >= DEEPEST * (1.0 - 1e-9)) & (thickness.kind != "w0")
    torn = ~thin & (goal > used * (1.0 + NEAR))
    sharp = ~thin & ~torn & (margin < SHARP)
    told = {
        "the body is too thin there": thin,
        "isosurfaces farther in have another genus": torn,
        "sharp edge": sharp,
        "no room for valid elements": ~(thin | torn | sharp),
    }
    parts = np.array([np.where(chosen, missing, 0.0) for chosen in told.values()])
    points: dict[str, list[np.ndarray]] = {face: [] for face in faces}
    for patch in shell.surface.patches:
        points[patch.face].append(patch.index.ravel())
    reasons = []
    for own in map(np.concatenate, points.values()):
        weight = parts[:, own].sum(axis=1)
        if thin[own].mean() > 0.3 or (thin[own].any() and not weight.any()):
            weight[0] = np.inf
        reasons.append(list(told)[int(weight.argmax())] if weight.any() else "")
    return reasons


def _levels(shell: Shell) -> tuple[np.ndarray, np.ndarray]:
    """Level reached and asked at each control point."""
    n = len(shell.surface.control_points)
    level = shell.level if len(shell.level) == n else np.full(n, shell.w0)
    goal = shell.goal if len(shell.goal) == n else np.full(n, shell.w0_asked)
    return level, goal


def cells_along(surface: PatchSurface) -> int:
    """Squares along each knot span that figures are taken over."""
    return int(np.clip(np.sqrt(_POINTS / surface.element_count), 2, 12))


def _areas(mesh: SurfaceMesh) -> np.ndarray:
    x = mesh.vertices[mesh.triangles]
    return 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)


def _between_nodes(surface: PatchSurface, mesh: SurfaceMesh, values: np.ndarray) -> np.ndarray:
    """Values at the vertices of a mesh from those at the Greville points, bilinear between."""
    found = np.empty(len(mesh.vertices))
    stack_of, place = surface.stack_of
    number = stack_of[mesh.vertex_patch]
    for k, stack in enumerate(surface.stacks):
        members = np.flatnonzero(number == k)
        (i, s), (j, t) = (
            _bracket(bspline.greville(stack.degrees[axis], stack.knots[axis]), places)
            for axis, places in enumerate(mesh.vertex_uv[members].T)
        )
        grid, own = values[stack.index], place[mesh.vertex_patch[members]]
        low = (1.0 - s) * grid[own, i, j] + s * grid[own, i + 1, j]
        high = (1.0 - s) * grid[own, i, j + 1] + s * grid[own, i + 1, j + 1]
        found[members] = (1.0 - t) * low + t * high
    return found


def _bracket(sites: np.ndarray, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Interval of rising sites that holds each place, and how far along it, in [0, 1]."""
    i = np.clip(np.searchsorted(sites, places, side="right") - 1, 0, len(sites) - 2)
    width = np.maximum(sites[i + 1] - sites[i], np.finfo(float).tiny)
    return i, np.clip((places - sites[i]) / width, 0.0, 1.0)
