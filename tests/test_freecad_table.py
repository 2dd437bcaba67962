# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Real bodies through the command line: what must be reached, and what must be refused.

Volumes and genus were computed by others than this project's code, or are exact.
"""

import json
import math
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from HybridVolume import job
from HybridVolume.errors import SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

PROJECT = Path(__file__).resolve().parent.parent
FANDISK = PROJECT / "resources" / "examples" / "fandisk.step"


def run(body, folder, *options):
    try:
        python = job.worker_python()
    except SetupError as missing:
        pytest.skip(missing.line)
    return subprocess.run(
        [sys.executable, "-P", "-m", "HybridVolume", str(body), "-o", str(folder), *options],
        env={**os.environ, "PYTHONPATH": str(PROJECT), "HYBRIDVOLUME_PYTHON": python},
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        timeout=480,  # other runs go on beside this one
    )


def check(report, volume, genus, least):
    shell = report["shell"]
    assert report["input"]["volume"] == pytest.approx(volume, rel=1e-6)
    assert report["input"]["genus"] == [genus]
    assert shell["valid"] == shell["elements"] > 0
    assert shell["undecided"] == shell["invalid"] == 0
    # det J is proved positive, but for the corners of the given surface where it cannot be
    assert (shell["min_bernstein"] > 0.0) == (shell["valid_inside"] == 0)
    assert shell["embedded"] is True
    assert shell["w0"] >= least
    assert report["interior"]["boundary_exact"] is True
    parts = shell["volume"] + report["interior"]["volume"] + report["interface"]["gap_volume"]
    assert parts == pytest.approx(report["input"]["volume"], rel=1e-9)
    assert report["fem"]["min_scaled_jacobian"] > 0.0
    assert report["fem"]["faces_covered"] == report["input"]["faces"]
    assert shell["boundary_deviation"] <= 1e-12 * report["input"]["volume"] ** (1 / 3)


@pytest.fixture(scope="module")
def fandisk(tmp_path_factory):
    """Folder of the example's results."""
    folder = tmp_path_factory.mktemp("fandisk") / "out"
    answer = run(FANDISK, folder)
    assert answer.returncode == 0, answer.stderr
    return folder


def test_fandisk(fandisk):
    report = json.loads((fandisk / "report.json").read_text())
    assert report["input"]["patches"] == 108
    check(report, 20.240808, 0, 0.4)


needs_ccx = pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX (ccx) is absent")


@needs_ccx
def test_fandisk_deck_is_solved(fandisk, tmp_path):
    shutil.copy(fandisk / "fandisk.inp", tmp_path)
    solved = subprocess.run(
        ["ccx", "fandisk"], cwd=tmp_path, capture_output=True, text=True, timeout=200
    )
    assert solved.returncode == 0, solved.stdout[-2000:]
    assert "nonpositive jacobian" not in solved.stdout
    assert "Job finished" in solved.stdout


@needs_ccx
def test_fandisk_in_the_fem_workbench(fandisk, tmp_path):
    """Two faces at opposite ends, one fixed and one loaded, through FreeCAD's own tools."""
    import FreeCAD
    import ObjectsFem
    from femtools import ccxtools

    path = tmp_path / "fandisk.FCStd"
    shutil.copy(fandisk / "fandisk.FCStd", path)
    doc = FreeCAD.openDocument(str(path))
    try:
        mesh = next(
            o
            for o in doc.Objects
            if o.isDerivedFrom("Fem::FemMeshObject") and "Interface" in getattr(o, "Groups", ())
        )
        body = mesh.Shape
        centre = [face.CenterOfMass.x for face in body.Shape.Faces]
        ends = [centre.index(least(centre)) + 1 for least in (min, max)]
        fixed = ObjectsFem.makeConstraintFixed(doc)
        fixed.References = [(body, f"Face{ends[0]}")]
        pressure = ObjectsFem.makeConstraintPressure(doc)
        pressure.References = [(body, f"Face{ends[1]}")]
        modern = hasattr(ObjectsFem, "makeSolverCalculiXCcxTools")
        pressure.Pressure = "1 MPa" if modern else 1.0
        steel = ObjectsFem.makeMaterialSolid(doc)
        steel.Material = {"Name": "Steel", "YoungsModulus": "210000 MPa", "PoissonRatio": "0.3"}
        make = ObjectsFem.makeSolverCalculiXCcxTools if modern else (
            ObjectsFem.makeSolverCalculixCcxTools
        )  # fmt: skip
        solver = make(doc)
        analysis = ObjectsFem.makeAnalysis(doc)
        for member in (solver, steel, fixed, pressure, mesh):
            analysis.addObject(member)
        doc.recompute()
        tools = ccxtools.FemToolsCcx(analysis, solver)
        tools.update_objects()
        tools.setup_working_dir(str(tmp_path))
        tools.setup_ccx()
        assert tools.check_prerequisites() == ""
        tools.purge_results()
        tools.write_inp_file()
        assert tools.ccx_run() == 0
        tools.load_results()
        result = next(o for o in analysis.Group if o.isDerivedFrom("Fem::FemResultObject"))
        assert len(result.NodeNumbers) == mesh.FemMesh.NodeCount
        bent = max(result.DisplacementLengths)
        # a stiff lump under 1 MPa: more than nothing, less than a hair
        assert 1e-7 < bent < 1e-2
    finally:
        FreeCAD.closeDocument(doc.Name)


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "volume", "genus", "least"),
    [
        ("chair_stand", 0.050042467, 2, 0.45),
        ("terrific_part_02", 0.00371655207, 2, 0.35),
        ("twisted_fichera", 2.15175941, 0, 0.4),
        ("twisted_pipe", 2.07566115, 0, 0.4),
        ("torus", 39.4786933, 1, 0.45),
        # caps of one patch each: four corners of 180 degrees, where det J = 0 for any shell
        ("pole", 2.0 * math.pi, 0, 0.45),
    ],
)
def test_untrimmed_bodies(name, volume, genus, least, shared_data, tmp_path):
    answer = run(shared_data / "untrimmed" / f"{name}.step", tmp_path / "out")
    assert answer.returncode == 0, answer.stderr
    check(json.loads((tmp_path / "out" / "report.json").read_text()), volume, genus, least)


PICTURED = ("singular", "no direction is inward")


@pytest.mark.shared
@pytest.mark.parametrize(
    ("name", "faces", "words"),
    [
        # doubled control points: the derivative vanishes along a line
        ("untrimmed/horseshoe.step", ("Face4", "Face5", "Face6"), "singular"),
        ("untrimmed/g_shape.step", ("Face2", "Face4", "Face5", "Face6"), "singular"),
        ("untrimmed/moebius_torus.step", ("Face1", "Face2"), "no direction is inward"),
        ("untrimmed/tesla_t_junctions.step", ("Face20",), "two neighbours"),
        ("trimmed/trimmed_cube.brep", (), "trimmed"),
        ("trimmed/component8.step", (), "trimmed"),
        ("trimmed/linkrods.step", (), "seam"),
        ("trimmed/as1.step", (), "trimmed"),
    ],
)
def test_refused_by_name(name, faces, words, shared_data, tmp_path):
    answer = run(shared_data / name, tmp_path / "out", "--no-cover")
    assert answer.returncode == 2, answer.stderr
    lines = answer.stderr.strip().splitlines()
    assert len(lines) == 1
    assert lines[0].startswith("error: Face")
    assert words in lines[0]
    for face in faces:
        assert face in lines[0]
    # where the places are known there is a picture of them, and nothing else
    pictures = [f"{Path(name).stem}_refused.png"] if words in PICTURED else []
    assert sorted(p.name for p in (tmp_path / "out").glob("*")) == pictures
    assert (tmp_path / "out").exists() == bool(pictures)
