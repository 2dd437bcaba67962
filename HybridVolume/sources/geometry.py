# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What became of the faces of a body, for the report: bit for bit, exact, or within a tolerance."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..core.covering.kinds import BIT, EXACT, KINDS, TOLERANCE
from ..core.surface import SplineFace

if TYPE_CHECKING:
    from .covering import Covered


def converted_geometry(solid: Any, faces: Sequence[SplineFace]) -> dict[str, Any]:
    """Figures of a solid each of whose faces is a patch.

    Parameters
    ----------
    solid : Part.Solid
    faces : sequence of SplineFace
        In the order of the solid's.

    Returns
    -------
    dict
        As :func:`covered_geometry`; without a tolerance.
    """
    kinds = [EXACT if face.exact else BIT for face in faces]
    return _figures(solid, kinds, [1] * len(faces), [0.0] * len(faces), None)


def covered_geometry(solid: Any, cover: Covered) -> dict[str, Any]:
    """Figures of a covered solid.

    Parameters
    ----------
    solid : Part.Solid
    cover : Covered

    Returns
    -------
    dict
        ``patches``; ``tolerance`` and ``max_deviation``, mm; ``counts`` of faces and shares of
        their ``area`` by kind; ``faces``: for each its ``name``, ``kind``, ``patches``,
        ``deviation`` (mm); ``sentence``: the same in words.
    """
    patches = np.bincount(cover.origin, minlength=len(cover.kinds)).tolist()
    return _figures(solid, cover.kinds, patches, cover.deviation.tolist(), cover.tolerance)


def _figures(
    solid: Any,
    kinds: Sequence[str],
    patches: Sequence[int],
    deviation: Sequence[float],
    tolerance: float | None,
) -> dict[str, Any]:
    area = np.array([face.Area for face in solid.Faces])
    share = {kind: float(area[[own == kind for own in kinds]].sum() / area.sum()) for kind in KINDS}
    counts = {kind: sum(own == kind for own in kinds) for kind in KINDS}
    worst = float(max(deviation))
    return {
        "patches": int(sum(patches)),
        "tolerance": tolerance,
        "max_deviation": worst,
        "counts": counts,
        "area": share,
        "faces": [
            {"name": f"Face{number}", "kind": kind, "patches": int(count), "deviation": float(off)}
            for number, (kind, count, off) in enumerate(
                zip(kinds, patches, deviation, strict=True), start=1
            )
        ],
        "sentence": _sentence(counts, int(sum(patches)), worst, tolerance),
    }


def _sentence(
    counts: dict[str, int], patches: int, deviation: float, tolerance: float | None
) -> str:
    words = {
        BIT: "bit for bit",
        EXACT: "exact",
        TOLERANCE: f"within {deviation:.2g} mm",
    }
    faces = sum(counts.values())
    told = ", ".join(f"{counts[kind]} {words[kind]}" for kind in KINDS if counts[kind])
    text = f"{faces} face{'' if faces == 1 else 's'}: {told}"
    if tolerance is not None:
        text += f"; covered with {patches} patches"
        if counts[TOLERANCE]:
            text += f", {tolerance:.2g} mm allowed"
    return text
