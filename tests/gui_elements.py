# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Scenario in FreeCAD's window: which colour stands on which triangle of a mesh."""

import tempfile
import time
from pathlib import Path

import FreeCAD
import FreeCADGui
import numpy as np
from made_by_hand import SIZE, completed
from pivy import coin


def colours(answer):
    """Give every element of a box's shell and core a colour of its own, and read them back."""
    from HybridVolume.gui.element_colours import BLUE, colour_elements
    from HybridVolume.objects import document

    doc = FreeCAD.newDocument("colours")
    box = doc.addObject("Part::Box", "Box")
    box.Length, box.Width, box.Height = SIZE
    doc.recompute()
    folder = Path(tempfile.mkdtemp())
    (volume,) = document.insert(doc, box, [document.Prepared(completed(box, folder))])
    for name in ("Shell", "Core"):
        obj = getattr(volume, name)
        obj.ViewObject.Visibility = True
        _wait()
        elements = list(obj.FemMesh.Volumes)
        colour_elements(obj.ViewObject, {e: (e / 100.0, 1.0 - e / 100.0, BLUE) for e in elements})
        _wait()
        answer[name] = _on_their_elements(obj, elements)


def _on_their_elements(obj, elements):
    """Triangles that are drawn, and how many have the colour of the element that they are of."""
    root = obj.ViewObject.RootNode
    (faces, *_) = _nodes(root, coin.SoIndexedFaceSet)
    (points, *_) = _nodes(root, coin.SoCoordinate3)
    colour = max(
        (node.diffuseColor for node in _nodes(root, coin.SoMaterial)), key=lambda one: one.getNum()
    )
    corners = np.array(faces.coordIndex.getValues(0)).reshape(-1, 4)[:, :3]
    places = np.array([points.point[i].getValue() for i in range(points.point.getNum())])
    mesh = obj.FemMesh
    table = mesh.Nodes
    nodes = {e: np.array([tuple(table[n]) for n in mesh.getElementNodes(e)]) for e in elements}
    right = 0
    for number, triangle in enumerate(places[corners]):
        element = round(100.0 * colour[number].getValue()[0])
        off = np.abs(nodes[element][:, None] - triangle[None]).max(axis=2).min(axis=0)
        right += bool(off.max() < 1e-5)
    return [len(corners), colour.getNum(), right]


def _nodes(root, kind):
    search = coin.SoSearchAction()
    search.setType(kind.getClassTypeId())
    search.setInterest(coin.SoSearchAction.ALL)
    search.apply(root)
    paths = search.getPaths()
    return [paths[i].getTail() for i in range(paths.getLength())]


def _wait(seconds=0.4):
    end = time.time() + seconds
    while time.time() < end:
        FreeCADGui.updateGui()
