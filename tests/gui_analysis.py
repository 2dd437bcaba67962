# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""From a completed body to stresses in FreeCAD's real window; test_gui_analysis.py judges."""

import FreeCAD
import FreeCADGui
from gui_midstructure import whole_window
from gui_quality import look_along_x, toolbar
from gui_scenarios import (
    FOLDER,
    click,
    close_panel,
    message_box,
    new_document,
    open_panel,
    screenshot,
    stage,
    wait,
    wait_for,
)


def face_at(shape, x):
    """Name of the face in the plane at some x."""
    return next(
        f"Face{number}"
        for number, face in enumerate(shape.Faces, start=1)
        if all(abs(vertex.X - x) < 1e-9 for vertex in face.Vertexes)
    )


def whole_path(answer):
    """Complete a box, make its analysis, pull at it, solve, show the recovered stresses."""
    doc, box = new_document()
    whole_window()
    open_panel(box)
    click("run")
    wait_for(lambda: stage() == "Done")
    close_panel()
    FreeCADGui.Selection.clearSelection()
    toolbar("HybridVolume_Analysis")
    wait_for(lambda: doc.findObjects("Fem::FemAnalysis"))
    wait_for(lambda: FreeCADGui.activeWorkbench().name() == "FemWorkbench")
    wait(500)
    import FemGui
    import ObjectsFem
    from femtools import ccxtools

    analysis = FemGui.getActiveAnalysis()
    answer["told"] = message_box() is not None
    answer["members"] = sorted(one.TypeId for one in analysis.Group)
    answer["visible"] = sorted(
        one.Name for one in doc.Objects if one.ViewObject and one.ViewObject.Visibility
    )
    fixed = ObjectsFem.makeConstraintFixed(doc)
    fixed.References = [(box, face_at(box.Shape, 0.0))]
    force = ObjectsFem.makeConstraintForce(doc)
    force.References = [(box, face_at(box.Shape, box.Length.Value))]
    force.Force = 1000.0 if FreeCAD.Version()[0] == "0" else "1000 N"
    force.Direction = (box, ["Edge10"])
    analysis.addObjects([fixed, force])
    doc.recompute()
    (solver,) = [one for one in analysis.Group if "Solver" in one.Name]
    run = ccxtools.FemToolsCcx(analysis, solver, test_mode=False)
    run.update_objects()
    run.setup_working_dir(str(FOLDER))
    run.setup_ccx()
    answer["prerequisites"] = run.check_prerequisites()
    run.purge_results()
    run.write_inp_file()
    run.ccx_run()
    run.load_results()
    wait(500)
    steps = doc.UndoCount
    FreeCADGui.runCommand("HybridVolume_Stress")
    wait_for(lambda: doc.getObject("HybridVolume_Results"))
    wait_for(FreeCADGui.Control.activeDialog)
    wait(800)
    answer["undo steps"] = doc.UndoCount - steps
    solved = next(one for one in analysis.Group if one.Name.startswith("CCX"))
    ours = doc.HybridVolume_Results
    middle = [
        row
        for row, number in enumerate(ours.NodeNumbers)
        if 0.3 < ours.Mesh.FemMesh.Nodes[number].x / box.Length.Value < 0.7
    ]
    answer["length"] = max(ours.DisplacementLengths)
    answer["size"] = [box.Length.Value, box.Width.Value, box.Height.Value]
    answer["mises"] = [ours.vonMises[row] for row in middle]
    answer["solver mises"] = [solved.vonMises[row] for row in middle]
    look_along_x()
    FreeCADGui.activeDocument().activeView().viewIsometric()
    FreeCADGui.SendMsgToActiveView("ViewFit")
    wait(500)
    screenshot("stress")
    FreeCADGui.Control.closeDialog()
