# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The conforming mesh that a document stores, as arrays: of a hybrid volume, or a mesh alone."""

from __future__ import annotations

from typing import Any

import numpy as np

from HybridVolume.core.element_jacobians import prove_positive, relative_bound, scaled_jacobian
from HybridVolume.core.elements import from_order
from HybridVolume.core.finite_elements import FiniteElementMesh
from HybridVolume.core.hybrid import HybridVolume
from HybridVolume.errors import InputError

from .fem_mesh import AnalysisMesh
from .volume import CHILDREN, VolumeObject

_KINDS = {3: "tri3", 6: "tri6"}, {4: "tet4", 6: "penta6", 10: "tet10", 15: "penta15"}
"""Kinds of faces and of volumes by their number of nodes."""


def volume_object_of(obj: Any) -> Any:
    """The hybrid volume that an object stands for.

    Parameters
    ----------
    obj : App.DocumentObject
        A hybrid volume, one of its parts, or the body it was made of.

    Raises
    ------
    InputError
        There is none, or several.
    """
    if _type(obj) == VolumeObject.Type:
        return obj
    found = [
        one
        for one in dict.fromkeys(obj.InList)
        if _type(one) == VolumeObject.Type
        and obj in [getattr(one, name) for name in ("Source", *CHILDREN)]
    ]
    if len(found) != 1:
        raise InputError(
            f"{obj.Label} has {len(found) or 'no'} hybrid volumes",
            remedy="give the hybrid volume itself, and complete it first if there is none",
        )
    return found[0]


def stored_mesh(obj: Any) -> FiniteElementMesh:
    """The conforming mesh of an object.

    Parameters
    ----------
    obj : App.DocumentObject
        As for `volume_object_of`, or a mesh that belongs to no hybrid volume of the document.

    Raises
    ------
    InputError
        It has no hybrid volume, that one no result, or the mesh is not as it was made.
    """
    if _type(obj) == AnalysisMesh.Type and not any(
        _type(one) == VolumeObject.Type for one in obj.InList
    ):
        return read_mesh(obj.FemMesh, obj.Label)
    return stored_volume(obj).fem


def stored_volume(obj: Any) -> HybridVolume:
    """The hybrid volume of an object.

    Parameters
    ----------
    obj : App.DocumentObject
        As for `volume_object_of`.

    Raises
    ------
    InputError
        It has no hybrid volume, or that one no result.
    """
    volume = volume_object_of(obj)
    if not volume.Result:
        raise InputError(f"{volume.Label} has no result yet", remedy="complete the volume first")
    return HybridVolume.load(volume.Result)


def read_mesh(mesh: Any, label: str) -> FiniteElementMesh:
    """Arrays of a ``Fem.FemMesh`` with the groups Shell and Core and one for each CAD face.

    Patches are not known (-1), nor parameters on them.

    Parameters
    ----------
    mesh : Fem.FemMesh
    label : str
        What the mesh is called, for an error.

    Raises
    ------
    InputError
        Groups or elements are others than those that this program makes.
    """
    table = mesh.Nodes
    numbers = np.array(sorted(table), dtype=np.int64)
    nodes = np.array([tuple(table[number]) for number in numbers.tolist()]).reshape(-1, 3)
    groups = {
        mesh.getGroupName(g): (mesh.getGroupElementType(g), sorted(mesh.getGroupElements(g)))
        for g in mesh.Groups
    }
    faces = sorted((ids, name) for name, (kind, ids) in groups.items() if kind == "Face")
    held = [groups.get(name, ("", []))[1] for name in ("Shell", "Core")]
    foreign = InputError(
        f"{label} is not a mesh of shell and core with a group for each face",
        remedy="give the hybrid volume, or a mesh as it was made",
    )
    whole = sorted(mesh.Volumes) == sorted([*held[0], *held[1]])
    whole &= sorted(mesh.Faces) == sorted(number for ids, _ in faces for number in ids)
    if not (all(held) and faces and whole):
        raise foreign

    def rows(elements: list[int], kinds: dict[int, str]) -> tuple[str, np.ndarray]:
        found = [mesh.getElementNodes(element) for element in elements]
        sizes = {len(row) for row in found}
        if len(sizes) != 1 or not sizes <= set(kinds):
            raise foreign
        kind = kinds[sizes.pop()]
        return kind, from_order("freecad", kind, np.searchsorted(numbers, np.array(found)))

    wedge_kind, wedges = rows(held[0], _KINDS[1])
    tet_kind, tets = rows(held[1], _KINDS[1])
    _, boundary = rows([number for ids, _ in faces for number in ids], _KINDS[0])
    if (wedge_kind, tet_kind) not in (("penta6", "tet4"), ("penta15", "tet10")):
        raise foreign
    order = 2 if tet_kind == "tet10" else 1
    over, layer, inner = _columns(wedges, boundary)
    if (over < 0).any() or (layer < 0).any():
        raise foreign
    qualities, bounds = [], []
    for kind, connectivity in ((wedge_kind, wedges), (tet_kind, tets)):
        x = nodes[connectivity]
        qualities.append(scaled_jacobian(kind, x))
        bounds.append(relative_bound(kind, x, prove_positive(kind, x).lower_bound))
    bottom = [0, 1, 2, 6, 7, 8] if order == 2 else [0, 1, 2]
    return FiniteElementMesh(
        order=order,
        nodes=nodes,
        wedges=wedges,
        wedge_patch=np.full(len(wedges), -1),
        wedge_layer=layer,
        tets=tets,
        boundary=boundary,
        boundary_face=np.repeat(np.arange(len(faces)), [len(ids) for ids, _ in faces]),
        boundary_wedge=over,
        interface=wedges[inner][:, bottom],
        face_names=tuple(name for _, name in faces),
        wedge_quality=qualities[0],
        tet_quality=qualities[1],
        wedge_bound=bounds[0],
        tet_bound=bounds[1],
    )


def _columns(wedges: np.ndarray, boundary: np.ndarray) -> tuple[np.ndarray, ...]:
    """Wedge under each boundary triangle, layer of each wedge, and the innermost wedges."""
    sides = np.sort(np.concatenate([wedges[:, 3:6], wedges[:, :3], boundary[:, :3]]), axis=1)
    _, side = np.unique(sides, axis=0, return_inverse=True)
    top, bottom, outer = np.split(side.reshape(-1), [len(wedges), 2 * len(wedges)])
    owner = np.full(side.max() + 1, -1)
    owner[top] = np.arange(len(wedges))
    over = owner[outer]
    layer = np.full(len(wedges), -1)
    current, depth = over[over >= 0], 0
    # a wedge that has its layer is not visited again, whatever the mesh
    while len(current):
        layer[current] = depth
        below = owner[bottom[current]]
        current, depth = below[(below >= 0) & (layer[below] < 0)], depth + 1
    return over, layer, np.flatnonzero(owner[bottom] < 0)


def _type(obj: Any) -> str:
    return getattr(getattr(obj, "Proxy", None), "Type", "")
