# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Volumes of bodies with NURBS faces: exact NURBS elements at the boundary, tetrahedra in the core.

What macros and scripts use::

    import HybridVolume
    body = HybridVolume.read_step("fandisk.step")[0]
    part = HybridVolume.read_step("drilled.step", cover_tolerance=0.01)[0]    # any faces, mm
    part.origin["geometry"]["sentence"]                  # what became of its faces
    volume = HybridVolume.complete(body, w0=0.5)
    volume = HybridVolume.complete(body, thickness="2 mm", face_factors={"Face3": 1.5}, layers=4,
                                   spacing="first 0.2 mm")
    volume.report["sentence"], volume.report["faces"]    # what was reached
    mesh = HybridVolume.to_fem(volume, FreeCAD.ActiveDocument)
    finer = HybridVolume.remesh(volume, size=1.0, face_sizes={"Face3": 0.2})
    HybridVolume.export_mesh(volume, "fandisk.med")      # or .inp, .unv, .msh, .vtu
    HybridVolume.export_shell(volume, "fandisk.mesh")    # MFEM; .xml: G+Smo; the core beside it

    cage = HybridVolume.import_mesh("fish.obj", scheme="catmull-clark")[0]    # keeps its mesh
    cage.Scheme = "smooth"

    result = HybridVolume.analysis.elasticity(volume, fixed={"Face1": 0.0}, pressure={"Face2": 5.0})
    result.save_vtu("pressed.vtu")                       # ParaView, on the exact shell and core

    mid = HybridVolume.edit_midstructure(FreeCAD.ActiveDocument.getObject("Midstructure"))
    mid.remove(faces=("Face3", "Face9"))

Importing the package loads nothing else; each function is loaded at its first use.
"""

from __future__ import annotations

import importlib
from typing import Any

__version__ = "0.1.0"

version = __version__

_FUNCTIONS = {
    "complete": "scripting",
    "edit_midstructure": "scripting",
    "edit_volume": "scripting",
    "export_mesh": "scripting_fem",
    "export_shell": "scripting_fem",
    "export_step": "scripting_fem",
    "find_midstructure": "scripting",
    "import_mesh": "scripting",
    "make_analysis": "scripting_fem",
    "medial_axis": "scripting",
    "read_mesh": "scripting",
    "read_step": "scripting",
    "recover_stress": "scripting_fem",
    "remesh": "scripting_fem",
    "solve": "scripting_fem",
    "to_document": "scripting",
    "to_fem": "scripting_fem",
}
"""What macros call, and the module of each."""

__all__ = [*_FUNCTIONS, "analysis", "version"]


def __getattr__(name: str) -> Any:
    if name == "analysis":
        return importlib.import_module(f"{__name__}.analysis")
    if name in _FUNCTIONS:
        return getattr(importlib.import_module(f"{__name__}.{_FUNCTIONS[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
