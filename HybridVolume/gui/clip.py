# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The plane that cuts a view open, and the widgets that move it; every panel has the same."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from pivy import coin

AXES = (("x", (1.0, 0.0, 0.0)), ("y", (0.0, 1.0, 0.0)), ("z", (0.0, 0.0, 1.0)), ("view", None))
"""Names of directions; None stands for the one that the camera looks along."""


def plane_across(
    low: np.ndarray, high: np.ndarray, direction: tuple[float, float, float], share: float
) -> tuple[np.ndarray, float]:
    """The plane across a direction that has passed a share of a box.

    Parameters
    ----------
    low, high : (3,) arrays
        Corners of the box, mm.
    direction : (3,) floats
    share : float
        In [0, 1].

    Returns
    -------
    normal : (3,) array
        Unit vector along the direction.
    distance : float
        The plane is ``normal . x = distance``.
    """
    normal = np.array(direction, dtype=float)
    normal /= np.linalg.norm(normal)
    first = np.where(normal > 0.0, low, high) @ normal
    last = np.where(normal > 0.0, high, low) @ normal
    return normal, float((1.0 - share) * first + share * last)


class ClipNode:
    """Coin's plane; what comes after it in the scene is cut.

    Attributes
    ----------
    node : SoClipPlane
    """

    def __init__(self) -> None:
        self.node = coin.SoClipPlane()
        self.node.on = False

    def set(self, normal: np.ndarray | None, distance: float = 0.0) -> None:
        """Cut away what lies before a plane; None shows everything.

        Parameters
        ----------
        normal : (3,) array, optional
            Points x with ``normal . x > distance`` stay.
        distance : float
            mm.
        """
        self.node.on = normal is not None
        if normal is not None:
            self.node.plane = coin.SbPlane(coin.SbVec3f(*map(float, normal)), float(distance))


class ClipControls:
    """Widgets ``clip``, ``clipAxis``, ``clipSlider`` and, where it is there, ``clipFlip``.

    Parameters
    ----------
    form : QWidget
    looking : callable
        Returns the direction that the camera looks along.
    cut : callable(direction or None, share)
        What comes first along the direction is hidden, up to the share of the body.
    """

    def __init__(
        self,
        form: Any,
        looking: Callable[[], tuple[float, float, float]],
        cut: Callable[[tuple[float, float, float] | None, float], None],
    ) -> None:
        self._form = form
        self._looking = looking
        self._cut = cut
        self._direction: tuple[float, float, float] = AXES[0][1]
        self._flip = getattr(form, "clipFlip", None)
        form.clipAxis.addItems([name for name, _ in AXES])
        form.clip.toggled.connect(lambda *_: self._turn())
        form.clipAxis.activated.connect(lambda *_: self._take_axis())
        form.clipSlider.valueChanged.connect(lambda *_: self.show())
        if self._flip is not None:
            self._flip.toggled.connect(lambda *_: self.show())

    def show(self) -> None:
        """Cut as the widgets say."""
        form = self._form
        if not form.clip.isChecked():
            self._cut(None, 0.0)
            return
        # beside round shares: there knot lines of even bodies lie, and what touches is not cut
        share = (form.clipSlider.value() + 0.4) / (form.clipSlider.maximum() + 1.0)
        direction = self._direction
        if self._flip is not None and self._flip.isChecked():
            direction, share = tuple(-x for x in direction), 1.0 - share
        self._cut(direction, share)

    def _take_axis(self) -> None:
        if not self._form.clip.isChecked():
            self._form.clip.setChecked(True)  # comes back through _turn
            return
        self._turn()

    def _turn(self) -> None:
        # the camera's direction stays until it is asked for again: the slider moves one plane
        axis, looking = AXES[self._form.clipAxis.currentIndex()][1], self._looking()
        # what is nearer to the eye goes, so that the section is seen
        away = axis is not None and np.dot(axis, looking) < 0.0
        self._direction = tuple(-x for x in axis) if away else axis or looking
        self.show()
