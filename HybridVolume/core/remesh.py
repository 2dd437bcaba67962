# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Another mesh of a hybrid volume whose shell stays as it is."""

from __future__ import annotations

from dataclasses import replace

from .density import Density
from .finite_elements import build_finite_elements
from .gap import check_balance, gap_volume
from .hybrid import HybridVolume


def remesh(
    volume: HybridVolume,
    density: Density,
    *,
    order: int = 2,
    engine: str = "auto",
    free: bool | None = None,
) -> HybridVolume:
    """The same shell with a new interface, core and finite element mesh.

    Parameters
    ----------
    volume : HybridVolume
    density : Density
    order : {1, 2}
    engine, free
        As for :func:`HybridVolume.core.interior.fill_interior`.

    Raises
    ------
    InputError
        The density does not fit the body.
    MesherError
        No core, or elements that are not proved; the volume stays as it was.
    FaultError
        Shell, core and gap do not add up to the body.
    """
    interface, interior, fem = build_finite_elements(
        volume.shell, density, order=order, engine=engine, free=free
    )
    gap = gap_volume(interface, volume.shell)
    check_balance(volume.surface, volume.shell, interior, gap)
    return replace(volume, interface=interface, interior=interior, fem=fem, gap_volume=gap)
