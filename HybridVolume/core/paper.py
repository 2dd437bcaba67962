# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The paper's own way to a shell, for smooth bodies and for comparison (sections 3.1, 3.2, 3.5).

As written: the triangulated control net bounds the domain (3.1); w is harmonic in linear elements,
0 on the net and 1 on the midstructure (Eq. 2); from every control point c_l a path follows the
gradient of w to the isosurface w = w0 (3.2); all paths advance together in small steps, and in each
step the front of their ends is smoothed by a Laplacian and brought back to its isosurface (3.5);
the control points of the shell stand where the paths pass the levels W (Eq. 3), with weights 1
inside. The user is told where w0 has an isosurface of another genus than the body (3.2).

What the paper leaves open is decided so that its method does as well as it can:

* the midstructure is facets, fattened and mended as in :mod:`.harmonic_domain`: points alone are
  forgotten by a fine mesh; and edges between boundary vertices are split, or w would be 0 around
  them;
* the gradient is recovered at the vertices and interpolated. Along the gradient that is constant in
  each tetrahedron, paths meet at the tetrahedra's faces: a box of 352 elements then has 24 inverted
  ones at w0 = .5 instead of none;
* a step is 1/24 of the way from the surface to the midstructure. The Laplacian has the weights dual
  length over length of the control net (the cotangents, on a net of rectangles), so that what is
  even on the surface stays as it is, and the ends move a tenth of the way. Without smoothing the
  box has 16 inverted elements at w0 = .5, now none; with three tenths of the way a ring of 32 has
  12, with equal weights 2, now none. More smoothing is better on boxes and worse on round bodies;
* W is found for all paths together ("determined through an optimization procedure"): from equally
  spaced values such that the layers of elements have equal volumes. A single layer leaves nothing
  to choose, and W stays equally spaced.

The paper trusts that inverted elements "generally do not occur". Here they are looked for: a shell
is handed out only where every element is proved valid and the inner surface does not cut itself.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ..errors import (
    HybridVolumeError,
    InputError,
    Place,
    SelfIntersectionError,
    ThicknessError,
)
from . import bspline
from .column_state import GRIDS
from .contacts import TestGrid
from .front import column_frame
from .harmonic import HarmonicField, solve_on
from .harmonic_domain import domain_within
from .intersection import self_intersections
from .midstructure import Midstructure
from .shell import Shell
from .surface import PatchSurface
from .traced import control_net, equal_volume_levels, swept_shell, trace_paths
from .validity import Certificate, certify, scaled_jacobian

UNEVEN = 0.05
"""Difference of the layers' volumes, as a share, that is told."""
MOST_PLACES = 200
"""Places that an error names."""
REMEDY = "use --method certified"
WHY = "its control points, not its points, are drawn to the level"
"""Why the inner surface of this method is not at its level."""


def check_wishes(thickness: str, face_factors: Mapping[str, float], spacing: str) -> None:
    """Refuse what the paper's method has no means for.

    Parameters
    ----------
    thickness, face_factors, spacing
        As in :class:`HybridVolume.core.pipeline.Options`.

    Raises
    ------
    InputError
    """
    if thickness:
        raise InputError(
            f"the paper's method knows levels w0 only, not a thickness of {thickness!r}",
            remedy=f"give w0, or {REMEDY}",
        )
    if face_factors:
        raise InputError(
            "the paper's method has one level w0 for all faces, no factors",
            faces=sorted(face_factors),
            remedy=f"leave the factors out, or {REMEDY}",
        )
    if spacing.strip().lower() != "volume":
        raise InputError(
            f"the paper's levels W give layers of equal volume, not the spacing {spacing!r}",
            remedy=f"leave the spacing out, or {REMEDY}",
        )


def paper_field(surface: PatchSurface, midstructure: Midstructure) -> HarmonicField:
    """The harmonic function in the control net (section 3.1).

    Parameters
    ----------
    surface : PatchSurface
    midstructure : Midstructure

    Raises
    ------
    SelfIntersectionError
        The control net cuts itself, so that it bounds nothing.
    MesherError
        No mesher could fill it.
    """
    triangles, patch = control_net(surface)
    x = surface.control_points
    pairs = self_intersections(x, triangles)
    if len(pairs):
        raise SelfIntersectionError(
            f"the control net, which bounds the domain in the paper's method, cuts itself in"
            f" {len(pairs)} places (the surface itself need not)",
            faces=_faces(surface, patch[pairs.ravel()]),
            figure=float(len(pairs)),
            remedy=REMEDY,
            places=_net_places(surface, triangles, patch, np.unique(pairs)),
        )
    return solve_on(domain_within((x, triangles), surface, midstructure), surface.genus)


def paper_shell(
    surface: PatchSurface,
    field: HarmonicField,
    w0: float,
    *,
    layers: int = 2,
    degree_w: int = 3,
    progress: Callable[[float, str], None] | None = None,
) -> tuple[Shell, Certificate]:
    """The shell of the paper's method, proved.

    Parameters
    ----------
    surface : PatchSurface
    field : HarmonicField
        From :func:`paper_field`.
    w0 : float
        Level of the inner boundary.
    layers : int
        Bézier layers.
    degree_w : int
        Degree across the shell.
    progress : callable, optional
        Called with a share of the work done and a text.

    Returns
    -------
    Shell, Certificate

    Raises
    ------
    ThicknessError
        An element is not proved valid, the inner surface cuts itself, a path does not reach the
        isosurface, or that has another genus than the body.
    """
    report = progress or (lambda share, text: None)
    level = field.largest_level(surface.genus, w0)
    if level < w0 * (1.0 - 1e-9):
        raise ThicknessError(
            f"the isosurface at w0 = {w0:.3g} has another genus than the body, which the paper's"
            f" method does not allow; the largest level with the right genus is {level:.3g}",
            figure=level,
            remedy=f"choose a smaller w0, or {REMEDY}",
        )
    report(0.1, f"isosurface has the body's genus; {len(surface.control_points)} paths")
    shell, lost = _traced_shell(surface, field, w0, layers, degree_w)
    report(0.7, "paths traced; certificate")
    certificate = certify(shell.bezier_elements())
    _refuse(shell, certificate, lost)
    pairs, patches = _crossings(shell)
    if pairs:
        raise ThicknessError(
            f"the inner surface of the paper's method cuts itself in {pairs} places at"
            f" w0 = {w0:.3g}",
            faces=_faces(surface, patches),
            figure=float(pairs),
            remedy=REMEDY,
        )
    return replace(shell, embedded=True), certificate


def paper_figures(
    surface: PatchSurface,
    midstructure: Midstructure,
    w0: float,
    *,
    layers: int = 2,
    degree: int = 3,
    field: HarmonicField | None = None,
) -> dict[str, Any]:
    """What the paper's method makes of a body, valid or not, for a table.

    Parameters
    ----------
    surface : PatchSurface
        Refined as for :func:`HybridVolume.core.pipeline.complete`.
    midstructure : Midstructure
    w0 : float
    layers, degree : int
        Across the shell.
    field : HarmonicField, optional
        From :func:`paper_field`, where it is known from another level.

    Returns
    -------
    dict
        ``elements``, ``valid``, ``invalid``, ``undecided``; ``crossing`` (pairs of triangles of the
        inner surface), ``lost`` (paths that do not reach the isosurface), ``w0`` (area mean of the
        level reached) and ``w0_rms``, ``min_scaled_jacobian``, ``seconds`` (of the processor, those
        of the meshers included) and ``error``: the sentence where there is no field, else empty.
        Figures that are not there are None.
    """
    started = os.times()
    found: dict[str, Any] = dict.fromkeys(
        ("elements", "valid", "invalid", "undecided", "crossing", "lost", "w0", "w0_rms")
        + ("min_scaled_jacobian",)
    )
    found["error"] = ""
    try:
        field = field or paper_field(surface, midstructure)
        shell, lost = _traced_shell(surface, field, w0, layers, degree)
    except HybridVolumeError as error:
        found["error"] = error.line
    else:
        batches = shell.bezier_elements()
        certificate = certify(batches)
        found.update(
            elements=len(certificate),
            valid=certificate.valid,
            invalid=certificate.invalid,
            undecided=certificate.undecided,
            crossing=_crossings(shell)[0],
            lost=len(lost),
            w0=shell.w0,
            w0_rms=shell.w0_rms,
            min_scaled_jacobian=float(scaled_jacobian(batches).min()),
        )
    found["seconds"] = sum(os.times()[:4]) - sum(started[:4])
    return found


def _traced_shell(
    surface: PatchSurface, field: HarmonicField, w0: float, layers: int, degree: int
) -> tuple[Shell, np.ndarray]:
    """The shell as the paths give it, and the control points whose paths are lost."""
    paths, lost = trace_paths(surface, field, w0)
    knots = bspline.clamped_knots(degree, layers)
    levels, spread = equal_volume_levels(surface, field, paths, w0, degree, knots)
    shell = swept_shell(surface, field, paths, levels, knots)
    notes = ["made by the paper's own method; its field is that of the control net"]
    if spread > UNEVEN:
        notes.append("the layers have not the same volume: no levels W for that were found")
    inner = shell.inner_surface().triangulation("greville").vertices
    w, _, _ = field.evaluate(inner)
    area = column_frame(surface).area
    area = area / area.sum()
    mean = float(area @ w)
    return replace(
        shell,
        w0_asked=float(w0),
        w0=mean,
        w0_rms=float(np.sqrt(area @ (w - mean) ** 2)),
        level=w,
        goal=np.full(len(w), float(w0)),
        notes=tuple(notes),
    ), lost


# ------------------------------------------------------------------------------ what is refused


def _crossings(shell: Shell) -> tuple[int, np.ndarray]:
    """Pairs of triangles of the inner surface that cross, and their patches; as in `.growth`.

    Grids on which the outer surface's own coarse triangles cross tell nothing.
    """
    grids = [TestGrid(shell.surface, cells) for cells in GRIDS]
    grids = [grid for grid in grids if grid.outer_embedded] or grids[-1:]
    found = [(grid, grid.crossing(shell.layers[-1])[1]) for grid in grids]
    elements = np.concatenate([grid.element[pairs.ravel()] for grid, pairs in found])
    return max(len(pairs) for _, pairs in found), np.unique(shell.surface.element_patch[elements])


def _refuse(shell: Shell, certificate: Certificate, lost: np.ndarray) -> None:
    """Refuse a shell whose elements are not all proved, or that does not reach its level.

    Raises
    ------
    ThicknessError
    """
    surface, w0 = shell.surface, shell.w0_asked
    if not certificate.all_valid:
        bad = certificate.status < 1
        spans = np.unique(certificate.element[bad] // shell.layer_count)
        raise ThicknessError(
            f"{int(bad.sum())} of {len(certificate)} elements that the paper's method makes at"
            f" w0 = {w0:.3g} are not proved valid ({certificate.invalid} are proved inverted)",
            faces=_faces(surface, certificate.patch[bad]),
            figure=float(bad.sum()),
            remedy=REMEDY,
            places=_element_places(surface, spans),
        )
    if len(lost):
        patches = [k for k, p in enumerate(surface.patches) if np.isin(p.index, lost).any()]
        raise ThicknessError(
            f"{len(lost)} of {len(surface.control_points)} paths do not reach w0 = {w0:.3g}",
            faces=_faces(surface, np.array(patches)),
            figure=float(len(lost)),
            remedy=REMEDY,
        )


def _faces(surface: PatchSurface, patches: np.ndarray) -> list[str]:
    names = {surface.patches[k].face for k in np.unique(patches)}
    return sorted(names, key=lambda name: (len(name), name))


def _element_places(surface: PatchSurface, elements: np.ndarray) -> list[Place]:
    """Middles of some knot spans."""
    patch, uv = [], []
    for group in surface.groups:
        rows = np.isin(group.element, elements)
        patch.append(group.patch[rows])
        uv.append(0.5 * (group.low[rows] + group.high[rows]))
    return _places(surface, np.concatenate(patch), np.concatenate(uv), "element not proved valid")


def _net_places(
    surface: PatchSurface, triangles: np.ndarray, patch: np.ndarray, crossing: np.ndarray
) -> list[Place]:
    """Places on the surface over the first corners of some triangles of the control net."""
    uv = []
    for k in crossing[:MOST_PLACES]:
        p = surface.patches[patch[k]]
        at = np.argwhere(p.index == triangles[k, 0])[0]
        uv.append(
            [bspline.greville(d, t)[n] for d, t, n in zip(p.degrees, p.knots, at, strict=True)]
        )
    return _places(surface, patch[crossing[:MOST_PLACES]], np.array(uv), "control net cuts itself")


def _places(surface: PatchSurface, patch: np.ndarray, uv: np.ndarray, what: str) -> list[Place]:
    patch, uv = patch[:MOST_PLACES], uv[:MOST_PLACES]
    points = surface.evaluate_at(patch, uv[:, 0], uv[:, 1])
    return [
        Place(
            surface.patches[k].face,
            *map(float, surface.face_parameters(k, at[None])[0]),
            tuple(map(float, x)),
            what,
        )
        for k, at, x in zip(patch, uv, points, strict=True)
    ]
