# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Quality of a finite element mesh: element by element, and summed up by group.

All figures are those of the curved elements: derivatives of the map along the edges, and from them
into the two faces that meet there, give lengths and angles; derivatives along the faces give areas.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from .element_jacobians import volumes
from .elements import EDGES, FACES, gauss_line, quadrature, reference, shape_gradients

if TYPE_CHECKING:
    from .finite_elements import FiniteElementMesh

BINS = 20
"""Bars of the histogram of the scaled Jacobian, from 0 to 1."""
SHELL, CORE, ALL = "Shell", "Core", "All"
"""Groups: the wedges, the tets, and both together."""

_CHUNK = 512
"""Elements at once, so that what is computed for them stays in the cache."""
_ALONG = np.array([0.0, 0.5 - np.sqrt(3.0 / 28.0), 0.5, 0.5 + np.sqrt(3.0 / 28.0), 1.0])
_ALONG_WEIGHTS = np.array([9.0, 49.0, 64.0, 49.0, 9.0]) / 180.0
"""Lobatto's rule on an edge: its ends and its middle are among the points."""


@dataclass(frozen=True)
class ElementFigures:
    """Figures of the elements of one kind, in the order of the mesh.

    Attributes
    ----------
    kind : {"penta15", "penta6", "tet10", "tet4"}
    scaled_jacobian : (m,) array
        Smallest over a lattice of points: 1 is a regular tet or a regular wedge, 0 a flat one.
    bound : (m,) array
        Proved lower bound of det J over the mean edge product.
    dihedral : (m, 2) array
        Smallest and largest angle between two faces along the edges, degrees. A regular tet has
        70.5, a regular wedge 60 and 90.
    aspect : (m,) array
        Longest edge over smallest height, 1 for a regular tet and for a wedge of equal edges.
    shortest_edge, longest_edge : (m,) arrays
        Lengths of curved edges, mm.
    volume : (m,) array
        mm³
    centre : (m, 3) array
        Mean of the corners, mm.
    """

    kind: str
    scaled_jacobian: np.ndarray
    bound: np.ndarray
    dihedral: np.ndarray
    aspect: np.ndarray
    shortest_edge: np.ndarray
    longest_edge: np.ndarray
    volume: np.ndarray
    centre: np.ndarray

    def __len__(self) -> int:
        return len(self.scaled_jacobian)


@dataclass(frozen=True)
class Spread:
    """Smallest, mean and largest value of a figure."""

    min: float
    mean: float
    max: float

    @staticmethod
    def of(*values: np.ndarray) -> Spread:
        """Spread of all values of some arrays."""
        x = np.concatenate(values)
        return Spread(float(x.min()), float(x.mean()), float(x.max()))


@dataclass(frozen=True)
class GroupQuality:
    """Figures of a group of elements.

    Attributes
    ----------
    name : str
    kinds : tuple of str
    elements : int
    scaled_jacobian : Spread
    min_bound : float
        Smallest proved lower bound of det J over the mean edge product.
    min_dihedral, max_dihedral : float
        The worst angles between faces of an element, degrees.
    aspect : Spread
        See `ElementFigures`.
    edge : Spread
        mm; the mean is over the shortest and the longest edge of every element.
    volume : Spread
        Of an element, mm³.
    total_volume : float
        mm³
    histogram : tuple of int
        Elements by their scaled Jacobian, `BINS` equal steps from 0 to 1.
    """

    name: str
    kinds: tuple[str, ...]
    elements: int
    scaled_jacobian: Spread
    min_bound: float
    min_dihedral: float
    max_dihedral: float
    aspect: Spread
    edge: Spread
    volume: Spread
    total_volume: float
    histogram: tuple[int, ...]


@dataclass(frozen=True)
class WorstElement:
    """An element to look at.

    Attributes
    ----------
    group : {"Shell", "Core"}
    index : int
        Its place among the wedges or the tets of the mesh.
    number : int
        Its number in NAME.inp, from 1: wedges first, then tets.
    face : str
        CAD face that a wedge lies under; empty for a tet.
    layer : int
        Layer of a wedge, 0 is the outermost; -1 for a tet.
    scaled_jacobian : float
    centre : (x, y, z)
        mm
    """

    group: str
    index: int
    number: int
    face: str
    layer: int
    scaled_jacobian: float
    centre: tuple[float, float, float]


@dataclass(frozen=True)
class MeshQuality:
    """Quality of a mesh.

    Attributes
    ----------
    shell, core : ElementFigures
        Of the wedges and of the tets.
    wedge_face : (m,) int array
        Place in ``face_names`` of the CAD face over each wedge.
    wedge_layer : (m,) int array
        0 is the outermost.
    face_names : tuple of str
    """

    shell: ElementFigures
    core: ElementFigures
    wedge_face: np.ndarray
    wedge_layer: np.ndarray
    face_names: tuple[str, ...]

    @cached_property
    def groups(self) -> tuple[GroupQuality, ...]:
        """Shell, Core and All, without those that have no elements."""
        parts = {SHELL: [self.shell], CORE: [self.core], ALL: [self.shell, self.core]}
        return tuple(_group(name, p) for name, p in parts.items() if any(map(len, p)))

    def group(self, name: str) -> GroupQuality:
        """One group by its name; KeyError where it has no elements."""
        return {group.name: group for group in self.groups}[name]

    @cached_property
    def scaled_jacobian(self) -> np.ndarray:
        """Of all elements in the order of their numbers in NAME.inp, (m + k,)."""
        return np.concatenate([self.shell.scaled_jacobian, self.core.scaled_jacobian])

    def below(self, value: float) -> int:
        """Number of elements with a smaller scaled Jacobian."""
        return int(np.count_nonzero(self.scaled_jacobian < value))

    def worst(self, count: int = 10) -> tuple[WorstElement, ...]:
        """Elements of the smallest scaled Jacobians, the worst first."""
        return tuple(
            self._element(int(number))
            for number in np.argsort(self.scaled_jacobian, kind="stable")[:count]
        )

    def least_by_face(self) -> dict[str, float]:
        """Smallest scaled Jacobian of the wedges under each CAD face."""
        least = np.full(len(self.face_names), np.inf)
        np.minimum.at(least, self.wedge_face, self.shell.scaled_jacobian)
        return {
            name: float(value)
            for name, value in zip(self.face_names, least, strict=True)
            if np.isfinite(value)
        }

    def figures(self) -> dict[str, Any]:
        """Plain values for report.json: each group, and the worst elements."""
        groups = {}
        for group in self.groups:
            values = asdict(group)
            name = values.pop("name").lower()
            groups[name] = {**values, "kinds": list(group.kinds), "histogram": [*group.histogram]}
        worst = [{**asdict(one), "centre": list(one.centre)} for one in self.worst()]
        return {"groups": groups, "worst": worst}

    def _element(self, number: int) -> WorstElement:
        wedge = number < len(self.shell)
        index = number if wedge else number - len(self.shell)
        part = self.shell if wedge else self.core
        return WorstElement(
            SHELL if wedge else CORE,
            index,
            number + 1,
            self.face_names[self.wedge_face[index]] if wedge else "",
            int(self.wedge_layer[index]) if wedge else -1,
            float(part.scaled_jacobian[index]),
            tuple(part.centre[index].tolist()),
        )


def mesh_quality(mesh: FiniteElementMesh) -> MeshQuality:
    """Quality of every element of a mesh.

    Parameters
    ----------
    mesh : FiniteElementMesh

    Returns
    -------
    MeshQuality
    """
    face_of_patch = np.zeros(int(mesh.wedge_patch.max(initial=-1)) + 1, dtype=np.int64)
    face_of_patch[mesh.wedge_patch[mesh.boundary_wedge]] = mesh.boundary_face
    return MeshQuality(
        element_figures(
            mesh.wedge_kind, mesh.nodes[mesh.wedges], mesh.wedge_quality, mesh.wedge_bound
        ),
        element_figures(mesh.tet_kind, mesh.nodes[mesh.tets], mesh.tet_quality, mesh.tet_bound),
        face_of_patch[mesh.wedge_patch],
        mesh.wedge_layer,
        mesh.face_names,
    )


def element_figures(
    kind: str, coordinates: np.ndarray, scaled_jacobian: np.ndarray, bound: np.ndarray
) -> ElementFigures:
    """Figures of elements of one kind.

    Parameters
    ----------
    kind : {"penta15", "penta6", "tet10", "tet4"}
    coordinates : (m, n, 3) array
        Nodes of each element, mm.
    scaled_jacobian, bound : (m,) arrays
        Kept as they are: the mesh has them from its proof.

    Returns
    -------
    ElementFigures
    """
    coordinates = np.asarray(coordinates, dtype=float)
    edges, angles, areas = [], [], []
    for start in range(0, len(coordinates), _CHUNK):
        part = coordinates[start : start + _CHUNK]
        lengths, dihedral = _edges(kind, part)
        edges.append(lengths)
        angles.append(dihedral)
        areas.append(_face_areas(kind, part))
    count = len(EDGES[kind])
    length = np.concatenate([np.empty((0, count)), *edges])
    size = volumes(kind, coordinates) if len(coordinates) else np.empty(0)
    return ElementFigures(
        kind,
        np.asarray(scaled_jacobian),
        np.asarray(bound),
        np.concatenate([np.empty((0, 2)), *angles]),
        _aspect(kind, length, np.concatenate([np.empty((0, len(FACES[kind]))), *areas]), size),
        length.min(axis=1, initial=np.inf),
        length.max(axis=1, initial=0.0),
        size,
        coordinates[:, : reference(kind).corners].mean(axis=1).reshape(-1, 3),
    )


@cache
def _edge_derivatives(kind: str) -> np.ndarray:
    """Weights of the nodes in derivatives at points of the edges, (n, 3 * edges * points).

    Three a point: along the edge, and from it into one and the other of the faces that meet there,
    which are a right-handed frame.
    """
    nodes = reference(kind).nodes
    columns = []
    for edge in EDGES[kind]:
        start, along = nodes[edge[0]], nodes[edge[1]] - nodes[edge[0]]
        into = []
        for face in FACES[kind]:
            corners = face[: len(face) // 2] if len(face) > 4 else face
            if set(edge) <= set(corners):
                # the corner next to the edge's start that is not its end
                at = corners.index(edge[0])
                beside = {corners[at - 1], corners[(at + 1) % len(corners)]} - {edge[1]}
                into.append(nodes[beside.pop()] - start)
        if np.linalg.det([along, *into]) < 0.0:
            into.reverse()
        gradients = shape_gradients(kind, start + _ALONG[:, None] * along)
        columns.append(np.einsum("qnd,kd->nkq", gradients, [along, *into]))
    return np.stack(columns, axis=2).reshape(len(nodes), -1)


def _edges(kind: str, coordinates: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lengths of the edges, (m, ne), and smallest and largest dihedral angle, (m, 2), degrees."""
    along, one, other = _derivatives(coordinates, _edge_derivatives(kind), 3)
    square = _dot(along, along)
    length = np.sqrt(square)
    sine = length * _dot(along, _cross(one, other))
    cosine = square * _dot(one, other) - _dot(along, one) * _dot(along, other)
    # from sine and cosine it is exact where it is small; a negative one would be of an element
    # that is turned inside out
    angle = np.degrees(np.arctan2(sine, cosine)) % 360.0
    lengths = length.reshape(len(coordinates), -1, len(_ALONG)) @ _ALONG_WEIGHTS
    return lengths, np.column_stack([angle.min(axis=1), angle.max(axis=1)])


@cache
def _face_derivatives(kind: str) -> tuple[np.ndarray, np.ndarray]:
    """The same for two derivatives along each face, and the weights of the points, (nf, points)."""
    nodes = reference(kind).nodes
    columns, weights = [], []
    for face in FACES[kind]:
        corners = face[: len(face) // 2] if len(face) > 4 else face
        start = nodes[corners[0]]
        sides = nodes[[corners[1], corners[-1]]] - start
        points, w = quadrature("tri", 2)
        if len(corners) == 4:
            x, one = gauss_line(2)
            points = np.column_stack([np.repeat(x, 2), np.tile(x, 2)])
            w = np.outer(one, one).ravel()
        gradients = shape_gradients(kind, start + points @ sides)
        columns.append(np.einsum("qnd,kd->nkq", gradients, sides))
        weights.append(w)
    return np.stack(columns, axis=2).reshape(len(nodes), -1), np.array(weights)


def _face_areas(kind: str, coordinates: np.ndarray) -> np.ndarray:
    """Areas of the curved faces, (m, nf), mm²."""
    derivatives, weights = _face_derivatives(kind)
    normal = _cross(*_derivatives(coordinates, derivatives, 2))
    size = np.sqrt(_dot(normal, normal)).reshape(len(coordinates), *weights.shape)
    return np.einsum("efq,fq->ef", size, weights)


def _derivatives(coordinates: np.ndarray, weights: np.ndarray, count: int) -> np.ndarray:
    """Derivatives of the map, (count, 3, m, places)."""
    found = coordinates.transpose(2, 0, 1).reshape(-1, len(weights)) @ weights
    return found.reshape(3, len(coordinates), count, -1).transpose(2, 0, 1, 3)


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def _cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross product of vectors whose components come first; np.cross is far slower."""
    return np.stack(
        [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
    )


def _aspect(kind: str, length: np.ndarray, area: np.ndarray, volume: np.ndarray) -> np.ndarray:
    """Longest edge over smallest height, as a multiple of the regular element's.

    Heights are of volumes over areas: of a tet 3 V / A, between a wedge's triangles V / A, and of
    a wedge's triangle 2 V over the area of the side under it.
    """
    if kind.startswith("penta"):
        factors, regular = np.array([1.0, 1.0, 2.0, 2.0, 2.0]), np.sqrt(0.75)
    else:
        factors, regular = np.full(4, 3.0), np.sqrt(2.0 / 3.0)
    height = volume * (factors / area).min(axis=1, initial=np.inf)
    return regular * length.max(axis=1, initial=0.0) / height


def _group(name: str, parts: list[ElementFigures]) -> GroupQuality:
    parts = [part for part in parts if len(part)]
    quality = np.concatenate([part.scaled_jacobian for part in parts])
    counts, _ = np.histogram(np.clip(quality, 0.0, 1.0), BINS, (0.0, 1.0))
    dihedral = np.concatenate([part.dihedral for part in parts])
    size = Spread.of(*_each(parts, "volume"))
    return GroupQuality(
        name,
        tuple(part.kind for part in parts),
        len(quality),
        Spread.of(quality),
        float(min(part.bound.min() for part in parts)),
        float(dihedral[:, 0].min()),
        float(dihedral[:, 1].max()),
        Spread.of(*_each(parts, "aspect")),
        Spread.of(*_each(parts, "shortest_edge"), *_each(parts, "longest_edge")),
        size,
        float(sum(part.volume.sum() for part in parts)),
        tuple(counts.tolist()),
    )


def _each(parts: list[ElementFigures], name: str) -> Iterator[np.ndarray]:
    return (getattr(part, name) for part in parts)
