# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Pictures of the stages: what their arrays show, and what is drawn of them."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from shells import make_volume

from HybridVolume.core.harmonic import HarmonicField
from HybridVolume.core.quality import element_quality
from HybridVolume.core.tetmesh.mesh import TetMesh
from HybridVolume.core.validity import certify
from HybridVolume.exports import pictures
from HybridVolume.exports.scene import Bar, Chart, Label, Scene
from HybridVolume.exports.slices import clipped, isolines
from HybridVolume.job import PICTURES

SIZE = np.array([3.0, 2.0, 1.0])


def tets_of_box(cells):
    """Six tetrahedra in each cell of a box from the origin."""
    shape = np.array(cells) + 1
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in shape), indexing="ij"), axis=-1)
    number = np.arange(shape.prod()).reshape(shape)
    tets = []
    for order in permutations(range(3)):
        steps = np.cumsum(np.eye(3, dtype=int)[list(order)], axis=0)
        ends = [number[:-1, :-1, :-1]]
        ends += [
            number[tuple(slice(a, n - 1 + a) for a, n in zip(s, shape, strict=True))] for s in steps
        ]
        rows = np.stack([e.ravel() for e in ends], axis=1)
        even = np.linalg.det(np.eye(3)[list(order)]) > 0
        tets.append(rows if even else rows[:, [0, 2, 1, 3]])
    return TetMesh(grid.reshape(-1, 3) / cells * SIZE, np.concatenate(tets))


@pytest.fixture(scope="module")
def volume():
    """A box in whose shell the inner box is half as large."""
    found = make_volume("box")
    return replace(found, shell=replace(found.shell, w0=0.5, w0_asked=0.5, w0_rms=0.0))


@pytest.fixture(scope="module")
def field():
    """w that rises from top and bottom of the box to 1 half-way."""
    mesh = tets_of_box((6, 4, 8))
    assert mesh.volume == pytest.approx(6.0, rel=1e-12) and mesh.volumes.min() > 0
    w = 1.0 - 2.0 * np.abs(mesh.vertices[:, 2] - 0.5)
    return HarmonicField(mesh, w, np.zeros_like(mesh.vertices), w == 1.0, True)


@pytest.fixture(scope="module")
def scenes(volume, field):
    return pictures.all_pictures("block", volume, field)


def test_every_picture_has_a_name_and_a_title(scenes):
    assert tuple(scenes) == PICTURES
    for scene in scenes.values():
        assert scene.title.startswith("block: ")
    rulers = [scene.ruler for scene in scenes.values() if isinstance(scene, Scene)]
    assert len(rulers) == 6 and all(rulers)


def test_the_cut_shows_the_field(scenes):
    scene = scenes["field"]
    body, section = scene.skins
    x = section.points[section.triangles]
    area = 0.5 * np.linalg.norm(np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0]), axis=1).sum()
    # the plane stands across the middle extent
    assert area == pytest.approx(3.0, rel=1e-9)
    assert np.ptp(section.points, axis=0) == pytest.approx([3.0, 0.0, 1.0], abs=1e-9)
    assert section.values == pytest.approx(1.0 - 2.0 * np.abs(section.points[:, 2] - 0.5), abs=1e-9)
    # one half of the body stands behind it
    assert 0.45 < np.ptp(body.points[np.unique(body.triangles)], axis=0)[1] / 2.0 < 0.55
    white = [wire for wire in scene.wires if wire.colour == (1.0, 1.0, 1.0)]
    heights = sorted({round(float(z), 6) for wire in white for z in wire.points[..., 2].ravel()})
    expected = sorted({round(z, 6) for k in range(1, 10) for z in (k / 20, 1 - k / 20)})
    assert heights == pytest.approx(expected, abs=1e-6)
    inner = next(wire for wire in scene.wires if wire.width == 4.0)
    ends = inner.points.reshape(-1, 3)
    assert ends.min(axis=0)[[0, 2]] == pytest.approx([0.75, 0.25], abs=1e-9)
    assert ends.max(axis=0)[[0, 2]] == pytest.approx([2.25, 0.75], abs=1e-9)


def test_columns_stand_between_the_surfaces(scenes):
    lines = next(w for w in scenes["columns"].wires if w.colour == pictures.COLUMN).points
    start, end = lines[:, 0], lines[:, -1]
    on_box = np.minimum(np.abs(start), np.abs(start - SIZE)).min(axis=1)
    assert on_box.max() < 1e-12
    assert end == pytest.approx(start + 0.5 * (0.5 * SIZE - start), abs=1e-9)
    # only where the shell is taken away
    assert start[:, 0].min() > 0.3 * 3.0 and start[:, 0].max() == pytest.approx(3.0)


def test_colours_of_the_inner_boundary(scenes, field):
    thickness = scenes["thickness"].skins[0].values
    # distance from the outer box of the inner one: a quarter at the large faces, half at most
    assert thickness.min() == pytest.approx(0.25, rel=1e-9)
    assert thickness.max() == pytest.approx(0.5, rel=1e-9)
    level = scenes["level"].skins[0]
    assert level.values == pytest.approx(1.0 - 2.0 * np.abs(level.points[:, 2] - 0.5), abs=1e-9)
    assert scenes["level"].bar.low <= 0.5 <= scenes["level"].bar.high
    assert "asked 0.5" in scenes["level"].lines[0]


def test_a_crushed_element_is_named_first(volume, field):
    layers = volume.shell.layers.copy()
    patch = volume.shell.surface.patches[3]
    # the inner control points in the middle of this face are pulled out of the body
    point = patch.index[2, 2]
    layers[1:, point] = layers[0, point] - 1.5 * (layers[1:, point] - layers[0, point])
    shell = replace(volume.shell, layers=layers)
    crushed = replace(volume, shell=shell, certificate=certify(shell.bezier_elements()))
    scene = pictures.worst_picture("block", crushed, element_quality(crushed))
    assert len(scene.labels) == 10
    assert scene.labels[0].text.startswith(f"{patch.face}, layer ")
    assert float(scene.labels[0].text.rsplit(" ", 1)[1]) < 0.0
    least = [float(label.text.rsplit(" ", 1)[1]) for label in scene.labels]
    assert least == sorted(least)
    outer = shell.surface.triangulation("greville").vertices[
        shell.surface.triangulation("greville").grids[3].ravel()
    ]
    apart = np.linalg.norm(outer - scene.labels[0].point, axis=1).min()
    assert apart < 0.7
    # each red element has six sides and its label lies within
    for skin, label in zip(scene.skins[1:], scene.labels, strict=True):
        low, high = skin.points.min(axis=0), skin.points.max(axis=0)
        assert (low < label.point).all() and (label.point < high).all()


def test_the_histogram_counts_every_element(scenes, volume):
    chart = scenes["histogram"]
    assert chart.counts.sum() == volume.shell.element_count
    least = element_quality(volume).scaled_jacobian.min()
    assert chart.marks[0][0] == pytest.approx(least)
    filled = np.flatnonzero(chart.counts)
    assert chart.edges[filled[0]] <= least <= chart.edges[filled[0] + 1]
    # three right angles and a straight column: 1/sqrt(3) for the box's diagonal in scaled axes
    assert chart.marks[1][0] == pytest.approx(3**-0.5, rel=1e-6)


def test_the_histogram_of_finite_elements_has_shell_and_core(scenes, volume):
    chart, fem = scenes["fem_histogram"], volume.fem
    (_, shell, _), (_, core, _) = chart.parts
    assert (sum(shell), sum(core)) == (len(fem.wedges), len(fem.tets))
    assert chart.counts.tolist() == [a + b for a, b in zip(shell, core, strict=True)]
    assert core[-1] == np.count_nonzero(fem.tet_quality >= chart.edges[-2])
    assert chart.marks[0][0] == fem.min_scaled_jacobian


def test_a_cube_is_clipped_to_its_lower_part():
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in squares for t in ((a, b, c), (a, c, d))])
    points, kept = clipped(corners, triangles, corners[:, 2] - 0.3)
    x = points[kept]
    normal = 0.5 * np.cross(x[:, 1] - x[:, 0], x[:, 2] - x[:, 0])
    assert np.linalg.norm(normal, axis=1).sum() == pytest.approx(1.0 + 4 * 0.3)
    assert points[np.unique(kept)][:, 2].max() == pytest.approx(0.3)
    # turned as before: outward from the middle
    assert (np.einsum("ti,ti->t", normal, x.mean(axis=1) - [0.5, 0.5, 0.15]) > 0).all()


def test_isolines_of_a_cone_are_circles():
    t = np.linspace(-1, 1, 41)
    grid = np.stack(np.meshgrid(t, t, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
    corner = (np.arange(40)[:, None] * 41 + np.arange(40)).ravel()
    triangles = np.concatenate([np.stack([corner, corner + 41, corner + 42], 1),
                                np.stack([corner, corner + 42, corner + 1], 1)])  # fmt: skip
    lines = isolines(grid, triangles, np.hypot(grid[:, 0], grid[:, 1]), 0.6)
    assert np.linalg.norm(lines, axis=2) == pytest.approx(0.6, abs=3e-3)
    length = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1).sum()
    assert length == pytest.approx(1.2 * np.pi, rel=5e-3)


def test_words_are_drawn_beside_the_body(scenes, tmp_path):
    """One process draws a scene with labels and a chart; words do not lie on one another."""
    pytest.importorskip("pyvista")
    image = pytest.importorskip("PIL.Image")
    from HybridVolume.core.tetmesh.door import interpreter
    from HybridVolume.exports.picture import write_scenes

    wanted = {tmp_path / "worst.png": scenes["worst"], tmp_path / "bars.png": scenes["histogram"]}
    wanted[tmp_path / "fem.png"] = scenes["fem_histogram"]
    write_scenes(wanted, interpreter(), size=(640, 480))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["bars.png", "fem.png", "worst.png"]
    pixels = np.asarray(image.open(tmp_path / "worst.png").convert("RGB")).astype(int)
    assert pixels.shape == (480, 640, 3)
    red = (pixels[..., 0] > 2 * pixels[..., 1]) & (pixels[..., 0] > 90)
    ink = (pixels < 250).any(axis=2)
    # labels stand in the margins, the elements in the middle, the title above, the ruler below
    assert red[:, :110].any() and red[:, 530:].any() and red[100:400, 130:510].sum() > 400
    assert ink[5:40].any() and ink[440:, 500:].any()
    bars = np.asarray(image.open(tmp_path / "bars.png").convert("RGB")).astype(int)
    blue = (bars[..., 2] > 1.5 * bars[..., 0]) & (bars[..., 2] > 120)
    assert 0.02 < blue.mean() < 0.6
    fem = np.asarray(image.open(tmp_path / "fem.png").convert("RGB")).astype(int)
    blue = (fem[..., 2] > 1.5 * fem[..., 0]) & (fem[..., 2] > 120)
    ochre = (fem[..., 0] > 1.8 * fem[..., 2]) & (fem[..., 0] > 150)
    assert blue.mean() > 0.02 and ochre.mean() > 0.01


def test_a_scene_without_words_is_drawn_as_before():
    scene = Scene((), (), np.array([0.0, 0.0, 1.0]), np.array([0.0, 1.0, 0.0]), 1.0)
    assert not scene.written
    assert replace(scene, bar=Bar("w", 0.0, 1.0)).written
    assert replace(scene, labels=(Label(np.zeros(3), "here"),)).written
    assert isinstance(Chart("", (), np.arange(2.0), np.ones(1), "", ""), Chart)


@pytest.mark.parametrize(
    ("length", "told"), [(0.37, 0.2), (1.0, 1.0), (7.3e3, 5e3), (2.4e-3, 2e-3), (0.099, 0.05)]
)
def test_rulers_have_round_lengths(length, told):
    annotate = pytest.importorskip("HybridVolume.exports.annotate")
    assert annotate.round_length(length) == pytest.approx(told, rel=1e-12)
