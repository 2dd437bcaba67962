# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The text of ``./run.sh reproduce shell``: every figure in it comes from shell.json."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .shell_bodies import DEMANDS, SPEED_BODY
from .shell_demands import sound
from .table import demand_table, made_on, table

Case = Mapping[str, Any]

INTRODUCTION = """# Shells: what is reached, measured

A shell is asked for by the level w0 of the harmonic field on which its inner boundary shall lie (0
is the surface, 1 the midstructure). Each row below is one body at one level:

- *w0*: mean of the level over the inner boundary, weighted by area, and in brackets its root mean
  square deviation;
- *proved*: Bézier elements of which det J > 0 is proved on the whole closed element (Bernstein
  coefficients with rounding bounds), of all elements. A shell counts only if that is all of them
  and the inner boundary does not cut itself;
- *scaled Jacobian*: the smallest det J / (|x_u| |x_v| |x_w|) over 6 x 6 x 6 places of every
  element; 1 is a box. Where the normal of the given surface itself vanishes (in corners of the
  pole, along lines of others) it is 0 whatever the shell does; the proof then holds everywhere
  else, and the row says for how many elements;
- *bound*: what no shell on this surface can exceed, with any columns: the smallest, over places of
  the surface, of the largest value that one direction can have for all patches that meet there;
- *seconds*: front, untangling, certificate and test for crossings, of the processor. Midstructure
  and field are made once for all levels of a body and not counted here.

A case that has no shell is a row, too, with the reason. All is made again by
"""

METHODS = {
    "paper": "the paper's section 3 as written (`--method paper`)",
    "netgen": "Netgen's boundary layers",
    "gmsh": "Gmsh's `extrudeBoundaryLayer`",
}


def as_markdown(found: Mapping[str, Any]) -> str:
    """The text of shell.md."""
    reached = demand_table(found["demands"], "body")
    parts = [
        INTRODUCTION + "\n```\n./run.sh reproduce shell -o DIR\n```\n",
        made_on(found, "bodies"),
        _section("What is demanded, and what is reached", reached),
    ]
    cases = found["cases"]
    groups: dict[str, list[Case]] = {}
    for case in cases:
        if case["group"] == "table":
            groups.setdefault(DEMANDS[case["body"]].group, []).append(case)
    for group, members in groups.items():
        parts.append(_section(f"Bodies: {group}", _cases(members)))
    parts.append(_section("Bodies: further files", _cases(_of(cases, "other"))))
    parts.append(_section("Random bodies", _random(_of(cases, "random"))))
    parts.append(_section("Shape before level", _shape(found["shape_first"])))
    parts.append(_section("Layers", _layers(found["layers"])))
    parts.append(_section("Beside other ways", _rivals(found)))
    parts.append(_section("Time", _speed(found)))
    parts.append(_section("Pictures", _pictures(found["pictures"])))
    return "\n".join(part for part in parts if part)


def _section(heading: str, text: str) -> str:
    return f"## {heading}\n\n{text}" if text else ""


def _of(cases: Sequence[Case], group: str) -> list[Case]:
    return [case for case in cases if case["group"] == group]


def _cases(cases: Sequence[Case]) -> str:
    made = [case for case in cases if not case.get("error")]
    rows, last = [], None
    for case in made:
        scaled = case["scaled_jacobian"]
        first = case["body"] != last
        last = case["body"]
        rows.append(
            (
                _body_words(case) if first else "",
                f"{case['w0_asked']:g}",
                f"{case['w0']:.3f} ({case['w0_rms']:.3f})",
                _proof(case),
                f"{case['min_scaled_jacobian']:.3f}",
                f"{scaled['q01']:.2f}, {scaled['median']:.2f}",
                _optional(case.get("bound"), 3),
                f"{case['seconds_cpu']:.1f}",
            )
        )
    head = ("body", "asked", "w0 (rms)", "proved", "scaled Jacobian", "1 %, median", "bound", "s")
    text = table(head, rows) if rows else ""
    return "\n".join(part for part in (text, _errors(cases), _notes(made)) if part)


def _body_words(case: Case) -> str:
    genus = ", ".join(str(g) for g in case["genus"])
    words = f"{case['body']}: {case['patches']} patches, {case['spans']} spans, genus {genus}"
    options = "".join(f", {name}" for name in case["options"])
    return words + (", rational" if case["rational"] else "") + options


def _proof(case: Case) -> str:
    if sound(case):
        inside = case.get("valid_inside", 0)
        return f"all {case['elements']}" + (f" ({inside} but for such places)" if inside else "")
    more = "" if case["embedded"] else ", cuts itself"
    return f"{case['valid']} of {case['elements']}{more}"


def _errors(cases: Sequence[Case]) -> str:
    """Reasons, each once with the levels it holds for."""
    reasons: dict[tuple[str, str], list[str]] = {}
    for case in cases:
        if case.get("error"):
            reasons.setdefault((case["body"], _reason(case["error"])), []).append(
                f"{case['w0_asked']:g}"
            )
    lines = [
        f"- {body} has no shell at {', '.join(levels)}: {reason}"
        for (body, reason), levels in reasons.items()
    ]
    return "\n".join(lines) + ("\n" if lines else "")


def _reason(error: Mapping[str, Any]) -> str:
    faces = ", ".join(error["faces"][:4]) + (" ..." if len(error["faces"]) > 4 else "")
    text = f"{faces}: {error['message']}" if faces else error["message"]
    places = [
        f"{place['face']} at ({place['u']:.2f}, {place['v']:.2f})" for place in error["places"][:3]
    ]
    return text + (f"; the first places: {', '.join(places)}" if places else "")


def _notes(cases: Sequence[Case]) -> str:
    notes: dict[tuple[str, str], list[str]] = {}
    for case in cases:
        for note in case["notes"]:
            notes.setdefault((case["body"], note), []).append(f"{case['w0_asked']:g}")
    asked = {case["body"]: case["options"] for case in cases if case["options"]}
    lines = [
        f"- {body} is made with {', '.join(f'`{name}={value}`' for name, value in options.items())}"
        for body, options in asked.items()
    ]
    lines += [f"- {body} at {', '.join(at)}: {note}" for (body, note), at in notes.items()]
    return "\n".join(lines) + ("\n" if lines else "")


def _random(cases: Sequence[Case]) -> str:
    if not cases:
        return ""
    names = list(dict.fromkeys(case["body"] for case in cases))
    levels = sorted({case["w0_asked"] for case in cases})
    parts = [
        f"{len(names)} bodies that a script makes from fixed seeds (`HybridVolume/reproduce/"
        "random_bodies.py`): voxel solids bent by smooth maps, of degree 1 to 3, with holes, "
        "steps, shears, thin and twisted parts.\n"
    ]
    rows = []
    for level in levels:
        there = [case for case in cases if case["w0_asked"] == level]
        good = [case for case in there if sound(case)]
        least = sorted(case["min_scaled_jacobian"] for case in good)
        reached = sorted(case["w0"] / level for case in good)
        rows.append(
            (
                f"{level:g}",
                f"{len(good)} of {len(there)}",
                *(_spread(least, 2)),
                *(_spread(reached, 2)),
            )
        )
    head = ("asked", "proved and free of crossings", "scaled Jacobian: least", "median", "most",
            "w0 / asked: least", "median", "most")  # fmt: skip
    parts.append(table(head, rows))
    at = 0.5 if 0.5 in levels else levels[-1]
    parts.append(_distribution([c for c in cases if c["w0_asked"] == at and sound(c)], at))
    parts.append(_each(cases, names, levels))
    parts.append(_errors(cases))
    return "\n".join(part for part in parts if part)


def _spread(values: Sequence[float], digits: int) -> tuple[str, str, str]:
    if not values:
        return "", "", ""
    chosen = (values[0], values[len(values) // 2], values[-1])
    return tuple(f"{value:.{digits}f}" for value in chosen)


def _distribution(cases: Sequence[Case], level: float) -> str:
    if not cases:
        return ""
    total = [sum(column) for column in zip(
        *(case["scaled_jacobian"]["histogram"] for case in cases), strict=True)]  # fmt: skip
    # pairs of bins: ten columns are enough for a table
    pairs = [a + b for a, b in zip(total[::2], total[1::2], strict=True)]
    of_bodies = [0] * len(pairs)
    for case in cases:
        of_bodies[min(int(case["min_scaled_jacobian"] * 10), 9)] += 1
    head = ("scaled Jacobian", *(f"{k / 10:.1f} to {(k + 1) / 10:.1f}" for k in range(10)))
    count = sum(total)
    return f"At {level:g}, all elements, and the smallest of each body:\n\n" + table(
        head,
        [
            (f"of {count} elements", *(f"{100 * n / count:.1f} %" for n in pairs)),
            (f"smallest of {len(cases)} bodies", *(str(n) for n in of_bodies)),
        ],
    )


def _each(cases: Sequence[Case], names: Sequence[str], levels: Sequence[float]) -> str:
    rows = []
    for name in names:
        own = {case["w0_asked"]: case for case in cases if case["body"] == name}
        some = next(iter(own.values()))
        cells = [
            "-" if own[level].get("error") or not sound(own[level])
            else f"{own[level]['w0']:.2f} / {own[level]['min_scaled_jacobian']:.2f}"
            for level in levels if level in own
        ]  # fmt: skip
        genus = ", ".join(str(g) for g in some.get("genus", ()))
        rows.append((name, str(some.get("spans", "")), genus, *cells,
                     _optional(some.get("bound"), 2)))  # fmt: skip
    head = ("body", "spans", "genus", *(f"at {level:g}" for level in levels), "bound")
    return "Level reached / smallest scaled Jacobian:\n\n" + table(head, rows)


def _shape(cases: Sequence[Case]) -> str:
    if not cases:
        return ""
    rows = [
        (
            case["body"], f"{case['w0_asked']:g}", f"{case['w0']:.2f} ({case['w0_rms']:.2f})",
            _proof(case), f"{case['min_scaled_jacobian']:.3f}",
        )
        for case in cases if not case.get("error")
    ]  # fmt: skip
    words = (
        "With a weight of .3 on the isosurface term the elements keep their best shape and the "
        "shell stays thinner than asked; this is what that costs and brings.\n\n"
    )
    text = table(("body", "asked", "w0 (rms)", "proved", "scaled Jacobian"), rows) if rows else ""
    return words + text + _errors(cases)


def _layers(cases: Sequence[Case]) -> str:
    # degrees that give the same figures share a row
    grouped: dict[tuple[str, ...], list[str]] = {}
    for case in cases:
        for row in case.get("levels", ()):
            cells = (
                case["body"], _spacing(row),
                f"{row['valid']} of {row['elements']}", f"{row['min_scaled_jacobian']:.2f}",
                f"{row['volume_ratio_median']:.2f}", f"{row['volume_ratio_max']:.1f}",
                " / ".join(f"{height:.2g}" for height in row["heights"]),
            )  # fmt: skip
            grouped.setdefault(cells, []).append(str(row["degree"]))
    rows = [(*cells[:2], ", ".join(degrees), *cells[2:]) for cells, degrees in grouped.items()]
    errors = _errors([case for case in cases if case.get("error")])
    if not rows:
        return errors
    words = (
        "One shell at .5, cut into three layers in different ways and proved again. Volumes are "
        "compared within each column, the largest over the smallest element. Heights are means, "
        "outermost first.\n\n"
    )
    head = ("body", "layers", "degree", "proved", "scaled Jacobian", "volume ratio: median",
            "largest", "heights mm")  # fmt: skip
    return words + table(head, rows) + errors


def _spacing(row: Mapping[str, Any]) -> str:
    words = {
        "volume": "equal volume",
        "distance": "equal distance",
        "ratio": f"each {row['value']:g} times as high",
        "first": f"first layer {row['value']:.3g} mm",
    }
    return words[row["spacing"]]


def _rivals(found: Mapping[str, Any]) -> str:
    parts = []
    if found["paper"]:
        parts.append(_paper(found["paper"], found["cases"]))
    if found["rivals"]:
        parts.append(_meshers(found["rivals"], found["cases"]))
    return "\n".join(parts)


def _paper(paper: Sequence[Case], cases: Sequence[Case]) -> str:
    """Elements that the paper's method leaves unproved, beside ours."""
    levels = sorted({case["w0_asked"] for case in paper})
    own = {(case["body"], case["w0_asked"]): case for case in cases}
    rows: list[tuple[str, ...]] = []
    reasons: dict[str, str] = {}
    for name in dict.fromkeys(case["body"] for case in paper):
        there = {case["w0_asked"]: case for case in paper if case["body"] == name}
        if any(case.get("error") for case in there.values()):
            continue
        cells = []
        for level in levels:
            figures = there[level]["paper"] if level in there else None
            if figures is None or figures["elements"] is None:
                cells.append("-")
                if figures and figures["error"]:
                    reasons[name] = figures["error"]
            else:
                bad = figures["elements"] - figures["valid"]
                least = _optional(figures["min_scaled_jacobian"], 2)
                cells.append(f"{bad} of {figures['elements']} ({least})")
        ours = own.get((name, 0.5))
        told = "" if ours is None else "no shell" if ours.get("error") else (
            f"{ours['elements'] - ours['valid']} of {ours['elements']} "
            f"({ours['min_scaled_jacobian']:.2f})"
        )  # fmt: skip
        rows.append((name, *cells, told))
    words = (
        f"Elements that {METHODS['paper']} leaves inverted or unproved, and in brackets the "
        "smallest scaled Jacobian of all; in the last column ours at .5.\n\n"
    )
    head = ("body", *(f"paper at {level:g}" for level in levels), "ours at 0.5")
    lines = [f"- {name}: {reason}\n" for name, reason in reasons.items()]
    return words + table(head, rows) + ("\n" if lines else "") + "".join(lines)


def _meshers(rivals: Sequence[Case], cases: Sequence[Case]) -> str:
    own = {(case["body"], case["w0_asked"]): case for case in cases}
    rows, absent = [], {}
    for case in rivals:
        if case.get("error"):
            absent[case["body"]] = _reason(case["error"])
            continue
        ours = own.get((case["body"], case["w0_asked"])) or {}
        rows.append(
            (
                case["body"], f"{case['thickness_asked']:.3g}",
                "" if not ours.get("elements") else
                f"{ours['valid']} of {ours['elements']} ({ours['min_scaled_jacobian']:.2f})",
                *(_layered(case["made"][who]) for who in ("netgen", "gmsh")),
            )
        )  # fmt: skip
    if not rows:
        return ""
    words = (
        f"{METHODS['netgen']} and {METHODS['gmsh']}, asked for two layers that are together as "
        "thick as our shell at .1 and at .5 in the mean, on about a thousand triangles. Prisms "
        "that are proved valid, of all: linear, then curved (second order), in brackets the mean "
        "thickness. Netgen is tried without and with `limit_growth_vectors`, the better answer "
        "counts.\n\n"
    )
    head = ("body", "thickness mm", "ours: elements (scaled Jacobian)", "Netgen", "Gmsh")
    lines = [f"- {body}: {reason}\n" for body, reason in absent.items()]
    return words + table(head, rows) + ("\n" if lines else "") + "".join(lines)


def _layered(one: Mapping[str, Any]) -> str:
    if not one["made"]:
        return f"no mesh: {one['error']}"
    cells = []
    for kind in ("linear", "curved"):
        figures = one.get(kind)
        bad = None if figures is None else figures["invalid"] + figures["undecided"]
        cells.append("-" if bad is None else f"{one['prisms'] - bad}")
    thickness = one.get("thickness") or {}
    mean = thickness.get("mean")
    return f"{', '.join(cells)} of {one['prisms']}" + ("" if mean is None else f" ({mean:.3g} mm)")


def _speed(found: Mapping[str, Any]) -> str:
    rows = []
    for case in [*found["cases"], *found["free"]]:
        if case["body"] == SPEED_BODY and case["w0_asked"] == 0.5 and not case.get("error"):
            rows.append(
                (
                    case["body"], case["mesher"], str(case["tets"]),
                    f"{case['seconds_before']['midstructure']:.1f}",
                    f"{case['seconds_stage'] - case['seconds']:.1f}", f"{case['seconds']:.1f}",
                    f"{case['seconds_stage']:.1f}", f"{case['seconds_stage_cpu']:.1f}",
                )
            )  # fmt: skip
    if not rows:
        return ""
    head = ("body", "mesher", "tetrahedra", "midstructure s", "field s", "shell s",
            "field and shell s", "of the processor s")  # fmt: skip
    return "Seconds on the wall at .5, beside another body:\n\n" + table(head, rows)


def _pictures(names: Sequence[str]) -> str:
    if not names:
        return ""
    return f"Beside this text the command writes {', '.join(f'`{name}`' for name in names)}.\n"


def _optional(value: float | None, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"
