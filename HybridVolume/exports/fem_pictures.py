# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Pictures of the finite elements: how good they are."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from HybridVolume.core.fem_quality import ALL, BINS, MeshQuality, mesh_quality

from .scene import Chart

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh

COLOURS = {"Shell": (0.30, 0.50, 0.74), "Core": (0.88, 0.68, 0.30)}
_KINDS = {"penta15": "wedges of 15 nodes", "penta6": "wedges of 6 nodes",
          "tet10": "tetrahedra of 10 nodes", "tet4": "tetrahedra of 4 nodes"}  # fmt: skip


def fem_histogram(name: str, mesh: FiniteElementMesh, quality: MeshQuality | None = None) -> Chart:
    """How many elements of shell and core have which scaled Jacobian.

    Parameters
    ----------
    name : str
        Of the body, for the title.
    mesh : FiniteElementMesh
    quality : MeshQuality, optional
        Its figures, where they are at hand.
    """
    quality = quality or mesh_quality(mesh)
    everything = quality.group(ALL)
    parts = [group for group in quality.groups if group is not everything]
    least = everything.scaled_jacobian.min
    angles = f"angles {everything.min_dihedral:.1f} to {everything.max_dihedral:.1f} degrees"
    return Chart(
        f"{name}: scaled Jacobian of {everything.elements} finite elements",
        (
            f"{len(mesh.nodes)} nodes; smallest {least:.3f}, mean "
            f"{everything.scaled_jacobian.mean:.3f}; {angles}; all proved valid",
        ),
        np.linspace(0.0, 1.0, BINS + 1),
        np.array(everything.histogram),
        "smallest scaled Jacobian of an element (1: regular, 0: flat)",
        "elements",
        ((least, f"smallest {least:.3f}"),),
        tuple(
            (
                f"{group.name}: {group.elements} {_KINDS[group.kinds[0]]}, smallest "
                f"{group.scaled_jacobian.min:.3f}",
                group.histogram,
                COLOURS[group.name],
            )
            for group in parts
        ),
    )
