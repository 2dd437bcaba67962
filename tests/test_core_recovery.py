# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Strain and stress at the nodes, against fields whose derivatives are known."""

from __future__ import annotations

import numpy as np
import pytest

from HybridVolume.core.elements import reference
from HybridVolume.core.recovery import Material, averaged, element_strain, recover, von_mises
from HybridVolume.errors import InputError

STEEL = Material(210_000.0, 0.3)


def one_element(kind: str, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Nodes of an affine image of the reference element, and its connectivity."""
    random = np.random.default_rng(seed)
    matrix = np.eye(3) + 0.3 * random.normal(size=(3, 3))
    matrix *= np.sign(np.linalg.det(matrix))
    nodes = reference(kind).nodes @ matrix.T + random.normal(size=3)
    return nodes, np.arange(len(nodes))[None]


@pytest.mark.parametrize("kind", ["tet10", "penta15", "hex20"])
def test_a_quadratic_field_has_its_exact_strain_at_every_node(kind: str) -> None:
    nodes, elements = one_element(kind)
    x, y, z = nodes.T
    displacement = np.column_stack([x * y - z**2, 2.0 * y**2 + x * z, x**2 - y * z])
    found = element_strain(kind, nodes, elements, displacement)[0]
    exact = np.column_stack(
        [y, 4.0 * y, -y, 0.5 * (x + z), 0.5 * (-2.0 * z + 2.0 * x), 0.5 * (x - z)]
    )
    assert found == pytest.approx(exact, abs=1e-12)


@pytest.mark.parametrize("kind", ["tet4", "penta6"])
def test_a_linear_field_has_its_exact_strain(kind: str) -> None:
    nodes, elements = one_element(kind, 1)
    slope = np.array([[1.0, 2.0, 3.0], [-1.0, 0.5, 2.0], [0.0, 4.0, -2.0]])
    found = element_strain(kind, nodes, elements, nodes @ slope.T)[0]
    assert found == pytest.approx(np.tile([1.0, 0.5, -2.0, 0.5, 1.5, 3.0], (len(nodes), 1)))


def test_uniaxial_tension_is_uniaxial_stress() -> None:
    # sigma_xx = E eps_xx when the sides contract by Poisson's ratio
    nodes, elements = one_element("penta15", 2)
    displacement = nodes * np.array([1e-3, -0.3e-3, -0.3e-3])
    found = recover(nodes, [("penta15", elements)], displacement, STEEL)
    assert found.stress == pytest.approx(np.tile([210.0, 0, 0, 0, 0, 0], (15, 1)), abs=1e-9)
    assert found.von_mises == pytest.approx(np.full(15, 210.0))
    assert found.principal == pytest.approx(np.tile([210.0, 0, 0], (15, 1)), abs=1e-9)


def test_pure_shear_has_a_von_mises_stress_of_root_three_times_it() -> None:
    assert von_mises(np.array([[0.0, 0.0, 0.0, 5.0, 0.0, 0.0]])) == pytest.approx([75**0.5])


def test_a_rigid_turn_by_a_small_angle_strains_nothing() -> None:
    nodes, elements = one_element("tet10", 3)
    displacement = np.cross([1e-4, -2e-4, 3e-4], nodes) + [5.0, 6.0, 7.0]
    found = recover(nodes, [("tet10", elements)], displacement, STEEL)
    assert np.abs(found.stress).max() < 1e-7


def test_neighbours_are_averaged_and_other_nodes_left_out() -> None:
    # two tets with a common face, strained by 1 and 3
    nodes = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [0, 0, -1], [9, 9, 9]])
    tets = np.array([[0, 1, 2, 3], [0, 2, 1, 4]])
    displacement = np.zeros_like(nodes)
    displacement[3, 2], displacement[4, 2] = 1.0, -3.0
    found = averaged(nodes, [("tet4", tets)], displacement, Material(1.0, 0.0))
    assert found.nodes.tolist() == [0, 1, 2, 3, 4]
    assert found.strain[:, 2] == pytest.approx([2.0, 2.0, 2.0, 1.0, 3.0])


def test_results_of_another_mesh_and_broken_ones_are_refused() -> None:
    nodes, elements = one_element("tet4")
    with pytest.raises(InputError, match="3 displacements"):
        recover(nodes, [("tet4", elements)], np.zeros((3, 3)), STEEL)
    with pytest.raises(InputError, match="not finite"):
        recover(nodes, [("tet4", elements)], np.full((4, 3), np.nan), STEEL)
    with pytest.raises(InputError, match="Poisson"):
        Material(1.0, 0.5)
