# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What an analysis found: values at points and on CAD faces, files, pictures, FreeCAD objects."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from HybridVolume.core.analysis.fields import Field, FieldSpace
from HybridVolume.core.analysis.places import Locator, Places
from HybridVolume.core.analysis.spline_space import check_faces
from HybridVolume.core.recovery import Material, tensor, von_mises
from HybridVolume.errors import InputError

if TYPE_CHECKING:
    from HybridVolume.core.analysis.coupling import CollocationSpace, NitscheSpace
    from HybridVolume.core.analysis.elasticity import Displacement
    from HybridVolume.core.analysis.linear import Solved
    from HybridVolume.core.analysis.modal import Modes
    from HybridVolume.core.analysis.poisson import Solution
    from HybridVolume.core.hybrid import HybridVolume

Where = np.ndarray | Sequence[Sequence[float]] | str | Places
"""Points (m, 3), mm; the name of a CAD face; or places of `points_on` and `find`."""

_LABELS = {
    "displacement": "displacement, mm",
    "stress": "size of the stress, MPa",
    "von_mises": "von Mises stress, MPa",
    "heat_flux": "heat flux, W/mm²",
}

OUTSIDE = 1e-3
"""A point this far outside of a body, as a share of its size, is taken as one on its surface."""


@dataclass(frozen=True, eq=False)
class Result:
    """What all results have.

    Attributes
    ----------
    space : CollocationSpace or NitscheSpace
    volume : HybridVolume or None
        None where the space was given.
    """

    space: CollocationSpace | NitscheSpace
    volume: HybridVolume | None

    @property
    def faces(self) -> tuple[str, ...]:
        """Names of the CAD faces."""
        return self.space.spline.face_names

    @property
    def notes(self) -> tuple[str, ...]:
        """What was done so that every element is valid."""
        return tuple(self.space.notes)

    @cached_property
    def shown(self) -> FieldSpace:
        """The elements that fields are shown on."""
        return FieldSpace(self.space)

    @cached_property
    def _locator(self) -> Locator:
        return Locator(self.shown)

    def find(self, points: Sequence[Sequence[float]] | np.ndarray) -> Places:
        """Places of points, found once for several questions.

        Parameters
        ----------
        points : (m, 3) array
            mm.

        Raises
        ------
        InputError
            The array has another shape, or a point is outside of the body.
        """
        try:
            x = np.asarray(points, dtype=float)
        except (TypeError, ValueError) as error:
            raise InputError(f"these are no points ({error})", remedy="give (m, 3) mm") from error
        x = x[None] if x.shape == (3,) else x
        if x.ndim != 2 or x.shape[1] != 3 or not np.isfinite(x).all():
            raise InputError(
                f"an array of shape {x.shape} holds no points or not finite ones",
                remedy="give (m, 3) mm, or the name of a face",
            )
        found = self._locator.find(x)
        outside = self._locator.outside(x, found, OUTSIDE * self._locator.size)
        if len(outside):
            first = int(outside[0])
            worst = float(found.distance[outside].max())
            raise InputError(
                f"{len(outside)} of {len(x)} points are outside of the body, by up to {worst:.3g}"
                f" mm; the first is {first} at ({', '.join(f'{c:.6g}' for c in x[first])})",
                figure=worst,
                remedy="give points inside",
            )
        return found

    def points_on(self, face: str, steps: int = 4) -> Places:
        """Places on a CAD face: a lattice over each of its knot spans.

        Parameters
        ----------
        face : str
        steps : int
            Parts of each span along both directions.

        Raises
        ------
        InputError
            There is no such face.
        """
        check_faces(self.faces, [face])
        surface = self.space.spline.shell.surface
        patches = [k for k, patch in enumerate(surface.patches) if patch.face == face]
        spans = np.flatnonzero(np.isin(surface.element_patch, patches))
        t = np.linspace(0.0, 1.0, steps + 1)
        lattice = np.stack(np.meshgrid(t, t, [0.0], indexing="ij"), axis=-1).reshape(-1, 3)
        element = np.repeat(spans * self.shown.cells.layers, len(lattice))
        return Places(element, np.tile(lattice, (len(spans), 1)), np.zeros(len(element)))

    def positions(self, where: Where) -> np.ndarray:
        """Points in space, (m, 3), mm, of places or on a face."""
        return self._values(where, self._map)

    @cached_property
    def _map(self) -> Field:
        from HybridVolume.core.analysis.rigid import coefficient_points

        return self.shown.of(coefficient_points(self.space))

    def _values(self, where: Where, field: Field) -> np.ndarray:
        if isinstance(where, str):
            where = self.points_on(where)
        elif not isinstance(where, Places):
            where = self.find(where)
        return self._locator.values(where, field)

    def fields(self) -> dict[str, Field]:
        """Fields by the names under which files have them."""
        raise NotImplementedError

    def save_picture(
        self,
        path: str | os.PathLike,
        what: str = "",
        *,
        factor: float | None = None,
        cut: bool = False,
        title: str = "",
        limits: tuple[float, float] | None = None,
    ) -> None:
        """Draw the body in the colours of a field, without a screen.

        Parameters
        ----------
        path : path
            ``.png``
        what : str
            One of `fields`, by default the last; of vectors the length is shown.
        factor : float, optional
            By what a displacement is multiplied; 0 draws the body undeformed. By default so that
            the deformation is seen.
        cut : bool
            Take the half in front away.
        title : str
        limits : (float, float), optional
            Values at the ends of the colours.

        Raises
        ------
        InputError
            There is no such field.
        SetupError
            pyvista is not installed, or nothing on this system can draw.
        OSError
            The place cannot be written.
        """
        from HybridVolume.exports.solution_picture import solution_scene, write_solution_picture

        fields = self.fields()
        what = what or list(fields)[-1]
        if what not in fields:
            raise InputError(f"there is no field {what!r}", remedy=f"there are {', '.join(fields)}")
        moved = self._moved(what) if factor != 0.0 else None
        scene = solution_scene(
            self.shown,
            fields[what],
            _LABELS.get(what, what.replace("_", " ")),
            displacement=moved,
            factor=factor,
            cut=cut,
            title=title,
            limits=limits,
        )
        write_solution_picture(path, scene)

    def _moved(self, what: str) -> Field | None:
        """The displacement that belongs to the picture of a field."""
        return None

    def save_vtu(self, path: str | os.PathLike) -> None:
        """Write all fields on the exact shell and the curved core, for ParaView.

        Parameters
        ----------
        path : path
            ``.vtu``; see :mod:`HybridVolume.exports.solution_vtu`.

        Raises
        ------
        OSError
            The place cannot be written.
        """
        from HybridVolume.exports.solution_vtu import SolutionFile

        SolutionFile(self.shown).write(path, self.fields())


@dataclass(frozen=True, eq=False)
class ScalarResult(Result):
    """A temperature or another potential.

    Attributes
    ----------
    solution : Solution
        Coefficients of the coupled unknowns.
    conductivity : (float, float)
        Of shell and core, W/(mm K).
    """

    solution: Solution
    conductivity: tuple[float, float]

    @cached_property
    def field(self) -> Field:
        """The field itself, one component."""
        return self.shown.of(self.solution.values)

    @property
    def figures(self) -> Solved | None:
        """How the linear system was solved: unknowns, seconds, memory, residual."""
        return self.solution.figures

    @cached_property
    def flux_field(self) -> Field:
        """Heat flux -k grad u, three components, W/mm²; one value where elements meet."""
        outer, inner = self.conductivity
        return self.shown.derived(
            self.field,
            lambda _, g: -outer * g[..., 0],
            None if outer == inner else lambda _, g: -inner * g[..., 0],
        )

    def at(self, where: Where) -> np.ndarray:
        """Values at points, on a face or at places, (m,).

        Raises
        ------
        InputError
            A point is outside of the body, or there is no such face.
        """
        return self._values(where, self.field)[:, 0]

    def flux(self, where: Where) -> np.ndarray:
        """Heat flux -k grad u, (m, 3), W/mm²; as `at`."""
        return self._values(where, self.flux_field)

    def fields(self) -> dict[str, Field]:
        """``heat_flux`` and ``temperature``."""
        return {"heat_flux": self.flux_field, "temperature": self.field}

    def errors(self, exact: Callable, slope: Callable) -> tuple[float, float]:
        """Errors against an exact solution in L2 and in the H1 seminorm.

        Parameters
        ----------
        exact, slope : callables
            Take (m, 3) points, mm; return (m,) values and (m, 3) gradients.
        """
        return self.solution.errors(exact, slope)

    def to_document(self, doc: Any, label: str = "Temperature", **options: Any) -> Any:
        """Put the result into a document; see :func:`HybridVolume.objects.solution.add_result`."""
        from HybridVolume.objects.solution import add_result

        return add_result(doc, self, label, **options)


@dataclass(frozen=True, eq=False)
class DisplacementResult(Result):
    """Displacement, strain and stress.

    Attributes
    ----------
    solution : Displacement
        Coefficients of the coupled unknowns, mm.
    materials : (Material, Material)
        Of shell and core.
    """

    solution: Displacement
    materials: tuple[Material, Material]

    @property
    def figures(self) -> Solved | None:
        """How the linear system was solved: unknowns, seconds, memory, residual."""
        return self.solution.figures

    @property
    def energy(self) -> float:
        """Strain energy, mJ (N mm)."""
        return self.solution.energy

    @cached_property
    def field(self) -> Field:
        """The displacement, three components, mm."""
        return self.shown.of(self.solution.values)

    @cached_property
    def stress_field(self) -> Field:
        """Stress xx yy zz xy xz yz, MPa; one value where elements of one material meet."""
        return stress_field(self.shown, self.field, self.materials)

    @cached_property
    def strain_field(self) -> Field:
        """Strain xx yy zz xy xz yz (of the tensor); as `stress_field`."""
        outer, inner = self.materials
        return self.shown.derived(
            self.field, lambda _, g: strain(g), None if outer == inner else lambda _, g: strain(g)
        )

    def displacement(self, where: Where) -> np.ndarray:
        """Displacements at points, on a face or at places, (m, 3), mm.

        Raises
        ------
        InputError
            A point is outside of the body, or there is no such face.
        """
        return self._values(where, self.field)

    at = displacement

    def stress(self, where: Where) -> np.ndarray:
        """Stresses xx yy zz xy xz yz, (m, 6), MPa; as `displacement`."""
        return self._values(where, self.stress_field)

    def strain(self, where: Where) -> np.ndarray:
        """Strains xx yy zz xy xz yz, (m, 6), shear as in the tensor; as `displacement`."""
        return self._values(where, self.strain_field)

    def von_mises(self, where: Where) -> np.ndarray:
        """Equivalent stress, (m,), MPa; as `displacement`."""
        return von_mises(self.stress(where))

    def principal(self, where: Where) -> np.ndarray:
        """Principal stresses, largest first, (m, 3), MPa; as `displacement`."""
        return np.linalg.eigvalsh(tensor(self.stress(where)))[:, ::-1]

    def reaction(self, faces: str | Sequence[str]) -> np.ndarray:
        """Force by which the support of one or several CAD faces holds the body, (3,), N.

        Where two supported faces meet, the forces on their common side are in both.

        Raises
        ------
        InputError
            There is no such face.
        """
        names = [faces] if isinstance(faces, str) else list(faces)
        spline = self.space.spline
        check_faces(spline.face_names, names)
        there = np.zeros(spline.columns, dtype=bool)
        for samples in spline.boundary_samples(names, 1):
            there[samples.values.indices] = True
        return self.solution.reactions[spline.outer[there]].sum(axis=0)

    def _moved(self, what: str) -> Field | None:
        return self.field

    def fields(self) -> dict[str, Field]:
        """``displacement``, ``stress`` and ``von_mises``."""
        equivalent = self.shown.mapped(self.stress_field, lambda s: von_mises(s)[:, None])
        return {
            "displacement": self.field,
            "stress": self.stress_field,
            "von_mises": equivalent,
        }

    def errors(self, exact: Callable, slope: Callable) -> tuple[float, float]:
        """Errors against an exact solution in L2 and in the H1 seminorm.

        Parameters
        ----------
        exact, slope : callables
            Take (m, 3) points, mm; return (m, 3) displacements and (m, 3, 3) gradients, of which
            ``[:, c, d]`` is the derivative of component c along d.
        """
        return self.solution.errors(exact, slope)

    def to_document(self, doc: Any, label: str = "Displacement and stress", **options: Any) -> Any:
        """Put the result into a document; see :func:`HybridVolume.objects.solution.add_result`."""
        from HybridVolume.objects.solution import add_result

        return add_result(doc, self, label, **options)


@dataclass(frozen=True, eq=False)
class ModalResult(Result):
    """Natural vibrations.

    Attributes
    ----------
    modes : Modes
        Frequencies and shapes, the slowest first.
    materials : (Material, Material)
    """

    modes: Modes
    materials: tuple[Material, Material]

    @property
    def frequencies(self) -> np.ndarray:
        """Hz, (n,); 0 but for rounding for rigid motions."""
        return self.modes.frequencies

    def shape(self, number: int, largest: float = 1.0) -> Field:
        """A mode's displacement, scaled to a largest coefficient, mm.

        Parameters
        ----------
        number : int
            From 0.
        largest : float
        """
        if not 0 <= number < len(self.frequencies):
            raise InputError(
                f"there is no mode {number}", remedy=f"there are 0 to {len(self.frequencies) - 1}"
            )
        values = self.modes.shapes[number]
        return self.shown.of(values * (largest / np.linalg.norm(values, axis=1).max()))

    def values_of(self, number: int, where: Where, largest: float = 1.0) -> np.ndarray:
        """Displacements of a mode at points, on a face or at places, (m, 3), mm; see `shape`."""
        return self._values(where, self.shape(number, largest))

    def fields(self) -> dict[str, Field]:
        """``mode_0``, ``mode_1``, ..., each with a largest displacement of 1 mm."""
        return {f"mode_{k}": self.shape(k) for k in range(len(self.frequencies))}

    def _moved(self, what: str) -> Field | None:
        return self.shape(int(what.rpartition("_")[2]))

    def to_document(self, doc: Any, number: int, label: str = "", **options: Any) -> Any:
        """Put one mode into a document; see :func:`HybridVolume.objects.solution.add_result`."""
        from HybridVolume.objects.solution import add_result

        label = label or f"Mode {number}: {self.frequencies[number]:.6g} Hz"
        return add_result(doc, self, label, mode=number, **options)


def strain(gradient: np.ndarray) -> np.ndarray:
    """Strains (m, 6) of gradients (m, 3, 3), of which [:, d, c] is the slope of c along d."""
    both = 0.5 * (gradient + np.swapaxes(gradient, 1, 2))
    return both[:, [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def stress_field(
    shown: FieldSpace, displacement: Field, materials: tuple[Material, Material]
) -> Field:
    """Stress xx yy zz xy xz yz of a displacement, MPa, with one value where elements meet."""
    outer, inner = materials
    return shown.derived(
        displacement,
        lambda _, g: outer.stress(strain(g)),
        None if outer == inner else lambda _, g: inner.stress(strain(g)),
    )
