# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Broken meshes, each with what must be said about it: mended and told, or refused by numbers."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np

from .quads_inputs import obj_text

MENDED, REFUSED = "mended", "refused"

Faces = list[list[int]]


@dataclass(frozen=True)
class BrokenMesh:
    """A mesh file with a fault.

    Attributes
    ----------
    name : str
    words : str
        What is wrong with it.
    file : str
        Its name.
    content : bytes
    expected : {"mended", "refused"}
    named : tuple of str
        Words of which one must be in the sentence: numbers of elements, lines, or what is missing.
    scheme : str
        Asked for; "" for none.
    """

    name: str
    words: str
    file: str
    content: bytes
    expected: str
    named: tuple[str, ...]
    scheme: str = ""


def block(cells: Sequence[int] = (2, 2, 2)) -> tuple[np.ndarray, Faces]:
    """The surface of a block of cells of 10, 8 and 6 mm: vertices, and quads that look outward."""
    numbers: dict[tuple[int, ...], int] = {}

    def vertex(at: tuple[int, ...]) -> int:
        return numbers.setdefault(at, len(numbers))

    faces: Faces = []
    for axis in range(3):
        one, other = (axis + 1) % 3, (axis + 2) % 3
        for end in (0, cells[axis]):
            for i in range(cells[one]):
                for j in range(cells[other]):
                    corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                    at = []
                    for a, b in corners if end else corners[::-1]:
                        place = [0, 0, 0]
                        place[axis], place[one], place[other] = end, a, b
                        at.append(vertex(tuple(place)))
                    faces.append(at)
    return np.array(list(numbers), float) * (10.0, 8.0, 6.0), faces


def off_text(vertices: np.ndarray, faces: Faces) -> str:
    """The text of an OFF file."""
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0"]
    lines += ["{:.17g} {:.17g} {:.17g}".format(*row) for row in np.asarray(vertices).tolist()]
    lines += [" ".join(map(str, (len(face), *face))) for face in faces]
    return "\n".join(lines) + "\n"


def ply_bytes(vertices: np.ndarray, faces: Faces) -> bytes:
    """A binary PLY file."""
    head = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\n"
        "property double x\nproperty double y\nproperty double z\n"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = b"".join(struct.pack(f"<B{len(face)}i", len(face), *face) for face in faces)
    return head.encode() + np.asarray(vertices, "<f8").tobytes() + rows


def _obj(name: str, words: str, mesh: tuple[np.ndarray, Faces], expected: str, *named: str,
         scheme: str = "") -> BrokenMesh:  # fmt: skip
    content = obj_text(*mesh).encode()
    return BrokenMesh(name, words, f"{name}.obj", content, expected, named, scheme)


def _moved(shift: Sequence[float], start: int) -> tuple[np.ndarray, Faces]:
    """Another block, moved, with vertices that count from ``start``."""
    x, faces = block()
    return x + shift, [[v + start for v in face] for face in faces]


def _two(shift: Sequence[float], weld: bool = False) -> tuple[np.ndarray, Faces]:
    """Two blocks; where they touch they have the same vertices, if they are welded."""
    x, faces = block()
    y, more = _moved(shift, len(x))
    both, every = np.concatenate([x, y]), faces + more
    if not weld:
        return both, every
    places, number = np.unique(both.round(9), axis=0, return_inverse=True)
    number = number.reshape(-1)
    return places, [[int(number[v]) for v in face] for face in every]


@cache
def catalogue() -> tuple[BrokenMesh, ...]:
    """All broken meshes."""
    return (*_surfaces(), *_elements(), *_files())


def _surfaces() -> tuple[BrokenMesh, ...]:
    """Faults of the surface as a whole."""
    x, faces = block()
    size = np.array([20.0, 16.0, 12.0])
    middle = [face for k, face in enumerate(faces) if k != 6]
    wall = [*faces, [faces[0][0], faces[0][1], faces[8][0], faces[8][1]]]
    flipped = [face[::-1] if k in (4, 11) else face for k, face in enumerate(faces)]
    half = [face[::-1] if k < 11 else face for k, face in enumerate(faces)]
    inward = [face[::-1] for face in faces]
    ring = _klein()
    flat = np.array([[0, 0, 0], [4, 0, 0], [4, 3, 0], [0, 3, 0]], float)
    return (
        _obj("open", "quad 7 is missing", (x, middle), REFUSED, "11-16"),
        _obj("open-strip", "a row of quads is missing", (x, faces[4:]), REFUSED, "1-4"),
        _obj("inner-wall", "a quad more than closes it, on edges of others", (x, wall), REFUSED,
             "1-20", "face 25"),
        _obj("common-edge", "two blocks that have an edge in common", _two((20, 16, 0), True),
             REFUSED, "24-25"),
        _obj("common-vertex", "two blocks that have a vertex in common", _two(size, True), REFUSED,
             "vertex 26"),
        _obj("crossing", "two blocks that cross each other", _two((9, 7, 5)), REFUSED, "faces 5"),
        _obj("flipped", "quads 5 and 12 are flipped", (x, flipped), MENDED, "faces 5 and 12"),
        _obj("flipped-half", "nearly half of the quads are flipped", (x, half), MENDED, "faces 1"),
        _obj("inward", "all quads look inward", (x, inward), MENDED, "inward"),
        _obj("one-sided", "a Klein bottle: no inside", ring, REFUSED, "face 1"),
        _obj("doubled", "quad 3 is there twice", (x, [*faces, faces[2]]), MENDED, "face 25",
             "face 3"),
        _obj("unwelded", "every quad has vertices of its own",
             (x[np.ravel(faces)], np.arange(4 * len(faces)).reshape(-1, 4).tolist()), MENDED,
             "70 vertices"),
        _obj("unused", "three vertices that no quad has",
             (np.concatenate([x, np.full((3, 3), 99.0)]), faces), MENDED),
        _obj("flat", "two quads back to back: no volume", (flat, [[0, 1, 2, 3], [3, 2, 1, 0]]),
             REFUSED, "1-2", "face 1", "faces 1"),
    )  # fmt: skip


def _elements() -> tuple[BrokenMesh, ...]:
    """Faults of single quads and vertices."""
    x, faces = block()
    quad = faces[9]
    collapsed = x.copy()
    collapsed[quad[1]], collapsed[quad[2]] = x[quad[0]], x[quad[3]]
    pulled = x.copy()
    # the middle of one side comes out on the other one
    top = int(np.flatnonzero((x == (10.0, 8.0, 12.0)).all(axis=1))[0])
    pulled[top, 2] = -4.0
    folded = x.copy()
    corner = int(np.flatnonzero((x == (20.0, 8.0, 6.0)).all(axis=1))[0])
    folded[corner, 1:] = (17.0, 13.0)
    not_number, endless = x.copy(), x.copy()
    not_number[4, 1], endless[4, 1] = np.nan, np.inf
    bow = [face if k != 9 else [quad[0], quad[2], quad[1], quad[3]] for k, face in enumerate(faces)]
    twice = [face if k != 9 else [*quad[:2], quad[1], *quad[2:]] for k, face in enumerate(faces)]
    line = [*faces, quad[:2]]
    split = [face for k, face in enumerate(faces) if k != 9] + [quad[:3], [quad[0], *quad[2:]]]
    missing = [face if k != 9 else [*quad[:3], len(x)] for k, face in enumerate(faces)]
    own = "face 10"
    return (
        _obj("zero-area", "quad 10 has no area: its sides lie on each other", (collapsed, faces),
             REFUSED, own),
        _obj("bow-tie", "the corners of quad 10 stand crosswise", (x, bow), REFUSED, own),
        _obj("repeated-corner", "quad 10 has a corner twice in a row", (x, twice), MENDED, own),
        _obj("two-corners", "face 25 has two corners", (x, line), REFUSED, "face 25"),
        _obj("triangles", "two triangles in place of quad 10, as bilinear patches", (x, split),
             REFUSED, "faces 24 and 25", scheme="bilinear"),
        _obj("no-vertex", "quad 10 has vertex 27 of 26", (x, missing), REFUSED, own),
        _obj("nan", "a coordinate of vertex 5 is NaN", (not_number, faces), REFUSED, "vertex 5",
             "line 5"),
        _obj("infinite", "a coordinate of vertex 5 is infinite", (endless, faces), REFUSED,
             "vertex 5", "line 5"),
        _obj("pulled-through", "a vertex is pulled through the opposite side", (pulled, faces),
             REFUSED, "faces 17"),
        _obj("folded", "a quad is folded over: its bilinear patch cuts the others",
             (folded, faces), REFUSED, "16"),
    )  # fmt: skip


def _files() -> tuple[BrokenMesh, ...]:
    """Faults of the file."""
    x, faces = block()
    text, off, ply = obj_text(x, faces), off_text(x, faces), ply_bytes(x, faces)
    zero_based = "\n".join(
        line if not line.startswith("f") else "f " + " ".join(
            str(int(word) - 1) for word in line.split()[1:])
        for line in text.splitlines()
    )  # fmt: skip
    one_based = off_text(x, [[v + 1 for v in face] for face in faces])
    words = text.replace(text.splitlines()[3], "v 0 8 abc", 1)
    crease = text + "t crease 2/1/0 0 99 3.0\n"
    far = text + "f 1 2 3 -99\n"
    cases = (
        ("zero-based", "an OBJ file whose vertices count from 0", "zero_based.obj", zero_based,
         ("vertex 0",), ""),
        ("one-based", "an OFF file whose vertices count from 1", "one_based.off", one_based,
         ("faces 20",), ""),
        ("negative-index", "an OBJ face with vertex -99 of 26", "negative_index.obj", far,
         ("face 25", "line"), ""),
        ("empty", "a file without a byte", "empty.obj", "", ("0 vertices", "empty"), ""),
        ("no-faces", "vertices without faces", "no_faces.obj",
         "\n".join(text.splitlines()[: len(x)]) + "\n", ("0 faces", "no faces"), ""),
        ("words", "a word in place of a coordinate", "words.obj", words, ("line 4",), ""),
        ("truncated-off", "an OFF file cut off in its faces", "truncated.off",
         off[: int(0.8 * len(off))], ("line", "ends after"), ""),
        ("truncated-ply", "a binary PLY file cut off in its faces", "truncated.ply", ply[:-40],
         ("face 21",), ""),
        ("no-ply", "a PLY file without a header", "no_ply.ply", off, ("header",), ""),
        ("lost-crease", "a crease at vertex 99 of 26", "lost_crease.obj", crease,
         ("vertex 99",), "catmull-clark"),
    )  # fmt: skip
    return tuple(
        BrokenMesh(name, told, file, content if isinstance(content, bytes) else content.encode(),
                   REFUSED, named, scheme)
        for name, told, file, content, named, scheme in cases
    )  # fmt: skip


def _klein(around: int = 6, across: int = 4) -> tuple[np.ndarray, Faces]:
    """A closed surface of quads with one side only."""
    at = np.arange(around * across).reshape(around, across)
    rows = np.concatenate([at, np.roll(at[:1, ::-1], 1, axis=1)])
    u = 2.0 * np.pi * np.arange(around)[:, None] / around
    v = 2.0 * np.pi * np.arange(across)[None] / across
    radius = 5.0 + np.cos(u / 2.0) * np.sin(v) - np.sin(u / 2.0) * np.sin(2.0 * v)
    height = np.sin(u / 2.0) * np.sin(v) + np.cos(u / 2.0) * np.sin(2.0 * v)
    x = np.stack([radius * np.cos(u), radius * np.sin(u), height + 0.0 * radius], axis=-1)
    nearby = np.roll(rows, -1, axis=1)
    faces = np.stack([rows[:-1], rows[1:], nearby[1:], nearby[:-1]], axis=-1)
    return x.reshape(-1, 3), faces.reshape(-1, 4).tolist()
