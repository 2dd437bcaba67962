# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Jobs that give a hybrid volume another mesh, and the keywords that say how fine it shall be."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from HybridVolume.core.density import Density
from HybridVolume.errors import InputError
from HybridVolume.job import Job

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume

KEYWORDS = {
    "nodes": "nodes",
    "subdivide": "subdivide",
    "size": "size",
    "face_sizes": "face_sizes",
    "gradation": "gradation",
    "fem_layers": "layers",
    "growth": "growth",
}
"""Keywords of the density, as of the pipeline's options, and the fields of `Density`."""


def mesh_job(
    volume: HybridVolume | str | os.PathLike,
    density: Density,
    order: int,
    *,
    engine: str = "auto",
    **keywords: Any,
) -> Job:
    """A job that gives a volume another mesh.

    Parameters
    ----------
    volume : HybridVolume or path
    density : Density
    order : {1, 2}
    engine : {"auto", "netgen", "gmsh"}
    **keywords
        Of `Job`.
    """
    path = isinstance(volume, str | os.PathLike)
    return Job(
        (),
        goal="mesh",
        volume=str(volume) if path else volume,
        options={**density_keywords(density), "order": order, "engine": engine},
        **keywords,
    )


def changed_density(density: Density, **values: Any) -> Density:
    """A density with some of its values changed, by the keywords of :data:`KEYWORDS`.

    Raises
    ------
    InputError
        A value is out of its range, or there is no such keyword.
    """
    unknown = sorted(set(values) - set(KEYWORDS))
    if unknown:
        raise InputError(
            f"no such value: {', '.join(unknown)}", remedy=f"use order, {', '.join(KEYWORDS)}"
        )
    try:
        changed = {KEYWORDS[word]: _KINDS.get(word, str)(value) for word, value in values.items()}
    except (TypeError, ValueError, AttributeError) as fault:
        raise InputError(
            f"the density cannot be read: {fault}",
            remedy='give numbers, and sizes of faces as {"Face3": 0.5}',
        ) from fault
    return replace(density, **changed)


def density_keywords(density: Density) -> dict[str, Any]:
    """Keywords of :data:`KEYWORDS` that ask for a density, as plain values."""
    values = {word: getattr(density, field) for word, field in KEYWORDS.items()}
    return {**values, "face_sizes": dict(density.face_sizes)}


def check_order(order: Any) -> int:
    """The order of elements, 1 or 2.

    Raises
    ------
    InputError
        It is something else.
    """
    if order not in (1, 2):
        raise InputError(f"order is {order}", remedy="choose 1 or 2")
    return int(order)


def _count(value: Any) -> int:
    if int(value) != float(value):
        raise ValueError(f"{value} is no count")
    return int(value)


def _face_sizes(sizes: Mapping[str, Any]) -> dict[str, float]:
    return {str(face): float(size) for face, size in sizes.items()}


_KINDS: dict[str, Callable[[Any], Any]] = {
    **{"subdivide": _count, "fem_layers": _count, "face_sizes": _face_sizes},
    **{"size": float, "gradation": float, "growth": float},
}
