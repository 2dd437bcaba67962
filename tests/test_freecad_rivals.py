# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies written for other meshers: the same faces, oriented outward, around the same volume."""

import bodies
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.errors import SetupError
from HybridVolume.reproduce import rivals

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Part


@pytest.mark.parametrize("name", ["box", "torus", "hollow_sphere"])
def test_bodies_are_written_with_faces_that_look_outward(name, tmp_path):
    body = getattr(bodies, name)()
    path = tmp_path / "body.brep"
    rivals.write_brep(build_surface(list(body.faces)), path)
    shape = Part.Shape()
    shape.read(str(path))
    (solid,) = shape.Solids
    assert solid.Volume == pytest.approx(body.volume, rel=1e-6)
    assert len(solid.Faces) == len(body.faces)
    step = 1e-3 * solid.BoundBox.DiagonalLength
    for face in solid.Faces:
        low, high, left, right = face.ParameterRange
        u, v = 0.5 * (low + high), 0.5 * (left + right)
        # of the surface itself: gmsh does not ask whether a face is reversed
        surface = face.Surface
        point, normal = surface.value(u, v), surface.normal(u, v)
        assert not solid.isInside(point + normal * step, 1e-9, False)
        assert solid.isInside(point - normal * step, 1e-9, False)
