# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Any surface of patches becomes a solid of untrimmed faces, and comes back the same."""

import bodies
import numpy as np
import pytest
from scipy.spatial import cKDTree

import HybridVolume
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.catmull_clark import catmull_clark
from HybridVolume.core.polygon_repair import mended
from HybridVolume.core.polygons import PolygonMesh, bilinear_faces
from HybridVolume.errors import InputError, SetupError
from HybridVolume.exports.step import write_solid
from HybridVolume.sources import read_file

try:
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

import Part

CUBE = np.array([[x, y, z] for z in (0.0, 3.0) for y in (0.0, 2.0) for x in (0.0, 1.0)])
QUADS = [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]]
CAGE = mended(PolygonMesh.of(CUBE, QUADS))


@pytest.mark.parametrize(
    "faces",
    [
        bilinear_faces(CAGE),
        catmull_clark(CAGE).faces,
        bodies.hollow_sphere().faces,
        bodies.torus().faces,
    ],
    ids=["bilinear", "Catmull-Clark", "rational, with a cavity", "genus 1"],
)
@pytest.mark.parametrize("suffix", [".step", ".brep"])
def test_what_is_written_is_what_was_there(tmp_path, faces, suffix):
    surface = build_surface(list(faces))
    path = tmp_path / f"body{suffix}"
    write_solid(path, surface)
    shape = Part.Shape()
    shape.read(str(path))
    assert shape.isValid()
    assert len(shape.Solids) == 1
    (body,) = read_file(path)
    again = build_surface(list(body.faces))
    assert (len(again.patches), again.genus) == (len(surface.patches), surface.genus)
    assert again.volume() == pytest.approx(surface.volume(), rel=1e-12)
    off, _ = cKDTree(again.control_points).query(surface.control_points)
    assert off.max() < 1e-11 * surface.diagonal
    # Face3 is the same face in both; a cavity comes after the skin
    order = np.argsort(-surface.shell_volumes()[surface.shell_of_patch], kind="stable")
    was, now = (
        [one.control_points[p.index].mean((0, 1)) for p in one.patches] for one in (surface, again)
    )
    assert np.array(now) == pytest.approx(np.array(was)[order], abs=1e-11 * surface.diagonal)


@pytest.mark.parametrize("name", ["box", "torus", "hollow_sphere"])
def test_bodies_are_written_with_faces_that_look_outward(name, tmp_path):
    body = getattr(bodies, name)()
    path = tmp_path / "body.brep"
    write_solid(path, build_surface(list(body.faces)))
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


def test_macros_write_a_mesh_as_step(tmp_path):
    lines = [f"v {x} {y} {z}" for x, y, z in CUBE]
    lines += ["f " + " ".join(str(k + 1) for k in quad) for quad in QUADS]
    (tmp_path / "box.obj").write_text("\n".join(lines))
    (body,) = HybridVolume.read_mesh(tmp_path / "box.obj", "bilinear")
    HybridVolume.export_step(body, tmp_path / "box.step")
    (again,) = HybridVolume.read_step(tmp_path / "box.step")
    assert again.shape.Volume == pytest.approx(6.0, rel=1e-12)
    assert len(again.faces) == 6


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match="no STEP or BREP file"):
        write_solid(tmp_path / "body.obj", build_surface(bilinear_faces(CAGE)))
    with pytest.raises(OSError, match="nowhere"):
        write_solid(tmp_path / "nowhere" / "body.step", build_surface(bilinear_faces(CAGE)))
    assert not list(tmp_path.iterdir())
