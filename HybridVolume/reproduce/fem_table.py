# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The text of ``./run.sh reproduce fem``: every figure in it comes from fem.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .table import demand_table, made_on, table

Case = Mapping[str, Any]
Row = dict[str, Any]

PATCH_LIMIT = 1e-6
LOAD_LIMIT = 1e-3
"""Relative errors that are allowed."""

INTRODUCTION = """# Finite elements: what is reached, measured

Wedges of 15 nodes in the shell and tets of ten in the core on shared nodes, solved by CalculiX.
Displacements and stresses at the Gauss points are read from the file from which CalculiX could go
on, in double precision, so that nothing below is the error of printed digits. All is made again by

```
./run.sh reproduce fem -o DIR
```
"""

PATCH_WORDS = """All nodes of the outer boundary get one random displacement that is linear in
space; the stress is then the same everywhere. Told is how far it is from that at CalculiX's Gauss
points, over its own size (Frobenius): the largest deviation, and in brackets the root mean square.

- *curved*: the mesh as it is delivered, mid nodes on the exact surfaces; *cells in two*: the same
  shell with every cell cut in two both ways;
- *first order*: the mesh of wedges of six nodes and tets of four; *straight*: the same with a node
  in the middle of every edge, wedges of 15 nodes and tets of ten;
- *hexahedra*: the shell of 20-node hexahedra, bound to the tets by equations (`--elements hex20`);
- *Gmsh*: curved tets of the same body, about as coarse.

"""

RULE_WORDS = """A mesh of curved elements conforms as well as one of straight ones: integrated
exactly, the nodal forces of a constant stress cancel at all inner nodes (first column below).
CalculiX integrates a wedge with three points in its triangle, which is exact to the second degree;
where the triangle is curved, those forces are of the third degree and more (second column). That is
the whole deviation of the curved meshes. It is in every curved wedge of CalculiX, whoever made it,
falls as edges get shorter, and is far smaller in curved tets, whose four points err only by the
third power of the bulge.

"""

LOAD_WORDS = """Loads on the CAD body as a user puts them there, on the face with the most curved
area; FreeCAD writes the deck. A force is summed over its `*CLOAD`; for pressure and weight
CalculiX tells the forces at the nodes. *Exact* is the integral over the exact surface. *Ours* is
the deck that this program writes itself (NAME.inp), *mesh* the integral over the mesh's own curved
triangles or elements, that is what the mesh misses of the body. *Centre off* is how far the centre
of the nodal forces is from the face's, over the root of its area.

"""


def as_markdown(found: Mapping[str, Any]) -> str:
    """The text of fem.md."""
    parts = [INTRODUCTION, made_on(found, "cases")]
    reached = demand_table(found["demands"])
    parts.append(_section("What is demanded, and what is reached", reached))
    parts.append(_section("Patch tests", _patch(found["patch_tests"])))
    parts.append(_section("Sums of loads", _loads(found["load_sums"])))
    parts.append(_section("Accuracy", _accuracy(found["accuracy"])))
    if found["pictures"]:
        names = ", ".join(f"`{name}`" for name in found["pictures"])
        parts.append(f"Beside this text the command writes {names}.\n")
    return "\n".join(part for part in parts if part)


def demands(found: Mapping[str, Any]) -> list[Row]:
    """All demands, met or not by the figures alone.

    Parameters
    ----------
    found : mapping
        What fem.json holds.

    Returns
    -------
    list of dict
        ``case``, ``demand`` (text), ``figure`` (text), ``met`` (None where it was not measured).
    """
    rows: list[Row] = []
    for case in found["patch_tests"]:
        rows += _patch_demands(case)
    for case in found["load_sums"]:
        rows += _load_demands(case)
    if found["accuracy"]:
        from . import fem_accuracy

        rows += fem_accuracy.demands(found["accuracy"])
    return rows


def _patch_demands(case: Case) -> list[Row]:
    asked = ("straight", "first order", "curved")
    if case["error"]:
        return [_lost(case, "patch test")]
    rows = []
    for row in case["rows"]:
        if row["mesh"] in asked:
            rows.append(
                {
                    "case": case["case"],
                    "demand": f"patch test, {row['mesh']}: stress within {PATCH_LIMIT:.0e}",
                    "figure": row.get("error") or f"{row['max']:.1e}",
                    "met": not row.get("error") and row["max"] <= PATCH_LIMIT,
                }
            )
    return rows


def _load_demands(case: Case) -> list[Row]:
    if case["error"]:
        return [_lost(case, "sums of loads")]
    return [
        {
            "case": case["case"],
            "demand": f"sum of {row['load']} within {100 * LOAD_LIMIT:g} % of the integral",
            "figure": f"{100 * row['freecad_error']:.4f} %",
            "met": row["freecad_error"] <= LOAD_LIMIT,
        }
        for row in case["rows"]
        if row["load"] != "force"
    ]


def _lost(case: Case, what: str) -> Row:
    return {"case": case["case"], "demand": what, "figure": _reason(case["error"]), "met": False}


def _reason(error: Mapping[str, Any]) -> str:
    return f"{error['code']}: {error['message']}"


def _section(heading: str, text: str) -> str:
    return f"## {heading}\n\n{text}" if text else ""


def _patch(cases: Sequence[Case]) -> str:
    made = [case for case in cases if not case["error"]]
    if not cases:
        return ""
    rows = [
        (
            case["case"] if n == 0 else "",
            row["mesh"],
            str(row.get("nodes", "")),
            _elements(row),
            row.get("error") or f"{row['max']:.1e} ({row['rms']:.1e})",
        )
        for case in made
        for n, row in enumerate(case["rows"])
    ]
    text = PATCH_WORDS + table(("body", "mesh", "nodes", "elements", "deviation"), rows)
    rules = [
        (
            case["case"],
            f"{case['conforming']['exact']:.1e}",
            f"{case['conforming']['calculix']:.1e}",
        )
        for case in made
    ]
    text += "\n" + RULE_WORDS
    text += table(("body", "exactly", "with CalculiX's points"), rules) if rules else ""
    return text + _errors(cases)


def _elements(row: Row) -> str:
    words = [f"{count} {kind}" for kind, count in row.get("elements", {}).items()]
    if row.get("unproved"):
        words.append(f"{row['unproved']} of them not proved valid")
    return ", ".join(words)


def _loads(cases: Sequence[Case]) -> str:
    if not cases:
        return ""
    rows = []
    for case in cases:
        if case["error"]:
            continue
        face = f"{case['case']}, {case['face']} ({100 * case['curved']:.0f} % curved)"
        for row in case["rows"]:
            rows.append(
                (
                    face if row["load"] != "weight" else f"{case['case']}, all",
                    row["load"],
                    f"{_length(row['exact']):.6g}",
                    _sum(row, "freecad"),
                    _sum(row, "ours"),
                    _sum(row, "mesh"),
                    f"{row['freecad_centre_off']:.1e}, {row['ours_centre_off']:.1e}"
                    if "ours_centre_off" in row
                    else "",
                )
            )
    head = ("body, face", "load", "exact N", "FreeCAD: off", "ours: off", "mesh: off",
            "centre off: FreeCAD, ours")  # fmt: skip
    return LOAD_WORDS + table(head, rows) + _errors(cases)


def _length(vector: Sequence[float]) -> float:
    return sum(x * x for x in vector) ** 0.5


def _sum(row: Row, who: str) -> str:
    if who not in row:
        return ""
    return f"{100 * row[f'{who}_error']:.4f} %"


def _accuracy(cases: Sequence[Case]) -> str:
    if not cases:
        return ""
    from . import fem_accuracy

    return fem_accuracy.as_markdown(list(cases)) + _errors(cases)


def _errors(cases: Sequence[Case]) -> str:
    lines = [f"- {case['case']}: {_reason(case['error'])}\n" for case in cases if case["error"]]
    return ("\n" if lines else "") + "".join(lines)
