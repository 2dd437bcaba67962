# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The one door to all midstructures: which kind, how it is found, what the user decided."""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np

from ...errors import InputError
from ..surface import PatchSurface
from .sheets import Decision, Midstructure

METHODS = ("auto", "medial-axis", "skeleton", "distance", "own")
"""``auto`` takes the medial axis; ``own`` is geometry that the user gives."""

SAMPLES = (1000, 200_000)
ANGLES = (60.0, 179.0)
SIZES = (0.0, 1000.0)


@dataclass(frozen=True)
class Search:
    """What a user can choose about the midstructure.

    Attributes
    ----------
    method : str
        One of :data:`METHODS`.
    samples : int
        Surface samples aimed at; 0 chooses by the body.
    angle : float
        Smallest object angle of what a medial axis keeps automatically, degrees.
    minimum_size : float
        Smallest area of a part that a medial axis keeps automatically, in squares of its distance
        to the surface.
    depth : str
        Of a distance surface: a share of the largest distance such as ``"50%"``, or mm such as
        ``"2.5 mm"`` or ``"2.5"``.
    decisions : tuple of str
        See :class:`Decision`.

    Raises
    ------
    InputError
        A value is out of its range.
    """

    method: str = "auto"
    samples: int = 0
    angle: float = 125.0
    minimum_size: float = 1.0
    depth: str = "50%"
    decisions: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise InputError(
                f"{self.method!r} is no kind of midstructure",
                remedy=f"choose one of {', '.join(METHODS)}",
            )
        low, high = SAMPLES
        if self.samples != 0 and not low <= self.samples <= high:
            raise InputError(
                f"samples is {self.samples}",
                remedy=f"choose a number from {low} to {high}, or 0 for the default",
            )
        for name, value, (low, high) in (
            ("angle", self.angle, ANGLES),
            ("minimum size", self.minimum_size, SIZES),
        ):
            if not low <= value <= high:
                raise InputError(
                    f"{name} is {value:g}", remedy=f"choose a value from {low:g} to {high:g}"
                )
        parse_depth(self.depth)
        for decision in self.decisions:
            Decision.parse(decision)


def parse_depth(text: str) -> tuple[float, bool]:
    """Read a depth.

    Returns
    -------
    value : float
        mm, or a share in (0, 1).
    share : bool

    Raises
    ------
    InputError
        It is neither a share nor a length.
    """
    found = re.fullmatch(r"\s*([0-9]*\.?[0-9]+(?:[eE][-+]?[0-9]+)?)\s*(%|mm|)\s*", text)
    value = float(found[1]) if found else 0.0
    share = bool(found) and found[2] == "%"
    if value <= 0.0 or (share and value >= 100.0):
        raise InputError(
            f"{text!r} is no depth", remedy='give a share such as "50%" or a length such as "2 mm"'
        )
    return (value / 100.0 if share else value), share


def find_midstructure(
    surface: PatchSurface,
    search: Search | None = None,
    own: tuple[np.ndarray, np.ndarray] | None = None,
) -> Midstructure:
    """Find the midstructure of a body, and apply the user's decisions to it.

    Parameters
    ----------
    surface : PatchSurface
    search : Search, optional
    own : (vertices (m, 3), facets (f, 3)), optional
        The geometry for the method ``own``, mm; a facet with equal corners is a line or a point.

    Returns
    -------
    Midstructure
        Without kept facets only where the decisions remove all.

    Raises
    ------
    InputError
        The user's geometry is missing or not inside the body, or the depth is too large.
    FaultError
        The samples show no interior at all.
    """
    search = search or Search()
    if search.method == "own":
        from .own import own_midstructure

        if own is None:
            raise InputError(
                "no geometry is given for the midstructure",
                remedy="name points, wires or faces inside the body, or use another method",
            )
        found = own_midstructure(surface, *own)
    elif search.method == "skeleton":
        from .skeleton import curve_skeleton

        found = curve_skeleton(surface, search.samples)
    elif search.method == "distance":
        from .distance import distance_surface

        found = distance_surface(surface, *parse_depth(search.depth))
    else:
        from .medial_axis import medial_axis

        found = medial_axis(surface, search.samples)
    return found.choose(
        angle=search.angle, minimum_size=search.minimum_size, decisions=search.decisions
    )
