# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Meshes of the same bodies by Gmsh and by Netgen, for the accuracy cases.

Curved ten-node tets, uniform or graded away from chosen faces, and Netgen's boundary layers, whose
prisms get the mid nodes of their upright edges so that they are 15-node wedges. All mid nodes of
the boundary lie on the CAD surface. The meshers run in a process of their own with a time limit:
both keep state, and both may crash.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial import cKDTree

from ..core.element_jacobians import prove_positive, volumes
from ..core.elements import FACES
from ..core.tetmesh import free_only
from ..errors import FaultError, InputError, MesherError
from .fem_mesh import Meshed
from .rivals import GMSH_TET, NETGEN_PRISM, NETGEN_TET

if TYPE_CHECKING:
    from ..core.surface import PatchSurface, SplineFace

MESHERS = ("gmsh", "netgen")
OFF = 0.02
"""Share of the volume, or of the diagonal, by which a coarse mesh may miss the body."""
_PROJECT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Sizes:
    """Wanted edge length: ``size * (1 + slope * d)`` at the distance d, mm, from the faces named.

    Attributes
    ----------
    size : float
        mm.
    slope : float
        Growth a mm; 0 is uniform.
    faces : tuple of str
        CAD faces that the distance is from; all, where none is named.
    """

    size: float
    slope: float = 0.0
    faces: tuple[str, ...] = ()


def tet10_mesh(
    surface: PatchSurface, sizes: Sizes, mesher: str = "gmsh", *, time_limit: float = 120.0
) -> Meshed:
    """Curved ten-node tets of a body; Gmsh straightens its worst mid nodes itself.

    Parameters
    ----------
    surface : PatchSurface
    sizes : Sizes
    mesher : {"gmsh", "netgen"}
        Netgen grades by sizes at the points of a grid, since it knows no field.
    time_limit : float
        Seconds on the wall.

    Raises
    ------
    MesherError
        The mesher crashed, found no end or no mesh of the body.
    """
    if mesher not in MESHERS:
        raise InputError(f"{mesher!r} is no mesher", remedy=f"take one of {', '.join(MESHERS)}")
    return _mesh(surface, {"kind": mesher, "sizes": asdict(sizes)}, time_limit)


def layered_mesh(
    surface: PatchSurface,
    sizes: Sizes,
    heights: Sequence[float],
    faces: Sequence[str] = (),
    *,
    limit: bool = False,
    time_limit: float = 120.0,
) -> Meshed:
    """Netgen's boundary layers of wedges, and curved ten-node tets in the core.

    Parameters
    ----------
    surface : PatchSurface
    sizes : Sizes
        Of the core and of the triangles on the faces.
    heights : sequence of float
        Of the layers from outside, mm.
    faces : sequence of str
        CAD faces that get layers; all, where none is named.
    limit : bool
        Netgen's ``limit_growth_vectors``.
    time_limit : float
        Seconds on the wall.

    Raises
    ------
    MesherError
        As for :func:`tet10_mesh`.
    """
    task = {
        "kind": "layers",
        "sizes": asdict(sizes),
        "heights": [float(height) for height in heights],
        "faces": list(faces),
        "limit": bool(limit),
    }
    return _mesh(surface, task, time_limit)


def _mesh(surface: PatchSurface, task: dict[str, Any], time_limit: float) -> Meshed:
    """Run a mesher, read and check its answer."""
    if free_only():
        raise MesherError("left out: the bodies are handed over by Gmsh, which is under the GPL")
    from ..exchange import write_surface
    from ..scripting import _faces_of_surface

    names = list(dict.fromkeys(patch.face for patch in surface.patches))
    unknown = [n for n in (*task["sizes"]["faces"], *task.get("faces", ())) if n not in names]
    if unknown:
        raise InputError("there is no such face", faces=unknown)
    with tempfile.TemporaryDirectory(prefix="hybridvolume-") as folder:
        write_surface(Path(folder) / "surface.npz", _faces_of_surface(surface))
        rank = np.argsort(np.argsort(-surface.shell_volumes(settle=False)))
        task["shells"] = rank[surface.shell_of_patch].tolist()
        (Path(folder) / "task.json").write_text(json.dumps(task), encoding="utf-8")
        _run(Path(folder), time_limit)
        with np.load(Path(folder) / "answer.npz", allow_pickle=False) as answer:
            found = {name: answer[name] for name in answer.files}
    return _checked(surface, names, task["kind"], found)


def _run(folder: Path, time_limit: float) -> None:
    command = [sys.executable, "-m", __spec__.name if __spec__ else __name__, str(folder)]
    environment = {**os.environ, "PYTHONPATH": str(_PROJECT), "OMP_NUM_THREADS": "1"}
    with open(folder / "log.txt", "w+b") as log:
        try:
            done = subprocess.run(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=subprocess.STDOUT,
                env=environment, cwd=folder, timeout=time_limit, check=False,
            )  # fmt: skip
        except subprocess.TimeoutExpired:
            raise MesherError(f"no end within {time_limit:g} s") from None
        log.seek(0)
        said = [line.strip() for line in log.read().decode(errors="replace").split("\n")]
    if not (folder / "answer.npz").is_file():
        last = next((line for line in reversed(said) if line), "no word")
        raise MesherError(f"no mesh (code {done.returncode}): {last[:300]}")


def _checked(
    surface: PatchSurface, names: list[str], kind: str, found: Mapping[str, np.ndarray]
) -> Meshed:
    """The mesh, after a check of faces and volume, and a proof of its elements."""
    nodes, prisms, tets = found["nodes"], found["prisms"], found["tets"]
    used, number = np.unique(np.concatenate([prisms.ravel(), tets.ravel()]), return_inverse=True)
    nodes = nodes[used]
    prisms = number[: prisms.size].reshape(prisms.shape)
    tets = number[number.size - tets.size :].reshape(tets.shape)
    place = np.full(len(found["nodes"]), -1)
    place[used] = np.arange(len(used))
    elements = tuple(e for e in (("penta15", prisms), ("tet10", tets)) if len(e[1]))
    filled = sum(float(volumes(k, nodes[rows]).sum()) for k, rows in elements)
    volume = surface.volume()
    if abs(filled / volume - 1.0) > OFF:
        raise MesherError(f"the elements have {filled:.6g} mm³, the body {volume:.6g}")
    triangles = _outward(nodes, elements, place[found["triangles"]])
    faces = {name: ("tri6", triangles[found["face"] == k]) for k, name in enumerate(names)}
    _check_places(surface, names, nodes, faces)
    bad = sum(int(np.count_nonzero(~prove_positive(k, nodes[rows]).proved)) for k, rows in elements)
    label = {"gmsh": "tet10 by Gmsh", "netgen": "tet10 by Netgen", "layers": "layers by Netgen"}
    return Meshed(nodes, elements, faces, label[kind], bad)


def _outward(
    nodes: np.ndarray, elements: Sequence[tuple[str, np.ndarray]], triangles: np.ndarray
) -> np.ndarray:
    """Triangles in the order of nodes that the elements over them have, normals outward."""
    sides = []
    for kind, rows in elements:
        for face in FACES[kind]:
            if len(face) == 6:
                sides.append(rows[:, face])
            elif len(face) != 8:
                raise FaultError(f"{kind} has a face of {len(face)} nodes")
    sides = np.concatenate(sides)
    keys = np.sort(sides[:, :3], axis=1)
    _, first, inverse, count = np.unique(
        keys, axis=0, return_index=True, return_inverse=True, return_counts=True
    )
    outer = sides[first[count == 1]]
    _, at = np.unique(keys[first[count == 1]], axis=0, return_index=True)
    outer = outer[at]
    wanted = np.sort(triangles[:, :3], axis=1)
    known = {tuple(row): k for k, row in enumerate(np.sort(outer[:, :3], axis=1).tolist())}
    try:
        order = [known[tuple(row)] for row in wanted.tolist()]
    except KeyError:
        raise MesherError("a triangle on a CAD face belongs to no element") from None
    if len(set(order)) != len(outer) or len(order) != len(outer):
        raise MesherError(
            f"{len(set(order))} of {len(outer)} outer faces of elements are known on CAD faces"
        )
    return outer[order]


def _check_places(
    surface: PatchSurface, names: Sequence[str], nodes: np.ndarray, faces: Mapping[str, Any]
) -> None:
    """Refuse triangles that do not lie on the face whose name they have, or miss a part of it."""
    line = np.linspace(0.0, 1.0, 33)
    for name in names:
        points = []
        for number, patch in enumerate(surface.patches):
            if patch.face != name:
                continue
            ends = [np.unique(knots) for knots in patch.knots]
            u, v = (np.interp(line, np.linspace(0, 1, len(e)), e) for e in ends)
            u, v = (a.ravel() for a in np.meshgrid(u, v))
            points.append(surface.evaluate_at(np.full(u.size, number), u, v))
        samples = np.concatenate(points)
        own = nodes[np.unique(faces[name][1])]
        spacing = 2.0 * float(cKDTree(samples).query(samples, 2)[0][:, 1].max())
        off = float(cKDTree(samples).query(own)[0].max(initial=np.inf if not len(own) else 0.0))
        if off > spacing + OFF * surface.diagonal:
            raise MesherError(f"nodes on {name} lie up to {off:.2g} mm beside it", faces=[name])
        corners = nodes[faces[name][1][:, :3]]
        edge = float(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max())
        missed = float(cKDTree(own).query(samples)[0].max())
        if missed > edge + spacing:
            raise MesherError(f"the triangles on {name} leave {missed:.2g} mm out", faces=[name])


# --------------------------------------------------------------------- in the mesher's process


def main(arguments: Sequence[str] | None = None) -> int:
    """Mesh the body in a folder and write ``answer.npz`` there."""
    from ..exchange import read_surface

    (folder,) = map(Path, sys.argv[1:] if arguments is None else arguments)
    task = json.loads((folder / "task.json").read_text(encoding="utf-8"))
    surface = read_surface(folder / "surface.npz")
    part = folder / "answer.part.npz"
    gmsh = _Gmsh(surface, task["shells"], Sizes(**task["sizes"]))
    if task["kind"] == "gmsh":
        nodes, tets, triangles, face = gmsh.tets()
        prisms = np.zeros((0, 15), dtype=np.int64)
    else:
        brep = folder / "body.brep"
        gmsh.write(brep)
        nodes, prisms, tets, triangles, face = _netgen(brep, gmsh, task)
    np.savez(part, nodes=nodes, prisms=prisms, tets=tets, triangles=triangles, face=face)
    os.replace(part, folder / "answer.npz")
    sys.stdout.flush()
    # the answer is told; a mesher's own clean-up at exit may crash and tells nothing
    os._exit(0)


class _Gmsh:
    """A body in Gmsh, made of its patches; ``names`` are those of its faces in their order."""

    def __init__(self, faces: Sequence[SplineFace], shells: Sequence[int], sizes: Sizes) -> None:
        import gmsh

        gmsh.initialize(interruptible=False)
        gmsh.option.setNumber("General.NumThreads", 1)
        self.gmsh, self.sizes, self.occ = gmsh, sizes, gmsh.model.occ
        points = np.concatenate([f.control_points.reshape(-1, 3) for f in faces])
        self.diagonal = float(np.linalg.norm(np.ptp(points, axis=0)))
        gmsh.option.setNumber("Geometry.Tolerance", 1e-7 * self.diagonal)
        self.order = list(dict.fromkeys(face.name for face in faces))
        tags = np.array([self._add(face) for face in faces])
        # sewing makes copies of the surfaces; the first shell is the outermost
        loops = [
            self.occ.addSurfaceLoop(tags[np.array(shells) == k].tolist(), sewing=True)
            for k in range(max(shells) + 1)
        ]
        solid = self.occ.addVolume(loops)
        self.occ.synchronize()
        kept = {tag for _, tag in gmsh.model.getBoundary([(3, solid)], oriented=False)}
        self.occ.remove([(2, int(tag)) for tag in tags if tag not in kept], recursive=True)
        self.occ.synchronize()
        self.tags = [tag for _, tag in gmsh.model.getEntities(2)]
        self.name_of = self._named(faces)

    def _add(self, face: SplineFace) -> int:
        counts, knots = [], []
        for line in face.knots:
            values, multiplicities = np.unique(line, return_counts=True)
            knots.append(values.tolist())
            counts.append(multiplicities.tolist())
        net = face.control_points
        # the first parameter runs fastest
        points = [self.occ.addPoint(*p) for p in net.transpose(1, 0, 2).reshape(-1, 3).tolist()]
        return self.occ.addBSplineSurface(
            points, net.shape[0], degreeU=face.degrees[0], degreeV=face.degrees[1],
            weights=face.weights.T.ravel().tolist(), knotsU=knots[0], knotsV=knots[1],
            multiplicitiesU=counts[0], multiplicitiesV=counts[1],
        )  # fmt: skip

    def _named(self, faces: Sequence[SplineFace]) -> list[str]:
        """Name of each surface, found by points in the middle of the faces."""
        found: dict[int, str] = {}
        for face in faces:
            probes = []
            for share in ((0.5, 0.5), (0.31, 0.62), (0.73, 0.27)):
                uv = [k[0] + s * (k[-1] - k[0]) for k, s in zip(face.knots, share, strict=True)]
                probes.append(_evaluate(face, *uv))
            probes = np.array(probes)
            off = []
            for tag in self.tags:
                near, _ = self.gmsh.model.getClosestPoint(2, tag, probes.ravel().tolist())
                off.append(np.abs(np.reshape(near, (-1, 3)) - probes).max())
            best = int(np.argmin(off))
            if off[best] > 1e-6 * self.diagonal or self.tags[best] in found:
                raise RuntimeError(f"sewing lost {face.name}")
            found[self.tags[best]] = face.name
        if len(found) != len(self.tags):
            raise RuntimeError(f"sewing gave {len(self.tags)} faces of {len(faces)}")
        return [found[tag] for tag in self.tags]

    def write(self, path: Path) -> None:
        """Write the body; its faces keep their order."""
        self.gmsh.write(str(path))

    def tets(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Nodes, ten-node tets, six-node triangles on the faces, and the face of each."""
        gmsh, mesh = self.gmsh, self.gmsh.model.mesh
        for name in ("MeshSizeExtendFromBoundary", "MeshSizeFromPoints", "MeshSizeFromCurvature"):
            gmsh.option.setNumber(f"Mesh.{name}", 0)
        size, slope = self.sizes.size, self.sizes.slope
        gmsh.option.setNumber("Mesh.MeshSizeMin", size)
        gmsh.option.setNumber("Mesh.MeshSizeMax", size if not slope else 10.0 * self.diagonal)
        if slope:
            chosen = self.sizes.faces or self.order
            field = mesh.field.add("Distance")
            near = [t for t, n in zip(self.tags, self.name_of, strict=True) if n in chosen]
            mesh.field.setNumbers(field, "SurfacesList", near)
            mesh.field.setNumber(field, "Sampling", 40)
            grown = mesh.field.add("MathEval")
            mesh.field.setString(grown, "F", f"{size!r}*(1+{slope!r}*F{field})")
            mesh.field.setAsBackgroundMesh(grown)
        mesh.generate(3)
        mesh.setOrder(2)
        mesh.optimize("HighOrder")
        tags, points, _ = mesh.getNodes()
        number = np.zeros(int(tags.max()) + 1, dtype=np.int64)
        number[tags] = np.arange(len(tags))
        kinds, _, rows = mesh.getElements(3)
        if list(kinds) != [11]:
            raise RuntimeError(f"elements of the kinds {list(kinds)}")
        tets = number[rows[0].reshape(-1, 10)][:, GMSH_TET]
        triangles, face = [], []
        for tag, name in zip(self.tags, self.name_of, strict=True):
            own = mesh.getElementsByType(9, tag)[1].reshape(-1, 6)
            triangles.append(number[own])
            face.append(np.full(len(own), self.order.index(name)))
        return points.reshape(-1, 3), tets, np.concatenate(triangles), np.concatenate(face)


def _evaluate(face: SplineFace, u: float, v: float) -> np.ndarray:
    """Point of a face."""
    from ..core import bspline

    left = bspline.basis_matrix(face.degrees[0], face.knots[0], np.array([u])).toarray()[0]
    right = bspline.basis_matrix(face.degrees[1], face.knots[1], np.array([v])).toarray()[0]
    act = np.outer(left, right) * face.weights
    return np.einsum("ab,abd->d", act, face.control_points) / act.sum()


def _netgen(brep: Path, gmsh: _Gmsh, task: dict[str, Any]) -> tuple[np.ndarray, ...]:
    """Nodes, prisms, tets, triangles on the faces, and the face of each, by Netgen."""
    from netgen import meshing
    from netgen.occ import OCCGeometry

    sizes = gmsh.sizes
    geometry = OCCGeometry(str(brep))
    shape = geometry.shape
    if len(shape.faces) != len(gmsh.tags):
        raise RuntimeError(f"Netgen reads {len(shape.faces)} faces of {len(gmsh.tags)}")
    chosen = sizes.faces or tuple(gmsh.order)
    for face, name in zip(shape.faces, gmsh.name_of, strict=True):
        face.name = name
        if name in chosen:
            face.maxh = sizes.size
    wanted: dict[str, Any] = {"maxh": sizes.size}
    if sizes.slope:
        wanted = {"maxh": sizes.size * (1.0 + sizes.slope * gmsh.diagonal)}
        # Netgen's grading is the growth of the size a step, as the slope is
        wanted["grading"] = float(np.clip(sizes.slope * sizes.size, 0.05, 1.0))
    if task["kind"] == "layers":
        wanted["boundary_layers"] = [
            meshing.BoundaryLayerParameters(
                boundary="|".join(task["faces"]) or ".*",
                thickness=task["heights"],
                new_material="layer",
                domain=".*",
                outside=False,
                limit_growth_vectors=task["limit"],
                disable_curving=False,
            )
        ]
    mesh = OCCGeometry(shape).GenerateMesh(**wanted)
    mesh.SecondOrder()
    nodes = np.array([point.p for point in mesh.Points()])
    elements = [[v.nr - 1 for v in element.points] for element in mesh.Elements3D()]
    prisms = np.array([e for e in elements if len(e) == 12], dtype=np.int64).reshape(-1, 12)
    tets = np.array([e for e in elements if len(e) == 10], dtype=np.int64).reshape(-1, 10)
    if len(prisms) + len(tets) != len(elements):
        raise RuntimeError("elements that are neither prisms nor tetrahedra")
    prisms, tets = prisms[:, NETGEN_PRISM], tets[:, NETGEN_TET]
    # upright edges are straight; one mid node each makes wedges of 15 nodes
    pairs = np.stack([prisms[:, :3], prisms[:, 3:6]], axis=2).reshape(-1, 2)
    edges, which = np.unique(np.sort(pairs, axis=1), axis=0, return_inverse=True)
    prisms = np.hstack([prisms, len(nodes) + which.reshape(-1, 3)])
    nodes = np.concatenate([nodes, nodes[edges].mean(axis=1)])
    outer = _outer_corners(prisms, tets)
    triangles, face = [], []
    for element in mesh.Elements2D():
        points = [v.nr - 1 for v in element.points]
        name = mesh.FaceDescriptor(element.index).bcname
        if len(points) != 6:
            raise RuntimeError("a face without layers meets one with layers")
        if tuple(sorted(points[:3])) in outer:
            triangles.append(points)
            face.append(gmsh.order.index(name))
    return nodes, prisms, tets, np.array(triangles), np.array(face)


def _outer_corners(prisms: np.ndarray, tets: np.ndarray) -> set[tuple[int, ...]]:
    """Corners of the triangles that one element only has."""
    sides = [rows[:, face[:3]] for kind, rows in (("penta6", prisms), ("tet4", tets))
             for face in FACES[kind] if len(face) == 3]  # fmt: skip
    keys, count = np.unique(np.sort(np.concatenate(sides), axis=1), axis=0, return_counts=True)
    return set(map(tuple, keys[count == 1].tolist()))


if __name__ == "__main__":
    main()
