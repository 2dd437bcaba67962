# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The whole way without the GPL parts."""

from __future__ import annotations

import sys

import bodies
import pytest

from HybridVolume.core.assembly import build_surface
from HybridVolume.core.pipeline import Options, complete


@pytest.mark.parametrize("body", [bodies.box(spans=(4, 3, 2)), bodies.torus(), bodies.wedge(30.0)])
def test_nothing_under_the_gpl_takes_part(body, monkeypatch):
    monkeypatch.setenv("HYBRIDVOLUME_FREE_ONLY", "1")
    for name in ("CGAL", "gmsh"):
        # an import of these now fails, as where they were left out
        monkeypatch.setitem(sys.modules, name, None)
    volume = complete(build_surface(list(body.faces)), Options(w0=0.5))
    assert volume.interior.mesh.engine == "netgen"
    assert volume.field["mesher"] in ("netgen", "pytetwild")
    assert volume.certificate.all_valid
    assert volume.shell.w0 >= 0.45
    parts = volume.shell.volume() + volume.interior.volume + volume.gap_volume
    assert parts == pytest.approx(body.volume, rel=1e-9)
