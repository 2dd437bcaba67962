# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What became of the faces of a body, for the report: bit for bit, exact, or within a tolerance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from HybridVolume.core.covering.kinds import BIT, EXACT, KINDS, TOLERANCE


def geometry_figures(
    kinds: Sequence[str],
    patches: Sequence[int],
    deviation: Sequence[float],
    area: Sequence[float],
    tolerance: float | None = None,
    inside: Sequence[int] = (),
    merged: Mapping[int, int] | None = None,
) -> dict[str, Any]:
    """Figures of the faces of a body.

    Parameters
    ----------
    kinds : sequence of {"bit", "exact", "tolerance"}
        Of ``Face1``, ``Face2``, ...
    patches : sequence of int
        How many each has.
    deviation : sequence of float
        Largest distance of its patches from it, mm.
    area : sequence of float
        Of each, mm^2.
    tolerance : float, optional
        Largest deviation that was allowed, mm; None where every face is one patch itself.
    inside : sequence of int
        Faces, from 0, that are left out: inside the material, or merged.
    merged : mapping of int to int
        Those of them that are part of a neighbour now, and this.

    Returns
    -------
    dict
        ``patches``; ``tolerance`` and ``max_deviation``, mm; ``counts`` of faces and shares of
        their ``area`` by kind; ``faces``: of each its ``name``, ``kind``, ``patches``,
        ``deviation`` (mm), ``area`` (mm^2); ``inside``: names of the faces that are left out
        because they are inside the material; where there are any, ``merged``: names of faces too
        narrow for patches, and of the neighbour that each is part of now; ``sentence``: the same
        in words.
    """
    names = {f"Face{k + 1}": f"Face{into + 1}" for k, into in sorted((merged or {}).items())}
    rows = [
        {
            "name": f"Face{number}",
            "kind": kind,
            "patches": int(count),
            "deviation": float(off),
            "area": float(size),
        }
        for number, (kind, count, off, size) in enumerate(
            zip(kinds, patches, deviation, area, strict=True), start=1
        )
        if number - 1 not in inside
    ]
    walls = [f"Face{number + 1}" for number in inside]
    return _of_rows(rows, tolerance, [name for name in walls if name not in names], names)


def with_moves(figures: Mapping[str, Any], moves: Mapping[str, float]) -> dict[str, Any]:
    """The figures after points of faces were moved to close the surface.

    Parameters
    ----------
    figures : mapping
        As :func:`geometry_figures` gives them.
    moves : mapping of str to float
        Largest move of a point of a face, mm, by its name; only of those that were moved by more
        than rounding.
    """
    rows = [
        {**row, "kind": TOLERANCE, "deviation": row["deviation"] + float(moves[row["name"]])}
        if row["name"] in moves
        else dict(row)
        for row in figures["faces"]
    ]
    return _of_rows(rows, figures["tolerance"], figures["inside"], figures.get("merged", {}))


def _of_rows(
    rows: list[dict[str, Any]],
    tolerance: float | None,
    inside: Sequence[str],
    merged: Mapping[str, str],
) -> dict[str, Any]:
    of_kind = {kind: [row for row in rows if row["kind"] == kind] for kind in KINDS}
    counts = {kind: len(found) for kind, found in of_kind.items()}
    areas = {kind: sum(row["area"] for row in found) for kind, found in of_kind.items()}
    whole = sum(areas.values())
    patches = sum(row["patches"] for row in rows)
    near = max((row["deviation"] for row in of_kind[TOLERANCE]), default=0.0)
    return {
        "patches": patches,
        "tolerance": tolerance,
        "max_deviation": max(row["deviation"] for row in rows),
        "counts": counts,
        "area": {kind: area / whole for kind, area in areas.items()},
        "faces": rows,
        "inside": list(inside),
        **({"merged": dict(merged)} if merged else {}),
        "sentence": _sentence(counts, patches, near, tolerance, len(inside)) + _joined(merged),
    }


def _sentence(
    counts: Mapping[str, int],
    patches: int,
    deviation: float,
    tolerance: float | None,
    inside: int,
) -> str:
    words = {BIT: "bit for bit", EXACT: "exact", TOLERANCE: f"within {deviation:.2g} mm"}
    told = ", ".join(f"{counts[kind]} {words[kind]}" for kind in KINDS if counts[kind])
    text = f"{_number(sum(counts.values()), 'face')}: {told}"
    if tolerance is None:
        return text
    allowed = f", {tolerance:.2g} mm allowed" if counts[TOLERANCE] else ""
    left = f"; {_number(inside, 'face')} inside the material" if inside else ""
    left += f" {'is' if inside == 1 else 'are'} left out" if inside else ""
    return f"{text}; covered with {_number(patches, 'patch', 'patches')}{allowed}{left}"


def _joined(merged: Mapping[str, str]) -> str:
    """Which faces were too narrow, in words; the first few of many."""
    told = [f"{name} is part of {into} now" for name, into in list(merged.items())[:3]]
    if len(merged) > 3:
        told.append(f"{_number(len(merged) - 3, 'more face')} of neighbours")
    return f"; too narrow: {', '.join(told)}" if told else ""


def _number(count: int, one: str, several: str = "") -> str:
    return f"{count} {one if count == 1 else several or one + 's'}"
