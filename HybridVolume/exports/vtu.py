# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""NAME.vtu: the exact shell as rational Bézier hexahedra and the core's tets in one file.

VTK_BEZIER_HEXAHEDRON has Euclidean control points, weights as point data and degrees as cell data;
both arrays are named by attributes of their tags. The file's version must be 2.1 or higher: from
older ones VTK swaps two edges of these cells.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from functools import cache
from typing import TYPE_CHECKING, BinaryIO

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from HybridVolume.core.atomic import replacing
from HybridVolume.core.elements import VTK_TYPES, to_order
from HybridVolume.core.validity import scaled_jacobian

from .vtk_xml import HEADER, Appended, strings_tag

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume

BEZIER_HEXAHEDRON = 79

_MERGED = 1e-12
"""Control points of neighbours this close, as a share of the diagonal, are one point."""


@cache
def bezier_order(degrees: tuple[int, int, int]) -> np.ndarray:
    """VTK's order of the control points of a Bézier hexahedron.

    Parameters
    ----------
    degrees : (p, q, r)

    Returns
    -------
    ((p + 1) * (q + 1) * (r + 1),) int array
        VTK's list is ``points.reshape(-1, 3)[order]`` for (p + 1, q + 1, r + 1, 3) points.
    """
    p, q, r = degrees
    i, j, k = (a.ravel() for a in np.indices((p + 1, q + 1, r + 1)))
    at_i, at_j, at_k = ((x == 0) | (x == d) for x, d in ((i, p), (j, q), (k, r)))
    ends = at_i.astype(int) + at_j + at_k
    p, q, r = p - 1, q - 1, r - 1
    corner = np.where(i > 0, np.where(j > 0, 2, 1), np.where(j > 0, 3, 0))
    place = np.where(ends == 3, corner + 4 * (k > 0), 0)
    edge = np.select(
        [~at_i, ~at_j, ~at_k],
        [
            (i - 1) + (p + q) * (j > 0) + 2 * (p + q) * (k > 0),
            (j - 1) + np.where(i > 0, p, 2 * p + q) + 2 * (p + q) * (k > 0),
            4 * (p + q) + (k - 1) + r * corner,
        ],
        0,
    )
    place = np.where(ends == 2, 8 + edge, place)
    face = np.select(
        [at_i, at_j, at_k],
        [
            (j - 1) + q * (k - 1) + q * r * (i > 0),
            2 * q * r + (i - 1) + p * (k - 1) + r * p * (j > 0),
            2 * q * r + 2 * r * p + (i - 1) + p * (j - 1) + p * q * (k > 0),
        ],
        0,
    )
    start = 8 + 4 * (p + q + r)
    place = np.where(ends == 1, start + face, place)
    inside = start + 2 * (q * r + r * p + p * q) + (i - 1) + p * ((j - 1) + q * (k - 1))
    place = np.where(ends == 0, inside, place)
    return np.argsort(place)


def write_vtu(path: str | os.PathLike, volume: HybridVolume) -> None:
    """Write shell and core into one file.

    Cell data: ``part`` (0 shell, 1 core), ``patch``, ``face`` (position in the field data
    ``face_names``), ``layer`` (0 outermost) - these three are -1 in the core -,
    ``scaled_jacobian`` and ``min_bernstein``.

    Parameters
    ----------
    path : path
    volume : HybridVolume

    Raises
    ------
    OSError
        The place cannot be written.
    """
    grid = _Grid()
    _add_shell(grid, volume)
    _add_core(grid, volume)
    with replacing(path) as file:
        _write(file, grid, list(volume.fem.face_names))


@dataclass
class _Grid:
    """Parts of an unstructured grid, collected."""

    points: list[np.ndarray] = field(default_factory=list)
    weights: list[np.ndarray] = field(default_factory=list)
    connectivity: list[np.ndarray] = field(default_factory=list)
    sizes: list[np.ndarray] = field(default_factory=list)
    cells: dict[str, list[np.ndarray]] = field(default_factory=dict)
    count: int = 0

    def add_points(self, points: np.ndarray, weights: np.ndarray) -> int:
        """Append points; the number of the first of them."""
        self.points.append(points)
        self.weights.append(weights)
        first, self.count = self.count, self.count + len(points)
        return first

    def add_cells(self, connectivity: np.ndarray, **data: np.ndarray | float) -> None:
        """Append cells of one size with their data."""
        self.connectivity.append(connectivity.ravel())
        self.sizes.append(np.full(len(connectivity), connectivity.shape[1]))
        for name, values in data.items():
            shape = (len(connectivity), *np.shape(values)[1:])
            self.cells.setdefault(name, []).append(np.broadcast_to(values, shape))


def _add_shell(grid: _Grid, volume: HybridVolume) -> None:
    shell, certificate = volume.shell, volume.certificate
    batches = shell.bezier_elements()
    quality = scaled_jacobian(batches)
    bound = np.empty(shell.element_count)
    bound[certificate.element] = certificate.min_bernstein
    place = {name: k for k, name in enumerate(volume.fem.face_names)}
    face = np.array([place[patch.face] for patch in shell.surface.patches])
    points, weights, orders = [], [], []
    for batch in batches:
        order = bezier_order(batch.degrees)
        local = batch.control_points.reshape(len(batch), -1, 3)[:, order]
        points.append(local.reshape(-1, 3))
        flat = np.ones(local.shape[:2])
        if batch.weights is not None:
            flat = batch.weights.reshape(len(batch), -1)[:, order]
        weights.append(flat.ravel())
        orders.append(len(order))
    merged, number = _merge(np.concatenate(points), np.concatenate(weights), volume)
    grid.add_points(np.concatenate(points)[merged], np.concatenate(weights)[merged])
    start = 0
    for batch, size in zip(batches, orders, strict=True):
        end = start + size * len(batch)
        grid.add_cells(
            number[start:end].reshape(-1, size),
            types=np.full(len(batch), BEZIER_HEXAHEDRON),
            degrees=np.tile(np.array(batch.degrees, dtype=float), (len(batch), 1)),
            part=np.zeros(len(batch)),
            patch=batch.patch,
            face=face[batch.patch],
            layer=batch.element % shell.layer_count,
            scaled_jacobian=quality[batch.element],
            min_bernstein=bound[batch.element],
        )
        start = end


def _add_core(grid: _Grid, volume: HybridVolume) -> None:
    fem = volume.fem
    used, number = np.unique(fem.tets, return_inverse=True)
    first = grid.add_points(fem.nodes[used], np.ones(len(used)))
    tets = first + number.reshape(fem.tets.shape)
    none = np.full(len(tets), -1)
    grid.add_cells(
        to_order("vtk", fem.tet_kind, tets),
        types=np.full(len(tets), VTK_TYPES[fem.tet_kind]),
        degrees=np.zeros((len(tets), 3)),
        part=np.ones(len(tets)),
        patch=none,
        face=none,
        layer=none,
        scaled_jacobian=fem.tet_quality,
        min_bernstein=fem.tet_bound,
    )


def _merge(
    points: np.ndarray, weights: np.ndarray, volume: HybridVolume
) -> tuple[np.ndarray, np.ndarray]:
    """Points that neighbouring elements share: the first of each group, and every one's group.

    Elements compute shared control points from the same ones, but may round differently; points of
    different weight stay apart.
    """
    scaled = np.column_stack([points / volume.surface.diagonal, weights])
    pairs = cKDTree(scaled).query_pairs(_MERGED, output_type="ndarray")
    graph = sparse.coo_matrix((np.ones(len(pairs)), pairs.T), shape=(len(points), len(points)))
    _, label = sparse.csgraph.connected_components(graph, directed=False)
    _, first = np.unique(label, return_index=True)
    order = np.argsort(first)
    rank = np.empty(len(first), dtype=np.int64)
    rank[order] = np.arange(len(first))
    return first[order], rank[label]


def _write(file: BinaryIO, grid: _Grid, names: list[str]) -> None:
    points = np.concatenate(grid.points)
    sizes = np.concatenate(grid.sizes)
    cells = {name: np.concatenate(parts) for name, parts in grid.cells.items()}
    appended = Appended()
    text = [
        HEADER,
        f"<FieldData>\n{strings_tag('face_names', names)}</FieldData>\n"
        f'<Piece NumberOfPoints="{len(points)}" NumberOfCells="{len(sizes)}">\n'
        '<PointData RationalWeights="RationalWeights">\n',
        appended.tag("RationalWeights", np.concatenate(grid.weights)),
        '</PointData>\n<CellData HigherOrderDegrees="HigherOrderDegrees">\n',
        appended.tag("HigherOrderDegrees", cells["degrees"]),
        appended.tag("part", cells["part"].astype(np.int8)),
        *(appended.tag(n, cells[n].astype(np.int32)) for n in ("patch", "face", "layer")),
        *(appended.tag(n, cells[n]) for n in ("scaled_jacobian", "min_bernstein")),
        "</CellData>\n<Points>\n",
        appended.tag("Points", points),
        "</Points>\n<Cells>\n",
        appended.tag("connectivity", np.concatenate(grid.connectivity).astype(np.int64)),
        appended.tag("offsets", np.cumsum(sizes).astype(np.int64)),
        appended.tag("types", cells["types"].astype(np.uint8)),
        "</Cells>\n</Piece>\n</UnstructuredGrid>\n",
    ]
    file.write("".join(text).encode("utf-8"))
    appended.finish(file)
