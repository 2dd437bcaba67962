# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A sector of a hollow sphere under inner pressure, meshed by hand, with Lamé's exact solution."""

from __future__ import annotations

import numpy as np

from HybridVolume.core.elements import EDGES
from HybridVolume.core.recovery import Material

INNER, OUTER, PRESSURE = 1.0, 2.0, 1.0
MATERIAL = Material(1000.0, 0.3)


def displacement(x: np.ndarray) -> np.ndarray:
    """Displacement of (m, 3) points, mm."""
    young, poisson = MATERIAL.young, MATERIAL.poisson
    scale = PRESSURE * INNER**3 / (OUTER**3 - INNER**3) / young
    radius = np.linalg.norm(x, axis=1, keepdims=True)
    share = 1.0 - 2.0 * poisson + 0.5 * (1.0 + poisson) * (OUTER / radius) ** 3
    return scale * share * x


def stress(x: np.ndarray) -> np.ndarray:
    """Stress at (m, 3) points, (m, 6), MPa."""
    scale = PRESSURE * INNER**3 / (OUTER**3 - INNER**3)
    radius = np.linalg.norm(x, axis=1)
    cube = (OUTER / radius) ** 3
    radial, hoop = scale * (1.0 - cube), scale * (1.0 + 0.5 * cube)
    normal = x / radius[:, None]
    full = hoop[:, None, None] * np.eye(3) + (radial - hoop)[:, None, None] * (
        normal[:, :, None] * normal[:, None, :]
    )
    return full[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def mesh(count: int, layers: int, wedges: int) -> tuple[np.ndarray, list[tuple[str, np.ndarray]]]:
    """Nodes (n, 3) and elements of the sector, see `cube`."""
    places, elements = cube(count, layers, wedges)
    ray = np.column_stack([places[:, :2] - 0.5, np.ones(len(places))])
    ray /= np.linalg.norm(ray, axis=1, keepdims=True)
    return ray * (INNER + (OUTER - INNER) * places[:, 2:] ** 1.5), elements


def cube(count: int, layers: int, wedges: int) -> tuple[np.ndarray, list[tuple[str, np.ndarray]]]:
    """Nodes (n, 3) in the unit cube, and elements: wedges in the lowest layers, tets in the others.

    Parameters
    ----------
    count : int
        Elements along a side of the sector.
    layers, wedges : int
        Layers through the wall, and how many of them are wedges.
    """
    # a doubled grid: mid nodes are grid points as well
    along, up = np.linspace(0.0, 1.0, 2 * count + 1), np.linspace(0.0, 1.0, 2 * layers + 1)
    nodes = np.stack(np.meshgrid(along, along, up, indexing="ij"), axis=-1).reshape(-1, 3)

    def number(place: np.ndarray) -> np.ndarray:
        i, j, k = np.moveaxis(place, -1, 0)
        return (i * (2 * count + 1) + j) * (2 * layers + 1) + k

    def elements(kind: str, corners: np.ndarray) -> np.ndarray:
        middle = [corners[:, [a, b]].mean(axis=1).astype(int) for a, b in EDGES[kind]]
        return number(np.concatenate([corners, np.stack(middle, axis=1)], axis=1))

    squares = np.stack(np.meshgrid(np.arange(count), np.arange(count), indexing="ij"), axis=-1)
    squares = 2 * squares.reshape(-1, 2)
    offsets = np.array([[[0, 0], [2, 0], [2, 2]], [[0, 0], [2, 2], [0, 2]]])
    triangles = (squares[:, None, None] + offsets).reshape(-1, 3, 2)
    prisms = []
    for layer in range(layers):
        levels = [
            np.dstack([triangles, np.full(triangles.shape[:2], 2 * layer + up)]) for up in (0, 2)
        ]
        prisms.append(np.concatenate(levels, axis=1))
    found = [("penta15", elements("penta15", np.concatenate(prisms[:wedges])))] if wedges else []
    if wedges < layers:
        rest = np.concatenate(prisms[wedges:])
        # corners sorted by place: neighbours cut their common side alike
        order = np.argsort(rest[:, :3] @ [10_000, 1, 0], axis=1)
        base = np.take_along_axis(rest[:, :3], order[..., None], axis=1)
        top = np.take_along_axis(rest[:, 3:], order[..., None], axis=1)
        both = np.concatenate([base, top], axis=1)
        tets = both[:, np.array([[0, 1, 2, 5], [0, 1, 5, 4], [0, 4, 5, 3]])].reshape(-1, 4, 3)
        place = nodes[number(tets)]
        turned = np.linalg.det(place[:, 1:] - place[:, :1]) < 0.0
        tets[turned] = tets[turned][:, [0, 2, 1, 3]]
        found.append(("tet10", elements("tet10", tets)))
    used, rows = np.unique(np.concatenate([part.ravel() for _, part in found]), return_inverse=True)
    sizes = np.cumsum([part.size for _, part in found])[:-1]
    split = np.split(rows.reshape(-1), sizes)
    return nodes[used], [
        (kind, new.reshape(part.shape)) for (kind, part), new in zip(found, split, strict=True)
    ]
