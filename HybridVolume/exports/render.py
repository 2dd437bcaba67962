# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The process that draws a scene: ``python -m HybridVolume.exports.render SCENE.npz OUT.png``.

It is apart because a graphics driver that is missing or broken may end the process.
"""

from __future__ import annotations

import sys
from typing import Any

import numpy as np


def main(scene: str, picture: str) -> int:
    """Draw the arrays of a file; 0 when the picture was written."""
    import pyvista

    with np.load(scene, allow_pickle=False) as file:
        data = {name: file[name] for name in file.files}
    plotter = pyvista.Plotter(off_screen=True, window_size=data["size"].tolist(), lighting="none")
    plotter.set_background("white")
    for number in range(int(data["skins"])):
        _add_skin(plotter, pyvista, {k: data.get(f"skin{number}_{k}") for k in _SKIN})
    for number in range(int(data["wires"])):
        _add_wire(plotter, pyvista, {k: data[f"wire{number}_{k}"] for k in _WIRE})
    _look(plotter, pyvista, data)
    if any(data[f"skin{number}_opacity"] < 1.0 for number in range(int(data["skins"]))):
        plotter.enable_depth_peeling(12)
    plotter.enable_anti_aliasing("ssaa")
    plotter.screenshot(picture)
    return 0


_SKIN = ("points", "normals", "triangles", "colour", "opacity")
_WIRE = ("points", "colour", "width")


def _add_skin(plotter: Any, pyvista: Any, skin: dict[str, Any]) -> None:
    triangles = skin["triangles"]
    faces = np.column_stack([np.full(len(triangles), 3), triangles]).ravel()
    mesh = pyvista.PolyData(skin["points"], faces)
    smooth = skin["normals"] is not None
    if smooth:
        mesh.point_data["Normals"] = skin["normals"]
        mesh.GetPointData().SetActiveNormals("Normals")
    actor = plotter.add_mesh(
        mesh,
        color=skin["colour"].tolist(),
        smooth_shading=smooth,
        ambient=0.30,
        diffuse=0.74,
        specular=0.12,
        specular_power=18.0,
        split_sharp_edges=False,
        opacity=float(skin["opacity"]),
    )
    mapper = actor.GetMapper()
    # skins step back a little, so that lines on them are whole
    mapper.SetResolveCoincidentTopologyToPolygonOffset()
    mapper.SetRelativeCoincidentTopologyPolygonOffsetParameters(1.0, 1.0)


def _add_wire(plotter: Any, pyvista: Any, wire: dict[str, Any]) -> None:
    points = wire["points"]
    count, length = points.shape[:2]
    lines = np.column_stack(
        [np.full(count, length), np.arange(count * length).reshape(count, length)]
    ).ravel()
    mesh = pyvista.PolyData(points.reshape(-1, 3), lines=lines)
    actor = plotter.add_mesh(
        mesh, color=wire["colour"].tolist(), line_width=float(wire["width"]), lighting=False
    )
    mapper = actor.GetMapper()
    mapper.SetResolveCoincidentTopologyToPolygonOffset()
    mapper.SetRelativeCoincidentTopologyLineOffsetParameters(-1.0, -2.0)


def _look(plotter: Any, pyvista: Any, data: dict[str, np.ndarray]) -> None:
    """Fill the picture with what is shown, and light it from above the left shoulder."""
    points = np.concatenate([data[f"skin{number}_points"] for number in range(int(data["skins"]))])
    depth = data["direction"]
    right = np.cross(data["up"], depth)
    right /= np.linalg.norm(right)
    upward = np.cross(depth, right)
    frame = np.array([right, upward, depth])
    seen = points @ frame.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle = 0.5 * (low + high)
    width, height = data["size"]
    half = 0.5 * max(high[1] - low[1], (high[0] - low[0]) * height / width)
    angle = 14.0
    distance = 1.06 * half / np.tan(np.radians(angle / 2.0))
    camera = plotter.camera
    camera.focal_point = middle @ frame
    camera.position = middle @ frame + (distance + 0.5 * (high[2] - low[2])) * depth
    camera.up = upward
    camera.view_angle = angle
    plotter.reset_camera_clipping_range()
    far = 10.0 * distance
    for side, strength in (
        (depth, 0.42),
        (depth + 0.9 * upward - 0.9 * right, 0.50),
        (depth + 0.2 * upward + 0.9 * right, 0.30),
    ):
        plotter.add_light(
            pyvista.Light(
                position=camera.focal_point + far * side,
                focal_point=camera.focal_point,
                intensity=strength,
                light_type="scene light",
            )
        )


if __name__ == "__main__":
    sys.exit(main(sys.argv[1], sys.argv[2]))
