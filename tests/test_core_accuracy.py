# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The exact fields of the accuracy cases, their loads on meshes, and the errors told of them."""

import numpy as np
import pytest
from bodies import box
from shells import make_volume

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.recovery import tensor
from HybridVolume.reproduce.fem_accuracy_table import as_markdown, demands, nodes_needed
from HybridVolume.reproduce.fem_measure import measure, prepare, traction_forces
from HybridVolume.reproduce.fem_mesh import Meshed
from HybridVolume.reproduce.fem_problems import MAKERS, Problem, problem

STEP = 1e-4


def _inside(name: str, count: int = 40) -> np.ndarray:
    """Points in the body, off its faces."""
    rng = np.random.default_rng(5)
    r, a, b = rng.uniform([1.05, 0.05, 0.0], [1.95, 1.5, 6.0], (count, 3)).T
    if name in ("cylinder", "plate"):
        return np.column_stack([r * np.cos(a), r * np.sin(a), rng.uniform(0.1, 0.9, count)])
    if name == "sphere":
        way = np.column_stack([np.cos(a), np.sin(a) * np.cos(b), np.sin(a) * np.sin(b)])
        return way * r[:, None]
    if name == "cantilever":
        return rng.uniform([1.0, -0.9, -0.9], [9.0, 0.9, 0.9], (count, 3))
    across = 3.0 + (r - 1.0) * np.cos(a * 4.0)
    height = (r - 1.0) * np.sin(a * 4.0)
    return np.column_stack([across * np.cos(b), across * np.sin(b), height])


def _slope(field, x: np.ndarray) -> np.ndarray:
    """Central differences, (m, components, 3)."""
    steps = STEP * np.eye(3)
    return np.stack([(field(x + s) - field(x - s)) / (2.0 * STEP) for s in steps], axis=2)


@pytest.mark.parametrize("name", list(MAKERS))
def test_field_is_an_equilibrium_of_its_displacement(name):
    case, x = problem(name), _inside(name)
    slope = _slope(case.displacement, x)
    strain = 0.5 * (slope + slope.swapaxes(1, 2))[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]
    stress = case.stress(x)
    assert np.abs(case.material.stress(strain) - stress).max() < 1e-6 * case.scale
    along = _slope(case.stress, x)
    rows = [[0, 3, 4], [3, 1, 5], [4, 5, 2]]
    force = np.stack([sum(along[:, c, k] for k, c in enumerate(row)) for row in rows], axis=1)
    assert np.abs(force + case.weight).max() < 1e-6 * case.scale


@pytest.mark.parametrize("name", list(MAKERS))
def test_tractions_are_those_of_the_stress(name):
    case = problem(name)
    surface = build_surface(list(case.body.faces))
    assert surface.volume() == pytest.approx(case.body.volume, rel=1e-12)
    u, v = (a.ravel() for a in np.meshgrid([0.13, 0.5, 0.81], [0.21, 0.66]))
    role_of = {face: role for role, faces in case.body.roles.items() for face in faces}
    for number, patch in enumerate(surface.patches):
        role = role_of[patch.face]
        x, x_u, x_v = surface.evaluate_at(np.full(u.size, number), u, v, derivative=1)
        normal = np.cross(x_u, x_v)
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        found = np.einsum("mij,mj->mi", tensor(case.stress(x)), normal)
        wanted = np.zeros_like(x)
        if role in case.tractions:
            wanted = case.tractions[role](x, normal)
        free = [k for k in range(3) if k not in case.held.get(role, ())]
        assert np.abs(found - wanted)[:, free].max(initial=0.0) < 2e-5 * case.scale


def _uniform(name: str = "uniform") -> Problem:
    """The box of the shells under uniform stress: no element makes an error."""
    from HybridVolume.core.recovery import Material
    from HybridVolume.reproduce.fem_bodies import FemBody

    material = Material(200.0, 0.25)
    strain = np.array([1e-3, -2e-3, 5e-4, 3e-4, 0.0, -1e-4])
    matrix = tensor(strain[None])[0]
    stress = material.stress(strain[None])[0]
    faces = box((3.0, 2.0, 1.0), (4, 3, 2)).faces
    ends = ("Face1",)
    rest = tuple(f.name for f in faces if f.name not in ends)
    return Problem(
        name,
        name,
        FemBody("box", tuple(faces), {"root": ends, "rest": rest}, 6.0),
        lambda x: x @ matrix.T,
        lambda x: np.tile(stress, (len(x), 1)),
        ("rest",),
        tractions={"rest": lambda x, n: n @ tensor(stress[None])[0]},
        held={"root": (0, 1, 2)},
        material=material,
        peak_at=np.zeros((1, 3)),
    )


def test_exact_answer_has_no_error_and_a_wrong_one_has_its_own():
    case = _uniform()
    mesh = Meshed.of(make_volume("box").fem)
    ready = prepare(case, mesh)
    root = mesh.face_nodes("Face1")
    assert np.array_equal(np.flatnonzero(~np.isnan(ready.prescribed[:, 0])), root)
    # what pulls at five faces is what the sixth holds: stress times its area along its normal
    pull = tensor(case.stress(np.zeros((1, 3))))[0] @ [1.0, 0.0, 0.0] * 2.0
    assert ready.forces.sum(axis=0) == pytest.approx(pull, rel=1e-9)
    u = case.displacement(mesh.nodes)
    exact = case.stress(mesh.nodes)
    found = measure(ready, u, {"same": exact, "more": 1.1 * exact})
    assert found["nodes"] == len(mesh.nodes)
    assert max(found["displacement"], found["energy"]) < 1e-6
    assert found["same"] == pytest.approx({"rms": 0.0, "max": 0.0, "peak": 0.0}, abs=1e-9)
    assert found["more"] == pytest.approx({"rms": 10.0, "max": 10.0, "peak": 10.0}, rel=1e-9)
    assert measure(ready, 1.02 * u, {})["displacement"] == pytest.approx(2.0, rel=1e-9)
    assert measure(ready, 1.02 * u, {})["energy"] == pytest.approx(2.0, rel=1e-9)


def test_pressure_on_a_curved_closed_surface_is_its_volume():
    fem = make_volume("sphere").fem
    mesh = Meshed.of(fem)
    kind, triangles = mesh.triangles(*mesh.faces)
    forces = traction_forces(mesh.nodes, kind, triangles, lambda x, n: -n)
    assert np.abs(forces.sum(axis=0)).max() < 1e-12
    # divergence theorem: the sum of force times place is -3 volumes of the elements
    assert np.sum(forces * mesh.nodes) == pytest.approx(-3.0 * fem.volume, rel=1e-10)


def _rows(nodes, errors):
    figures = [{"rms": e, "max": 2.0 * e, "peak": 0.1 * e} for e in errors]
    return [
        {"nodes": n, "displacement": f["rms"], "energy": f["rms"], "ccx": f, "recovered": f,
         "unproved": 0}
        for n, f in zip(nodes, figures, strict=True)
    ]  # fmt: skip


def test_nodes_needed_follow_the_power_of_the_error():
    # an error of 100 / n passes 1 at n = 100
    inner = _rows([50, 200, 800], [2.0, 0.5, 0.125])
    assert nodes_needed(inner, "ccx", "rms") == (pytest.approx(100.0), True)
    outer = _rows([10, 20, 40], [10.0, 5.0, 2.5])
    assert nodes_needed(outer, "ccx", "rms") == (pytest.approx(100.0), False)
    # not where an error falls below the bound and rises again
    wavy = _rows([50, 100, 200, 800], [2.0, 0.5, 2.0, 0.5])
    assert nodes_needed(wavy, "ccx", "rms") == (pytest.approx(400.0), True)
    assert np.isnan(nodes_needed(_rows([10, 20], [2.0, 3.0]), "ccx", "rms")[0])


def test_table_and_demands_compare_with_graded_tets():
    cases = [
        {"problem": "p", "words": "words", "mesher": mesher, "rows": rows}
        for mesher, rows in (
            ("hybrid", _rows([50, 200], [2.0, 0.5])),
            ("tet10-graded", [*_rows([200, 800], [2.0, 0.5]), {"asked": {}, "error": "no mesh"}]),
        )
    ]
    text = as_markdown(cases)
    assert "| p | rms | 100 | 400 | 400 | 0.25 | 0.25 |" in text
    assert "no mesh" in text
    met = {row["demand"]: row["met"] for row in demands(cases)}
    assert [met[k] for k in met if "rms" in k] == [True]
    assert [met[k] for k in met if "max" in k] == [False]
    assert [met[k] for k in met if "Mises" in k] == [True]
