# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The boundary of a mesh as smooth faces: normals, areas, and derivatives along it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import scipy.sparse.csgraph as csgraph

from .elements import EDGES, FACES, quadrature, reference, shape_functions, shape_gradients

CREASE = 30.0
"""Degrees between the normals of two triangles from which their common edge is sharp."""

SEAM = 10.0
"""The same for a common edge of two CAD faces, by the normals that each of them has there."""
STEEPEST = 45.0
"""Degrees between normals up to which a point is seen from the tangent plane of another."""
_NEAR = 0.03
"""Square of the distance, as a share of the farthest, within which all weights are alike."""
_HOLD = 1e-4
"""Weight that holds cubic terms back, as a share of the far points'."""
_MARGIN = {2: 1.0, 3: 1.5}
"""Points an unknown of a quadric, of a cubic."""
_TRUST = 1.0
"""Largest change by a cubic as a multiple of that by the quadric."""
_SINGULAR = 1e-7
_BLOCK = 5_000


@dataclass(frozen=True)
class Boundary:
    """Triangles of a boundary, and what is known of them from outside the mesh.

    Attributes
    ----------
    triangles : (nt, 6) or (nt, 3) int array
        Oriented outward.
    face : (nt,) int array or None
        Number of the CAD face of each, or all are one.
    normals : (nt, 6, 3) or (nt, 3, 3) array or None
        Exact unit normals at the nodes, outward; where they are nan, those of the triangles serve.
    others : (m,) int array
        Nodes that boundary faces touch which are no triangles.
    pressure : (nt,) array or None
        MPa, of triangles whose load is known for certain: 0 on free ones; nan where it is not.
    """

    triangles: np.ndarray
    face: np.ndarray | None = None
    normals: np.ndarray | None = None
    others: np.ndarray | Sequence[int] = ()
    pressure: np.ndarray | None = None


def free_facets(
    elements: Sequence[tuple[str, np.ndarray]],
) -> tuple[np.ndarray, np.ndarray]:
    """Faces that belong to one element only.

    Returns
    -------
    triangles : (nt, 6) or (nt, 3) int array
        Oriented outward.
    others : (m,) int array
        Nodes of those that are no triangles, sorted.
    """
    kinds: dict[int, list[np.ndarray]] = {}
    for kind, connectivity in elements:
        for face in FACES.get(kind, ()):
            kinds.setdefault(len(face), []).append(connectivity[:, face])
    free = {}
    for size, rows in kinds.items():
        found = np.concatenate(rows)
        corners = np.sort(found[:, : 3 if size in (3, 6) else 4], axis=1)
        _, inverse, count = np.unique(corners, axis=0, return_inverse=True, return_counts=True)
        free[size] = found[count[inverse.reshape(-1)] == 1]
    triangles = free.pop(6, free.pop(3, np.zeros((0, 6), dtype=int)))
    return triangles, np.unique(np.concatenate([np.zeros(0, int), *map(np.ravel, free.values())]))


class BoundarySurface:
    """Smooth faces of a boundary and their points: a node on a sharp edge is a point of each face.

    Parameters
    ----------
    nodes : (n, 3) array
        mm
    boundary : Boundary
    sides : (nt, k, 3) array, optional
        Normals at the triangles' nodes as each CAD face has them; with these, faces that continue
        each other smoothly are one. Else each is one of its own, or several where sharp edges cut
        it.

    Attributes
    ----------
    points : (nt, k) int array
        Points of each triangle.
    point_node, point_face : (np,) int arrays
        Node of the mesh, and face, of each point.
    faces : int
        Number of smooth faces.
    position, normal : (np, 3) arrays
        mm, and outward unit normals.
    pressure : (np,) array
        MPa, where it is known for certain; else nan.
    """

    def __init__(
        self, nodes: np.ndarray, boundary: Boundary, sides: np.ndarray | None = None
    ) -> None:
        self.triangles = np.asarray(boundary.triangles)
        self.others = np.asarray(boundary.others, dtype=int)
        self._nodes = nodes
        self.whole: BoundarySurface | None = None
        self.kind = f"tri{self.triangles.shape[1]}"
        places = reference(self.kind).nodes
        self._gradients = shape_gradients(self.kind, places)
        self._tangents = np.einsum("tnc,mnd->tmcd", nodes[self.triangles], self._gradients)
        cross = np.cross(self._tangents[..., 0], self._tangents[..., 1])
        length = np.linalg.norm(cross, axis=2, keepdims=True)
        normals = cross / np.where(length > 0.0, length, 1.0)
        self.points, self.point_node = self._split(normals, boundary, sides)
        self.point_face, self.faces = self._components()
        self.position = nodes[self.point_node]
        self.normal = _unit(self._mean(normals))
        given = np.full(self.points.shape, np.nan)
        if boundary.pressure is not None:
            given[:] = np.asarray(boundary.pressure)[:, None]
        self.pressure = self._mean(given[..., None])[:, 0]
        if self.kind == "tri6":
            slope, sound = self._slopes(self.position, 2)
            height = np.einsum("pck,pc->pk", slope, self.normal)
            tilted = self.normal - np.einsum("pk,pkc->pc", height, self.frame[:, :2])
            self._turn(np.where(sound[:, None], _unit(tilted), self.normal))
        if boundary.normals is not None:
            known = np.isfinite(boundary.normals).all(axis=2, keepdims=True)
            share = self._mean(known.astype(float))
            exact = _unit(self._mean(np.where(known, boundary.normals, 0.0)))
            self._turn(np.where(share > 0.0, exact, self.normal))

    def join(self, boundary: Boundary) -> None:
        """Take normals and frames of the same boundary with its faces joined across seams."""
        whole = BoundarySurface(self._nodes, boundary, self.normal[self.points])
        self.whole = whole
        place = np.empty(len(self.point_node), dtype=np.int64)
        place[self.points.ravel()] = whole.points.ravel()
        self._turn(whole.normal[place])
        self._place = place

    def _turn(self, normal: np.ndarray) -> None:
        """Take better normals."""
        self.normal = normal
        self.__dict__.pop("frame", None)

    def _split(
        self, normals: np.ndarray, boundary: Boundary, sides: np.ndarray | None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Points of the triangles: corners of triangles that meet smoothly are one."""
        triangles = self.triangles
        count, width = triangles.shape
        edges = EDGES[self.kind]
        key = np.sort(np.concatenate([triangles[:, list(edge)] for edge in edges]), axis=1)
        owner = np.tile(np.arange(count), len(edges))
        local = np.repeat(np.arange(len(edges)), count)
        order = np.lexsort((key[:, 1], key[:, 0]))
        same = np.flatnonzero((key[order][1:] == key[order][:-1]).all(axis=1))
        one, other = order[same], order[same + 1]
        members = np.array(
            [[*edge, *([3 + k] if width == 6 else [])] for k, edge in enumerate(edges)]
        )
        left = owner[one][:, None] * width + members[local[one]]
        wanted = triangles.ravel()[left]
        rows = triangles[owner[other]]
        place = np.argmax(rows[:, None, :] == wanted[:, :, None], axis=2)
        right = owner[other][:, None] * width + place
        flat = normals.reshape(-1, 3)
        smooth = np.einsum("emc,emc->em", flat[left], flat[right]).min(axis=1)
        within = np.ones(len(one), dtype=bool)
        if boundary.face is not None:
            face = np.asarray(boundary.face)
            within = face[owner[one]] == face[owner[other]]
        if sides is None:
            smooth[~within] = -1.0
        else:
            flat = sides.reshape(-1, 3)
            turn = np.einsum("emc,emc->em", flat[left], flat[right]).min(axis=1)
            smooth = np.where(within, smooth, turn)
        limit = np.where(within, CREASE, SEAM)
        smooth = smooth > np.cos(np.radians(limit))
        left, right = left[smooth].ravel(), right[smooth].ravel()
        graph = sp.coo_matrix((np.ones(len(left)), (left, right)), (count * width,) * 2)
        total, label = csgraph.connected_components(graph, directed=False)
        node = np.empty(total, dtype=np.int64)
        node[label] = triangles.ravel()
        return label.reshape(count, width), node

    def _components(self) -> tuple[np.ndarray, int]:
        """Face of each point: points of one triangle are of one face."""
        ends = np.repeat(self.points[:, :1], self.points.shape[1] - 1, axis=1).ravel()
        others = self.points[:, 1:].ravel()
        size = len(self.point_node)
        graph = sp.coo_matrix((np.ones(len(ends)), (ends, others)), (size, size))
        faces, label = csgraph.connected_components(graph, directed=False)
        return label, faces

    def _mean(self, values: np.ndarray) -> np.ndarray:
        """Mean over the triangles around each point of (nt, k, m) values."""
        flat, size = self.points.ravel(), len(self.point_node)
        total = np.stack(
            [
                np.bincount(flat, column, minlength=size)
                for column in values.reshape(len(flat), -1).T
            ],
            axis=1,
        )
        return total / np.bincount(flat, minlength=size)[:, None]

    @cached_property
    def _quadrature(self) -> tuple[np.ndarray, np.ndarray]:
        """Shape functions (q, k), and the area of each triangle's points (nt, q), mm²."""
        points, weights = quadrature("tri", 4)
        slopes = shape_gradients(self.kind, points)
        tangents = np.einsum("tnc,qnd->tqcd", self._nodes[self.triangles], slopes)
        area = np.linalg.norm(np.cross(tangents[..., 0], tangents[..., 1]), axis=2)
        return shape_functions(self.kind, points), area * weights

    @cached_property
    def mass(self) -> sp.csr_matrix:
        """Nodal forces of tractions at the points, (n, np), mm²."""
        values, area = self._quadrature
        local = np.einsum("qi,qj,tq->tij", values, values, area)
        width = self.points.shape[1]
        rows = np.repeat(self.triangles, width, axis=1).ravel()
        columns = np.tile(self.points, (1, width)).ravel()
        shape = (len(self._nodes), len(self.point_node))
        return sp.csr_matrix((local.ravel(), (rows, columns)), shape)

    @cached_property
    def pressure_forces(self) -> tuple[np.ndarray, np.ndarray]:
        """Nodal forces of a traction of 1 MPa along the normal, and of one that grows with x, y, z.

        They are integrated over the triangles as a solver does, whatever the exact normals are.

        Returns
        -------
        (n, 3) array, mm², and (n, 3, 3) array, mm³: axis of the position, component.
        """
        points, weights = quadrature("tri", 4)
        values, slopes = shape_functions(self.kind, points), shape_gradients(self.kind, points)
        corners = self._nodes[self.triangles]
        tangents = np.einsum("tnc,qnd->tqcd", corners, slopes)
        normal = np.cross(tangents[..., 0], tangents[..., 1]) * weights[:, None]
        place = np.einsum("qn,tnc->tqc", values, corners)
        even, linear = np.zeros((len(self._nodes), 3)), np.zeros((len(self._nodes), 3, 3))
        np.add.at(even, self.triangles, np.einsum("qn,tqc->tnc", values, normal))
        np.add.at(linear, self.triangles, np.einsum("qn,tqa,tqc->tnac", values, place, normal))
        return even, linear

    @cached_property
    def node_area(self) -> np.ndarray:
        """Area of the triangles around each node of the mesh, (n,), mm²."""
        area = np.repeat(self._quadrature[1].sum(axis=1), self.points.shape[1])
        return np.bincount(self.triangles.ravel(), area, minlength=len(self._nodes))

    @cached_property
    def frame(self) -> np.ndarray:
        """Two tangents and the normal at each point, in rows, (np, 3, 3)."""
        least = np.eye(3)[np.argmin(np.abs(self.normal), axis=1)]
        first = _unit(np.cross(self.normal, least))
        return np.stack([first, np.cross(self.normal, first), self.normal], axis=1)

    @cached_property
    def inward(self) -> np.ndarray:
        """Unit vectors from each point into its own face, (np, 3): what lies around it of that."""
        middle = self._nodes[self.triangles].mean(axis=1, keepdims=True)
        return _unit(self._mean(middle - self._nodes[self.triangles]))

    def tangential_strain(self, displacement: np.ndarray, gradient: np.ndarray) -> np.ndarray:
        """Strain along the surface in the frame's tangents.

        Parameters
        ----------
        displacement : (n, 3) array
            mm.
        gradient : (n, 3, 3) array
            Its derivatives at the nodes, roughly. Only what goes beyond is taken from the surface:
            rigid turns, however large, leave no trace.

        Returns
        -------
        (np, 3) array
            11, 22, 12.
        """
        if self.whole is not None:
            return self.whole.tangential_strain(displacement, gradient)[self._place]
        rough = gradient[self.point_node]
        linear = np.einsum("pck,pbk->pcb", rough, self.frame[:, :2])
        slope = np.einsum("tnc,mnd->tmcd", displacement[self.triangles], self._gradients)
        slope -= gradient[self.triangles] @ self._tangents
        inverse = np.linalg.pinv(self._tangents, rcond=1e-6)
        direct = self._mean((slope @ inverse).reshape(len(slope), -1, 9)).reshape(-1, 3, 3)
        along = linear + np.einsum("pck,pbk->pcb", direct, self.frame[:, :2])
        if self.kind == "tri6":
            values = displacement[self.point_node]
            # no fit, where faces are narrow, may change more than there is
            room = np.linalg.norm(rough + np.swapaxes(rough, 1, 2), axis=(1, 2))
            quadric, sound = self._slopes(values, 2, rough)
            first = _within(np.where(sound[:, None, None], linear + quadric - along, 0.0), room)
            # and where a cubic changes much more than the quadric did, it is the fit that errs
            room = np.minimum(room, _TRUST * np.linalg.norm(first, axis=(1, 2)))
            cubic, sound = self._slopes(values, 3, rough)
            along = along + first
            along += _within(np.where(sound[:, None, None], linear + cubic - along, 0.0), room)
        local = np.einsum("pac,pcb->pab", self.frame[:, :2], along)
        shear = 0.5 * (local[:, 0, 1] + local[:, 1, 0])
        return np.column_stack([local[:, 0, 0], local[:, 1, 1], shear])

    def _ring(self, wide: bool) -> sp.csr_matrix:
        """Points near each point: of the triangles around it, or also of those that touch them."""
        count, width = self.points.shape
        size = len(self.point_node)

        def touches(points: np.ndarray) -> sp.csr_matrix:
            rows, columns = points.ravel(), np.repeat(np.arange(count), points.shape[1])
            return sp.csr_matrix((np.ones(len(rows)), (rows, columns)), (size, count))

        corner = touches(self.points)
        if not wide:
            return (corner @ corner.T).tocsr()
        # a point sees the triangles that have a corner with one of its own in common
        vertex = touches(self.points[:, :3])
        return (corner @ (vertex.T @ vertex) @ corner.T).tocsr()

    def _slopes(
        self, values: np.ndarray, degree: int, linear: np.ndarray | None = None
    ) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives along the frame's tangents, by a polynomial over the triangles near a point.

        It sees the surface from the tangent plane, so that mid nodes beside the middle of their
        edges, as uneven parameters give them, do no harm.

        Parameters
        ----------
        values : (np, 3) array
        degree : {2, 3}
            Over the triangles around each point, or over two rings.
        linear : (np, 3, 3) array, optional
            Derivatives in space of what is taken off first; the slopes are those of the rest.

        Returns
        -------
        slopes : (np, 3, 2) array
        sound : (np,) bool array
            False where the triangles are too few, or bend too much.
        """
        ring = self._ring(wide=degree == 3)
        powers = [(i - j, j) for i in range(degree + 1) for j in range(i + 1)]
        cubic = np.array([i + j > 2 for i, j in powers])
        length = np.diff(ring.indptr)
        sound = length >= _MARGIN[degree] * len(powers)
        seen = np.cos(np.radians(STEEPEST))
        slopes = np.zeros((len(self.point_node), 3, 2))
        todo = np.flatnonzero(sound)
        todo = todo[np.argsort(length[todo], kind="stable")]
        for start in range(0, len(todo), _BLOCK):
            part = todo[start : start + _BLOCK]
            used = np.arange(length[part].max()) < length[part][:, None]
            index = np.zeros(used.shape, dtype=np.int64)
            index[used] = ring[part].indices
            # what lies round a bend is out of sight
            used &= np.einsum("psc,pc->ps", self.normal[index], self.normal[part]) > seen
            sound[part] = used.sum(axis=1) >= _MARGIN[degree] * len(powers)
            away = self.position[index] - self.position[part][:, None]
            x = np.einsum("psc,pkc->psk", away, self.frame[part][:, :2])
            square = np.sum(x**2, axis=2)
            scale = np.sqrt(np.max(square * used, axis=1))
            x, square = x / scale[:, None, None], square / scale[:, None] ** 2
            weight = used / (_NEAR + square)
            basis = np.stack([x[..., 0] ** i * x[..., 1] ** j for i, j in powers], axis=2)
            basis *= weight[..., None]
            rest = values[index] - values[part][:, None]
            if linear is not None:
                rest -= np.einsum("pck,psk->psc", linear[part], away)
            wanted = rest * weight[..., None]
            matrix = np.swapaxes(basis, 1, 2) @ basis
            # what only few points would decide stays small
            hold = _HOLD * np.sum(weight**2 * (square > 0.25), axis=1)
            matrix += hold[:, None, None] * np.diag(cubic.astype(float))
            size, vectors = np.linalg.eigh(matrix)
            sound[part] &= size[:, 0] > _SINGULAR * size[:, -1]
            size = np.maximum(size, _SINGULAR * size[:, -1:])
            right = np.swapaxes(basis, 1, 2) @ wanted
            found = vectors @ ((np.swapaxes(vectors, 1, 2) @ right) / size[..., None])
            slopes[part] = np.swapaxes(found[:, 1:3], 1, 2) / scale[:, None, None]
        return slopes, sound


def _within(change: np.ndarray, room: np.ndarray) -> np.ndarray:
    """Changes (np, 3, 2), made smaller where they are larger than (np,) bounds."""
    size = np.linalg.norm(change, axis=(1, 2))
    share = np.divide(room, size, out=np.ones_like(size), where=size > room)
    return share[:, None, None] * change


def _unit(vectors: np.ndarray) -> np.ndarray:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    return vectors / np.where(length > 0.0, length, 1.0)
