# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Polygon meshes from OBJ, OFF and PLY files, with the crease tags of OpenSubdiv's OBJ files."""

from __future__ import annotations

import codecs
import os
import re
import struct
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from HybridVolume.core.polygons import PolygonMesh
from HybridVolume.errors import InputError

SUFFIXES = (".obj", ".off", ".ply")
"""Files that can be read."""

_PLY = {
    "char": "b", "int8": "b", "uchar": "B", "uint8": "B", "short": "h", "int16": "h",
    "ushort": "H", "uint16": "H", "int": "i", "int32": "i", "uint": "I", "uint32": "I",
    "float": "f", "float32": "f", "double": "d", "float64": "d",
}  # fmt: skip


def read_polygons(path: str | os.PathLike) -> PolygonMesh:
    """Read a mesh as the file has it; `HybridVolume.core.polygons.mended` checks it.

    Parameters
    ----------
    path : path
        .obj, .off or .ply; vertices and faces are numbered from 1 in OBJ files, from 0 in others.

    Raises
    ------
    InputError
        It is no such file, or damaged; the line is named.
    """
    path = Path(path)
    readers = {".obj": _read_obj, ".off": _read_off, ".ply": _read_ply}
    suffix = path.suffix.lower()
    if suffix not in readers:
        raise InputError(
            f"{path.name} is no mesh file", remedy=f"give one of the kinds {', '.join(SUFFIXES)}"
        )
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path.name} cannot be read ({error.strerror})", remedy="check its name and place"
        ) from error
    try:
        vertices, faces, creases, points = readers[suffix](content)
    except _Damaged as damage:
        raise InputError(f"{path.name}: {damage}", remedy="export the mesh again") from damage
    return PolygonMesh.of(
        np.array(vertices, dtype=float).reshape(-1, 3),
        faces,
        creases,
        int(suffix == ".obj"),
        points=points,
    )


class _Damaged(Exception):
    """What is wrong with a file, and in which line."""


_Content = tuple[list, list, list, list]
"""Vertices, faces, creases, sharp vertices."""
_DIGITS = 18
"""Digits of the longest whole number that is taken for one."""


def _lines(content: bytes) -> Iterator[tuple[int, list[str]]]:
    """Number and words of each line that has any; lines that end with a backslash go on."""
    held, first = "", 0
    wide = content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    text = content.decode("utf-16" if wide else "utf-8-sig", "replace")
    for number, line in enumerate(re.split(r"\r\n|\n|\r", text), 1):
        line = line.split("#")[0].rstrip()
        first = first or number
        if line.endswith("\\"):
            held += line[:-1] + " "
            continue
        words = (held + line).split()
        if words:
            yield first, words
        held, first = "", 0


def _numbers(words: list[str], kind: type, number: int) -> list:
    try:
        # Python itself would take 1_000 as well
        if not any("_" in word or (kind is int and len(word) > _DIGITS) for word in words):
            return [kind(word) for word in words]
    except ValueError:
        pass
    raise _Damaged(f"line {number} has {' '.join(words)!r} where numbers must be")


def _read_obj(content: bytes) -> _Content:
    vertices: list = []
    faces: list = []
    creases: list = []
    points: list = []
    for number, words in _lines(content):
        if words[0] == "v":
            if len(words) < 4:
                raise _Damaged(f"line {number} has no three coordinates")
            vertices.append(_numbers(words[1:4], float, number))
        elif words[0] == "f":
            corners = _numbers([word.split("/")[0] for word in words[1:]], int, number)
            if 0 in corners:
                raise _Damaged(f"line {number} has vertex 0; vertices count from 1 in OBJ files")
            faces.append([c - 1 if c > 0 else len(vertices) + c for c in corners])
        elif words[:2] == ["t", "crease"]:
            ends, sharp = _tag(words, number, 1)
            creases += list(zip(ends[:-1], ends[1:], sharp, strict=True))
        elif words[:2] == ["t", "corner"]:
            points += list(zip(*_tag(words, number, 0), strict=True))
    return vertices, faces, creases, points


def _tag(words: list[str], number: int, between: int) -> tuple[list[int], list[float]]:
    """Vertices, which count from 0, and sharpness of ``t crease`` or ``t corner``.

    They are written ``t name integers/reals/texts`` with so many of each behind, one real for all
    or one for each vertex or, of a crease, between two.
    """
    counts = _numbers(words[2].split("/"), int, number) if len(words) > 2 else []
    if len(counts) == 3 and min(counts) >= 0 and len(words) >= 3 + counts[0] + counts[1]:
        ends = _numbers(words[3 : 3 + counts[0]], int, number)
        sharp = _numbers(words[3 + counts[0] : 3 + counts[0] + counts[1]], float, number)
        wanted = len(ends) - between
        if wanted > 0 and len(sharp) in (1, wanted):
            return ends, sharp * wanted if len(sharp) == 1 else sharp
    raise _Damaged(f"line {number} has no readable {words[1]}")


def _read_off(content: bytes) -> _Content:
    lines = list(_lines(content))
    words = [word for _, row in lines for word in row]
    number = lines[0][0] if lines else 1
    if not words or not words[0].upper().endswith("OFF"):
        raise _Damaged("it does not begin with OFF")
    if len(words) > 1 and words[1].upper() == "BINARY":
        raise _Damaged("it is a binary OFF file; save it as text")
    header = words[0].upper()
    if not re.fullmatch("(ST)?C?N?OFF", header) or words[0].startswith("n"):
        raise _Damaged(f"it has a header {words[0]}, which is not known here")
    rows = [(n, row) for n, row in lines if row[0].upper() != header or len(row) > 1]
    if rows and rows[0][1][0].upper() == header:
        rows[0] = (rows[0][0], rows[0][1][1:])
    if not rows or len(rows[0][1]) < 2:
        raise _Damaged(f"line {number} has no counts of vertices and faces")
    vertex_count, face_count = _numbers(rows[0][1][:2], int, rows[0][0])
    body = rows[1:]
    if min(vertex_count, face_count) < 0 or len(body) < vertex_count + face_count:
        raise _Damaged(
            f"it ends after {len(body)} of {vertex_count} vertices and {face_count} faces"
        )
    vertices = []
    for n, row in body[:vertex_count]:
        if len(row) < 3:
            raise _Damaged(f"line {n} has no three coordinates")
        vertices.append(_numbers(row[:3], float, n))
    faces = []
    for n, row in body[vertex_count : vertex_count + face_count]:
        (count,) = _numbers(row[:1], int, n)
        if count < 0 or len(row) < 1 + count:
            raise _Damaged(f"line {n} has no {count} vertices")
        faces.append(_numbers(row[1 : 1 + count], int, n))
    return vertices, faces, [], []


def _read_ply(content: bytes) -> _Content:
    content = content.removeprefix(codecs.BOM_UTF8)
    end = re.search(rb"^end_header[ \t]*(\r\n|\n|\r)", content, re.MULTILINE)
    end = end or re.search(rb"\rend_header[ \t]*\r", content)
    if not content.startswith(b"ply") or not end:
        raise _Damaged("it has no header of a PLY file")
    head, body = content[: end.start()], content[end.end() :]
    form, elements = _ply_header(head.decode("ascii", "replace").splitlines())
    read = _ply_text if form == "ascii" else _ply_binary
    tables = read(body, elements, "<" if form == "binary_little_endian" else ">")
    columns = [tables.get("vertex", {}).get(axis) for axis in "xyz"]
    if any(column is None or isinstance(next(iter(column), 0.0), list) for column in columns):
        raise _Damaged("its vertices have no x, y and z")
    table = tables.get("face", {})
    name = next((n for n in ("vertex_indices", "vertex_index") if n in table), None)
    if name is None:
        raise _Damaged("it has no faces with vertex_indices")
    faces = []
    for row, values in enumerate(table[name]):
        if not isinstance(values, list) or not all(float(value).is_integer() for value in values):
            raise _Damaged(f"face {row} has vertices that are no whole numbers")
        faces.append(list(map(int, values)))
    return np.column_stack(columns).tolist(), faces, [], []


_Element = tuple[str, int, list[tuple[str, str, str]]]
"""Name, count, and (name, kind, kind of the list's length or "") of its properties."""


def _ply_header(lines: list[str]) -> tuple[str, list[_Element]]:
    form, elements = "", []
    for number, line in enumerate(lines, 1):
        words = line.split()
        if words[:1] == ["format"] and len(words) > 1:
            form = words[1]
        elif words[:1] == ["element"] and len(words) == 3:
            elements.append((words[1], *_numbers(words[2:], int, number), []))
        elif words[:1] == ["property"] and elements:
            is_list = words[1:2] == ["list"]
            if len(words) != (5 if is_list else 3) or not set(words[1 + is_list : -1]) <= set(_PLY):
                raise _Damaged(f"line {number} has no readable property")
            if words[-1] in (name for name, *_ in elements[-1][2]):
                raise _Damaged(f"line {number} has a second {words[-1]}")
            elements[-1][2].append((words[-1], words[-2], words[2] if is_list else ""))
    if form not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise _Damaged(f"its format {form!r} is not known")
    return form, elements


def _ply_text(body: bytes, elements: list[_Element], order: str) -> dict[str, dict[str, list]]:
    words = body.split()
    at = 0
    tables: dict[str, dict[str, list]] = {}
    for name, count, properties in elements:
        table: dict[str, list] = {key: [] for key, _, _ in properties}
        for row in range(count if properties else 0):
            for key, _, counted in properties:
                try:
                    length = int(words[at]) if counted else 1
                    if length < 0:
                        raise ValueError
                    at += bool(counted)
                    values = [float(word) for word in words[at : at + length]]
                except (ValueError, IndexError):
                    raise _Damaged(f"{name} {row} is not readable") from None
                if len(values) < length:
                    raise _Damaged(f"it ends in {name} {row} of {count}")
                at += length
                table[key].append(values if counted else values[0])
        tables[name] = table
    return tables


def _ply_binary(body: bytes, elements: list[_Element], order: str) -> dict[str, dict[str, list]]:
    at = 0
    tables: dict[str, dict[str, list]] = {}
    for name, count, properties in elements:
        table: dict[str, list] = {key: [] for key, _, _ in properties}
        for row in range(count if properties else 0):
            for key, kind, counted in properties:
                try:
                    length = 1
                    if counted:
                        (length,) = struct.unpack_from(order + _PLY[counted], body, at)
                        at += struct.calcsize(order + _PLY[counted])
                    form = f"{order}{length}{_PLY[kind]}"
                    values = list(struct.unpack_from(form, body, at))
                except struct.error:
                    raise _Damaged(f"it ends in {name} {row} of {count}") from None
                at += struct.calcsize(form)
                table[key].append(values if counted else values[0])
        tables[name] = table
    return tables
