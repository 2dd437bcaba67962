# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The midstructure in a document: how it is found, what was found, which sheets count."""

from __future__ import annotations

from typing import Any

from .properties import DocumentObject, Property

METHODS = ("auto", "medial-axis", "skeleton", "distance")

_FOUND = "Found"
_SEARCH = "Search"


class MidstructureObject(DocumentObject):
    """Proxy of the midstructure; a change of its search makes the hybrid volume out of date."""

    Type = "HybridVolume::Midstructure"
    PROPERTIES = {
        "Method": Property(
            "App::PropertyEnumeration",
            _SEARCH,
            "How the midstructure is found; auto takes the medial axis and falls back where the "
            "body has none.",
            choices=METHODS,
        ),
        "Samples": Property(
            "App::PropertyInteger",
            _SEARCH,
            "Samples of the surface for the medial axis; 0 leaves the choice to the program.",
        ),
        "Decisions": Property(
            "App::PropertyStringList",
            _SEARCH,
            "Sheets that a user kept or removed: 'kept' or 'removed', the pair of faces and a "
            "point of the sheet (mm), e.g. 'removed Face3+Face9 @ 1.5 0 2'.",
        ),
        "MethodUsed": Property(
            "App::PropertyString", _FOUND, "Method that gave the midstructure.", mode=("ReadOnly",)
        ),
        "Sheets": Property(
            "App::PropertyStringList",
            _FOUND,
            "The sheets: kept or removed, the faces, the area (mm²).",
            mode=("ReadOnly",),
        ),
        "Facets": Property(
            "App::PropertyFileIncluded",
            _FOUND,
            "Arrays of vertices (mm), facets, sheet and kept.",
            mode=("ReadOnly", "Hidden"),
        ),
        "Status": Property(
            "App::PropertyString", "Base", "Up to date, or why not.", mode=("ReadOnly",)
        ),
    }


def make_midstructure(doc: Any, name: str = "Midstructure") -> Any:
    """Add an empty midstructure to a document."""
    obj = doc.addObject("App::FeaturePython", name)
    MidstructureObject(obj)
    return obj
