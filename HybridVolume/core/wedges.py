# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The wedges of the shell: every column over an interface triangle, cut into layers."""

from __future__ import annotations

import numpy as np

from .columns import evaluate_columns
from .density import Density
from .element_jacobians import prove_positive, scaled_jacobian
from .elements import jacobians, reference
from .heights import layer_levels
from .interior import Interface
from .mid_nodes import outer_mids
from .shell import Shell

_POOR = 0.15
"""Scaled Jacobian at its nodes below which a wedge may be invalid elsewhere."""


class Wedges:
    """Nodes and wedges between the outer boundary and the interface.

    Nodes stand in blocks: corners level by level from outside, then mid nodes between levels, mid
    nodes of the triangles' edges level by level.

    Parameters
    ----------
    shell : Shell
    interface : Interface
    density : Density
    order : {1, 2}

    Attributes
    ----------
    layers : int
    nodes : (n, 3) array
        mm
    elements : (m, 15) or (m, 6) int array
        Layer by layer from outside; bottom towards the core.
    patch, uv : (nb,) int array, (nb, 2) array
        A patch of each outer node, and its parameters there.
    """

    def __init__(self, shell: Shell, interface: Interface, density: Density, order: int) -> None:
        self.interface, self.order = interface, order
        self.kind = "penta15" if order == 2 else "penta6"
        levels = layer_levels(shell, interface, density)
        self.layers = levels.count
        self._n, self._e = len(interface.vertices), len(interface.edges)
        corners = evaluate_columns(
            shell,
            interface.vertex_patch,
            interface.vertex_uv,
            levels.vertices[:: 3 - order],
        )
        corners[-1] = interface.vertices
        blocks = [corners[::order].reshape(-1, 3)]
        self.patch, self.uv = interface.vertex_patch, interface.vertex_uv
        if order == 2:
            blocks.append(corners[1::2].reshape(-1, 3))
            mids = evaluate_columns(shell, interface.edge_patch, interface.edge_uv, levels.edges)
            mids[-1] = interface.midpoints
            mids[0], patch, uv = outer_mids(shell, interface, mids[0])
            self.patch, self.uv = np.append(self.patch, patch), np.vstack([self.uv, uv])
            blocks.append(mids.reshape(-1, 3))
        starts = np.cumsum([0, *(len(b) for b in blocks)])
        self._between, self._edge = (starts[1], starts[2]) if order == 2 else (0, 0)
        self.nodes = np.concatenate(blocks)
        self.elements = self._elements()

    @property
    def outer_nodes(self) -> np.ndarray:
        """Nodes of the outer boundary in the order of `patch` and `uv`, (nb,)."""
        return np.append(np.arange(self._n), self.edge_mids(0))

    def vertices(self, level: int) -> np.ndarray:
        """Corner nodes of a level, one for each vertex of the interface, (n,)."""
        return level * self._n + np.arange(self._n)

    def edge_mids(self, level: int) -> np.ndarray:
        """Mid nodes of a level, one for each edge of the interface, (e,); none of order 1."""
        if self.order == 1:
            return np.zeros(0, dtype=np.int64)
        return self._edge + level * self._e + np.arange(self._e)

    def triangles(self, level: int) -> np.ndarray:
        """Interface triangles seen on a level, with their mid nodes."""
        corners = level * self._n + self.interface.triangles
        if self.order == 1:
            return corners
        mids = self._edge + level * self._e + self.interface.triangle_edges
        return np.concatenate([corners, mids], axis=1)

    def _elements(self) -> np.ndarray:
        parts = []
        for layer in range(self.layers):
            bottom, top = self.triangles(layer + 1), self.triangles(layer)
            columns = [bottom[:, :3], top[:, :3]]
            if self.order == 2:
                between = self._between + layer * self._n + self.interface.triangles
                columns += [bottom[:, 3:], top[:, 3:], between]
            parts.append(np.concatenate(columns, axis=1))
        return np.concatenate(parts)

    def curved_inside(self) -> tuple[np.ndarray, np.ndarray]:
        """Mid nodes inside the body, and the ends of their edges, (m,) and (m, 2)."""
        levels = np.arange(1, self.layers + 1)[:, None]
        above = np.arange(self.layers * self._n)
        nodes = [self._between + above]
        ends = [np.column_stack([above, above + self._n])]
        nodes.append((self._edge + levels * self._e + np.arange(self._e)).ravel())
        ends.append((levels[..., None] * self._n + self.interface.edges).reshape(-1, 2))
        return np.concatenate(nodes), np.concatenate(ends)

    def folded(self) -> np.ndarray:
        """Triangles whose curved outer face, which stays as it is, is folded at one of its nodes.

        No place of the nodes inside makes the wedges below them valid.
        """
        if self.order == 1:
            return np.zeros(0, dtype=np.int64)
        j = jacobians("tri6", self.nodes[self.triangles(0)], reference("tri6").nodes)
        normal = np.cross(j[..., 0], j[..., 1])
        return np.flatnonzero(
            (np.einsum("tnc,tc->tn", normal, normal.mean(axis=1)) <= 0.0).any(axis=1)
        )

    def cell_sides(self) -> np.ndarray:
        """Mean outer length of each cell's sides along u and along v, (nc, 2), mm."""
        interface = self.interface
        corners = self.nodes[interface.triangles]
        uv = interface.triangle_uv
        sides = []
        for axis in (0, 1):
            # the sides along an axis are those whose other parameter stays
            length = np.zeros(len(corners))
            for k in range(3):
                ends = uv[:, k], uv[:, (k + 1) % 3]
                along = ends[0][:, 1 - axis] == ends[1][:, 1 - axis]
                step = np.linalg.norm(corners[:, k] - corners[:, (k + 1) % 3], axis=1)
                length[along] = step[along]
            sides.append(length.reshape(-1, 2).mean(axis=1))
        return np.column_stack(sides)

    def poor_cells(self, least: float) -> np.ndarray:
        """Cells a wedge of which stays below a scaled Jacobian with straight edges inside too."""
        poor = np.flatnonzero(self.quality() < least)
        if self.order == 1 or not len(poor):
            return poor
        mids, ends = self.curved_inside()
        curved = self.nodes
        self.nodes = curved.copy()
        self.nodes[mids] = 0.5 * (curved[ends[:, 0]] + curved[ends[:, 1]])
        try:
            return poor[self.quality(poor) < least]
        finally:
            self.nodes = curved

    def quality(self, cells: np.ndarray | None = None) -> np.ndarray:
        """Smallest scaled Jacobian over all wedges of a cell, -1 where one is not proved.

        Parameters
        ----------
        cells : (nc,) int array, optional
            Cells of the interface's grid; all by default.

        Returns
        -------
        (nc,) array
        """
        count = len(self.interface.triangles) // 2
        cells = np.arange(count) if cells is None else cells
        rows = 2 * cells[:, None] + np.arange(2)
        rows = (rows[:, None] + 2 * count * np.arange(self.layers)[:, None]).reshape(
            len(cells), 2 * self.layers
        )
        x = self.nodes[self.elements[rows.ravel()]]
        found = scaled_jacobian(self.kind, x, reference(self.kind).nodes)
        # only those that look poor are looked at closely
        poor = np.flatnonzero(found < _POOR)
        proved = prove_positive(self.kind, x[poor]).proved
        found[poor] = np.where(proved, scaled_jacobian(self.kind, x[poor]), -1.0)
        return found.reshape(rows.shape).min(axis=1)
