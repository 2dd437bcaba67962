# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""CPU seconds of FreeCAD's part of a large FEM mesh: checked, built, inserted, saved, opened.

``/usr/bin/python3 bench/fem_object.py resources/examples/fandisk.step --subdivide 3 [--size 0.2]``
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

PROJECT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PROJECT))

LIMIT = 5.0
"""Seconds that the object may take at 100k nodes."""


@contextmanager
def clock(name: str):
    """Print the CPU seconds of what is inside."""
    started = time.process_time()
    yield
    print(f"{name:44s} {time.process_time() - started:7.2f} s")


def main() -> int:
    """Mesh a body finely and take the times."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("body", type=Path)
    parser.add_argument("--subdivide", type=int, default=1)
    parser.add_argument("--size", type=float, default=0.0)
    parser.add_argument("--volume", type=Path, help="a stored volume of the body; else it is made")
    arguments = parser.parse_args()
    from HybridVolume.freecad_python import import_freecad

    FreeCAD = import_freecad()
    import HybridVolume
    from HybridVolume import sources
    from HybridVolume.core.hybrid import HybridVolume as Volume
    from HybridVolume.job import Job
    from HybridVolume.objects import document, fem_mesh
    from HybridVolume.objects.volume import parameters_of, source_fingerprint
    from HybridVolume.report import volume_report

    (body,) = sources.read_file(arguments.body)
    given = arguments.volume
    fine = Volume.load(given) if given else HybridVolume.complete(body)
    options = {"subdivide": arguments.subdivide, "size": arguments.size}
    if arguments.subdivide > 1 or arguments.size:
        with Job([], goal="mesh", volume=fine, options=options) as job:
            fine = job.run()
    fem = fine.fem
    print(f"{len(fem.nodes)} nodes, {len(fem.wedges)} wedges, {len(fem.tets)} tets")
    with tempfile.TemporaryDirectory() as folder:
        result = Path(folder) / "result.npz"
        fine.save(result)
        doc = FreeCAD.newDocument("bench")
        doc.UndoMode = 1
        source = doc.addObject("Part::Feature", "Body")
        source.Shape = body.shape
        completed = document.Completed(
            body=body,
            solid=1,
            volume=fine,
            result=result,
            report=volume_report(fine, {}, {}),
            parameters=parameters_of(fine),
            fingerprint=source_fingerprint(source),
        )
        with clock("mesh for the analysis alone: built, compared"):
            fem_mesh.build(fem_mesh.arrays_of(fem))
        started = time.process_time()
        with clock("all three meshes: found on the faces, built"):
            prepared = document.Prepared(completed)
        with clock("put into the document"):
            (obj,) = document.insert(doc, source, [prepared])
        total = time.process_time() - started
        with clock("quality of every element, from FreeCAD's mesh"):
            fem_mesh.element_quality(obj.FemMesh.FemMesh)
        path = str(Path(folder) / "bench.FCStd")
        with clock("saved"):
            doc.saveAs(path)
        FreeCAD.closeDocument(doc.Name)
        with clock("opened"):
            doc = FreeCAD.openDocument(path, hidden=True)
        with clock("compared"):
            wrong = prepared.mesh.differences(doc.HybridVolume)
        for text in wrong:
            print(text)
        print("found on the faces:", prepared.mesh.coverage.figures())
    print(f"objects: {total:.2f} s for {len(fem.nodes)} nodes, limit {LIMIT:g} s at 100k")
    return 1 if wrong or total > LIMIT * max(1.0, len(fem.nodes) / 1e5) else 0


if __name__ == "__main__":
    sys.exit(main())
