# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies from polygon meshes: the mesh becomes patches by a scheme, and these a FreeCAD solid."""

from __future__ import annotations

import logging
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..core.assembly import build_surface
from ..core.catmull_clark import catmull_clark
from ..core.polygon_repair import bodies, mended
from ..core.polygons import SHARP, PolygonMesh, bilinear_faces, number_of
from ..core.quad_folds import check_quads
from ..core.smooth_quads import smooth_quads
from ..core.surface import SplineFace
from ..errors import FaultError, InputError
from ..solids import solid_of
from .polygon_files import read_polygons
from .shapes import Body, MeshOrigin, read_shape

logger = logging.getLogger(__name__)

SCHEMES = ("auto", "bilinear", "catmull-clark", "smooth")
"""Ways from a mesh to patches."""
STEPS = (0, 5)
"""Subdivisions that may be asked for."""


@dataclass(frozen=True)
class Surfacing:
    """How a mesh becomes patches.

    Attributes
    ----------
    scheme : {"auto", "bilinear", "catmull-clark", "smooth"}
        One bilinear patch a quad; the Catmull-Clark surface of a cage, with creases; or a smooth
        bicubic surface without creases. "auto": Catmull-Clark where the file has creases or other
        faces than quads, or where a sharp angle is given, else bilinear.
    steps : int or None
        Subdivisions first; None: as many as the scheme needs, and for Catmull-Clark one, or up to
        four where semi-sharp creases need more.
    sharp_angle : float
        Edges of the cage whose faces turn by more, degrees, are creases of Catmull-Clark; 0: only
        those that the file names.

    Raises
    ------
    InputError
        A value is out of its range.
    """

    scheme: str = "auto"
    steps: int | None = None
    sharp_angle: float = 0.0

    def __post_init__(self) -> None:
        if self.scheme not in SCHEMES:
            raise InputError(
                f"scheme is {self.scheme!r}", remedy=f"choose one of {', '.join(SCHEMES)}"
            )
        if self.steps is not None and not STEPS[0] <= self.steps <= STEPS[1]:
            raise InputError(
                f"{self.steps} subdivisions", remedy=f"choose {STEPS[0]} to {STEPS[1]} of them"
            )
        if not 0.0 <= self.sharp_angle < 180.0:
            raise InputError(
                f"the sharp angle is {self.sharp_angle:g} degrees",
                remedy="choose an angle from 0 to 180 degrees",
            )
        if self.sharp_angle and self.scheme in ("bilinear", "smooth"):
            raise InputError(
                f"{self.scheme} patches have no creases by angle ({self.sharp_angle:g} degrees)",
                remedy="leave the sharp angle out, or choose Catmull-Clark",
            )


def read_mesh(path: str | os.PathLike, surfacing: Surfacing | None = None) -> list[Body]:
    """Bodies of an OBJ, OFF or PLY file, one for each outer skin of its mesh.

    Parameters
    ----------
    path : path
    surfacing : Surfacing, optional

    Returns
    -------
    list of Body
        ``origin["mesh"]`` has ``scheme``, ``quads``, ``notes`` (what was mended, and how the
        patches were made) and, where the scheme knows them, ``distance`` (of the limit surface,
        mm) and ``normal_jump`` (rad).

    Raises
    ------
    InputError
        One of its kinds, naming elements of the file: it cannot be read, the mesh is not closed or
        cannot be mended, or the scheme does not take its faces.
    """
    surfacing = surfacing or Surfacing()
    path = Path(path)
    mesh = read_polygons(path)
    scheme = chosen_scheme(mesh, surfacing)
    parts = named_bodies(mesh, scheme, path.stem)
    made = replace(surfacing, scheme=scheme)
    return [
        replace(
            surfaced(part, name, made),
            mesh=MeshOrigin(path.name, part, scheme, made.steps, made.sharp_angle),
        )
        for name, part in parts.items()
    ]


def chosen_scheme(mesh: PolygonMesh, surfacing: Surfacing) -> str:
    """The scheme that is meant: for "auto" the one that the mesh, or a sharp angle, asks for."""
    if surfacing.scheme != "auto":
        return surfacing.scheme
    curved = len(mesh.creases) or len(mesh.points) or (mesh.sizes != 4).any()
    return "catmull-clark" if curved or surfacing.sharp_angle else "bilinear"


def named_bodies(mesh: PolygonMesh, scheme: str, stem: str) -> dict[str, PolygonMesh]:
    """Closed bodies of a mesh as a file has it, by their names: the stem, numbered where several.

    Parameters
    ----------
    mesh : PolygonMesh
    scheme : {"bilinear", "catmull-clark", "smooth"}
    stem : str

    Raises
    ------
    InputError
        One of its kinds: the mesh is not closed, or cannot be mended.
    """
    cage = scheme != "bilinear"
    found = bodies(mended(mesh, cage=cage), cage=cage)
    names = [stem] if len(found) == 1 else [f"{stem}_{k + 1}" for k in range(len(found))]
    return dict(zip(names, found, strict=True))


def surfaced(mesh: PolygonMesh, name: str, surfacing: Surfacing) -> Body:
    """One body of `named_bodies` by a scheme.

    Parameters
    ----------
    mesh : PolygonMesh
    name : str
    surfacing : Surfacing

    Raises
    ------
    InputError
        The scheme does not take its faces, or its patches are folded, cut each other or make no
        solid.
    """
    scheme = chosen_scheme(mesh, surfacing)
    figures: dict[str, Any] = {"scheme": scheme}
    faces: list[SplineFace]
    if scheme == "bilinear":
        if surfacing.steps:
            raise InputError(
                f"{surfacing.steps} subdivisions of bilinear patches",
                remedy="choose Catmull-Clark or smooth to subdivide",
            )
        faces, words = bilinear_faces(mesh), "one bilinear patch a quad"
        nets = np.stack([face.control_points for face in faces])
        numbers = mesh.face_number
        figures["quads"] = len(mesh)
    elif scheme == "catmull-clark":
        made = catmull_clark(_creased(mesh, surfacing.sharp_angle), surfacing.steps)
        faces, nets, numbers = list(made.faces), made.nets, made.numbers
        figures |= {
            "quads": made.quads, "distance": made.distance, "normal_jump": made.normal_jump,
            "steps": made.steps,
        }  # fmt: skip
        words = (
            f"Catmull-Clark, {number_of(made.steps, 'subdivision')}, {made.quads} quads in"
            f" {number_of(len(faces), 'patch')}, at most"
            f" {made.distance:.2g} mm from the limit surface, normals turn by"
            f" {np.degrees(made.normal_jump):.2g} degrees at most at sides"
        )
    else:
        smooth = smooth_quads(mesh, surfacing.steps or 0)
        faces, nets, numbers = list(smooth.faces), smooth.nets, smooth.numbers
        figures |= {"quads": smooth.quads, "normal_jump": smooth.normal_jump}
        words = (
            f"smooth, {smooth.quads} quads in {len(faces)} patches, normals turn by"
            f" {smooth.normal_jump:.1g} rad at most at sides"
        )
        if len(mesh.creases) or len(mesh.points):
            words += "; creases are smoothed over"
    surface = build_surface(faces)
    check_quads(surface, nets, numbers)
    try:
        (body,) = read_shape(solid_of(surface), name, cover=False)
    except FaultError as fault:
        raise InputError(
            f"the patches make no solid for FreeCAD ({fault.message})",
            remedy="look for faces of the mesh that are nearly flat or cut each other",
        ) from fault
    if body.error is None and len(body.faces) != len(faces):
        raise FaultError(f"FreeCAD has {len(body.faces)} of {len(faces)} faces")
    return replace(body, origin={**body.origin, "mesh": {**figures, "notes": [*mesh.notes, words]}})


def edge_turns(mesh: PolygonMesh) -> tuple[np.ndarray, np.ndarray]:
    """Ends (e, 2) of the edges of a mended mesh, and by how much its faces turn there, degrees."""
    ends, edge = mesh.edges
    order = np.argsort(edge, kind="stable").reshape(-1, 2)
    normal = mesh.area_vectors()
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    one, other = (normal[mesh.face_of[order[:, k]]] for k in (0, 1))
    turn = np.arctan2(np.linalg.norm(np.cross(one, other), axis=1), (one * other).sum(axis=1))
    return ends, np.degrees(turn)


def _creased(mesh: PolygonMesh, angle: float) -> PolygonMesh:
    """The cage with edges that are sharper than an angle as creases too."""
    if not angle:
        return mesh
    ends, turn = edge_turns(mesh)
    sharp = ends[turn > angle]
    return replace(
        mesh,
        creases=np.concatenate([mesh.creases, sharp]),
        sharpness=np.concatenate([mesh.sharpness, np.full(len(sharp), SHARP)]),
    )
