# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What ``./run.sh reproduce quads`` works on: quad meshes, cages, and bodies made here."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from HybridVolume.core.polygons import PolygonMesh
from HybridVolume.core.quad_layout import quad_layout
from HybridVolume.core.surface import SplineFace

WHOLE, SHELL = "whole", "shell"


@dataclass(frozen=True)
class Input:
    """One row of the table of inputs.

    Attributes
    ----------
    name : str
    file : str
        Name of the mesh file.
    scheme : {"bilinear", "catmull-clark", "smooth"}
    way : {"whole", "shell"}
        Up to the finite element mesh and all files, or the shell only.
    """

    name: str
    file: str
    scheme: str
    way: str = WHOLE


INPUTS = (
    Input("ant_smooth", "ant.obj", "smooth", SHELL),
    Input("rod_smooth", "rod.obj", "smooth"),
    Input("ant_bilinear", "ant.obj", "bilinear"),
    Input("fandisk_quads_bilinear", "fandisk_quads.obj", "bilinear"),
    Input("fandisk_quads_dense_bilinear", "fandisk_quads_dense.off", "bilinear"),
    Input("fish", "fish.obj", "catmull-clark"),
    Input("rod_bilinear", "rod.obj", "bilinear"),
    Input("bitorus_smooth", "bitorus.off", "smooth"),
    Input("bitorus_bilinear", "bitorus.off", "bilinear"),
    Input("polycube_smooth", "polycube.off", "smooth"),
    Input("polycube_bilinear", "polycube.off", "bilinear"),
    Input("osd_toroidal_tet", "osd_toroidal_tet.obj", "catmull-clark"),
    Input("osd_torus_creases0", "osd_torus_creases0.obj", "catmull-clark"),
    Input("osd_cube_creases0", "osd_cube_creases0.obj", "catmull-clark"),
    Input("osd_cube", "osd_cube.obj", "catmull-clark"),
)
"""Inputs that go the way to a volume, the longest first."""

SURFACES = (
    "ant.obj", "rod.obj", "bitorus.off", "polycube.off", "fandisk_quads.obj",
    "fandisk_quads_dense.off", "fish.obj", "osd_cube.obj", "osd_cube_creases0.obj",
    "osd_torus_creases0.obj", "osd_toroidal_tet.obj",
)  # fmt: skip
"""Meshes whose surfaces are measured, by both smooth schemes."""

MANY = "ant.obj"
"""The mesh with thousands of patches."""

VALENCES = tuple(range(3, 13))
"""Of the spindles whose smooth surfaces are measured."""


def mesh_files(folders: Sequence[str | Path]) -> dict[str, Path]:
    """Files of the inputs by their names, as far as they are in some folders.

    Parameters
    ----------
    folders : sequence of path
        Folders that are searched, or files.
    """
    wanted = {one.file for one in INPUTS} | set(SURFACES)
    found: dict[str, Path] = {}
    for folder in map(Path, folders):
        files = sorted(folder.rglob("*")) if folder.is_dir() else [folder]
        for file in files:
            if file.name in wanted and file.is_file():
                found.setdefault(file.name, file.resolve())
    return found


def spindle(valence: int) -> tuple[np.ndarray, list[list[int]]]:
    """A body of quads with two vertices of a valence, all others of valence three.

    Returns
    -------
    vertices : (2 valence + 2, 3) array
        mm.
    faces : list of lists of int
    """
    n = valence
    angle = np.pi * np.arange(2 * n) / n
    ring = np.column_stack(
        [1.5 * np.cos(angle), 1.5 * np.sin(angle), 0.15 * (-1.0) ** np.arange(2 * n)]
    )
    ends = [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]
    faces = []
    for k in range(0, 2 * n, 2):
        faces.append([2 * n, k, k + 1, (k + 2) % (2 * n)])
        faces.append([2 * n + 1, (k + 3) % (2 * n), (k + 2) % (2 * n), k + 1])
    return np.concatenate([ring, ends]), faces


def torus_cage(around: int, across: int) -> tuple[np.ndarray, list[list[int]]]:
    """A torus of ``around * across`` quads, radii 3 and 1 mm, as vertices and faces."""
    u, v = np.meshgrid(
        2.0 * np.pi * np.arange(around) / around,
        2.0 * np.pi * np.arange(across) / across,
        indexing="ij",
    )
    radius = 3.0 + np.cos(v)
    vertices = np.stack([radius * np.cos(u), radius * np.sin(u), np.sin(v)], axis=-1)
    at = np.arange(around * across).reshape(around, across)
    next_u, next_v = np.roll(at, -1, axis=0), np.roll(at, -1, axis=1)
    both = np.roll(next_u, -1, axis=1)
    return vertices.reshape(-1, 3), np.stack([at, next_u, both, next_v], axis=-1).reshape(
        -1, 4
    ).tolist()


def obj_text(vertices: np.ndarray, faces: Sequence[Sequence[int]]) -> str:
    """The text of an OBJ file."""
    lines = ["v {:.17g} {:.17g} {:.17g}".format(*row) for row in np.asarray(vertices).tolist()]
    lines += ["f " + " ".join(str(v + 1) for v in face) for face in faces]
    return "\n".join(lines) + "\n"


def joined_bilinear(mesh: PolygonMesh) -> list[SplineFace]:
    """The bilinear surface of a quad mesh in as few patches as its layout has.

    The same points, the same spans, the same surface as one patch a quad: only the number of
    patches differs.

    Parameters
    ----------
    mesh : PolygonMesh
        Closed, of quads.
    """
    faces = []
    for number, grid in enumerate(quad_layout(mesh.quads).grids):
        knots = tuple(
            np.concatenate([[0.0], np.arange(count), [count - 1.0]]) for count in grid.shape
        )
        faces.append(
            SplineFace(
                name=f"Face{number + 1}",
                degrees=(1, 1),
                knots=knots,
                control_points=mesh.vertices[grid],
                weights=np.ones(grid.shape),
            )
        )
    return faces
