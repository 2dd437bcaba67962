# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The process in which faces are meshed: ``python -m HybridVolume.core.covering.mesher FOLDER``.

Reads ``request.npz`` and writes ``answer-000000.npz`` and so on, or ``error.txt`` with a complaint.
Meshers crash or never end on some faces, and take nothing with them here.
"""

from __future__ import annotations

import importlib
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

ADAPTERS = {"gmsh": "gmsh_faces", "netgen": "netgen_faces"}
ONE_BY_ONE = ("netgen",)
"""Meshers that answer face by face: what they have done counts when they come to a bad end."""
REQUEST, ANSWER, ANSWERS, COMPLAINT = (
    "request.npz",
    "answer-{:06d}.npz",
    "answer-*.npz",
    "error.txt",
)


def one_by_one(engine: str) -> bool:
    """Whether a mesher answers face by face."""
    return engine in ONE_BY_ONE


@dataclass(frozen=True)
class Request:
    """Faces to be meshed.

    Attributes
    ----------
    brep : str
        File of the solid that they are of.
    faces : (k,) int array
        Their numbers.
    face, edge : (nc,) int arrays
        Coedges of the solid, see :class:`.outline.Outline`.
    intervals : (ne,) int array
        Parts that edges are cut into.
    first : (ne + 1,) int array
        Where an edge's points begin in ``points``.
    points : (n, 3) array
        Ends of the intervals of every edge, in its direction, evenly by arc length, mm.
    middle, ends : (ne, 3) arrays
        Halfway along the edges' parameters, and the sum of both ends, mm.
    size : float
        Largest edge inside the faces, mm.
    quads : bool
        Whether quads are wanted besides triangles.
    algorithm : int
        Of the mesher.
    """

    brep: str
    faces: np.ndarray
    face: np.ndarray
    edge: np.ndarray
    intervals: np.ndarray
    first: np.ndarray
    points: np.ndarray
    middle: np.ndarray
    ends: np.ndarray
    size: float
    quads: bool
    algorithm: int

    @property
    def diagonal(self) -> float:
        """Size of the box around all edges, mm."""
        return float(np.linalg.norm(np.ptp(self.points, axis=0)))

    def edges_of(self, face: int) -> np.ndarray:
        """Edges of a face."""
        return np.unique(self.edge[self.face == face])

    def write(self, folder: Path) -> None:
        """Write it for :meth:`read`."""
        np.savez(folder / REQUEST, **{f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def read(cls, folder: Path) -> Request:
        """What :meth:`write` wrote."""
        with np.load(folder / REQUEST) as file:
            values = {f.name: file[f.name] for f in fields(cls)}
        for name, kind in (("brep", str), ("size", float), ("quads", bool), ("algorithm", int)):
            values[name] = kind(values[name])
        return cls(**values)


@dataclass(frozen=True)
class Answer:
    """Triangles and quads on faces.

    Attributes
    ----------
    points : (n, 3) array
        mm
    elements : (m, 4) int array
        Corners; -1 at the end of a triangle.
    face : (m,) int array
    rim : (k, 4) int array
        Face, edge, point, and the number of the interval on the edge that begins there.
    done : (d,) int array
        Faces that were tried, in the order of the request; some may have no elements.
    """

    points: np.ndarray
    elements: np.ndarray
    face: np.ndarray
    rim: np.ndarray
    done: np.ndarray

    @classmethod
    def nothing(cls, face: int) -> Answer:
        """The answer for a face that was not meshed."""
        empty = np.zeros((0, 4), dtype=int)
        return cls(np.zeros((0, 3)), empty, empty[:, 0], empty, np.array([face]))

    @classmethod
    def joined(cls, answers: Sequence[Answer]) -> Answer:
        """Several answers in one."""
        before = np.cumsum([0, *(len(answer.points) for answer in answers)])
        elements = [
            np.where(answer.elements >= 0, answer.elements + count, -1)
            for answer, count in zip(answers, before, strict=False)
        ]
        rims = [
            answer.rim + [0, 0, count, 0] for answer, count in zip(answers, before, strict=False)
        ]
        return cls(
            np.concatenate([answer.points for answer in answers]),
            np.concatenate(elements),
            np.concatenate([answer.face for answer in answers]),
            np.concatenate(rims),
            np.concatenate([answer.done for answer in answers]),
        )

    def write(self, folder: Path, number: int) -> None:
        """Write it for :meth:`read`; nobody sees half a file."""
        part = folder / "part.npz"
        np.savez(part, **{f.name: getattr(self, f.name) for f in fields(self)})
        os.replace(part, folder / ANSWER.format(number))

    @classmethod
    def read(cls, path: Path) -> Answer:
        """What :meth:`write` wrote."""
        with np.load(path) as file:
            return cls(**{f.name: file[f.name] for f in fields(cls)})


def along(chain: np.ndarray, wanted: np.ndarray) -> tuple[np.ndarray, float]:
    """Positions on an edge of the points of a chain, and how far they are off.

    Parameters
    ----------
    chain : (n, 3) array
        In order along the edge, in either direction.
    wanted : (n, 3) array
        The ends of its intervals.
    """
    forward = float(np.abs(chain - wanted).max())
    backward = float(np.abs(chain[::-1] - wanted).max())
    order = np.arange(len(chain))
    return (order, forward) if forward <= backward else (order[::-1], backward)


def main(folder: Path, engine: str) -> int:
    """Run one mesher on the request in a folder; 0 when it gave an answer."""
    from ..tetmesh.run import end_with_parent

    end_with_parent()
    adapter = importlib.import_module(f"{__package__}.{ADAPTERS[engine]}")
    try:
        for number, answer in enumerate(adapter.mesh_faces(Request.read(folder))):
            answer.write(folder, number)
    except Exception as error:  # whatever a foreign mesher raises becomes one sentence
        text = str(error).strip() or "no reason"
        (folder / COMPLAINT).write_text(f"{type(error).__name__}: {text}", encoding="utf-8")
        return 3
    return 0


if __name__ == "__main__":
    code = main(Path(sys.argv[1]), sys.argv[2])
    sys.stdout.flush()
    sys.stderr.flush()
    # the answer is on disk; a mesher's own clean-up at exit may crash and tells nothing
    os._exit(code)
