# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How fine the finite element mesh is wanted: along the faces, and through the shell."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ..errors import InputError

NODES = ("knots", "greville")
PARTS = (1, 64)
"""Parts of a cell's side that may be asked for."""
LAYERS = (0, 100)
"""Layers of wedges that may be asked for; 0 is by itself."""
GROWTHS = (1.0, 3.0)
"""Growths of the layers that may be asked for."""
GRADATIONS = (0.01, 10.0)
"""Gradations of the sizes at faces that may be asked for."""


@dataclass(frozen=True)
class Density:
    """Wanted density of a finite element mesh.

    Attributes
    ----------
    nodes : {"knots", "greville"}
        Where grid lines stand in any case. Greville abscissae are the paper's nodes, and are
        neither cut nor given a size.
    subdivide : int
        Into how many parts each cell's sides are cut at least.
    size : float
        Largest edge along the faces that is wanted, mm; 0: as the cells are.
    face_sizes : mapping of str to float
        The same near CAD faces, mm.
    gradation : float
        By how many mm the size grows a mm away from a face of its own size.
    layers : int
        Layers of wedges through the shell; 0: the shell's own where nothing is cut, else so many
        that the outermost is about a fifth of an edge's length, and never less than an eighth.
    growth : float
        Height of each layer over that of the one outside of it; 1: equal ones.

    Raises
    ------
    InputError
        A value is out of its range.
    """

    nodes: str = "knots"
    subdivide: int = 1
    size: float = 0.0
    face_sizes: Mapping[str, float] = field(default_factory=dict)
    gradation: float = 0.5
    layers: int = 0
    growth: float = 1.3

    def __post_init__(self) -> None:
        if self.nodes not in NODES:
            raise InputError(f"nodes is {self.nodes!r}", remedy=f"choose one of {', '.join(NODES)}")
        for name, (low, high), what in (
            ("subdivide", PARTS, "parts of a cell"),
            ("layers", LAYERS, "layers of wedges"),
            ("growth", GROWTHS, "the growth of the layers"),
            ("gradation", GRADATIONS, "the gradation"),
        ):
            value = getattr(self, name)
            if not low <= value <= high:
                raise InputError(
                    f"{what}: {value:g}", remedy=f"choose a value from {low:g} to {high:g}"
                )
        for face, size in {"": self.size, **self.face_sizes}.items():
            if not 0.0 <= size < np.inf or (face and not size):
                at = f" at {face}" if face else ""
                raise InputError(
                    f"the size of elements{at} is {size:g} mm",
                    faces=[face] if face else (),
                    remedy="choose a length above 0 mm",
                )
        if self.nodes == "greville" and (self.size or self.face_sizes):
            raise InputError(
                "nodes at the Greville abscissae have no size",
                remedy="choose nodes at the knots, or give no size",
            )

    @property
    def plain(self) -> bool:
        """Whether the mesh has the cells and layers of the shell, and no others."""
        return self.subdivide == 1 and not (self.size or self.face_sizes or self.layers)


def parse_size(text: str) -> tuple[str, float]:
    """Read the size of elements at a face, e.g. ``"Face3 = 0.5"`` or ``"Face3 = 0.5 mm"``.

    Raises
    ------
    InputError
        It is none, or out of its range.
    """
    found = re.fullmatch(r"\s*([^\s=:]+)\s*[=:]\s*([^\s=:]+?)\s*(mm)?\s*", text)
    try:
        size = float(found[2]) if found else np.nan
    except ValueError:
        size = np.nan
    if np.isnan(size):
        raise InputError(
            f"{text!r} is no size of elements at a face", remedy='write it as "Face3 = 0.5"'
        )
    return found[1], Density(face_sizes={found[1]: size}).face_sizes[found[1]]


def parse_sizes(texts: Sequence[str]) -> dict[str, float]:
    """Read the sizes at several faces, each as for :func:`parse_size`.

    Raises
    ------
    InputError
        One cannot be read, is out of its range, or a face has two.
    """
    sizes: dict[str, float] = {}
    for face, size in map(parse_size, texts):
        if sizes.setdefault(face, size) != size:
            raise InputError(
                f"{face} has the sizes {sizes[face]:g} and {size:g} mm",
                faces=[face],
                remedy="leave one of them",
            )
    return sizes
