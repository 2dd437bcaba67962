# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Colours of the elements of a FEM mesh in FreeCAD's view."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

Colour = tuple[float, float, float]

BLUE = 0.1
"""Blue of every colour of an element: by it the colours are told from those that are unset."""


def traffic_light(quality: float) -> Colour:
    """Red at 0, yellow at 0.5, green at 1."""
    q = min(max(quality, 0.0), 1.0)
    return (min(1.0, 2.0 - 2.0 * q), min(1.0, 2.0 * q), BLUE)


def colour_elements(view: Any, colours: Mapping[int, Colour]) -> None:
    """Colour a mesh of a FEM object element by element.

    Parameters
    ----------
    view : view object of a Fem::FemMeshObject
    colours : mapping of int to (red, green, blue)
        By the numbers of the elements that are to be seen; each with `BLUE`.
    """
    view.ElementColor = dict(colours)
    if "ColorMode" in view.PropertiesList:  # FreeCAD 1.0 and later
        view.ColorMode = "ByElement"
    _mend(view)


def _mend(view: Any) -> None:
    """Put the colours on the right triangles.

    FreeCAD draws a face of six nodes as four triangles, but keeps three colours for it, so that
    those of later faces slip forward, on elements of second order by a quarter at last.
    """
    from pivy import coin

    search = coin.SoSearchAction()
    search.setType(coin.SoMaterial.getClassTypeId())
    search.setInterest(coin.SoSearchAction.ALL)
    search.apply(view.RootNode)
    paths = search.getPaths()
    fields = [paths[i].getTail().diffuseColor for i in range(paths.getLength())]
    if not fields:
        return
    field = max(fields, key=lambda one: one.getNum())
    count = field.getNum()
    given = np.array([field[i].getValue() for i in range(count)]).reshape(-1, 3)
    is_set = np.abs(given[:, 2] - BLUE) < 0.02
    kept = 3 * (count // 4)
    if count % 4 or not is_set[:kept].all() or is_set[kept:].any():
        return
    right = np.repeat(given[:kept:3], 4, axis=0)
    field.setValues(0, count, [tuple(colour) for colour in right.tolist()])
