# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Hybrid volumes of FreeCAD solids: shells made by hand, meshes by the worker's Python."""

from __future__ import annotations

import os
import subprocess
from dataclasses import replace

import numpy as np
import pytest
from box_mesh import box_mesh
from conftest import PROJECT
from part_bodies import to_part_solid
from shells import BODIES, shell_towards

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.hybrid import HybridVolume
from HybridVolume.core.midstructure import Midstructure, Sheet
from HybridVolume.core.validity import certify
from HybridVolume.errors import SetupError
from HybridVolume.job import worker_python


def transformed(body, scale=1.0, turn=0.0, shift=(0.0, 0.0, 0.0)):
    """A body scaled, turned about (1, 2, 3) and shifted, and the map of its points."""
    axis = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)
    cross = np.cross(np.eye(3), axis)
    rotation = np.eye(3) + np.sin(turn) * cross + (1.0 - np.cos(turn)) * cross @ cross

    def there(points):
        return scale * points @ rotation.T + shift

    def back(points):
        return (points - shift) @ rotation / scale

    faces = tuple(replace(f, control_points=there(f.control_points)) for f in body.faces)
    return replace(body, faces=faces, volume=scale**3 * body.volume), there, back


def shelled(name, *, layers=2, read=None, **transform):
    """Solid of one of `shells.BODIES`, as it is read, and a volume with shell but without mesh.

    ``read`` is `HybridVolume.sources.read_shape`, which needs FreeCAD.
    """
    make, target = BODIES[name]
    body, there, back = transformed(make(), **transform)
    solid = to_part_solid(body, tolerance=1e-6 * transform.get("scale", 1.0))
    (found,) = read(solid, name.capitalize())
    surface = build_surface(list(found.faces))
    shell = shell_towards(surface, lambda x: there(target(back(x))), layers)
    shell = replace(shell, embedded=True, w0=0.4, w0_asked=0.4, w0_rms=0.0)
    sheet = Sheet(("Face1", "Face2"), 0.5, (0.1, 0.2), (120.0, 180.0), True, "large", (0, 0.5, 1))
    midstructure = Midstructure(
        *(np.eye(3), np.array([[0, 1, 2]]), np.zeros(1, dtype=int), np.ones(1, dtype=bool)),
        *(np.full(3, 0.1), (sheet,)),
    )
    # the mesh is only a stand-in until the worker makes one
    fem = replace(box_mesh((1.0, 1.0, 1.0), ["Face1"] * 6), surface_nodes=np.arange(8))
    certificate = certify(shell.bezier_elements())
    told = {"boundary_deviation": 0.0}
    volume = HybridVolume(
        *(surface, midstructure, {}, shell, certificate, None, None, fem, 0.0, told)
    )
    return found, volume


_MESH = """
import sys
from HybridVolume.core.density import Density
from HybridVolume.core.hybrid import HybridVolume
from HybridVolume.core.remesh import remesh

for path in sys.argv[1:]:
    name, subdivide, order = path.rsplit("_", 2)
    volume = remesh(HybridVolume.load(name), Density(subdivide=int(subdivide)), order=int(order))
    volume.save(path)
"""


def meshed(volumes, folder):
    """The same volumes with meshes, all made by one process of the worker's Python.

    Parameters
    ----------
    volumes : mapping of str to (HybridVolume, subdivide, order)
    folder : Path
    """
    try:
        python = worker_python()
    except SetupError as missing:
        pytest.skip(missing.line)
    paths = {}
    for number, (name, (volume, subdivide, order)) in enumerate(volumes.items()):
        volume.save(folder / str(number))
        paths[name] = f"{folder / str(number)}_{subdivide}_{order}"
    environment = {**os.environ, "PYTHONPATH": str(PROJECT), "OMP_NUM_THREADS": "1"}
    command = [python, "-c", _MESH, *paths.values()]
    subprocess.run(command, env=environment, check=True, timeout=120)
    return {name: HybridVolume.load(path) for name, path in paths.items()}
