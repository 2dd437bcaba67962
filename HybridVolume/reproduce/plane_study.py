# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Families of finer and finer spaces in the plane, and the errors on them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from ..core.analysis.assembly import errors
from ..core.analysis.coupling import CollocationSpace, NitscheSpace
from ..core.analysis.elasticity import solve_elasticity
from ..core.analysis.hybrid_space import refined
from ..core.analysis.plane import plane_space, triangles_only
from ..core.analysis.poisson import solve_poisson
from ..errors import FaultError
from .cases import told
from .plane_problems import BODIES, Problem, drum, shear_waves, wave

Space = CollocationSpace | NitscheSpace
MORE = 4
"""Gauss points a direction beyond the degree, with which errors are integrated."""


@dataclass(frozen=True)
class Family:
    """Spaces on one body, each with half the h of the one before.

    Attributes
    ----------
    body : str
    k : {1, 2, 3}
        Degree of the triangles.
    p : int
        Degree of the ring; 0: triangles alone.
    coupling : {"collocation", "nitsche", ""}
    depth : float
        Of the ring.
    layers, spans : int
        Elements through the ring, and parts of each of the body's own spans along it, on the first
        level.
    nodes : float or "greville"
        Corners of triangles on the inner curve, as for `plane_space`.
    levels : int
    anew : bool
        Whether each level is made anew, with triangles and layers about as large as the ring's
        spans are long; all levels are otherwise the first one, cut finer.
    elastic : bool
        Elasticity instead of Poisson's equation.
    """

    body: str
    k: int
    p: int = 0
    coupling: str = ""
    depth: float = 0.0
    layers: int = 1
    spans: int = 4
    nodes: float | str = 1
    levels: int = 5
    anew: bool = False
    elastic: bool = False

    @property
    def name(self) -> str:
        """Of the case."""
        body = f"{self.body}-elastic" if self.elastic else self.body
        if not self.p:
            return f"{body}-triangles-k{self.k}"
        how = f"-anew{self.nodes}" if self.anew else f"-{self.layers}x{self.spans}x{self.nodes}"
        return f"{body}-p{self.p}-k{self.k}-{self.coupling}-depth{self.depth:g}{how}"

    def problem(self) -> Problem:
        """What is solved."""
        curve = BODIES[self.body][0]()
        if self.elastic:
            return shear_waves(curve)
        return drum() if self.body == "disk" else wave(curve)

    def spaces(self) -> Iterator[Space]:
        """All levels, the coarsest first."""
        space = self._made(0)
        for level in range(self.levels):
            if level:
                space = self._made(level) if self.anew else refined(space)
            yield space

    def _made(self, level: int) -> Space:
        curve = BODIES[self.body][0]()
        if self.p > curve.degree:
            curve = curve.elevated(self.p)
        curve = curve.refined(self.spans * 2**level)
        if not self.p:
            return triangles_only(curve, degree=self.k)
        layers = self.layers
        if self.anew:
            # through the ring as long as along it, where it is a disk's
            length = 2.0 * np.pi / len(curve.spans.patch)
            layers = max(1, round(self.depth / length))
        return plane_space(curve, self.depth, layers, self.k, self.coupling, nodes=self.nodes)


def solved(space: Space, problem: Problem) -> Any:
    """The answer: a Solution or a Displacement; values are given on the whole boundary."""
    if problem.components == 1:
        return solve_poisson(space, problem.source, problem.exact)
    from .plane_problems import RUBBER

    fixed = dict.fromkeys(space.spline.face_names, problem.exact)
    return solve_elasticity(space, RUBBER, fixed=fixed, body_force=problem.source)


def measured(space: Space, problem: Problem) -> dict[str, Any]:
    """Errors of the answer, over the elements as they are.

    Returns
    -------
    dict
        ``unknowns`` of all components, ``l2`` and ``h1`` (of the seminorm) over all elements,
        ``ring_l2`` and ``triangles_l2``, ``seconds`` of the processor until it was solved.

    Raises
    ------
    FaultError
        A figure is not finite.
    """
    started = time.process_time()
    answer = solved(space, problem)
    seconds = time.process_time() - started
    many = problem.components
    parts = [part.reshape(-1, many) for part in space.parts(answer.values)]
    squares = np.zeros((2, 2))
    for c in range(many):
        exact, slope = problem.exact, problem.slope
        if many > 1:
            exact = lambda x, c=c: problem.exact(x)[:, c]  # noqa: E731
            slope = lambda x, c=c: problem.slope(x)[:, c]  # noqa: E731
        for row, (own, values) in enumerate(zip((space.spline, space.tets), parts, strict=True)):
            squares[row] += errors(own, values[:, c], exact, slope, own.degree + MORE)
    if not np.isfinite(squares).all():
        raise FaultError("an error is not a number", figure=float(squares.max()))
    both = np.sqrt(squares.sum(axis=0))
    return {
        "unknowns": many * space.size,
        "triangles": len(space.tets.elements),
        "l2": float(both[0]),
        "h1": float(both[1]),
        "ring_l2": float(np.sqrt(squares[0, 0])),
        "triangles_l2": float(np.sqrt(squares[1, 0])),
        "seconds": round(seconds, 2),
    }


def studied(family: Family, tell: Callable[[str], None] | None = None) -> dict[str, Any]:
    """All levels of a family with their rates; a fault ends it and is told.

    Returns
    -------
    dict
        What the family is, ``name``, ``levels``, the last level's figures and rates, and ``error``.
    """
    problem = family.problem()
    rows: list[dict[str, Any]] = []
    error = None
    try:
        for level, space in enumerate(family.spaces()):
            rows.append({"level": level, "h": 0.5**level, **measured(space, problem)})
    except Exception as fault:
        error = told(fault).to_dict()
    for before, row in zip([None, *rows], rows, strict=False):
        for norm in ("l2", "h1"):
            row[f"{norm}_rate"] = before and float(np.log2(before[norm] / row[norm]))
    last = {key: rows[-1][key] if rows else None
            for key in ("unknowns", "l2", "h1", "l2_rate", "h1_rate")}  # fmt: skip
    if tell is not None:
        words = error["message"] if error else f"{last['unknowns']} unknowns, L2 {last['l2']:.2e}"
        tell(f"{family.name}: {words}")
    return {**asdict(family), "name": family.name, **last, "levels": rows, "error": error}


def against(
    case: Mapping[str, Any], alone: Mapping[str, Any], norm: str = "l2"
) -> list[float | None]:
    """Errors over those of triangles alone with as many unknowns, for each level.

    Errors of the triangles are interpolated between their levels, both axes logarithmic; None
    where there were no triangles with so few or so many unknowns.
    """
    n = np.log([row["unknowns"] for row in alone["levels"]])
    e = np.log([row[norm] for row in alone["levels"]])
    found: list[float | None] = []
    for row in case["levels"]:
        here = float(np.log(row["unknowns"]))
        inside = n[0] <= here <= n[-1]
        found.append(float(row[norm] / np.exp(np.interp(here, n, e))) if inside else None)
    return found


def rates(rows: Sequence[Mapping[str, Any]], norm: str) -> list[float]:
    """Rates in h of all levels but the first."""
    return [row[f"{norm}_rate"] for row in rows[1:]]
