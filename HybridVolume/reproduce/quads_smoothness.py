# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How smooth the surfaces of quad meshes are: normals at 50 places of every side."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from HybridVolume.core.catmull_clark import catmull_clark
from HybridVolume.core.polygon_repair import bodies, mended
from HybridVolume.core.polygons import PolygonMesh
from HybridVolume.core.smooth_quads import smooth_quads
from HybridVolume.sources.polygon_files import read_polygons

from .quads_inputs import spindle
from .quads_limit import refined_cage
from .quads_pieces import SharedSides, pieces_of, shared_sides

SMOOTH = 1e-6
"""Angle between normals below which a side is smooth, rad."""


def make(task: Mapping[str, Any]) -> dict[str, Any]:
    """Figures of one surface.

    Parameters
    ----------
    task : mapping
        ``scheme``, and ``file`` or ``spindle`` (a valence).

    Returns
    -------
    dict
        ``angle`` is the largest between normals at sides that are not creases, ``told`` what the
        program itself says of it, rad; ``valences`` has for each number of sides at a vertex how
        many such vertices there are and the largest angle at sides that end there.
    """
    if "spindle" in task:
        mesh = PolygonMesh.of(*spindle(int(task["spindle"])))
    else:
        mesh = read_polygons(task["file"])
    (cage,) = bodies(mended(mesh, cage=True), cage=True)
    made: Any
    if task["scheme"] == "smooth":
        made, steps = smooth_quads(cage), int((cage.sizes != 4).any())
    else:
        made = catmull_clark(cage)
        steps = made.steps
    pieces = pieces_of(made.faces)
    sides = shared_sides(pieces)
    sharp = _sharp(cage, steps, sides, 1e-9 * pieces.diagonal)
    if task["scheme"] == "smooth":
        sharp[:] = False
    angle = sides.angle.max(axis=1)
    return {
        "scheme": task["scheme"],
        "quads": made.quads,
        "patches": len(made.faces),
        "pieces": len(pieces.nets),
        "sides": len(angle),
        "creases": int(np.count_nonzero(sharp)),
        "open_sides": sides.open,
        "angle": float(angle[~sharp].max(initial=0.0)),
        "told": made.normal_jump,
        "valences": _by_valence(sides, angle, sharp),
    }


def _sharp(cage: PolygonMesh, steps: int, sides: SharedSides, reach: float) -> np.ndarray:
    """Sides whose both ends are those of an edge that is still a crease, (m,) bool."""
    from scipy.spatial import cKDTree

    if not len(cage.creases):
        return np.zeros(len(sides.angle), dtype=bool)
    fine = refined_cage(cage, steps)
    ends = fine.limit()[fine.edges[fine.sharpness >= 0.5]]
    if not len(ends):
        return np.zeros(len(sides.angle), dtype=bool)
    # the sum of both ends and their distance tell an edge, whichever way it runs
    middle = cKDTree(ends.mean(axis=1))
    off, row = middle.query(sides.ends.mean(axis=1))
    length = np.linalg.norm(np.diff(ends, axis=1)[:, 0], axis=1)[row]
    own = np.linalg.norm(np.diff(sides.ends, axis=1)[:, 0], axis=1)
    return (off <= reach) & (np.abs(length - own) <= reach)


def _by_valence(
    sides: SharedSides, angle: np.ndarray, sharp: np.ndarray
) -> dict[str, dict[str, Any]]:
    found = {}
    places = np.unique(sides.valence)
    for valence in places.tolist():
        here = sides.valence == valence
        chosen = here.any(axis=1) & ~sharp
        found[str(valence)] = {
            # a vertex of valence n is an end of n sides
            "vertices": int(np.count_nonzero(here)) // valence,
            "angle": float(angle[chosen].max(initial=0.0)),
        }
    return found
