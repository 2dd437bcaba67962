# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What a result is looked at by: sections with exact areas, cells, figures of elements."""

from dataclasses import replace

import numpy as np
import pytest
from shells import exact_volume, make_volume

from HybridVolume.core.cells import CoreCells, shell_cells
from HybridVolume.core.density import Density
from HybridVolume.core.quality import element_quality
from HybridVolume.core.reached import inner_figures
from HybridVolume.core.remesh import remesh
from HybridVolume.core.section import cut_tets, cut_triangles, heights
from HybridVolume.core.validity import certify

CUBE = np.array([[i, j, k] for i in (0.0, 1.0) for j in (0.0, 1.0) for k in (0.0, 1.0)])
CUBE_TETS = np.array([[0, 4, 6, 7], [0, 4, 5, 7], [0, 2, 6, 7], [0, 2, 3, 7], [0, 1, 5, 7],
                      [0, 1, 3, 7]])  # fmt: skip
CUBE_TRIANGLES = np.array(
    [[0, 2, 6], [0, 4, 6], [1, 3, 7], [1, 5, 7], [0, 1, 5], [0, 4, 5], [2, 3, 7], [2, 6, 7],
     [0, 1, 3], [0, 2, 3], [4, 5, 7], [4, 6, 7]]
)  # fmt: skip


def area(section, direction):
    a, b, c = np.moveaxis(section.points[section.facing(direction)], 1, 0)
    return 0.5 * (np.cross(b - a, c - a) @ direction).sum() / np.linalg.norm(direction)


@pytest.mark.parametrize(
    ("normal", "distance", "expected", "around"),
    [
        # a hexagon of side sqrt(1/2), a triangle, a square in the middle and one that is a face
        ((1.0, 1.0, 1.0), 1.5, 1.5 * np.sqrt(3.0) * 0.5, 6.0 * np.sqrt(0.5)),
        ((1.0, 1.0, 1.0), 0.5, np.sqrt(3.0) / 8.0, 3.0 * np.sqrt(0.5)),
        ((0.0, 0.0, 1.0), 0.5, 1.0, 4.0),
        ((0.0, 0.0, 1.0), 1.0, 1.0, 4.0),
    ],
)
def test_sections_of_a_cube(normal, distance, expected, around):
    normal = np.array(normal)
    height = heights(CUBE, normal, distance)
    cut = cut_tets(CUBE, CUBE_TETS, height)
    assert area(cut, normal) == pytest.approx(expected, rel=1e-12)
    assert area(cut, -normal) == pytest.approx(expected, rel=1e-12)
    assert np.abs(heights(cut.points, normal, distance)).max() < 1e-12
    # what is linear in the cube is linear in the section
    assert cut.values(CUBE @ [1.0, 2.0, 3.0]) == pytest.approx(cut.points @ [1.0, 2.0, 3.0])
    assert cut.values(CUBE) == pytest.approx(cut.points)
    rim = cut_triangles(CUBE, CUBE_TRIANGLES, height)
    ends = rim.points[rim.parts]
    if distance < 1.0:  # the lid lies in the plane itself
        assert np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).sum() == pytest.approx(around)


def test_nothing_is_cut_beside():
    for distance in (-0.1, 1.1):
        height = heights(CUBE, np.array([1.0, 0.0, 0.0]), distance)
        assert len(cut_tets(CUBE, CUBE_TETS, height).parts) == 0
        assert len(cut_triangles(CUBE, CUBE_TRIANGLES, height).parts) == 0


@pytest.mark.parametrize("name", ["box", "torus"])
def test_sections_add_up_to_the_body(name):
    """Gauss points along an oblique direction: areas of sections integrate to the volumes."""
    # of the coarsest core the curved tets are straightened by more than this test allows
    volume = remesh(make_volume(name), Density(subdivide=2))
    cells = shell_cells(volume.shell)
    core = CoreCells(volume.fem.nodes, volume.fem.tets, volume.fem.interface)
    normal = np.array([2.0, -1.0, 2.0]) / 3.0
    along = cells.flat @ normal
    everything = np.arange(len(cells))
    x, weight = np.polynomial.legendre.leggauss(30)
    low, high = along.min(), along.max()
    shell_area, core_area = [], []
    for distance in 0.5 * (low + high) + 0.5 * (high - low) * x:
        cut, rims = cells.section(everything, normal, distance)
        shell_area.append(area(cut, normal))
        core_area.append(area(core.section(normal, distance)[0], normal))
        assert set(rims.owner) >= set(cut.owner)
    half = 0.5 * (high - low)
    shell, inside = half * weight @ shell_area, half * weight @ core_area
    assert shell == pytest.approx(volume.shell.volume(), rel=0.01)
    assert inside == pytest.approx(volume.fem.core_volume, rel=0.02)
    assert shell + inside == pytest.approx(exact_volume(name), rel=0.02)
    # one layer alone
    outer = cells.of_layers(0, 0)
    cut, _ = cells.section(outer, normal, 0.5 * (low + high))
    assert set(cut.owner % cells.layers) == {0}
    assert cut.values(cells.flat) == pytest.approx(cut.points, abs=1e-9)


@pytest.mark.parametrize("name", ["box", "torus"])
def test_cells(name):
    volume = make_volume(name)
    shell = volume.shell
    cells = shell_cells(shell)
    # the lattice at the inner boundary is the triangulation whose figures are known
    inner = inner_figures(shell)
    last = cells.points[cells.layers - 1 :: cells.layers, :, :, -1]
    assert inner.vertices[cells.vertex] == pytest.approx(last, abs=1e-12)
    # all sides of an element together are closed and point outward: they enclose its volume
    corners = cells.points.reshape(len(cells), -1, 3)[:, cells.triangles(range(6))]
    a, b, c = np.moveaxis(corners, 2, 0)
    enclosed = np.einsum("eti,eti->e", np.cross(a, b), c) / 6.0
    assert enclosed == pytest.approx(shell.element_volumes(), rel=0.02)
    # normals at the outer boundary are those of its triangles
    first = cells.of_layers(0, 0)
    outside = cells.triangles([4])
    a, b, c = np.moveaxis(cells.points.reshape(len(cells), -1, 3)[first][:, outside], 2, 0)
    flat = np.cross(b - a, c - a)
    smooth = cells.normals.reshape(len(cells), -1, 3)[first][:, outside[:, 0]]
    assert (np.einsum("eti,eti->et", flat, smooth) > 0.0).all()
    along, across = cells.rims(range(6))
    assert len(along) == 8 and len(across) == 4


def test_quality_by_element_face_and_layer():
    volume = make_volume("box")
    found = element_quality(volume)
    assert found.proved.all() and len(found) == volume.shell.element_count == 2 * 52
    assert found.faces == tuple(f"Face{k}" for k in range(1, 7))
    assert np.bincount(found.face).sum() == len(found) and np.bincount(found.layer).tolist() == [
        52,
        52,
    ]
    ranked = np.sort(found.scaled_jacobian)
    assert found.scaled_jacobian[found.worst(5)] == pytest.approx(ranked[:5])
    assert found.share(1.0) == ranked[1] and found.share(100.0) == ranked[-1]
    for face, least in enumerate(found.least_by_face()):
        assert least == found.scaled_jacobian[found.of_face(face)].min()
    assert found.least_by_layer().min() == ranked[0]

    # one control point pushed through the outer face: its elements, and no other, are not proved
    layers = volume.shell.layers.copy()
    column = int(np.argmax(volume.shell.surface.control_points @ [1.0, 1.0, 1.0]))
    layers[-1, column] += 2.0 * (layers[0, column] - layers[-1, column])
    bent = replace(volume.shell, layers=layers)
    broken = replace(volume, shell=bent, certificate=certify(bent.bezier_elements()))
    worse = element_quality(broken)
    bad = np.flatnonzero(~worse.proved)
    assert len(bad) and (worse.scaled_jacobian[bad] <= 0.0).any()
    assert set(worse.worst(1)) <= set(bad)
    near = [k for k, patch in enumerate(bent.surface.patches) if (patch.index == column).any()]
    assert {worse.faces[worse.face[k]] for k in bad} <= {bent.surface.patches[k].face for k in near}
