# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A conforming mesh of a box made by hand: 12 wedges around 12 tets, without any mesher."""

import numpy as np

from HybridVolume.core.elements import EDGES
from HybridVolume.core.finite_elements import FiniteElementMesh

# Corners are numbered in binary (z, y, x); two triangles a side, outward.
_SIDES = np.array(
    [
        [[0, 4, 6], [0, 6, 2]],
        [[1, 3, 7], [1, 7, 5]],
        [[0, 1, 5], [0, 5, 4]],
        [[2, 6, 7], [2, 7, 3]],
        [[0, 2, 3], [0, 3, 1]],
        [[4, 5, 7], [4, 7, 6]],
    ]
)


def box_mesh(size, names, order=2, share=0.4) -> FiniteElementMesh:
    """Mesh of a box with a corner at the origin.

    ``names`` are those of the CAD faces at x = 0, x = a, y = 0, y = b, z = 0, z = c; ``share`` is
    the thickness of the shell as a share of the way to the centre.
    """
    size = np.asarray(size, dtype=float)
    corners = np.array([[n & 1, n >> 1 & 1, n >> 2 & 1] for n in range(8)]) * size
    inner = corners + share * (0.5 * size - corners)
    nodes = [*corners, *inner, 0.5 * size]
    triangles = _SIDES.reshape(-1, 3)
    wedges = np.hstack([triangles + 8, triangles])
    tets = np.hstack([triangles[:, ::-1] + 8, np.full((12, 1), 16)])[:, [0, 1, 2, 3]]
    # The normal of 1-2-3 must point to node 4, the centre: the triangles are turned round.
    kinds = {"wedge": wedges, "tet": tets, "boundary": triangles, "interface": triangles + 8}
    if order == 2:
        middle: dict[tuple[int, int], int] = {}
        for name, kind in (
            ("wedge", "penta15"),
            ("tet", "tet10"),
            ("boundary", "tri6"),
            ("interface", "tri6"),
        ):
            rows = []
            for row in kinds[name]:
                for a, b in EDGES[kind]:
                    key = tuple(sorted((row[a], row[b])))
                    if key not in middle:
                        middle[key] = len(nodes)
                        nodes.append(0.5 * (nodes[key[0]] + nodes[key[1]]))
                ends = [tuple(sorted((row[a], row[b]))) for a, b in EDGES[kind]]
                rows.append([*row, *(middle[key] for key in ends)])
            kinds[name] = np.array(rows)
    ones = np.ones(12)
    return FiniteElementMesh(
        order=order,
        nodes=np.array(nodes),
        wedges=kinds["wedge"],
        wedge_patch=np.repeat(np.arange(6), 2),
        wedge_layer=np.zeros(12, dtype=int),
        tets=kinds["tet"],
        boundary=kinds["boundary"],
        boundary_face=np.repeat(np.arange(6), 2),
        boundary_wedge=np.arange(12),
        interface=kinds["interface"],
        face_names=tuple(names),
        wedge_quality=ones,
        tet_quality=ones,
        wedge_bound=ones,
        tet_bound=ones,
    )
