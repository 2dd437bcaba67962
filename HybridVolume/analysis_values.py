# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Values that an analysis is given, on faces and inside: numbers, vectors, functions; checked."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from HybridVolume.core.analysis.spline_space import SplineSpace, check_faces
from HybridVolume.errors import InputError

Value = float | Sequence[float | None] | Callable[[np.ndarray], np.ndarray]
OnFaces = Value | Mapping[str, Value]


def as_function(
    name: str, value: Value, width: int, *, partly: bool = False
) -> Callable[[np.ndarray], np.ndarray]:
    """A value as a function of points whose answers are checked.

    Parameters
    ----------
    name : str
        What it is, for errors.
    value : number, vector or callable
    width : int
        Components; 1 gives (m,) answers.
    partly : bool
        Whether components may be left free (nan, None).
    """
    wanted = "a number" if width == 1 else f"{width} numbers"

    def wrong(what: str) -> InputError:
        return InputError(f"{name}: {what}", remedy=f"give {wanted}, or a function of points")

    def checked(found: np.ndarray) -> np.ndarray:
        missing = np.isnan(found)
        if partly and missing.any():
            # a component is free on the whole face or nowhere
            missing = missing & ~np.broadcast_to(missing.all(axis=0), found.shape)
        if missing.any() or np.isinf(found).any():
            raise wrong("a value is not finite")
        return found

    if callable(value):

        def function(points: np.ndarray) -> np.ndarray:
            shape = (len(points),) if width == 1 else (len(points), width)
            try:
                found = np.asarray(value(points), dtype=float)
            except (TypeError, ValueError, IndexError) as error:
                raise wrong(f"the function fails on (m, 3) points ({error})") from error
            if found.shape != shape:
                raise wrong(f"the function returns shape {found.shape} for {len(points)} points")
            return checked(found)

        return function
    try:
        plain = np.array([np.nan if v is None else v for v in np.atleast_1d(value)], dtype=float)
    except (TypeError, ValueError) as error:
        raise wrong(f"{value!r} is no value") from error
    if partly and plain.shape == (1,):
        plain = np.repeat(plain, width)
    if plain.shape != (width,):
        raise wrong(f"{value!r} has shape {np.shape(value)}")
    if partly and np.isnan(plain).all():
        raise wrong("all components are free")
    plain = checked(plain[None])[0]
    return lambda points: np.broadcast_to(
        plain if width > 1 else plain[0], (len(points), width)[: 1 + (width > 1)]
    ).copy()


class FaceValues:
    """Values on the CAD faces of a space as functions."""

    def __init__(self, spline: SplineSpace, width: int) -> None:
        self.spline, self.width = spline, width

    def _table(self, name: str, values: OnFaces | None) -> dict[str, Value]:
        if values is None:
            return {}
        if not isinstance(values, Mapping):
            return dict.fromkeys(self.spline.face_names, values)
        unknown = [face for face in values if not isinstance(face, str)]
        if unknown:
            raise InputError(
                f"{name}: {unknown[0]!r} is no face", remedy=f"faces have names such as "
                f"{self.spline.face_names[0]}"
            )  # fmt: skip
        check_faces(self.spline.face_names, list(values))
        return dict(values)

    def given(
        self, name: str, values: OnFaces | None, width: int | None = None, *, partly: bool = False
    ) -> dict[str, Callable]:
        """Functions by face; equal values are one function, so that they are projected together."""
        made: dict[Any, Callable] = {}
        found = {}
        for face, value in self._table(name, values).items():
            key = value if callable(value) else repr(value)
            if key not in made:
                made[key] = as_function(
                    f"{name} of {face}", value, self.width if width is None else width,
                    partly=partly,
                )  # fmt: skip
            found[face] = made[key]
        return found

    def pressures(self, values: OnFaces | None) -> dict[str, Callable]:
        """Tractions (points, normals) of pressures."""

        def push(function: Callable) -> Callable:
            return lambda x, n: -function(x)[:, None] * n

        return {face: push(f) for face, f in self.given("pressure", values, 1).items()}

    def tractions(self, values: OnFaces | None) -> dict[str, Callable]:
        """Tractions (points, normals) of vectors."""

        def pull(function: Callable) -> Callable:
            return lambda x, n: function(x)

        return {face: pull(f) for face, f in self.given("traction", values).items()}

    def forces(self, values: Mapping[str, Sequence[float]] | None) -> dict[str, Callable]:
        """Even tractions of total forces."""
        if values is not None and not isinstance(values, Mapping):
            raise InputError("force: no face is named", remedy='give {"Face1": (x, y, z)}')
        found = {}
        for face, value in self._table("force", values).items():
            if callable(value):
                raise InputError(f"force of {face}: a function", remedy="give it as a traction")
            area = sum(s.measure.sum() for s in self.spline.boundary_samples([face]))
            even = as_function(f"force of {face}", value, 3)(np.zeros((1, 3)))[0] / area
            found[face] = lambda x, n, even=even: np.broadcast_to(even, x.shape)
        return found


def added(loads: Sequence[Mapping[str, Callable]]) -> dict[str, Callable]:
    """The sum of the tractions on each face."""
    found: dict[str, list[Callable]] = {}
    for table in loads:
        for face, function in table.items():
            found.setdefault(face, []).append(function)
    return {
        face: (lambda x, n, parts=parts: sum(part(x, n) for part in parts))
        for face, parts in found.items()
    }


def body_forces(
    body_force: Sequence[float] | Callable | None,
    acceleration: Sequence[float] | None,
    density: float | Sequence[float] | None,
) -> tuple[Callable, Callable] | None:
    """Body forces of shell and core."""
    if body_force is None and acceleration is None:
        if density is not None:
            raise InputError("a density alone does nothing", remedy="give an acceleration too")
        return None
    parts: list[list[Callable]] = [[], []]
    if body_force is not None:
        for part in parts:
            part.append(as_function("body_force", body_force, 3))
    if acceleration is not None:
        if density is None:
            raise InputError("an acceleration needs a density", remedy="give it in t/mm³")
        pair = np.atleast_1d(density)
        if pair.shape not in ((1,), (2,)) or not ((pair > 0.0) & (pair < np.inf)).all():
            raise InputError(f"a density of {density!r} t/mm³", remedy="give one above 0, or two")
        if callable(acceleration):
            raise InputError("acceleration: a function", remedy="give it as a body force")
        vector = as_function("acceleration", acceleration, 3)(np.zeros((1, 3)))[0]
        for part, rho in zip(parts, np.broadcast_to(pair, 2), strict=True):
            part.append(lambda x, g=float(rho) * vector: np.broadcast_to(g, x.shape))
    outer, inner = (lambda x, some=part: sum(one(x) for one in some) for part in parts)
    return outer, inner
