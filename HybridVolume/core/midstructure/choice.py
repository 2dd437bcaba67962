# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Which facets of a midstructure are kept: an automatic rule first, then the user's decisions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from .cells import NOISE_SQUARES, OPPOSITE, RESOLVED
from .sheets import Decision, Figures, Midstructure

# Share of the largest radius of its sheet from which on a facet in an acute edge is kept.
ACUTE_SHARE = 0.5
# The same for a facet of a sheet that the user keeps: rims stay away from the surface.
KEPT_SHARE = 0.5
# Nothing is kept within this share of the radius: a part of the body has no midstructure.
REACH = 0.3
# As many of the nearest cells tell which sheet a foot belongs to.
NEAREST = 9
# A foot nearer than this is the very one that a sheet is named after.
SAME_FOOT = 2e-6

BETWEEN = "between opposite faces"
ACUTE = "inside an acute edge, its thick part"
RIDGE = "ridge of a part without another sheet"
EDGE = "runs into a convex edge"
NARROW = "its faces do not lie opposite each other"
SMALL = "too small"
BY_HAND = "kept by hand"
REMOVED = "removed by hand"

REASONS = (BETWEEN, ACUTE, RIDGE, EDGE, NARROW, SMALL)
AUTOMATIC = {
    "skeleton": "along the middle",
    "distance": "at the chosen depth",
    "own": "given by the user",
}
"""Why sheets of the other methods are kept."""


def choose(
    midstructure: Midstructure,
    angle: float,
    minimum_size: float,
    decisions: Sequence[Decision | str],
) -> Midstructure:
    """See :meth:`Midstructure.choose`."""
    parsed = [Decision.parse(d) if isinstance(d, str) else d for d in decisions]
    count = len(midstructure.sheets)
    figures = midstructure.figures
    if figures is None:
        kept = np.ones(len(midstructure.facets), dtype=bool)
        solid = kept
        reasons = [_plain_reason(midstructure, sheet.reason) for sheet in midstructure.sheets]
    else:
        code = automatic(figures, angle, minimum_size)
        cell_kept = code < REASONS.index(EDGE)
        kept = cell_kept[figures.of_facet]
        sheet_of_cell = cell_sheets(midstructure)
        solid = _solid(figures, sheet_of_cell, count)[figures.of_facet]
        reasons = _dominant(code, cell_kept, figures.area, sheet_of_cell, count)
    kept, reasons, unmatched = _decide(midstructure, parsed, kept, solid, reasons)
    any_kept = np.zeros(count, dtype=bool)
    any_kept[midstructure.sheet[kept]] = True
    sheets = tuple(
        replace(sheet, kept=bool(any_kept[k]), reason=reasons[k])
        for k, sheet in enumerate(midstructure.sheets)
    )
    return replace(midstructure, kept=kept, sheets=sheets, unmatched=unmatched)


def _plain_reason(midstructure: Midstructure, reason: str) -> str:
    """Reason of a sheet that is kept because all are."""
    named = AUTOMATIC.get(midstructure.method)
    return named or (BETWEEN if reason in (BY_HAND, REMOVED) else reason)


# ----------------------------------------------------------------------------- decisions


def _decide(
    midstructure: Midstructure,
    decisions: Sequence[Decision],
    kept: np.ndarray,
    solid: np.ndarray,
    reasons: list[str],
) -> tuple[np.ndarray, list[str], tuple[str, ...]]:
    """Apply decisions in their order to what is kept automatically."""
    if not decisions:
        return kept, reasons, ()
    kept, reasons = kept.copy(), list(reasons)
    found = [find_sheets(midstructure, decision) for decision in decisions]
    meant = [sheets for sheets, d in zip(found, decisions, strict=True) if d.action != "remove"]
    if any(d.action == "only" and len(s) for d, s in zip(decisions, found, strict=True)):
        others = np.setdiff1d(np.arange(len(reasons)), np.concatenate(meant))
        kept[np.isin(midstructure.sheet, others)] = False
        for k in others:
            reasons[k] = REMOVED
    unmatched = []
    for decision, sheets in zip(decisions, found, strict=True):
        if not len(sheets):
            unmatched.append(str(decision))
            continue
        facets = np.isin(midstructure.sheet, sheets)
        if decision.action == "remove":
            kept[facets] = False
        else:
            kept[facets & solid] = True
        for k in sheets:
            reasons[k] = REMOVED if decision.action == "remove" else BY_HAND
    return kept, reasons, tuple(unmatched)


def find_sheets(midstructure: Midstructure, decision: Decision) -> np.ndarray:
    """Numbers of the sheets that a decision is about; none where none fits.

    With a place: the sheet around the nearest foot on ``faces[0]`` of a cell between the two
    faces. Without one: every sheet mostly between them, else the one with the most cells there.
    """
    pair = sorted(decision.faces)
    sheets = midstructure.sheets
    same = np.array([k for k, s in enumerate(sheets) if sorted(s.faces) == pair], dtype=np.int64)
    figures = midstructure.figures
    if decision.at is None and len(same):
        return same
    if figures is None:
        if decision.at is None or len(same) < 2:
            return same
        return same[[_nearest_sheet(midstructure, same, decision)]]
    names, number = np.unique(np.asarray(midstructure.faces), return_inverse=True)
    wanted = np.searchsorted(names, decision.faces)
    if (wanted >= len(names)).any() or (names[wanted] != decision.faces).any():
        return same[:0]
    ends = number.ravel()[figures.patch]
    sheet_of_cell = cell_sheets(midstructure)
    fits = [(ends[:, side] == wanted[0]) & (ends[:, 1 - side] == wanted[1]) for side in (0, 1)]
    if decision.at is None:
        votes = np.bincount(sheet_of_cell[fits[0] | fits[1]], minlength=len(sheets))
        return np.array([votes.argmax()]) if votes.any() else same[:0]
    cell = np.concatenate([np.flatnonzero(fit) for fit in fits])
    if not len(cell):
        return cell
    foot = np.concatenate([figures.foot[fit, side] for side, fit in enumerate(fits)])
    patches = midstructure.faces.count(decision.faces[0])
    return np.array([_around(figures, sheet_of_cell, cell, foot - decision.at, patches)])


def _around(
    figures: Figures, sheet_of_cell: np.ndarray, cell: np.ndarray, offset: np.ndarray, patches: int
) -> int:
    """Sheet of the cells whose feet are nearest to a place: the area votes, a foot itself wins.

    The patches of a face stand side by side along u, which is as much narrower.
    """
    very = np.linalg.norm(offset, axis=1) < SAME_FOOT
    if very.any():
        return int(sheet_of_cell[cell[very]].min())
    nearest = np.argsort(np.linalg.norm(offset * [patches, 1], axis=1), kind="stable")[:NEAREST]
    near = cell[nearest]
    votes = np.bincount(sheet_of_cell[near], figures.area[near])
    return int(votes.argmax()) if votes.any() else int(sheet_of_cell[near[0]])


def _nearest_sheet(midstructure: Midstructure, same: np.ndarray, decision: Decision) -> int:
    """Place in ``same`` of the sheet whose own foot is nearest."""
    sheets = [midstructure.sheets[k] for k in same]
    away = [
        np.hypot(s.foot[0] - decision.at[0], s.foot[1] - decision.at[1])
        if s.faces[0] == decision.faces[0]
        else np.inf
        for s in sheets
    ]
    return int(np.argmin(away))


def cell_sheets(midstructure: Midstructure) -> np.ndarray:
    """Sheet of every cell of a medial axis, (c,)."""
    figures = midstructure.figures
    sheet = np.zeros(len(figures.area), dtype=np.int64)
    sheet[figures.of_facet] = midstructure.sheet
    return sheet


def _solid(figures: Figures, sheet: np.ndarray, count: int) -> np.ndarray:
    """Cells that are kept when the user keeps their sheet: no rim that nears the surface."""
    largest = np.zeros(count)
    np.maximum.at(largest, sheet, figures.radius)
    opposite = (figures.angle > OPPOSITE) & ~figures.wedge
    return opposite | (figures.radius >= KEPT_SHARE * largest[sheet])


def _dominant(
    code: np.ndarray, kept: np.ndarray, area: np.ndarray, sheet: np.ndarray, count: int
) -> list[str]:
    """What decided for most of each sheet's kept cells, or of all where none is kept."""
    has = np.bincount(sheet[kept], minlength=count) > 0
    use = kept | ~has[sheet]
    # cells without area count a little, so that lines have a reason as well
    weight = area[use] + 1e-12 * area.max() + np.finfo(float).tiny
    key = sheet[use] * len(REASONS) + code[use]
    votes = np.bincount(key, weight, count * len(REASONS)).reshape(count, -1)
    return [REASONS[k] for k in votes.argmax(axis=1)]


# ------------------------------------------------------------------------- automatic rule


def automatic(figures: Figures, angle: float, minimum_size: float) -> np.ndarray:
    """Number in :data:`REASONS` for every cell; those before ``EDGE`` are kept.

    A larger angle or size keeps a part of what a smaller one keeps, except for the ridges: parts
    of the body that would be left with nothing keep the cells of their largest balls.
    """
    wedge, group, radius = figures.wedge, figures.group, figures.radius
    wide = figures.angle > angle
    code = np.where(wedge, REASONS.index(EDGE), REASONS.index(NARROW)).astype(np.int8)
    between = wide & ~wedge
    code[between] = REASONS.index(BETWEEN)

    acute = wide & wedge
    if acute.any():
        part = components(figures, wedge, group, manifold=True)
        largest = np.zeros(len(part))
        np.maximum.at(largest, part[wedge], radius[wedge])
        acute &= _enough(components(figures, acute, group), acute, _squares(figures))
        thick = acute & (radius > ACUTE_SHARE * largest[part])
        code[thick] = REASONS.index(ACUTE)
    else:
        thick = acute

    kept = between | thick
    large = kept & _enough(components(figures, kept, group), kept, _squares(figures))
    # a part smaller than its own distance from the surface does not divide the body: it is what
    # remains of an edge sheet near a corner. Squares of the radius are local: a thin region keeps
    # its sheet beside a thick one
    whole = components(figures, large, np.zeros(len(large), dtype=np.int8))
    size = figures.area / radius**2
    good = large & (np.bincount(whole[large], size[large], len(large)) >= minimum_size)[whole]
    code[kept & ~good] = REASONS.index(SMALL)
    # the thin part of an acute edge is left out on purpose
    code[_lonely_ridges(figures, good, good | acute)] = REASONS.index(RIDGE)
    if not (code < REASONS.index(EDGE)).any():
        code[radius >= (1.0 - 1e-9) * radius.max()] = REASONS.index(RIDGE)
    return code


def components(
    figures: Figures, use: np.ndarray, label: np.ndarray, *, manifold: bool = False
) -> np.ndarray:
    """Number of the connected part of each cell over sides between used cells of equal label.

    With ``manifold`` only over sides where just two of all cells meet.
    """
    a, b = figures.edges.T
    joined = use[a] & use[b] & (label[a] == label[b])
    if manifold:
        joined &= np.bincount(figures.edge, minlength=1)[figures.edge] == 1
    n = len(use)
    ones = np.ones(int(joined.sum()), dtype=np.int8)
    graph = coo_matrix((ones, (a[joined], b[joined])), shape=(n, n))
    return connected_components(graph, directed=False)[1]


def _squares(figures: Figures) -> np.ndarray:
    """Area of the cells in squares of the sample spacing."""
    return figures.area / figures.spacing**2


def _enough(part: np.ndarray, use: np.ndarray, squares: np.ndarray) -> np.ndarray:
    """Whether each cell belongs to a part of more than a few squares of the sample spacing."""
    return (np.bincount(part[use], squares[use], len(part)) > NOISE_SQUARES)[part]


def _lonely_ridges(figures: Figures, kept: np.ndarray, covered: np.ndarray) -> np.ndarray:
    """Cells of the largest balls around, where no covered cell is within reach of their radius."""
    ridge = figures.ridge & ~kept
    if not kept.any():
        return ridge & ~covered if (ridge & ~covered).any() else ridge
    some = np.flatnonzero(ridge & (figures.radius > RESOLVED * figures.spacing))
    tree = cKDTree(figures.centre[covered], balanced_tree=False)
    reach = REACH * figures.radius[some]
    distance = tree.query(figures.centre[some], distance_upper_bound=reach.max(initial=0.0))[0]
    result = np.zeros(len(ridge), dtype=bool)
    result[some[distance > reach]] = True
    return result
