# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Supports and loads of an analysis of the FEM workbench: where they act, and whether that is on
the body that was meshed.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from HybridVolume.errors import InputError

from .volume import source_fingerprint

_PRESSURE = "Fem::ConstraintPressure"
_MEGAPASCAL = 1e-3
"""MPa in FreeCAD's unit of a quantity, kg/(mm s²)."""


@dataclass(frozen=True)
class Reference:
    """A support or load on one face, edge or vertex.

    Attributes
    ----------
    constraint : App.DocumentObject
    body : App.DocumentObject
    name : str
        "Face3", "Edge1", "Vertex2", "Solid1", or "" for the whole body.
    """

    constraint: Any
    body: Any
    name: str


def references(analysis: Any) -> Iterator[Reference]:
    """All places of all supports and loads of an analysis that are not suppressed."""
    for one in analysis.Group:
        if not one.isDerivedFrom("Fem::Constraint") or getattr(one, "Suppressed", False):
            continue
        for body, names in getattr(one, "References", ()):
            for name in names or ("",):
                yield Reference(one, body, name)


def misplaced(analysis: Any, mesh: Any) -> list[InputError]:
    """One error for each support or load that does not act, or not wholly, on the mesh.

    The FEM workbench looks for nodes on a face; of another body it finds none, and loads nothing.

    Parameters
    ----------
    analysis, mesh : App.DocumentObject
        The analysis, and its mesh of a hybrid volume.
    """
    bodies = meshed_bodies(mesh)
    same = {body.Name: True for body in bodies}
    lost = set(getattr(mesh, "Lost", ()))
    wrong: dict[tuple[str, str], list[str]] = {}
    partly: dict[str, list[str]] = {}
    for place in references(analysis):
        if place.body.Name not in same:
            same[place.body.Name] = _same_shape(place.body, bodies, mesh)
        if not same[place.body.Name]:
            key = (place.constraint.Label, place.body.Label)
            wrong.setdefault(key, []).append(place.name or "everything")
        elif place.name in lost:
            partly.setdefault(place.constraint.Label, []).append(place.name)
    meshed = bodies[0].Label if bodies else mesh.Label
    return [
        InputError(
            f"{constraint} is on {', '.join(names)} of {body}, but {meshed} was meshed",
            remedy=f"pick its faces, edges or vertices on {meshed}",
        )
        for (constraint, body), names in wrong.items()
    ] + [
        InputError(
            f"FreeCAD does not find every node of the mesh on {', '.join(names)}: "
            f"{constraint} would not act on all of it",
            remedy=f"heal {meshed} and compute the hybrid volume again",
        )
        for constraint, names in partly.items()
    ]


def meshed_bodies(mesh: Any) -> list[Any]:
    """The body that a mesh belongs to: what loads go on, then what it was made of.

    Where loads go on a copy, the body is none of them: FreeCAD finds no nodes on it.
    """
    volumes = [one for one in mesh.InList if getattr(one, "FemMesh", None) == mesh]
    if any(one.AnalysisBody is not None and one.AnalysisBody == mesh.Shape for one in volumes):
        return [mesh.Shape]
    found = [mesh.Shape] if mesh.Shape is not None else []
    found += [one.Source for one in volumes if one.Source]
    return list(dict.fromkeys(found))


def _same_shape(body: Any, bodies: list[Any], mesh: Any) -> bool:
    """Whether a feature of the same shape will do, like the last one of a PartDesign body."""
    volumes = [one for one in mesh.InList if getattr(one, "FemMesh", None) == mesh]
    if not hasattr(body, "Shape") or body in [one.Source for one in volumes]:
        return False
    print_of = source_fingerprint(body)
    return any(source_fingerprint(one) == print_of for one in bodies)


def face_pressures(analysis: Any, names: tuple[str, ...]) -> np.ndarray:
    """Pressure on faces as far as the analysis tells it for certain.

    Parameters
    ----------
    analysis : App.DocumentObject
    names : tuple of str
        Faces of the body that was meshed.

    Returns
    -------
    (nf,) array
        MPa into the body; 0 where nothing is on a face, nan where more than pressures are.
    """
    pressure = dict.fromkeys(names, 0.0)
    for place in references(analysis):
        if place.name not in pressure:
            continue
        if place.constraint.TypeId == _PRESSURE:
            sign = -1.0 if place.constraint.Reversed else 1.0
            pressure[place.name] += sign * _megapascals(place.constraint.Pressure)
        else:
            pressure[place.name] = np.nan
    return np.array([pressure[name] for name in names])


def _megapascals(value: Any) -> float:
    """A pressure as FreeCAD 0.20 (a number, MPa) or 1.x (a quantity) holds it."""
    return value.Value * _MEGAPASCAL if hasattr(value, "Value") else float(value)
