# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One case of ``./run.sh reproduce steps`` in a process of its own.

``python -m HybridVolume.reproduce.steps_case FOLDER`` with the files of a
:class:`HybridVolume.job.Job`, in FreeCAD's Python. The file goes to the command line as a user
gives it; what comes out is measured here, apart from the program: volumes against formulas,
distances and found nodes with FreeCAD on the solid that was given.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from HybridVolume import protocol
from HybridVolume.freecad_python import import_freecad
from HybridVolume.worker import Channel

from .cases import case_main, told
from .quads_clock import tree_seconds

logger = logging.getLogger(__name__)

MADE, REFUSED, STOPPED, FAILED = "made", "refused", "stopped", "failed"
"""What became of a file: 0, 2, the time limit, anything else."""
PROJECT = Path(__file__).resolve().parents[2]
NODE_SECONDS = 150.0
"""Seconds of the processor for looking for nodes on the faces of one body."""
DISTANCES = 400
"""Nodes of the boundary of a body whose distance from it OCC measures."""
_GRACE = 30.0


def run_file(path: Path, output: Path, words: list[str], seconds: float) -> dict[str, Any]:
    """What the command line makes of a file, ended after some seconds of the processor.

    Parameters
    ----------
    path, output : Path
    words : list of str
        Options.
    seconds : float
        Of the processor, of all processes of the run.

    Returns
    -------
    dict
        ``state``, ``code`` of the exit, ``said`` (the error lines), ``traceback``, ``left`` (files
        in the output folder), ``seconds_cpu`` and ``seconds``.
    """
    command = [sys.executable, "-P", "-m", "HybridVolume", str(path), "-o", str(output), *words]
    logs = [output.with_suffix(suffix) for suffix in (".out", ".err")]
    began, before, stopped = time.perf_counter(), tree_seconds(), False
    with open(logs[0], "wb") as out, open(logs[1], "wb") as err:
        process = subprocess.Popen(
            command, cwd=PROJECT, stdin=subprocess.DEVNULL, stdout=out, stderr=err
        )
        spent = 0.0
        while process.poll() is None:
            time.sleep(0.25)
            spent = max(spent, tree_seconds() - before)
            if spent > seconds:
                stopped = True
                _end(process)
    spent = max(spent, tree_seconds() - before)
    said = logs[1].read_text(encoding="utf-8", errors="replace")
    code = process.returncode
    state = STOPPED if stopped else {0: MADE, 2: REFUSED}.get(code, FAILED)
    errors = [
        line.removeprefix("error: ") for line in said.splitlines() if line.startswith("error: ")
    ]
    return {
        "state": state,
        "code": code,
        "said": errors or (said.splitlines()[-1:] if state == FAILED else []),
        "traceback": "Traceback" in said,
        "left": sorted(p.name for p in output.rglob("*")) if output.exists() else [],
        "seconds_cpu": spent,
        "seconds": time.perf_counter() - began,
    }


def _end(process: subprocess.Popen) -> None:
    """End a run of the command line; its worker ends with it."""
    process.send_signal(signal.SIGTERM)
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(_GRACE)
        return
    process.kill()
    process.wait()


def _body(task: Mapping[str, Any], channel: Channel) -> dict[str, Any]:
    """One file, the whole way."""
    path = _input(task)
    output = Path(task["output"])
    shutil.rmtree(output, ignore_errors=True)
    output.parent.mkdir(parents=True, exist_ok=True)
    channel.progress("run", 0.0, " ".join(task["words"]))
    ran = run_file(path, output, list(task["words"]), task["seconds_limit"])
    report = output / protocol.REPORT_FILE
    bodies, refused = [], []
    # of a file with several bodies some may be there and others refused
    if report.is_file() and ran["state"] in (MADE, REFUSED):
        figures = json.loads(report.read_text(encoding="utf-8"))
        told = [_figures(one) for one in figures.get("volumes", [figures])]
        measured = _measured(output, [one["inside"] for one in told], channel)
        bodies = [{**one, **beside} for one, beside in zip(told, measured, strict=True)]
        refused = figures.get("refused", [])
    return {**ran, "bodies": bodies, "refused": refused}


def _input(task: Mapping[str, Any]) -> Path:
    """The file; that of a body made by script is written now."""
    if "file" in task:
        return Path(task["file"])
    import_freecad()
    from .steps_bodies import BODIES

    (body,) = (one for one in BODIES if one.name == task["case"])
    solids = body.make().Solids
    if len(solids) != 1 or not solids[0].isValid() or not solids[0].isClosed():
        raise ValueError(f"{body.name}: FreeCAD does not make one valid closed solid")
    path = Path(task["scratch"]) / f"{body.name}.step"
    solids[0].exportStep(str(path))
    return path


def _figures(report: Mapping[str, Any]) -> dict[str, Any]:
    """What the program itself tells of a body."""
    surface, shell, fem = report["input"], report["shell"], report["fem"]
    geometry = surface["geometry"]
    return {
        "faces": len(geometry["faces"]),
        "patches": geometry["patches"],
        # walls within the material have no patches and no nodes
        "inside": list(geometry.get("inside", ())),
        "counts": geometry["counts"],
        "area_shares": geometry["area"],
        "deviation": geometry["max_deviation"],
        "tolerance": geometry["tolerance"],
        "worst_faces": [
            row["name"]
            for row in sorted(geometry["faces"], key=lambda row: -row["deviation"])[:3]
            if row["kind"] == "tolerance"
        ],
        "volume": surface["volume"],
        "area": surface["area"],
        "genus": surface["genus"],
        "w0": shell["w0"],
        "thickness": shell["thickness"]["mean"],
        "elements": shell["elements"],
        "proved": shell["valid"],
        "embedded": shell["embedded"],
        "min_scaled_jacobian": shell["min_scaled_jacobian"],
        "tets": report["interior"]["tets"],
        "nodes": fem["nodes"],
        "fem_min_scaled_jacobian": fem["min_scaled_jacobian"],
        "fem_volume": fem["volume"],
        "repairs": fem["repairs"],
        "lost": fem["lost"],
        "notes": report["notes"],
        "stages": report["seconds"],
        "peak_memory_mb": report["peak_memory_mb"],
    }


def _measured(output: Path, inside: list[list[str]], channel: Channel) -> list[dict[str, Any]]:
    """What FreeCAD tells of each body of the document, reopened, and of the solid given."""
    FreeCAD = import_freecad()
    (file,) = output.glob("*.FCStd")
    document = FreeCAD.openDocument(str(file))
    meshes = [o for o in document.Objects if _is_analysis_mesh(o)]
    found = []
    for k, (mesh, walls) in enumerate(zip(meshes, inside, strict=True)):
        channel.progress("measuring", 0.5 + 0.5 * k / len(meshes), f"body {k + 1}")
        found.append(_measured_body(mesh, walls))
    FreeCAD.closeDocument(document.Name)
    return found


def _is_analysis_mesh(obj: Any) -> bool:
    return hasattr(obj, "FemMesh") and getattr(obj, "Shape", None) is not None


def _measured_body(mesh: Any, inside: list[str]) -> dict[str, Any]:
    from .steps_volume import triangle_volume

    shape = mesh.Shape.Shape
    solid = shape.Solids[0]
    volume, doubt = triangle_volume(solid)
    given = _given(mesh)
    return {
        "diagonal": shape.BoundBox.DiagonalLength,
        "triangle_volume": volume,
        "triangle_doubt": doubt,
        "given_faces": len(shape.Faces),
        # an analysis has the body itself or a copy with wider tolerances
        "widened": max(f.Tolerance for f in shape.Faces) > max(f.Tolerance for f in given.Faces),
        "face_tolerance": max(face.Tolerance for face in shape.Faces),
        **_nodes_on_faces(mesh.FemMesh, shape, inside),
        "off": _off(mesh.FemMesh, given),
    }


def _given(mesh: Any) -> Any:
    """Shape of the body itself."""
    for obj in mesh.Document.Objects:
        source = getattr(obj, "Source", None)
        if source is not None and any(mesh is part for part in _parts(obj)):
            return source.Shape
    return mesh.Shape.Shape


def _parts(obj: Any) -> list:
    return [getattr(obj, name) for name in obj.PropertiesList if name.endswith("Mesh")]


def _groups(mesh: Any, faces: int) -> dict[int, list[int]]:
    """Boundary elements of each CAD face, by its number."""
    found: dict[int, list[int]] = {}
    for group in mesh.Groups:
        name = re.fullmatch(r"Face(\d+)", mesh.getGroupName(group))
        if name and int(name[1]) <= faces:
            found[int(name[1])] = list(mesh.getGroupElements(group))
    return found


def _nodes_on_faces(mesh: Any, shape: Any, inside: list[str]) -> dict[str, Any]:
    """On how many faces FreeCAD finds all nodes of the mesh, as the FEM workbench does."""
    groups = _groups(mesh, len(shape.Faces))
    began = time.process_time()
    whole, asked, lost, more = 0, 0, [], []
    for number, face in enumerate(shape.Faces, start=1):
        if time.process_time() - began > NODE_SECONDS:
            break
        if f"Face{number}" in inside:
            continue
        asked += 1
        elements = groups.get(number, [])
        nodes = {node for element in elements for node in mesh.getElementNodes(element)}
        there = set(mesh.getNodesByFace(face))
        if nodes and nodes <= there:
            whole += 1
        else:
            lost.append(f"Face{number}")
        others = (members for other, members in groups.items() if other != number)
        if there - nodes and any(
            there.issuperset(mesh.getElementNodes(e)) for members in others for e in members
        ):
            more.append(f"Face{number}")
    return {
        "faces_to_ask": len(shape.Faces) - len(inside),
        "faces_asked": asked,
        "faces_found": whole,
        "faces_lost": lost,
        "faces_with_strangers": more,
        "groups": len(groups),
    }


def _off(mesh: Any, shape: Any) -> float | None:
    """Largest distance of some nodes of the boundary from their CAD faces, mm, as OCC measures."""
    import Part

    groups = _groups(mesh, len(shape.Faces))
    worst = None
    share = max(3, DISTANCES // max(1, len(groups)))
    places = mesh.Nodes
    for number, elements in groups.items():
        nodes = sorted({n for e in elements for n in mesh.getElementNodes(e)})
        for k in np.unique(np.linspace(0, len(nodes) - 1, share).round().astype(int)).tolist():
            off = Part.Vertex(places[nodes[k]]).distToShape(shape.Faces[number - 1])[0]
            worst = off if worst is None else max(worst, off)
    return worst


def limit_memory(size: int) -> None:
    """Limit the memory of this process and of each that it starts, bytes."""
    try:
        import resource
    except ImportError:  # Windows
        return
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size, hard))


def run_case(folder: Path, channel: Channel) -> None:
    """Make the case and write it; one that cannot be made is written with its error."""
    from HybridVolume.core.atomic import replacing

    task = json.loads((folder / protocol.OPTIONS_FILE).read_text(encoding="utf-8"))["options"]
    task["scratch"] = str(folder)
    limit_memory(int(task["memory_limit"]))
    os.environ.setdefault("PYTHONFAULTHANDLER", "1")
    try:
        figures = {**_body(task, channel), "error": None}
    except Exception as fault:
        figures = {"error": told(fault).to_dict(), "seconds": 0.0, "seconds_cpu": 0.0}
    values = {
        **{name: task[name] for name in ("name", "part", "case", "key", "program", "words")},
        **figures,
    }
    with replacing(Path(task["cases"]) / f"{task['name']}.json") as file:
        file.write((json.dumps(values, indent=1, allow_nan=False) + "\n").encode())


def main(arguments: list[str] | None = None) -> int:
    """Run one case; return the exit code."""
    return case_main(run_case, arguments)


if __name__ == "__main__":
    sys.exit(main())
