# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Stresses at the nodes from a solver's displacements, as a result of the FEM workbench."""

from __future__ import annotations

import logging
import re
from typing import Any

import FreeCAD
import numpy as np
import ObjectsFem
from femresult import resulttools

from HybridVolume.core.boundary_surface import Boundary, BoundarySurface
from HybridVolume.core.elements import from_order
from HybridVolume.core.exact_boundary import boundary_of
from HybridVolume.core.hybrid import load
from HybridVolume.core.recovery import COMPONENTS, Material, NodalStress, in_frame, recover
from HybridVolume.errors import FaultError, FileFormatError, InputError, OutOfDateError

from .analysis import mesh_in, require_current, require_static
from .loads import face_pressures, misplaced
from .properties import transaction

logger = logging.getLogger(__name__)

NAME = "HybridVolume_Results"
"""Name of the result object; the solver's own stays beside it."""

_FACE = re.compile(r"Face\d+")
_SAME_PLACE = 1e-4
"""Distance of a result's nodes from the mesh's, as a share of its size: files round them."""

_BOUNDARY = (
    ("BoundaryNodes", "IntegerList", "Numbers of the nodes on the boundary."),
    ("BoundaryNormals", "VectorList", "Outward normals there."),
    ("NormalStress", "FloatList", "Stress along the normal, MPa."),
    ("ShearStress", "FloatList", "Size of the shear stress in the boundary, MPa."),
    ("TangentialMax", "FloatList", "Largest normal stress along the boundary, MPa."),
    ("TangentialMin", "FloatList", "Smallest normal stress along the boundary, MPa."),
    ("FaceLoads", "StringList", "Load on each face, as the displacements tell it."),
)

_KINDS = {4: "tet4", 6: "penta6", 10: "tet10", 15: "penta15"}


def recover_stress(analysis: Any) -> Any:
    """Put strain and stress from the displacements into an analysis, in one step of Undo.

    Parameters
    ----------
    analysis : App.DocumentObject
        Solved, with the mesh of a hybrid volume.

    Returns
    -------
    App.DocumentObject
        A result of the FEM workbench with all that the solver's has; strains, stresses, von Mises
        and principal values are those of `HybridVolume.core.recovery`. At nodes of two materials
        they are those of the first, which has the boundary.

    Raises
    ------
    InputError
        The mesh is no hybrid volume's or out of date, or nothing was solved yet.
    """
    mesh = mesh_in(analysis)
    require_current(mesh)
    results = [
        one
        for one in analysis.Group
        if one.isDerivedFrom("Fem::FemResultObject")
        and not one.Name.startswith(NAME)
        and getattr(one, "DisplacementVectors", None)
    ]
    if not results:
        raise InputError(
            f"{analysis.Label} has no displacements yet", remedy="run its solver first"
        )
    require_static(analysis)
    for error in misplaced(analysis, mesh):
        raise error
    solved = results[-1]
    numbers, nodes, groups = _arrays(mesh.FemMesh)
    displacement = _displacement(solved, numbers, nodes, mesh.Label)
    names, boundary = _boundary(analysis, mesh, numbers, nodes)
    parts = [
        recover(nodes, elements, displacement, material, boundary=boundary)
        for material, elements in _materials(analysis, mesh.FemMesh, groups)
    ]
    with transaction(analysis.Document, "Recover stresses"):
        for old in [one for one in analysis.Group if one.Name.startswith(NAME)]:
            analysis.Document.removeObject(old.Name)
        result = ObjectsFem.makeResultMechanical(analysis.Document, NAME)
        result.Label = "Stresses from displacements"
        result.Mesh = solved.Mesh
        strain, stress = _merged(parts, len(numbers))
        _fill(result, solved, strain, stress)
        _add_boundary(result, numbers, nodes, names, boundary, stress, parts[0])
        analysis.addObject(result)
    return result


def _arrays(mesh: Any) -> tuple[np.ndarray, np.ndarray, dict[int, tuple[str, np.ndarray]]]:
    """Node numbers, their places, and kind and connectivity (rows of nodes) of every volume."""
    table = mesh.Nodes
    numbers = np.array(sorted(table))
    nodes = np.array([tuple(table[number]) for number in numbers.tolist()])
    rows = {element: mesh.getElementNodes(element) for element in mesh.Volumes}
    volumes = {}
    for element, members in rows.items():
        volumes[element] = (_KINDS[len(members)], np.searchsorted(numbers, members))
    return numbers, nodes, volumes


def _boundary(
    analysis: Any, mesh: Any, numbers: np.ndarray, nodes: np.ndarray
) -> tuple[tuple[str, ...], Boundary]:
    """Names of the CAD faces, and the boundary with what the document knows of it.

    Exact normals are those of the stored shell, where the mesh is the one of its result.
    """
    table = mesh.FemMesh
    groups = {table.getGroupName(g): table.getGroupElements(g) for g in table.Groups}
    faces = {name: members for name, members in groups.items() if _FACE.fullmatch(name)}
    names = tuple(faces)
    pressures = face_pressures(analysis, names)
    rows, owner = [], []
    for number, members in enumerate(faces.values()):
        rows += [table.getElementNodes(element) for element in members]
        owner += [number] * len(members)
    if not rows:
        raise InputError(
            f"{mesh.Label} has no groups of boundary faces", remedy="mesh the volume again"
        )
    given = np.searchsorted(numbers, np.array(rows, dtype=int))
    triangles = from_order("freecad", f"tri{given.shape[1]}", given)
    face = np.array(owner, dtype=int)
    plain = Boundary(triangles, face, pressure=pressures[face])
    stored = [one for one in mesh.InList if getattr(one, "FemMesh", None) == mesh and one.Result]
    if not stored:
        return names, plain
    try:
        volume = load(stored[0].Result)
    except (InputError, FileFormatError):
        logger.info("%s: no exact normals, the stored result is not readable", mesh.Label)
        return names, plain
    fem = volume.fem
    if fem is None or not np.array_equal(fem.nodes, nodes):
        return names, plain
    place = {name: number for number, name in enumerate(names)}
    face = np.array([place[name] for name in fem.face_names])[fem.boundary_face]
    exact = boundary_of(fem, volume.surface, volume.interface)
    return names, Boundary(fem.boundary, face, exact.normals, pressure=pressures[face])


def _displacement(result: Any, numbers: np.ndarray, nodes: np.ndarray, label: str) -> np.ndarray:
    """Displacement of every node of the mesh, (n, 3), mm."""
    given = np.asarray(result.NodeNumbers, dtype=int)
    order = np.argsort(given)
    if len(given) != len(numbers) or not np.array_equal(given[order], numbers):
        raise InputError(
            f"{result.Label} has {len(given)} nodes, {label} {len(numbers)}",
            remedy="run the solver again",
        )
    if result.Mesh is not None:
        table = result.Mesh.FemMesh.Nodes
        solved = np.array([tuple(table[number]) for number in numbers.tolist()])
        if np.abs(solved - nodes).max() > _SAME_PLACE * np.ptp(nodes, axis=0).max():
            raise OutOfDateError(
                f"{result.Label} belongs to another mesh than {label}",
                remedy="run the solver again",
            )
    vectors = np.array([tuple(vector) for vector in result.DisplacementVectors])
    return vectors[order]


def _materials(
    analysis: Any, mesh: Any, volumes: dict[int, tuple[str, np.ndarray]]
) -> list[tuple[Material, list[tuple[str, np.ndarray]]]]:
    """Each material of an analysis with its elements by kind; the boundary's first."""
    held = [one for one in analysis.Group if one.isDerivedFrom("App::MaterialObjectPython")]
    if not held:
        raise InputError(f"{analysis.Label} has no material", remedy="add one")
    groups = {mesh.getGroupName(number): number for number in mesh.Groups}
    found = []
    for one in held:
        # as the FEM workbench does: one material is everywhere, of several each has its groups
        members: list[int] = list(volumes)
        if len(held) > 1:
            named = [name for name in groups if name.startswith(f"{one.Name}_")]
            members = [e for name in named for e in mesh.getGroupElements(groups[name])]
        found.append((_elastic(one), _by_kind(members, volumes)))
    if sum(len(rows) for _, parts in found for _, rows in parts) != len(volumes):
        raise InputError(
            "the materials do not cover every element once",
            remedy="give shell and core a material each when the analysis is made, or one to both",
        )
    # wedges, which have the boundary, before tets
    return sorted(found, key=lambda part: min(kind for kind, _ in part[1]))


def _by_kind(
    members: list[int], volumes: dict[int, tuple[str, np.ndarray]]
) -> list[tuple[str, np.ndarray]]:
    """Connectivities of some elements, in the program's own order of nodes."""
    kinds: dict[str, list[np.ndarray]] = {}
    for element in members:
        kind, rows = volumes[element]
        kinds.setdefault(kind, []).append(rows)
    return [(kind, from_order("freecad", kind, np.array(rows))) for kind, rows in kinds.items()]


def _elastic(material: Any) -> Material:
    """Elastic constants of a material of the FEM workbench."""
    card = material.Material
    try:
        young = FreeCAD.Units.Quantity(card["YoungsModulus"]).getValueAs("MPa").Value
        poisson = float(FreeCAD.Units.Quantity(card["PoissonRatio"]).Value)
    except (KeyError, ValueError, OSError) as error:
        raise InputError(
            f"{material.Label} has no Young's modulus or no Poisson's ratio ({error})",
            remedy="choose a material card",
        ) from None
    return Material(young, poisson)


def _merged(parts: list[NodalStress], count: int) -> tuple[np.ndarray, np.ndarray]:
    """Strain and stress of all nodes, (n, 6) each; those of the first part where several have them.

    Raises
    ------
    FaultError
        Nodes are without any.
    """
    strain, stress = np.full((2, count, 6), np.nan)
    for part in reversed(parts):
        strain[part.nodes], stress[part.nodes] = part.strain, part.stress
    if np.isnan(stress).any():
        raise FaultError("some nodes belong to no element of a material")
    return strain, stress


def _fill(result: Any, solved: Any, strain: np.ndarray, stress: np.ndarray) -> None:
    """Write what the FEM workbench's own results have."""
    order = np.argsort(np.asarray(solved.NodeNumbers, dtype=int))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    result.NodeNumbers = solved.NodeNumbers
    result.DisplacementVectors = solved.DisplacementVectors
    fill_components(result, strain[place], stress[place])
    resulttools.fill_femresult_stats(result)


def fill_components(result: Any, strain: np.ndarray, stress: np.ndarray) -> None:
    """Write strains and stresses (n, 6) of a result's nodes, and what follows from them.

    Parameters
    ----------
    result : App.DocumentObject
        With NodeNumbers and DisplacementVectors.
    strain, stress : (n, 6) arrays
        In the order of the nodes' numbers there; xx yy zz xy xz yz, MPa.
    """
    for number, component in enumerate(COMPONENTS):
        setattr(result, f"NodeStress{component.upper()}", stress[:, number].tolist())
        setattr(result, f"NodeStrain{component.upper()}", strain[:, number].tolist())
    # lengths, von Mises and principal values by the workbench's own formulas
    for add in ("add_disp_apps", "add_von_mises", "add_principal_stress_std"):
        getattr(resulttools, add)(result)


def _add_boundary(
    result: Any,
    numbers: np.ndarray,
    nodes: np.ndarray,
    names: tuple[str, ...],
    boundary: Boundary,
    stress: np.ndarray,
    outer: NodalStress,
) -> None:
    """Add properties with the stress of the boundary nodes in the frame of the normal."""
    for name, kind, text in _BOUNDARY:
        result.addProperty(f"App::Property{kind}", name, "Boundary", text)
        result.setEditorMode(name, ["ReadOnly"])
    if not outer.loads:
        return
    surface = BoundarySurface(nodes, boundary)
    # a node on a sharp edge is seen on the first of its faces
    members, point = np.unique(surface.point_node, return_index=True)
    normal = surface.normal[point]
    seen = in_frame(stress[members], normal)
    result.BoundaryNodes = numbers[members].tolist()
    result.BoundaryNormals = [FreeCAD.Vector(*one) for one in normal.tolist()]
    result.NormalStress = seen.normal.tolist()
    result.ShearStress = seen.shear.tolist()
    result.TangentialMax = seen.tangential[:, 0].tolist()
    result.TangentialMin = seen.tangential[:, 1].tolist()
    result.FaceLoads = [f"{names[number]}: {load}" for number, load in outer.loads]
