# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What of a midstructure is kept: the sliders, the decisions, and how they find their sheets."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from itertools import product
from time import process_time

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.midstructure import Decision, Midstructure, Sheet, medial_axis
from HybridVolume.core.midstructure.choice import (
    EDGE,
    REASONS,
    RIDGE,
    automatic,
    cell_sheets,
    find_sheets,
)
from HybridVolume.core.surface import PatchSurface
from HybridVolume.errors import InputError


def bracket(first: float = 3.0, second: float = 2.0, thick: float = 0.6) -> bodies.Body:
    """L of two plates, 2 mm wide."""
    t = thick
    quads = [
        [(0, 0), (t, 0), (t, t), (0, t)],
        [(t, 0), (first, 0), (first, t), (t, t)],
        [(0, t), (t, t), (t, second), (0, second)],
    ]
    volume = 2.0 * (t * first + t * (second - t))
    return bodies.prism(quads, 2.0, volume, name="bracket")


def two_faced() -> bodies.Body:
    """Voxels whose many patches belong to two CAD faces only."""
    body = bodies.bent_voxels(1)
    faces = [replace(face, name=f"Face{1 + k % 2}") for k, face in enumerate(body.faces)]
    return replace(body, faces=tuple(faces))


BODIES = {
    "box": lambda: bodies.box((4.0, 2.0, 1.0), (4, 2, 2)),
    "other box": lambda: bodies.box((5.0, 2.0, 1.2), (4, 2, 2)),
    "bracket": bracket,
    "other bracket": lambda: bracket(3.6, 1.8, 0.5),
    "cylinder": lambda: bodies.cylinder(1.0, 4.0),
    "wedge": bodies.wedge,
    "voxels": lambda: bodies.bent_voxels(1),
    "two-faced": two_faced,
}


@cache
def surface_of(name: str) -> PatchSurface:
    return build_surface(list(BODIES[name]().faces))


@cache
def axis_of(name: str, samples: int = 0, seed: int = 0) -> Midstructure:
    return medial_axis(surface_of(name), samples, seed=seed)


def moved(surface: PatchSurface, seed: int, scale: float, shift: float) -> PatchSurface:
    """The body turned at random, scaled, and moved away by so many diagonals."""
    points = surface.control_points @ turned(seed).T
    points = points + shift * surface.diagonal * np.array([0.6, -0.8, 1.0])
    return surface.with_points(scale * points)


def turned(seed: int) -> np.ndarray:
    """A random rotation."""
    turn = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return turn * np.sign(np.linalg.det(turn))


def kept_of(midstructure: Midstructure) -> list[int]:
    return [k for k, sheet in enumerate(midstructure.sheets) if sheet.kept]


def centre_of(midstructure: Midstructure, sheet: int) -> np.ndarray:
    facets = midstructure.sheet == sheet
    middle = midstructure.vertices[midstructure.facets[facets]].mean(axis=1)
    return np.average(middle, axis=0, weights=midstructure.facet_areas[facets])


# ------------------------------------------------------------------------------- decisions


@pytest.mark.parametrize("name", ["box", "bracket", "cylinder", "wedge", "voxels"])
def test_every_sheet_is_found_by_its_name(name):
    m = axis_of(name)
    assert len({sheet.name for sheet in m.sheets}) == len(m.sheets)
    for k, sheet in enumerate(m.sheets):
        alone = m.choose(decisions=[Decision.about("only", sheet.name)])
        assert kept_of(alone) == [k] and alone.unmatched == ()
        assert alone.sheets[k].reason == "kept by hand"
        gone = m.choose(decisions=[f"remove {sheet.name}"])
        assert not gone.kept[gone.sheet == k].any()
        others = gone.sheet != k
        assert np.array_equal(gone.kept[others], m.kept[others])
        assert gone.sheets[k].reason == "removed by hand"


def test_sheets_between_faces_of_many_patches_are_found_in_other_samples():
    first, second = axis_of("two-faced", 4000), axis_of("two-faced", 4000, seed=5)
    large = 0.02 * sum(sheet.area for sheet in first.sheets)
    names = [(k, sheet.name) for k, sheet in enumerate(first.sheets) if sheet.area > large]
    assert len(names) > 10
    for k, name in names:
        (found,) = find_sheets(second, Decision.about("only", name))
        off = np.linalg.norm(centre_of(second, found) - centre_of(first, k))
        assert off < 0.05 * surface_of("two-faced").diagonal


def test_choosing_changes_nothing_else():
    m = axis_of("bracket")
    removed = m.choose(decisions=[f"remove {m.sheets[0].name}"])
    again = removed.choose()
    assert np.array_equal(again.kept, m.kept) and again.sheets == m.sheets
    assert removed.vertices is m.vertices and removed.figures is m.figures
    assert [s.name for s in removed.sheets] == [s.name for s in m.sheets]


def test_later_decisions_go_over_earlier_ones():
    m = axis_of("box")
    centre, edge = m.sheets[0].name, m.sheets[1].name
    assert kept_of(m) == [0]
    assert kept_of(m.choose(decisions=[f"keep {edge}"])) == [0, 1]
    assert kept_of(m.choose(decisions=[f"keep {edge}", f"remove {edge}"])) == [0]
    assert kept_of(m.choose(decisions=[f"remove {centre}"])) == []
    assert kept_of(m.choose(decisions=[f"only {edge}"])) == [1]
    assert kept_of(m.choose(decisions=[f"only {edge}", f"keep {centre}"])) == [0, 1]
    assert kept_of(m.choose(decisions=[f"only {edge}", f"only {centre}"])) == [0, 1]
    assert kept_of(m.choose(decisions=[f"only {edge}", f"remove {edge}"])) == []


def test_the_order_of_the_faces_does_not_matter_without_a_place():
    m = axis_of("box")
    assert kept_of(m.choose(decisions=["remove Face5+Face6"])) == []
    assert kept_of(m.choose(decisions=["remove Face6+Face5"])) == []
    # with a place it is one on the first face
    assert kept_of(m.choose(decisions=["remove Face6+Face5@0.5,0.5"])) == []


def test_what_fits_no_sheet_is_listed():
    m = axis_of("box")
    # opposite faces whose sheet would be beyond the edges, an unknown face, a real sheet
    wrong = ["remove Face1+Face2", "only Face1+Face99@0.5,0.5"]
    chosen = m.choose(decisions=[*wrong, "keep Face1+Face3"])
    assert chosen.unmatched == tuple(wrong)
    assert len(kept_of(chosen)) == 2
    with pytest.raises(InputError):
        m.choose(decisions=["destroy Face1+Face2"])


def test_decisions_are_texts():
    for text in ("remove Face3+Face9@0.41,0.77", "keep Face1+Face2", "only Face10+Face2@0,1"):
        assert str(Decision.parse(text)) == text
    m = axis_of("voxels")
    decisions = [Decision.about("remove", sheet.name) for sheet in m.sheets[:7]]
    one = m.choose(decisions=decisions)
    two = m.choose(decisions=[str(d) for d in decisions])
    assert np.array_equal(one.kept, two.kept) and one.sheets == two.sheets


def test_a_kept_edge_sheet_stays_off_the_surface():
    m = axis_of("box")
    for k, sheet in enumerate(m.sheets[1:], 1):
        assert sheet.at_edge and "edge" in sheet.reason
        kept = m.choose(decisions=[f"only {sheet.name}"])
        radius = kept.radius[np.unique(kept.facets[kept.kept])]
        assert radius.min() > 0.4 * 0.5
        # it rises from the edge to the middle of the box: half of its width stays
        share = kept.facet_areas[kept.kept].sum() / m.facet_areas[m.sheet == k].sum()
        assert 0.3 < share < 0.8
    assert not m.sheets[0].at_edge


def test_sheets_without_figures():
    one = Sheet(("A", "B"), 1.0, (1.0, 1.0), (180.0, 180.0), True, "", (0, 0, 0), (0.1, 0.1))
    sheets = (one, replace(one, foot=(0.9, 0.9)), replace(one, faces=("C", "B")))
    m = Midstructure(
        np.zeros((3, 3)),
        np.array([[0, 1, 2], [0, 1, 1], [2, 2, 2]]),
        np.arange(3),
        np.zeros(3, dtype=bool),
        np.ones(3),
        sheets,
        method="own",
        faces=("A", "B", "C"),
    )
    assert m.choose().kept.tolist() == [True, True, True]
    assert m.choose(angle=179.0, minimum_size=1000.0).kept.all()
    assert m.choose(decisions=["remove B+A"]).kept.tolist() == [False, False, True]
    assert m.choose(decisions=["remove A+B@0.8,0.8"]).kept.tolist() == [True, False, True]
    assert m.choose(decisions=["only B+C"]).kept.tolist() == [False, False, True]
    assert m.choose(decisions=["only A+C"]).unmatched == ("only A+C",)
    again = m.choose(decisions=["remove A+B"]).choose()
    assert {sheet.reason for sheet in again.sheets} == {m.choose().sheets[0].reason}


# ------------------------------------------------------------------- decisions find again


@pytest.mark.parametrize(("first", "second"), [("box", "other box"), ("bracket", "other bracket")])
def test_names_find_their_sheet_in_a_changed_body(first, second):
    one, two = axis_of(first), axis_of(second)
    size = [np.ptp(surface_of(name).control_points, axis=0) for name in (first, second)]
    big = [k for k, sheet in enumerate(one.sheets) if sheet.area > 0.02 * one.sheets[0].area]
    assert len(big) >= 13
    for k in big:
        (found,) = kept_of(two.choose(decisions=[f"only {one.sheets[k].name}"]))
        assert sorted(two.sheets[found].faces) == sorted(one.sheets[k].faces)
        # at the same place of the body
        place = [centre_of(m, n) / s for m, n, s in ((one, k, size[0]), (two, found, size[1]))]
        assert np.abs(place[0] - place[1]).max() < 0.15


@pytest.mark.parametrize("name", ["bracket", "voxels"])
def test_names_find_their_sheet_in_other_samples(name):
    one = axis_of(name)
    same = np.eye(3)
    others = [
        (axis_of(name, 6000, 1), same),
        (medial_axis(moved(surface_of(name), 3, 1e3, 0.0)), 1e3 * turned(3)),
    ]
    big = [k for k, sheet in enumerate(one.sheets) if sheet.area > 0.1 * one.sheets[0].area]
    for (two, turn), k in product(others, big):
        sheet = one.sheets[k]
        (found,) = kept_of(two.choose(decisions=[f"only {sheet.name}"]))
        assert two.sheets[found].at_edge == sheet.at_edge
        # the seed lies on it
        size = np.cbrt(np.linalg.det(turn))
        middle = two.vertices[two.facets[two.sheet == found]].mean(axis=1)
        away = np.linalg.norm(middle - turn @ sheet.seed, axis=1).min()
        assert away < 0.3 * size * sheet.radius[1]


# --------------------------------------------------------------------------------- sliders


@pytest.mark.parametrize("name", ["box", "bracket", "wedge", "voxels"])
def test_sliders_only_take_away(name):
    m = axis_of(name)
    ridge = REASONS.index(RIDGE)
    for values in (
        [(angle, 1.0) for angle in (60.0, 90.0, 120.0, 140.0, 160.0, 178.0)],
        [(125.0, size) for size in (0.0, 0.3, 1.0, 3.0, 10.0, 100.0)],
    ):
        before = np.ones(len(m.figures.area), dtype=bool)
        for angle, size in values:
            code = automatic(m.figures, angle, size)
            kept = code < REASONS.index(EDGE)
            assert kept.any()
            # but for the ridges, which stand in where everything else is gone
            plain = kept & (code != ridge)
            assert not (plain & ~before).any()
            before = plain
    assert [s.name for s in m.choose(angle=178.0).sheets] == [s.name for s in m.sheets]


def test_decisions_win_over_sliders():
    m = axis_of("box")
    centre = m.sheets[0].name
    for value in ({"angle": 179.0}, {"minimum_size": 1000.0}):
        assert kept_of(m.choose(decisions=[f"only {centre}"], **value)) == [0]
        assert 0 not in kept_of(m.choose(decisions=[f"remove {centre}"], **value))


def test_choosing_is_quick():
    m = axis_of("voxels", 20000)
    decisions = [f"remove {sheet.name}" for sheet in m.sheets[:20]]
    begin = process_time()
    for _ in range(3):
        m.choose(angle=110.0, decisions=decisions)
    assert (process_time() - begin) / 3 < 0.2


def test_figures_agree_with_facets():
    m = axis_of("bracket")
    figures = m.figures
    cells = len(figures.area)
    area = np.bincount(figures.of_facet, m.facet_areas, cells)
    assert figures.area == pytest.approx(area)
    assert figures.edges.max() < cells and len(figures.edge) == len(figures.edges)
    sheet = cell_sheets(m)
    assert np.array_equal(sheet[figures.of_facet], m.sheet)
    assert [s.area for s in m.sheets] == pytest.approx(np.bincount(sheet, figures.area))
    assert all(a.area >= b.area for a, b in zip(m.sheets[:-1], m.sheets[1:], strict=True))
    # a foot is where the surface is, about as far from the cell as its radius
    surface = surface_of("bracket")
    some = np.arange(0, cells, max(1, cells // 60))
    for side, k in product((0, 1), some):
        u, v = figures.foot[k, side]
        x = surface.evaluate(figures.patch[k, side], np.array([u]), np.array([v]))[0]
        distance = np.linalg.norm(x - figures.centre[k])
        assert abs(distance - figures.radius[k]) < 2.0 * figures.spacing[k]


def test_probes_know_the_thickness():
    m = axis_of("bracket")
    assert len(m.probe_points) == len(m.probe_radius) == len(m.probe_patch)
    x, t = m.probe_points, 0.6
    plates = (x[:, 0] > 1.2) | (x[:, 1] > 1.2)
    assert plates.sum() > 500
    # also beside the edges, where the balls that fit are small
    assert np.abs(m.probe_radius[plates] / (0.5 * t) - 1.0).max() < 0.2
    assert np.median(m.probe_radius[plates]) == pytest.approx(0.5 * t, rel=0.01)
