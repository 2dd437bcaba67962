# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Adapter of Netgen (LGPL): triangles and quads on faces of a solid, edges cut as wanted.

Every face is meshed for itself: one that fails takes no other with it.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .mesher import Answer, Request, along

MATCH = 1e-5
"""Edges are told apart by their ends and middles to this share of the diagonal."""
FLAT = 1e-10
"""Shorter edges, as a share of the diagonal, are degenerate: without a curve."""
GRADING = 0.9
"""How many mm edges grow by a mm away from the rim."""
SAMPLES = 100
"""Points of an edge by which its arc length is measured, at least."""


def mesh_faces(request: Request) -> Iterator[Answer]:
    """Mesh the faces of a request one by one; a face that Netgen gives up has no elements.

    Raises
    ------
    RuntimeError
        Netgen reads another solid.
    """
    from netgen import meshing, occ

    faces = list(occ.OCCGeometry(request.brep).shape.faces)
    numbers = _numbers(faces, request)
    keywords = {
        "maxh": request.size,
        "grading": GRADING,
        "minedgelen": 1e-9 * request.diagonal,
        # edges are cut already, and how they bend is no size for the face inside: a plane between
        # two circles had six times the elements
        "curvaturesafety": 0.1,
        "segmentsperedge": 0.1,
        "quad_dominated": request.quads,
        "perfstepsend": meshing.MeshingStep.MESHSURFACE,
    }
    for face in request.faces.tolist():
        own = faces[numbers[face]]
        own.quad_dominated = request.quads
        try:
            mesh = occ.OCCGeometry(own).GenerateMesh(**keywords)
        except Exception as error:  # netgen raises plain exceptions
            print(f"Face{face + 1}: {type(error).__name__}: {error}")
            yield Answer.nothing(face)
            continue
        points = np.array(mesh.Coordinates(), dtype=float).reshape(-1, 3)
        corners = mesh.Elements2D().NumPy()["nodes"][:, :4]
        table = np.full((len(corners), 4), -1)
        table[:, : corners.shape[1]] = corners.astype(int) - 1  # 0 behind triangles among quads
        rim = _rim(mesh, points, request, face) if len(table) else None
        if rim is None:
            print(f"Face{face + 1}: {len(table)} elements, edges not as wanted")
            yield Answer.nothing(face)
        else:
            yield Answer(points, table, np.full(len(table), face), rim, np.array([face]))


def _numbers(faces: list, request: Request) -> list[int]:
    """Netgen's numbers of faces, by their edges; cuts the edges as wanted on the way."""
    from scipy.spatial import cKDTree

    tree = cKDTree(np.hstack([request.middle, request.ends])[np.unique(request.edge)])
    used = np.unique(request.edge)
    known: dict[frozenset, list[int]] = {}
    for number, face in enumerate(faces):
        own = set()
        for edge in face.edges:
            if edge.mass <= FLAT * request.diagonal:
                continue
            samples = _samples(edge, SAMPLES)
            key = np.concatenate([samples[SAMPLES // 2], samples[0] + samples[-1]])
            distance, nearest = tree.query(key)
            if distance > MATCH * request.diagonal:
                raise RuntimeError("other edges are read than FreeCAD has")
            own.add(int(used[nearest]))
            count = int(request.intervals[used[nearest]])
            if 4 * count > SAMPLES:
                samples = _samples(edge, 4 * count)
            edge.partition = _even(samples, count)  # empty: one part, or Netgen takes more
        known.setdefault(frozenset(own), []).append(number)
    numbers = []
    for face in range(int(request.face.max()) + 1):
        found = known.get(frozenset(request.edges_of(face).tolist()))
        if not found:
            raise RuntimeError("other faces are read than FreeCAD has")
        numbers.append(found.pop(0))
    return numbers


def _samples(edge: object, parts: int) -> np.ndarray:
    low, high = edge.parameter_interval
    values = [edge.Value(t) for t in np.linspace(low, high, parts + 1).tolist()]
    return np.array([(p.x, p.y, p.z) for p in values])


def _even(samples: np.ndarray, count: int) -> np.ndarray:
    """Shares of an edge's parameters where it is cut into parts of equal length."""
    length = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(samples, axis=0), axis=1)))
    wanted = length[-1] * np.arange(1, count) / count
    return np.interp(wanted, length, np.linspace(0.0, 1.0, len(samples)))


def _rim(mesh: object, points: np.ndarray, request: Request, face: int) -> np.ndarray | None:
    """Rows of :attr:`Answer.rim` of a face; None where an edge is not cut as wanted."""
    segments = mesh.Elements1D().NumPy()
    nodes, index = segments["nodes"][:, :2].astype(int) - 1, segments["index"]
    chains = [_chain(nodes[index == number]) for number in np.unique(index).tolist()]
    rows = []
    for edge in request.edges_of(face).tolist():
        wanted = request.points[request.first[edge] : request.first[edge + 1]]
        fitting = [c for c in chains if c is not None and len(c) == len(wanted)]
        if not fitting:
            return None
        order, off = zip(*(along(points[chain], wanted) for chain in fitting), strict=True)
        best = int(np.argmin(off))
        chain = fitting[best][order[best]]
        fixed = np.full_like(chain, face), np.full_like(chain, edge)
        rows.append(np.column_stack([*fixed, chain, np.arange(len(chain))]))
    return np.concatenate(rows)


def _chain(lines: np.ndarray) -> np.ndarray | None:
    """Points of the segments of one edge in their order; None where they are no chain."""
    if np.all(lines[1:, 0] == lines[:-1, 1]):
        return np.append(lines[:, 0], lines[-1, 1])
    after = dict(lines.tolist())
    starts = set(after) - set(after.values())
    if len(after) != len(lines) or len(starts) != 1:
        return None
    chain = [starts.pop()]
    while chain[-1] in after and len(chain) <= len(lines):
        chain.append(after[chain[-1]])
    return np.array(chain) if len(chain) == len(lines) + 1 else None
