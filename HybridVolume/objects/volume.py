# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The hybrid volume in a document: parameters, the stored result, and whether it is up to date."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from HybridVolume.sources import global_shape

from .fingerprint import fingerprint
from .properties import DocumentObject, Property

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume

_PARAMETERS = "Parameters"
_RESULT = "Result"
_PARTS = "Parts"

UP_TO_DATE = "Up to date"

CHILDREN = ("Midstructure", "Shell", "Core", "FemMesh")
"""Links from a hybrid volume to its parts, in the order of the tree."""


class VolumeObject(DocumentObject):
    """Proxy of the hybrid volume. A recompute compares and marks; the long work is a job."""

    Type = "HybridVolume::Volume"
    PROPERTIES = {
        "Source": Property("App::PropertyLink", _PARAMETERS, "The body: closed, of NURBS faces."),
        "Solid": Property(
            "App::PropertyInteger",
            _PARAMETERS,
            "Which solid of the body, from 1.",
            1,
            mode=("ReadOnly",),
        ),
        "W0": Property(
            "App::PropertyFloatConstraint",
            _PARAMETERS,
            "Thickness of the shell: share of the way from the faces (0) to the midstructure (1).",
            (0.5, 0.01, 0.99, 0.05),
        ),
        "Layers": Property(
            "App::PropertyIntegerConstraint",
            _PARAMETERS,
            "Layers of elements through the shell.",
            (2, 1, 50, 1),
        ),
        "Degree": Property(
            "App::PropertyIntegerConstraint",
            _PARAMETERS,
            "Degree of the shell's elements through its thickness.",
            (3, 1, 6, 1),
        ),
        "Tolerance": Property(
            "App::PropertyFloat",
            _PARAMETERS,
            "Points closer than this share of the body's diagonal are one point.",
            1e-7,
        ),
        "W0Reached": Property(
            "App::PropertyFloat", _RESULT, "Thickness that was reached.", mode=("ReadOnly",)
        ),
        "Elements": Property(
            "App::PropertyInteger",
            _RESULT,
            "Elements of the shell, each proved to be valid.",
            mode=("ReadOnly",),
        ),
        "MinimumScaledJacobian": Property(
            "App::PropertyFloat",
            _RESULT,
            "Smallest scaled Jacobian of the shell's elements (1 is a box, 0 is folded).",
            mode=("ReadOnly",),
        ),
        "Report": Property(
            "App::PropertyMap", _RESULT, "The figures of report.json.", mode=("ReadOnly",)
        ),
        "Result": Property(
            "App::PropertyFileIncluded",
            _RESULT,
            "The hybrid volume itself, as HybridVolume's .npz.",
            mode=("ReadOnly", "Hidden"),
        ),
        "ComputedFrom": Property(
            "App::PropertyMap",
            _RESULT,
            "What the result was computed from.",
            mode=("ReadOnly", "Hidden"),
        ),
        "Status": Property(
            "App::PropertyString", "Base", "Up to date, or why not.", mode=("ReadOnly",)
        ),
        **{
            name: Property("App::PropertyLink", _PARTS, f"The {name}.", mode=("ReadOnly",))
            for name in (*CHILDREN, "AnalysisBody")
        },
    }

    def execute(self, obj: Any) -> None:
        """Mark the result as out of date where body or parameters changed since it was made."""
        update_status(obj)


def make_volume(doc: Any, name: str = "HybridVolume") -> Any:
    """Add an empty hybrid volume to a document."""
    obj = doc.addObject("App::FeaturePython", name)
    VolumeObject(obj)
    return obj


def current_inputs(obj: Any) -> dict[str, str]:
    """What a result of the object would be computed from now, as text by name."""
    values = {name: repr(getattr(obj, name)) for name in ("W0", "Layers", "Degree", "Tolerance")}
    if obj.Midstructure:
        values["Midstructure.Method"] = obj.Midstructure.Method
    if obj.FemMesh:
        values["FemMesh.Order"] = obj.FemMesh.Order
        values["FemMesh.Density"] = obj.FemMesh.Density
    values["Source"] = source_fingerprint(obj.Source)
    return values


def options_of(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Keyword arguments of the pipeline's options for an object's parameters.

    Parameters
    ----------
    parameters : mapping
        By the names that :func:`current_inputs` has.
    """
    return {
        "w0": parameters["W0"],
        "layers": parameters["Layers"],
        "degree": parameters["Degree"],
        "tolerance": parameters["Tolerance"],
        "midstructure": parameters["Midstructure.Method"],
        "order": 2 if parameters["FemMesh.Order"] == "Second" else 1,
        "nodes": parameters["FemMesh.Density"],
    }


def parameters_of(volume: HybridVolume) -> dict[str, Any]:
    """What an object's parameters were when a volume was computed, as far as the volume tells."""
    return {
        "W0": volume.shell.w0_asked,
        "Layers": volume.shell.layer_count,
        "Degree": volume.shell.degree_w,
        "Tolerance": VolumeObject.PROPERTIES["Tolerance"].default,
        "Midstructure.Method": "auto",
        "FemMesh.Order": "Second" if volume.fem.order == 2 else "First",
        "FemMesh.Density": volume.interface.nodes,
    }


def source_fingerprint(source: Any) -> str:
    """Fingerprint of a document object's shape in global coordinates; "none" without one."""
    shape = global_shape(source) if source else None
    return "none" if shape is None or shape.isNull() else fingerprint(shape)


def changes(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Names of the inputs that differ."""
    return [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]


def update_status(obj: Any) -> None:
    """Write into the object's Status, and its parts', whether the result is up to date."""
    if not obj.Result:
        status = obj.Status or "Not computed"
    else:
        changed = changes(obj.ComputedFrom, current_inputs(obj))
        words = ["the body" if name == "Source" else name for name in changed]
        status = f"Out of date: {', '.join(words)} changed" if words else UP_TO_DATE
    set_status(obj, status)


def set_status(obj: Any, status: str) -> None:
    """Set the Status of a volume and of its parts; nothing is touched that has it already."""
    for one in (obj, *(getattr(obj, name) for name in CHILDREN)):
        if one is not None and one.Status != status:
            one.Status = status
