# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Solutions on shell and core as results of the FEM workbench, at the nodes of a sampled mesh.

A result object has one value a node; between the nodes FreeCAD draws it linearly. The solution
itself is finer than that: its file for ParaView has it as it is.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import FreeCAD
import numpy as np
import ObjectsFem
from femresult import resulttools

from HybridVolume.errors import FaultError, InputError

from .fem_mesh import MeshArrays, build
from .properties import transaction
from .stress import fill_components

if TYPE_CHECKING:
    from HybridVolume.analysis_results import Result
    from HybridVolume.core.finite_elements import FiniteElementMesh

NAME = "HybridVolume_Solution"
"""Name of the result objects; their meshes are called the same with ``Mesh``."""
GROUP = "HybridVolume_Solved"
"""Name of the analysis that holds them."""

_SOLVED = (
    ("Unknowns", "Integer", "Unknowns of one component of the solution."),
    ("Coupling", "String", "How shell and core are coupled, and the degree of the core."),
    ("Notes", "StringList", "What was done so that every element is valid."),
)


def add_result(
    doc: Any,
    result: Result,
    label: str,
    *,
    mesh: FiniteElementMesh | None = None,
    analysis: Any = None,
    mode: int | None = None,
) -> Any:
    """Put a solution into a document as a result of the FEM workbench, in one step of Undo.

    Parameters
    ----------
    doc : App.Document
    result : ScalarResult, DisplacementResult or ModalResult
    label : str
    mesh : FiniteElementMesh, optional
        Where it is sampled; by default the mesh of the hybrid volume.
    analysis : App.DocumentObject, optional
        An analysis that takes the result; by default one of its own, which holds such results
        only.
    mode : int, optional
        Which mode of vibrations, from 0.

    Returns
    -------
    App.DocumentObject
        ``Fem::FemResultObjectPython`` with displacements, strains, stresses, von Mises and
        principal values, or with the temperature; its Mesh has the same nodes. A double click
        opens the FEM workbench's panel of results.

    Raises
    ------
    InputError
        There is no document, or no mesh to sample at.
    FaultError
        A value is not finite, or FreeCAD did not take the whole mesh.
    """
    from HybridVolume.analysis_results import DisplacementResult, ModalResult, ScalarResult

    if doc is None or not hasattr(doc, "addObject"):
        raise InputError("there is no document", remedy="give one, such as App.ActiveDocument")
    if mesh is None:
        if result.volume is None:
            raise InputError(
                "the space was given, without a mesh to sample at",
                remedy="give mesh=volume.fem",
            )
        mesh = result.volume.fem
    places = result.find(mesh.nodes)
    if isinstance(result, ScalarResult):
        values = {"Temperature": result.at(places)}
        moved = np.zeros((len(mesh.nodes), 3))
    elif isinstance(result, DisplacementResult):
        values = {"strain": result.strain(places), "stress": result.stress(places)}
        moved = result.displacement(places)
    elif isinstance(result, ModalResult):
        if mode is None:
            raise InputError("no mode is named", remedy="give its number, from 0")
        values = {}
        moved = result.values_of(mode, places)
    else:
        raise InputError(f"a {type(result).__name__} is no result", remedy="give one")
    if not all(np.isfinite(array).all() for array in (moved, *values.values())):
        raise FaultError("the solution is not finite at some nodes")
    arrays = MeshArrays(
        mesh.nodes, {"Shell": (mesh.wedge_kind, mesh.wedges), "Core": (mesh.tet_kind, mesh.tets)}
    )
    built = build(arrays)
    with transaction(doc, f"Add {label}"):
        if analysis is None:
            analysis = doc.getObject(GROUP)
        if analysis is None:
            analysis = ObjectsFem.makeAnalysis(doc, GROUP)
            analysis.Label = "Solved on shell and core"
        shown = ObjectsFem.makeMeshResult(doc, f"{NAME}Mesh")
        shown.Label = f"{label}: nodes"
        shown.FemMesh = built
        obj = ObjectsFem.makeResultMechanical(doc, NAME)
        obj.Label = label
        obj.Mesh = shown
        obj.NodeNumbers = list(range(1, len(mesh.nodes) + 1))
        obj.DisplacementVectors = [FreeCAD.Vector(*one) for one in moved.tolist()]
        if "stress" in values:
            fill_components(obj, values["strain"], values["stress"])
        else:
            resulttools.add_disp_apps(obj)
            obj.Temperature = values["Temperature"].tolist() if values else []
        if mode is not None:
            obj.Eigenmode = mode + 1
            obj.EigenmodeFrequency = float(result.frequencies[mode])
        resulttools.fill_femresult_stats(obj)
        _describe(obj, result)
        analysis.addObject(obj)
        if shown.ViewObject:
            shown.ViewObject.Visibility = False
            # colours count: the lines of a fine mesh would cover them
            shown.ViewObject.DisplayMode = "Faces"
    return obj


def _describe(obj: Any, result: Result) -> None:
    """Say in properties what the solution is."""
    space = result.space
    coupling = type(space).__name__.replace("Space", "").lower()
    values = (space.size, f"{coupling}, core of degree {space.tets.degree}", list(result.notes))
    for (name, kind, text), value in zip(_SOLVED, values, strict=True):
        obj.addProperty(f"App::Property{kind}", name, "Solution", text)
        setattr(obj, name, value)
        obj.setEditorMode(name, ["ReadOnly"])
