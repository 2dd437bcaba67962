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

from HybridVolume.core.element_jacobians import scaled_jacobian
from HybridVolume.core.elements import FACES, from_order, to_order
from HybridVolume.errors import FaultError

from . import density
from .mesh_undo import watch
from .properties import DocumentObject, Property
from .volume import mesh_inputs, mesh_parameters, source_fingerprint, status_of_inputs

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh


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
    numbers = element_numbers(arrays)
    for element, table, add in (
        ("Face", arrays.faces, mesh.addFace),
        ("Volume", arrays.volumes, mesh.addVolume),
    ):
        for name, (kind, connectivity) in table.items():
            rows = (to_order("freecad", kind, connectivity) + 1).tolist()
            for row, number in zip(rows, numbers[name], strict=True):
                add(row, number)
            groups.append((name, element, numbers[name]))
    for name, members in arrays.node_groups.items():
        groups.append((name, "Node", (np.asarray(members) + 1).tolist()))
    for name, element, members in groups:
        # FreeCAD forgets empty groups when it stores a mesh.
        if len(members):
            mesh.addGroupElements(mesh.addGroup(name, element), list(members))
    wrong = differences(mesh, arrays)
    if wrong:
        raise FaultError(f"FreeCAD did not take the whole mesh: {'; '.join(wrong)}")
    return mesh


def differences(mesh: Any, arrays: MeshArrays) -> list[str]:
    """What of a ``Fem.FemMesh`` is not as in the arrays that it was built of.

    Coordinates are compared bit for bit, elements node by node, groups member by member.

    Parameters
    ----------
    mesh : Fem.FemMesh
        As it was built, or as it came back from a file.
    arrays : MeshArrays

    Returns
    -------
    list of str
        A few words on each difference; empty when there is none.
    """
    wrong = []
    nodes, given = mesh.Nodes, arrays.nodes.tolist()
    if len(nodes) != len(given):
        wrong.append(f"{len(nodes)} nodes, not {len(given)}")
    else:
        moved = sum(
            number not in nodes or tuple(nodes[number]) != tuple(point)
            for number, point in enumerate(given, start=1)
        )
        if moved:
            wrong.append(f"{moved} nodes elsewhere")
    groups = {mesh.getGroupName(g): set(mesh.getGroupElements(g)) for g in mesh.Groups}
    numbers = element_numbers(arrays)
    for held, table in ((mesh.Faces, arrays.faces), (mesh.Volumes, arrays.volumes)):
        kind = "faces" if table is arrays.faces else "volumes"
        count = sum(len(rows) for _, rows in table.values())
        if len(held) != count:
            wrong.append(f"{len(held)} {kind}, not {count}")
            continue
        for name, (element, rows) in table.items():
            expected = (to_order("freecad", element, rows) + 1).tolist()
            turned = sum(
                list(mesh.getElementNodes(number)) != nodes_of
                for number, nodes_of in zip(numbers[name], expected, strict=True)
            )
            if turned:
                wrong.append(f"{turned} {kind} of {name} with other nodes")
    members = {name: set(range_) for name, range_ in numbers.items()}
    members |= {name: set((rows + 1).tolist()) for name, rows in arrays.node_groups.items()}
    for name, expected in members.items():
        if groups.get(name, set()) != expected:
            wrong.append(
                f"{len(groups.get(name, ()))} members of group {name}, not {len(expected)}"
                if len(groups.get(name, ())) != len(expected)
                else f"other members of group {name}"
            )
    return wrong


def element_numbers(arrays: MeshArrays) -> dict[str, range]:
    """Numbers of FreeCAD's elements by group: faces come first, all in the arrays' order."""
    # Saving numbers faces before volumes too, so the numbers stay the same.
    numbers, following = {}, 1
    for table in (arrays.faces, arrays.volumes):
        for name, (_, rows) in table.items():
            numbers[name] = range(following, following + len(rows))
            following += len(rows)
    return numbers


def element_quality(mesh: Any, *, outer: bool = False) -> dict[int, float]:
    """Smallest scaled Jacobian of each volume element of a FreeCAD mesh, by element number.

    Parameters
    ----------
    mesh : Fem.FemMesh
    outer : bool
        Only of the elements with a face that no other element has, which are those to be seen:
        FreeCAD takes time by the square of their number to colour elements.
    """
    place = {node: row for row, node in enumerate(mesh.Nodes)}
    points = np.array([tuple(point) for point in mesh.Nodes.values()])
    kinds = {4: "tet4", 6: "penta6", 10: "tet10", 15: "penta15"}
    rows: dict[str, dict[int, list[int]]] = {}
    for element in mesh.Volumes:
        nodes = mesh.getElementNodes(element)
        rows.setdefault(kinds[len(nodes)], {})[element] = [place[node] for node in nodes]
    tables = {
        kind: (np.array(list(table)), from_order("freecad", kind, np.array(list(table.values()))))
        for kind, table in rows.items()
    }
    if outer:
        seen = np.concatenate(_outer_elements(tables))
        kept = {kind: np.isin(numbers, seen) for kind, (numbers, _) in tables.items()}
        tables = {k: (numbers[kept[k]], c[kept[k]]) for k, (numbers, c) in tables.items()}
    quality: dict[int, float] = {}
    for kind, (numbers, connectivity) in tables.items():
        values = scaled_jacobian(kind, points[connectivity])
        quality.update(zip(numbers.tolist(), values.tolist(), strict=True))
    return quality


def _outer_elements(tables: Mapping[str, tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
    """Numbers of the elements with a face of their own, kind by kind and face by face."""
    owners, keys = [], []
    for kind, (numbers, connectivity) in tables.items():
        for corners in FACES[{"tet10": "tet4", "penta15": "penta6"}.get(kind, kind)]:
            owners.append(numbers)
            # three corners tell faces of a conforming mesh apart
            keys.append(np.sort(connectivity[:, corners], axis=1)[:, :3])
    _, place, times = np.unique(
        np.concatenate(keys), axis=0, return_inverse=True, return_counts=True
    )
    alone = np.split(times[place.ravel()] == 1, np.cumsum([len(o) for o in owners])[:-1])
    return [numbers[own] for numbers, own in zip(owners, alone, strict=True)]


_STATUS = Property("App::PropertyString", "Base", "Up to date, or why not.", mode=("ReadOnly",))
_DIGEST = Property(
    "App::PropertyString", "Mesh", "What the mesh is known by.", mode=("ReadOnly", "Hidden")
)


class PartMesh(DocumentObject):
    """Proxy of the shell's or the core's mesh, which is there to be looked at and exported."""

    Type = "HybridVolume::PartMesh"
    PROPERTIES = {
        "Part": Property(
            "App::PropertyString", "Mesh", "Shell or Core.", mode=("ReadOnly", "Hidden")
        ),
        "Elements": Property("App::PropertyInteger", "Mesh", "Elements.", mode=("ReadOnly",)),
        "Digest": _DIGEST,
        "Status": _STATUS,
    }

    def ensure_properties(self, obj: Any) -> None:
        """Add what is absent, and look after the mesh at Undo."""
        super().ensure_properties(obj)
        watch()

    def prepare(self, obj: Any) -> None:
        """Take the part from the object's name, which FreeCAD may have given a number."""
        obj.Part = "Shell" if obj.Name.startswith("Shell") else "Core"


class AnalysisMesh(DocumentObject):
    """Proxy of the conforming mesh of shell and core for an analysis."""

    Type = "HybridVolume::AnalysisMesh"
    SCHEMA = 2
    PROPERTIES = {
        # FEM looks for a link of this name.
        "Shape": Property("App::PropertyLink", "Mesh", "The body that was meshed."),
        "Order": Property(
            "App::PropertyEnumeration",
            "Mesh",
            "Order of the elements: 15-node wedges and 10-node tets (Second), or 6 and 4 nodes.",
            choices=("Second", "First"),
        ),
        **density.PROPERTIES,
        "Groups": Property(
            "App::PropertyStringList", "Mesh", "Groups of the mesh.", mode=("ReadOnly",)
        ),
        "ComputedFrom": Property(
            "App::PropertyMap",
            "Mesh",
            "What a mesh without a hybrid volume was made from.",
            mode=("ReadOnly", "Hidden"),
        ),
        "Lost": Property(
            "App::PropertyStringList",
            "Mesh",
            "Faces, edges and vertices on which FreeCAD does not find every node: loads and "
            "supports on them would be incomplete.",
            mode=("ReadOnly",),
        ),
        "FaceTolerance": Property(
            "App::PropertyLength",
            "Mesh",
            "Widest tolerance of faces of the body that loads go on, where it was made wider than "
            "that of the CAD faces, which the nodes are beside; else 0.",
            0.0,
            mode=("ReadOnly",),
        ),
        "Digest": _DIGEST,
        "Status": _STATUS,
    }

    def ensure_properties(self, obj: Any) -> None:
        """Add what is absent, hide what does not count, and look after the mesh at Undo."""
        super().ensure_properties(obj)
        density.show_relevant(obj)
        watch()

    def onChanged(self, obj: Any, name: str) -> None:
        """Show the properties that count for what was selected."""
        if name == "Density" and set(density.DEFAULTS) <= set(obj.PropertiesList):
            density.show_relevant(obj)

    def execute(self, obj: Any) -> None:
        """Mark a mesh that belongs to no hybrid volume where its body or density changed."""
        if obj.ComputedFrom:
            obj.Status = status_of_inputs(obj.ComputedFrom, inputs_of_mesh(obj))


def inputs_of_mesh(obj: Any) -> dict[str, str]:
    """What the mesh of a mesh object would be made from now, as text by name."""
    values = mesh_parameters(obj)
    return {**mesh_inputs(values), "Source": source_fingerprint(obj.Shape)}


def make_mesh_object(doc: Any, name: str, proxy: type[DocumentObject]) -> Any:
    """Add an empty mesh object to a document; ``proxy`` is its class."""
    obj = doc.addObject("Fem::FemMeshObjectPython", name)
    proxy(obj)
    return obj
