# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Tables as Markdown, and those of ``./run.sh reproduce midstructure``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

NAMED = 20
"""Cases that are named where they are not done; of more only their number is told."""


def as_markdown(found: Mapping[str, Sequence[Mapping[str, Any]]]) -> str:
    """The tables of all parts that were made."""
    parts = []
    if found.get("bodies"):
        parts.append("## Automatic midstructures\n\n" + _bodies(found["bodies"]))
    if found.get("exact"):
        parts.append("## Bodies whose midstructure is known\n\n" + _exact(found["exact"]))
    if found.get("timing"):
        parts.append("## Time\n\n" + timing(found["timing"]))
    return "\n".join(parts)


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table of Markdown with columns of even width."""
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    lines = [
        "| " + " | ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)) + " |"
        for row in (head, *rows)
    ]
    lines.insert(1, "|" + "|".join("-" * (width + 2) for width in widths) + "|")
    return "\n".join(lines) + "\n"


def _bodies(rows: Sequence[Mapping[str, Any]]) -> str:
    head = (
        "body", "faces", "genus", "sheets", "kept", "area mm²", "midstructure s", "all s",
        "w0 asked", "reached", "largest", "elements proved", "thinnest mm (hint)",
        "thickest mm (hint)", "hints",
    )  # fmt: skip
    made = [_body(row) for row in rows if row["state"] == "shell"]
    text = table(head, made) if made else ""
    others = [row for row in rows if row["state"] != "shell"]
    if others:
        text += "\n" + "\n".join(_refusal(row) for row in others) + "\n"
    return text


def _body(row: Mapping[str, Any]) -> tuple[str, ...]:
    middle, w0, thick, told = row["midstructure"], row["w0"], row["thickness"], row["hints"]
    return (
        row["name"],
        str(row["faces"]),
        ", ".join(str(g) for g in row["genus"]),
        str(middle["sheets"]),
        str(middle["kept"]),
        f"{middle['area']:.4g}",
        f"{row['seconds']['midstructure']:.1f}",
        f"{row['seconds']['total']:.0f}",
        f"{w0['asked']:.2f}",
        f"{w0['reached']:.2f}",
        f"{w0['largest']:.2f}",
        f"{row['elements']['proved']} of {row['elements']['all']}",
        f"{thick['min']:.3g} ({told['thinnest']:.3g})",
        f"{thick['max']:.3g} ({told['thickest']:.3g})",
        _told(told),
    )


def _told(told: Mapping[str, Any]) -> str:
    words = [] if told["pieces"] == 1 else [f"{told['pieces']} pieces"]
    for region in told["unreached"]:
        faces = region["faces"]
        shown = ", ".join(faces[:3]) + (f" and {len(faces) - 3} more" if len(faces) > 3 else "")
        words.append(f"not reached: {shown}")
    return "; ".join(words)


def _refusal(row: Mapping[str, Any]) -> str:
    error = row["error"]
    faces = ", ".join(error["faces"][:4]) + (" ..." if len(error["faces"]) > 4 else "")
    reason = f"{faces}: {error['message']}" if faces else error["message"]
    return f"- {row['name']} ({row['state']}): {reason}"


def _exact(rows: Sequence[Mapping[str, Any]]) -> str:
    head = (
        "body", "kind", "place", "kept", "area mm²", "exact", "off by", "length mm", "exact",
        "off its place, of half the thickness", "w0 reached", "largest", "elements proved",
        "all s",
    )  # fmt: skip
    made = [_known(row) for row in rows if row["state"] == "shell"]
    text = table(head, made) if made else ""
    others = [_refusal(row) for row in rows if row["state"] != "shell"]
    return text + ("\n" + "\n".join(others) + "\n" if others else "")


def _known(row: Mapping[str, Any]) -> tuple[str, ...]:
    exact, middle, w0 = row["exact"], row["midstructure"], row["w0"]
    share = exact["off_max"] / exact["half_thickness"]
    return (
        row["name"].removeprefix("exact-"),
        middle["method"],
        exact["place"],
        f"{middle['kept']} of {middle['sheets']}",
        f"{exact['area']:.5g}",
        _figure(exact["area_exact"]),
        _error(exact["area"], exact["area_exact"]),
        _figure(exact["length"]),
        _figure(exact["length_exact"]),
        f"{share:.1e}",
        f"{w0['reached']:.2f}",
        f"{w0['largest']:.2f}",
        f"{row['elements']['proved']} of {row['elements']['all']}",
        f"{row['seconds']['total']:.0f}",
    )


def _figure(value: float | None) -> str:
    return "" if value is None else f"{value:.5g}"


def _error(found: float, exact: float | None) -> str:
    return "" if not exact else f"{100.0 * (found / exact - 1.0):+.2f} %"


def timing(rows: Sequence[Mapping[str, Any]]) -> str:
    """Seconds, a line each."""
    lines = [
        f"- {row['body']}: medial axis of {row['samples'] / 1000:g}k samples: "
        f"{_spent(row, 'medial_axis', 2)}; choose(): {_spent(row, 'choose', 3)}; hints(): "
        f"{_spent(row, 'hints', 3)} ({row['facets']} facets, {row['sheets']} sheets)"
        for row in rows
    ]
    return "\n".join(lines) + "\n"


def _spent(row: Mapping[str, Any], what: str, digits: int) -> str:
    return f"{row[what]:.{digits}f} s ({row[f'{what}_cpu']:.{digits}f} s of the processor)"


def made_on(found: Mapping[str, Any], several: str) -> str:
    """Where and when figures were made, and what is missing.

    Parameters
    ----------
    found : mapping
        With ``machine``, ``missing`` and ``not_done``.
    several : str
        What was done side by side: "cases", "bodies".
    """
    machine = found["machine"]
    lines = [
        f"Made on {machine['processor']}, {machine['cores']} cores, two {several} side by side with"
        f" one thread each, Python {machine['python']}."
    ]
    if found["missing"]:
        lines += ["", "Not measured, since their files were not there (`--data` names a folder): "
                  f"{', '.join(found['missing'])}."]  # fmt: skip
    left = found["not_done"]
    if left:
        names = ", ".join(left) if len(left) <= NAMED else f"{len(left)} cases"
        lines += ["", f"Not done yet: {names}."]
    return "\n".join(lines) + "\n"


def demand_table(
    rows: Sequence[Mapping[str, Any]],
    head: str = "case",
    *,
    shown: Sequence[Mapping[str, Any]] | None = None,
    more: str = "",
) -> str:
    """What is demanded and whether it is met, with a sentence that counts; empty without rows.

    Parameters
    ----------
    rows : sequence of mapping
        With ``demand``, ``figure``, ``met`` (None where it was not asked) and the head's key.
    head : str
        Key and head of the first column.
    shown : sequence of mapping, optional
        Those of them that stand in the table; all otherwise.
    more : str
        Further words beside the count.
    """
    if not rows:
        return ""
    shown = rows if shown is None else shown
    words = {True: "met", False: "**not met**", None: "not asked"}
    asked = [row for row in rows if row["met"] is not None]
    met = sum(bool(row["met"]) for row in asked)
    return (
        f"{met} of {len(asked)} demands are met; the words in the last column come from the "
        f"figures.{more}\n\n"
        + table(
            (head, "demand", "figure", ""),
            [(row[head], row["demand"], row["figure"], words[row["met"]]) for row in shown],
        )
    )
