# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The whole way on bodies with known figures, judged by other means than the code's own."""

from __future__ import annotations

import bodies
import numpy as np
import pytest
import variants

from HybridVolume import report
from HybridVolume.core import growth, pipeline
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.pipeline import Options, complete
from HybridVolume.errors import (
    HybridVolumeError,
    InputError,
    SelfIntersectionError,
    ThicknessError,
)

CASES = {
    "box": (bodies.box(spans=(6, 4, 2)), 0.45),
    "torus": (bodies.torus(), 0.45),
    "hollow sphere": (bodies.hollow_sphere(), 0.45),
    "l bracket": (bodies.l_bracket(), 0.42),
    "ring": (bodies.ring(), 0.42),
    "bent voxels": (bodies.bent_voxels(1, 2), 0.42),
}


@pytest.fixture(scope="module", params=list(CASES))
def case(request):
    body, least = CASES[request.param]
    return body, least, complete(build_surface(list(body.faces)), Options(w0=0.5))


def test_parts_add_up_to_the_known_volume(case):
    body, _, volume = case
    parts = volume.shell.volume() + volume.interior.volume + volume.gap_volume
    assert parts == pytest.approx(body.volume, rel=1e-9)
    assert tuple(volume.surface.genus) == tuple(body.genus)


def test_every_element_is_proved_and_no_sample_disagrees(case):
    body, _, volume = case
    certificate = volume.certificate
    assert certificate.valid == len(certificate) == volume.shell.element_count
    # an independent look: signs of det J at random places, from the evaluation of the shell
    rng = np.random.default_rng(11)
    for k in range(len(volume.surface.patches)):
        u, v, w = rng.uniform(size=(3, 400))
        _, x_u, x_v, x_w = volume.shell.evaluate(k, u, v, w, 1)
        det = np.einsum("mi,mi->m", np.cross(x_v, x_u), x_w)
        assert det.min() > 0.0, volume.surface.patches[k].face


def test_the_level_asked_is_reached(case):
    _, least, volume = case
    assert volume.shell.w0 >= least
    assert volume.shell.embedded
    assert volume.interior.boundary_exact


def test_outer_layer_is_the_refined_input_bit_for_bit(case):
    _, _, volume = case
    assert np.array_equal(volume.shell.layers[0], volume.surface.control_points)
    assert volume.report["boundary_deviation"] <= 1e-13 * volume.surface.diagonal


def test_boundary_nodes_of_the_mesh_lie_on_the_surface():
    body = bodies.sphere(radius=2.0)
    volume = complete(build_surface(list(body.faces)))
    outer = volume.fem.nodes[np.unique(volume.fem.boundary)]
    assert np.abs(np.linalg.norm(outer, axis=1) - 2.0).max() < 1e-12
    # thickness of a ball's shell is the same all round
    thickness = volume.shell.thickness()
    assert np.ptp(thickness) < 0.12 * thickness.mean()


def test_columns_of_mirror_images_mirror():
    """The cube has no preferred corner: neither may its shell, beyond the field's mesh."""
    volume = complete(build_surface(list(bodies.box((2.0, 2.0, 2.0), (4, 4, 4)).faces)))
    thickness = volume.shell.thickness()
    centre = np.array([1.0, 1.0, 1.0])
    corners = np.abs(volume.surface.control_points - centre).min(axis=1) > 0.999
    assert corners.sum() == 8
    assert np.ptp(thickness[corners]) < 0.15 * thickness[corners].mean()


def test_stages_are_told_in_order():
    told = []
    body = bodies.box(spans=(3, 2, 1))
    complete(
        build_surface(list(body.faces)),
        Options(w0=0.3, layers=1),
        lambda stage, share, text: told.append((stage, share)),
    )
    shares = [share for _, share in told]
    assert shares == sorted(shares)
    assert list(dict.fromkeys(stage for stage, _ in told)) == [
        "surface", "midstructure", "field", "shell", "interior",
    ]  # fmt: skip


def test_layers_and_degree_are_what_was_asked():
    body = bodies.box(spans=(3, 2, 1))
    volume = complete(build_surface(list(body.faces)), Options(w0=0.3, layers=4, degree=2, order=1))
    assert volume.shell.layer_count == 4
    assert volume.shell.degree_w == 2
    assert volume.fem.order == 1
    assert len(volume.shell.layers) == 4 + 2


def test_thickness_and_first_layer_in_mm():
    surface = build_surface(list(bodies.box(spans=(6, 4, 2)).faces))
    options = Options(thickness="0.2 mm", face_factors={"Face1": 0.5}, spacing="0.03 mm", layers=3)
    shell = complete(surface, options).shell
    w = np.arange(4) / 3.0
    for k, thick in ((0, 0.1), (1, 0.2)):
        x = shell.evaluate(k, np.full(4, 0.5), np.full(4, 0.5), w)
        heights = np.linalg.norm(np.diff(x, axis=0), axis=1)
        assert heights[0] == pytest.approx(0.03, rel=0.05)
        assert heights.sum() == pytest.approx(thick, rel=0.35 if k == 0 else 0.12)


@pytest.mark.parametrize(
    "values", [{"thickness": "2 inch"}, {"face_factors": {"Face1": 0.0}}, {"spacing": "thin"}]
)
def test_thicknesses_that_make_no_sense_are_refused_before_any_work(values):
    with pytest.raises(InputError):
        Options(**values)


@pytest.mark.parametrize(
    "values",
    [
        *({"w0": 0.0}, {"w0": 1.5}, {"layers": 0}, {"order": 3}, {"nodes": "gauss"}),
        *({"tolerance": 1.0}, {"samples": 10}, {"angle": 20.0}),
    ],
)
def test_values_out_of_range_are_refused(values):
    with pytest.raises(InputError) as refusal:
        Options(**values)
    assert next(iter(values)) in refusal.value.line
    assert "choose" in refusal.value.remedy


@pytest.mark.parametrize(
    "values",
    [{"midstructure": "magic"}, {"depth": "0"}, {"decisions": ["drop A+B"]}, {"minimum_size": -1}],
)
def test_searches_that_make_no_sense_are_refused(values):
    with pytest.raises(InputError):
        Options(**values)


def plain_box():
    """4 x 2 x 1; its middle sheet has the area (4 - 1) (2 - 1)."""
    return build_surface(list(bodies.box((4.0, 2.0, 1.0), (4, 2, 1)).faces))


def test_all_goals_go_by_the_same_midstructure():
    surface, options = plain_box(), Options(samples=4000, w0=0.5)
    stage = pipeline.midstructure_stage(surface, options)
    assert stage.midstructure.area == pytest.approx(3.0, rel=0.01)
    assert stage.surface.volume() == pytest.approx(8.0)
    again, _, figures = pipeline.thickness(surface, options)
    assert np.array_equal(again.midstructure.vertices, stage.midstructure.vertices)
    # half the way to the middle, and less where the corners round the level off
    assert 0.2 < figures["min"] <= 0.27 and figures["max"] < 1.0
    assert [part["face"] for part in figures["faces"]] == [p.face for p in surface.patches]
    volume = complete(surface, Options(samples=4000, w0=0.3, decisions=("keep FaceX+FaceY",)))
    assert np.array_equal(volume.midstructure.vertices, stage.midstructure.vertices)
    assert volume.report["search"]["decided"] == ["keep FaceX+FaceY"]
    told = report.volume_report(volume, {}, {})
    assert told["midstructure"]["unmatched"] == ["keep FaceX+FaceY"]
    assert "keep FaceX+FaceY: no such sheet, nothing was done" in told["notes"]
    assert told["midstructure"]["pieces"] == 1 and told["midstructure"]["unreached"] == []


def test_corners_far_from_the_midstructure_still_move():
    """All eight control points are corners, and no level of .5 lies straight inward of them."""
    surface = build_surface(list(bodies.box((4.0, 2.0, 1.0), (1, 1, 1), 1).faces))
    corners = np.array([[1, 0.5, 0.5], [3, 0.5, 0.5], [3, 1.5, 0.5], [1, 1.5, 0.5]])
    plate = (corners, np.array([[0, 1, 2], [0, 2, 3]]))
    volume = complete(surface, Options(midstructure="own"), own=plate)
    assert volume.midstructure.area == pytest.approx(2.0)
    assert volume.certificate.all_valid and volume.shell.w0 > 0.4


def test_decisions_that_leave_nothing_are_refused_with_the_sheets_names():
    surface = plain_box()
    (middle,) = [
        sheet
        for sheet in pipeline.midstructure_stage(surface, Options(samples=2000)).midstructure.sheets
        if sheet.kept
    ]
    remove = f"remove {middle.name}"
    with pytest.raises(InputError, match="nothing is left of the midstructure") as refusal:
        complete(surface, Options(samples=2000, decisions=(remove,)))
    assert remove in refusal.value.line and "keep a sheet; the largest are" in refusal.value.line
    with pytest.raises(InputError, match="no such sheet; the largest sheets are") as refusal:
        complete(
            surface, Options(samples=2000, decisions=("keep X+Y", remove), strict_decisions=True)
        )
    assert refusal.value.message == "keep X+Y: no such sheet"
    assert middle.name in refusal.value.remedy


def test_a_surface_that_cuts_itself_is_refused():
    surface = build_surface(list(bodies.plate().faces))
    points = surface.control_points.copy()
    # push one point of the upper side through the lower one
    top = np.flatnonzero(points[:, 2] > 0.9 * points[:, 2].max())
    middle = top[np.linalg.norm(points[top, :2] - points[:, :2].mean(axis=0), axis=1).argmin()]
    points[middle, 2] -= 12.0
    with pytest.raises(SelfIntersectionError) as refusal:
        complete(surface.with_points(points))
    assert refusal.value.faces
    assert refusal.value.figure > 0


def test_broken_bodies_end_in_our_own_errors():
    for faces in (variants.missing_face().faces, variants.gap(1e-3).faces):
        with pytest.raises(HybridVolumeError):
            complete(build_surface(list(faces)))


def test_a_wrong_balance_is_a_fault(monkeypatch):
    monkeypatch.setattr(pipeline, "gap_volume", lambda interface, shell: 1.0)
    with pytest.raises(pipeline.FaultError):
        complete(build_surface(list(bodies.box(spans=(3, 2, 1)).faces)), Options(w0=0.3))


def test_a_thin_start_grows_to_a_proved_shell(monkeypatch):
    """The last resort: without a usable front the shell grows from a thin one."""
    monkeypatch.setattr(growth._Grower, "from_front", lambda self, level: None)
    told = []
    body = bodies.box(spans=(6, 4, 2))
    volume = complete(
        build_surface(list(body.faces)),
        Options(w0=0.4),
        lambda stage, share, text: told.append(text),
    )
    assert any("thin start" in text for text in told)
    assert volume.certificate.all_valid
    assert volume.shell.w0 >= 0.3
    assert "grown from a thin start" in volume.shell.notes


def test_no_shell_at_all_names_the_faces(monkeypatch):
    monkeypatch.setattr(growth._Grower, "from_front", lambda self, level: None)
    monkeypatch.setattr(growth, "THIN_STARTS", (40.0,))
    body = bodies.box(spans=(3, 2, 1))
    with pytest.raises(ThicknessError) as refusal:
        complete(build_surface(list(body.faces)), Options(w0=0.4))
    assert refusal.value.faces
    assert refusal.value.remedy
