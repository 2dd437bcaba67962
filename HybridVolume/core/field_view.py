# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The inner boundary before there is a shell: isosurfaces of the field, fast enough for a slider.

The worker solves the field and hands out what is here; the window then cuts it at any thickness in
a fraction of a second (section 3.2, "isosurface genus").
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from ..errors import FileFormatError
from .atomic import replacing
from .goals import DEEPEST, Thickness
from .harmonic import HarmonicField
from .isosurface import genus_from_euler, isosurface_cuts, isosurface_euler
from .surface import PatchSurface
from .tetmesh import TetMesh
from .thickness import HIGHEST, distance_to_triangles, surface_places

LEVELS = 16
"""Levels at which the thickness is known beforehand."""

PLACES = 2500
"""Places of the surface at which the thickness is taken, about."""

# Places from which the distance of the field's vertices to the surface is taken.
_DENSE = 40_000
# Rounds of averaging that even out factors between faces.
_ROUNDS = 6


@dataclass(frozen=True)
class Inner:
    """The inner boundary for one thickness.

    Attributes
    ----------
    vertices : (k, 3) array
        mm.
    triangles : (m, 3) int array
        Their normals point to the outer surface.
    distance : (k,) array
        Of each vertex to the outer surface, mm.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    distance: np.ndarray


@dataclass(frozen=True)
class FieldView:
    """A harmonic field and what is needed to look at its isosurfaces.

    Attributes
    ----------
    vertices : (n, 3) array
        Of the tetrahedra, mm.
    tets : (m, 4) int array
    w : (n,) array
        The field: 0 on the surface, 1 on the midstructure.
    distance : (n,) array
        Of each vertex to the surface, mm.
    middle : (n,) array
        Of each vertex to the midstructure, mm.
    face : (n,) int array
        The nearest CAD face, as a place in ``faces``.
    faces : (f,) array of str
        Names of the CAD faces.
    places : (p, 3) array
        Points of the surface, mm.
    area : (p,) array
        What each of them stands for, mm².
    curve : (l, 4) array
        Levels, and the least, the mean and the largest thickness there, mm.
    genus : (s,) int array
        Of each shell of the body's surface.
    largest_w0 : float
        The largest level, up to 0.99, whose isosurface has these genera.
    """

    vertices: np.ndarray
    tets: np.ndarray
    w: np.ndarray
    distance: np.ndarray
    middle: np.ndarray
    face: np.ndarray
    faces: np.ndarray
    places: np.ndarray
    area: np.ndarray
    curve: np.ndarray
    genus: np.ndarray
    largest_w0: float

    @classmethod
    def of(cls, field: HarmonicField, surface: PatchSurface) -> FieldView:
        """Take what is needed from a field in a body."""
        vertices = field.mesh.vertices
        dense, _, patch = surface_places(surface, _DENSE)
        near, place = cKDTree(dense).query(vertices)
        on_faces = field.mesh.boundary_triangles
        distance = np.minimum(near, distance_to_triangles(vertices, vertices, on_faces))
        distance[field.mesh.on_boundary] = 0.0
        names = np.array([p.face for p in surface.patches])
        faces = np.array(list(dict.fromkeys(names.tolist())))
        number = {name: k for k, name in enumerate(faces.tolist())}
        face = np.array([number[name] for name in names.tolist()])[patch[place]]
        places, area, _ = surface_places(surface, PLACES)
        view = cls(
            vertices=vertices,
            tets=field.mesh.tets,
            w=field.w,
            distance=distance,
            middle=cKDTree(vertices[field.fixed]).query(vertices)[0],
            face=face,
            faces=faces,
            places=places,
            area=area,
            curve=np.zeros((0, 4)),
            genus=np.array(surface.genus, dtype=np.int64),
            largest_w0=field.largest_level(surface.genus, HIGHEST),
        )
        return view._with_curve()

    def _with_curve(self) -> FieldView:
        levels = np.linspace(0.02, HIGHEST, LEVELS)
        rows = [[level, *self.figures(self.inner(Thickness("w0", level)))] for level in levels]
        values = {f.name: getattr(self, f.name) for f in fields(self)}
        return FieldView(**{**values, "curve": np.vstack([np.zeros(4), rows])})

    def save(self, path: str | os.PathLike) -> None:
        """Write an .npz; an existing file is replaced in one step.

        Raises
        ------
        OSError
            The place cannot be written.
        """
        with replacing(path) as file:
            np.savez(file, **{f.name: getattr(self, f.name) for f in fields(self)})

    @classmethod
    def load(cls, path: str | os.PathLike) -> FieldView:
        """Read what `save` wrote.

        Raises
        ------
        FileFormatError
            The file is missing or is no such file.
        """
        try:
            with np.load(path, allow_pickle=False) as file:
                values = {f.name: file[f.name] for f in fields(cls)}
        except (OSError, ValueError, KeyError) as error:
            raise FileFormatError(
                f"{os.path.basename(path)} holds no field ({error})", remedy="compute it again"
            ) from error
        return cls(**{**values, "largest_w0": float(values["largest_w0"])})

    @cached_property
    def mesh(self) -> TetMesh:
        """The tetrahedra."""
        return TetMesh(self.vertices, self.tets)

    @property
    def _deepest(self) -> float:
        return min(DEEPEST, self.largest_w0) or DEEPEST

    # What is asked for, as a function that is 1 on the inner boundary.

    def level(self, thickness: Thickness) -> float | None:
        """The one level that a thickness stands for; None where the level varies by place.

        Parameters
        ----------
        thickness : Thickness
        """
        if thickness.kind == "w0":
            level = thickness.value
        elif thickness.kind in ("mean", "min"):
            known = self.curve[:, {"min": 1, "mean": 2}[thickness.kind]]
            known = np.maximum.accumulate(known)
            level = float(np.interp(thickness.value, known, self.curve[:, 0]))
            level = min(level, self._deepest)
        else:
            return None
        return None if thickness.factors else level

    def function(self, thickness: Thickness) -> np.ndarray:
        """A function of the vertices that is 1 where the inner boundary should be, 0 outside.

        Parameters
        ----------
        thickness : Thickness

        Returns
        -------
        (n,) array
        """
        factor = self._factors(thickness.factors)
        if thickness.kind == "even":
            goal = self.distance / (thickness.value * factor)
            return np.maximum(goal, self.w / self._deepest)
        if thickness.kind == "share":
            local = np.maximum(self.distance + self.middle, np.finfo(float).tiny)
            goal = self.distance / (thickness.value * factor * local)
            return np.maximum(goal, self.w / self._deepest)
        level = self.level(Thickness(thickness.kind, thickness.value))
        if not thickness.factors:
            return self.w / level
        return self.w / np.minimum(level * factor, max(level, self._deepest))

    def _factors(self, factors: Mapping[str, float]) -> np.ndarray:
        """Factor at every vertex, that of the nearest face, evened out between faces."""
        if not factors:
            return np.ones(len(self.w))
        each = np.log([factors.get(name, 1.0) for name in self.faces.tolist()])[self.face]
        for _ in range(_ROUNDS):
            each = self._average @ each
        return np.exp(each)

    @cached_property
    def _average(self) -> sparse.csr_matrix:
        n = len(self.w)
        a, b = self.mesh.edges.T
        ones = np.ones(len(a))
        graph = sparse.coo_matrix((ones, (a, b)), shape=(n, n)).tocsr()
        graph = graph + graph.T + sparse.identity(n, format="csr")
        return sparse.diags(1.0 / np.asarray(graph.sum(axis=1)).ravel()) @ graph

    # What is seen.

    def inner(self, thickness: Thickness) -> Inner:
        """The inner boundary for a thickness, as triangles."""
        ends, share, triangles = isosurface_cuts(self.mesh, self.function(thickness), 1.0)
        first, second = ends.T
        share = share[:, None]
        vertices = (1.0 - share) * self.vertices[first] + share * self.vertices[second]
        share = share[:, 0]
        distance = (1.0 - share) * self.distance[first] + share * self.distance[second]
        return Inner(vertices, triangles, distance)

    def figures(self, inner: Inner) -> tuple[float, float, float]:
        """The least, the mean and the largest distance of an inner boundary to the surface, mm.

        The mean is weighted by the area of the surface: each of its places takes the distance of
        the point of the inner boundary that is nearest to it.
        """
        if not len(inner.triangles):
            return 0.0, 0.0, 0.0
        near = cKDTree(inner.vertices).query(self.places)[1]
        mean = np.average(inner.distance[near], weights=self.area)
        return float(inner.distance.min()), float(mean), float(inner.distance.max())

    def genus_at(self, thickness: Thickness) -> tuple[int, ...]:
        """Genus of every component of the inner boundary, sorted."""
        return genus_from_euler(isosurface_euler(self.mesh, self.function(thickness), 1.0))

    def same_genus(self, genus: Sequence[int]) -> bool:
        """Whether an inner boundary of these genera looks like the body."""
        return sorted(genus) == sorted(self.genus.tolist())
