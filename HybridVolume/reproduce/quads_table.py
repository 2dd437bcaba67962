# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The text of ``./run.sh reproduce quads``: every figure in it comes from quads.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from .quads_demands import SEVERAL, reason
from .quads_inputs import INPUTS, SHELL
from .table import demand_table, made_on, table

Case = Mapping[str, Any]
Row = Mapping[str, Any]

INTRODUCTION = """# Quad meshes, cages, smooth surfaces: what is reached, measured

The paper's other inputs: quads as bilinear patches (section 3), Catmull-Clark cages (Figs. 1 and
3), smooth bicubic surfaces of quad meshes (Fig. 8 a, b). All is made again by

```
./run.sh reproduce quads -o DIR
```
"""

INPUT_WORDS = """Each row is one run of the command line with nothing but the scheme, in a process
of its own, with all files that it writes: midstructure, field, shell, certificate, core, finite
element mesh of the second order, document. *w0* is the mean level reached (asked: .5), *scaled
Jacobian* the smallest of the shell's elements at 6 x 6 x 6 places each, *of the mesh* the smallest
of all finite elements. Seconds are of the processor, of all processes of the run.

"""

MANY_WORDS = """*ant-patches* is the ant with one bilinear patch a quad. *ant-joined* is the same
surface, point for point, and with the same spans and control points, in the few patches of its
layout; *torus* has about as many control points in bicubic patches of many spans. Seconds of the
processor, by stages; what the command line itself does besides is in *reading* and *document*.

"""

SMOOTH_WORDS = """The surfaces are cut into their polynomial pieces, and normals of both pieces are
compared at 50 places of every side that two have in common, creases left out; splines are evaluated
one knot span at a time, apart from the program's own evaluation, and sides are found by their
places. *Told* is what the program itself says. Spindles have two vertices of the valence and else
vertices of valence three.

"""

LIMIT_WORDS = """The limit surface by a subdivision of its own, whose vertices are put to their
places on the limit; each of these points is projected onto the patches. *Told* is what the program
itself says, which is to be no less.

"""

EXACT_WORDS = """Spans are cut, and the surfaces before and after are evaluated by SciPy at random
places and at the new knots of every patch.

"""

BROKEN_WORDS = """A block of 24 quads with one fault each, given to the command line. A refusal ends
with code 2 and leaves no file; what is mended is told, and completed.

"""


def as_markdown(found: Mapping[str, Any]) -> str:
    """The text of quads.md."""
    parts = [INTRODUCTION, made_on(found, "cases")]
    for heading, text in (
        ("What is demanded, and what is reached", _demands(found["demands"])),
        ("The whole way", _inputs(found["cases"])),
        ("Thousands of patches", _many(found["many_patches"])),
        ("Smoothness", _smoothness(found["smoothness"])),
        ("Distance to the limit surface", _limits(found["limit_distance"])),
        ("Exactness of refinement", _exactness(found["exactness"])),
        ("Broken meshes", _broken(found["broken"])),
    ):
        if text:
            parts.append(f"## {heading}\n\n{text}")
    if found["pictures"]:
        names = ", ".join(f"`{name}`" for name in found["pictures"])
        parts.append(f"Beside this text the command writes {names}: bodies cut open.\n")
    return "\n".join(part for part in parts if part)


def _demands(rows: Sequence[Row]) -> str:
    broken = [row for row in rows if row["case"].startswith("broken")]
    shown = [row for row in rows if row not in broken or not row["met"]]
    more = ""
    if broken:
        held = sum(bool(row["met"]) for row in broken)
        more = f" Broken meshes have a table of their own below: {held} of {len(broken)} are met."
    return demand_table(rows, shown=shown, more=more)


def _inputs(cases: Sequence[Case]) -> str:
    if not cases:
        return ""
    known = {one.name: one for one in INPUTS}
    head = ("input", "scheme", "quads", "patches", "control points", "volume mm³", "elements",
            "w0", "scaled Jacobian", "tets", "nodes", "of the mesh", "s")  # fmt: skip
    rows = []
    for case in sorted(cases, key=lambda c: (bool(c["error"]), c["name"])):
        one = known[case["name"]]
        if case["error"]:
            rows.append((one.file, one.scheme, *[""] * 10, "see below"))
            continue
        mesh = (
            ("shell only", "", "")
            if one.way == SHELL
            else (
                str(case["tets"]),
                str(case["fem_nodes"]),
                f"{case['fem_min_scaled_jacobian']:.2g}",
            )
        )
        rows.append(
            (
                one.file,
                one.scheme,
                str(case["quads"]),
                str(case["patches"]),
                str(case["control_points"]),
                f"{case['volume']:.6g}",
                f"{case['proved']} of {case['elements']} proved",
                f"{case['w0']:.2f}",
                f"{case['min_scaled_jacobian']:.2g}",
                *mesh,
                f"{case['seconds_cpu']:.0f}",
            )
        )
    return INPUT_WORDS + table(head, rows) + _errors(cases) + _told(cases)


def _told(cases: Sequence[Case]) -> str:
    """Notes of the runs."""
    lines = [
        f"- {case['name']}: {note}\n"
        for case in cases
        if not case["error"]
        for note in case.get("notes", [])[:3]
    ]
    return ("\nTold by the runs:\n\n" if lines else "") + "".join(lines)


def _many(cases: Sequence[Case]) -> str:
    made = [case for case in cases if not case["error"]]
    if not made:
        return _errors(cases)
    stages = list(dict.fromkeys(stage for case in made for stage in case["stages"]))
    head = ("", *(case["case"] for case in made))
    rows = [
        ("patches", *(str(case["patches"]) for case in made)),
        ("control points", *(str(case["control_points"]) for case in made)),
        ("elements of the shell", *(str(case["elements"]) for case in made)),
        ("tets of the core", *(str(case["tets"]) for case in made)),
        *(
            (f"{stage}, s", *(f"{case['stages'].get(stage, 0.0):.1f}" for case in made))
            for stage in stages
        ),
        ("all, s", *(f"{case['seconds_cpu']:.1f}" for case in made)),
    ]
    many = next((case for case in made if case["case"] == SEVERAL), None)
    if many:
        ratios = [f"{many['seconds_cpu'] / case['seconds_cpu']:.2f}" for case in made]
        rows.append((f"times that {SEVERAL} takes", *ratios))
    return MANY_WORDS + table(head, rows) + _errors(cases)


def _smoothness(cases: Sequence[Case]) -> str:
    if not cases:
        return ""
    head = ("surface", "scheme", "pieces", "sides", "creases", "largest angle rad", "told",
            "by valence (vertices)")  # fmt: skip
    rows = []
    for case in cases:
        if case["error"]:
            continue
        valences = ", ".join(
            f"{n}: {one['angle']:.1e} ({one['vertices']})" for n, one in case["valences"].items()
        )
        rows.append(
            (
                case["case"],
                case["scheme"],
                str(case["pieces"]),
                str(case["sides"]),
                str(case["creases"]),
                f"{case['angle']:.1e}",
                f"{case['told']:.1e}",
                valences,
            )
        )
    return SMOOTH_WORDS + table(head, rows) + _errors(cases)


def _limits(cases: Sequence[Case]) -> str:
    if not cases:
        return ""
    head = ("cage", "subdivisions", "quads", "patches", "largest distance mm", "of the diagonal",
            "root mean square mm", "told mm")  # fmt: skip
    rows = [
        (
            f"{case['case']} ({case['points']} points)" if number == 0 else "",
            f"{row['steps']} (default)" if row["default"] else str(row["steps"]),
            str(row["quads"]),
            str(row["patches"]),
            f"{row['distance']:.2e}",
            f"{row['share']:.1e}",
            f"{row['rms']:.1e}",
            f"{row['told']:.2e}",
        )
        for case in cases
        if not case["error"]
        for number, row in enumerate(case["rows"])
    ]
    return LIMIT_WORDS + table(head, rows) + _errors(cases)


def _exactness(cases: Sequence[Case]) -> str:
    if not cases:
        return ""
    head = ("body", "refinement", "spans", "longest mm", "aspect", "turn °", "deviation mm",
            "of the diagonal")  # fmt: skip
    rows = []
    for case in cases:
        if case["error"]:
            continue
        kind = "rational" if case["rational"] else "polynomial"
        rows.append((f"{case['case']} ({kind})", "none", *_spans(case), "", ""))
        rows += [
            (
                "",
                row["refinement"],
                *_spans(row),
                f"{row['deviation']:.1e}",
                f"{row['deviation'] / case['diagonal']:.1e}",
            )
            for row in case["rows"]
        ]
    return EXACT_WORDS + table(head, rows) + _errors(cases)


def _spans(row: Row) -> tuple[str, ...]:
    return (
        str(row["spans"]),
        f"{row['longest']:.3g}",
        f"{np.minimum(row['aspect'], 9999.0):.3g}",
        f"{row['turn']:.3g}",
    )


def _broken(cases: Sequence[Case]) -> str:
    if not cases:
        return ""
    rows = []
    for case in cases:
        if case["error"]:
            continue
        # the last note is the summary of the finished volume
        notes = [note for note in case["notes"] if not note.startswith("w0 ")]
        said = case["said"] or "; ".join(notes[:2])
        rows.append((case["case"], case["words"], case["expected"], str(case["code"]), said))
    head = ("mesh", "fault", "is to be", "code", "what is said")
    return BROKEN_WORDS + table(head, rows) + _errors(cases)


def _errors(cases: Sequence[Case]) -> str:
    lines = [f"- {case['name']}: {reason(case['error'])}\n" for case in cases if case["error"]]
    return ("\n" if lines else "") + "".join(lines)
