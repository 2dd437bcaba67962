# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Meshes of the FEM workbench, checked against what they were made from and against the CAD faces.

FreeCAD takes inverted elements, drops kinds it does not know and finds no nodes on a face, all
without a word: therefore everything is counted again here.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import Fem
import numpy as np
import Part

from HybridVolume.core.element_jacobians import scaled_jacobian
from HybridVolume.core.elements import from_order, to_order
from HybridVolume.errors import FaultError

from .properties import DocumentObject, Property

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh

SAMPLED_NODES = 500
"""Nodes that are looked for on the CAD faces altogether: each costs OCC about 2 ms."""

WIDEST = 1e-5
"""Widest tolerance of a face that is used, as a share of the body's diagonal."""


@dataclass(frozen=True)
class MeshArrays:
    """What a mesh of the FEM workbench is made from.

    Attributes
    ----------
    nodes : (n, 3) array
        mm.
    volumes : mapping of str to (str, (m, k) array)
        Group name to kind ("penta15", ...) and connectivity in Abaqus order.
    faces : mapping of str to (str, (m, k) array)
        The same for boundary faces.
    node_groups : mapping of str to int array
    """

    nodes: np.ndarray
    volumes: Mapping[str, tuple[str, np.ndarray]]
    faces: Mapping[str, tuple[str, np.ndarray]] = field(default_factory=dict)
    node_groups: Mapping[str, np.ndarray] = field(default_factory=dict)

    def part(self, group: str, *, faces: bool = False) -> MeshArrays:
        """Only one group of volumes, and the nodes that it uses."""
        kind, connectivity = self.volumes[group]
        used, renumbered = np.unique(connectivity, return_inverse=True)
        volumes = {group: (kind, renumbered.reshape(connectivity.shape))}
        kept = {}
        if faces:
            place = np.full(len(self.nodes), -1)
            place[used] = np.arange(len(used))
            kept = {name: (k, place[c]) for name, (k, c) in self.faces.items()}
        return MeshArrays(self.nodes[used], volumes, kept)


def arrays_of(fem: FiniteElementMesh) -> MeshArrays:
    """Groups Shell, Core, Interface and one for each CAD face of a conforming mesh."""
    return MeshArrays(
        nodes=fem.nodes,
        volumes={"Shell": (fem.wedge_kind, fem.wedges), "Core": (fem.tet_kind, fem.tets)},
        faces={name: (fem.face_kind, fem.face_triangles(name)) for name in fem.face_names},
        node_groups={"Interface": np.unique(fem.interface)},
    )


def build(arrays: MeshArrays) -> Any:
    """Return a ``Fem.FemMesh`` of the arrays; nodes are numbered from 1 in their order.

    Raises
    ------
    FaultError
        FreeCAD did not take everything.
    """
    mesh = Fem.FemMesh()
    for number, (x, y, z) in enumerate(arrays.nodes.tolist(), start=1):
        mesh.addNode(x, y, z, number)
    groups: list[tuple[str, str, Sequence[int]]] = []
    next_id = 1
    # Faces come first: saving numbers faces before volumes too, so the numbers stay the same.
    for element, table, add in (
        ("Face", arrays.faces, mesh.addFace),
        ("Volume", arrays.volumes, mesh.addVolume),
    ):
        for name, (kind, connectivity) in table.items():
            for row in (to_order("freecad", kind, connectivity) + 1).tolist():
                add(row, next_id)
                next_id += 1
            groups.append((name, element, range(next_id - len(connectivity), next_id)))
    for name, members in arrays.node_groups.items():
        groups.append((name, "Node", (np.asarray(members) + 1).tolist()))
    for name, element, members in groups:
        # FreeCAD forgets empty groups when it stores a mesh.
        if len(members):
            mesh.addGroupElements(mesh.addGroup(name, element), list(members))
    _check_counts(mesh, arrays, groups)
    return mesh


def _check_counts(mesh: Any, arrays: MeshArrays, groups: list) -> None:
    expected = {
        "NodeCount": len(arrays.nodes),
        "VolumeCount": sum(len(c) for _, c in arrays.volumes.values()),
        "FaceCount": sum(len(c) for _, c in arrays.faces.values()),
    }
    for name, count in expected.items():
        if getattr(mesh, name) != count:
            raise FaultError(f"FreeCAD's mesh has {name} {getattr(mesh, name)}, not {count}")
    members = {mesh.getGroupName(g): len(mesh.getGroupElements(g)) for g in mesh.Groups}
    for name, _, wanted in groups:
        if members.get(name, 0) != len(wanted):
            raise FaultError(
                f"group {name} of FreeCAD's mesh has {members.get(name, 0)} members, "
                f"not {len(wanted)}"
            )


def element_quality(mesh: Any) -> dict[int, float]:
    """Smallest scaled Jacobian of each volume element of a FreeCAD mesh, by element number."""
    place = {node: row for row, node in enumerate(mesh.Nodes)}
    points = np.array([tuple(point) for point in mesh.Nodes.values()])
    kinds = {4: "tet4", 6: "penta6", 10: "tet10", 15: "penta15"}
    rows: dict[str, dict[int, list[int]]] = {}
    for element in mesh.Volumes:
        nodes = mesh.getElementNodes(element)
        rows.setdefault(kinds[len(nodes)], {})[element] = [place[node] for node in nodes]
    quality: dict[int, float] = {}
    for kind, table in rows.items():
        connectivity = from_order("freecad", kind, np.array(list(table.values())))
        values = scaled_jacobian(kind, points[connectivity])
        quality.update(zip(table, values.tolist(), strict=True))
    return quality


def uncovered_faces(
    arrays: MeshArrays, shape: Any, budget: int | None = SAMPLED_NODES
) -> dict[str, tuple[int, int]]:
    """Faces of a shape on which FreeCAD does not find the mesh's nodes.

    A load or support on such a face would act on nothing, without a message. Nodes are looked for
    as the FEM workbench does.

    Parameters
    ----------
    arrays : MeshArrays
        With a group of faces ``FaceN`` for every face of the shape.
    shape : Part.Shape
    budget : int or None
        Nodes to look for altogether, spread evenly over each face's; None: all.

    Returns
    -------
    dict
        Face name to (nodes found, nodes looked for); empty when all is well.
    """
    bad = {}
    share = None if budget is None else max(4, budget // max(1, len(shape.Faces)))
    for number, face in enumerate(shape.Faces, start=1):
        name = f"Face{number}"
        if name not in arrays.faces:
            bad[name] = (0, 0)
            continue
        known = _spread(arrays, name, share)
        # A mesh of these nodes only: every node in the face's box costs time.
        probe = Fem.FemMesh()
        for node, (x, y, z) in enumerate(arrays.nodes[known].tolist(), start=1):
            probe.addNode(x, y, z, node)
        found = len(probe.getNodesByFace(face))
        if found != len(known):
            bad[name] = (found, len(known))
    return bad


def cover(arrays: MeshArrays, shape: Any) -> tuple[Any | None, int]:
    """Make sure that FreeCAD finds the mesh's nodes on every face of a body.

    Parameters
    ----------
    arrays : MeshArrays
    shape : Part.Shape

    Returns
    -------
    copy : Part.Shape or None
        None where the shape serves as it is, else a copy whose faces have a tolerance wide enough.
    faces : int
        Number of faces.

    Raises
    ------
    FaultError
        Nodes lie too far from a face; the error names the faces.
    """
    bad = uncovered_faces(arrays, shape)
    if not bad:
        return None, len(shape.Faces)
    off = max(_distance(arrays, shape, name) for name in bad)
    tolerance = max(1e-6, 2.0 * off)
    if tolerance <= WIDEST * shape.BoundBox.DiagonalLength:
        copy = shape.copy()
        copy.fixTolerance(tolerance)
        if not uncovered_faces(arrays, copy):
            return copy, len(shape.Faces)
    raise FaultError(
        f"mesh nodes lie up to {off:.2g} mm beside the CAD faces; loads on them would be lost",
        faces=tuple(bad),
        figure=off,
        remedy="heal the body and run again",
    )


def _distance(arrays: MeshArrays, shape: Any, name: str) -> float:
    """Largest distance of a face's nodes from it, mm."""
    if name not in arrays.faces:
        return np.inf
    face = shape.Faces[int(name.removeprefix("Face")) - 1]
    points = arrays.nodes[_spread(arrays, name, SAMPLED_NODES)]
    return max(Part.Vertex(*point).distToShape(face)[0] for point in points.tolist())


def _spread(arrays: MeshArrays, name: str, count: int | None) -> np.ndarray:
    """Nodes on a face, at most ``count`` of them, spread evenly."""
    known = np.unique(arrays.faces[name][1])
    if count is not None and len(known) > count:
        known = known[np.linspace(0, len(known) - 1, count).round().astype(int)]
    return known


_STATUS = Property("App::PropertyString", "Base", "Up to date, or why not.", mode=("ReadOnly",))


class PartMesh(DocumentObject):
    """Proxy of the shell's or the core's mesh, which is there to be looked at and exported."""

    Type = "HybridVolume::PartMesh"
    PROPERTIES = {
        "Part": Property(
            "App::PropertyString", "Mesh", "Shell or Core.", mode=("ReadOnly", "Hidden")
        ),
        "Elements": Property("App::PropertyInteger", "Mesh", "Elements.", mode=("ReadOnly",)),
        "Status": _STATUS,
    }

    def prepare(self, obj: Any) -> None:
        """Take the part from the object's name, which FreeCAD may have given a number."""
        obj.Part = "Shell" if obj.Name.startswith("Shell") else "Core"


class AnalysisMesh(DocumentObject):
    """Proxy of the conforming mesh of shell and core for an analysis."""

    Type = "HybridVolume::AnalysisMesh"
    PROPERTIES = {
        # FEM looks for a link of this name.
        "Shape": Property("App::PropertyLink", "Mesh", "The body that was meshed."),
        "Order": Property(
            "App::PropertyEnumeration",
            "Mesh",
            "Order of the elements: 15-node wedges and 10-node tets (Second), or 6 and 4 nodes.",
            choices=("Second", "First"),
        ),
        "Density": Property(
            "App::PropertyEnumeration",
            "Mesh",
            "Where the nodes on the interface of shell and core lie: at the knots, or at the "
            "Greville abscissae.",
            choices=("knots", "greville"),
        ),
        "Groups": Property(
            "App::PropertyStringList", "Mesh", "Groups of the mesh.", mode=("ReadOnly",)
        ),
        "Status": _STATUS,
    }


def make_mesh_object(doc: Any, name: str, proxy: type[DocumentObject]) -> Any:
    """Add an empty mesh object to a document; ``proxy`` is its class."""
    obj = doc.addObject("Fem::FemMeshObjectPython", name)
    proxy(obj)
    return obj
