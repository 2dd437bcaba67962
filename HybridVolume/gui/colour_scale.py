# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Figures as colours, and the bar that explains them in the 3D view."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from pivy import coin

from .coin_nodes import Faces, Lines, look, separator, switch, turn, unlit, unpickable
from .coin_nodes import without_extent as _without_extent

_Stops = tuple[tuple[float, tuple[float, float, float]], ...]

TRAFFIC_LIGHT: _Stops = (
    (0.0, (1.0, 0.0, 0.1)),
    (0.5, (1.0, 1.0, 0.1)),
    (1.0, (0.0, 1.0, 0.1)),
)
"""Quality of elements: 0 is folded, 1 is a box."""

REACHED: _Stops = (
    (0.00, (0.55, 0.00, 0.15)),
    (0.40, (0.86, 0.10, 0.12)),
    (0.70, (0.98, 0.55, 0.15)),
    (0.90, (0.99, 0.90, 0.45)),
    (0.97, (0.62, 0.85, 0.48)),
    (1.03, (0.35, 0.75, 0.42)),
    (1.10, (0.35, 0.65, 0.85)),
    (1.25, (0.15, 0.35, 0.75)),
)
"""What is reached of what was asked: green as asked, red thinner, blue thicker."""

RISING: _Stops = (
    (0.00, (0.27, 0.00, 0.33)),
    (0.25, (0.23, 0.32, 0.55)),
    (0.50, (0.13, 0.57, 0.55)),
    (0.75, (0.37, 0.79, 0.38)),
    (1.00, (0.99, 0.91, 0.14)),
)
"""From little to much; readable without telling red from green."""


@dataclass(frozen=True)
class ColourScale:
    """Colours for an interval of figures.

    Attributes
    ----------
    title : str
    low, high : float
        Figures beyond have the colour of the end.
    stops : tuple of (float, (r, g, b))
        Places in the interval's own measure (``absolute``) or as shares of it.
    text : callable
        Turns a figure of the bar into words.
    absolute : bool
    ticks : tuple of float
        Figures beside the bar; none: five, evenly.
    """

    title: str
    low: float
    high: float
    stops: _Stops
    text: Callable[[float], str]
    absolute: bool = False
    ticks: tuple[float, ...] = ()

    def rgb(self, values: np.ndarray) -> np.ndarray:
        """Colours of figures, (n, 3) in [0, 1]."""
        values = np.clip(np.asarray(values, dtype=float), self.low, self.high)
        if not self.absolute:
            values = (values - self.low) / max(self.high - self.low, np.finfo(float).tiny)
        place, colours = (np.array(column) for column in zip(*self.stops, strict=True))
        return np.stack([np.interp(values, place, channel) for channel in colours.T], axis=-1)

    def packed(self, values: np.ndarray) -> np.ndarray:
        """Colours of figures as Coin packs them, (n,) int array of 0xRRGGBBFF."""
        return packed(self.rgb(values))

    @property
    def marks(self) -> Sequence[float]:
        """Figures that stand beside the bar."""
        return self.ticks or tuple(np.linspace(self.low, self.high, 5).tolist())


def packed(rgb: np.ndarray) -> np.ndarray:
    """Colours (n, 3) in [0, 1] as (n,) ints 0xRRGGBBFF."""
    levels = np.round(255.0 * np.clip(rgb, 0.0, 1.0)).astype(np.int64)
    return (levels[..., 0] << 24) | (levels[..., 1] << 16) | (levels[..., 2] << 8) | 0xFF


def quality_scale() -> ColourScale:
    """Scaled Jacobian, 0 to 1."""
    return ColourScale("scaled Jacobian", 0.0, 1.0, TRAFFIC_LIGHT, lambda x: f"{x:.2f}")


def share_scale() -> ColourScale:
    """Reached of asked; the same colours for every body."""
    return ColourScale(
        "reached / asked",
        *(0.0, 1.25, REACHED, lambda x: f"{100.0 * x:.0f} %"),
        absolute=True,
        ticks=(0.0, 0.25, 0.5, 0.75, 0.9, 1.0, 1.1, 1.25),
    )


def level_scale(highest: float) -> ColourScale:
    """Level w from 0 to the highest that is there."""
    return ColourScale("level w", 0.0, highest, RISING, lambda x: f"{x:.2f}")


def thickness_scale(highest: float) -> ColourScale:
    """Millimetres from 0 to the largest thickness."""
    return ColourScale("thickness, mm", 0.0, highest, RISING, lambda x: f"{x:.3g}")


class Legend:
    """A bar of colours with figures at the right edge of the 3D view.

    Attributes
    ----------
    node : SoSwitch
    """

    LEFT, RIGHT, BOTTOM, TOP = 0.82, 0.85, -0.55, 0.35
    """Of the bar, in a view that reaches from -1 to 1 both ways."""

    STEPS = 64
    INK = (0.05, 0.05, 0.08)

    def __init__(self) -> None:
        camera = coin.SoOrthographicCamera()
        camera.viewportMapping = coin.SoCamera.LEAVE_ALONE
        camera.aspectRatio, camera.height = 1.0, 2.0
        camera.position = (0.0, 0.0, 1.0)
        camera.nearDistance, camera.farDistance = 0.5, 2.0
        self._bar, self._frame = Faces(lit=False), Lines(self.INK, 1.0)
        self._texts = coin.SoSeparator()
        on_top = coin.SoAnnotation()
        for node in (camera, unpickable(), self._bar.node, self._frame.node, self._texts):
            on_top.addChild(node)
        self.node = switch(_without_extent(on_top), on=False)

    def show(self, scale: ColourScale | None) -> None:
        """Explain a scale; None hides the bar."""
        turn(self.node, scale is not None)
        if scale is None:
            return
        share = np.linspace(0.0, 1.0, self.STEPS + 1)
        y = self.BOTTOM + (self.TOP - self.BOTTOM) * share
        points = np.zeros((2, len(y), 3))
        points[0, :, 0], points[1, :, 0], points[:, :, 1] = self.LEFT, self.RIGHT, y
        low = np.arange(self.STEPS)
        a, b = low, low + len(y)
        triangles = np.concatenate(
            [np.stack([a, b, b + 1], axis=1), np.stack([a, b + 1, a + 1], axis=1)]
        )
        colours = scale.packed(scale.low + (scale.high - scale.low) * np.tile(share, 2))
        normals = np.tile([0.0, 0.0, 1.0], (points.size // 3, 1))
        self._bar.show(points.reshape(-1, 3), triangles, normals, colours)
        self._texts.removeAllChildren()
        self._texts.addChild(unlit())
        self._texts.addChild(look(self.INK))
        self._write(scale.title, 0.98, self.TOP + 0.06, 14, right=True)
        corners = [(x, y) for x in (self.LEFT, self.RIGHT) for y in (self.BOTTOM, self.TOP)]
        points, rows = [(x, y, 0.01) for x, y in corners], [(0, 1), (1, 3), (3, 2), (2, 0)]
        for value in scale.marks:
            place = (value - scale.low) / max(scale.high - scale.low, np.finfo(float).tiny)
            y = self.BOTTOM + (self.TOP - self.BOTTOM) * place
            rows.append((len(points), len(points) + 1))
            points += [(self.RIGHT, y, 0.01), (self.RIGHT + 0.012, y, 0.01)]
            self._write(scale.text(value), self.RIGHT + 0.02, y - 0.012, 12)
        self._frame.show(np.array(points), np.array(rows))

    def _write(self, text: str, x: float, y: float, size: int, *, right: bool = False) -> None:
        place, font, words = coin.SoTranslation(), coin.SoFont(), coin.SoText2()
        if right:
            words.justification = coin.SoText2.RIGHT
        place.translation = (x, y, 0.0)
        font.size = size
        font.name = "sans"
        words.string = text
        self._texts.addChild(separator(place, font, words))
