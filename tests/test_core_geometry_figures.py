# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What report.json tells of the faces of a body."""

import bodies
import numpy as np
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.geometry_figures import geometry_figures, with_moves
from HybridVolume.report import geometry_notes, input_part

KINDS = ("bit", "exact", "tolerance", "exact", "bit", "bit")


def figures(tolerance=0.01, inside=()):
    patches, area = [1, 4, 9, 2, 1, 1], [6, 3, 1, 2, 4, 4]
    deviation = [0, 0, 0.0012, 1e-16, 0, 0]
    return geometry_figures(KINDS, patches, deviation, area, tolerance, inside)


def test_counts_areas_and_words():
    found = figures()
    assert found["patches"] == 18 and found["max_deviation"] == 0.0012
    assert found["counts"] == {"bit": 3, "exact": 2, "tolerance": 1}
    assert found["area"] == pytest.approx({"bit": 0.7, "exact": 0.25, "tolerance": 0.05})
    assert found["sentence"] == (
        "6 faces: 3 bit for bit, 2 exact, 1 within 0.0012 mm; covered with 18 patches, 0.01 mm"
        " allowed"
    )
    assert [row["name"] for row in found["faces"]] == [f"Face{k}" for k in range(1, 7)]
    assert found["faces"][2] == {
        "name": "Face3", "kind": "tolerance", "patches": 9, "deviation": 0.0012, "area": 1.0
    }  # fmt: skip


def test_faces_inside_the_material_are_left_out():
    found = figures(inside=(0, 5))
    assert found["inside"] == ["Face1", "Face6"] and len(found["faces"]) == 4
    assert found["counts"] == {"bit": 1, "exact": 2, "tolerance": 1}
    assert found["area"]["bit"] == pytest.approx(0.4)
    assert found["sentence"].endswith("; 2 faces inside the material are left out")


def test_words_of_single_things_and_of_what_is_only_rounded():
    found = geometry_figures(
        ["exact", "exact", "tolerance"], [1, 0, 0], [3e-9, 0.0, 2e-9], [1.0, 1.0, 1.0], 0.01, (1,)
    )
    # the distance is that of the face within the tolerance
    assert found["sentence"] == (
        "2 faces: 1 exact, 1 within 2e-09 mm; covered with 1 patch, 0.01 mm allowed; 1 face inside"
        " the material is left out"
    )
    assert found["max_deviation"] == 3e-9


def test_faces_that_were_moved_are_not_kept():
    found = with_moves(figures(), {"Face5": 0.003, "Face3": 0.001})
    assert found["counts"] == {"bit": 2, "exact": 2, "tolerance": 2}
    assert found["faces"][4]["deviation"] == 0.003 == found["max_deviation"]
    assert found["faces"][2]["deviation"] == pytest.approx(0.0022)
    assert with_moves(figures(), {}) == figures()


def test_the_report_counts_faces_not_patches():
    """Two sides of a box are told apart by name, one of them has the points of another file."""
    box = bodies.box(spans=(1, 1, 1))
    surface = build_surface(list(box.faces))
    source = {"file": "x.step", "geometry": figures(tolerance=None)}
    found = input_part(source, surface)
    assert [found[f"faces_{kind}"] for kind in ("bit", "exact", "tolerance")] == [3, 2, 1]
    assert found["closed"] and geometry_notes(found) == []
    assert geometry_notes({"geometry": figures()}) == [figures()["sentence"]]
    off = list(box.faces)
    points = off[0].control_points + 1e-8 * np.ones(3)
    off[0] = type(off[0])(off[0].name, off[0].degrees, off[0].knots, points, off[0].weights)
    moved = input_part(source, build_surface(off))
    assert moved["faces_bit"] < 3 and moved["geometry"]["max_deviation"] >= 1e-9
