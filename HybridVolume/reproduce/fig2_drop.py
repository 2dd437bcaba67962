# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""An elastic disk dropped on a plane: where its elements flip (the paper's Fig. 2).

The same disk as triangles alone, and with one, two and three layers of bicubic elements (C² along
the boundary and through the layers) around triangles, at about equal unknowns. Everything else is
the same for all: material (St. Venant-Kirchhoff: Hooke's law with Green's strain), drop, plane,
steps in time, viscosity.
"""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from HybridVolume.core.analysis.contact import PlaneContact
from HybridVolume.core.analysis.coupling import CollocationSpace
from HybridVolume.core.analysis.hyperelastic import Hyperelastic
from HybridVolume.core.analysis.newmark import Motion, Newmark
from HybridVolume.core.analysis.plane import plane_space, triangles_only
from HybridVolume.core.analysis.plane_curve import PlaneCurve, closed_spline
from HybridVolume.core.analysis.plane_ring import PlaneRing
from HybridVolume.core.recovery import Material
from HybridVolume.errors import FaultError

logger = logging.getLogger(__name__)

DEGREE = 3
"""Of the boundary and of the layers: C² elements, as in the paper's figure."""
COUPLING = "collocation"
"""Of the layers with the triangles: the paper's."""
AGAINST = 0.03
"""Share by which numbers of unknowns may differ."""
CLOSE = 0.01
"""Share that is near enough."""
SHARES = (1.0, 1.05, 0.95, 1.1, 1.15, 0.9, 1.2, 1.25, 0.85, 1.3)
"""Sizes of triangles that are tried, as shares of the edges around them."""
POINTS = 8
"""Gauss points a direction at which the area is measured that is flipped."""
FINE = 8
"""Parts of a span in pictures."""


@dataclass(frozen=True)
class Body:
    """How the disk is made.

    Attributes
    ----------
    name : str
    layers : int
        Of spline elements; 0 for triangles alone.
    depth : float
        Of all layers together, as a share of the radius.
    """

    name: str
    layers: int
    depth: float


BODIES = (
    Body("triangles", 0, 0.0),
    Body("one-layer", 1, 0.15),
    Body("two-layers", 2, 0.30),
    Body("three-layers", 3, 0.45),
)
"""Representations that are compared: growing thickness, as in the paper."""


@dataclass(frozen=True)
class Drop:
    """What happens, the same for all bodies.

    Attributes
    ----------
    young : float
        Young's modulus, MPa.
    unknowns : int
        Of one component, wanted.
    turn : float
        Degrees by which the mesh is turned in the disk.
    radius, height : float
        Of the disk, and of its lowest point above the plane where it is let go, mm.
    poisson : float
    density : float
        t/mm³
    gravity : float
        mm/s²
    viscosity : float
        Time that, times Young's modulus, is the viscosity, s.
    step, duration : float
        Of the motion from the first touch on, s.
    contact : float
        Stiffness of the plane, MPa/mm, as a share of Young's modulus for each mm.
    """

    young: float
    unknowns: int = 240
    turn: float = 0.0
    radius: float = 50.0
    height: float = 50.0
    poisson: float = 0.3
    density: float = 1e-9
    gravity: float = 9810.0
    viscosity: float = 1.5e-3
    step: float = 1e-3
    duration: float = 0.2
    contact: float = 2.0

    @property
    def speed(self) -> float:
        """Of the first touch, mm/s."""
        return float(np.sqrt(2.0 * self.gravity * self.height))

    @property
    def softness(self) -> float:
        """Density times the squared speed, over Young's modulus."""
        return self.density * self.speed**2 / self.young


CALMING, LONG = 10.0, 16.0
"""Times the viscosity, and at most times the step, with which a body then comes to rest."""
FAR = 0.01
"""Share of the radius by which a step may move it then, where steps are longer than before."""
CALM = 1e-3
"""Forces that are left at rest, as a share of the weight."""
CALMING_STEPS = 1500


def circle(radius: float, spans: int, turn: float = 0.0) -> PlaneCurve:
    """A closed C² cubic spline that encloses a disk's area.

    Parameters
    ----------
    radius : float
        mm
    spans : int
        Knot spans all around.
    turn : float
        Degrees.
    """
    angle = 2.0 * np.pi * np.arange(spans) / spans
    flat = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(spans)])
    points = Rotation.from_euler("z", turn, degrees=True).apply(flat)[:, :2]
    area = closed_spline(points, DEGREE).area
    return closed_spline(points * radius * np.sqrt(np.pi / area), DEGREE)


def disk(body: Body, drop: Drop) -> CollocationSpace:
    """The space of a disk with about as many unknowns as wanted.

    As many spans (edges, for triangles alone) as give enough unknowns with triangles inside that
    are as long as the edges around them; the size inside does the rest.

    Raises
    ------
    FaultError
        No space comes near enough.
    """

    def made(spans: int, share: float) -> CollocationSpace:
        edge = 2.0 * np.pi * drop.radius * (1.0 - body.depth) / spans
        curve = circle(drop.radius, spans, drop.turn)
        if not body.layers:
            return triangles_only(curve, share * edge)
        return plane_space(curve, body.depth, body.layers, 1, COUPLING, size=share * edge)

    few, enough = DEGREE + 1, int(max(6.0 * drop.unknowns**0.5, drop.unknowns / 4))
    while enough - few > 1:
        middle = (few + enough) // 2
        if made(middle, 1.0).size < drop.unknowns:
            few = middle
        else:
            enough = middle
    found = None
    for spans, share in ((n, share) for share in SHARES for n in (enough, few)):
        space = made(spans, share)
        off = abs(space.size - drop.unknowns)
        if found is None or off < abs(found.size - drop.unknowns):
            found = space
        if off <= CLOSE * drop.unknowns:
            return space
    if abs(found.size - drop.unknowns) > AGAINST * drop.unknowns:
        raise FaultError(f"{body.name}: {found.size} unknowns instead of {drop.unknowns}")
    return found


@dataclass(frozen=True)
class Flips:
    """What is flipped.

    Attributes
    ----------
    triangles : int
        With det F < 0.
    ring : int
        Spline elements of which det F > 0 is not proved everywhere, by Bernstein coefficients.
    area : float
        Of the undeformed parts with det F < 0, as a share of the disk.
    """

    triangles: int
    ring: int
    area: float

    @property
    def elements(self) -> int:
        """All of them."""
        return self.triangles + self.ring


def flipped(space: CollocationSpace, displacement: np.ndarray) -> Flips:
    """Count what is flipped in a state.

    Parameters
    ----------
    space : CollocationSpace
    displacement : (size, 2) array
        mm
    """
    shell, core = space.parts(displacement)
    ring = deformed_ring(space, displacement)
    folded = 0 if ring is None else int((ring.jacobian_bounds <= 0.0).sum())
    area = total = 0.0
    turned = 0
    for side, values in ((space.spline, shell), (space.tets, core)):
        for s in side.samples(POINTS if side is space.spline else 1):
            slope = np.einsum("eqcl,eld->eqdc", s.gradients, values[s.unknowns])
            against = np.linalg.det(slope + np.eye(2)) <= 0.0
            area += float(s.measure[against].sum())
            total += float(s.measure.sum())
            turned += int(against.any(axis=1).sum()) if side is space.tets else 0
    return Flips(turned, folded, area / total)


def deformed_ring(space: CollocationSpace, displacement: np.ndarray) -> PlaneRing | None:
    """The layers where they have gone, with the same weights; None for triangles alone."""
    ring = space.spline
    if not isinstance(ring, PlaneRing):
        return None
    shell, _ = space.parts(displacement)
    net = ring.homogeneous.copy()
    net[..., :2] += net[..., 2:] * shell.reshape(*net.shape[:2], 2)
    return replace(ring, homogeneous=net)


def dropped(
    body: Body, drop: Drop, told_to: Callable[[float, str], None] | None = None
) -> dict[str, Any]:
    """Let a body fall, and count flipped elements at maximal impact and at rest.

    Parameters
    ----------
    body : Body
    drop : Drop
    told_to : callable, optional
        Gets the share that is done, and a text.

    Returns
    -------
    dict
        ``unknowns``, ``triangles``, ``ring_elements``; ``impact`` and ``rest`` (time, s, flips,
        energies, mJ, and an outline to draw); ``most``, the largest number of elements that are
        flipped at any time; ``energies`` over time; ``drift`` of their sum, as a share of the
        kinetic energy of the first touch.

    Raises
    ------
    FaultError
        The motion cannot be followed, or does not come to rest.
    """
    started = time.process_time()
    space = disk(body, drop)
    ring = space.spline if body.layers else None
    plane = PlaneContact(np.array([0.0, 1.0]), -drop.radius, drop.contact * drop.young)
    count = round(drop.duration / drop.step)
    rule = _rule(_elastic(space, drop), drop, plane, drop.step, rule="conserving")
    start = rule.start([0.0, -drop.speed])
    first = rule.energies(start)
    states, most, iterations = [_row(rule, start)], 0, 0
    impact = start
    for number, motion in enumerate(rule.run(start, count)):
        states.append(_row(rule, motion))
        iterations += motion.iterations
        if states[-1]["elastic"] >= max(row["elastic"] for row in states):
            impact = motion
        most = max(most, states[-1]["flipped"])
        if told_to and number % 20 == 0:
            told_to(number / count, f"{motion.time:.3f} s, {states[-1]['flipped']} flipped")
    totals = np.array([row["total"] for row in states])
    still, left, later = _calmed(space, drop, plane, motion)
    return {
        "body": asdict(body),
        "drop": asdict(drop),
        "softness": drop.softness,
        "unknowns": space.size,
        "triangles": len(space.tets.elements),
        "ring_elements": 0 if ring is None else ring.jacobian_bounds.size,
        "steps": count,
        "iterations": iterations,
        "impact": _state(rule, space, impact),
        "rest": {**_state(rule, space, still), "forces_left": left},
        "most": max(most, later),
        "energies": states,
        "drift": float(np.abs(totals - totals[0]).max() / first.kinetic),
        "seconds_cpu": time.process_time() - started,
    }


def _elastic(space: CollocationSpace, drop: Drop, viscous: float = 1.0) -> Hyperelastic:
    """The body, with a multiple of the viscosity."""
    viscosity = viscous * drop.viscosity * drop.young
    material = Material(drop.young, drop.poisson)
    return Hyperelastic(space, material, drop.density, law="svk", viscosity=viscosity)


def _rule(body: Hyperelastic, drop: Drop, plane: PlaneContact, step: float, **rule: Any) -> Newmark:
    """Steps in time."""
    return Newmark(body, step, gravity=[0.0, -drop.gravity], contacts=[plane], **rule)


def _calmed(
    space: CollocationSpace, drop: Drop, plane: PlaneContact, motion: Motion
) -> tuple[Motion, float, int]:
    """The body at rest, the forces that are left as a share of its weight, and the most flips.

    More viscosity and a rule that damps itself take the energy out; steps grow as it slows down,
    so that none moves it far.
    """
    body = _elastic(space, drop, CALMING)
    began, most, left = motion.time, 0, np.inf
    step, rule = 0.0, None
    for _ in range(CALMING_STEPS):
        fastest = float(np.linalg.norm(motion.velocity, axis=1).max())
        wanted = np.clip(FAR * drop.radius / max(fastest, 1e-12), drop.step, LONG * drop.step)
        doubled = drop.step * 2.0 ** np.floor(np.log2(wanted / drop.step) + 1e-9)
        if doubled != step:
            step = float(doubled)
            rule = _rule(body, drop, plane, step, beta=0.5625, gamma=1.0)
            motion = rule.start(motion.velocity, motion.displacement)
        motion = rule.advance(motion)
        began += step
        u = motion.displacement
        most = max(most, _count(body, u))
        forces = body.forces(u) - rule.load + sum(c.forces(u) for c in rule.contacts)
        left = float(np.linalg.norm(forces) / np.linalg.norm(rule.load))
        if left <= CALM:
            return replace(motion, time=began), left, most
    raise FaultError(
        f"not at rest after {began:.2f} s: {left:.2g} of the weight is not carried",
        figure=left,
        remedy="give the material more viscosity",
    )


def _count(body: Hyperelastic, displacement: np.ndarray) -> int:
    """Elements with det F <= 0 at a quadrature point."""
    return int(sum((side <= 0.0).sum() for side in body.least_volumes(displacement)))


def _row(rule: Newmark, motion: Motion) -> dict[str, float]:
    """Energies, mJ, and the number of flipped elements (by det F at quadrature points)."""
    energies = rule.energies(motion)
    return {
        "time": motion.time,
        **asdict(energies),
        "total": energies.total,
        "flipped": _count(rule.body, motion.displacement),
    }


def _state(rule: Newmark, space: CollocationSpace, motion: Motion) -> dict[str, Any]:
    found = flipped(space, motion.displacement)
    return {
        "time": motion.time,
        **asdict(found),
        "flipped": found.elements,
        "elastic": rule.energies(motion).elastic,
        "kinetic": rule.energies(motion).kinetic,
        "outline": outline(space, motion.displacement),
    }


def outline(space: CollocationSpace, displacement: np.ndarray) -> dict[str, Any]:
    """What a picture shows of a state: triangles, lines between spline elements, what is flipped.

    Returns
    -------
    dict
        ``vertices``, ``triangles``, ``turned`` (numbers of triangles with det F < 0); ``lines``
        along the knots of the layers, and ``folded``: four corners of parts with det F < 0.
    """
    _, core = space.parts(displacement)
    vertices = space.tets.nodes + core
    x = vertices[space.tets.elements]
    turned = np.linalg.det(x[:, 1:] - x[:, :1]) <= 0.0
    lines: list[Any] = []
    folded: list[Any] = []
    ring = deformed_ring(space, displacement)
    if ring is not None:
        lines, folded = _lines(ring), _folded(ring)
    return {
        "vertices": np.round(vertices, 3).tolist(),
        "triangles": space.tets.elements.tolist(),
        "turned": np.flatnonzero(turned).tolist(),
        "lines": lines,
        "folded": folded,
    }


def height(drawn: Mapping[str, Any]) -> float:
    """Height of the body that an outline shows, mm."""
    points = [drawn["vertices"], *drawn["lines"][:1]]
    return float(np.ptp(np.concatenate(points)[:, 1]))


def _at(ring: PlaneRing, u: np.ndarray, w: np.ndarray) -> np.ndarray:
    """Points of a ring of one smooth arc, (m, 2)."""
    nowhere = np.zeros(len(u), dtype=np.int64)
    return ring.basis_at(nowhere, u[:, None], w) @ ring.control_points


def _lines(ring: PlaneRing) -> list[list[list[float]]]:
    """Lines along all knots."""
    around = np.linspace(0.0, 1.0, 1 + FINE * (len(ring.curve.breaks[0]) - 1))
    across = np.linspace(0.0, 1.0, 1 + FINE * ring.layers)
    places = [(around, np.full(len(around), w)) for w in np.linspace(0.0, 1.0, ring.layers + 1)]
    places += [(np.full(len(across), u), across) for u in ring.curve.breaks[0][:-1]]
    return [np.round(_at(ring, u, w), 3).tolist() for u, w in places]


def _folded(ring: PlaneRing) -> list[list[list[float]]]:
    """Cells of a fine grid over the ring that are turned."""
    u = np.linspace(0.0, 1.0, 1 + FINE * (len(ring.curve.breaks[0]) - 1))
    w = np.linspace(0.0, 1.0, 1 + FINE * ring.layers)
    grid = np.stack(np.meshgrid(u, w, indexing="ij"), axis=-1)
    x = _at(ring, grid[..., 0].ravel(), grid[..., 1].ravel()).reshape(grid.shape)
    corners = np.stack([x[:-1, :-1], x[1:, :-1], x[1:, 1:], x[:-1, 1:]], axis=2)
    one, two = corners[:, :, 2] - corners[:, :, 0], corners[:, :, 3] - corners[:, :, 1]
    area = one[..., 0] * two[..., 1] - one[..., 1] * two[..., 0]
    return np.round(corners[area < 0.0], 3).tolist()
