# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""From a hybrid volume to a space of unknowns on it, and from one to the next finer.

The core's tets follow the curved inner surface of the shell. Where that folds them, nodes inside
give way; then edges, faces and tets that join points of the interface through the core get a vertex
of their own; then the interface gets finer there. In the end every element is proved valid.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from ...errors import InputError, MesherError
from ..density import Density
from ..diagonals import refine_at
from ..hybrid import HybridVolume
from ..interior import Interface, Interior, build_interface, fill_interior
from ..shell import Shell
from ..sizes import wanted_lines
from ..strips import GridLines
from ..tetmesh import TetMesh
from ..tetmesh.split import separate_boundary
from .coupling import CollocationSpace, NitscheSpace
from .elevation import elevated_shell
from .simplex_space import DEGREES
from .spline_space import SplineSpace
from .subdivision import cut_simplices, raised_simplices
from .tet_space import TetSpace, check_valid, curved_tets
from .unfold import unfolded

logger = logging.getLogger(__name__)

COUPLINGS = {"collocation": CollocationSpace, "nitsche": NitscheSpace}
"""Names of the couplings."""
_SEPARATIONS = 3
"""How often vertices are put between points of the interface around folded tets."""
_SMOOTH = np.cos(np.radians(30.0))
"""Cosine of the angle between normals at an edge from which on the interface counts as smooth."""
_FINEST = 8
"""Into how many parts a side of a knot rectangle may be cut where tets stay folded."""


def hybrid_space(
    shell: Shell,
    interface: Interface,
    interior: Interior,
    *,
    degree: int = 2,
    coupling: str = "collocation",
    parts: int = 1,
) -> CollocationSpace | NitscheSpace:
    """The unknowns of shell and core, coupled.

    Parameters
    ----------
    shell : Shell
    interface : Interface
    interior : Interior
        Its first vertices are those of the interface.
    degree : {1, 2, 3}
        Of the polynomials in the core. Patches of a lower degree are raised to it, exactly.
    coupling : {"collocation", "nitsche"}
        See :mod:`.coupling`. Collocation serves degrees 1 and 2, Nitsche's method all.
    parts : int
        Parts that each of the shell's layers is cut into.

    Returns
    -------
    CollocationSpace or NitscheSpace
        Every element is valid; its ``notes`` say what was done for it.

    Raises
    ------
    InputError
        Degree or coupling are unknown, or tets stay folded; the CAD faces over them are named.
    MesherError
        The core could not be filled anew where the interface had to be made finer.
    """
    if degree not in DEGREES:
        raise InputError(f"degree {degree} in the core", remedy="choose 1, 2 or 3")
    if coupling not in COUPLINGS:
        raise InputError(
            f"no coupling is called {coupling!r}", remedy=f"choose {' or '.join(COUPLINGS)}"
        )
    raised = elevated_shell(shell, degree)
    spline = SplineSpace(raised, parts)
    notes = []
    if raised is not shell:
        notes.append(f"patches of a lower degree were raised to {degree}")
    tets, found = _core(shell, interface, interior, degree, spline)
    notes += found
    for note in notes:
        logger.info("%s", note)
    return COUPLINGS[coupling](spline, tets, tuple(notes))


def of_volume(
    volume: HybridVolume, *, degree: int = 2, coupling: str = "collocation", parts: int = 1
) -> CollocationSpace | NitscheSpace:
    """The unknowns of a hybrid volume; see :func:`hybrid_space`."""
    return hybrid_space(
        volume.shell,
        volume.interface,
        volume.interior,
        degree=degree,
        coupling=coupling,
        parts=parts,
    )


def refined(space: CollocationSpace | NitscheSpace) -> CollocationSpace | NitscheSpace:
    """The next finer space on the same volume.

    All knot spans are halved along u, v and w, and every tet is cut into eight in its own reference
    coordinates; new nodes on the interface stand on the inner surface, which stays what it is.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
        In space or in the plane.

    Raises
    ------
    InputError
        Elements of the core are folded by it and could not be repaired.
    """
    spline = space.spline.refined()
    tets, moved = cut_simplices(space.tets, spline)
    check_valid(tets, spline)
    notes = space.notes
    if moved:
        notes = (*notes, f"{moved} nodes of the finer core were moved, since tets were folded")
    return type(space)(spline, tets, notes)


def _core(
    shell: Shell, interface: Interface, interior: Interior, degree: int, spline: SplineSpace
) -> tuple[TetSpace, list[str]]:
    """Valid tets, over a finer interface if need be, and what was done."""
    if (interface.vertex_w < 1.0).any():
        # a core that reaches into the shell would be there twice
        wanted = wanted_lines(shell.surface, Density())
        notes = ["the core was filled anew up to the inner surface"]
    else:
        wanted = wanted_lines(shell.surface, Density(interface.nodes, interface.subdivide))
        found, notes = _repaired(shell, interface, interior, degree, spline)
        if not _folded(found).any():
            return found, notes
        notes = ["the core was filled anew under a finer interface"]
    return _filled_anew(shell, wanted, degree, spline, notes)


def _filled_anew(
    shell: Shell, wanted: GridLines, degree: int, spline: SplineSpace, notes: list[str]
) -> tuple[TetSpace, list[str]]:
    """Valid tets under an interface that is refined until there are such."""
    lines: GridLines | None = wanted
    while True:
        try:
            interface = build_interface(shell, lines=lines)
            interior = fill_interior(interface, surface=shell.surface)
        except MesherError as error:
            logger.info("interface of %d cells: %s", lines.cells, error.line)
            lines = refine_at(lines, wanted, error.triangles, _FINEST)
            if lines is None:
                raise
            continue
        found, more = _repaired(shell, interface, interior, degree, spline)
        folded = _folded(found)
        if not folded.any():
            return found, notes + more
        under = np.isin(found.faces[:, :3], found.elements[folded, :4]).any(axis=1)
        finer = refine_at(lines, wanted, np.flatnonzero(under), _FINEST)
        if finer is None:
            check_valid(found, spline)
        lines = finer


def _repaired(
    shell: Shell, interface: Interface, interior: Interior, degree: int, spline: SplineSpace
) -> tuple[TetSpace, list[str]]:
    """Tets that are valid as far as that can be had without another interface, and what was done.

    Cubic tets are those of degree 2 with more nodes, so that what is hard is done with few.
    """
    mesh = interior.mesh
    low = min(degree, 2)

    def attempt(tets: TetMesh, light: bool) -> tuple[TetSpace, np.ndarray, int]:
        filled = replace(interior, mesh=tets)
        space, moved = unfolded(curved_tets(shell, interface, filled, low), light)
        bad = _folded(space)
        if degree > low and not bad.any():
            space, more = raised_simplices(space, spline, degree, light)
            bad, moved = _folded(space), moved + more
        return space, bad, moved

    bad = _pressed_flat(curved_tets(shell, interface, interior, low), spline)
    if not bad.any():
        space, bad, moved = attempt(mesh, True)
    for step in range(_SEPARATIONS):
        if not bad.any():
            break
        chosen = np.zeros(len(mesh.vertices), dtype=bool)
        chosen[mesh.tets[bad]] = True
        mesh, _ = separate_boundary(mesh, chosen=chosen)
        space, bad, moved = attempt(mesh, step < _SEPARATIONS - 1)
    notes = []
    count = len(mesh.vertices) - len(interior.mesh.vertices)
    if count:
        notes.append(f"{count} vertices were put into the core, where curved tets were folded")
    if moved:
        notes.append(f"{moved} nodes of the core were moved, where curved tets were folded")
    return space, notes


def _pressed_flat(space: TetSpace, spline: SplineSpace) -> np.ndarray:
    """Tets with two faces on the interface that meet in an edge where it is smooth, (m,) bool.

    However fine the elements get, det J vanishes on such an edge, since the faces have one tangent
    plane there.
    """
    found = np.zeros(len(space.elements), dtype=bool)
    if space.degree == 1:
        return found
    element, _ = space.elements_of_faces
    number = np.flatnonzero(np.bincount(element, minlength=len(found))[element] > 1)
    sides = np.array([[0, 1], [1, 2], [2, 0]])
    ends = np.sort(space.faces[number][:, sides], axis=2).reshape(-1, 2)
    middle = space.face_uv[number][:, sides].mean(axis=2).reshape(-1, 2)
    w = space.face_w[number][:, sides].mean(axis=2).ravel()
    tangents = spline.tangents_at(np.repeat(space.face_patch[number], 3), middle, w)
    normal = np.cross(tangents[:, 0], tangents[:, 1])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    owner = np.repeat(element[number], 3)
    order = np.lexsort((*ends.T, owner))
    first, second = order[:-1], order[1:]
    same = (owner[first] == owner[second]) & (ends[first] == ends[second]).all(axis=1)
    smooth = (normal[first] * normal[second]).sum(axis=1) > _SMOOTH
    found[owner[first[same & smooth]]] = True
    return found


def _folded(space: TetSpace) -> np.ndarray:
    """Elements that are not proved valid, (m,) bool."""
    return space.jacobian_bounds <= 0.0
