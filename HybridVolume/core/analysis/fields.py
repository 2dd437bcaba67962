# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Fields over shell and core as they are shown: solutions, gradients, strains and stresses.

A solution is shown as it is. Its gradient jumps between elements; what is shown is one field: in
the shell the values at the lattice of each Bézier element, with the mean at points that elements
share; in the core the mean of its elements at each node. Nodes on the interface have the shell's
gradient, as they have its values, unless the materials differ.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ...errors import InputError
from .bezier_cells import BezierCells
from .coupling import CollocationSpace, NitscheSpace
from .simplex_space import lattice, shape_functions

_BLOCK = 4_000_000
"""Numbers that are held at once."""


@dataclass(frozen=True)
class Field:
    """A field over shell and core.

    Attributes
    ----------
    shell : list of (ne, p + 1, q + 1, r + 1, k) arrays
        Coefficients of the Bézier elements, one array for each batch of `FieldSpace.cells`.
    core : (n, k) array
        Values at the core's nodes.
    """

    shell: list[np.ndarray]
    core: np.ndarray

    @property
    def width(self) -> int:
        """Number of components."""
        return self.core.shape[1]


class FieldSpace:
    """What shows fields of a coupled space: the shell's Bézier elements and the core's.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
        Of a body in space.

    Raises
    ------
    InputError
        The space is one in the plane.
    """

    def __init__(self, space: CollocationSpace | NitscheSpace) -> None:
        if space.dimension != 3:
            raise InputError(
                "a field in the plane has no body to be shown on",
                remedy="take a space on a hybrid volume",
            )
        self.space = space

    @cached_property
    def cells(self) -> BezierCells:
        """The shell's elements."""
        return BezierCells(self.space.spline)

    def of(self, values: np.ndarray) -> Field:
        """The field of coefficients (size,) or (size, k) of the coupled unknowns, as it is."""
        values = np.asarray(values, dtype=float)
        if len(values) != self.space.size or values.ndim > 2:
            raise InputError(
                f"an array of shape {values.shape} holds no field of {self.space.size} unknowns",
                remedy="give the coefficients of a solution on this space",
            )
        shell, core = self.space.parts(values.reshape(len(values), -1))
        return Field(self.cells.coefficients(shell), core)

    def derived(
        self,
        field: Field,
        shell: Callable[[np.ndarray, np.ndarray], np.ndarray],
        core: Callable[[np.ndarray, np.ndarray], np.ndarray] | None = None,
    ) -> Field:
        """A field made of another and its gradient, with one value where elements meet.

        Parameters
        ----------
        field : Field
            Of k components.
        shell, core : callables
            Take values (m, k) and gradients (m, 3, k), of which ``[:, d, c]`` is the derivative of
            component c along d, and return (m, j) values. ``core`` is given where it is another
            than ``shell``: then the field may jump at the interface.
        """
        found = Field(
            self.cells.lattice_values(field.shell, shell),
            self._at_nodes(field.core, core or shell),
        )
        if core is None:
            tets = self.space.tets
            place = tets.interface_patch, tets.interface_uv, tets.interface_w
            found.core[tets.interface] = self.cells.at(*self.cells.element_at(*place), found.shell)
        return found

    def mapped(self, field: Field, function: Callable[[np.ndarray], np.ndarray]) -> Field:
        """A field made of the values of another, (m, k) to (m, j), such as the von Mises stress."""

        def of_values(values: np.ndarray, _: np.ndarray) -> np.ndarray:
            return function(values)

        return Field(self.cells.lattice_values(field.shell, of_values), function(field.core))

    def _at_nodes(self, core: np.ndarray, function: Callable) -> np.ndarray:
        """Mean over the elements at each node of what a function makes of values and gradients."""
        tets = self.space.tets
        at = lattice(3, tets.degree)[:, 1:] / tets.degree
        _, slopes = shape_functions(tets.degree, at)
        total, count = 0.0, np.zeros(tets.size)
        step = max(1, _BLOCK // (slopes.size * (core.shape[1] + 3)))
        for first in range(0, len(tets.elements), step):
            members = tets.elements[first : first + step]
            inside = core[members]
            jacobian = slopes @ tets.nodes[members][:, None]
            gradient = np.linalg.solve(jacobian, slopes @ inside[:, None])
            width = core.shape[1]
            values = function(inside.reshape(-1, width), gradient.reshape(-1, 3, width))
            row = members.ravel()
            total = total + np.stack(
                [np.bincount(row, column, tets.size) for column in values.T], axis=-1
            )
            count += np.bincount(row, minlength=tets.size)
        return total / count[:, None]
