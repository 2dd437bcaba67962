# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""HybridVolume.analysis: exact solutions through the public functions, results at points, files."""

import bodies
import numpy as np
import pytest
import shells

import HybridVolume
from HybridVolume import analysis
from HybridVolume.core.analysis.hybrid_space import hybrid_space
from HybridVolume.core.assembly import build_surface
from HybridVolume.core.interior import build_interface, fill_interior
from HybridVolume.errors import FaultError, InputError
from HybridVolume.exports.solution_picture import solution_scene
from HybridVolume.exports.solution_vtu import SolutionFile, write_pvd

SIZE = np.array([3.0, 2.0, 1.0])
SLOPE = np.array([0.9, -0.4, 1.3])
STEEL = analysis.Material(210000.0, 0.3)


@pytest.fixture(scope="module")
def box():
    """A box whose interface is flat: Nitsche's form is exact for linear fields."""
    surface = build_surface(list(bodies.box(SIZE, (1, 1, 1)).faces))
    shell = shells.shell_towards(surface, lambda x: x + 0.5 * (0.5 * SIZE - x), layers=1)
    interface = build_interface(shell)
    return hybrid_space(shell, interface, fill_interior(interface), coupling="nitsche")


@pytest.fixture(scope="module")
def ball():
    shell = shells.make_shell("sphere")
    interface = build_interface(shell)
    return hybrid_space(shell, interface, fill_interior(interface))


@pytest.fixture(scope="module")
def face(box):
    """The CAD face at the lower (0) and the upper (1) end of each axis."""
    surface = box.spline.shell.surface
    found = {}
    for patch in surface.patches:
        x = surface.control_points[patch.index].reshape(-1, 3)
        (axis,) = np.flatnonzero(np.ptp(x, axis=0) == 0.0)
        found[int(axis), int(x[0, axis] > 0.0)] = patch.face
    return found


@pytest.fixture(scope="module")
def pulled(box, face):
    """A uniaxial stress of 70 MPa along x: 140 N over 2 mm²."""
    slide = {
        face[0, 0]: (0.0, None, None),
        face[1, 0]: (None, 0, None),
        face[2, 0]: (None, None, 0),
    }
    return analysis.elasticity(box, STEEL, fixed=slide, force={face[0, 1]: (140.0, 0.0, 0.0)})


def inside(count=40):
    return np.random.default_rng(3).uniform(0.01, 0.99, (count, 3)) * SIZE


def in_ball(count=60):
    x = np.random.default_rng(4).normal(size=(count, 3))
    radius = np.random.default_rng(5).uniform(0.0, 1.0, (count, 1)) ** (1.0 / 3.0)
    return x / np.linalg.norm(x, axis=1, keepdims=True) * radius


def test_a_pulled_bar_at_points_and_faces(pulled, face):
    x = inside()
    strain = 70.0 / 210000.0 * np.array([1.0, -0.3, -0.3])
    assert np.abs(pulled.displacement(x) - x * strain).max() < 1e-14
    assert pulled.stress(x) == pytest.approx(np.outer(np.ones(40), [70, 0, 0, 0, 0, 0]), abs=1e-8)
    assert pulled.strain(x)[:, :3] == pytest.approx(np.outer(np.ones(40), strain), abs=1e-13)
    assert pulled.von_mises(face[1, 1]) == pytest.approx(70.0, rel=1e-10)
    assert pulled.principal(x)[:, 0] == pytest.approx(70.0, rel=1e-10)
    assert pulled.displacement(face[0, 1])[:, 0] == pytest.approx(0.001, rel=1e-11)
    assert pulled.positions(face[0, 1])[:, 0] == pytest.approx(3.0, rel=1e-14)
    assert pulled.reaction(face[0, 0])[0] == pytest.approx(-140.0, rel=1e-10)
    assert pulled.energy == pytest.approx(0.5 * 140.0 * 0.001, rel=1e-10)
    assert pulled.figures.residual < 1e-10 and pulled.figures.unknowns < 3 * pulled.space.size


def test_pressure_all_around_needs_no_support(box):
    soft = analysis.Material(1000.0, 0.25)
    found = analysis.elasticity(box, soft, pressure=2.0, balanced=True)
    x = inside()
    # p = 3 K e, and no rigid motion: the middle stays
    exact = -2.0 * (1.0 - 0.5) / 1000.0 * (x - 0.5 * SIZE)
    assert np.abs(found.displacement(x) - exact).max() < 1e-13
    assert found.stress(x)[:, :3] == pytest.approx(-2.0, rel=1e-9)
    with pytest.raises(InputError, match="do not balance: .* N act.*fix a face"):
        analysis.elasticity(box, soft, body_force=(0.0, 0.0, -1.0), balanced=True)


def test_weight_of_two_materials_is_the_reaction(box, face):
    soft = analysis.Material(70000.0, 0.3)
    held = face[2, 0]
    weight = {"density": (8e-9, 3e-9), "acceleration": (0.0, 0.0, -9810.0)}
    found = analysis.elasticity(box, STEEL, core_material=soft, fixed={held: 0.0}, **weight)
    # the core is the box of half the size
    expected = 9810.0 * (8e-9 * 6.0 * 7.0 / 8.0 + 3e-9 * 6.0 / 8.0)
    assert found.reaction(held) == pytest.approx([0.0, 0.0, expected], rel=1e-9, abs=1e-12)
    # the stress jumps at the interface, each side with its own material
    assert found.von_mises(inside()).min() > 0.0


def test_heat_through_a_wall(box, face):
    # 5 W over 2 mm² come in at x = 3, the far end is kept at 20 degrees, nothing passes the sides
    found = analysis.poisson(
        box, fixed={face[0, 0]: 20.0}, flux={face[0, 1]: 2.5}, conductivity=0.5
    )
    x = inside()
    assert found.at(x) == pytest.approx(20.0 + 5.0 * x[:, 0], rel=1e-11)
    assert found.flux(x) == pytest.approx(np.outer(np.ones(40), [-2.5, 0.0, 0.0]), abs=1e-9)
    assert found.at(face[0, 1]) == pytest.approx(35.0, rel=1e-11)
    # a source, with a parabola that quadratics hold: u = x (3 - x) / 2 between cold ends
    warm = {face[0, 0]: 0.0, face[0, 1]: lambda p: np.zeros(len(p))}
    parabola = analysis.poisson(box, fixed=warm, source=1.0)
    assert parabola.at(x) == pytest.approx(0.5 * x[:, 0] * (3.0 - x[:, 0]), abs=1e-10)


def test_points_of_a_ball_are_found(ball):
    found = analysis.poisson(ball, fixed=lambda x: x @ SLOPE + 2.0)
    x = in_ball()
    places = found.find(x)
    met = places.distance < 1e-9
    # the slit between the core's faces and the inner surface is all that is not met
    assert met.mean() > 0.9 and places.distance.max() < 5e-3
    assert np.abs(found.positions(places) - x)[met].max() < 1e-9
    assert found.at(places) == pytest.approx(x @ SLOPE + 2.0, abs=0.02)
    on = found.positions(ball.spline.face_names[2])
    assert np.linalg.norm(on, axis=1) == pytest.approx(1.0, abs=1e-13)
    assert found.at(ball.spline.face_names[2]) == pytest.approx(on @ SLOPE + 2.0, abs=2e-4)
    with pytest.raises(
        InputError, match=r"1 of 2 points are outside.*by up to 0\.5 mm.*first is 1"
    ):
        found.at([[0.0, 0.0, 0.2], [0.0, 1.5, 0.0]])


def test_every_point_outside_is_refused(ball):
    # the nearest place of a point outside may well be inside, on the side of an element
    found = analysis.poisson(ball, fixed=lambda x: x @ SLOPE)
    x = np.random.default_rng(6).uniform(-1.3, 1.3, (1500, 3))
    radius = np.linalg.norm(x, axis=1)
    x = x[np.abs(radius - 1.0) > 0.01]
    count = int(np.count_nonzero(np.linalg.norm(x, axis=1) > 1.0))
    assert 500 < count < len(x) - 200
    with pytest.raises(InputError, match=f"{count} of {len(x)} points are outside"):
        found.at(x)
    assert np.isfinite(found.at(x[np.linalg.norm(x, axis=1) < 1.0])).all()


def read_vtu(path):
    vtk = pytest.importorskip("vtk")
    reader = vtk.vtkXMLUnstructuredGridReader()
    reader.SetFileName(str(path))
    reader.Update()
    return vtk, reader.GetOutput()


def located(vtk, grid, cell, local, name):
    """Point and value of a cell by VTK's own functions."""
    from vtk.util.numpy_support import vtk_to_numpy

    found = grid.GetCell(cell)
    count = found.GetNumberOfPoints()
    x, weights = [0.0] * 3, [0.0] * count
    found.EvaluateLocation(vtk.reference(0), local, x, weights)
    ids = [found.GetPointId(k) for k in range(count)]
    return np.array(x), np.array(weights) @ vtk_to_numpy(grid.GetPointData().GetArray(name))[ids]


@pytest.mark.parametrize("degree", [2, 3])
def test_vtk_has_the_solution_itself(ball, degree, tmp_path):
    both = ball
    if degree == 3:
        shell = shells.make_shell("box")
        interface = build_interface(shell)
        both = hybrid_space(
            shell, interface, fill_interior(interface), degree=3, coupling="nitsche"
        )
    wave = analysis.poisson(both, fixed=lambda x: np.sin(x @ SLOPE))
    wave.save_vtu(tmp_path / "wave.vtu")
    vtk, grid = read_vtu(tmp_path / "wave.vtu")
    cells = len(wave.shown.cells)
    assert grid.GetNumberOfCells() == cells + len(both.tets.elements)
    local = (0.3, 0.2, 0.4)
    for cell in range(0, grid.GetNumberOfCells(), 23):
        x, value = located(vtk, grid, cell, local, "temperature")
        # the map and the field of the same cell by the program's own functions
        if cell < cells:
            batches = wave.shown.cells.batches
            owner = [n for batch in batches for n in batch.element][cell]
            element = np.array([owner]), np.array([local])
            own = wave.shown.cells.at(*element, wave.field.shell)[0]
            here = wave.shown.cells.at(*element, wave._map.shell)[0]
        else:
            from HybridVolume.core.analysis.simplex_space import shape_functions

            values, _ = shape_functions(degree, np.array([local]))
            members = both.tets.elements[cell - cells]
            own, here = (values @ f.core[members] for f in (wave.field, wave._map))
        assert x == pytest.approx(here.ravel(), abs=1e-13)
        assert value == pytest.approx(own.ravel()[0], abs=1e-13)


def test_a_series_for_paraview(pulled, tmp_path):
    file = SolutionFile(pulled.shown)
    steps = []
    for number, time in enumerate((0.0, 0.25)):
        name = tmp_path / f"step{number}.vtu"
        fields = {"displacement": time * pulled.solution.values, "stress": pulled.stress_field}
        file.write(name, fields, time=time)
        steps.append((time, name))
    write_pvd(tmp_path / "series.pvd", steps)
    text = (tmp_path / "series.pvd").read_text()
    assert 'timestep="0.25" part="0" file="step1.vtu"' in text
    _, grid = read_vtu(steps[1][1])
    assert grid.GetFieldData().GetArray("TimeValue").GetValue(0) == 0.25
    stress = grid.GetPointData().GetArray("stress")
    names = [stress.GetComponentName(k) for k in range(6)]
    assert names == ["XX", "YY", "ZZ", "XY", "YZ", "XZ"]
    assert stress.GetRange(0) == pytest.approx((70.0, 70.0), rel=1e-9)
    with pytest.raises(InputError, match="step9.vtu is not there"):
        write_pvd(tmp_path / "bad.pvd", [(0.0, tmp_path / "step9.vtu")])
    with pytest.raises(InputError, match="holds no field of"):
        file.write(tmp_path / "bad.vtu", {"short": np.zeros(3)})
    with pytest.raises(FaultError, match="not finite"):
        file.write(tmp_path / "bad.vtu", {"bad": np.full(pulled.space.size, np.nan)})
    assert not (tmp_path / "bad.pvd").exists() and not (tmp_path / "bad.vtu").exists()


def test_a_picture_shows_the_body_cut_open(ball):
    found = analysis.poisson(ball, fixed=lambda x: x @ SLOPE)
    scene = solution_scene(found.shown, found.field, "temperature", cut=True)
    outside, cut = scene.skins
    used = np.unique(outside.triangles)
    on = outside.points[used]
    radius = np.linalg.norm(on, axis=1)
    assert radius.min() > 0.995 and radius.max() < 1.0 + 1e-12
    assert outside.values[used] == pytest.approx(on @ SLOPE, abs=5e-3)
    corners = cut.points[cut.triangles]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    offset = 0.0137 * 2.0 * 3.0**0.5
    # the slit and overlaps at the interface are less than what is allowed here
    assert 0.5 * np.linalg.norm(area, axis=1).sum() == pytest.approx(
        np.pi * (1.0 - offset**2), rel=0.01
    )


def test_bad_use_is_one_sentence(box, ball, face):
    nan = float("nan")
    held = {face[0, 0]: 0.0}
    for call, words in (
        (lambda: analysis.poisson(None, fixed=1.0), "a NoneType is no hybrid volume; give the re"),
        (lambda: analysis.poisson(box, fixed={}), "no temperature is given"),
        (lambda: analysis.poisson(box, fixed={"Face99": 1.0}), "Face99: no such face"),
        (lambda: analysis.poisson(box, fixed=nan), r"fixed of Face\d: a value is not finite"),
        (lambda: analysis.poisson(box, fixed=(1.0, 2.0)), r"\(1.0, 2.0\) has shape \(2,\)"),
        (lambda: analysis.poisson(box, fixed=lambda x: x), r"returns shape \(\d+, 3\) for"),
        (lambda: analysis.poisson(box, fixed=1.0, conductivity=-1.0), "a conductivity of -1"),
        (lambda: analysis.poisson(box, fixed=1.0, degree=3), "degree: the space is already made"),
        (lambda: analysis.elasticity(box), "nothing is fixed"),
        (lambda: analysis.elasticity(box, "steel", fixed=held), "'steel' is no material"),
        (lambda: analysis.elasticity(box, fixed=held, force=(1.0, 0, 0)), "no face is named"),
        (lambda: analysis.elasticity(box, fixed=held, pressure={face[0, 1]: nan}), "not finite"),
        (
            lambda: analysis.elasticity(box, fixed=held, traction={face[0, 1]: 3.0}),
            r"traction of Face\d: 3.0 has shape \(\).*give 3 numbers",
        ),
        (
            lambda: analysis.elasticity(box, fixed=held, acceleration=(0, 0, -9810)),
            "an acceleration needs a density",
        ),
        (lambda: analysis.modal(box, count=0), "0 modes"),
        (lambda: analysis.space("nowhere.npz"), "nowhere.npz does not exist"),
    ):
        with pytest.raises(InputError if "exist" not in words else Exception, match=words) as told:
            call()
        assert "\n" not in str(told.value)
    free = {face[0, 0]: (0.0, None, None)}
    with pytest.raises(InputError, match="leave the body 3 rigid motions.*cannot move freely"):
        analysis.elasticity(box, fixed=free, force={face[0, 1]: (1.0, 0.0, 0.0)})


def test_analysis_is_reached_from_the_package():
    assert HybridVolume.analysis is analysis and "analysis" in dir(HybridVolume)
