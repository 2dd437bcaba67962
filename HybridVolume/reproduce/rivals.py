# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Boundary layers of prisms by Netgen and by Gmsh on the same bodies, judged as we judge ours.

Both meshers run in a process with a time limit: on some bodies they crash or never end. Their
meshes are taken with linear elements and with quadratic ones whose outer nodes lie on the CAD
surface, and det J of every prism and every tetrahedron is proved positive, or found not to be, by
Bernstein coefficients. That the mesh is the body is asked of its volume.

``python -m HybridVolume.reproduce.rivals MESHER BODY.brep THICKNESS SIZE`` prints the figures as
JSON, for a look.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

LAYERS = (0.4, 1.0)
"""Where the two layers end, as shares of the thickness."""
MISSED = 0.05
"""Share of the body's volume by which a mesh may miss it; what is more is not the body."""
GMSH_PRISM = [0, 1, 2, 3, 4, 5, 6, 9, 7, 12, 14, 13, 8, 10, 11, 15, 17, 16]
GMSH_TET = [0, 1, 2, 3, 4, 5, 6, 7, 9, 8]
NETGEN_PRISM = [0, 2, 1, 3, 5, 4, 6, 8, 7, 9, 11, 10]
NETGEN_TET = [0, 2, 1, 3, 5, 7, 4, 6, 9, 8]
"""Where the nodes of this program's order stand in the elements of the meshers."""
_PROJECT = Path(__file__).resolve().parents[2]
_NOTHING = {
    "made": False,
    "error": "",
    **dict.fromkeys(("prisms", "tets", "nodes", "linear", "curved", "thickness")),
    **dict.fromkeys(("volume_error", "seconds")),
}


def size_for(area: float, triangles: int = 1000) -> float:
    """Edge length, mm, at which equilateral triangles cover an area, mm², with so many."""
    return float(np.sqrt(area / (0.433 * triangles)))


def netgen_layers(
    path: str | os.PathLike,
    thickness: float,
    size: float,
    *,
    limit: bool | None = None,
    time_limit: float = 60.0,
    python: str | None = None,
) -> dict[str, Any]:
    """Netgen's boundary layers in a body.

    Parameters
    ----------
    path : path
        STEP or BREP file of one solid.
    thickness : float
        Of both layers together, mm.
    size : float
        Largest edge, mm.
    limit : bool, optional
        Netgen's ``limit_growth_vectors``: layers may become thinner where there is no room. If not
        given, it is tried without, and where that gives no valid curved mesh, with it; the better
        answer counts.
    time_limit : float
        Seconds on the wall for each try.
    python : str, optional
        Interpreter that has netgen and numpy; this one otherwise.

    Returns
    -------
    dict
        ``made`` (whether there is a mesh of the body), ``error`` (why not), ``limited``;
        ``prisms``, ``tets``, ``nodes``; ``linear`` and ``curved``, each with ``invalid`` and
        ``undecided`` elements, ``valid`` (all of them proved) and ``min_scaled_jacobian``;
        ``thickness`` (mean and min, mm) that the prisms have, ``volume_error`` (share of the
        body's), ``seconds`` of the processor for the mesh. Figures that are not there are None.
    """
    tries = [limit] if limit is not None else [False, True]
    answers = []
    for limited in tries:
        answer = _measure("netgen", path, thickness, size, limited, time_limit, python)
        answers.append({**answer, "limited": limited})
        if answer["made"] and answer["curved"]["valid"]:
            break
    return max(answers, key=_worth)


def gmsh_layers(
    path: str | os.PathLike,
    thickness: float,
    size: float,
    *,
    time_limit: float = 60.0,
    python: str | None = None,
) -> dict[str, Any]:
    """Gmsh's boundary layers in a body (``extrudeBoundaryLayer`` on all faces).

    Parameters
    ----------
    path : path
        STEP or BREP file of one solid whose faces are oriented outward.
    thickness, size, time_limit, python
        As for :func:`netgen_layers`.

    Returns
    -------
    dict
        As of :func:`netgen_layers`, without ``limited``.
    """
    from HybridVolume.core.tetmesh import free_only

    if free_only():
        return {**_NOTHING, "error": "left out: gmsh is under the GPL"}
    return _measure("gmsh", path, thickness, size, False, time_limit, python)


def _worth(answer: dict[str, Any]) -> tuple:
    if not answer["made"]:
        return (0,)
    bad = [answer[kind]["invalid"] + answer[kind]["undecided"] for kind in ("curved", "linear")]
    return (1, -bad[0], -bad[1])


# --------------------------------------------------------------------------- in this process


def _measure(
    mesher: str,
    path: str | os.PathLike,
    thickness: float,
    size: float,
    limited: bool,
    time_limit: float,
    python: str | None,
) -> dict[str, Any]:
    """Run a mesher in a process of its own; a crash is an answer as well."""
    command = [python or sys.executable, "-m", __spec__.name if __spec__ else __name__, mesher]
    command += [str(Path(path).resolve()), repr(float(thickness)), repr(float(size))]
    environment = {**os.environ, "PYTHONPATH": str(_PROJECT), "OMP_NUM_THREADS": "1"}
    with tempfile.TemporaryDirectory(prefix="hybridvolume-") as folder:
        answer = Path(folder) / "answer.json"
        command += ["--answer", str(answer)] + (["--limit"] if limited else [])
        with open(Path(folder) / "log.txt", "w+b") as log:
            process = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                env=environment, cwd=folder,
            )  # fmt: skip
            try:
                code = process.wait(time_limit)
            except subprocess.TimeoutExpired:
                return {**_NOTHING, "error": f"no end within {time_limit:g} s"}
            finally:
                if process.poll() is None:
                    process.kill()
                    process.wait()
            if answer.is_file():
                return {**_NOTHING, **json.loads(answer.read_text(encoding="utf-8"))}
            log.seek(0)
            said = log.read().decode(errors="replace").split("\n")
        last = next((line.strip() for line in reversed(said) if line.strip()), "no word")
        return {**_NOTHING, "error": f"crashed (code {code}): {last[:200]}"}


# --------------------------------------------------------------------- in the mesher's process

_Mesh = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Nodes (n, 3), prisms and tetrahedra with quadratic nodes, in this program's order."""


def _netgen_mesh(path: str, thickness: float, size: float, limited: bool) -> tuple[_Mesh, float]:
    from netgen import meshing
    from netgen.occ import OCCGeometry

    geometry = OCCGeometry(path)
    layer = meshing.BoundaryLayerParameters(
        boundary=".*",
        thickness=(thickness * np.diff([0.0, *LAYERS])).tolist(),
        new_material="layer",
        domain=".*",
        outside=False,
        limit_growth_vectors=limited,
        disable_curving=False,
    )
    mesh = geometry.GenerateMesh(maxh=size, boundary_layers=[layer])
    mesh.SecondOrder()
    nodes = np.array([point.p for point in mesh.Points()])
    elements = [[v.nr - 1 for v in element.points] for element in mesh.Elements3D()]
    prisms = np.array([e for e in elements if len(e) == 12]).reshape(-1, 12)
    tets = np.array([e for e in elements if len(e) == 10]).reshape(-1, 10)
    others = len(elements) - len(prisms) - len(tets)
    if others:
        raise RuntimeError(f"{others} elements that are neither prisms nor tetrahedra")
    # netgen's elements are left-handed, its mid nodes on 0-2, 0-1, 1-2 below and above in prisms,
    # on 0-1, 0-2, 0-3, 1-2, 1-3, 2-3 in tetrahedra
    prisms, tets = prisms[:, NETGEN_PRISM], tets[:, NETGEN_TET]
    # the sides are straight: with mid nodes half-way the same element has 15 nodes
    middle = len(nodes) + np.arange(3 * len(prisms)).reshape(-1, 3)
    upright = 0.5 * (nodes[prisms[:, :3]] + nodes[prisms[:, 3:6]])
    nodes = np.vstack([nodes, upright.reshape(-1, 3)])
    volume = sum(solid.mass for solid in geometry.shape.solids)
    return (nodes, np.hstack([prisms, middle]), tets), float(volume)


def _gmsh_mesh(path: str, thickness: float, size: float, limited: bool) -> tuple[_Mesh, float]:
    import gmsh

    gmsh.initialize(interruptible=False)
    gmsh.option.setNumber("General.NumThreads", 1)
    gmsh.option.setNumber("Mesh.MeshSizeMin", size)
    gmsh.option.setNumber("Mesh.MeshSizeMax", size)
    model = gmsh.model
    model.occ.importShapes(path)
    model.occ.synchronize()
    solids = model.getEntities(3)
    volume = sum(model.occ.getMass(3, tag) for _, tag in solids)
    faces = model.getEntities(2)
    model.occ.remove(solids)
    model.occ.synchronize()
    heights = [-thickness * share for share in LAYERS]
    made = model.geo.extrudeBoundaryLayer(faces, [1] * len(LAYERS), heights, True)
    # each face gives its top, then the volume over it
    tops = [top for (_, top), (dim, _) in zip(made, made[1:], strict=False) if dim == 3]
    model.geo.synchronize()
    core = model.geo.addVolume([model.geo.addSurfaceLoop(tops)])
    model.geo.synchronize()
    model.mesh.generate(3)
    model.mesh.setOrder(2)
    if not len(model.mesh.getElements(3, core)[0]):
        raise RuntimeError("no tetrahedra in the core")
    tags, points, _ = model.mesh.getNodes()
    number = np.zeros(int(tags.max()) + 1, dtype=np.int64)
    number[tags] = np.arange(len(tags))
    kinds = {13: 18, 11: 10}
    found = {kind: np.zeros((0, count), dtype=np.int64) for kind, count in kinds.items()}
    for kind, _, nodes in zip(*model.mesh.getElements(3), strict=True):
        if kind not in kinds:
            raise RuntimeError(f"elements of the kind {kind}")
        found[int(kind)] = number[nodes.reshape(-1, kinds[int(kind)])]
    return (points.reshape(-1, 3), found[13][:, GMSH_PRISM], found[11][:, GMSH_TET]), volume


MESHERS: dict[str, Callable[[str, float, float, bool], tuple[_Mesh, float]]] = {
    "netgen": _netgen_mesh,
    "gmsh": _gmsh_mesh,
}


def figures(mesh: _Mesh, volume: float) -> dict[str, Any]:
    """Figures of a mesh of prisms and tetrahedra.

    Parameters
    ----------
    mesh : (nodes (n, 3), prisms (m, 15 or 18), tets (k, 10))
        Quadratic elements, in the order of :mod:`HybridVolume.core.elements`.
    volume : float
        Of the body, mm³.

    Returns
    -------
    dict
        As of :func:`netgen_layers`, without ``error`` and ``seconds``.
    """
    from HybridVolume.core.element_jacobians import prove_positive, scaled_jacobian, volumes

    nodes, prisms, tets = mesh
    wedge = f"penta{prisms.shape[1]}"
    found: dict[str, Any] = {
        "prisms": len(prisms),
        "tets": len(tets),
        # of netgen's prisms the nodes on upright edges are ours
        "nodes": len(np.unique(np.concatenate([prisms[:, :12].ravel(), tets.ravel()]))),
    }
    for name, kinds in (
        ("linear", (("penta6", prisms[:, :6]), ("tet4", tets[:, :4]))),
        ("curved", ((wedge, prisms), ("tet10", tets))),
    ):
        status = [prove_positive(kind, nodes[rows]).status for kind, rows in kinds if len(rows)]
        quality = [scaled_jacobian(kind, nodes[rows]) for kind, rows in kinds if len(rows)]
        status, quality = np.concatenate(status), np.concatenate(quality)
        found[name] = {
            "invalid": int((status < 0).sum()),
            "undecided": int((status == 0).sum()),
            "valid": bool((status > 0).all()),
            "min_scaled_jacobian": float(quality.min()),
        }
    filled = sum(float(volumes(k, nodes[rows]).sum()) for k, rows in kinds if len(rows))
    found["volume_error"] = abs(filled / volume - 1.0)
    if len(prisms):
        columns = _columns(nodes, prisms)
        found["thickness"] = {"mean": float(columns.mean()), "min": float(columns.min())}
    found["made"] = found["volume_error"] < MISSED and len(prisms) > 0 and len(tets) > 0
    if not found["made"]:
        found["error"] = (
            f"{len(prisms)} prisms and {len(tets)} tetrahedra of {100 * filled / volume:.3g} % of"
            " the body's volume"
        )
    return found


def _columns(nodes: np.ndarray, prisms: np.ndarray) -> np.ndarray:
    """Length of each column of upright edges, mm."""
    edges = np.unique(np.stack([prisms[:, :3], prisms[:, 3:6]], axis=2).reshape(-1, 2), axis=0)
    following = np.full(len(nodes), -1)
    following[edges[:, 0]] = edges[:, 1]
    at = np.setdiff1d(edges[:, 0], edges[:, 1])
    length = np.zeros(len(at))
    for _ in LAYERS:
        there = np.where(following[at] < 0, at, following[at])
        length += np.linalg.norm(nodes[there] - nodes[at], axis=1)
        at = there
    return length


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one mesher and tell the figures, or what it said in place of a mesh."""
    import argparse

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("mesher", choices=sorted(MESHERS))
    parser.add_argument("body")
    parser.add_argument("thickness", type=float)
    parser.add_argument("size", type=float)
    parser.add_argument("--limit", action="store_true")
    parser.add_argument("--answer", type=Path)
    options = parser.parse_args(arguments)
    started = time.process_time()
    try:
        mesh, volume = MESHERS[options.mesher](
            options.body, options.thickness, options.size, options.limit
        )
        spent = time.process_time() - started
        found = figures(mesh, volume)
    except Exception as error:  # whatever a foreign mesher raises is its answer
        spent = time.process_time() - started
        found = {"made": False, "error": " ".join(str(error).split())[:300] or repr(error)}
    text = json.dumps({**found, "seconds": spent}, indent=1)
    if options.answer:
        part = options.answer.with_suffix(".part")
        part.write_text(text, encoding="utf-8")
        os.replace(part, options.answer)
    else:
        print(text)
    sys.stdout.flush()
    # the answer is told; a mesher's own clean-up at exit may crash and tells nothing
    os._exit(0)


if __name__ == "__main__":
    main()
