# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Refinement before the offset never changes the surface: measured at places of every patch.

The surfaces before and after are evaluated by SciPy's B-splines, not by ``core``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from scipy.interpolate import BSpline

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.even import Evenness, even_out, span_figures
from HybridVolume.core.polygons import PolygonMesh, bilinear_faces
from HybridVolume.core.refinement import divide_faces, flatten_spans, split_spans
from HybridVolume.core.smooth_quads import smooth_quads
from HybridVolume.core.surface import PatchSurface, SplineFace

from .quads_inputs import spindle, torus_cage

PLACES = 25
"""Random values of u, and of v, in every patch, besides the knots of the finer one."""
MOST_KNOTS = 40


def _fandisk() -> list[SplineFace]:
    from HybridVolume.freecad_python import import_freecad

    from .midstructure import EXAMPLES

    import_freecad()
    from HybridVolume.sources import read_file

    (body,) = read_file(EXAMPLES / "fandisk.step")
    return list(body.faces)


def _torus() -> list[SplineFace]:
    from .bodies import torus

    return list(torus(3.0, 1.0))


def _cylinder() -> list[SplineFace]:
    from .bodies import cylinder

    return list(cylinder(2.0, 5.0))


def _spindle() -> list[SplineFace]:
    return list(smooth_quads(PolygonMesh.of(*spindle(7))).faces)


def _quads() -> list[SplineFace]:
    return bilinear_faces(PolygonMesh.of(*torus_cage(16, 6)))


_MADE: dict[str, Callable[[], list[SplineFace]]] = {
    "fandisk": _fandisk,
    "torus": _torus,
    "cylinder": _cylinder,
    "spindle": _spindle,
    "quads": _quads,
}
BODIES = tuple(_MADE)


def refinements(surface: PatchSurface) -> dict[str, Callable[[], PatchSurface]]:
    """Ways to refine a surface, each a function that does it.

    Parameters
    ----------
    surface : PatchSurface
    """
    mean = float(np.sqrt(surface.area() / surface.element_count))
    face = surface.patches[0].face
    return {
        "size": lambda: even_out(surface, Evenness(size=0.6 * mean)),
        "aspect": lambda: even_out(surface, Evenness(aspect=2.0)),
        "turn": lambda: even_out(surface, Evenness(turn=12.0)),
        "size, aspect, turn": lambda: even_out(surface, Evenness(0.8 * mean, 3.0, 20.0)),
        "spans in three": lambda: split_spans(surface, 3),
        "a face divided": lambda: divide_faces(surface, [face]),
        "as the shell needs": lambda: flatten_spans(surface),
    }


def make(task: Mapping[str, Any]) -> dict[str, Any]:
    """Deviations of the refined surfaces of one body.

    Parameters
    ----------
    task : mapping
        ``body``, one of ``BODIES``.
    """
    surface = build_surface(_MADE[task["body"]]())
    rows, before = [], span_figures(surface)
    for name, work in refinements(surface).items():
        finer = work()
        after = span_figures(finer)
        rows.append(
            {
                "refinement": name,
                "spans": finer.element_count,
                "aspect": after.aspect,
                "turn": after.turn,
                "longest": after.longest,
                "deviation": deviation(surface, finer),
            }
        )
    return {
        "body": task["body"],
        "rational": surface.rational,
        "patches": len(surface.patches),
        "spans": surface.element_count,
        "aspect": before.aspect,
        "turn": before.turn,
        "longest": before.longest,
        "diagonal": surface.diagonal,
        "rows": rows,
    }


def deviation(one: PatchSurface, other: PatchSurface, seed: int = 7) -> float:
    """Largest distance of two surfaces of the same patches at the same parameters, mm."""
    random = np.random.default_rng(seed)
    worst = 0.0
    for k in range(len(one.patches)):
        lines = []
        for d in (0, 1):
            knots = np.unique(other.patches[k].knots[d])
            knots = knots[:: max(1, len(knots) // MOST_KNOTS)]
            lines.append(np.concatenate([random.uniform(0.0, 1.0, PLACES), knots, [1.0]]))
        gap = _points(one, k, *lines) - _points(other, k, *lines)
        worst = max(worst, float(np.linalg.norm(gap, axis=-1).max()))
    return worst


def _points(surface: PatchSurface, number: int, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Points of a patch on a grid of parameters, (nu, nv, 3)."""
    patch = surface.patches[number]
    weights = patch.weights[..., None]
    net = np.concatenate([surface.control_points[patch.index] * weights, weights], axis=-1)
    along = BSpline(patch.knots[0], net, patch.degrees[0])(u)
    across = BSpline(patch.knots[1], along.swapaxes(0, 1), patch.degrees[1])(v).swapaxes(0, 1)
    return across[..., :3] / across[..., 3:]
