# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME.msh, read by Gmsh."""

import json
import subprocess
import sys

import pytest
from shells import make_volume

from HybridVolume.exports.msh import write_msh

# in a process of its own: Gmsh keeps state, and takes over signals
READ = """
import json, sys
import gmsh
import numpy as np
gmsh.initialize(["gmsh", "-v", "0"])
gmsh.open(sys.argv[1])
found = {"groups": {}, "volume": 0.0, "least": 1e300, "errors": gmsh.logger.getLastError()}
for dimension, tag in gmsh.model.getPhysicalGroups():
    name = gmsh.model.getPhysicalName(dimension, tag)
    count = 0
    for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
        kinds, elements, _ = gmsh.model.mesh.getElements(dimension, entity)
        count += sum(len(e) for e in elements)
        for kind in kinds:
            points, weights = gmsh.model.mesh.getIntegrationPoints(kind, "Gauss8")
            _, det, _ = gmsh.model.mesh.getJacobians(kind, points, entity)
            size = det.reshape(-1, len(weights)) @ weights
            found.setdefault(f"{name} size", 0.0)
            found[f"{name} size"] += float(size.sum())
            if dimension == 3:
                found["least"] = min(found["least"], float(det.min()))
    found["groups"][name] = count
found["nodes"] = len(gmsh.model.mesh.getNodes()[0])
gmsh.finalize()
print(json.dumps(found))
"""


@pytest.mark.parametrize("name, order", [("torus", 2), ("hollow sphere", 1)])
def test_gmsh_reads_the_same_mesh(tmp_path, name, order):
    pytest.importorskip("gmsh")
    fem = make_volume(name, order).fem
    path = tmp_path / "body.msh"
    write_msh(path, fem)
    answer = subprocess.run(
        [sys.executable, "-c", READ, str(path)], capture_output=True, text=True, check=True
    )
    found = json.loads(answer.stdout.splitlines()[-1])
    assert found["errors"] == "" and found["nodes"] == len(fem.nodes)
    expected = {face: len(fem.face_triangles(face)) for face in fem.face_names}
    expected |= {"Shell": len(fem.wedges), "Core": len(fem.tets), "Interface": len(fem.interface)}
    assert found["groups"] == expected
    # orientation and order of nodes: another one would fold elements or change their volumes
    assert found["least"] > 0.0
    assert found["Shell size"] == pytest.approx(fem.shell_volume, rel=1e-9)
    assert found["Core size"] == pytest.approx(fem.core_volume, rel=1e-9)
