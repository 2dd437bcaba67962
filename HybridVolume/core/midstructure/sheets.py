# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Facets of the midstructure, the sheets that they form, and which of the sheets count."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ...errors import InputError

ACTIONS = ("keep", "remove", "only")

_NUMBER = r"[-+]?[0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?"
_SHEET = re.compile(rf"(?P<one>[^+@\s]+)\+(?P<two>[^+@\s]+)(?:@(?P<u>{_NUMBER}),(?P<v>{_NUMBER}))?")


@dataclass(frozen=True)
class Sheet:
    """One sheet: connected facets between the same two smooth parts of the surface.

    Attributes
    ----------
    faces : (str, str)
        The CAD faces that most of its facets lie between.
    area : float
        mm².
    radius : (float, float)
        Smallest and largest distance to the surface, mm.
    angle : (float, float)
        Smallest and largest object angle but for a few stray facets, degrees: 180 between parallel
        faces, 90 at the edge of a box.
    kept : bool
        Whether any facet of it is kept.
    reason : str
        Why it is kept or not.
    seed : (float, float, float)
        A point on it, near the middle, mm.
    foot : (float, float)
        Parameters in [0, 1]² of the seed's foot on ``faces[0]``: they find the sheet again after
        the body was changed. Where the face is made of many patches, see :func:`face_places`.
    at_edge : bool
        Whether it reaches the surface along a convex sharp edge.
    """

    faces: tuple[str, str]
    area: float
    radius: tuple[float, float]
    angle: tuple[float, float]
    kept: bool
    reason: str
    seed: tuple[float, float, float]
    foot: tuple[float, float] = (0.5, 0.5)
    at_edge: bool = False

    @property
    def name(self) -> str:
        """What finds the sheet again, e.g. ``Face3+Face9@0.41,0.77``."""
        return f"{'+'.join(self.faces)}@{self.foot[0]:.6g},{self.foot[1]:.6g}"


@dataclass(frozen=True)
class Decision:
    """What a user decided about a sheet.

    Attributes
    ----------
    action : {"keep", "remove", "only"}
        Where any decision says "only", sheets that no decision keeps are removed.
    faces : (str, str)
        The two CAD faces that the sheet lies between, in any order.
    at : (float, float), optional
        Parameters in [0, 1]² of a foot of the sheet on ``faces[0]``; without it every sheet
        between the two faces is meant.
    """

    action: str
    faces: tuple[str, str]
    at: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        if self.action not in ACTIONS:
            raise InputError(
                f"{self.action!r} decides nothing about a sheet",
                remedy=f"use one of {', '.join(ACTIONS)}",
            )
        if self.at is not None and not all(0.0 <= x <= 1.0 for x in self.at):
            raise InputError(
                f"{self.at[0]:g},{self.at[1]:g} is no place on {self.faces[0]}",
                faces=[self.faces[0]],
                remedy="give u,v between 0 and 1",
            )

    def __str__(self) -> str:
        place = "" if self.at is None else f"@{self.at[0]:.6g},{self.at[1]:.6g}"
        return f"{self.action} {'+'.join(self.faces)}{place}"

    @classmethod
    def parse(cls, text: str) -> Decision:
        """Read ``"remove Face3+Face9@0.41,0.77"``, as `str` writes it.

        Raises
        ------
        InputError
            The text is no decision.
        """
        action, _, sheet = text.strip().partition(" ")
        return cls.about(action, sheet)

    @classmethod
    def about(cls, action: str, sheet: str) -> Decision:
        """Decide about a sheet that is named as ``Face3+Face9[@u,v]``.

        Raises
        ------
        InputError
            The name is none of a sheet.
        """
        found = _SHEET.fullmatch(sheet.strip())
        if not found:
            raise InputError(
                f"{sheet!r} names no sheet",
                remedy="name it by its two faces, e.g. Face3+Face9 or Face3+Face9@0.4,0.7",
            )
        at = None if found["u"] is None else (float(found["u"]), float(found["v"]))
        return cls(action, (found["one"], found["two"]), at)


def face_places(faces: Sequence[str], patch: np.ndarray, uv: np.ndarray) -> np.ndarray:
    """Places on CAD faces, told apart also where a face is made of many patches.

    Parameters
    ----------
    faces : sequence of str
        CAD face of each patch.
    patch : (...) int array
    uv : (..., 2) array
        Parameters on the patches, in [0, 1].

    Returns
    -------
    (..., 2) array
        In [0, 1]. The patches of a face stand side by side along u; the same as ``uv`` where it is
        made of one.
    """
    _, face, count = np.unique(np.asarray(faces), return_inverse=True, return_counts=True)
    face = face.ravel()
    order = np.argsort(face, kind="stable")
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order)) - np.repeat(np.cumsum(count) - count, count)
    u = (rank[patch] + uv[..., 0]) / count[face[patch]]
    return np.stack([u, uv[..., 1]], axis=-1)


@dataclass(frozen=True)
class Figures:
    """What deciding about medial facets needs, computed once for all choices.

    A *cell* is one polygon of the medial axis; it is cut into triangles, the facets.

    Attributes
    ----------
    of_facet : (f,) int array
        Cell of each facet.
    patch : (c, 2) int array
        Patches of the two feet of each cell.
    foot : (c, 2, 2) array
        Their parameters (u, v) in [0, 1]², as of :func:`face_places`.
    centre : (c, 3) array
        mm.
    radius, length, angle, area, spacing : (c,) arrays
        Distance to the surface, distance of the feet, object angle (degrees), area, and local
        distance of the samples; mm, mm², degrees.
    wedge : (c,) bool array
        The cell belongs to the wedge of a convex sharp edge between its own two groups.
    ridge : (c,) bool array
        No ball near the cell is much larger.
    group : (c,) int array
        Equal for cells between the same two smooth groups of faces.
    edges : (e, 2) int array
        Pairs of cells that share a side.
    edge : (e,) int array
        Number of that side; three cells meet where it occurs three times.
    """

    of_facet: np.ndarray
    patch: np.ndarray
    foot: np.ndarray
    centre: np.ndarray
    radius: np.ndarray
    length: np.ndarray
    angle: np.ndarray
    area: np.ndarray
    spacing: np.ndarray
    wedge: np.ndarray
    ridge: np.ndarray
    group: np.ndarray
    edges: np.ndarray
    edge: np.ndarray


@dataclass(frozen=True)
class Midstructure:
    """Where the harmonic field is 1: triangles, lines and points inside the body.

    Attributes
    ----------
    vertices : (m, 3) array
        mm.
    facets : (f, 3) int array
        Triangles. A facet with two equal corners (a, b, b) is a line, with three a point.
    sheet : (f,) int array
        Sheet of each facet.
    kept : (f,) bool array
        Whether the harmonic field is 1 there.
    radius : (m,) array
        Distance of each vertex to the surface, mm.
    sheets : tuple of Sheet
        The largest first. They do not depend on what is kept.
    method : {"medial-axis", "skeleton", "distance", "own"}
    faces : tuple of str
        CAD face of each patch.
    figures : Figures, optional
        Of a medial axis.
    probe_points : (s, 3) array, optional
        Places spread over the surface, mm.
    probe_radius : (s,) array, optional
        Half the thickness of the body near each of them, mm.
    unmatched : tuple of str
        Decisions that fit no sheet.
    probe_patch : (s,) int array, optional
        Patch of each of the places.
    """

    vertices: np.ndarray
    facets: np.ndarray
    sheet: np.ndarray
    kept: np.ndarray
    radius: np.ndarray
    sheets: tuple[Sheet, ...]
    method: str = "medial-axis"
    faces: tuple[str, ...] = ()
    figures: Figures | None = None
    probe_points: np.ndarray | None = None
    probe_radius: np.ndarray | None = None
    unmatched: tuple[str, ...] = ()
    probe_patch: np.ndarray | None = None

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

    def choose(
        self,
        *,
        angle: float = 125.0,
        minimum_size: float = 1.0,
        decisions: Sequence[Decision | str] = (),
    ) -> Midstructure:
        """Return the same sheets with other ones kept: automatic first, then the decisions.

        Parameters
        ----------
        angle : float
            Smallest object angle of what is kept automatically, degrees; only of a medial axis.
        minimum_size : float
            Smallest area of a connected part that is kept automatically, in units of the square of
            its distance to the surface; only of a medial axis.
        decisions : sequence of Decision or str
            Later ones go over earlier ones. Those that fit no sheet are in ``unmatched``.

        Returns
        -------
        Midstructure
            Possibly without any kept facet, where the decisions remove all.
        """
        from .choice import choose

        return choose(self, angle, minimum_size, decisions)
