# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""How a body's faces were made into patches, as properties of its hybrid volume: kept bit for bit,
exact, or within a tolerance.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from HybridVolume.errors import InputError

from .properties import Property

_FACES = "Faces"

COVER = "CoverTolerance"
"""Parameter of a hybrid volume; a result was computed from it only where faces were covered."""

AUTOMATIC = "automatic"
"""Text for a tolerance that follows from the body's size."""

PROPERTIES = {
    COVER: Property(
        "App::PropertyLength",
        _FACES,
        "How far patches may be from the faces of a body that is covered with patches because "
        "faces are trimmed, have seams or poles; 0: 1e-4 of the body's diagonal.",
        0.0,
    ),
    "FacesKept": Property(
        "App::PropertyString",
        _FACES,
        "How many faces are kept bit for bit, exactly, or within a tolerance.",
        mode=("ReadOnly",),
    ),
    # FreeCAD's property editor shows lists of texts, but no maps
    "FaceGeometry": Property(
        "App::PropertyStringList",
        _FACES,
        "Whether each face is kept bit for bit, exactly, or within so many mm, and its patches.",
        mode=("ReadOnly",),
    ),
    "FacesBit": Property(
        "App::PropertyInteger",
        _FACES,
        "Faces that are kept bit for bit, with their own parameters.",
        mode=("ReadOnly",),
    ),
    "FacesExact": Property(
        "App::PropertyInteger",
        _FACES,
        "Faces with the same points, but for rounding, and other parameters.",
        mode=("ReadOnly",),
    ),
    "FacesTolerance": Property(
        "App::PropertyInteger",
        _FACES,
        "Faces that the patches follow within a tolerance.",
        mode=("ReadOnly",),
    ),
    "FaceDeviation": Property(
        "App::PropertyLength",
        _FACES,
        "Largest distance of patches from the faces.",
        0.0,
        mode=("ReadOnly",),
    ),
    "Patches": Property(
        "App::PropertyInteger",
        _FACES,
        "Patches that the faces were covered with, or as many as faces.",
        mode=("ReadOnly",),
    ),
}
"""Properties of a hybrid volume: the tolerance, and what became of the faces."""

DEFAULTS: dict[str, Any] = {COVER: 0.0}
"""Values of the parameters among them as plain numbers; mm."""

_WORDS = {"bit": "bit for bit", "exact": "exact", "tolerance": "within {} mm"}
_TEXT = re.compile(r"(Face\d+) = (bit for bit|exact|within ([0-9.e+-]+) mm), (\d+) patch(?:es)?")


@dataclass(frozen=True)
class FaceColour:
    """What a face is coloured by.

    Attributes
    ----------
    kind : {"bit", "exact", "tolerance"}
    deviation : float
        Largest distance of its patches from it, mm; 0 of what is no more than rounding.
    patches : int
    """

    kind: str
    deviation: float
    patches: int


def values_of(obj: Any) -> dict[str, float]:
    """Values of :data:`DEFAULTS` of an object, as plain numbers."""
    value = getattr(obj, COVER, 0.0)
    return {COVER: float(getattr(value, "Value", value))}


def set_values(obj: Any, values: Mapping[str, Any]) -> None:
    """Write values of :data:`DEFAULTS` into an object's properties."""
    setattr(obj, COVER, float(values[COVER]))


def relevant(values: Mapping[str, Any]) -> dict[str, str]:
    """Values of :data:`DEFAULTS` as text by name."""
    # a length may lose its last digits in a file
    return {COVER: f"{values[COVER]:.12g}" if values[COVER] else AUTOMATIC}


def tolerance_of(values: Mapping[str, Any]) -> float | None:
    """The tolerance as `sources.read_object` takes it, mm; None for the automatic one.

    Raises
    ------
    InputError
        It is no length.
    """
    return parse_tolerance(values[COVER]) or None


def parse_tolerance(value: Any) -> float:
    """A tolerance in mm; 0 is the automatic one.

    Raises
    ------
    InputError
        It is no length.
    """
    try:
        found = 0.0 if value is None else float(value)
    except (TypeError, ValueError):
        found = math.nan
    if not (math.isfinite(found) and found >= 0.0):
        raise InputError(
            f"cover_tolerance is {value!r}",
            remedy="choose a length in mm, or 0 for 1e-4 of the body's diagonal",
        )
    return found


def stored_tolerance(computed_from: Mapping[str, str]) -> float | None:
    """The tolerance that a result was covered with, mm; 0: the automatic one, None: not covered."""
    text = computed_from.get(COVER)
    if text is None:
        return None
    return 0.0 if text == AUTOMATIC else float(text)


def fill(obj: Any, geometry: Mapping[str, Any] | None) -> None:
    """Write what became of the faces into an object's properties.

    Parameters
    ----------
    obj : App.DocumentObject
    geometry : mapping or None
        As in report.json's ``input.geometry``; None: not known.
    """
    geometry = geometry or {}
    counts = geometry.get("counts", {})
    obj.FacesKept = geometry.get("sentence", "")
    obj.FaceGeometry = [f"{row['name']} = {_text(row)}" for row in geometry.get("faces", ())]
    obj.FacesBit = int(counts.get("bit", 0))
    obj.FacesExact = int(counts.get("exact", 0))
    obj.FacesTolerance = int(counts.get("tolerance", 0))
    obj.FaceDeviation = float(geometry.get("max_deviation", 0.0))
    obj.Patches = int(geometry.get("patches", 0))


def _text(row: Mapping[str, Any]) -> str:
    words = _WORDS[row["kind"]].format(f"{row['deviation']:.3g}")
    return f"{words}, {row['patches']} patch{'' if row['patches'] == 1 else 'es'}"


def face_colours(obj: Any) -> dict[str, FaceColour]:
    """What each face of the body of a hybrid volume is coloured by.

    Parameters
    ----------
    obj : App.DocumentObject
        A hybrid volume.

    Returns
    -------
    dict of str to FaceColour
        By the name of the face, in their order; empty without a result, or where it is of an
        earlier version.
    """
    kinds = {words: kind for kind, words in _WORDS.items()}
    found = {}
    for line in getattr(obj, "FaceGeometry", ()):
        match = _TEXT.fullmatch(line)
        if match:
            name, words, deviation, patches = match.groups()
            kind = kinds.get(words, "tolerance")
            found[name] = FaceColour(kind, float(deviation or 0.0), int(patches))
    return found
