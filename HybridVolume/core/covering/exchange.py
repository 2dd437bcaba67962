# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A body's outline and geometry, and its cover, as files between FreeCAD and the mesher's process.

The process is ``python -m HybridVolume.core.covering.exchange FOLDER``: Gmsh may crash or never
end, and takes nothing with it. It reads ``body.brep``, ``body.npz`` and ``task.json`` and writes
``cover.npz``, or ``error.json`` and ends with 2.
"""

from __future__ import annotations

import json
import logging
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from ...errors import HybridVolumeError
from ..surface import SplineFace
from .cover import Cover, cover_body
from .geometry import SplineCurve
from .outline import Outline

BREP, BODY, TASK, COVER, ERROR = (
    *("body.brep", "body.npz", "task.json"),
    *("cover.npz", "error.json"),
)


def write_body(
    folder: Path,
    outline: Outline,
    curves: Sequence[SplineCurve | None],
    surfaces: Sequence[SplineFace],
    task: Mapping[str, float],
) -> None:
    """Write what the process needs besides the solid itself.

    Parameters
    ----------
    folder : Path
    outline : Outline
    curves, surfaces : sequences
    task : mapping
        Keywords of :func:`.cover.cover_body`.
    """
    arrays = {f"outline/{f.name}": getattr(outline, f.name) for f in fields(Outline)}
    for k, curve in enumerate(curves):
        if curve is not None:
            arrays |= {f"curve/{k}/{name}": value for name, value in asdict(curve).items()}
    arrays |= _face_arrays("surface", surfaces)
    np.savez(folder / BODY, curves=len(curves), surfaces=len(surfaces), **arrays)
    (folder / TASK).write_text(json.dumps(dict(task)))


def read_body(
    folder: Path,
) -> tuple[Outline, list[SplineCurve | None], list[SplineFace], dict[str, float]]:
    """What :func:`write_body` wrote."""
    with np.load(folder / BODY) as file:
        outline = Outline(**{f.name: file[f"outline/{f.name}"] for f in fields(Outline)})
        curves = [
            SplineCurve(
                int(file[f"curve/{k}/degree"]),
                *(file[f"curve/{k}/{name}"] for name in ("knots", "control_points", "weights")),
                float(file[f"curve/{k}/tolerance"]),
            )
            if f"curve/{k}/degree" in file
            else None
            for k in range(int(file["curves"]))
        ]
        surfaces = _faces(file, "surface", int(file["surfaces"]))
    return outline, curves, surfaces, json.loads((folder / TASK).read_text())


def _face_arrays(what: str, faces: Sequence[SplineFace]) -> dict[str, np.ndarray]:
    arrays = {}
    for k, face in enumerate(faces):
        arrays |= {
            f"{what}/{k}/name": np.array(face.name),
            f"{what}/{k}/u": face.knots[0],
            f"{what}/{k}/v": face.knots[1],
            f"{what}/{k}/points": face.control_points,
            f"{what}/{k}/weights": face.weights,
            f"{what}/{k}/exact": np.array(face.exact),
        }
    return arrays


def _faces(file: Mapping[str, np.ndarray], what: str, count: int) -> list[SplineFace]:
    found = []
    for k in range(count):
        u, v, points, weights = (file[f"{what}/{k}/{name}"] for name in ("u", "v", "points",
                                                                           "weights"))  # fmt: skip
        degrees = (len(u) - points.shape[0] - 1, len(v) - points.shape[1] - 1)
        found.append(
            SplineFace(
                str(file[f"{what}/{k}/name"]), degrees, (u, v), points, weights,
                bool(file[f"{what}/{k}/exact"]),
            )
        )  # fmt: skip
    return found


def read_cover(folder: Path) -> Cover:
    """The cover that the process wrote."""
    with np.load(folder / COVER) as file:
        faces = _faces(file, "patch", int(file["patches"]))
        kinds = tuple(str(kind) for kind in file["kinds"])
        return Cover(tuple(faces), file["origin"], file["deviation"], int(file["quads"]), kinds)


def main(arguments: Sequence[str] | None = None) -> int:
    """Cover the body in a folder."""
    folder = Path((sys.argv[1:] if arguments is None else arguments)[0])
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(message)s")
    outline, curves, surfaces, task = read_body(folder)
    try:
        cover = cover_body(folder / BREP, outline, curves, surfaces, **task)
    except HybridVolumeError as error:
        told = {"message": error.message, "faces": list(error.faces), "remedy": error.remedy}
        (folder / ERROR).write_text(json.dumps({**told, "figure": error.figure}))
        return 2
    np.savez(
        folder / COVER,
        patches=len(cover.faces),
        origin=cover.origin,
        deviation=cover.deviation,
        quads=cover.quads,
        kinds=np.array(cover.kinds),
        **_face_arrays("patch", cover.faces),
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
