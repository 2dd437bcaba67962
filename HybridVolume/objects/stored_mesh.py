# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The conforming mesh that a document's hybrid volume stores, as arrays."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from HybridVolume.core.hybrid import HybridVolume
from HybridVolume.errors import InputError

from .volume import CHILDREN, VolumeObject

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh


def volume_object_of(obj: Any) -> Any:
    """The hybrid volume that an object stands for.

    Parameters
    ----------
    obj : App.DocumentObject
        A hybrid volume, one of its parts, or the body it was made of.

    Raises
    ------
    InputError
        There is none, or several.
    """
    if _is_volume(obj):
        return obj
    links = ("Source", *CHILDREN)
    found = [
        one
        for one in dict.fromkeys(obj.InList)
        if _is_volume(one) and obj in [getattr(one, name) for name in links]
    ]
    if len(found) != 1:
        raise InputError(
            f"{obj.Label} has {len(found) or 'no'} hybrid volumes",
            remedy="give the hybrid volume itself, and complete it first if there is none",
        )
    return found[0]


def stored_mesh(obj: Any) -> FiniteElementMesh:
    """The conforming mesh of the result that an object's hybrid volume stores.

    Parameters
    ----------
    obj : App.DocumentObject
        As for `volume_object_of`.

    Raises
    ------
    InputError
        It has no hybrid volume, or that one no result.
    """
    volume = volume_object_of(obj)
    if not volume.Result:
        raise InputError(f"{volume.Label} has no result yet", remedy="complete the volume first")
    return HybridVolume.load(volume.Result).fem


def _is_volume(obj: Any) -> bool:
    return getattr(getattr(obj, "Proxy", None), "Type", "") == VolumeObject.Type
