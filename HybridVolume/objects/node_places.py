# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Where the outer nodes of a mesh lie on the CAD faces, and how far beside them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.sources.distances import surface_distances
from HybridVolume.sources.faces import distance_of_points

if TYPE_CHECKING:
    from HybridVolume.core.finite_elements import FiniteElementMesh
    from HybridVolume.core.surface import PatchSurface
    from HybridVolume.sources import Body


@dataclass(frozen=True)
class Places:
    """Where a mesh's outer nodes lie on the patches, and the patches on the CAD faces.

    Attributes
    ----------
    surface : PatchSurface
    body : Body
    patch : (n,) int array
        Patch of each node of the mesh, -1 inside.
    uv : (n, 2) array
        Its parameters there.
    tolerance : float
        How far beside the CAD faces the patches of a covered body may be, mm; 0 where each CAD
        face is a patch itself.
    """

    surface: PatchSurface
    body: Body
    patch: np.ndarray
    uv: np.ndarray
    tolerance: float = 0.0

    @classmethod
    def of(cls, fem: FiniteElementMesh, surface: PatchSurface, body: Body) -> Places | None:
        """Places of the nodes of a mesh; None where it does not tell them."""
        if not len(fem.surface_nodes):
            return None
        patch = np.full(len(fem.nodes), -1)
        uv = np.full((len(fem.nodes), 2), np.nan)
        patch[fem.surface_nodes] = fem.surface_patch
        uv[fem.surface_nodes] = fem.surface_uv
        tolerance = body.cover.tolerance if body.cover is not None else 0.0
        return cls(surface, body, patch, uv, tolerance)

    def distances(self, known: Mapping[str, np.ndarray], nodes: np.ndarray) -> dict[str, float]:
        """Largest distance of nodes from their CAD faces at their own parameters, mm.

        On a covered body the nearest points of the faces' surfaces count: its patches have
        parameters of their own.

        Parameters
        ----------
        known : mapping of str to (m,) int array
            Nodes on each face, at least one.
        nodes : (n, 3) array
            All nodes.
        """
        if self.body.cover is not None:
            faces = self.body.shape.Faces
            return {
                name: float(surface_distances(faces[_number(name) - 1], nodes[own]).max())
                for name, own in known.items()
            }
        faces = [self._by_name[name] for name in known]
        sizes = [len(numbers) for numbers in known.values()]
        node = np.concatenate(list(known.values()))
        patch = np.repeat([patch for patch, _, _ in faces], sizes)
        points = nodes[node]
        uv = self._parameters(patch, node, points)
        turned = self.surface.turned
        ways = [uv, uv[:, ::-1]]
        if len(turned):
            # turning a patch over exchanged its parameters
            ways = [np.where(np.asarray(turned)[patch, None], uv[:, ::-1], uv)]
        ends = np.cumsum(sizes).tolist()
        found = {}
        for name, (_, face, domain), first, end in zip(
            known, faces, [0, *ends], ends, strict=False
        ):
            part = slice(first, end)
            tried = ways if domain is not None else ways[:1]
            found[name] = min(
                distance_of_points(points[part], *way[part].T, face, domain) for way in tried
            )
        return found

    @cached_property
    def _by_name(self) -> dict[str, tuple[int, Any, tuple | None]]:
        """Patch, CAD face and its rectangle of parameters by the face's name."""
        patches = {patch.face: k for k, patch in enumerate(self.surface.patches)}
        faces = self.body.shape.Faces
        return {
            face.name: (patches[face.name], faces[_number(face.name) - 1], domain)
            for face, domain in zip(self.body.faces, self.body.domains, strict=True)
        }

    def _parameters(self, patch: np.ndarray, known: np.ndarray, points: np.ndarray) -> np.ndarray:
        """Parameters of nodes, (m, 2), each on a patch that may be a neighbour of its own."""
        uv = self.uv[known].copy()
        others = np.flatnonzero(self.patch[known] != patch)
        if len(others):
            # sides that meet have the same parameters, either way: one of these is the place
            t = uv[others].ravel()
            ends = [np.zeros_like(t), np.ones_like(t)]
            along = [t, 1.0 - t]
            tried = [np.column_stack([e, a]) for e in ends for a in along]
            tried = np.stack([*tried, *(pair[:, ::-1] for pair in tried)])
            tried = tried.reshape(8, len(others), 2, 2).transpose(1, 0, 2, 3).reshape(-1, 16, 2)
            on = np.repeat(patch[others], 16)
            at = self.surface.evaluate_at(on, *tried.reshape(-1, 2).T).reshape(-1, 16, 3)
            best = np.linalg.norm(at - points[others, None], axis=2).argmin(axis=1)
            uv[others] = tried[np.arange(len(others)), best]
        return uv


def _number(name: str) -> int:
    return int(name.removeprefix("Face"))
