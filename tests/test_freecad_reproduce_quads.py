# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""``./run.sh reproduce quads``: a few small cases through their processes, kept and told."""

import json

import pytest

from HybridVolume.errors import SetupError

try:
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
except SetupError as missing:
    pytest.skip(missing.message, allow_module_level=True)

from HybridVolume.reproduce import main

CASES = ["limit-torus", "exactness-quads", "broken-open", "smoothness-spindle-6"]


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("quads")
    assert main(["quads", "-o", str(folder), "--only", *CASES]) == 0
    return folder


def test_figures_are_written(made):
    found = json.loads((made / "quads.json").read_text())
    assert not found["not_done"]
    assert all(row["met"] for row in found["demands"])
    assert len(found["demands"]) == len(CASES)
    (broken,) = found["broken"]
    assert broken["code"] == 2
    assert "11-16" in broken["said"]
    (smooth,) = found["smoothness"]
    assert smooth["valences"]["6"]["vertices"] == 2
    text = (made / "quads.md").read_text()
    assert "4 of 4 demands are met" in text
    assert broken["said"] in text


def test_finished_cases_are_kept(made, capsys):
    before = (made / "cases" / "broken-open.json").stat().st_mtime_ns
    assert main(["quads", "-o", str(made), "--only", *CASES]) == 0
    assert "4 of 4 cases finished before" in capsys.readouterr().out
    assert (made / "cases" / "broken-open.json").stat().st_mtime_ns == before


def test_an_unknown_case_is_refused(tmp_path, capsys):
    assert main(["quads", "-o", str(tmp_path), "--only", "sheep"]) == 2
    assert "sheep: no such part or case" in capsys.readouterr().err
