# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A conforming mesh on its way into a document: made and checked before the document changes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import FreeCAD

from .coverage import Coverage, Places, cover
from .fem_mesh import arrays_of, build, differences
from .mesh_undo import digest

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh
    from HybridVolume.core.surface import PatchSurface
    from HybridVolume.sources import Body

PARTS = ("Shell", "Core")
"""Groups of volume elements that have an object of their own, to be looked at."""


class PreparedMesh:
    """A conforming mesh as FreeCAD meshes, with the proof that its nodes are found on the body.

    Parameters
    ----------
    fem : FiniteElementMesh
    body : Body or None
        None: nothing is looked for.
    surface : PatchSurface, optional
        The body's surface, to whose patches the mesh's nodes belong; without it nodes are looked
        for, but not measured.

    Attributes
    ----------
    fem : FiniteElementMesh
    arrays : MeshArrays
    coverage : Coverage or None
    mesh : Fem.FemMesh
        Shell and core.
    parts : dict of str to Fem.FemMesh
        Each alone.
    groups : list of str

    Raises
    ------
    FaultError
        Nodes lie beside the body's faces, or FreeCAD did not take the meshes.
    """

    def __init__(
        self, fem: FiniteElementMesh, body: Body | None, surface: PatchSurface | None = None
    ) -> None:
        self.fem = fem
        self.arrays = arrays_of(fem)
        self.coverage: Coverage | None = None
        if body is not None:
            places = None if surface is None else Places.of(fem, surface, body)
            self.coverage = cover(self.arrays, body.shape, places)
        self.mesh = build(self.arrays)
        self.parts = {part: build(self.arrays.part(part)) for part in PARTS}
        self.groups = [*self.arrays.volumes, *self.arrays.node_groups, *self.arrays.faces]

    def fill(self, obj: Any) -> None:
        """Give the mesh to the mesh object; groups that were added to an earlier one come again."""
        _carry_groups(obj.FemMesh, self.mesh)
        obj.FemMesh = self.mesh
        obj.Digest = digest(self.mesh)
        obj.Groups = self.groups

    def fill_part(self, volume: Any, part: str) -> None:
        """Give shell or core alone to the part of a hybrid volume."""
        child, mesh = getattr(volume, part), self.parts[part]
        child.FemMesh = mesh
        child.Digest = digest(mesh)
        child.Elements = mesh.VolumeCount

    def differences(self, volume: Any) -> list[str]:
        """What the meshes of a hybrid volume's objects have not as they were prepared.

        Returns
        -------
        list of str
            Empty when there is nothing.
        """
        wrong = [f"FemMesh: {text}" for text in differences(volume.FemMesh.FemMesh, self.arrays)]
        for part in PARTS:
            stored = getattr(volume, part).FemMesh
            wrong += [f"{part}: {text}" for text in differences(stored, self.arrays.part(part))]
        return wrong


def _carry_groups(old: Any, new: Any) -> None:
    """Add groups of an earlier mesh that were copies of its own groups, as materials have them."""
    held = {old.getGroupName(g): g for g in old.Groups}
    own = {new.getGroupName(g): g for g in new.Groups}
    for name, group in held.items():
        if name in own:
            continue
        members = old.getGroupElements(group)
        kind = old.getGroupElementType(group)
        same = next(
            (
                other
                for other in own
                if other in held
                and old.getGroupElementType(held[other]) == kind
                and old.getGroupElements(held[other]) == members
            ),
            None,
        )
        if same is None:
            FreeCAD.Console.PrintWarning(f"the group {name} has no counterpart in the new mesh\n")
            continue
        new.addGroupElements(new.addGroup(name, kind), list(new.getGroupElements(own[same])))
