# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The input check: what is refused and where, what is let pass and named."""

from __future__ import annotations

from dataclasses import replace

import bodies
import numpy as np
import pytest
from patches import Body, represent
from singular_bodies import doubled, folded, pole
from variants import turned_faces

from HybridVolume.core import bspline
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.bezier import bernstein
from HybridVolume.core.check import check_surface, check_uncut, unproved_places
from HybridVolume.core.refinement import flatten_spans
from HybridVolume.core.singular import normal_nets
from HybridVolume.errors import SelfIntersectionError, SingularSurfaceError
from HybridVolume.exports.red_places import FACE_RED, RED, refusal_scene


def surface_of(body):
    return flatten_spans(build_surface(list(body.faces)))


def refused(body, **options) -> SingularSurfaceError:
    with pytest.raises(SingularSurfaceError) as caught:
        check_surface(surface_of(body), **options)
    return caught.value


def moved(body: Body, matrix=None, shift=(0.0, 0.0, 0.0)) -> Body:
    matrix = np.eye(3) if matrix is None else matrix
    faces = [replace(f, control_points=f.control_points @ matrix.T + shift) for f in body.faces]
    return Body(body.name, tuple(faces), body.volume * np.linalg.det(matrix), body.genus)


# ------------------------------------------------------------------------------- let pass


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e3])
def test_sound_bodies_pass_at_any_size_and_far_from_the_origin(scale):
    rng = np.random.default_rng(1)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    for body in (bodies.box(), bodies.sphere(), bodies.wedge(2.0), bodies.hollow_sphere()):
        shift = 1e4 * scale * np.array([1.0, -2.0, 0.5])
        assert check_surface(surface_of(moved(body, scale * turn, shift))).places == ()


def test_corners_of_180_degrees_pass_and_are_named():
    body = pole()
    kept = check_surface(surface_of(body))
    assert not kept.lines
    assert {place.face for place in kept.places} == {"Face1", "Face2"}
    assert len(kept.places) == 8
    corners = {(round(p.u), round(p.v), round(p.point[2])) for p in kept.places}
    assert len(corners) == 8
    for place in kept.places:
        assert np.hypot(*place.point[:2]) == pytest.approx(1.0, abs=1e-14)
        assert "180" in place.what
    assert "Face1, Face2" in kept.sentence


# -------------------------------------------------------------------------------- refused


def test_a_line_of_vanishing_derivative_is_refused_with_its_places_and_can_be_let_pass():
    body = doubled()
    error = refused(body)
    assert {"Face1"} <= set(error.faces) <= {"Face1", "Face3", "Face4"}
    lines = [place for place in error.places if "along a line" in place.what]
    assert {place.face for place in lines} == {"Face1"}
    for place in lines:
        assert (place.u, place.v) == (pytest.approx(0.5), pytest.approx(0.5))
        assert place.point == pytest.approx((1.0, 0.0, 0.5))
    # the caps have the same fault in a point of their side
    ends = {p.face: p for p in error.places if p.face != "Face1"}
    assert set(ends) == {"Face3", "Face4"}
    for place in ends.values():
        assert (place.u, place.v) == (pytest.approx(0.0), pytest.approx(0.5))
        assert place.point[:2] == pytest.approx((1.0, 0.0))
    assert "--singular-lines" in error.remedy
    kept = check_surface(surface_of(body), lines=True)
    assert kept.lines
    assert {place.face for place in kept.places} == {"Face1", "Face3", "Face4"}


@pytest.mark.parametrize("flip", [False, True])
def test_a_fold_between_the_samples_is_found_at_its_place(flip):
    at, width = 0.4375, 0.05
    body = folded(at, width)
    if flip:
        body = turned_faces(body, seed=4)
    surface = surface_of(body)
    x = np.linspace(0.0, 1.0, 9)
    _, x_u, x_v = surface.element_samples(x, x).surface(surface.control_points)
    normals = np.cross(x_u, x_v).reshape(-1, 81, 3)
    unit = normals / np.linalg.norm(normals, axis=2, keepdims=True)
    assert (
        np.einsum("eki,eli->ekl", unit, unit).min() > 0.99
    )  # nine samples a direction see nothing
    error = refused(body)
    assert len(error.faces) == 1
    assert "turns over" in error.message
    for place in error.places:
        assert place.face == error.faces[0]
        assert place.point[2] == pytest.approx(1.0)
    face = next(f for f in body.faces if f.name == error.faces[0])
    worst = error.places[0]
    u, v = bernstein(3, [worst.u]), bernstein(3, [worst.v])
    assert worst.point == pytest.approx((u @ np.moveaxis(face.control_points, 2, 0) @ v.T).ravel())
    # y = v is not changed by the fold
    assert abs(worst.point[1] - 0.5) < 0.3


def test_a_wider_fold_is_seen_by_samples_too():
    error = refused(folded(0.5, 0.4))
    assert "turns over" in error.message
    assert len(error.places) >= 1


def test_a_knife_edge_is_refused_where_it_is():
    error = refused(bodies.wedge(0.2))
    assert "no direction is inward" in error.message
    assert "meet at an angle of 0.2 degrees" in error.message
    assert error.figure == pytest.approx(np.sin(np.radians(0.1)), rel=0.2)
    for place in error.places:
        assert place.point[0] == pytest.approx(0.0, abs=1e-12)  # the edge of the wedge
    assert len(error.places) <= 50


def test_refused_places_are_the_same_on_a_rotated_body_of_another_size():
    rng = np.random.default_rng(2)
    turn, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    turn *= np.sign(np.linalg.det(turn))
    shift = np.array([3.0, -7.0, 11.0])
    plain = refused(folded(0.4375, 0.05))
    other = refused(moved(folded(0.4375, 0.05), 1e3 * turn, shift))
    assert other.faces == plain.faces
    a, b = plain.places[0], other.places[0]
    assert (a.u, a.v) == (pytest.approx(b.u, abs=0.05), pytest.approx(b.v, abs=0.2))
    back = (np.array(b.point) - shift) @ turn / 1e3
    assert back == pytest.approx(a.point, abs=0.2)


# --------------------------------------------------------------------------------- proofs


def test_normal_coefficients_of_a_rational_patch_against_differences():
    rng = np.random.default_rng(6)
    body = bodies.torus()
    faces = [replace(f, weights=f.weights * 1.7) for f in body.faces]
    surface = build_surface([represent(f, f.degrees, (2, 1)) for f in faces])
    nets = normal_nets(surface)
    u, v = rng.uniform(0.02, 0.98, size=(2, 12))
    step = 1e-5
    for part in nets:
        n1, n2 = part.coefficients.shape[1:3]
        group = part.group
        for row in (0, len(group.element) - 1):
            width = group.high[row] - group.low[row]
            a, b = group.low[row][:, None] + np.stack([u, v]) * width[:, None]
            patch = group.patch[row]
            du = surface.evaluate(patch, a + step, b) - surface.evaluate(patch, a - step, b)
            dv = surface.evaluate(patch, a, b + step) - surface.evaluate(patch, a, b - step)
            expected = np.cross(du, dv) / (4 * step**2) * width.prod()
            values = np.einsum(
                "mi,mj,ijc->mc", bernstein(n1 - 1, u), bernstein(n2 - 1, v), part.coefficients[row]
            )
            unit = values / np.linalg.norm(values, axis=1, keepdims=True)
            assert np.allclose(
                unit, expected / np.linalg.norm(expected, axis=1, keepdims=True), atol=1e-8
            )
            assert np.all(part.error < 1e-8 * np.abs(part.coefficients).max())


def test_places_of_a_polynomial_that_is_negative_in_an_island():
    """(u - .31)² + (v - .77)² - r² as Bernstein coefficients of degree (2, 2)."""

    def coefficients(r: float) -> np.ndarray:
        def square(a):
            return np.array([a * a, a * a - a, (1 - a) ** 2])

        return square(0.31)[:, None] + square(0.77) - r * r

    none = np.zeros((3, 3), dtype=bool)
    places, values = unproved_places(coefficients(0.02), 1e-14, none)
    assert len(places)
    assert np.all(np.hypot(places[:, 0] - 0.31, places[:, 1] - 0.77) < 0.02)
    assert values.min() < 0.0
    positive = coefficients(0.0) + 1e-3
    assert len(unproved_places(positive, 1e-14, none)[0]) == 0
    # u + v: zero in a corner, which may be excused, and is not otherwise
    corner = np.add.outer([0.0, 0.5, 1.0], [0.0, 0.5, 1.0])
    places, _ = unproved_places(corner, 1e-14, none)
    assert np.all(places <= 2.0**-7)
    excused = none.copy()
    excused[0, 0] = True
    assert len(unproved_places(corner, 1e-14, excused)[0]) == 0


def test_a_body_that_cuts_itself_is_refused_with_places():
    """A bar bent into a ring whose ends run through each other: its end faces cross."""
    bar = bodies.box((8.0, 1.0, 1.0), (4, 1, 1), 2)

    def bent(points):
        angle = (points[..., :1] - 4.0) * (2.15 * np.pi / 8.0)
        radius = 2.0 + points[..., 1:2]
        return np.concatenate(
            [radius * np.cos(angle), radius * np.sin(angle), points[..., 2:]], axis=-1
        )

    faces = tuple(replace(f, control_points=bent(f.control_points)) for f in bar.faces)
    surface = build_surface(list(faces))
    check_surface(surface)
    with pytest.raises(SelfIntersectionError) as caught:
        check_uncut(surface)
    error = caught.value
    assert 0 < len(error.places) <= 50
    assert {place.face for place in error.places} <= set(error.faces)
    for place in error.places:
        # the ends overlap around angle pi, for 27 degrees
        assert abs(np.arctan2(-place.point[1], -place.point[0])) < np.radians(40.0)
        face = next(f for f in faces if f.name == place.face)
        lines = [
            bspline.basis_matrix(p, k, np.array([x])).toarray()
            for p, k, x in zip(face.degrees, face.knots, (place.u, place.v), strict=True)
        ]
        point = np.einsum("ai,bj,ijc->c", *lines, face.control_points)
        assert point == pytest.approx(place.point, abs=1e-9)
    check_uncut(build_surface(list(bodies.torus().faces)))


def test_picture_of_a_refusal():
    """Named faces are red, the others gray, and words stand at the places."""
    body = doubled()
    error = refused(body)
    scene = refusal_scene(body.name, body.faces, error)
    reds = [s for s in scene.skins if s.colour == FACE_RED]
    balls = [s for s in scene.skins if s.colour == RED]
    assert len(reds) == len(set(error.faces)) == 3
    assert len(scene.skins) == len(body.faces) + len(error.places)
    centres = np.array([(s.points.min(axis=0) + s.points.max(axis=0)) / 2 for s in balls])
    assert np.allclose(np.sort(centres, axis=0), np.sort([p.point for p in error.places], axis=0))
    points = np.concatenate([s.points for s in reds])
    assert points.min() == pytest.approx(0.0) and points.max() == pytest.approx(1.0)
    assert any("Face1" in label.text and "vanishes" in label.text for label in scene.labels)
    assert "refused" in scene.title
