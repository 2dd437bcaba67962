# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The bodies of ``./run.sh reproduce shell``, and what is demanded of each.

Lengths are mm.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

from HybridVolume.core.surface import SplineFace
from HybridVolume.errors import HybridVolumeError

from .bodies import box, cylinder, prism, ring, sphere, torus, wedge

Faces = tuple[SplineFace, ...]


@dataclass(frozen=True)
class Demand:
    """What a body's shells are measured against.

    Attributes
    ----------
    group : str
        Heading in the table.
    near : float
        Largest deviation of the mean level from the level asked, as a share of it, up to .5.
    thinner : bool
        Whether only a level below the one asked counts as a deviation.
    least : float
        Smallest scaled Jacobian at .5.
    share : float
        The same as a share of the bound that the surface sets.
    shapely : float
        Smallest scaled Jacobian at .5 where shape goes before the level; 0: not asked.
    refused : bool
        Whether the body has to be refused by name, with the places.
    if_read : bool
        Whether nothing is demanded where the reader refuses the body by name.
    """

    group: str
    near: float
    thinner: bool = False
    least: float = 0.0
    share: float = 0.0
    shapely: float = 0.0
    refused: bool = False
    if_read: bool = False


SHARP, ROUND, SPLINES, PARTS, FOLDED = (
    "straight faces, sharp edges",
    "rational",
    "splines",
    "parts",
    "cannot be followed",
)

DEMANDS: dict[str, Demand] = {
    "box": Demand(SHARP, 0.1, least=0.45, shapely=0.4),
    "box_coarse": Demand(SHARP, 0.1, least=0.45),
    "L": Demand(SHARP, 0.1, least=0.30, shapely=0.4),
    "plate": Demand(SHARP, 0.1, least=0.15, shapely=0.4),
    "plate_50": Demand(SHARP, 0.1, least=0.15, shapely=0.4),
    "wedge_30": Demand(SHARP, 0.1, share=0.5),
    "sphere": Demand(ROUND, 0.03, least=0.8),
    "torus": Demand(ROUND, 0.03, least=0.8),
    "cylinder": Demand(ROUND, 0.03),
    "ring": Demand(ROUND, 0.03),
    "pole": Demand(ROUND, 0.03),
    "horseshoe": Demand(ROUND, 0.03),
    "twisted_fichera": Demand(SPLINES, 0.1, least=0.15),
    "chair_stand": Demand(SPLINES, 0.1, least=0.30),
    "twisted_pipe": Demand(SPLINES, 0.1, share=0.5),
    "moebius_torus": Demand(SPLINES, 0.1, share=0.5, if_read=True),
    "terrific_part_02": Demand(PARTS, 0.2, thinner=True, share=0.6),
    "fandisk": Demand(PARTS, 0.2, thinner=True, share=0.6),
    "g_shape": Demand(FOLDED, 0.0, refused=True),
    "g_shape_lines": Demand(FOLDED, 0.1),
}
"""By the body's name; bodies of files are found by the name of their file."""

SINGULAR_LINES = {"singular_lines": True}
OPTIONS = {"horseshoe": SINGULAR_LINES}
"""Options that bodies need besides those that all have; the tables tell them."""
VARIANTS = {"g_shape_lines": ("g_shape", SINGULAR_LINES)}
"""Further rows: a body once more, with options."""

LARGE_SHARE = 0.6
"""Least mean level at .7 and .9, as a share of the level asked."""
RANDOM_ALLOWED = 1
"""Random bodies that may stay without a shell at .5, if they are named."""
SPEED_BODY = "fandisk"
SECONDS = {"gmsh": 8.0, "netgen": 15.0}
"""Field, front, untangling, certificate and test for crossings of that body, by its mesher."""
RIVALS_FILE = "body.brep"
"""The body for other meshers, in the job's folder."""


@dataclass(frozen=True)
class Made:
    """A body that is made here.

    Attributes
    ----------
    name : str
    words : str
        What it is.
    faces : callable
        Makes the faces.
    split : int
        Parts that each knot span is cut into, in both directions.
    """

    name: str
    words: str
    faces: Callable[[], Faces]
    split: int = 1


def no_shell(error: HybridVolumeError) -> dict[str, Any]:
    """Figures of a case without a shell, under the names of shell.json."""
    return {
        **dict.fromkeys(("w0", "w0_rms", "min_scaled_jacobian", "min_bernstein", "bound")),
        **dict.fromkeys(("elements", "valid", "undecided", "invalid"), 0),
        "embedded": False,
        "notes": [],
        "error": error.to_dict(),
    }


def made_bodies() -> list[Made]:
    """Bodies whose form is plain from their names."""
    return [
        Made("box", "3 x 2 x 1, 352 spans", lambda: box((3.0, 2.0, 1.0), (12, 8, 4))),
        Made("box_coarse", "3 x 2 x 1, 88 spans", lambda: box((3.0, 2.0, 1.0), (6, 4, 2))),
        Made("L", "three unit cubes", _bracket),
        Made("plate", "20 x 20 x 1", lambda: box((20.0, 20.0, 1.0), (16, 16, 2))),
        Made("plate_50", "50 x 50 x 1", lambda: box((50.0, 50.0, 1.0), (16, 16, 2))),
        Made("wedge_30", "triangular prism with an edge of 30°", lambda: wedge(30.0, 4)),
        Made("sphere", "six rational patches of degree 4", lambda: sphere(1.0), 4),
        Made("torus", "radii 3 and 1, rational", lambda: torus(3.0, 1.0), 2),
        Made("cylinder", "radius 1, height 6, rational", lambda: cylinder(1.0, 6.0), 3),
        Made("ring", "radii 2 and 3, height 3, rational", lambda: ring(2.0, 3.0, 3.0), 3),
    ]


def _bracket() -> Faces:
    squares = [
        [(x, y), (x + 1, y), (x + 1, y + 1), (x, y + 1)] for x, y in ((0, 0), (1, 0), (0, 1))
    ]
    return prism(squares, 1.0, 5)


def random_bodies() -> Iterator[Made]:
    """The random bodies, of fixed seeds."""
    from . import random_bodies as bodies

    for name in bodies.BODIES:
        yield Made(name, "random", lambda name=name: tuple(bodies.build(name)))
