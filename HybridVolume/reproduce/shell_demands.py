# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What is demanded of the shells, met or not by the figures alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from .shell_bodies import DEMANDS, LARGE_SHARE, RANDOM_ALLOWED, SECONDS, SPEED_BODY, Demand

UP_TO = 0.5
"""Levels up to which the mean has to be near the level asked."""

Row = dict[str, Any]


def demands(found: Mapping[str, Any]) -> list[Row]:
    """All demands.

    Parameters
    ----------
    found : mapping
        What shell.json holds.

    Returns
    -------
    list of dict
        ``body``, ``demand`` (text), ``figure`` (text), ``met`` (None where it was not measured).
    """
    rows: list[Row] = []
    for name, demand in DEMANDS.items():
        cases = [case for case in found["cases"] if case["body"] == name]
        if not cases:
            continue
        if demand.refused:
            rows.append(_refused(name, cases))
            continue
        unread = [case for case in cases if case.get("error") and "patches" not in case]
        if demand.if_read and unread:
            reason = unread[0]["error"]
            rows.append(
                {
                    "body": name,
                    "demand": "as the others, where the reader takes it",
                    "figure": f"refused by the reader ({reason['code']})",
                    "met": None,
                }
            )
            continue
        rows += [_proved(name, cases), _near(name, cases, demand), *_shape(name, cases, demand)]
        rows += [_large(name, cases)]
        shape = [case for case in found.get("shape_first", ()) if case["body"] == name]
        if demand.shapely and shape:
            rows.append(_shapely(name, shape[0], demand.shapely))
    rows += _random(found["cases"])
    rows += _speed([*found["cases"], *found.get("free", ())])
    return [row for row in rows if row]


def sound(case: Mapping[str, Any]) -> bool:
    """Whether a case has a shell that is proved and does not cut itself."""
    return bool(case["elements"]) and case["valid"] == case["elements"] and case["embedded"]


def _proved(name: str, cases: Sequence[Mapping[str, Any]]) -> Row:
    good = [case for case in cases if sound(case)]
    lost = [f"{case['w0_asked']:g}" for case in cases if not sound(case)]
    words = f"{len(good)} of {len(cases)} levels"
    return {
        "body": name,
        "demand": "every element proved, free of crossings",
        "figure": words + (f", not at {', '.join(lost)}" if lost else ""),
        "met": not lost,
    }


def _near(name: str, cases: Sequence[Mapping[str, Any]], demand: Demand) -> Row:
    asked = [case for case in cases if case["w0_asked"] <= UP_TO]
    if not asked:
        return {}
    off = {c["w0_asked"]: 1.0 - c["w0"] / c["w0_asked"] for c in asked if c["w0"] is not None}
    if not demand.thinner:
        off = {level: abs(share) for level, share in off.items()}
    worst = max(off, key=lambda level: off[level], default=None)
    if demand.thinner:
        words = f"mean level at least {1.0 - demand.near:g} of the level asked"
        figure = "" if worst is None else f"{1.0 - off[worst]:.2f} at {worst:g}"
    else:
        words = f"mean level within {100 * demand.near:g} % of the level asked"
        figure = "" if worst is None else f"{100 * off[worst]:.1f} % off at {worst:g}"
    return {
        "body": name,
        "demand": f"{words}, up to {UP_TO:g}",
        "figure": figure or "no shell",
        "met": len(off) == len(asked) and off[worst] <= demand.near,
    }


def _shape(name: str, cases: Sequence[Mapping[str, Any]], demand: Demand) -> list[Row]:
    case = next((c for c in cases if c["w0_asked"] == 0.5), None)
    if case is None or not (demand.least or demand.share):
        return []
    bound, found = case.get("bound"), case["min_scaled_jacobian"]
    if demand.share:
        if bound is None:
            return []
        least, words = demand.share * bound, f"{demand.share:g} of the bound {bound:.3f}"
    else:
        least, words = demand.least, f"{demand.least:g}"
    return [
        {
            "body": name,
            "demand": f"scaled Jacobian at .5 at least {words}",
            "figure": "no shell" if found is None else f"{found:.3f}",
            "met": found is not None and sound(case) and found >= least,
        }
    ]


def _large(name: str, cases: Sequence[Mapping[str, Any]]) -> Row:
    large = [case for case in cases if case["w0_asked"] in (0.7, 0.9)]
    if not large:
        return {}
    shares = {c["w0_asked"]: (c["w0"] or 0.0) / c["w0_asked"] for c in large}
    return {
        "body": name,
        "demand": f"at least {100 * LARGE_SHARE:g} % of the level at .7 and .9",
        "figure": ", ".join(f"{100 * share:.0f} % at {level:g}" for level, share in shares.items()),
        "met": all(share >= LARGE_SHARE for share in shares.values()),
    }


def _shapely(name: str, case: Mapping[str, Any], least: float) -> Row:
    found = case["min_scaled_jacobian"]
    return {
        "body": name,
        "demand": f"shape before level: scaled Jacobian at .5 at least {least:g}",
        "figure": "no shell"
        if found is None
        else f"{found:.3f} with a mean level {case['w0']:.2f}",
        "met": found is not None and sound(case) and found >= least,
    }


def _refused(name: str, cases: Sequence[Mapping[str, Any]]) -> Row:
    errors = [case.get("error") for case in cases]
    told = [error for error in errors if error and error["code"] == "singular-surface"]
    places = min((len(error["places"]) for error in told), default=0)
    return {
        "body": name,
        "demand": "refused as singular, with the places",
        "figure": f"{len(told)} of {len(cases)} refused, {places} places named",
        "met": len(told) == len(cases) and places > 0,
    }


def _random(cases: Sequence[Mapping[str, Any]]) -> list[Row]:
    asked = [c for c in cases if c.get("group") == "random" and c["w0_asked"] == 0.5]
    if not asked:
        return []
    lost = [case["body"] for case in asked if not sound(case)]
    return [
        {
            "body": f"{len(asked)} random",
            "demand": f"proved and free of crossings at .5, {RANDOM_ALLOWED} named exception",
            "figure": f"{len(asked) - len(lost)} of {len(asked)}"
            + (f"; not {', '.join(lost)}" if lost else ""),
            "met": len(lost) <= RANDOM_ALLOWED,
        }
    ]


def _speed(cases: Sequence[Mapping[str, Any]]) -> list[Row]:
    rows = []
    for case in cases:
        least = SECONDS.get(case.get("mesher", ""))
        if case["body"] != SPEED_BODY or case["w0_asked"] != 0.5 or not least:
            continue
        spent = case.get("seconds_stage_cpu")
        rows.append(
            {
                "body": case["body"],
                "demand": f"whole shell stage at .5 within {least:g} s with {case['mesher']}",
                "figure": "no shell" if spent is None else f"{spent:.1f} s of the processor",
                "met": spent is not None and spent <= least,
            }
        )
    return rows
