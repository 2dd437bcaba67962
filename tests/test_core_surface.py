# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The closed surface: volume, genus, orientation, conformity and exactness on bodies known by
other means, and refusals by name."""

from __future__ import annotations

from dataclasses import replace

import bodies
import numpy as np
import pytest
import variants
from patches import homogeneous

from HybridVolume import errors
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.surface import PatchSurface, SplineFace, side_of

EVERY_KIND = [
    bodies.box(),
    bodies.box(spans=(6, 4, 2), degree=3),
    bodies.box(spans=(1, 1, 1), degree=1),
    bodies.box(spans=(2, 1, 1), degree=6),
    bodies.plate(20.0, 10),
    bodies.plate(50.0, 25),
    bodies.l_bracket(),
    bodies.wedge(20.0),
    bodies.wedge(30.0, degree=3, spans=1),
    bodies.torus(),
    bodies.ring(),
    bodies.cylinder(),
    bodies.sphere(),
    bodies.sphere(spans=3),
    bodies.hollow_sphere(),
    *(bodies.bent_voxels(seed, 1 + seed % 4) for seed in range(6)),
    bodies.bent_voxels(6, 2, merge=False),
    variants.turned_faces(bodies.torus(), 1),
    variants.turned_faces(bodies.hollow_sphere(), 2),
    variants.turned_faces(bodies.bent_voxels(8, 3), 3),
    variants.scaled_weights(bodies.cylinder()),
    variants.shifted_knots(bodies.bent_voxels(9, 2)),
    variants.mixed_splines(bodies.box(spans=(1, 1, 1), degree=1)),
    variants.mixed_splines(bodies.torus(), 1),
    variants.mixed_splines(bodies.cylinder(), 2),
    variants.mixed_splines(bodies.sphere(), 3, raise_by=1),
    variants.mixed_splines(bodies.bent_voxels(1, 2, merge=False), 4, spans=2),
    variants.turned_faces(variants.scaled_weights(variants.mixed_splines(bodies.ring(), 5)), 6),
]


@pytest.fixture(scope="module", params=EVERY_KIND, ids=lambda body: body.name.replace(" ", "-"))
def built(request) -> tuple[bodies.Body, PatchSurface]:
    return request.param, build_surface(list(request.param.faces))


def _parameters(seed: int = 0, count: int = 20) -> tuple[np.ndarray, np.ndarray]:
    return tuple(np.random.default_rng(seed).uniform(size=(2, count)))


def _evaluate(face: SplineFace, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Points of a face by SciPy; parameters in [0, 1]."""
    at = [k[0] + (k[-1] - k[0]) * x for k, x in zip(face.knots, (u, v), strict=True)]
    h = homogeneous(face, *at)[np.arange(len(u)), np.arange(len(u))]
    return h[:, :3] / h[:, 3:]


def test_volume_and_genus(built):
    body, surface = built
    assert surface.volume() == pytest.approx(body.volume, rel=1e-10)
    assert surface.genus == body.genus
    assert surface.shells == len(body.genus)
    assert [patch.face for patch in surface.patches] == [face.name for face in body.faces]


def test_patches_are_the_given_faces(built):
    """Refinement moves no point, and the parameters stay but for an exchange of u and v."""
    body, surface = built
    u, v = _parameters()
    for k, face in enumerate(body.faces):
        given = _evaluate(face, u, v)
        off = min(np.abs(surface.evaluate(k, *pair) - given).max() for pair in ((u, v), (v, u)))
        assert off <= 1e-13 * surface.diagonal + surface.moved[k]
    assert surface.moved.max() <= 1e-14 * surface.diagonal


def test_unrefined_faces_keep_every_bit(built):
    body, surface = built
    for k, (face, patch) in enumerate(zip(body.faces, surface.patches, strict=True)):
        if surface.exact[k] or surface.moved[k] > 0.0:
            continue
        points = surface.control_points[patch.index]
        assert np.array_equal(points, face.control_points) or np.array_equal(
            points, face.control_points.swapaxes(0, 1)
        )


def test_sides_conform(built):
    """Sides that meet have one degree, one knot vector, the same control points and weights."""
    _, surface = built
    t = np.linspace(0.0, 1.0, 12)
    for k, patch in enumerate(surface.patches):
        for side in range(4):
            other, other_side = surface.neighbour[k, side]
            assert tuple(surface.neighbour[other, other_side]) == (k, side)
            along, other_along = 1 - side // 2, 1 - other_side // 2
            partner = surface.patches[other]
            step = -1 if surface.reversed[k, side] else 1
            assert patch.degrees[along] == partner.degrees[other_along]
            knots = partner.knots[other_along]
            knots = 1.0 - knots[::-1] if step < 0 else knots
            np.testing.assert_allclose(patch.knots[along], knots, atol=1e-12)
            theirs = side_of(partner.index, other_side)[::step]
            assert np.array_equal(side_of(patch.index, side), theirs)
            weights = side_of(partner.weights, other_side)[::step]
            np.testing.assert_allclose(side_of(patch.weights, side), weights, rtol=1e-12)
            here = [t, t]
            here[1 - along] = np.full_like(t, side % 2)
            there = [t[::step], t[::step]]
            there[1 - other_along] = np.full_like(t, other_side % 2)
            gap = surface.evaluate(k, *here) - surface.evaluate(other, *there)
            assert np.abs(gap).max() <= 1e-13 * surface.diagonal


@pytest.mark.parametrize("nodes", [2, "knots", "greville"])
def test_triangulation_is_watertight_and_outward(built, nodes):
    body, surface = built
    mesh = surface.triangulation(nodes)
    a, b, c = mesh.triangles.T
    directed = np.concatenate([np.column_stack(p) for p in ((a, b), (b, c), (c, a))])
    keys = directed[:, 0] * len(mesh.vertices) + directed[:, 1]
    opposite = directed[:, 1] * len(mesh.vertices) + directed[:, 0]
    assert len(np.unique(keys)) == len(keys), "an edge runs twice the same way"
    assert np.array_equal(np.sort(keys), np.sort(opposite)), "an edge has no second triangle"
    euler = len(mesh.vertices) - len(keys) // 2 + len(mesh.triangles)
    assert euler == sum(2 - 2 * genus for genus in body.genus)
    x = mesh.vertices[mesh.triangles]
    volume = np.einsum("ti,ti->", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6.0
    assert 0.25 * body.volume < volume < 1.5 * body.volume
    for k in range(len(surface.patches)):
        mine = mesh.vertex_patch == k
        found = surface.evaluate(k, *mesh.vertex_uv[mine].T)
        assert np.abs(found - mesh.vertices[mine]).max(initial=0.0) <= 1e-13 * surface.diagonal


def test_normals_point_out_of_the_material():
    for body in (bodies.hollow_sphere(), variants.turned_faces(bodies.hollow_sphere(), 4)):
        surface = build_surface(list(body.faces))
        u, v = _parameters()
        for k in range(len(surface.patches)):
            x, x_u, x_v = surface.evaluate(k, u, v, derivative=1)
            radius = np.linalg.norm(x, axis=1)
            outer = surface.shell_of_patch[k] == 0
            np.testing.assert_allclose(radius, 2.0 if outer else 1.0, rtol=1e-13)
            outward = np.einsum("ij,ij->i", np.cross(x_u, x_v), x)
            assert np.all(outward > 0.0 if outer else outward < 0.0)


def test_derivatives_against_differences():
    surface = build_surface(list(variants.mixed_splines(bodies.torus(), 7).faces))
    h = 1e-5
    u, v = (0.05 + 0.9 * p for p in _parameters(1))
    for k in range(0, len(surface.patches), 5):
        # stay within one knot span: the parametrisation is smooth, the difference is not
        _, x_u, x_v = surface.evaluate(k, u, v, derivative=1)
        du = (surface.evaluate(k, u + h, v) - surface.evaluate(k, u - h, v)) / (2 * h)
        dv = (surface.evaluate(k, u, v + h) - surface.evaluate(k, u, v - h)) / (2 * h)
        np.testing.assert_allclose(x_u, du, atol=1e-8 * np.abs(du).max())
        np.testing.assert_allclose(x_v, dv, atol=1e-8 * np.abs(dv).max())


@pytest.mark.parametrize(
    ("body", "area"),
    [
        (bodies.box(), 22.0),
        (bodies.sphere(3.0), 36.0 * np.pi),
        (bodies.torus(3.0, 1.0), 12.0 * np.pi**2),
        (bodies.cylinder(1.0, 2.0), 6.0 * np.pi),
        (bodies.hollow_sphere(2.0, 1.0), 20.0 * np.pi),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_area(body, area):
    assert build_surface(list(body.faces)).area() == pytest.approx(area, rel=1e-10)


def test_shell_volumes():
    body = bodies.hollow_sphere(2.0, 1.0)
    volumes = build_surface(list(body.faces)).shell_volumes()
    np.testing.assert_allclose(volumes, np.array([32.0, -4.0]) * np.pi / 3.0, rtol=1e-10)


def test_box_keeps_every_bit():
    """Dyadic coordinates and equal splines: nothing is moved, refined or rounded."""
    body = bodies.box(spans=(4, 2, 2))
    surface = build_surface(list(body.faces))
    assert not surface.exact.any() and not surface.moved.any()
    given = np.concatenate([face.control_points.reshape(-1, 3) for face in body.faces])
    assert {p.tobytes() for p in surface.control_points} == {p.tobytes() for p in given}


def test_small_gap_is_welded_and_reported():
    """Lower-numbered faces keep their bits; the move of the other face is reported."""
    body = variants.gap(1e-7)
    surface = build_surface(list(body.faces))
    np.testing.assert_allclose(surface.moved[:5], 0.0)
    assert surface.moved[5] == pytest.approx(1e-7, rel=1e-6)
    with pytest.raises(errors.GapError):
        build_surface(list(body.faces), tolerance=1e-8)


def test_wider_tolerance_accepts_a_gap():
    surface = build_surface(list(variants.gap(1e-3).faces), tolerance=1e-3)
    assert surface.moved.max() == pytest.approx(1e-3)


def _weights_that_do_not_close() -> bodies.Body:
    """Torus whose patches are reparametrised so that weights grow on the way around."""
    body = bodies.torus()
    growth = 1.3 ** np.arange(3)[:, None]
    faces = tuple(replace(face, weights=face.weights * growth) for face in body.faces)
    return replace(body, faces=faces)


def _first_face(body: bodies.Body, **changes) -> bodies.Body:
    return replace(body, faces=(replace(body.faces[0], **changes), *body.faces[1:]))


_BOX = bodies.box(spans=(1, 1, 1), degree=2)
_KNOTS = _BOX.faces[0].knots


@pytest.mark.parametrize(
    ("body", "error", "faces"),
    [
        (variants.missing_face(), errors.OpenBodyError, {"Face1", "Face2", "Face5", "Face6"}),
        (variants.gap(1e-3), errors.GapError, {"Face1", "Face2", "Face3", "Face4", "Face6"}),
        (variants.t_junction(), errors.TJunctionError, {"Face3", "Face4", "Face6", "Face7"}),
        (variants.joined_boxes(1), errors.NonManifoldError, {"Face2", "Face4", "Face7", "Face9"}),
        (
            variants.joined_boxes(0),
            errors.NonManifoldError,
            {"Face2", "Face4", "Face6", "Face7", "Face9", "Face11"},
        ),
        (variants.joined_boxes(-1), errors.InputError, None),
        (variants.pinched(), errors.DegenerateSideError, {"Face2", "Face6"}),
        (variants.other_speed(), errors.GapError, {"Face3", "Face4", "Face6"}),
        (variants.klein_bottle(), errors.OrientationError, None),
        (_weights_that_do_not_close(), errors.GapError, None),
        (_first_face(_BOX, weights=-_BOX.faces[0].weights), errors.InputError, {"Face1"}),
        (_first_face(_BOX, weights=0 * _BOX.faces[0].weights), errors.InputError, {"Face1"}),
        (
            _first_face(_BOX, control_points=np.full((3, 3, 3), np.nan)),
            errors.InputError,
            {"Face1"},
        ),
        (_first_face(_BOX, knots=(_KNOTS[0][1:], _KNOTS[1])), errors.InputError, {"Face1"}),
        (
            _first_face(_BOX, knots=(np.linspace(0.0, 1.0, 6), _KNOTS[1])),
            errors.InputError,
            {"Face1"},
        ),
        (bodies.Body("nothing", (), 0.0), errors.InputError, None),
        (
            bodies.Body("flat", (_BOX.faces[4], replace(_BOX.faces[4], name="back")), 0.0),
            errors.InputError,
            None,
        ),
    ],
)  # fmt: skip
def test_refusals_name_the_faces(body, error, faces):
    with pytest.raises(error) as caught:
        build_surface(list(body.faces))
    if faces is not None:
        assert set(caught.value.faces) == faces
    assert caught.value.remedy
    assert "\n" not in caught.value.line


def test_refusal_figures():
    """The figure of a gap is its size in mm."""
    with pytest.raises(errors.GapError) as caught:
        build_surface(list(variants.gap(2.5e-4).faces))
    assert caught.value.figure == pytest.approx(2.5e-4, rel=1e-6)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_size_does_not_matter(scale):
    """The tolerance is relative: microns and metres behave alike."""
    for body in (bodies.cylinder(), bodies.bent_voxels(3, 2)):
        faces = [replace(f, control_points=f.control_points * scale) for f in body.faces]
        surface = build_surface(faces)
        assert surface.volume() == pytest.approx(body.volume * scale**3, rel=1e-10)


def test_far_from_the_origin():
    body = bodies.bent_voxels(3, 2)
    shift = np.array([1e4, -2e4, 3e4])
    faces = [replace(f, control_points=f.control_points + shift) for f in body.faces]
    assert build_surface(faces).volume() == pytest.approx(body.volume, rel=1e-9)


@pytest.mark.parametrize("seed", range(20, 30))
def test_random_voxel_solids(seed):
    """Any genus: high-genus solids from a larger block."""
    cells = bodies.random_voxels(seed, (3, 3, 3), 0.5)
    body = bodies.bent_voxels(seed, 2, cells=cells)
    surface = build_surface(list(variants.turned_faces(body, seed).faces))
    assert surface.volume() == pytest.approx(body.volume, rel=1e-12)
    assert surface.genus == body.genus
