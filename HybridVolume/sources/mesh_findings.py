# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What is in a mesh file, and which schemes can take it: what one wants to know before choosing."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from ..core.catmull_clark import default_steps
from ..core.polygons import SHARP, PolygonMesh
from ..errors import InputError
from .meshes import SCHEMES, Surfacing, chosen_scheme, edge_turns, named_bodies
from .polygon_files import read_polygons

_CORNERS = {3: "triangle", 4: "quad", 5: "pentagon", 6: "hexagon"}


@dataclass(frozen=True)
class MeshFindings:
    """A mesh file looked at before its scheme is chosen.

    Attributes
    ----------
    name : str
        Of the file.
    mesh : PolygonMesh or None
        As the file has it; None where it cannot be read.
    bodies : dict
        The closed bodies by their names; empty where every scheme refuses the mesh.
    refusals : dict of str to str
        Schemes that do not take it, and why.
    """

    name: str
    mesh: PolygonMesh | None
    bodies: dict[str, PolygonMesh] = field(default_factory=dict)
    refusals: dict[str, str] = field(default_factory=dict)

    @property
    def scheme(self) -> str:
        """The scheme to begin with; empty where there is none."""
        usable = [scheme for scheme in SCHEMES[1:] if scheme not in self.refusals]
        if self.mesh is None or not usable:
            return ""
        first = chosen_scheme(self.mesh, Surfacing())
        return first if first in usable else usable[0]

    @property
    def refusal(self) -> str:
        """Why no scheme takes the mesh; empty where one does."""
        return "" if self.scheme else next(iter(self.refusals.values()))

    @property
    def lines(self) -> list[str]:
        """What the file has, in a few sentences."""
        mesh = self.mesh
        if mesh is None:
            return []
        sizes, counts = np.unique(mesh.sizes, return_counts=True)
        kinds = ", ".join(
            _count(int(n), _CORNERS.get(int(size), f"face of {size} corners"))
            for size, n in sorted(zip(sizes, counts, strict=True), key=lambda row: -row[1])
        )
        extent = " x ".join(f"{x:.4g}" for x in np.ptp(mesh.vertices, axis=0))
        lines = [
            f"{_count(len(mesh.vertices), 'vertex')}, {_count(len(mesh), 'face')}: {kinds}",
            f"{extent} mm (the file has no unit: its numbers are taken as mm)",
        ]
        if len(mesh.creases):
            semi = int(np.count_nonzero((mesh.sharpness > 0.0) & (mesh.sharpness < SHARP)))
            some = f", {semi} of them semi-sharp" if semi else ""
            lines.append(f"{_count(len(mesh.creases), 'crease')} named in the file{some}")
        if len(mesh.points):
            lines.append(f"{_count(len(mesh.points), 'sharp vertex')} named in the file")
        if len(self.bodies) > 1:
            lines.append(f"{len(self.bodies)} bodies: each becomes an object")
        return lines

    @property
    def notes(self) -> list[str]:
        """What was mended."""
        return list(dict.fromkeys(note for part in self.bodies.values() for note in part.notes))

    def sharper(self, angle: float) -> int:
        """How many edges turn by more than an angle, degrees."""
        return int(np.count_nonzero(self._turns > angle))

    def quads(self, scheme: str, steps: int | None) -> int:
        """How many quads a scheme makes patches of, after its subdivisions."""
        return sum(_quads(part, scheme, steps) for part in self.bodies.values())

    @cached_property
    def _turns(self) -> np.ndarray:
        found = [edge_turns(part)[1] for part in self.bodies.values()]
        return np.concatenate([np.zeros(0), *found])


def examine(path: str | os.PathLike) -> MeshFindings:
    """Look at a mesh file; what is wrong with it is among the findings.

    Parameters
    ----------
    path : path
        OBJ, OFF or PLY.
    """
    path = Path(path)
    try:
        mesh = read_polygons(path)
    except InputError as error:
        return MeshFindings(path.name, None, {}, dict.fromkeys(SCHEMES[1:], error.line))
    refusals: dict[str, str] = {}
    try:
        bodies = named_bodies(mesh, "catmull-clark", path.stem)
    except InputError as error:
        return MeshFindings(path.name, mesh, {}, dict.fromkeys(SCHEMES[1:], error.line))
    try:
        _ = mesh.quads
        named_bodies(mesh, "bilinear", path.stem)
    except InputError as error:
        refusals["bilinear"] = error.line
    return MeshFindings(path.name, mesh, bodies, refusals)


def _quads(mesh: PolygonMesh, scheme: str, steps: int | None) -> int:
    if scheme == "bilinear":
        return len(mesh)
    if steps is None:
        steps = default_steps(mesh) if scheme == "catmull-clark" else 0
    if (mesh.sizes != 4).any():
        steps = max(steps, 1)
    # the first makes a quad of each corner, the others four of each quad
    return len(mesh.corners) * 4 ** (steps - 1) if steps else len(mesh)


def _count(number: int, one: str) -> str:
    many = one.replace("vertex", "vertices") if one.endswith("vertex") else f"{one}s"
    if one.startswith("face of"):
        many = one.replace("face", "faces", 1)
    return f"{number} {one if number == 1 else many}"
