# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The text of ``./run.sh reproduce steps``, and what is demanded; all from steps.json."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from .steps import SOLIDS
from .steps_bodies import BODIES
from .steps_case import FAILED, MADE, REFUSED, STOPPED
from .table import demand_table, made_on, table

Case = Mapping[str, Any]
Row = dict[str, Any]

LEAST = 25
"""Distinct bodies that have to go the whole way."""
ROUNDING = 1e-9
"""Allowed beside every tolerance, as a share of the diagonal or of the volume."""

INTRODUCTION = """# CAD bodies of any faces: what is reached, measured

Solids as they are drawn, with holes, seams, poles and trimmed faces, from STEP files and by script
in FreeCAD (which writes a STEP file of each). Each is one run of the command line without options,
in a process of its own. All is made again by

```
./run.sh reproduce steps -o DIR
```
"""

BODY_WORDS = """*Kept* counts the faces that stay bit for bit, those with exact geometry, and those
within a tolerance (1e-4 of the diagonal is allowed), and the share of the area that is one of the
first two. *Deviation* is the largest distance of the patches from the CAD faces that the program
tells, *off* the largest of some nodes of the mesh from their CAD faces as OCC measures it, both as
shares of the diagonal. *Volume* is compared with the formula, in brackets with OCC's triangles,
extrapolated (and how far that may be off). *w0* is the mean level reached (asked: .5); *scaled
Jacobian* the smallest of the shell's elements and of all finite elements. *Found* are the faces of
the body on which `getNodesByFace` finds all nodes of the reopened document's mesh; with * on a copy
of the body with wider tolerances, as the analysis has it. Seconds are of the processor, of all
processes of the run.

"""

REFUSED_WORDS = """A refusal ends with code 2 and leaves no file but a picture of the places, if it
has some.

"""


def as_markdown(found: Mapping[str, Any]) -> str:
    """The text of steps.md."""
    head = made_on(found, "bodies")
    limits = found["limits"]
    head += (
        f"\nLimits: {limits['seconds']:g} s of the processor for a body, "
        f"{limits['memory'] / 2**30:g} GiB of address space for each process.\n"
    )
    if found["other_programs"]:
        head += f"\nMade by another version of the program: {', '.join(found['other_programs'])}.\n"
    parts, cases = [INTRODUCTION, head], [*found["scripted"], *found["files"]]
    for heading, text in (
        ("What is demanded, and what is reached", _demand_table(found["demands"])),
        ("Bodies", BODY_WORDS if _bodies(cases) else ""),
        ("Bodies by script", _bodies(found["scripted"])),
        ("Bodies of files", _bodies(found["files"])),
        ("Refused", _refused(cases)),
    ):
        if text:
            parts.append(f"## {heading}\n\n{text}")
    if found["pictures"]:
        names = ", ".join(f"`{name}`" for name in found["pictures"])
        parts.append(f"Beside this text the command writes {names}: bodies cut open.\n")
    return "\n".join(parts)


def _demand_table(rows: Sequence[Row]) -> str:
    """All that is not met, and each demand once with how many meet it."""
    if not rows:
        return ""
    counts = []
    for words in dict.fromkeys(row["demand"] for row in rows):
        asked = [row for row in rows if row["demand"] == words and row["met"] is not None]
        if len(asked) > 1:
            met = sum(bool(row["met"]) for row in asked)
            counts.append(
                {"body": f"all {len(asked)}", "demand": words,
                 "figure": f"met by {met}", "met": met == len(asked)}
            )  # fmt: skip
    single = [row for row in rows if sum(r["demand"] == row["demand"] for r in rows) == 1]
    unmet = [row for row in rows if row["met"] is False and row not in single]
    return demand_table(rows, head="body", shown=[*single, *counts, *unmet])


def demands(found: Mapping[str, Any]) -> list[Row]:
    """All demands.

    Parameters
    ----------
    found : mapping
        What steps.json holds.

    Returns
    -------
    list of dict
        ``body``, ``demand`` (text), ``figure`` (text), ``met`` (None where it was not asked).
    """
    cases = [*found["scripted"], *found["files"]]
    if not cases:
        return []
    bodies = [body for case in cases if not case["error"] for body in case["bodies"]]
    whole = sum(_whole(body) for body in bodies)
    rows = []
    if found["whole"] and not found["not_done"]:
        rows.append(
            {"body": "together", "demand": f"{LEAST} bodies or more go the whole way",
             "figure": f"{whole} of {sum(_solids(case) for case in cases)}", "met": whole >= LEAST}
        )  # fmt: skip
    for case in cases:
        rows.append(_ended(case))
        for name, body in _named(case):
            rows += _of_body(name, case["case"], body)
        if case["name"] in SOLIDS:
            count = SOLIDS[case["name"]]
            made = sum(_whole(body) for _, body in _named(case))
            rows.append(
                {"body": case["name"], "demand": f"{count} volumes in one run",
                 "figure": str(made), "met": made == count}
            )  # fmt: skip
    return rows


def _solids(case: Case) -> int:
    if case["error"] or not case["bodies"]:
        return SOLIDS.get(case["name"], 1)
    return len(case["bodies"]) + len(case["refused"])


def _named(case: Case) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Bodies of a case with their names."""
    if case["error"]:
        return
    for k, body in enumerate(case["bodies"], start=1):
        yield (case["name"] if len(case["bodies"]) == 1 else f"{case['name']} {k}"), body


def _whole(body: Mapping[str, Any]) -> bool:
    return body["proved"] == body["elements"] > 0 and body["embedded"] and body["nodes"] > 0


def _ended(case: Case) -> Row:
    """Made, or refused as it should be."""
    if case["error"]:
        figure, met = case["error"]["message"], False
    elif case["state"] == MADE:
        figure, met = "made", all(_whole(body) for _, body in _named(case))
    elif case["state"] == REFUSED:
        named = bool(case["said"]) and all("Face" in line for line in case["said"])
        # a picture of the places is no result
        results = [name for name in case["left"] if not name.endswith("_refused.png")]
        left = bool(results) and not case["bodies"]
        met = named and not left and not case["traceback"]
        figure = "refused, " + ("faces named" if named else "no face named")
        figure += ", files left" if left else ""
    else:
        figure = {STOPPED: "no end within the limit", FAILED: f"code {case['code']}"}[case["state"]]
        met = False
    return {
        "body": case["name"],
        "demand": "certified volume and mesh, or a refusal that names faces and leaves no result",
        "figure": figure,
        "met": met,
    }


def _of_body(name: str, case: str, body: Mapping[str, Any]) -> list[Row]:
    diagonal, tolerance = body["diagonal"], body["tolerance"] or 0.0
    allowed = tolerance + ROUNDING * diagonal
    known = next((one for one in BODIES if one.name == case), None)
    rows = [
        {
            "body": name,
            "demand": "deviation told, and of nodes by OCC, within the tolerance",
            "figure": f"{body['deviation']:.2g} and {body['off']:.2g} mm, {tolerance:.2g} allowed",
            "met": max(body["deviation"], body["off"]) <= allowed,
        },
        {
            "body": name,
            "demand": "getNodesByFace finds every face of the body",
            "figure": _found(body),
            "met": body["faces_found"] == body.get("faces_to_ask", body["faces_asked"]),
        },
        {
            "body": name,
            "demand": "no element of a neighbour is found with a face",
            "figure": ", ".join(body["faces_with_strangers"]) or "none",
            "met": not body["faces_with_strangers"],
        },
    ]
    if known is not None:
        rows.append(
            {
                "body": name,
                "demand": "genus as known",
                "figure": _genus(body["genus"]),
                "met": sorted(body["genus"]) == sorted(known.genus),
            }
        )
    if known is not None and known.volume is not None:
        # nothing can be off by more than the surface times its distance
        bound = body["area"] * body["deviation"] + ROUNDING * known.volume
        rows.append(
            {
                "body": name,
                "demand": "volume by formula within the deviation told times the area",
                "figure": f"off by {body['volume'] - known.volume:.2g} mm³, {bound:.2g} allowed",
                "met": abs(body["volume"] - known.volume) <= bound,
            }
        )
    return rows


def _found(body: Mapping[str, Any]) -> str:
    """Faces on which all nodes are found; looking for them ends after some time."""
    text = f"{body['faces_found']} of {body['faces_asked']}"
    left = body.get("faces_to_ask", body["faces_asked"]) - body["faces_asked"]
    return f"{text} ({left} not asked)" if left else text


def _genus(genus: Sequence[int]) -> str:
    return ", ".join(str(g) for g in genus)


def _bodies(cases: Sequence[Case]) -> str:
    head = (
        "body", "faces", "patches", "kept", "deviation", "off", "volume", "genus", "elements",
        "w0", "scaled Jacobian", "tets", "nodes", "of the mesh", "found", "s",
    )  # fmt: skip
    rows = [_row(name, case, body) for case in cases for name, body in _named(case)]
    return table(head, rows) if rows else ""


def _row(name: str, case: Case, body: Mapping[str, Any]) -> tuple[str, ...]:
    counts, shares = body["counts"], body["area_shares"]
    kept = f"{counts['bit']}/{counts['exact']}/{counts['tolerance']}"
    if counts["tolerance"]:
        kept += f" ({100 * (shares['bit'] + shares['exact']):.0f} %)"
    alone = len(case["bodies"]) == 1
    return (
        name,
        str(body["faces"]),
        str(body["patches"]),
        kept,
        f"{body['deviation'] / body['diagonal']:.1e}",
        f"{body['off'] / body['diagonal']:.1e}",
        _volume(case["case"], body),
        _genus(body["genus"]),
        str(body["elements"]),
        f"{body['w0']:.2f}",
        f"{body['min_scaled_jacobian']:.2g}",
        str(body["tets"]),
        str(body["nodes"]),
        f"{body['fem_min_scaled_jacobian']:.2g}",
        _found(body) + ("*" if body["widened"] else ""),
        f"{case['seconds_cpu'] if alone else body['stages']['total']:.0f}",
    )


def _volume(case: str, body: Mapping[str, Any]) -> str:
    known = next((one for one in BODIES if one.name == case), None)
    if known is not None and known.volume is not None:
        return f"{body['volume'] / known.volume - 1.0:+.0e}"
    of = body["triangle_volume"]
    return f"({body['volume'] / of - 1.0:+.0e} ± {body['triangle_doubt'] / of:.0e})"


def _refused(cases: Sequence[Case]) -> str:
    lines = []
    for case in cases:
        if case["error"]:
            lines.append(f"- {case['name']} (fault): {case['error']['message']}")
        elif case["state"] == STOPPED:
            lines.append(f"- {case['name']}: no end within the limit ({case['seconds_cpu']:.0f} s)")
        elif case["state"] != MADE:
            kind = "" if case["state"] == REFUSED else f" (code {case['code']})"
            lines += [f"- {case['name']}{kind}: {line}" for line in case["said"] or ["no reason"]]
    return REFUSED_WORDS + "\n".join(lines) + "\n" if lines else ""
