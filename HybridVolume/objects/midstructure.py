# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The midstructure in a document: how it is found, what was found, which sheets count."""

from __future__ import annotations

from typing import Any

from .properties import DocumentObject, Property

METHODS = ("auto", "medial-axis")

_FOUND = "Found"
_SEARCH = "Search"


class MidstructureObject(DocumentObject):
    """Proxy of the midstructure; a change of its search makes the hybrid volume out of date."""

    Type = "HybridVolume::Midstructure"
    PROPERTIES = {
        "Method": Property(
            "App::PropertyEnumeration",
            _SEARCH,
            "How the midstructure is found; auto takes the medial axis.",
            choices=METHODS,
        ),
        "MethodUsed": Property(
            "App::PropertyString", _FOUND, "Method that gave the midstructure.", mode=("ReadOnly",)
        ),
        "Decisions": Property(
            "App::PropertyStringList",
            _FOUND,
            "What was decided about each sheet: kept or removed, its faces, a point on it (mm).",
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
