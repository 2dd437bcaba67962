# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Closed meshes of polygons: quad meshes and the cages of subdivision surfaces.

What is wrong with a mesh is said by the numbers that its file has.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import InputError
from .surface import SplineFace

SHARP = 10.0
"""Sharpness from which on a crease is sharp for good, as OpenSubdiv has it."""
NAMED = 6
"""Elements that an error names."""
_PLURALS = {"vertex": "vertices", "patch": "patches"}


@dataclass(frozen=True)
class PolygonMesh:
    """Polygons on shared vertices.

    Attributes
    ----------
    vertices : (n, 3) array
        mm.
    corners : (nc,) int array
        Vertices of all faces, one face after the other.
    start : (nf + 1,) int array
        Where each face begins in ``corners``, and the end.
    creases : (e, 2) int array
        Ends of edges that have a sharpness of their own.
    sharpness : (e,) array
        Theirs; `SHARP` or more is sharp for good.
    points : (k,) int array
        Vertices that have a sharpness of their own.
    point_sharpness : (k,) array
        Theirs.
    face_number, vertex_number : (nf,), (n,) int arrays
        Numbers in the file.
    notes : tuple of str
        What was mended.
    """

    vertices: np.ndarray
    corners: np.ndarray
    start: np.ndarray
    creases: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), dtype=np.int64))
    sharpness: np.ndarray = field(default_factory=lambda: np.zeros(0))
    points: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    point_sharpness: np.ndarray = field(default_factory=lambda: np.zeros(0))
    face_number: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    vertex_number: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    notes: tuple[str, ...] = ()

    @classmethod
    def of(
        cls,
        vertices: np.ndarray,
        faces: Sequence[Sequence[int]],
        creases: Sequence[tuple[int, int, float]] = (),
        first: int = 1,
        points: Sequence[tuple[int, float]] = (),
    ) -> PolygonMesh:
        """A mesh of lists of vertices, which count from 0; in the file both count from ``first``.

        ``creases`` are two vertices and a sharpness each, ``points`` one vertex and a sharpness.

        Raises
        ------
        InputError
            There is nothing, a coordinate or a sharpness is no number, or a face or crease has a
            vertex that does not exist or fewer than three.
        """
        vertices = np.asarray(vertices, dtype=float).reshape(-1, 3)
        if not len(vertices) or not len(faces):
            raise InputError(
                f"the mesh has {number_of(len(vertices), 'vertex')} and"
                f" {number_of(len(faces), 'face')}",
                remedy="give a file with a closed mesh of faces",
            )
        numbers = first + np.arange(len(vertices))
        bad = numbers[~np.isfinite(vertices).all(axis=1)]
        if len(bad):
            raise InputError(
                f"{some('vertex', bad)} {have(bad)} coordinates that are no numbers",
                figure=float(len(bad)),
                remedy="export the mesh again",
            )
        sizes = np.array([len(face) for face in faces])
        corners = np.array([v for face in faces for v in face], dtype=np.int64)
        start = np.concatenate([[0], np.cumsum(sizes)])
        face = np.repeat(np.arange(len(sizes)), sizes)
        wrong = np.unique(face[(corners < 0) | (corners >= len(vertices))])
        if len(wrong):
            raise InputError(
                f"{some('face', first + wrong)} {have(wrong)} vertices that do not exist; the"
                f" file has the vertices {numbers[0]} to {numbers[-1]}",
                figure=float(len(wrong)),
                remedy=f"vertices must count from {first}",
            )
        few = np.flatnonzero(sizes < 3)
        if len(few):
            raise InputError(
                f"{some('face', first + few)} {have(few)} fewer than three corners",
                figure=float(len(few)),
                remedy="remove them in the program that the mesh is from",
            )
        ends = np.array([(a, b) for a, b, _ in creases], dtype=np.int64).reshape(-1, 2)
        tips = np.array([v for v, _ in points], dtype=np.int64)
        ranks = np.array([sharp for *_, sharp in (*creases, *points)], dtype=float)
        named = np.concatenate([ends.ravel(), tips])
        missing = named[(named < 0) | (named >= len(vertices))]
        if len(missing) or np.isnan(ranks).any():
            raise InputError(
                f"a crease has {some('vertex', missing)}, counted from 0, of {len(vertices)}"
                if len(missing)
                else "a crease has a sharpness that is no number",
                remedy="export the mesh again, or take its crease tags out",
            )
        ranks = np.clip(ranks, 0.0, SHARP)
        return cls(
            vertices,
            corners,
            start,
            np.sort(ends, axis=1),
            ranks[: len(ends)],
            tips,
            ranks[len(ends) :],
            first + np.arange(len(sizes)),
            numbers,
        )

    def __len__(self) -> int:
        return len(self.start) - 1

    @property
    def sizes(self) -> np.ndarray:
        """Corners of each face, (nf,)."""
        return np.diff(self.start)

    @property
    def quads(self) -> np.ndarray:
        """The faces as (nf, 4), where all have four corners.

        Raises
        ------
        InputError
            Some have not.
        """
        other = np.flatnonzero(self.sizes != 4)
        if len(other):
            raise InputError(
                f"{some('face', self.face_number[other])} {have(other)} not four corners",
                figure=float(len(other)),
                remedy="choose Catmull-Clark, which takes any faces, or remesh to quads",
            )
        return self.corners.reshape(-1, 4)

    @property
    def face_of(self) -> np.ndarray:
        """Face of each corner, (nc,)."""
        return np.repeat(np.arange(len(self)), self.sizes)

    @property
    def following(self) -> np.ndarray:
        """Vertex after each corner in its face, (nc,)."""
        after = np.arange(1, len(self.corners) + 1)
        after[self.start[1:] - 1] = self.start[:-1]
        return self.corners[after]

    @property
    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Ends (e, 2) of all edges, the smaller first, and the edge after each corner (nc,)."""
        a, b, n = self.corners, self.following, len(self.vertices)
        keys = np.minimum(a, b) * n + np.maximum(a, b)
        unique, inverse = np.unique(keys, return_inverse=True)
        return np.column_stack(np.divmod(unique, n)), inverse.reshape(-1)

    @property
    def diagonal(self) -> float:
        """Diagonal of the bounding box, mm."""
        return float(np.linalg.norm(np.ptp(self.vertices, axis=0)))

    def triangles(self) -> tuple[np.ndarray, np.ndarray]:
        """Fans from the first corner of each face, (m, 3), and the face of each, (m,)."""
        count = self.sizes - 2
        face = np.repeat(np.arange(len(self)), count)
        step = np.arange(len(face)) - np.repeat(np.cumsum(count) - count, count)
        first = self.start[face]
        rows = np.column_stack([first, first + step + 1, first + step + 2])
        return self.corners[rows], face

    def area_vectors(self) -> np.ndarray:
        """Vector area of each face, (nf, 3), mm²."""
        middle = np.add.reduceat(self.vertices[self.corners], self.start[:-1], axis=0)
        middle = (middle / self.sizes[:, None])[self.face_of]
        a, b = self.vertices[self.corners] - middle, self.vertices[self.following] - middle
        return 0.5 * np.add.reduceat(np.cross(a, b), self.start[:-1], axis=0)

    def volume(self) -> float:
        """Signed volume inside the fans, mm³."""
        rows, _ = self.triangles()
        x = self.vertices[rows] - self.vertices.mean(axis=0)
        return float(np.einsum("ij,ij->", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6.0)

    def take(self, faces: np.ndarray) -> PolygonMesh:
        """Only some faces, and the vertices and creases that they have."""
        sizes = self.sizes[faces]
        first = np.repeat(self.start[faces] - np.concatenate([[0], np.cumsum(sizes)[:-1]]), sizes)
        corners = self.corners[first + np.arange(int(sizes.sum()))]
        used, renumbered = np.unique(corners, return_inverse=True)
        place = np.full(len(self.vertices), -1)
        place[used] = np.arange(len(used))
        creases, points = place[self.creases], place[self.points]
        kept = (creases >= 0).all(axis=1)
        return replace(
            self,
            vertices=self.vertices[used],
            corners=renumbered.reshape(-1),
            start=np.concatenate([[0], np.cumsum(sizes)]),
            creases=np.sort(creases[kept], axis=1),
            sharpness=self.sharpness[kept],
            points=points[points >= 0],
            point_sharpness=self.point_sharpness[points >= 0],
            face_number=self.face_number[faces],
            vertex_number=self.vertex_number[used],
        )

    def turned(self, which: np.ndarray) -> PolygonMesh:
        """With the corners of some faces (bool, (nf,)) the other way round; the first stays."""
        step = np.arange(len(self.corners)) - self.start[:-1][self.face_of]
        other = (self.sizes[self.face_of] - step) % self.sizes[self.face_of]
        step = np.where(which[self.face_of], other, step)
        return replace(self, corners=self.corners[self.start[:-1][self.face_of] + step])


def number_of(count: int, kind: str) -> str:
    """``"1 face"``, ``"3 faces"``."""
    return f"{count} {kind if count == 1 else _PLURALS.get(kind, f'{kind}s')}"


def have(what: np.ndarray, one: str = "has", many: str = "have") -> str:
    """The verb for one or for many elements."""
    return one if len(what) == 1 else many


def some(kind: str, numbers: np.ndarray) -> str:
    """``"face 4"``, ``"faces 4, 7 and 12"`` or ``"faces 1, 2, 3, 4, 5, 6 and 80 more"``."""
    words = [str(number) for number in np.unique(numbers)]
    return _listed(_PLURALS.get(kind, f"{kind}s") if len(words) > 1 else kind, words)


def some_edges(mesh: PolygonMesh, ends: np.ndarray) -> str:
    """``"edge 4-7"`` or ``"edges 4-7 and 7-9"`` by the numbers of their vertices in the file."""
    numbers = mesh.vertex_number[ends]
    words = [f"{a}-{b}" for a, b in numbers.tolist()]
    return _listed("edges" if len(words) > 1 else "edge", words)


def _listed(kind: str, words: list[str]) -> str:
    if len(words) == 1:
        return f"{kind} {words[0]}"
    last = words[-1] if len(words) <= NAMED else f"{len(words) - NAMED} more"
    return f"{kind} {', '.join(words[: min(NAMED, len(words) - 1)])} and {last}"


def off_centre(mesh: PolygonMesh) -> np.ndarray:
    """What to take from the vertices of a body far from the origin so that rounding stays small."""
    middle = mesh.vertices.mean(axis=0)
    return middle if np.abs(middle).max() > 10.0 * mesh.diagonal else np.zeros(3)


def near(points: np.ndarray) -> str:
    """``" (near 1, 2, 3 mm)"``: the middle of points, so that the first element is found."""
    middle = np.asarray(points, dtype=float).reshape(-1, 3).mean(axis=0)
    return f" (near {', '.join(f'{x:.4g}' for x in middle)} mm)"


def bilinear_faces(mesh: PolygonMesh) -> list[SplineFace]:
    """One bilinear patch a quad, p = q = 1 and weights 1 (section 3).

    Raises
    ------
    InputError
        A face has not four corners.
    """
    # u runs from the first corner to the second, so that the normal looks out
    nets = mesh.vertices[mesh.quads[:, [[0, 3], [1, 2]]]]
    knots = np.array([0.0, 0.0, 1.0, 1.0])
    weights = np.ones((2, 2))
    return [
        SplineFace(
            name=f"Face{number}",
            degrees=(1, 1),
            knots=(knots, knots),
            control_points=net,
            weights=weights,
        )
        for number, net in zip(mesh.face_number.tolist(), nets, strict=True)
    ]
