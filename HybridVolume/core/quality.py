# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Quality of the shell's elements: one by one, by CAD face and by layer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from .bezier import BezierElements
from .validity import VALID, scaled_jacobian

if TYPE_CHECKING:
    from .hybrid import HybridVolume


@dataclass(frozen=True)
class ElementQuality:
    """Figures of every Bézier element, in the order of their numbers.

    Attributes
    ----------
    scaled_jacobian : (ne,) array
        Least over 6 x 6 x 6 points; 1 is a box, 0 is folded.
    bound : (ne,) array
        Certified lower bound of det J over the mean edge product (`Certificate.min_bernstein`).
    proved : (ne,) bool array
        Whether det J > 0 is proved everywhere.
    face : (ne,) int array
        Place of the element's CAD face in `faces`.
    layer : (ne,) int array
        0 is the outermost.
    faces : tuple of str
    """

    scaled_jacobian: np.ndarray
    bound: np.ndarray
    proved: np.ndarray
    face: np.ndarray
    layer: np.ndarray
    faces: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.scaled_jacobian)

    @cached_property
    def order(self) -> np.ndarray:
        """Numbers of the elements, the worst first."""
        return np.lexsort((self.bound, self.scaled_jacobian))

    def worst(self, count: int) -> np.ndarray:
        """Numbers of the worst elements, the worst first."""
        return self.order[:count]

    def share(self, per_cent: float) -> float:
        """Scaled Jacobian that so many per cent of the elements do not exceed."""
        ranked = self.scaled_jacobian[self.order]
        return float(ranked[max(0, int(np.ceil(per_cent / 100.0 * len(ranked))) - 1)])

    def of_face(self, face: int) -> np.ndarray:
        """Numbers of the elements under a CAD face, by its place in `faces`."""
        return np.flatnonzero(self.face == face)

    def least_by_face(self) -> np.ndarray:
        """Smallest scaled Jacobian under each face, (faces,)."""
        return self._least(self.face, len(self.faces))

    def least_by_layer(self) -> np.ndarray:
        """Smallest scaled Jacobian in each layer, (layers,)."""
        return self._least(self.layer, int(self.layer.max()) + 1)

    def _least(self, group: np.ndarray, count: int) -> np.ndarray:
        least = np.full(count, np.inf)
        np.minimum.at(least, group, self.scaled_jacobian)
        return least


def element_quality(
    volume: HybridVolume, batches: Sequence[BezierElements] | None = None
) -> ElementQuality:
    """Figures of the elements of a volume's shell.

    Parameters
    ----------
    volume : HybridVolume
    batches : sequence of BezierElements, optional
        The shell's elements, where they are at hand.
    """
    shell, certificate = volume.shell, volume.certificate
    names = list(dict.fromkeys(patch.face for patch in shell.surface.patches))
    place = {name: number for number, name in enumerate(names)}
    face = np.array([place[patch.face] for patch in shell.surface.patches])
    bound = np.full(shell.element_count, -np.inf)
    bound[certificate.element] = certificate.min_bernstein
    proved = np.zeros(shell.element_count, dtype=bool)
    proved[certificate.element] = certificate.status >= VALID
    return ElementQuality(
        scaled_jacobian(shell.bezier_elements() if batches is None else batches),
        bound,
        proved,
        face[shell.element_patch],
        np.arange(shell.element_count) % shell.layer_count,
        tuple(names),
    )
