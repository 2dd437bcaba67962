# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A completed box made by hand, as the worker would answer; needs FreeCAD."""

from types import SimpleNamespace

import numpy as np
from box_mesh import box_mesh

from HybridVolume import sources
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.midstructure import Midstructure, Sheet
from HybridVolume.objects import document
from HybridVolume.objects.volume import source_fingerprint

SIZE = (3.0, 2.0, 1.0)
PARAMETERS = {
    "W0": 0.4,
    "Layers": 1,
    "Degree": 1,
    "Tolerance": 1e-7,
    "Midstructure.Method": "auto",
    "FemMesh.Order": "Second",
    "FemMesh.Density": "knots",
}
REPORT = {
    "input": {"file": "box.step"},
    "shell": {"w0": 0.4, "elements": 6, "min_scaled_jacobian": 0.5},
    "fem": {"nodes": 69},
}


def face_names(shape):
    """Names of the faces at x = 0, x = a, y = 0, ..."""
    names = []
    for axis in range(3):
        for end in (0.0, SIZE[axis]):
            names += [
                f"Face{i + 1}"
                for i, face in enumerate(shape.Faces)
                if all(abs(v.Point[axis] - end) < 1e-9 for v in face.Vertexes)
            ]
    return names


def completed(box, tmp_path, fem=None):
    (body,) = sources.read_object(box)
    sheet = Sheet(("Face5", "Face6"), 2.0, (0.5, 0.5), (180.0, 180.0), True, "", (1.5, 1.0, 0.5))
    midstructure = Midstructure(
        vertices=np.array([[1.0, 1.0, 0.5], [2.0, 1.0, 0.5], [2.0, 1.5, 0.5]]),
        facets=np.array([[0, 1, 2]]),
        sheet=np.array([0]),
        kept=np.array([True]),
        radius=np.full(3, 0.5),
        sheets=(sheet,),
    )
    result = tmp_path / "result.npz"
    np.savez(result, stored=np.arange(5.0))
    return document.Completed(
        body=body,
        solid=1,
        volume=SimpleNamespace(
            fem=fem or box_mesh(SIZE, face_names(box.Shape)),
            midstructure=midstructure,
            surface=build_surface(list(body.faces)),
        ),
        result=result,
        report=REPORT,
        parameters=PARAMETERS,
        fingerprint=source_fingerprint(box),
    )
