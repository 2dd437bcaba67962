# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Adapter of pytetwild (fTetWild, MPL): meshes surfaces that cut themselves, within an envelope."""

from __future__ import annotations

import importlib.util
import sys
import types

import numpy as np


def fill(
    vertices: np.ndarray,
    triangles: np.ndarray,
    facets: np.ndarray,
    max_size: float | None = None,
    grading: float | None = None,
    optimise: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Tetrahedra of a surface up to 1/1000 of its diagonal. ``facets`` only attract vertices.

    Returns
    -------
    vertices : (n, 3) array
    tets : (m, 4) int array
    """
    if importlib.util.find_spec("pyvista") is None:
        # pytetwild imports it for functions that are not used here, without requiring it
        sys.modules["pyvista"] = types.ModuleType("pyvista")
    import pytetwild

    soup = np.vstack([triangles, facets]) if len(facets) else triangles
    diagonal = float(np.linalg.norm(np.ptp(vertices[np.unique(soup)], axis=0)))
    size = 0.05 * diagonal if max_size is None else min(max_size, 0.05 * diagonal)
    points, tets = pytetwild.tetrahedralize(
        np.ascontiguousarray(vertices, dtype=np.float64),
        np.ascontiguousarray(soup, dtype=np.int32),
        edge_length_abs=size,
        epsilon=1e-3,
        stop_energy=10.0 if optimise else 50.0,
        num_threads=2,
    )
    return np.asarray(points, dtype=float), np.asarray(tets, dtype=np.int64)
