# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Sums of loads on curved faces: what FreeCAD's own writer gives to CalculiX, beside the integrals.

A force, a pressure and the weight are put on the CAD body as a user does. FreeCAD writes its deck;
CalculiX reads it, held at three nodes that bear no load, and tells the forces at all nodes. The
integrals are those over the exact surface. Needs FreeCAD.
"""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.core.elements import quadrature, shape_gradients
from HybridVolume.errors import FaultError, SetupError, WorkerError
from HybridVolume.exports.inp import Material, nodal_forces, write_inp
from HybridVolume.freecad_python import import_freecad

from .calculix import check_support, frd_block

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.surface import PatchSurface

FORCE, PRESSURE = 1000.0, 1.0
"""N, MPa."""
POINTS = 24
"""Gauss points a direction in every knot span."""
TIME_LIMIT = 600.0
_LEAST_RESULTANT = 0.2
"""Share of a face's area that its vector area should have."""


@dataclass(frozen=True)
class FaceIntegrals:
    """Integrals over the exact face.

    Attributes
    ----------
    area : float
        mm²
    vector : (3,) array
        Integral of the normal out of the body, mm².
    centre : (3,) array
        Of the area, mm.
    """

    area: float
    vector: np.ndarray
    centre: np.ndarray

    @property
    def curved(self) -> float:
        """1 less the length of the vector area over the area; 0 is plane."""
        return 1.0 - float(np.linalg.norm(self.vector)) / self.area


def make(
    volume: HybridVolume, brep: Path, folder: Path, progress: Callable[[float, str], None]
) -> dict[str, Any]:
    """Figures of one body, under the names of fem.json.

    Parameters
    ----------
    volume : HybridVolume
    brep : Path
        The body as FreeCAD reads it.
    folder : Path
        For decks.
    progress : callable
        Called with the share of the work and a text.

    Returns
    -------
    dict
        ``face``, its ``area``, how ``curved`` it is, and ``rows``: one load each, with ``exact``,
        ``freecad``, ``ours`` and ``mesh`` (the integral over the mesh), N, and their relative
        errors.

    Raises
    ------
    SetupError
        There is no FreeCAD or no CalculiX.
    HybridVolumeError
        FreeCAD does not take the mesh, or CalculiX not a deck.
    """
    freecad = import_freecad()
    program = shutil.which("ccx")
    if program is None:
        raise SetupError("CalculiX (ccx) is not installed", remedy="install calculix-ccx")
    face, exact = curved_face(volume.surface)
    fem = volume.fem
    bench = _Bench(freecad, volume, brep, folder, program)
    try:
        first, second = bench.supports(face)
        progress(0.1, "force")
        rows = [_force(bench, face, exact)]
        progress(0.3, "pressure")
        rows.append(_pressure(bench, face, exact, first))
        progress(0.6, "weight")
        rows.append(_weight(bench, volume.surface.volume(), first, second))
    finally:
        freecad.closeDocument(bench.doc.Name)
    return {
        "freecad_version": ".".join(freecad.Version()[:3]),
        "nodes": len(fem.nodes),
        "face": face,
        "area": exact.area,
        "curved": exact.curved,
        "triangles": len(fem.face_triangles(face)),
        "rows": rows,
    }


def curved_face(surface: PatchSurface) -> tuple[str, FaceIntegrals]:
    """The face with the most area that is curved, and its integrals."""
    names = dict.fromkeys(patch.face for patch in surface.patches)
    found = {name: face_integrals(surface, name) for name in names}

    def rank(name: str) -> tuple[bool, float]:
        one = found[name]
        return 1.0 - one.curved >= _LEAST_RESULTANT, one.area * one.curved

    best = max(found, key=rank)
    return best, found[best]


def face_integrals(surface: PatchSurface, name: str) -> FaceIntegrals:
    """Integrals over one CAD face, by Gauss points in every knot span of the exact surface."""
    x, weight = np.polynomial.legendre.leggauss(POINTS)
    x, weight = 0.5 * (x + 1.0), 0.5 * weight
    weights = np.multiply.outer(weight, weight).ravel()
    members = [n for n, patch in enumerate(surface.patches) if patch.face == name]
    elements = np.flatnonzero(np.isin(surface.element_patch, members))
    samples = surface.element_samples(x, x, elements)
    places, along_u, along_v = samples.surface(surface.control_points)
    normal = np.cross(along_u, along_v)
    area = np.linalg.norm(normal, axis=1) * np.tile(weights, len(elements))
    total = float(area.sum())
    return FaceIntegrals(total, np.tile(weights, len(elements)) @ normal, area @ places / total)


class _Bench:
    """A document with the body and its mesh, and CalculiX."""

    def __init__(
        self, freecad: Any, volume: HybridVolume, brep: Path, folder: Path, program: str
    ) -> None:
        import Part

        from HybridVolume.objects.analysis import make_analysis
        from HybridVolume.objects.document import insert_mesh

        self.freecad, self.fem, self.folder, self.program = freecad, volume.fem, folder, program
        self.doc = freecad.newDocument("loads", hidden=True, temp=True)
        self.body = self.doc.addObject("Part::Feature", "Body")
        shape = Part.Shape()
        shape.read(str(brep))
        self.body.Shape = shape.Solids[0]
        self.doc.recompute()
        try:
            self.mesh = insert_mesh(self.doc, self.fem, self.body, volume.surface)
        except FaultError as error:
            if not error.figure:
                raise
            # what a user is told to do
            shape = self.body.Shape.copy()
            shape.fixTolerance(error.figure)
            self.body.Shape = shape
            self.doc.recompute()
            self.mesh = insert_mesh(self.doc, self.fem, self.body, volume.surface)
        nodes = self.mesh.FemMesh.Nodes
        places = np.array([tuple(nodes[n]) for n in range(1, len(self.fem.nodes) + 1)])
        if not np.array_equal(places, self.fem.nodes):
            raise FaultError("FreeCAD's nodes are not in the order of the mesh")
        self.analysis = make_analysis(self.mesh)

    def deck(self, load: Any) -> str:
        """FreeCAD's deck of one load."""
        import ObjectsFem
        from femtools import ccxtools

        held = ObjectsFem.makeConstraintFixed(self.doc)
        held.References = [(self.body, "Vertex1")]
        self.analysis.addObjects([held, load])
        self.doc.recompute()
        (solver,) = [one for one in self.analysis.Group if "Solver" in one.Name]
        run = ccxtools.FemToolsCcx(self.analysis, solver, test_mode=False)
        run.update_objects()
        run.setup_working_dir(str(self.folder))
        run.setup_ccx()
        missing = run.check_prerequisites()
        if missing:
            raise FaultError(f"FreeCAD lacks {missing.strip()}")
        run.write_inp_file()
        text = Path(run.inp_file_name).read_text(encoding="utf-8")
        for one in (held, load):
            self.doc.removeObject(one.Name)
        return text

    def line(self, direction: np.ndarray) -> Any:
        """A straight edge in the document, which a user picks for a direction."""
        import Part

        line = self.doc.addObject("Part::Feature", "Line")
        line.Shape = Part.makeLine(self.freecad.Vector(), self.freecad.Vector(*direction))
        return line

    def supports(self, face: str) -> tuple[list[tuple[int, int]], list[tuple[int, int]]]:
        """Two statically determinate supports without a common node, off a face."""
        fem = self.fem
        corners = np.unique(fem.boundary[:, :3])
        first = determinate(fem.nodes, np.setdiff1d(corners, fem.face_nodes(face)))
        second = np.setdiff1d(corners, [node for node, _ in first])
        return first, determinate(fem.nodes, second)

    def nodal_forces(self, deck: str, held: Sequence[tuple[int, int]], name: str) -> np.ndarray:
        """Force from outside at every node as CalculiX computes it from a deck, (n, 3), N.

        At the nodes that are held it is the reaction and the load together.
        """
        (self.folder / f"{name}.inp").write_text(with_support(deck, held), encoding="utf-8")
        try:
            done = subprocess.run(
                [self.program, name],
                cwd=self.folder,
                stdin=subprocess.DEVNULL,
                capture_output=True,
                timeout=TIME_LIMIT,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise WorkerError(f"CalculiX did not finish within {TIME_LIMIT:g} s") from None
        if done.returncode or b"*ERROR" in done.stdout or b"Job finished" not in done.stdout:
            raise WorkerError(f"CalculiX ended with {done.returncode} on the deck {name}")
        numbers, forces = frd_block((self.folder / f"{name}.frd").read_bytes(), "FORC", 3)
        if len(numbers) != len(self.fem.nodes):
            raise WorkerError(f"CalculiX has {len(numbers)} of {len(self.fem.nodes)} nodes")
        found = np.zeros_like(self.fem.nodes)
        found[numbers - 1] = forces
        return found


def determinate(nodes: np.ndarray, candidates: np.ndarray) -> list[tuple[int, int]]:
    """Six (node, axis) pairs that hold a body without strain, at three nodes far apart.

    Raises
    ------
    InputError
        The candidates stand in a line.
    """
    x = nodes[candidates]
    first = int(np.argmax(np.linalg.norm(x - x.mean(axis=0), axis=1)))
    along = x - x[first]
    second = int(np.argmax(np.linalg.norm(along, axis=1)))
    across = np.cross(along[second], along)
    third = int(np.argmax(np.linalg.norm(across, axis=1)))
    main = int(np.argmax(np.abs(along[second])))
    pairs = [(first, axis) for axis in range(3)]
    pairs += [(second, axis) for axis in range(3) if axis != main]
    pairs.append((third, int(np.argmax(np.abs(across[third])))))
    found = [(int(candidates[node]), axis) for node, axis in pairs]
    prescribed = np.full_like(nodes, np.nan)
    prescribed[tuple(np.array(found).T)] = 0.0
    check_support(nodes, prescribed)
    return found


def blocks(deck: str) -> list[tuple[str, list[str]]]:
    """Keyword lines of a deck, each with the lines that belong to it."""
    found: list[tuple[str, list[str]]] = []
    for line in deck.splitlines():
        if line.startswith("**") or not line.strip():
            continue
        if line.startswith("*"):
            found.append((line, []))
        elif found:
            found[-1][1].append(line)
    return found


def with_support(deck: str, held: Sequence[tuple[int, int]]) -> str:
    """A deck with its model and its loads, another support, and the nodes' forces as result."""
    model, loads, step = [], [], False
    for keyword, lines in blocks(deck):
        word = keyword.split(",")[0].strip().upper()
        step |= word == "*STEP"
        if not step and word not in ("*BOUNDARY", "*INCLUDE"):
            model += [keyword, *lines]
        elif word in ("*CLOAD", "*DLOAD"):
            loads += [keyword, *lines]
    fixed = [f"{node + 1},{axis + 1},{axis + 1}" for node, axis in held]
    end = ["*NODE FILE", "RF", "*END STEP"]
    return "\n".join([*model, "*STEP", "*STATIC", "*BOUNDARY", *fixed, *loads, *end]) + "\n"


def concentrated(deck: str, count: int) -> np.ndarray:
    """Sum of a deck's forces at each node, (count, 3), N."""
    total = np.zeros((count, 3))
    for keyword, lines in blocks(deck):
        if keyword.split(",")[0].strip().upper() == "*CLOAD":
            for line in lines:
                node, axis, value = line.split(",")[:3]
                total[int(node) - 1, int(axis) - 1] += float(value)
    return total


def _force(bench: _Bench, face: str, exact: FaceIntegrals) -> dict[str, Any]:
    """A force against the mean normal: sums at the nodes, and where they act."""
    import ObjectsFem

    direction = -exact.vector / np.linalg.norm(exact.vector)
    load = ObjectsFem.makeConstraintForce(bench.doc)
    load.References = [(bench.body, face)]
    # newer versions have a quantity here
    load.Force = FORCE if bench.freecad.Version()[0] == "0" else f"{FORCE} N"
    load.Direction = (bench.line(direction), ["Edge1"])
    bench.doc.recompute()
    load.Reversed = float(np.dot(tuple(load.DirectionVector), direction)) < 0.0
    deck = bench.deck(load)
    wanted = FORCE * direction
    theirs = concentrated(deck, len(bench.fem.nodes))
    nodes, loads = nodal_forces(bench.fem, face, wanted)
    ours = np.zeros_like(theirs)
    ours[nodes] = loads
    row = _row("force", wanted, {"freecad": theirs.sum(axis=0), "ours": ours.sum(axis=0)})
    for name, forces in (("freecad", theirs), ("ours", ours)):
        along = forces @ direction
        centre = along @ bench.fem.nodes / along.sum()
        row[f"{name}_centre_off"] = float(
            np.linalg.norm(centre - exact.centre) / np.sqrt(exact.area)
        )
    return row


def _pressure(
    bench: _Bench, face: str, exact: FaceIntegrals, held: Sequence[tuple[int, int]]
) -> dict[str, Any]:
    import ObjectsFem

    load = ObjectsFem.makeConstraintPressure(bench.doc)
    load.References = [(bench.body, face)]
    load.Pressure = PRESSURE if bench.freecad.Version()[0] == "0" else f"{PRESSURE} MPa"
    load.Reversed = False
    deck = bench.deck(load)
    own = bench.folder / "own.inp"
    write_inp(own, bench.fem, material=Material(), pressure={face: PRESSURE})
    free = np.setdiff1d(np.arange(len(bench.fem.nodes)), [node for node, _ in held])
    sums = {
        name: bench.nodal_forces(text, held, f"pressure_{name}")[free].sum(axis=0)
        for name, text in (("freecad", deck), ("ours", own.read_text(encoding="ascii")))
    }
    # the same integral over the mesh's own triangles
    points, weights = quadrature("tri", 3)
    tangents = np.einsum(
        "qnd,tnc->tqcd",
        shape_gradients(bench.fem.face_kind, points),
        bench.fem.nodes[bench.fem.face_triangles(face)],
    )
    normal = np.einsum("tqc,q->c", np.cross(tangents[..., 0], tangents[..., 1]), weights)
    row = _row("pressure", -PRESSURE * exact.vector, {**sums, "mesh": -PRESSURE * normal})
    row["freecad_faces"] = sum(
        len(lines) for keyword, lines in blocks(deck) if keyword.upper().startswith("*DLOAD")
    )
    return row


def _weight(
    bench: _Bench,
    volume: float,
    first: Sequence[tuple[int, int]],
    second: Sequence[tuple[int, int]],
) -> dict[str, Any]:
    import ObjectsFem

    load = ObjectsFem.makeConstraintSelfWeight(bench.doc)
    deck = bench.deck(load)
    gravity = re.search(r"^\S+,\s*GRAV\s*,(.*)$", deck, re.MULTILINE | re.IGNORECASE)
    density = re.search(r"^\*DENSITY[^\n]*\n([^\n,]+)", deck, re.MULTILINE | re.IGNORECASE)
    if gravity is None or density is None:
        raise FaultError("FreeCAD's deck has no weight")
    size, *direction = (float(x) for x in gravity[1].split(","))
    exact = float(density[1]) * size * volume * np.array(direction)
    mesh = exact * bench.fem.volume / volume
    forces = bench.nodal_forces(deck, first, "weight_first")
    # at nodes that are held the reaction is in it: there the other run tells the load
    nodes = [node for node, _ in first]
    forces[nodes] = bench.nodal_forces(deck, second, "weight_second")[nodes]
    sums = {"freecad": forces.sum(axis=0), "mesh": mesh}
    return {**_row("weight", exact, sums), "acceleration": size}


def _row(load: str, exact: np.ndarray, sums: dict[str, np.ndarray]) -> dict[str, Any]:
    row: dict[str, Any] = {"load": load, "exact": exact.tolist()}
    for name, total in sums.items():
        row[name] = total.tolist()
        row[f"{name}_error"] = float(np.linalg.norm(total - exact) / np.linalg.norm(exact))
    return row
