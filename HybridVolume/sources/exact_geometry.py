# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Curves and surfaces of a FreeCAD solid as NURBS arrays, without loss."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from .. import errors
from ..core.covering.geometry import SplineCurve
from ..core.surface import SplineFace
from .faces import spline_face


def curves_of(solid: Any) -> list[SplineCurve | None]:
    """The curve of every edge over the edge's range; None for degenerate edges.

    Parameters
    ----------
    solid : Part.Solid

    Raises
    ------
    InputError
        OCC does not convert an edge.
    """
    return [None if edge.Degenerated else _curve(edge) for edge in solid.Edges]


def _curve(edge: Any) -> SplineCurve:
    import Part

    try:
        spline = edge.Curve.toBSpline(*edge.ParameterRange)
    except (Part.OCCError, AttributeError) as error:
        raise errors.InputError(
            f"an edge of {edge.Length:.4g} mm has no B-spline form",
            remedy="convert the body to NURBS in the CAD program",
        ) from error
    if spline.isPeriodic():
        spline.setNotPeriodic()
    return SplineCurve(
        spline.Degree,
        np.repeat(spline.getKnots(), spline.getMultiplicities()),
        np.array([tuple(pole) for pole in spline.getPoles()]),
        np.array(spline.getWeights(), dtype=float),
        float(edge.Tolerance),
    )


def surfaces_of(solid: Any) -> list[SplineFace]:
    """The surface of every face, cut to the rectangle of its parameters that the face needs.

    ``exact`` tells converted ones from the file's own B-spline surfaces.

    Parameters
    ----------
    solid : Part.Solid

    Raises
    ------
    InputError
        OCC does not convert a face.
    """
    found = []
    for number, face in enumerate(solid.Faces):
        name = f"Face{number + 1}"
        surface = face.Surface
        own = surface.TypeId in ("Part::GeomBSplineSurface", "Part::GeomBezierSurface")
        if not own:
            converted = face.toNurbs().Faces
            surface = converted[0].Surface if len(converted) == 1 else None
            rectangle = converted[0].ParameterRange if surface is not None else None
        else:
            rectangle = face.ParameterRange
        patch = None if surface is None else spline_face(surface, name, rectangle)
        if patch is None:
            raise errors.InputError(
                "this face has no B-spline form",
                faces=[name],
                remedy="convert it to NURBS in the CAD program",
            )
        found.append(replace(patch, exact=not own))
    return found
