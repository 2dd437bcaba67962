# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Thickness and layers of a shell as properties of its hybrid volume.

A selector (:data:`SELECTORS`) says which of the other properties count; the others are hidden.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

from .properties import Property

if TYPE_CHECKING:
    from HybridVolume.core.goals import Thickness
    from HybridVolume.core.levels import Spacing

KINDS = {
    "Level w0": "w0",
    "Even": "even",
    "Mean": "mean",
    "Minimum": "min",
    "Share of radius": "share",
}
"""Choices of ``ThicknessKind``, and the kind of :class:`HybridVolume.core.goals.Thickness`."""

SPACINGS = {
    "Equal volume": "volume",
    "Equal height": "distance",
    "Ratio": "ratio",
    "First layer": "first",
}
"""Choices of ``Spacing``, and the kind of :class:`HybridVolume.core.levels.Spacing`."""

METHODS = ("certified", "paper")
"""Choices of ``Method``, as in :data:`HybridVolume.core.pipeline.METHODS`."""

SELECTORS = {
    "ThicknessKind": {
        "Level w0": ("W0",),
        "Even": ("Thickness",),
        "Mean": ("Thickness",),
        "Minimum": ("Thickness",),
        "Share of radius": ("Share",),
    },
    "Spacing": {
        "Equal volume": (),
        "Equal height": (),
        "Ratio": ("LayerRatio",),
        "First layer": ("FirstLayer",),
    },
}
"""For every choice of a selector the properties that count."""

_THICKNESS = "Thickness"
_LAYERS = "Layers"

PROPERTIES = {
    "ThicknessKind": Property(
        "App::PropertyEnumeration",
        _THICKNESS,
        "How the thickness of the shell is given: one level of the harmonic field; the same "
        "length everywhere; a mean or smallest length; a share of the local radius.",
        choices=tuple(KINDS),
    ),
    "W0": Property(
        "App::PropertyFloatConstraint",
        _THICKNESS,
        "Thickness of the shell: share of the way from the faces (0) to the midstructure (1).",
        (0.5, 0.01, 0.99, 0.05),
    ),
    "Thickness": Property(
        "App::PropertyLength",
        _THICKNESS,
        "Thickness of the shell: everywhere, in the mean, or at the thinnest place.",
        1.0,
    ),
    "Share": Property(
        "App::PropertyFloatConstraint",
        _THICKNESS,
        "Thickness of the shell in per cent of the local radius, half the body's thickness there.",
        (50.0, 1.0, 95.0, 5.0),
    ),
    "FaceFactors": Property(
        "App::PropertyStringList",
        _THICKNESS,
        'Where the shell is to be thicker or thinner: a face and a factor a line, "Face3 = 1.5".',
    ),
    "Method": Property(
        "App::PropertyEnumeration",
        _THICKNESS,
        "How the shell is made: certified, or as in the paper, for comparison. Both are proved.",
        choices=METHODS,
    ),
    "Layers": Property(
        "App::PropertyIntegerConstraint",
        _LAYERS,
        "Layers of elements through the shell.",
        (2, 1, 50, 1),
    ),
    "Spacing": Property(
        "App::PropertyEnumeration",
        _LAYERS,
        "Layers of equal volume, of equal height, each higher than the one before it by a ratio, "
        "or with an outermost layer of a given height.",
        choices=tuple(SPACINGS),
    ),
    "LayerRatio": Property(
        "App::PropertyFloatConstraint",
        _LAYERS,
        "Height of each layer over that of the one outside of it.",
        (1.2, 0.125, 8.0, 0.1),
    ),
    "FirstLayer": Property("App::PropertyLength", _LAYERS, "Height of the outermost layer.", 0.1),
    "Degree": Property(
        "App::PropertyIntegerConstraint",
        _LAYERS,
        "Degree of the shell's elements through its thickness.",
        (3, 1, 6, 1),
    ),
}
"""Properties of a hybrid volume that say how its shell should be."""

DEFAULTS: dict[str, Any] = {
    "ThicknessKind": "Level w0",
    "W0": 0.5,
    "Thickness": 1.0,
    "Share": 50.0,
    "FaceFactors": (),
    "Method": "certified",
    "Layers": 2,
    "Spacing": "Equal volume",
    "LayerRatio": 1.2,
    "FirstLayer": 0.1,
    "Degree": 3,
}
"""Their values as plain numbers and texts; lengths in mm."""


def values_of(obj: Any) -> dict[str, Any]:
    """Values of :data:`DEFAULTS` of an object, as plain numbers and texts; lengths in mm."""
    values = {name: getattr(obj, name) for name in DEFAULTS}
    for name in ("Thickness", "FirstLayer"):
        values[name] = values[name].Value
    return {**values, "FaceFactors": tuple(values["FaceFactors"])}


def set_values(obj: Any, values: Mapping[str, Any]) -> None:
    """Write values of :data:`DEFAULTS` into an object's properties."""
    for name in DEFAULTS:
        value = values[name]
        setattr(obj, name, list(value) if name == "FaceFactors" else value)


def show_relevant(obj: Any) -> None:
    """Hide the properties that do not count, by the selectors."""
    for selector, choices in SELECTORS.items():
        counting = choices[getattr(obj, selector)]
        for name in {name for names in choices.values() for name in names}:
            obj.setEditorMode(name, [] if name in counting else ["Hidden"])


def relevant(values: Mapping[str, Any]) -> dict[str, str]:
    """Values of :data:`DEFAULTS` that count, as text by name."""
    idle = {
        name
        for selector, choices in SELECTORS.items()
        for names in choices.values()
        for name in names
        if name not in choices[values[selector]]
    }
    texts = {name: values[name] for name in DEFAULTS if name not in idle}
    texts["FaceFactors"] = "; ".join(factor.strip() for factor in values["FaceFactors"])
    for name in texts.keys() & {"Thickness", "FirstLayer"}:
        # a length may lose its last digits in a file
        texts[name] = f"{values[name]:.12g}"
    return {name: text if isinstance(text, str) else repr(text) for name, text in texts.items()}


def face_factors(texts: Sequence[str]) -> dict[str, float]:
    """Read lines such as ``"Face3 = 1.5"``; empty ones are left out.

    Raises
    ------
    InputError
        A line cannot be read, a factor is out of its range, or a face has two.
    """
    from HybridVolume.core.goals import parse_factors

    return parse_factors([text for text in texts if text.strip()])


def factor_texts(factors: Mapping[str, float]) -> tuple[str, ...]:
    """Lines for a property, e.g. ``"Face3 = 1.5"``."""
    return tuple(f"{face} = {factor:.12g}" for face, factor in factors.items())


def thickness_of(values: Mapping[str, Any]) -> Thickness:
    """The thickness that values of :data:`DEFAULTS` ask for.

    Raises
    ------
    InputError
        A value is out of its range, or a factor cannot be read.
    """
    from HybridVolume.core.goals import Thickness

    kind = KINDS[values["ThicknessKind"]]
    value = {"w0": values["W0"], "share": values["Share"] / 100.0}.get(kind, values["Thickness"])
    return Thickness(kind, value, face_factors(values["FaceFactors"]))


def thickness_parameters(thickness: Thickness) -> dict[str, Any]:
    """Values by name that ask for a thickness; what does not count is left out."""
    labels = {kind: label for label, kind in KINDS.items()}
    name, factor = {"w0": ("W0", 1.0), "share": ("Share", 100.0)}.get(
        thickness.kind, ("Thickness", 1.0)
    )
    return {
        "ThicknessKind": labels[thickness.kind],
        name: factor * thickness.value,
        "FaceFactors": factor_texts(thickness.factors),
    }


def spacing_of(values: Mapping[str, Any]) -> Spacing:
    """The spacing of layers that values of :data:`DEFAULTS` ask for.

    Raises
    ------
    InputError
        A value is out of its range.
    """
    from HybridVolume.core.levels import Spacing

    kind = SPACINGS[values["Spacing"]]
    value = {"ratio": values["LayerRatio"], "first": values["FirstLayer"]}.get(kind, 0.0)
    return Spacing(kind, value)


def spacing_parameters(spacing: Spacing) -> dict[str, Any]:
    """Values by name that ask for a spacing; what does not count is left out."""
    labels = {kind: label for label, kind in SPACINGS.items()}
    named = {"ratio": "LayerRatio", "first": "FirstLayer"}
    value = {named[spacing.kind]: spacing.value} if spacing.kind in named else {}
    return {"Spacing": labels[spacing.kind], **value}
