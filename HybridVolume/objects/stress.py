# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Stresses at the nodes from a solver's displacements, as a result of the FEM workbench."""

from __future__ import annotations

from typing import Any

import FreeCAD
import numpy as np
import ObjectsFem
from femresult import resulttools

from HybridVolume.core.elements import from_order
from HybridVolume.core.recovery import COMPONENTS, Material, NodalStress, recover
from HybridVolume.errors import FaultError, InputError

from .analysis import is_mesh, require_current
from .properties import transaction

NAME = "HybridVolume_Results"
"""Name of the result object; the solver's own stays beside it."""

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
    meshes = [one for one in analysis.Group if is_mesh(one)]
    if len(meshes) != 1:
        raise InputError(
            f"{analysis.Label} has {len(meshes) or 'no'} meshes of hybrid volumes",
            remedy="make the analysis of a hybrid volume",
        )
    (mesh,) = meshes
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
    solved = results[-1]
    numbers, nodes, groups = _arrays(mesh.FemMesh)
    displacement = _displacement(solved, numbers, mesh.Label)
    parts = [
        recover(nodes, elements, displacement, material)
        for material, elements in _materials(analysis, mesh.FemMesh, groups)
    ]
    with transaction(analysis.Document, "Recover stresses"):
        for old in [one for one in analysis.Group if one.Name.startswith(NAME)]:
            analysis.Document.removeObject(old.Name)
        result = ObjectsFem.makeResultMechanical(analysis.Document, NAME)
        result.Label = "Stresses from displacements"
        result.Mesh = solved.Mesh
        _fill(result, solved, parts, numbers)
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


def _displacement(result: Any, numbers: np.ndarray, label: str) -> np.ndarray:
    """Displacement of every node of the mesh, (n, 3), mm."""
    given = np.asarray(result.NodeNumbers, dtype=int)
    order = np.argsort(given)
    if len(given) != len(numbers) or not np.array_equal(given[order], numbers):
        raise InputError(
            f"{result.Label} has {len(given)} nodes, {label} {len(numbers)}",
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


def _fill(result: Any, solved: Any, parts: list[NodalStress], numbers: np.ndarray) -> None:
    """Write everything into a result object of the FEM workbench."""
    strain, stress = np.full((2, len(numbers), 6), np.nan)
    for part in reversed(parts):
        strain[part.nodes], stress[part.nodes] = part.strain, part.stress
    if np.isnan(stress).any():
        raise FaultError("some nodes belong to no element of a material")
    order = np.argsort(np.asarray(solved.NodeNumbers, dtype=int))
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    result.NodeNumbers = solved.NodeNumbers
    result.DisplacementVectors = solved.DisplacementVectors
    for number, component in enumerate(COMPONENTS):
        setattr(result, f"NodeStress{component.upper()}", stress[place, number].tolist())
        setattr(result, f"NodeStrain{component.upper()}", strain[place, number].tolist())
    # lengths, von Mises and principal values by the workbench's own formulas
    for add in ("add_disp_apps", "add_von_mises", "add_principal_stress_std"):
        getattr(resulttools, add)(result)
    resulttools.fill_femresult_stats(result)
