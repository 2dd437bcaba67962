# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Facets of the midstructure and the sheets that they form."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Sheet:
    """One sheet: connected facets between the same two parts of the surface.

    Attributes
    ----------
    faces : (str, str)
        The CAD faces that most of its facets lie between.
    area : float
        mm².
    radius : (float, float)
        Smallest and largest distance to the surface, mm.
    angle : (float, float)
        Smallest and largest object angle, degrees: 180 between parallel faces, 90 at the edge of
        a box.
    kept : bool
    reason : str
        Why it is kept or not.
    seed : (float, float, float)
        A point on it, near the middle, that finds it again after a recompute, mm.
    """

    faces: tuple[str, str]
    area: float
    radius: tuple[float, float]
    angle: tuple[float, float]
    kept: bool
    reason: str
    seed: tuple[float, float, float]


@dataclass(frozen=True)
class Midstructure:
    """Triangles half-way between opposite parts of the surface.

    Attributes
    ----------
    vertices : (m, 3) array
        mm.
    facets : (f, 3) int array
    sheet : (f,) int array
        Sheet of each facet.
    kept : (f,) bool array
        Whether the harmonic field is 1 there.
    radius : (m,) array
        Distance of each vertex to the surface, mm.
    sheets : tuple of Sheet
    method : str
    """

    vertices: np.ndarray
    facets: np.ndarray
    sheet: np.ndarray
    kept: np.ndarray
    radius: np.ndarray
    sheets: tuple[Sheet, ...]
    method: str = "medial-axis"

    @property
    def facet_areas(self) -> np.ndarray:
        """Area of each facet, (f,), mm²."""
        x = self.vertices[self.facets]
        return 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1)

    @property
    def area(self) -> float:
        """Area of the kept facets, mm²."""
        return float(self.facet_areas[self.kept].sum())

    @property
    def kept_sheets(self) -> int:
        """Number of kept sheets."""
        return sum(sheet.kept for sheet in self.sheets)
