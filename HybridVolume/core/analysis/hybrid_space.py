# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""From a hybrid volume to a space of unknowns on it, and from one to the next finer.

The core's tets follow the curved inner surface of the shell. Where that folds them, nodes inside
give way; then edges, faces and tets that join points of the interface through the core get a vertex
of their own; then the interface gets finer there; at last nodes go towards straight tets, off the
interface too. In the end every element is proved valid.
"""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from ...errors import InputError, MesherError
from ..hybrid import HybridVolume
from ..interior import Interface, Interior
from ..shell import Shell
from .core_repair import (
    filled_core,
    folded,
    overlap_note,
    repaired_core,
    yielding_core,
)
from .coupling import CollocationSpace, NitscheSpace
from .elevation import elevated_shell
from .simplex_space import DEGREES
from .spline_space import SplineSpace
from .subdivision import cut_simplices
from .tet_space import Sides, TetSpace, check_valid

logger = logging.getLogger(__name__)

COUPLINGS = {"collocation": CollocationSpace, "nitsche": NitscheSpace}
"""Names of the couplings."""


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
    tets, found = _core(interface, interior, degree, spline)
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
    notes = space.notes
    if moved:
        notes = (*notes, f"{moved} nodes of the finer core were moved, since tets were folded")
    check_valid(tets, spline)
    return type(space)(spline, tets, notes)


def _core(
    interface: Interface, interior: Interior, degree: int, spline: SplineSpace
) -> tuple[TetSpace, list[str]]:
    """Valid tets, straight ones where nothing else is valid, and what was done."""
    sides = Sides.of(interface)
    if (sides.w < 1.0).any():
        # what the core takes of the shell would be there twice: up to the inner surface if it can
        try:
            mesh, full = filled_core(spline, replace(sides, w=np.ones_like(sides.w)))
            found, notes = repaired_core(spline, mesh, full, degree)
            if not folded(found).any():
                return found, ["the core was filled anew up to the inner surface", *notes]
        except MesherError as error:
            logger.info("no core up to the inner surface: %s", error.line)
    try:
        found, notes = repaired_core(spline, interior.mesh, sides, degree)
        if not folded(found).any():
            return found, notes
    except MesherError as error:
        logger.info("no core under a finer interface: %s", error.line)
    found, count = yielding_core(spline, interior.mesh, sides, degree)
    check_valid(found, spline)
    note = f"{count} nodes of the interface stand off the inner surface, where tets were folded"
    return found, [note, *overlap_note(sides)]
