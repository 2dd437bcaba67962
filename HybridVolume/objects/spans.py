# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How even the knot spans of a body are made before the shell, as properties of its volume."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from HybridVolume.errors import InputError

from .properties import Property

if TYPE_CHECKING:
    from HybridVolume.core.even import Evenness

_SPANS = "Spans"

PROPERTIES = {
    "SpanSize": Property(
        "App::PropertyLength",
        _SPANS,
        "Longest side of the spans that the faces are cut into first, exactly; 0: any.",
        0.0,
    ),
    "SpanAspect": Property(
        "App::PropertyFloatConstraint",
        _SPANS,
        "Longest over shortest side of spans, 2 or more, where half of a strip's spans ask; "
        "0: up to 10.",
        (0.0, 0.0, 1000.0, 1.0),
    ),
    "SpanTurn": Property(
        "App::PropertyFloatConstraint",
        _SPANS,
        "Largest turn of the normal along a span, 1 to 180 degrees; 0: as needed.",
        (0.0, 0.0, 180.0, 5.0),
    ),
}
"""Properties of a hybrid volume that say how even spans should be."""

DEFAULTS: dict[str, Any] = {"SpanSize": 0.0, "SpanAspect": 0.0, "SpanTurn": 0.0}
"""Their values as plain numbers; mm, degrees."""

KEYWORDS = {"span_size": "SpanSize", "span_aspect": "SpanAspect", "span_turn": "SpanTurn"}
"""Keywords of macros, which are those of the pipeline's options, and the properties they set."""


def values_of(obj: Any) -> dict[str, float]:
    """Values of :data:`DEFAULTS` of an object, as plain numbers."""
    values = {name: getattr(obj, name) for name in DEFAULTS}
    return {name: float(getattr(value, "Value", value)) for name, value in values.items()}


def set_values(obj: Any, values: Mapping[str, Any]) -> None:
    """Write values of :data:`DEFAULTS` into an object's properties."""
    for name in DEFAULTS:
        setattr(obj, name, values[name])


def relevant(values: Mapping[str, Any]) -> dict[str, str]:
    """Values of :data:`DEFAULTS` that ask for something, as text by name."""
    return {name: f"{values[name]:.12g}" for name in DEFAULTS if values[name]}


def options_of(values: Mapping[str, Any]) -> dict[str, float]:
    """Keyword arguments of the pipeline's options for values of :data:`DEFAULTS`."""
    return {keyword: float(values[name]) for keyword, name in KEYWORDS.items()}


def evenness_of(values: Mapping[str, Any]) -> Evenness:
    """The evenness that values of :data:`DEFAULTS` ask for.

    Raises
    ------
    InputError
        A value is out of its range.
    """
    from HybridVolume.core.even import Evenness

    return Evenness(values["SpanSize"], values["SpanAspect"], values["SpanTurn"])


def changed_values(values: Mapping[str, Any]) -> dict[str, float]:
    """Values of :data:`DEFAULTS` for :data:`KEYWORDS`; what is not given is left out.

    Raises
    ------
    InputError
        A value is no number, or out of its range.
    """
    found = {}
    for keyword, name in KEYWORDS.items():
        if keyword in values:
            try:
                found[name] = float(values[keyword])
            except (TypeError, ValueError):
                raise InputError(
                    f"{keyword} is {values[keyword]!r}",
                    remedy="choose a number, or 0 for as needed",
                ) from None
    evenness_of({**DEFAULTS, **found})
    return found


def parameters_of(asked: Mapping[str, float]) -> dict[str, float]:
    """Values of :data:`DEFAULTS` for the attributes of an `Evenness`."""
    return {f"Span{name.capitalize()}": float(value) for name, value in asked.items()}
