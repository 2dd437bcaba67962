# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME.png: outer faces red, inner boundary green, tets gray, cut open as in the paper's Fig. 8."""

from __future__ import annotations

import contextlib
import importlib.util
import json
import logging
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.core.atomic import beside
from HybridVolume.core.tetmesh.door import interpreter
from HybridVolume.errors import SetupError

from .scene import Chart, Scene, cutaway

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume

logger = logging.getLogger(__name__)

_PNG = b"\x89PNG\r\n\x1a\n"


def write_picture(
    path: str | os.PathLike,
    volume: HybridVolume,
    *,
    size: tuple[int, int] = (1600, 1200),
    time_limit: float = 120.0,
) -> None:
    """Draw a hybrid volume without a screen.

    Parameters
    ----------
    path : path
    volume : HybridVolume
    size : (int, int)
        Pixels.
    time_limit : float
        Seconds for each way of drawing that is tried.

    Raises
    ------
    SetupError
        pyvista is not installed, or nothing on this system can draw.
    OSError
        The place cannot be written.
    """
    if importlib.util.find_spec("pyvista") is None:
        raise SetupError("pyvista is not installed: no picture", remedy="install pyvista")
    write_scene(path, cutaway(volume), interpreter(), size=size, time_limit=time_limit)


def write_scene(
    path: str | os.PathLike,
    scene: Scene,
    python: str,
    *,
    size: tuple[int, int] = (1600, 1200),
    time_limit: float = 120.0,
) -> None:
    """Draw a scene without a screen; see :func:`write_scenes`."""
    write_scenes({path: scene}, python, size=size, time_limit=time_limit)


def write_scenes(
    scenes: Mapping[str | os.PathLike, Scene | Chart],
    python: str,
    *,
    size: tuple[int, int] = (1600, 1200),
    time_limit: float = 120.0,
) -> None:
    """Draw scenes without a screen, all in one process.

    Parameters
    ----------
    scenes : mapping of path to Scene or Chart
        Where each goes. All are written, or none.
    python : str
        An interpreter that has pyvista.
    size : (int, int)
        Pixels.
    time_limit : float
        Seconds for each way of drawing that is tried.

    Raises
    ------
    SetupError
        Nothing on this system can draw.
    OSError
        A place cannot be written.
    """
    with contextlib.ExitStack() as stack:
        folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="hybridvolume-")))
        pairs = []
        for number, (path, scene) in enumerate(scenes.items()):
            arrays = folder / f"scene{number}.npz"
            np.savez(arrays, **_arrays(scene, size))
            pairs.append((arrays, stack.enter_context(beside(path))))
        reasons = []
        for environment, prefix in _ways():
            reason = _draw(python, pairs, environment, prefix, time_limit)
            if reason is None:
                break
            reasons.append(reason)
            logger.info("no picture: %s", reason)
        else:
            raise SetupError(
                f"nothing on this system can draw a picture ({'; '.join(reasons)})",
                remedy="install libgl1 and libegl1, or Xvfb",
            )


def _arrays(scene: Scene | Chart, size: tuple[int, int]) -> dict[str, np.ndarray]:
    if isinstance(scene, Chart):
        values = {**asdict(scene), "edges": scene.edges.tolist(), "counts": scene.counts.tolist()}
        return {"size": np.array(size), "chart": np.array(json.dumps(values))}
    # graphics cards have single precision: bodies are drawn at the origin, about one long
    shown = np.concatenate([skin.points for skin in scene.skins])
    low, high = shown.min(axis=0), shown.max(axis=0)
    centre, unit = 0.5 * (low + high), max(float(np.linalg.norm(high - low)), 1e-300)

    def near(points: np.ndarray) -> np.ndarray:
        return (points - centre) / unit

    arrays = {
        "size": np.array(size),
        "unit": np.array(unit),
        "skins": np.array(len(scene.skins)),
        "wires": np.array(len(scene.wires)),
        "direction": scene.direction,
        "up": scene.up,
        "labels": near(np.array([label.point for label in scene.labels]).reshape(-1, 3)),
        "words": np.array(json.dumps(_words(scene))),
    }
    for number, skin in enumerate(scene.skins):
        arrays[f"skin{number}_points"] = near(skin.points)
        arrays[f"skin{number}_triangles"] = skin.triangles
        arrays[f"skin{number}_colour"] = np.array(skin.colour)
        arrays[f"skin{number}_opacity"] = np.array(skin.opacity)
        arrays[f"skin{number}_lit"] = np.array(skin.lit)
        if skin.normals is not None:
            arrays[f"skin{number}_normals"] = skin.normals
        if skin.values is not None:
            arrays[f"skin{number}_values"] = skin.values
    for number, wire in enumerate(scene.wires):
        arrays[f"wire{number}_points"] = near(wire.points)
        arrays[f"wire{number}_colour"] = np.array(wire.colour)
        arrays[f"wire{number}_width"] = np.array(wire.width)
    return arrays


def _words(scene: Scene) -> dict[str, Any] | None:
    """What is written beside the picture, as plain values."""
    if not scene.written:
        return None
    return {
        "title": scene.title,
        "lines": list(scene.lines),
        "bar": None if scene.bar is None else asdict(scene.bar),
        "labels": [[label.text, list(label.colour)] for label in scene.labels],
        "legend": [[list(colour), text] for colour, text in scene.legend],
        "ruler": scene.ruler,
    }


def _ways() -> list[tuple[dict[str, str], list[str]]]:
    """Environments and command prefixes to try, the one without a screen first."""
    ways: list[tuple[dict[str, str], list[str]]] = [({}, [])]
    if sys.platform.startswith("linux"):
        ways.append(({"VTK_DEFAULT_OPENGL_WINDOW": "vtkEGLRenderWindow"}, []))
        ways.append(({"VTK_DEFAULT_OPENGL_WINDOW": "vtkOSOpenGLRenderWindow"}, []))
        if shutil.which("xvfb-run"):
            ways.append(({}, ["xvfb-run", "-a", "-s", "-screen 0 1280x1024x24"]))
    return ways


def _draw(
    python: str,
    pairs: Sequence[tuple[Path, Path]],
    extra: dict[str, str],
    prefix: list[str],
    time_limit: float,
) -> str | None:
    """Draw in a process of its own; the reason where a picture is not there afterwards."""
    environment = {**os.environ, **extra}
    root = str(Path(__file__).resolve().parents[2])
    known = environment.get("PYTHONPATH", "")
    environment["PYTHONPATH"] = os.pathsep.join(p for p in (root, known) if p)
    names = [str(path) for pair in pairs for path in pair]
    command = [*prefix, python, "-m", f"{__package__}.render", *names]
    try:
        done = subprocess.run(
            command,
            env=environment,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=time_limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return f"no answer within {time_limit:g} s"
    if done.returncode == 0 and all(part.read_bytes()[:8] == _PNG for _, part in pairs):
        return None
    plain = re.sub(r"\x1b\[[0-9;]*m", "", done.stderr)
    lines = [line for line in plain.splitlines() if line.strip()]
    said = lines[-1].strip()[:160] if lines else "no message"
    return f"code {done.returncode}, {said}"
