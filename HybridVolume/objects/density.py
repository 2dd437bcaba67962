# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How fine a finite element mesh is wanted, as properties of its document object."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from .properties import Property

if TYPE_CHECKING:
    from HybridVolume.core.density import Density

_DENSITY = "Density"

PROPERTIES = {
    "Density": Property(
        "App::PropertyEnumeration",
        _DENSITY,
        "Where the nodes on the interface of shell and core lie in any case: at the knots, or at "
        "the Greville abscissae.",
        choices=("knots", "greville"),
    ),
    "Subdivide": Property(
        "App::PropertyIntegerConstraint",
        _DENSITY,
        "Into how many parts each side of the shell's elements is cut at least.",
        (1, 1, 64, 1),
    ),
    "Size": Property(
        "App::PropertyLength",
        _DENSITY,
        "Largest edge of the elements along the faces; 0: as the shell's elements are.",
        0.0,
    ),
    "FaceSizes": Property(
        "App::PropertyStringList",
        _DENSITY,
        'Where the elements are to be smaller or larger: a face and a length a line, "Face3 = 0.5 '
        'mm".',
    ),
    "Gradation": Property(
        "App::PropertyFloatConstraint",
        _DENSITY,
        "By how many mm the size of elements grows a mm away from a face of its own size.",
        (0.5, 0.01, 10.0, 0.1),
    ),
    "Layers": Property(
        "App::PropertyIntegerConstraint",
        _DENSITY,
        "Layers of wedges through the shell; 0: by themselves, thin at the faces.",
        (0, 0, 100, 1),
    ),
    "Growth": Property(
        "App::PropertyFloatConstraint",
        _DENSITY,
        "Height of each layer of wedges over that of the one outside of it.",
        (1.3, 1.0, 3.0, 0.1),
    ),
}
"""Properties of a mesh object that say how fine it should be."""

DEFAULTS: dict[str, Any] = {
    "Density": "knots",
    "Subdivide": 1,
    "Size": 0.0,
    "FaceSizes": (),
    "Gradation": 0.5,
    "Layers": 0,
    "Growth": 1.3,
}
"""Their values as plain numbers and texts; lengths in mm."""

_SIZES = ("Size", "FaceSizes", "Gradation")


def values_of(obj: Any) -> dict[str, Any]:
    """Values of :data:`DEFAULTS` of an object, as plain numbers and texts; lengths in mm.

    An object that is of an earlier version has the default of what it has not.
    """
    values = {name: getattr(obj, name, default) for name, default in DEFAULTS.items()}
    values["Size"] = float(getattr(values["Size"], "Value", values["Size"]))
    return {**values, "FaceSizes": tuple(values["FaceSizes"])}


def set_values(obj: Any, values: Mapping[str, Any]) -> None:
    """Write values of :data:`DEFAULTS` into an object's properties."""
    for name in DEFAULTS:
        value = values[name]
        setattr(obj, name, list(value) if name == "FaceSizes" else value)


def show_relevant(obj: Any) -> None:
    """Hide the sizes where the nodes stand at the Greville abscissae, which know none."""
    for name in _SIZES:
        obj.setEditorMode(name, ["Hidden"] if obj.Density == "greville" else [])


def relevant(values: Mapping[str, Any]) -> dict[str, str]:
    """Values of :data:`DEFAULTS` that count, as text by name."""
    idle: set[str] = set()
    if values["Density"] == "greville":
        idle |= set(_SIZES)
    if not any(text.strip() for text in values["FaceSizes"]):
        idle |= {"Gradation"}
    sized = "Size" not in idle and (values["Size"] or "Gradation" not in idle)
    if values["Subdivide"] == 1 and not values["Layers"] and not sized:
        idle |= {"Growth"}
    texts = {name: values[name] for name in DEFAULTS if name not in idle}
    for name in texts.keys() & {"Size", "Gradation", "Growth"}:
        # a length may lose its last digits in a file
        texts[name] = f"{values[name]:.12g}"
    if "FaceSizes" in texts:
        texts["FaceSizes"] = "; ".join(t.strip() for t in values["FaceSizes"] if t.strip())
    return {name: str(text) for name, text in texts.items()}


def face_sizes(texts: Sequence[str]) -> dict[str, float]:
    """Read lines such as ``"Face3 = 0.5 mm"``, mm by face; empty ones are left out.

    Raises
    ------
    InputError
        A line cannot be read, a length is out of its range, or a face has two.
    """
    from HybridVolume.core.density import parse_sizes

    return parse_sizes([text for text in texts if text.strip()])


def size_texts(sizes: Mapping[str, float]) -> tuple[str, ...]:
    """Lines for a property, e.g. ``"Face3 = 0.5 mm"``."""
    return tuple(f"{face} = {size:.12g} mm" for face, size in sizes.items())


def options_of(values: Mapping[str, Any]) -> dict[str, Any]:
    """Keyword arguments of the pipeline's options for values of :data:`DEFAULTS`.

    Raises
    ------
    InputError
        The size at a face cannot be read.
    """
    sized = values["Density"] != "greville"
    return {
        "nodes": values["Density"],
        "subdivide": int(values["Subdivide"]),
        "size": float(values["Size"]) if sized else 0.0,
        "face_sizes": face_sizes(values["FaceSizes"]) if sized else {},
        "gradation": float(values["Gradation"]),
        "fem_layers": int(values["Layers"]),
        "growth": float(values["Growth"]),
    }


def density_of(values: Mapping[str, Any]) -> Density:
    """The density that values of :data:`DEFAULTS` ask for.

    Raises
    ------
    InputError
        A value is out of its range, or the size at a face cannot be read.
    """
    from HybridVolume.core.density import Density

    options = options_of(values)
    return Density(layers=options.pop("fem_layers"), **options)


def density_parameters(density: Density) -> dict[str, Any]:
    """Values of :data:`DEFAULTS` that ask for a density."""
    return {
        "Density": density.nodes,
        "Subdivide": density.subdivide,
        "Size": density.size,
        "FaceSizes": size_texts(density.face_sizes),
        "Gradation": density.gradation,
        "Layers": density.layers,
        "Growth": density.growth,
    }
