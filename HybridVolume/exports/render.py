# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The process that draws: ``python -m HybridVolume.exports.render SCENE.npz OUT.png [...]``.

It is apart because a graphics driver that is missing or broken may end the process.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import numpy as np

HEAD, FOOT, SIDE = 0.10, 0.09, 0.20
"""Room above, below and beside the drawing for what is written, as shares of the picture."""


def main(*names: str) -> int:
    """Draw the arrays of files; 0 when all pictures were written.

    Parameters
    ----------
    names : str
        A scene and its picture, the next scene and its picture, and so on.
    """
    import pyvista

    for scene, picture in zip(names[::2], names[1::2], strict=True):
        with np.load(scene, allow_pickle=False) as file:
            data = {name: file[name] for name in file.files}
        if "chart" in data:
            from .annotate import chart

            chart(picture, json.loads(str(data["chart"])), data["size"])
        else:
            _draw(pyvista, data, picture)
    return 0


def _draw(pyvista: Any, data: dict[str, np.ndarray], picture: str) -> None:
    words = json.loads(str(data["words"]))
    size = data["size"].astype(int)
    room = size if words is None else _inner(size, words)[2:]
    plotter = pyvista.Plotter(off_screen=True, window_size=room.tolist(), lighting="none")
    plotter.set_background("white")
    for number in range(int(data["skins"])):
        _add_skin(plotter, pyvista, {k: data.get(f"skin{number}_{k}") for k in _SKIN}, words)
    for number in range(int(data["wires"])):
        _add_wire(plotter, pyvista, {k: data[f"wire{number}_{k}"] for k in _WIRE})
    height = _look(plotter, pyvista, data, room, flat=words is not None)
    if any(data[f"skin{number}_opacity"] < 1.0 for number in range(int(data["skins"]))):
        plotter.enable_depth_peeling(12)
    plotter.enable_anti_aliasing("ssaa")
    if words is None:
        plotter.screenshot(picture)
    else:
        image = plotter.screenshot(None, return_img=True)
        places = [_place(plotter, point) for point in data["labels"]]
        from .annotate import annotate

        annotate(
            picture, image, words, size, _inner(size, words), places, height * float(data["unit"])
        )
    plotter.close()


def _inner(size: np.ndarray, words: dict[str, Any]) -> np.ndarray:
    """Corner from the left and from below, width and height of the drawing, pixels."""
    left = SIDE if words["labels"] else 0.02
    right = SIDE if words["labels"] or words["bar"] else 0.02
    head = HEAD if words["title"] else 0.02
    head += 0.03 * max(0, len(words["lines"]) - 1)
    foot = FOOT if words["ruler"] or words["legend"] else 0.02
    width, height = size
    return np.array(
        [left * width, foot * height, (1.0 - left - right) * width, (1.0 - head - foot) * height]
    ).astype(int)


_SKIN = ("points", "normals", "triangles", "colour", "opacity", "values", "lit")
_WIRE = ("points", "colour", "width")


def _add_skin(
    plotter: Any, pyvista: Any, skin: dict[str, Any], words: dict[str, Any] | None
) -> None:
    triangles = skin["triangles"]
    faces = np.column_stack([np.full(len(triangles), 3), triangles]).ravel()
    mesh = pyvista.PolyData(skin["points"], faces)
    smooth = skin["normals"] is not None
    if smooth:
        mesh.point_data["Normals"] = skin["normals"]
        mesh.GetPointData().SetActiveNormals("Normals")
    colours: dict[str, Any] = {"color": skin["colour"].tolist()}
    if skin["values"] is not None:
        bar = words["bar"]
        mesh.point_data["values"] = skin["values"]
        colours = {
            "scalars": "values",
            "cmap": bar["colours"],
            "clim": (bar["low"], bar["high"]),
            "show_scalar_bar": False,
            "interpolate_before_map": True,
        }
    light = {"ambient": 0.30, "diffuse": 0.74, "specular": 0.12, "specular_power": 18.0}
    if not skin["lit"]:
        light = {"lighting": False}
    actor = plotter.add_mesh(
        mesh,
        smooth_shading=smooth,
        split_sharp_edges=False,
        opacity=float(skin["opacity"]),
        **light,
        **colours,
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


def _look(
    plotter: Any, pyvista: Any, data: dict[str, np.ndarray], size: np.ndarray, *, flat: bool
) -> float:
    """Fill the picture with what is shown, and light it from above the left shoulder.

    Returns
    -------
    float
        Height of the picture in units of the scene; in a flat (parallel) projection everywhere.
    """
    points = [data[f"skin{number}_points"] for number in range(int(data["skins"]))]
    if flat:
        points += [
            data[f"wire{number}_points"].reshape(-1, 3) for number in range(int(data["wires"]))
        ]
    points = np.concatenate(points)
    depth = data["direction"]
    right = np.cross(data["up"], depth)
    right /= np.linalg.norm(right)
    upward = np.cross(depth, right)
    frame = np.array([right, upward, depth])
    seen = points @ frame.T
    low, high = seen.min(axis=0), seen.max(axis=0)
    middle = 0.5 * (low + high)
    width, height = size
    half = 0.5 * max(high[1] - low[1], (high[0] - low[0]) * height / width)
    angle = 14.0
    distance = 1.06 * half / np.tan(np.radians(angle / 2.0))
    camera = plotter.camera
    camera.focal_point = middle @ frame
    camera.position = middle @ frame + (distance + 0.5 * (high[2] - low[2])) * depth
    camera.up = upward
    camera.view_angle = angle
    if flat:
        camera.enable_parallel_projection()
        camera.parallel_scale = 1.03 * half
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
    return 2.0 * 1.03 * half


def _place(plotter: Any, point: np.ndarray) -> tuple[float, float]:
    """Where a point is on the screen, pixels from the left and from below."""
    renderer = plotter.renderer
    renderer.SetWorldPoint(*point, 1.0)
    renderer.WorldToDisplay()
    return renderer.GetDisplayPoint()[:2]


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
