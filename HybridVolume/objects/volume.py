# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The hybrid volume in a document: parameters, the stored result, and whether it is up to date."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from HybridVolume.errors import InputError
from HybridVolume.sources import global_shape
from HybridVolume.sources.fingerprint import fingerprint

from . import density, face_geometry, midstructure, spans, thickness
from .midstructure import UP_TO_DATE
from .properties import DocumentObject, Property, transaction

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh
    from HybridVolume.core.hybrid import HybridVolume

_PARAMETERS = "Parameters"
_RESULT = "Result"
_PARTS = "Parts"

NOT_COMPUTED = "Not computed"

CHILDREN = ("Midstructure", "Shell", "InnerBoundary", "Core", "FemMesh")
"""Links from a hybrid volume to its parts, in the order of the tree."""


class VolumeObject(DocumentObject):
    """Proxy of the hybrid volume. A recompute compares and marks; the long work is a job."""

    Type = "HybridVolume::Volume"
    SCHEMA = 3
    PROPERTIES = {
        "Source": Property("App::PropertyLink", _PARAMETERS, "The body: a closed solid."),
        "Solid": Property(
            "App::PropertyInteger",
            _PARAMETERS,
            "Which solid of the body, from 1.",
            1,
            mode=("ReadOnly",),
        ),
        **thickness.PROPERTIES,
        **spans.PROPERTIES,
        **face_geometry.PROPERTIES,
        "Tolerance": Property(
            "App::PropertyFloat",
            _PARAMETERS,
            "Points closer than this share of the body's diagonal are one point.",
            1e-7,
        ),
        "W0Reached": Property(
            "App::PropertyFloat",
            _RESULT,
            "Level of the harmonic field that the shell reached, in the mean.",
            mode=("ReadOnly",),
        ),
        "ThicknessReached": Property(
            "App::PropertyString",
            _RESULT,
            "How thick the shell has become, and where it is thinner than asked.",
            mode=("ReadOnly",),
        ),
        "FaceThickness": Property(
            "App::PropertyMap",
            _RESULT,
            "Thickness that was reached at each face: mean, smallest and largest.",
            mode=("ReadOnly",),
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

    def ensure_properties(self, obj: Any) -> None:
        """Add what is absent, and hide what does not count."""
        super().ensure_properties(obj)
        thickness.show_relevant(obj)

    def migrate(self, obj: Any, version: int) -> None:
        """Tell what results of earlier versions were computed with, as this one names it."""
        if version < 2 and obj.ComputedFrom:
            values = {**thickness.DEFAULTS, "W0": obj.W0}
            obj.ComputedFrom = {**thickness.relevant(values), **obj.ComputedFrom}
        if version < 3 and obj.ComputedFrom:
            obj.ComputedFrom = {**mesh_inputs(_MESH), **obj.ComputedFrom}

    def onChanged(self, obj: Any, name: str) -> None:
        """Show the properties that count for what was selected."""
        if name in thickness.SELECTORS and set(thickness.DEFAULTS) <= set(obj.PropertiesList):
            thickness.show_relevant(obj)

    def execute(self, obj: Any) -> None:
        """Mark the result as out of date where body or parameters changed since it was made."""
        update_status(obj)


def make_volume(doc: Any, name: str = "HybridVolume") -> Any:
    """Add an empty hybrid volume to a document."""
    obj = doc.addObject("App::FeaturePython", name)
    VolumeObject(obj)
    obj.Status = NOT_COMPUTED
    return obj


def start(doc: Any, source: Any, solid: int = 1) -> Any:
    """Add a hybrid volume with its midstructure, before anything is computed; one step of Undo.

    Parameters
    ----------
    doc : App.Document
    source : App.DocumentObject
        The body.
    solid : int
        Which solid of it, from 1.

    Returns
    -------
    App.DocumentObject
        Without Shell, Core and FemMesh: `document.insert` makes them with the result.
    """
    with transaction(doc, "Create a hybrid volume"):
        obj = make_volume(doc)
        obj.Label = f"{source.Label} hybrid volume"
        obj.Source = source
        obj.Solid = solid
        obj.Midstructure = midstructure.make_midstructure(doc)
        doc.recompute()
    return obj


_OWN = {
    **thickness.DEFAULTS,
    **spans.DEFAULTS,
    **face_geometry.DEFAULTS,
    "Tolerance": VolumeObject.PROPERTIES["Tolerance"].default,
}
_FEM = "FemMesh."
_MESH = {f"{_FEM}Order": "Second", **{f"{_FEM}{k}": v for k, v in density.DEFAULTS.items()}}
_MIDSTRUCTURE = "Midstructure."
GEOMETRY = "Midstructure.Geometry"


def current_parameters(obj: Any) -> dict[str, Any]:
    """What a result of the object would be computed with now, by name.

    Returns
    -------
    dict
        For the method ``own`` with the fingerprint of the geometry, ``"Midstructure.Geometry"``.
    """
    values = {**thickness.values_of(obj), **spans.values_of(obj), "Tolerance": obj.Tolerance}
    values |= face_geometry.values_of(obj)
    child = obj.Midstructure
    if child:
        found = midstructure.parameters(child)
        values |= {f"{_MIDSTRUCTURE}{name}": value for name, value in found.items()}
        if child.Method == "own":
            values[GEOMETRY] = midstructure.geometry_fingerprint(child.Geometry)
    if obj.FemMesh:
        values |= mesh_parameters(obj.FemMesh)
    return complete_parameters(values)


def mesh_parameters(mesh: Any) -> dict[str, Any]:
    """What the mesh of a mesh object would be made with now, by the names of a hybrid volume's."""
    values = {"Order": mesh.Order, **density.values_of(mesh)}
    return {f"{_FEM}{name}": value for name, value in values.items()}


def complete_parameters(values: Mapping[str, Any]) -> dict[str, Any]:
    """Add the defaults of what is not among the values."""
    defaults = {f"{_MIDSTRUCTURE}{k}": v for k, v in midstructure.PARAMETERS.items()}
    return {**_OWN, **defaults, **_MESH, **values}


def inputs_of(parameters: Mapping[str, Any]) -> dict[str, str]:
    """Parameters as text by name, only those that the result depends on."""
    values = complete_parameters(parameters)
    texts = {**thickness.relevant(values), "Tolerance": repr(values["Tolerance"])}
    texts |= spans.relevant(values)
    texts |= face_geometry.relevant(values)
    found = {name: values[f"{_MIDSTRUCTURE}{name}"] for name in midstructure.PARAMETERS}
    relevant = midstructure.relevant(found)
    texts |= {f"{_MIDSTRUCTURE}{name}": text for name, text in relevant.items()}
    texts |= mesh_inputs(values)
    if GEOMETRY in values:
        texts[GEOMETRY] = str(values[GEOMETRY])
    return texts


def mesh_inputs(values: Mapping[str, Any]) -> dict[str, str]:
    """Parameters of the mesh as text by name, only those that it depends on."""
    texts = {"Order": values[f"{_FEM}Order"], **density.relevant(mesh_values(values))}
    return {f"{_FEM}{name}": text for name, text in texts.items()}


def mesh_values(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Values of :data:`density.DEFAULTS` among the parameters of a hybrid volume."""
    return {name: parameters[f"{_FEM}{name}"] for name in density.DEFAULTS}


def current_inputs(obj: Any) -> dict[str, str]:
    """What a result of the object would be computed from now, as text by name."""
    texts = {**inputs_of(current_parameters(obj)), "Source": source_fingerprint(obj.Source)}
    if obj.ComputedFrom and face_geometry.COVER not in obj.ComputedFrom:
        # a body whose faces are patches themselves is the same with any tolerance
        del texts[face_geometry.COVER]
    return texts


def options_of(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Keyword arguments of the pipeline's options for an object's parameters.

    Parameters
    ----------
    parameters : mapping
        By the names that :func:`current_parameters` has; what is absent has its default.

    Raises
    ------
    InputError
        A thickness, factor or height is out of its range, or cannot be read.
    """
    values = complete_parameters(parameters)
    goal = thickness.thickness_of(values)
    return {
        "w0": values["W0"],
        "thickness": "" if goal.kind == "w0" else goal.text,
        "face_factors": dict(goal.factors),
        "spacing": thickness.spacing_of(values).text,
        "method": values["Method"],
        "layers": values["Layers"],
        "degree": values["Degree"],
        "tolerance": values["Tolerance"],
        **spans.options_of(values),
        "midstructure": values["Midstructure.Method"],
        "samples": values["Midstructure.Samples"],
        "angle": values["Midstructure.Angle"],
        "minimum_size": values["Midstructure.MinimumSize"],
        "depth": values["Midstructure.Depth"],
        "decisions": list(values["Midstructure.Decisions"]),
        "order": 2 if values["FemMesh.Order"] == "Second" else 1,
        **density.options_of(mesh_values(values)),
    }


def parameters_of(volume: HybridVolume) -> dict[str, Any]:
    """What an object's parameters were when a volume was computed, as far as the volume tells."""
    search = volume.report.get("search", {})
    words = {"Samples": "samples", "Angle": "angle", "MinimumSize": "minimum_size"}
    words |= {"Depth": "depth", "Decisions": "decided"}
    found = {f"{_MIDSTRUCTURE}{k}": search[word] for k, word in words.items() if word in search}
    from HybridVolume.core.goals import Thickness
    from HybridVolume.core.levels import Spacing

    asked = volume.report.get("asked") or {"text": f"{volume.shell.w0_asked:.12g}", "factors": {}}
    return {
        **thickness.thickness_parameters(Thickness.parse(asked["text"], asked["factors"])),
        **thickness.spacing_parameters(Spacing.parse(volume.report.get("spacing", "volume"))),
        "Method": volume.report.get("method", "certified"),
        "Layers": volume.shell.layer_count,
        "Degree": volume.shell.degree_w,
        "Tolerance": _OWN["Tolerance"],
        **spans.parameters_of(volume.report.get("evening", {}).get("asked", {})),
        **found,
        "Midstructure.Method": search.get("asked", "auto"),
        **mesh_parameters_of(volume.fem),
    }


def mesh_parameters_of(fem: FiniteElementMesh) -> dict[str, Any]:
    """What the parameters of a mesh were when it was made, by the names of a hybrid volume's."""
    values = {
        "Order": "Second" if fem.order == 2 else "First",
        **density.density_parameters(fem.density),
    }
    return {f"{_FEM}{name}": value for name, value in values.items()}


def source_fingerprint(source: Any) -> str:
    """Fingerprint of a document object's shape in global coordinates; "none" without one."""
    shape = global_shape(source) if source else None
    return "none" if shape is None or shape.isNull() else fingerprint(shape)


def changes(before: Mapping[str, str], now: Mapping[str, str]) -> list[str]:
    """Names of the inputs that differ."""
    names = [name for name in sorted({*before, *now}) if before.get(name) != now.get(name)]
    if not {"Midstructure.Method", *thickness.SELECTORS}.isdisjoint(names):
        # another method looks at other parameters: the method says it all
        names = [name for name in names if name in before and name in now]
    if any(name.startswith(_FEM) and name in before and name in now for name in names):
        # what counts only beside another value of the mesh says nothing new
        names = [n for n in names if not n.startswith(_FEM) or (n in before and n in now)]
    return names


def remesh_suffices(obj: Any) -> bool:
    """Whether a result is out of date only in its finite elements: the shell can stay."""
    if not obj.Result or "Midstructure.Decisions" not in obj.ComputedFrom:
        return False
    try:
        names = changes(obj.ComputedFrom, current_inputs(obj))
    except InputError:
        return False
    return bool(names) and all(name.startswith(_FEM) for name in names)


def update_status(obj: Any) -> None:
    """Write into the Status of a volume, and of its parts, whether the result is up to date."""
    if not obj.Result:
        status = obj.Status or NOT_COMPUTED
    elif "Midstructure.Decisions" not in obj.ComputedFrom:
        status = "Out of date: computed by an earlier version"
    else:
        try:
            thickness.face_factors(obj.FaceFactors)
            spans.evenness_of(spans.values_of(obj))
            if obj.FemMesh:
                density.density_of(mesh_values(mesh_parameters(obj.FemMesh)))
        except InputError as error:
            status = f"Failed: {error.line}"
        else:
            status = status_of_inputs(obj.ComputedFrom, current_inputs(obj))
    set_status(obj, status)
    if obj.Midstructure:
        midstructure.update_choice(obj.Midstructure)


def status_of_inputs(before: Mapping[str, str], now: Mapping[str, str]) -> str:
    """Whether a result that was computed from other inputs is up to date, and why not."""
    words = ["the body" if name == "Source" else name for name in changes(before, now)]
    return f"Out of date: {', '.join(words)} changed" if words else UP_TO_DATE


def set_status(obj: Any, status: str) -> None:
    """Set the Status of a volume and of its meshes; nothing is touched that has it already."""
    for one in (obj, *(getattr(obj, name) for name in CHILDREN if name != "Midstructure")):
        if one is not None and one.Status != status:
            one.Status = status
