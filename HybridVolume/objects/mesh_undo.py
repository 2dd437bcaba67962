# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Undo and Redo of FEM meshes.

FreeCAD writes a mesh that is assigned over the one that it has kept for Undo: a step back restores
every property but the mesh's content. So the content carries a digest beside it, and where the two
do not agree after a step, the mesh is made again from the hybrid volume's stored result.
"""

from __future__ import annotations

import zlib
from typing import Any

import Fem
import FreeCAD
import numpy as np

from HybridVolume.errors import HybridVolumeError

_PARTS = ("FemMesh", "Shell", "Core")
"""Links from a hybrid volume to its meshes."""

_SAMPLED = 64
"""Nodes whose coordinates go into a digest."""

LOST = "Failed: this step's mesh cannot be made again; complete the volume again"


def digest(mesh: Any) -> str:
    """Counts of a ``Fem.FemMesh`` and a checksum over some of its nodes; groups do not count."""
    count = mesh.NodeCount
    numbers = np.linspace(1, max(1, count), min(_SAMPLED, count)).round().astype(int)
    try:
        places = [tuple(mesh.getNodeById(number)) for number in numbers.tolist()]
    except ValueError:  # numbered otherwise
        places = []
    checksum = zlib.crc32(np.array(places, dtype="<f8").tobytes())
    return f"{count} {mesh.FaceCount} {mesh.VolumeCount} {checksum:08x}"


class _Watcher:
    """Looks through a document after every step."""

    def slotUndoDocument(self, doc: Any) -> None:
        """After Undo."""
        restore_meshes(doc)

    def slotRedoDocument(self, doc: Any) -> None:
        """After Redo."""
        restore_meshes(doc)

    def slotAbortTransaction(self, doc: Any) -> None:
        """After a fault inside a step."""
        restore_meshes(doc)


_watchers: list[_Watcher] = []


def watch() -> None:
    """Look after every document's meshes from now on."""
    if not _watchers:
        _watchers.append(_Watcher())
        FreeCAD.addDocumentObserver(_watchers[0])


def restore_meshes(doc: Any) -> None:
    """Make those meshes of a document again that are not what their properties say."""
    wrong = [obj for obj in doc.Objects if hasattr(obj, "Digest") and not _agrees(obj)]
    for volume in {one.Name: one for obj in wrong for one in _volumes(obj)}.values():
        held = {name: getattr(volume, name) for name in _PARTS}
        try:
            _make_again(volume, {name: obj for name, obj in held.items() if obj in wrong})
        except (HybridVolumeError, OSError, AttributeError) as error:
            FreeCAD.Console.PrintError(f"{volume.Label}: {error}\n")
    for obj in wrong:
        if not _agrees(obj):
            # no mesh is better than another computation's
            obj.FemMesh = Fem.FemMesh()
            obj.Digest = digest(obj.FemMesh)
            if obj.Status:
                obj.Status = LOST


def _agrees(obj: Any) -> bool:
    return (obj.Digest or digest(Fem.FemMesh())) == digest(obj.FemMesh)


def _volumes(obj: Any) -> list[Any]:
    """Hybrid volumes that have a mesh object among their parts."""
    return [one for one in obj.InList if obj in [getattr(one, name, None) for name in _PARTS]]


def _make_again(volume: Any, objects: dict[str, Any]) -> None:
    from .inner import stored_volume
    from .prepared_mesh import PreparedMesh

    prepared = PreparedMesh(stored_volume(volume).fem, None)
    for name, obj in objects.items():
        if name == "FemMesh":
            prepared.fill(obj)
        else:
            prepared.fill_part(volume, name)
