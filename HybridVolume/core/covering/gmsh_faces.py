# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Adapter of Gmsh: triangles and quads on faces of a solid, edges cut as wanted."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from .mesher import Answer, Request, along

MATCH = 1e-5
"""Edges are told apart by their ends and middles to this share of the diagonal."""


def mesh_faces(request: Request) -> Iterator[Answer]:
    """Mesh the faces of a request, all at once; a face that Gmsh gave up has no elements.

    Raises
    ------
    RuntimeError
        Gmsh reads another solid, or fails.
    """
    import gmsh

    gmsh.initialize(interruptible=False)
    for name, value in (
        ("General.Terminal", 1),
        ("General.AbortOnError", 0),
        ("Mesh.RecombineAll", int(request.quads)),
        ("Mesh.RecombinationAlgorithm", 1),
        ("Mesh.MeshSizeMax", request.size),
        ("Mesh.Algorithm", request.algorithm),
        ("Mesh.ElementOrder", 1),
        ("Mesh.MeshOnlyVisible", 1),
        ("Mesh.MinimumCurveNodes", 2),  # or curves asked for in one part get more
    ):
        gmsh.option.setNumber(name, value)
    gmsh.model.occ.importShapes(request.brep)
    gmsh.model.occ.synchronize()
    curve, surface = _tags(gmsh, request)
    gmsh.model.setVisibility(gmsh.model.getEntities(), 0)
    for face in request.faces.tolist():
        gmsh.model.setVisibility([(2, int(surface[face]))], 1, recursive=True)
    edges = np.unique(request.edge[np.isin(request.face, request.faces)])
    for edge in edges.tolist():
        gmsh.model.mesh.setTransfiniteCurve(int(curve[edge]), int(request.intervals[edge]) + 1)
    try:
        gmsh.model.mesh.generate(2)
    except Exception as error:  # gmsh raises plain exceptions
        # what was meshed before is good, and is checked by who asked
        if not gmsh.model.mesh.getElements(2)[0].size:
            raise
        print(f"Gmsh: {error}")
    yield _read(gmsh, request, curve, surface)


def _tags(gmsh: object, request: Request) -> tuple[np.ndarray, np.ndarray]:
    """Gmsh's numbers of edges and faces, by ends and middles, and by edges."""
    from scipy.spatial import cKDTree

    model = gmsh.model
    tags = [tag for _, tag in model.getEntities(1)]
    bounds = [model.getParametrizationBounds(1, tag) for tag in tags]
    points = np.array(
        [
            model.getValue(1, tag, [first, 0.5 * (first + last), last])
            for tag, ((first,), (last,)) in zip(tags, bounds, strict=True)
        ]
    ).reshape(-1, 3, 3)
    used = np.unique(request.edge)
    own = np.hstack([request.middle, request.ends])[used]
    tree = cKDTree(np.hstack([points[:, 1], points[:, 0] + points[:, 2]]))
    distance, nearest = tree.query(own)
    if distance.max() > MATCH * request.diagonal or len(np.unique(nearest)) != len(nearest):
        raise RuntimeError("other edges are read than FreeCAD has")
    curve = np.zeros(len(request.intervals), dtype=int)
    curve[used] = np.array(tags)[nearest]
    known: dict[frozenset, list[int]] = {}
    regular = set(curve[used].tolist())  # degenerate edges at poles are no edges of the outline
    for _, tag in model.getEntities(2):
        around = model.getBoundary([(2, tag)], combined=False, oriented=False)
        known.setdefault(frozenset(abs(t) for _, t in around) & regular, []).append(tag)
    surface = np.zeros(int(request.face.max()) + 1, dtype=int)
    for face in range(len(surface)):
        found = known.get(frozenset(curve[request.edges_of(face)].tolist()))
        if not found:
            raise RuntimeError("other faces are read than FreeCAD has")
        surface[face] = found.pop(0)
    return curve, surface


def _read(gmsh: object, request: Request, curve: np.ndarray, surface: np.ndarray) -> Answer:
    mesh = gmsh.model.mesh
    tags, coordinates, _ = mesh.getNodes()
    order = np.argsort(tags)
    tags, points = np.asarray(tags)[order], np.reshape(coordinates, (-1, 3))[order]
    chains = {}
    elements, faces, rim = [], [], []
    for face in request.faces.tolist():
        kinds, _, nodes = mesh.getElements(2, int(surface[face]))
        own = []
        for kind, corners in zip(kinds, nodes, strict=True):
            count = mesh.getElementProperties(kind)[3]
            table = np.full((len(corners) // count, 4), -1)
            table[:, :count] = np.searchsorted(tags, np.reshape(corners, (-1, count)))
            own.append(table)
        rims = []
        for edge in request.edges_of(face).tolist():
            if edge not in chains:
                chains[edge] = _chain(mesh, tags, points, request, edge, int(curve[edge]))
            chain = chains[edge]
            if chain is not None:
                fixed = np.full_like(chain, face), np.full_like(chain, edge)
                rims.append(np.column_stack([*fixed, chain, np.arange(len(chain))]))
        if own and len(rims) == len(request.edges_of(face)):
            elements += own
            faces += [np.full(len(table), face) for table in own]
            rim += rims
    if not elements:
        raise RuntimeError("no face was meshed")
    parts = (np.concatenate(rows) for rows in (elements, faces, rim))
    return Answer(points, *parts, request.faces)


def _chain(
    mesh: object, tags: np.ndarray, points: np.ndarray, request: Request, edge: int, curve: int
) -> np.ndarray | None:
    """Points along an edge in its direction; None where it is not cut as wanted."""
    kinds, _, nodes = mesh.getElements(1, curve)
    if len(kinds) != 1:
        return None
    lines = np.searchsorted(tags, np.reshape(nodes[0], (-1, 2)))
    if len(lines) != request.intervals[edge] or np.any(lines[1:, 0] != lines[:-1, 1]):
        return None
    chain = np.append(lines[:, 0], lines[-1, 1])
    wanted = request.points[request.first[edge] : request.first[edge + 1]]
    return chain[along(points[chain], wanted)[0]]
