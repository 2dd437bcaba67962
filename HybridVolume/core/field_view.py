# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The inner boundary before there is a shell: isosurfaces of the field, fast enough for a slider.

The worker solves the field and hands out what is here; the window then cuts it at any thickness in
a fraction of a second (section 3.2, "isosurface genus").
"""

from __future__ import annotations

import os
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from zipfile import BadZipFile

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from ..errors import FileFormatError
from .atomic import replacing
from .front import column_frame
from .goals import DEEPEST, SAMPLES, THINNEST, TORN, Thickness, local_radius
from .harmonic import HarmonicField
from .isosurface import genus_from_euler, isosurface_cuts, isosurface_euler
from .midstructure.distances import SurfaceDistance
from .surface import PatchSurface
from .tetmesh import TetMesh
from .thickness import HIGHEST, surface_places

LEVELS = 16
"""Levels at which the thickness is known beforehand."""

PLACES = 2500
"""Places of the surface at which the thickness is taken, about."""

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
    reached : (k,) array
        Share of what is asked for; below 1 where the body is too thin for it.
    places : (p, 3) array
        Points of the outer surface, mm.
    """

    vertices: np.ndarray
    triangles: np.ndarray
    distance: np.ndarray
    reached: np.ndarray
    places: np.ndarray = field(repr=False)

    @cached_property
    def nearest(self) -> np.ndarray:
        """The vertex that is nearest to each place of the surface, (p,)."""
        return cKDTree(self.vertices).query(self.places)[1]


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
    radius : (n,) array
        The local radius, half the body's thickness, at the nearest place of the surface, mm.
    face : (n,) int array
        The nearest CAD face, as a place in ``faces``.
    faces : (f,) array of str
        Names of the CAD faces.
    places : (p, 3) array
        Points of the surface, mm.
    area : (p,) array
        What each of them stands for, mm².
    place_face : (p,) int array
        The CAD face of each, as a place in ``faces``.
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
    radius: np.ndarray
    face: np.ndarray
    faces: np.ndarray
    places: np.ndarray
    area: np.ndarray
    place_face: np.ndarray
    curve: np.ndarray
    genus: np.ndarray
    largest_w0: float

    @classmethod
    def of(cls, solved: HarmonicField, surface: PatchSurface) -> FieldView:
        """Take what is needed from a field in a body."""
        vertices = solved.mesh.vertices
        feet = SurfaceDistance(surface, SAMPLES).nearest(vertices)
        distance = np.where(solved.mesh.on_boundary, 0.0, feet.distance)
        frame = column_frame(surface)
        node = cKDTree(frame.nodes).query(feet.points)[1]
        names = np.array([p.face for p in surface.patches])
        faces = np.array(list(dict.fromkeys(names.tolist())))
        number = {name: k for k, name in enumerate(faces.tolist())}
        of_patch = np.array([number[name] for name in names.tolist()])
        places, area, place_patch = surface_places(surface, PLACES)
        view = cls(
            vertices=vertices,
            tets=solved.mesh.tets,
            w=solved.w,
            distance=distance,
            radius=local_radius(surface, frame)[node],
            face=of_patch[feet.patch],
            faces=faces,
            places=places,
            area=area,
            place_face=of_patch[place_patch],
            curve=np.zeros((0, 4)),
            genus=np.array(surface.genus, dtype=np.int64),
            largest_w0=solved.largest_level(surface.genus, HIGHEST),
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
        except (OSError, EOFError, ValueError, KeyError, BadZipFile, zlib.error) as error:
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
        return self.stops_at(DEEPEST)

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
        return level if thickness.uniform else None

    def function(self, thickness: Thickness) -> np.ndarray:
        """A function of the vertices that is 1 where the inner boundary should be, 0 outside.

        Parameters
        ----------
        thickness : Thickness

        Returns
        -------
        (n,) array
        """
        goal = self._goal(thickness)
        # where the body is too thin for it the field ends before
        return goal if thickness.uniform else np.maximum(goal, self.w / self._deepest)

    def _goal(self, thickness: Thickness) -> np.ndarray:
        """Share of what is asked for, at every vertex."""
        factor = self._factors(thickness.factors)
        if thickness.kind == "even":
            return self.distance / (thickness.value * factor)
        if thickness.kind == "share":
            radius = np.maximum(self.radius, THINNEST * self.radius.mean())
            return self.distance / (thickness.value * factor * radius)
        return self.w / (self.level(Thickness(thickness.kind, thickness.value)) * factor)

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

        def at_cuts(values: np.ndarray) -> np.ndarray:
            shares = share.reshape(-1, *[1] * (values.ndim - 1))
            return (1.0 - shares) * values[first] + shares * values[second]

        reached = np.ones(len(ends)) if thickness.uniform else at_cuts(self._goal(thickness))
        return Inner(
            at_cuts(self.vertices), triangles, at_cuts(self.distance), reached, self.places
        )

    def figures(self, inner: Inner) -> tuple[float, float, float]:
        """The least, the mean and the largest distance of an inner boundary to the surface, mm.

        The mean is weighted by the area of the surface: each of its places takes the distance of
        the point of the inner boundary that is nearest to it.
        """
        if not len(inner.triangles):
            return 0.0, 0.0, 0.0
        mean = np.average(inner.distance[inner.nearest], weights=self.area)
        return float(inner.distance.min()), float(mean), float(inner.distance.max())

    def short(self, thickness: Thickness, inner: Inner) -> tuple[float, list[str]]:
        """Where the body is too thin for a thickness.

        Parameters
        ----------
        thickness : Thickness
            inner : Inner
            Its inner boundary.

        Returns
        -------
        share : float
            Of the surface's area where the shell is thinner than asked by more than 5 %.
        faces : list of str
            Faces of which more than a third is.
        """
        if thickness.uniform or not len(inner.triangles):
            return 0.0, []
        short = inner.reached[inner.nearest] < 0.95
        count = len(self.faces)
        part = np.bincount(self.place_face, self.area * short, count)
        whole = np.bincount(self.place_face, self.area, count)
        faces = self.faces[part > np.maximum(whole, np.finfo(float).tiny) / 3.0]
        return float(part.sum() / whole.sum()), faces.tolist()

    def genus_at(self, thickness: Thickness) -> tuple[int, ...]:
        """Genus of every component of the inner boundary, sorted."""
        return genus_from_euler(isosurface_euler(self.mesh, self.function(thickness), 1.0))

    def stops_at(self, level: float) -> float:
        """How far the shell goes where a level is asked, as `goals.usable_level` decides.

        Parameters
        ----------
        level : float
        """
        if TORN * level <= self.largest_w0 < level:
            return self.largest_w0
        return level

    def same_genus(self, genus: Sequence[int]) -> bool:
        """Whether an inner boundary of these genera looks like the body."""
        return sorted(genus) == sorted(self.genus.tolist())
