# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The inner boundary of a shell as an object to look at, and the stored result that it shows."""

from __future__ import annotations

import os
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from HybridVolume.errors import InputError

from .properties import DocumentObject, Property

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume


class InnerBoundaryObject(DocumentObject):
    """Proxy of the inner boundary. It has no geometry: what is drawn is the volume's result."""

    Type = "HybridVolume::InnerBoundary"
    PROPERTIES = {
        "Status": Property(
            "App::PropertyString", "Base", "Up to date, or why not.", mode=("ReadOnly",)
        ),
    }


def make_inner_boundary(doc: Any) -> Any:
    """Add an inner boundary to a document; the volume links to it."""
    obj = doc.addObject("App::FeaturePython", "InnerBoundary")
    InnerBoundaryObject(obj)
    obj.Label = "Inner boundary"
    return obj


def volume_of(obj: Any) -> Any | None:
    """The hybrid volume that an inner boundary belongs to."""
    return next((one for one in obj.InList if getattr(one, "InnerBoundary", None) is obj), None)


def stored_volume(obj: Any) -> HybridVolume:
    """The result of a hybrid volume's object, from its file; the last one is kept in memory.

    Parameters
    ----------
    obj : App.DocumentObject
        A hybrid volume.

    Raises
    ------
    InputError
        Nothing was computed yet.
    FileFormatError
        The stored file is damaged.
    """
    if not obj.Result:
        raise InputError(f"{obj.Label}: there is no result yet", remedy="complete the volume first")
    return _load(obj.Result, *_identity(obj.Result))


def _identity(path: str) -> tuple[int, int, int]:
    # Undo brings another file under the same name
    file = os.stat(path)
    return file.st_ino, file.st_mtime_ns, file.st_size


@lru_cache(maxsize=1)
def _load(path: str, *identity: int) -> HybridVolume:
    from HybridVolume.core.hybrid import load

    return load(path)
