# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Adapter of netgen (LGPL): keeps the boundary exactly, says by zero tetrahedra that it failed."""

from __future__ import annotations

import numpy as np


def fill(
    vertices: np.ndarray,
    triangles: np.ndarray,
    facets: np.ndarray,
    max_size: float | None = None,
    grading: float | None = None,
    optimise: bool = True,
) -> tuple[np.ndarray, np.ndarray]:
    """Fill a closed surface; ``facets`` become faces inside.

    Returns
    -------
    vertices : (n, 3) array
    tets : (m, 4) int array
        Orientation as netgen gives it.
    """
    from netgen import meshing

    mesh = meshing.Mesh(dim=3)
    outer = mesh.Add(meshing.FaceDescriptor(surfnr=1, domin=1, domout=0, bc=1))
    mesh.AddPoints(np.ascontiguousarray(vertices, dtype=np.float64))
    mesh.AddElements(2, outer, np.ascontiguousarray(triangles, dtype=np.int32), base=0)
    if len(facets):
        inner = mesh.Add(meshing.FaceDescriptor(surfnr=2, domin=1, domout=1, bc=2))
        mesh.AddElements(2, inner, np.ascontiguousarray(facets, dtype=np.int32), base=0)
    parameters = {"optsteps3d": 5 if optimise else 1}
    if max_size is not None:
        # netgen's size is generous with triangles as input: measured edges are 1.5 times as long
        parameters["maxh"] = max_size / 1.5
    if grading is not None:
        parameters["grading"] = grading
    mesh.GenerateVolumeMesh(mp=meshing.MeshingParameters(**parameters))
    tets = np.asarray(mesh.Elements3D().NumPy()["nodes"][:, :4], dtype=np.int64) - 1
    # a copy: netgen's arrays are views of memory that goes with the mesh
    return np.array(mesh.Coordinates(), dtype=float), tets
