# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Evening out: spans of the size, shape and turn that are asked, on the very same surface."""

from dataclasses import replace

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.even import (
    Evenness,
    even_as_needed,
    even_out,
    evening_figures,
    span_figures,
)
from HybridVolume.core.pipeline import Options, midstructure_stage
from HybridVolume.core.refinement import cut_spans, insert_knots, split_spans
from HybridVolume.core.strips import span_intervals
from HybridVolume.errors import InputError
from HybridVolume.report import evening_part


def moved(body, scale=1.0, origin=(0.0, 0.0, 0.0)):
    """A surface turned about an axis of its own, scaled, and put somewhere else."""
    turn, _ = np.linalg.qr(np.random.default_rng(6).normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    faces = [
        replace(face, control_points=scale * face.control_points @ turn.T + origin)
        for face in body.faces
    ]
    return build_surface(faces)


def same_points(one, other):
    line = np.linspace(0.0, 1.0, 7)
    u, v = (a.ravel() for a in np.meshgrid(line, line))
    patch = np.repeat(np.arange(len(one.patches)), len(u))
    u, v = (np.tile(a, len(one.patches)) for a in (u, v))
    return np.abs(one.evaluate_at(patch, u, v) - other.evaluate_at(patch, u, v)).max()


@pytest.mark.parametrize("body", [bodies.torus(), bodies.hollow_sphere(), bodies.plate(4.0, 2)])
@pytest.mark.parametrize("size", [0.9, 0.4])
def test_no_side_is_longer_than_asked(body, size):
    surface = build_surface(list(body.faces))
    even = even_out(surface, Evenness(size=size))
    figures = span_figures(even)
    assert figures.longest <= size * (1 + 1e-9)
    assert figures.spans > span_figures(surface).spans
    assert same_points(surface, even) < 1e-13 * surface.diagonal
    # not finer than need be: some side is longer than half of it
    assert figures.longest > 0.5 * size


@pytest.mark.parametrize(
    ("body", "rational"),
    [
        (bodies.torus(), True),
        (bodies.sphere(), True),
        (bodies.ring(), True),
        (bodies.l_bracket(), False),
        (bodies.wedge(), False),
    ],
)
@pytest.mark.parametrize(
    ("scale", "origin"), [(1e-3, (0, 0, 0)), (1e3, (0, 0, 0)), (1.0, (900.0, -700.0, 400.0))]
)
def test_the_surface_stays_as_it_is(body, rational, scale, origin):
    surface = moved(body, scale, origin)
    size = 0.4 * span_figures(surface).longest
    wanted = Evenness(size=size, aspect=3.0, turn=30.0)
    even = even_out(surface, wanted)
    assert even.element_count > surface.element_count
    # coordinates far from the origin have no more digits than these
    digits = np.finfo(float).eps * np.abs(surface.control_points).max()
    assert same_points(surface, even) < 1e-13 * surface.diagonal + 4 * digits
    # weights 1 stay 1: a patch that was no rational one is none now
    assert [p.rational for p in even.patches] == [rational] * len(even.patches)
    assert even.genus == surface.genus
    asked = evening_figures(wanted, surface, even)
    assert asked["asked"] == {"size": size, "aspect": 3.0, "turn": 30.0}
    assert asked["after"]["longest"] <= size * (1 + 1e-9) < asked["before"]["longest"]
    assert asked["after"]["turn"] <= 30.0


def test_hardly_more_spans_than_there_must_be():
    # a sixth of the unit sphere is pi / 2 wide between the middles of opposite sides: eight spans
    # of .2, and some more since its parameters run unevenly
    even = even_out(build_surface(list(bodies.sphere().faces)), Evenness(size=0.2))
    assert 6 * 8**2 <= even.element_count <= 6 * 10**2


def test_normals_turn_as_little_as_asked():
    # a quarter of the torus's tube turns by 90 degrees: eight spans of 11.25
    surface = build_surface(list(bodies.torus().faces))
    even = even_out(surface, Evenness(turn=12.0))
    assert 5.0 < span_figures(even).turn <= 12.0
    assert same_points(surface, even) < 1e-13 * surface.diagonal


def test_long_spans_become_rounder_and_nothing_else_is_cut():
    surface = build_surface(list(bodies.box((12.0, 1.0, 1.0), (1, 1, 1)).faces))
    assert span_figures(surface).aspect == pytest.approx(12.0)
    even = even_out(surface, Evenness(aspect=2.0))
    assert span_figures(even).aspect <= 2.0 + 1e-9
    # 12 is cut into six parts along the four long faces only
    assert span_figures(even).spans == 4 * 6 + 2
    assert even_out(even, Evenness(aspect=2.0)) is even
    # the ends are as they came, bit for bit
    assert sorted(even.exact) == [False] * 2 + [True] * 4


def test_a_plate_of_one_span_a_face_is_cut_from_its_narrow_faces():
    # 20 x 20 x 1: half of a strip's spans are narrow; five parts each way make them 4 x 1
    surface = build_surface(list(bodies.box((20.0, 20.0, 1.0), (1, 1, 1)).faces))
    even = even_out(surface, Evenness(aspect=4.0))
    figures = span_figures(even)
    assert figures.spans == 2 * 25 + 4 * 5
    assert figures.aspect == pytest.approx(4.0)


def test_very_long_spans_are_cut_without_being_asked():
    bar = build_surface(list(bodies.box((24.0, 1.0, 1.0), (1, 1, 1)).faces))
    shorter = even_as_needed(bar, Evenness())
    # 24 : 1 in three, which is 8 : 1
    assert span_figures(shorter).spans == 4 * 3 + 2
    assert span_figures(shorter).aspect == pytest.approx(8.0)
    assert same_points(bar, shorter) < 1e-13 * bar.diagonal
    assert even_as_needed(bar, Evenness(aspect=30.0)) is bar
    bar = build_surface(list(bodies.box((9.0, 1.0, 1.0), (1, 1, 1)).faces))
    assert even_as_needed(bar, Evenness()) is bar
    # a sheet of paper does not become thousands of spans
    sheet = build_surface(list(bodies.box((300.0, 200.0, 0.1), (1, 1, 1)).faces))
    assert even_as_needed(sheet, Evenness()).element_count <= 2 * 16 * 16 + 4 * 16


def test_a_few_narrow_spans_do_not_cut_the_rest():
    # 2 of 18 spans of each strip are narrow: cutting would make all the others so
    surface = build_surface(list(bodies.box((16.0, 16.0, 0.25), (8, 8, 1)).faces))
    assert span_figures(surface).aspect == pytest.approx(8.0)
    wanted = Evenness(aspect=4.0)
    assert even_out(surface, wanted) is surface
    # who asked is told that it stays
    said = evening_part(evening_figures(wanted, surface, surface))["sentence"]
    assert "asked: aspect to 4" in said and "aspect 8 (was 8)" in said and "half" in said


def test_spans_are_cut_along_their_strips():
    surface = build_surface(list(bodies.torus(spans=2).faces))
    intervals = span_intervals(surface)
    # two lines a patch: each runs round the torus the short or the long way
    parts = np.ones((surface.element_count, 2), dtype=int)
    parts[5, 1] = 3
    cut = cut_spans(surface, parts)
    # a strip of spans is three now
    number = intervals.of_span[5, 1]
    width = np.count_nonzero((intervals.of_span == number).any(axis=1))
    assert cut.element_count == surface.element_count + 2 * width
    assert same_points(surface, cut) < 1e-13 * surface.diagonal
    # each span knows the mean, the median and the largest of those beside it
    ones = np.ones((surface.element_count, 2))
    assert (intervals.mean(ones) == 1.0).all() and (intervals.largest(ones) == 1.0).all()
    assert (intervals.median(ones, ones > 0) == 1.0).all()
    assert (intervals.median(ones, ones < 0) == 0.0).all()


def test_knots_by_patch_and_by_span_are_the_same():
    surface = build_surface(list(bodies.ring(spans=2).faces))
    thirds = insert_knots(surface, lambda k, d: np.array([1 / 6, 1 / 3, 2 / 3, 5 / 6]))
    split = split_spans(surface, 3)
    assert thirds.control_points == pytest.approx(split.control_points, abs=1e-12)
    assert span_figures(split).spans == 9 * surface.element_count


def test_the_shells_needs_are_met_besides():
    surface = build_surface(list(bodies.torus().faces))
    stage = midstructure_stage(surface, Options(span_size=1.5, samples=1000))
    evening = stage.evening
    assert evening["asked"] == {"size": 1.5, "aspect": 0.0, "turn": 0.0}
    assert evening["before"]["spans"] == surface.element_count
    assert evening["after"]["spans"] == stage.surface.element_count > surface.element_count
    assert evening["after"]["longest"] <= 1.5 * (1 + 1e-9)
    assert stage.deviation < 1e-13 * surface.diagonal


def test_what_cannot_be_is_refused():
    surface = build_surface(list(bodies.torus().faces))
    with pytest.raises(InputError, match="more than"):
        even_out(surface, Evenness(size=1e-3))
    for wrong in ({"size": -1.0}, {"aspect": 1.5}, {"turn": 0.1}, {"size": np.inf}):
        with pytest.raises(InputError):
            Evenness(**wrong)
        with pytest.raises(InputError):
            Options(**{f"span_{name}": value for name, value in wrong.items()})
