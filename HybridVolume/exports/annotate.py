# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Words around a drawing: title, bar of colours, labels at the margins, legend, ruler; bar charts.

Only the process that draws imports this module: it needs matplotlib.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

DOTS = 100
"""Pixels an inch: fonts are in points."""
INK = (0.12, 0.13, 0.15)


def annotate(
    path: str,
    image: np.ndarray,
    words: dict[str, Any],
    size: Sequence[int],
    inner: Sequence[int],
    places: Sequence[tuple[float, float]],
    height: float,
) -> None:
    """Write a picture with what belongs around it.

    Parameters
    ----------
    path : str
    image : (h, w, 3) array
        The drawing.
    words : dict
        ``title``, ``lines``, ``bar``, ``labels``, ``legend``, ``ruler`` of a scene.
    size : (int, int)
        Pixels of the picture.
    inner : (int, int, int, int)
        Corner from the left and from below, width and height of the drawing.
    places : sequence of (float, float)
        Of the labels, in pixels of the drawing.
    height : float
        Of the drawing, mm.
    """
    figure = _figure(size)
    x, y, w, h = inner
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.set_xlim(0, size[0])
    axes.set_ylim(0, size[1])
    axes.axis("off")
    axes.imshow(image, extent=(x, x + w, y, y + h), origin="upper", aspect="auto", zorder=0)
    axes.set_xlim(0, size[0])
    axes.set_ylim(0, size[1])
    _title(axes, words, size)
    if words["bar"]:
        _bar(figure, words["bar"], size, inner, labelled=bool(words["labels"]))
    _labels(axes, words["labels"], places, size, inner)
    _legend(axes, words["legend"], size)
    if words["ruler"]:
        _ruler(axes, height / h, size)
    figure.savefig(path, dpi=DOTS, facecolor="white", format="png")


def chart(path: str, values: dict[str, Any], size: Sequence[int]) -> None:
    """Write bars over a range, with their numbers and marked values.

    Parameters
    ----------
    path : str
    values : dict
        Of a :class:`HybridVolume.exports.scene.Chart`.
    size : (int, int)
        Pixels.
    """
    figure = _figure(size)
    page = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    page.set_xlim(0, size[0])
    page.set_ylim(0, size[1])
    page.axis("off")
    _title(page, values, size)
    axes = figure.add_axes((0.09, 0.11, 0.87, 0.72))
    edges, counts = np.array(values["edges"]), np.array(values["counts"])
    width = np.diff(edges)
    below = np.zeros(len(counts))
    for text, part, colour in values["parts"] or [("", counts, (0.30, 0.50, 0.74))]:
        axes.bar(edges[:-1], part, width, below, align="edge", color=colour,
                 edgecolor="white", linewidth=1.0, label=text)  # fmt: skip
        below = below + part
    top = max(1.0, float(counts.max()))
    for left, step, count in zip(edges, width, counts, strict=False):
        if count:
            axes.text(left + 0.5 * step, count + 0.01 * top, f"{count}", ha="center",
                      va="bottom", color=INK, fontsize=_points(size, 0.015))  # fmt: skip
    for number, (value, text) in enumerate(values["marks"]):
        level = (1.17 - 0.07 * number) * top
        axes.plot([value, value], [0.0, level], color=(0.75, 0.15, 0.10), linewidth=2.0,
                  linestyle=("-", "--")[number % 2])  # fmt: skip
        near_end = value > 0.72 * edges[-1]
        axes.text(value + (-0.008 if near_end else 0.008), level, text, va="top",
                  ha="right" if near_end else "left", color=(0.60, 0.10, 0.06),
                  fontsize=_points(size, 0.0175), zorder=5,
                  bbox={"facecolor": "white", "edgecolor": "none", "pad": 2.0})  # fmt: skip
    axes.set_xlim(edges[0], edges[-1])
    axes.set_ylim(0.0, 1.22 * top)
    axes.set_xlabel(values["x_label"], fontsize=_points(size, 0.019), color=INK)
    axes.set_ylabel(values["y_label"], fontsize=_points(size, 0.019), color=INK)
    axes.tick_params(labelsize=_points(size, 0.017), colors=INK)
    axes.spines[["top", "right"]].set_visible(False)
    if values["parts"]:
        axes.legend(loc="upper right", fontsize=_points(size, 0.017), labelcolor=INK, frameon=False)
    figure.savefig(path, dpi=DOTS, facecolor="white", format="png")


def _figure(size: Sequence[int]) -> Any:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(size[0] / DOTS, size[1] / DOTS), dpi=DOTS)
    FigureCanvasAgg(figure)
    return figure


def _points(size: Sequence[int], share: float) -> float:
    """Font size that is a share of the picture's height, points."""
    return share * size[1] * 72.0 / DOTS


def _title(axes: Any, words: dict[str, Any], size: Sequence[int]) -> None:
    width, height = size
    axes.text(0.02 * width, 0.975 * height, words["title"], va="top", color=INK,
              fontsize=_points(size, 0.026), fontweight="bold")  # fmt: skip
    for number, line in enumerate(words["lines"]):
        axes.text(0.02 * width, (0.937 - 0.03 * number) * height, line, va="top", color=INK,
                  fontsize=_points(size, 0.019))  # fmt: skip


def _bar(
    figure: Any, bar: dict[str, Any], size: Sequence[int], inner: Sequence[int], *, labelled: bool
) -> None:
    """The colours, with ticks; marked values to the left."""
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    left = (inner[0] + inner[2]) / size[0] + (0.14 if labelled else 0.06)
    place = (left, 0.22, 0.022, 0.56)
    axes = figure.add_axes(place)
    scale = ScalarMappable(Normalize(bar["low"], bar["high"]), bar["colours"])
    drawn = figure.colorbar(scale, cax=axes)
    drawn.ax.tick_params(labelsize=_points(size, 0.017), colors=INK)
    drawn.set_label(bar["label"], fontsize=_points(size, 0.019), color=INK)
    for value, text in bar["marks"]:
        axes.plot([0.0, 1.0], [value, value], color="black", linewidth=2.0,
                  transform=axes.get_yaxis_transform(), clip_on=False)  # fmt: skip
        axes.text(-0.25, value, text, ha="right", va="center", color=INK,
                  transform=axes.get_yaxis_transform(), fontsize=_points(size, 0.017))  # fmt: skip


def _labels(
    axes: Any,
    labels: Sequence[Any],
    places: Sequence[tuple[float, float]],
    size: Sequence[int],
    inner: Sequence[int],
) -> None:
    """Labels in two columns beside the drawing, in the order of their places: no lines cross."""
    if not labels:
        return
    x, y, w, h = inner
    at = np.array(places) + np.array([x, y])
    order = np.argsort(at[:, 0], kind="stable")
    half = len(order) // 2
    for side, members in (("left", order[:half]), ("right", order[half:])):
        members = members[np.argsort(-at[members, 1], kind="stable")]
        step = min(h / max(len(members), 1), 0.1 * size[1])
        centre = np.clip(
            at[members, 1].mean() if len(members) else 0.0,
            y + 0.5 * step * len(members),
            y + h - 0.5 * step * len(members),
        )
        for number, k in enumerate(members):
            level = centre + step * (0.5 * (len(members) - 1) - number)
            text, colour = labels[k]
            edge = x - 6 if side == "left" else x + w + 6
            axes.text(edge, level, text, va="center", ha="right" if side == "left" else "left",
                      color=colour, fontsize=_points(size, 0.0165))  # fmt: skip
            axes.plot([edge + (3 if side == "left" else -3), at[k, 0]], [level, at[k, 1]],
                      color=colour, linewidth=1.0, zorder=3)  # fmt: skip
            axes.plot(*at[k], marker="o", markersize=5, color=colour, zorder=4,
                      markeredgecolor="white", markeredgewidth=0.8)  # fmt: skip


def _legend(axes: Any, legend: Sequence[Any], size: Sequence[int]) -> None:
    """Patches of colour with their words, in a line at the foot."""
    from matplotlib.patches import Rectangle

    if not legend:
        return
    width, height = size
    font = _points(size, 0.0175)
    x, y, side = 0.02 * width, 0.035 * height, 0.02 * height
    renderer = axes.figure.canvas.get_renderer()
    for colour, text in legend:
        axes.add_patch(Rectangle((x, y - 0.5 * side), side, side, color=colour, zorder=3))
        drawn = axes.text(x + 1.5 * side, y, text, va="center", fontsize=font, color=INK)
        x = drawn.get_window_extent(renderer).x1 + 1.6 * side


def _ruler(axes: Any, pixel: float, size: Sequence[int]) -> None:
    """A round length near an eighth of the picture's width, at the foot on the right."""
    width, height = size
    length = round_length(0.125 * width * pixel)
    x1, y = 0.97 * width, 0.035 * height
    x0 = x1 - length / pixel
    tick = 0.008 * height
    axes.plot([x0, x0, x0, x1, x1, x1], [y - tick, y + tick, y, y, y + tick, y - tick],
              color=INK, linewidth=2.0)  # fmt: skip
    axes.text(0.5 * (x0 + x1), y + 0.012 * height, f"{length:g} mm", ha="center", va="bottom",
              fontsize=_points(size, 0.0175), color=INK)  # fmt: skip


def round_length(length: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a length."""
    power = 10.0 ** np.floor(np.log10(length))
    share = length / power
    return float(power * (5.0 if share >= 5.0 else 2.0 if share >= 2.0 else 1.0))
