# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Node orders against VTK and gmsh, quadrature against exact integrals, proofs against samples."""

from math import factorial

import numpy as np
import pytest

from HybridVolume.core import element_jacobians as ej
from HybridVolume.core import elements as el

KINDS = tuple(el.EDGES)
SOLIDS = ("tet4", "tet10", "penta6", "penta15")
DEGREE = {"tri3": 1, "tri6": 2, "tet4": 1, "tet10": 2, "penta6": 1, "penta15": 2}
DEGREE |= {"hex8": 1, "hex20": 2, "quad4": 1, "quad8": 2}


def shape(kind):
    return kind.rstrip("0123456789")


def inside(kind, count=7, seed=1):
    return np.random.default_rng(seed).random((count, el.reference(kind).dimension)) / 3.0


@pytest.mark.parametrize("kind", KINDS)
def test_shape_functions_interpolate_and_reproduce_polynomials(kind):
    nodes, points = el.reference(kind).nodes, inside(kind)
    assert np.array_equal(el.shape_functions(kind, nodes), np.eye(len(nodes)))
    values, gradients = el.shape_functions(kind, points), el.shape_gradients(kind, points)
    direction = np.array([0.3, -0.7, 0.4])[: nodes.shape[1]]
    for power in range(DEGREE[kind] + 1):
        at_nodes = (1.0 + nodes @ direction) ** power
        base = 1.0 + points @ direction
        assert np.allclose(values @ at_nodes, base**power, atol=1e-14)
        slope = np.einsum("mnd,n->md", gradients, at_nodes)
        exact = power * base[:, None] ** max(power - 1, 0) * direction
        assert np.allclose(slope, exact, atol=1e-13)


VTK_CLASSES = {
    "tri3": "vtkTriangle",
    "tri6": "vtkQuadraticTriangle",
    "tet4": "vtkTetra",
    "tet10": "vtkQuadraticTetra",
    "penta6": "vtkWedge",
    "penta15": "vtkQuadraticWedge",
    "hex8": "vtkHexahedron",
    "hex20": "vtkQuadraticHexahedron",
    "quad4": "vtkQuad",
    "quad8": "vtkQuadraticQuad",
}


@pytest.mark.parametrize("kind", KINDS)
def test_vtk_has_the_same_shape_functions(kind):
    vtk = pytest.importorskip("vtk")
    cell = getattr(vtk, VTK_CLASSES[kind])()
    assert cell.GetCellType() == el.VTK_TYPES[kind]
    order = el.ORDERS["vtk"][kind]
    for point in inside(kind):
        theirs = [0.0] * cell.GetNumberOfPoints()
        cell.InterpolateFunctions([*point, 0.0][:3], theirs)
        assert np.allclose(theirs, el.shape_functions(kind, point[None])[0][list(order)])


GMSH_TYPES = {"tri3": 2, "tri6": 9, "tet4": 4, "tet10": 11}
GMSH_TYPES |= {"penta6": 6, "penta15": 18, "hex8": 5, "hex20": 17, "quad4": 3, "quad8": 16}


@pytest.mark.parametrize("kind", KINDS)
def test_gmsh_nodes_stand_where_the_order_says(kind):
    gmsh = pytest.importorskip("gmsh")
    gmsh.initialize(interruptible=False)
    try:
        _, dimension, _, count, local, _ = gmsh.model.mesh.getElementProperties(GMSH_TYPES[kind])
    finally:
        gmsh.finalize()
    theirs = np.array(local).reshape(count, dimension)
    if shape(kind) == "penta":
        theirs[:, 2] = 0.5 * (theirs[:, 2] + 1.0)
    elif shape(kind) in ("quad", "hex"):
        theirs = 0.5 * (theirs + 1.0)
    ours = el.reference(kind).nodes[list(el.ORDERS["gmsh"][kind])]
    assert np.allclose(ours, theirs, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_orders_are_reversed_and_freecad_is_mirrored(kind):
    row = np.arange(len(el.reference(kind).nodes))[None] + 10
    for program in el.ORDERS:
        there = el.to_order(program, kind, row)
        assert np.array_equal(el.from_order(program, kind, there), row)
    if kind in SOLIDS:
        nodes = el.reference(kind).nodes
        mirrored = nodes[list(el.ORDERS["freecad"][kind])]
        volumes = ej.volumes(kind, np.stack([nodes, mirrored]))
        assert volumes[0] > 0.0 and volumes[1] == pytest.approx(-volumes[0])


def exact_integral(name, power):
    a, b, c = power
    if name == "tet":
        return factorial(a) * factorial(b) * factorial(c) / factorial(a + b + c + 3)
    triangle = factorial(a) * factorial(b) / factorial(a + b + 2)
    if name == "tri":
        return triangle
    if name == "quad":
        return 1.0 / ((a + 1) * (b + 1))
    return triangle / (c + 1) if name == "penta" else 1.0 / ((a + 1) * (b + 1) * (c + 1))


@pytest.mark.parametrize("name", ["tri", "quad", "tet", "penta", "hex"])
@pytest.mark.parametrize("count", [2, 4])
def test_quadrature_is_exact_as_promised(name, count):
    points, weights = el.quadrature(name, count)
    degree = {"tri": 2 * count - 2, "tet": 2 * count - 3}.get(name, 2 * count - 2)
    assert weights.min() > 0.0
    for a in range(degree + 1):
        for b in range(degree + 1 - a):
            c = degree - a - b if name not in ("tri", "quad") else 0
            power = np.array([a, b, c])[: points.shape[1]]
            found = weights @ np.prod(points**power, axis=1)
            assert found == pytest.approx(exact_integral(name, (a, b, c)), rel=1e-13)


def _sides(corners):
    return zip(corners, np.roll(corners, -1, axis=0), strict=True)


@pytest.mark.parametrize("kind", [*SOLIDS, "hex8", "hex20"])
def test_faces_point_outward_and_close_the_element(kind):
    nodes = el.reference(kind).nodes
    total = np.zeros(3)
    for face in el.FACES[kind]:
        corners = nodes[list(face[: 3 if len(face) in (3, 6) else 4])]
        area = 0.5 * sum(np.cross(a, b) for a, b in _sides(corners))
        assert area @ (corners.mean(0) - nodes.mean(0)) > 0.0
        total += area
        # each mid node lies between two corners that follow one another
        count = len(corners)
        middles = nodes[list(face[count:])]
        assert np.allclose(middles, 0.5 * (corners + np.roll(corners, -1, axis=0))[: len(middles)])
    assert np.allclose(total, 0.0)


def test_bernstein_coefficients_of_a_shear_are_one():
    # x -> (x, y + x^2 / 2 + x z, z + x^2): det J = 1 everywhere, so all coefficients are 1
    for kind in ("tet10", "penta15"):
        x, y, z = el.reference(kind).nodes.T
        nodes = np.column_stack([x, y + 0.5 * x**2, z + x**2])[None]
        coefficients, rounding = ej.bernstein_coefficients(kind, nodes)
        assert coefficients.shape[1] == {"tet10": 20, "penta15": 90}[kind]
        assert np.abs(coefficients - 1.0).max() <= rounding[0] < 1e-12
        assert ej.prove_positive(kind, nodes).proved.all()
        half = {"tet10": 6, "penta15": 2}[kind]
        assert ej.volumes(kind, nodes)[0] == pytest.approx(1.0 / half, rel=1e-14)


def random_elements(kind, amplitude, count=3000):
    nodes = el.reference(kind).nodes
    noise = np.random.default_rng(3).normal(size=(count, len(nodes), 3))
    return nodes + amplitude * noise


@pytest.mark.parametrize("kind", ["tet10", "penta15"])
def test_proofs_agree_with_samples(kind):
    nodes = random_elements(kind, 0.09)
    proof = ej.prove_positive(kind, nodes)
    points = np.concatenate(
        [el.quadrature(shape(kind), 6)[0], el.reference(kind).nodes, inside(kind, 200)]
    )
    if shape(kind) == "penta":
        points[-200:, 2] *= 3.0
    sampled = np.linalg.det(el.jacobians(kind, nodes, points)).min(axis=1)
    assert (sampled[proof.status == ej.VALID] >= proof.lower_bound[proof.status == ej.VALID]).all()
    assert (proof.lower_bound[proof.status == ej.VALID] > 0.0).all()
    assert (proof.status[sampled < 0.0] != ej.VALID).all()
    # both kinds of answer occur, and few elements stay open
    assert np.count_nonzero(proof.status == ej.VALID) > 500
    assert np.count_nonzero(proof.status == ej.INVALID) > 300
    assert np.count_nonzero(proof.status == ej.UNDECIDED) <= 3


@pytest.mark.parametrize("kind", SOLIDS)
def test_mirrored_flat_and_far_away_elements(kind):
    nodes = el.reference(kind).nodes
    mirrored, flat = nodes * [1, 1, -1], nodes * [1, 1, 0]
    far = 1e-3 * nodes + [1000.0, -2000.0, 500.0]
    proof = ej.prove_positive(kind, np.stack([nodes, mirrored, flat, far]))
    assert proof.status.tolist() == [ej.VALID, ej.INVALID, ej.UNDECIDED, ej.VALID]
    quality = ej.scaled_jacobian(kind, np.stack([nodes, mirrored, flat]))
    assert quality[0] > 0.5 and quality[1] < -0.5 and abs(quality[2]) < 1e-12


def test_a_midside_node_past_the_quarter_point_is_found():
    # an edge of a quadratic element folds when its mid node leaves the middle half
    for kind in ("tet10", "penta15"):
        node = el.reference(kind).corners
        for place, status in ((0.26, ej.VALID), (0.24, ej.INVALID)):
            nodes = el.reference(kind).nodes.copy()
            nodes[node, 0] = place
            assert ej.prove_positive(kind, nodes[None]).status[0] == status


def test_regular_elements_have_quality_one():
    height = np.sqrt(3.0) / 2.0
    triangle = np.array([[0, 0, 0], [1, 0, 0], [0.5, height, 0]])
    wedge = np.concatenate([triangle, triangle + [0, 0, 1]])
    tet = np.concatenate([triangle, [[0.5, height / 3.0, np.sqrt(2.0 / 3.0)]]])
    assert ej.scaled_jacobian("penta6", wedge[None])[0] == pytest.approx(1.0)
    assert ej.scaled_jacobian("tet4", tet[None])[0] == pytest.approx(1.0)
    bound = ej.prove_positive("tet4", tet[None]).lower_bound
    assert ej.relative_bound("tet4", tet[None], bound)[0] == pytest.approx(1.0 / np.sqrt(2.0))
