# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Motion of elastic bodies in time, implicit: Newmark's rule and the midpoint rule.

A step of either rule is the minimum of an incremental potential,

    P(u) = |u - p|²_M / (2 beta h²) + W(u) + contact(u) - f . u,

with the elastic energy W, loads f, the mass M and a prediction p; so Newton's method with a line
search on P finds it, also where elements flip. Where it does not, the step is halved.

*Newmark*: p = u + h v + h² (1/2 - beta) a at the start, and P has its minimum at the end of the
step. beta = 1/4 and gamma = 1/2 is the trapezoidal rule, of second order and without numerical
damping; a larger gamma damps.
*Midpoint*: p = u + h v / 2 and beta = 1/4; P has its minimum at the middle of the step, and the end
is as far again. Of second order; it keeps linear and angular momentum of bodies that move freely
to rounding, also where they are turned and stretched far.

Neither keeps the energy of large strains and of hard impacts: it can grow there without bound.
*Conserving* (Simo and Tarnow, Z. angew. Math. Phys. 43, 1992): the midpoint rule with the mean
stress of both ends, and with the difference quotient of the contact's energy. Its forces do
exactly the work that changes the energies, so the total energy is kept as well, at any step. It is
no minimum, and is found as a balance of forces.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse

from ...errors import FaultError, InputError
from .boundary import boundary_projection
from .contact import BoundContact, PlaneContact
from .hyperelastic import Hyperelastic
from .linear import factored
from .newton import Increments, Stalled, balanced, minimum
from .svk import Viscous

logger = logging.getLogger(__name__)

RULES = ("newmark", "midpoint", "conserving")

_HALVINGS = 8
"""How often a step may be halved."""


@dataclass(frozen=True)
class Motion:
    """A body at one time.

    Attributes
    ----------
    time : float
        s
    displacement : (size, d) array
        mm
    velocity : (size, d) array
        mm/s
    acceleration : (size, d) array
        mm/s²; but for Newmark's rule only a first guess.
    dissipated : float
        Energy that viscosity has turned into heat so far, mJ.
    iterations : int
        Of Newton's method in the step that ends here.
    """

    time: float
    displacement: np.ndarray
    velocity: np.ndarray
    acceleration: np.ndarray
    dissipated: float = 0.0
    iterations: int = 0


@dataclass(frozen=True)
class Energies:
    """Where the energy of a motion is, mJ.

    Attributes
    ----------
    kinetic, elastic, contact, gravity, dissipated : float
        Gravity is 0 for the undeformed body in its place.
    """

    kinetic: float
    elastic: float
    contact: float
    gravity: float
    dissipated: float

    @property
    def total(self) -> float:
        """Their sum, which exact motion keeps."""
        return self.kinetic + self.elastic + self.contact + self.gravity + self.dissipated


class Newmark:
    """Implicit steps in time of an elastic body.

    Parameters
    ----------
    body : Hyperelastic
    step : float
        s
    gravity : (d,) array, optional
        Acceleration, mm/s²; none by default.
    contacts : sequence of PlaneContact
    fixed : sequence of str
        CAD faces that stay where they are.
    rule : {"newmark", "midpoint", "conserving"}
    beta, gamma : float
        Of Newmark's rule.
    tolerance : float
        Residual that is left, as a share of the largest of its terms.

    Raises
    ------
    InputError
        An argument is out of its range, or there is no such face.
    """

    def __init__(
        self,
        body: Hyperelastic,
        step: float,
        *,
        gravity: Sequence[float] | None = None,
        contacts: Sequence[PlaneContact] = (),
        fixed: Sequence[str] = (),
        rule: str = "newmark",
        beta: float = 0.25,
        gamma: float = 0.5,
        tolerance: float = 1e-9,
    ) -> None:
        if rule not in RULES:
            raise InputError(f"rule {rule!r}", remedy=f"choose one of {', '.join(RULES)}")
        if not 0.0 < step < np.inf:
            raise InputError(f"time step {step} s", remedy="give one above 0")
        if not (0.0 < beta <= 1.0 and 0.5 <= gamma <= 1.0):
            raise InputError(
                f"Newmark's beta {beta} and gamma {gamma}", remedy="choose 1/4 and 1/2"
            )
        d = body.dimension
        self.body = body
        self.step = step
        self.gravity = np.zeros(d) if gravity is None else np.asarray(gravity, dtype=float)
        if self.gravity.shape != (d,) or not np.isfinite(self.gravity).all():
            raise InputError(f"gravity {gravity}", remedy=f"give {d} components, mm/s²")
        self.contacts: list[BoundContact] = [plane.of(body.space) for plane in contacts]
        self.rule = rule
        self.beta = beta if rule == "newmark" else 0.25
        self.gamma = gamma if rule == "newmark" else 0.5
        self.tolerance = tolerance
        self.fixed = np.zeros(0, dtype=np.int64)
        if len(fixed):
            held, _ = boundary_projection(body.space.spline, np.zeros_like, fixed)
            self.fixed = np.asarray(held)
        self.load = body.weights[:, None] * self.gravity
        self._free = np.setdiff1d(np.arange(body.size), self.fixed)
        self._increments: dict[float, Increments] = {}

    def start(
        self,
        velocity: np.ndarray | Sequence[float] | None = None,
        displacement: np.ndarray | None = None,
    ) -> Motion:
        """The body at time 0.

        Parameters
        ----------
        velocity : (size, d) or (d,) array, optional
            mm/s, at rest by default.
        displacement : (size, d) array, optional
            mm

        Raises
        ------
        InputError
            An array has another shape or values that are no numbers.
        """
        shape = (self.body.size, self.body.dimension)
        given = []
        for what, array in (("displacement", displacement), ("velocity", velocity)):
            array = np.zeros(shape) if array is None else np.asarray(array, dtype=float)
            if array.shape not in (shape, shape[1:]) or not np.isfinite(array).all():
                raise InputError(
                    f"{what} of shape {array.shape}", remedy=f"give finite values, {shape}"
                )
            given.append(np.array(np.broadcast_to(array, shape)))
            given[-1][self.fixed] = 0.0
        motion = Motion(0.0, *given, np.zeros(shape))
        if self.rule != "newmark":
            return motion
        free = self._free
        acceleration = np.zeros(shape)
        inertia = factored(self.body.mass[free][:, free])
        acceleration[free] = inertia.solve(-self._forces(given[0])[free])
        return replace(motion, acceleration=acceleration)

    def advance(self, motion: Motion) -> Motion:
        """The body one step later.

        Raises
        ------
        FaultError
            Newton's method finds no minimum, however often the step is halved.
        """
        return self._advance(motion, self.step, 0)

    def run(self, motion: Motion, steps: int) -> Iterator[Motion]:
        """The body after each of some steps."""
        for _ in range(steps):
            motion = self.advance(motion)
            yield motion

    def energies(self, motion: Motion) -> Energies:
        """Where the energy is."""
        u, v = motion.displacement, motion.velocity
        return Energies(
            0.5 * float((v * (self.body.mass @ v)).sum()),
            self.body.energy(u),
            float(sum(contact.energy(u) for contact in self.contacts)),
            -float((self.load * u).sum()),
            motion.dissipated,
        )

    def momentum(self, motion: Motion) -> tuple[np.ndarray, np.ndarray]:
        """Linear momentum, t mm/s, (d,), and angular momentum about the origin, t mm²/s.

        The latter has 3 components, in the plane 1.
        """
        at = self.body.reference + motion.displacement
        flow = self.body.mass @ motion.velocity
        pairs = [(1, 2), (2, 0), (0, 1)] if self.body.dimension == 3 else [(0, 1)]
        angular = [at[:, i] @ flow[:, k] - at[:, k] @ flow[:, i] for i, k in pairs]
        return flow.sum(axis=0), np.array(angular)

    def _forces(self, u: np.ndarray, viscous: Viscous | None = None) -> np.ndarray:
        """Forces that are not of inertia, (size, d): what they push against."""
        total = self.body.forces(u, viscous) - self.load
        for contact in self.contacts:
            total += contact.forces(u)
        return total

    def _advance(self, motion: Motion, step: float, depth: int) -> Motion:
        try:
            return self._once(motion, step)
        except Stalled as stalled:
            if depth == _HALVINGS:
                raise FaultError(
                    f"the motion at {motion.time:.4g} s cannot be followed: {stalled}, with steps"
                    f" of {step:.2g} s",
                    figure=stalled.residual,
                    remedy="make the time step or the contact's stiffness smaller",
                ) from stalled
            logger.info("step at %.4g s halved to %.2g s: %s", motion.time, 0.5 * step, stalled)
        middle = self._advance(motion, 0.5 * step, depth + 1)
        end = self._advance(middle, 0.5 * step, depth + 1)
        return replace(end, iterations=middle.iterations + end.iterations)

    def _once(self, motion: Motion, step: float) -> Motion:
        """One step of a rule."""
        if self.rule == "conserving":
            return self._kept(motion, step)
        u, v, a = motion.displacement, motion.velocity, motion.acceleration
        midpoint = self.rule == "midpoint"
        predicted = u + 0.5 * step * v if midpoint else u + step * v
        if not midpoint:
            predicted = predicted + step**2 * (0.5 - self.beta) * a
        viscous = None
        if any(self.body.viscosity):
            viscous = Viscous(u, 0.5 * step if midpoint else step)
        potential = _Potential(self, predicted, 1.0 / (self.beta * step**2), viscous)
        found, iterations = minimum(
            potential, predicted, self._solver(step), self._free, self.tolerance
        )
        push = potential.inertia * (found - predicted)
        dissipated = motion.dissipated
        if viscous is not None:
            lost = self.body.dissipated(u, found, viscous.step)
            dissipated += 2.0 * lost if midpoint else lost
        if midpoint:
            return Motion(
                motion.time + step,
                2.0 * found - u,
                v + step * push,
                push,
                dissipated,
                iterations,
            )
        return Motion(
            motion.time + step,
            found,
            v + step * ((1.0 - self.gamma) * a + self.gamma * push),
            push,
            dissipated,
            iterations,
        )

    def _kept(self, motion: Motion, step: float) -> Motion:
        """One step that keeps the energy."""
        u, v = motion.displacement, motion.velocity
        forces = _Conserving(self, motion, step)
        near = u + step * v + 0.5 * step**2 * motion.acceleration
        found, iterations = balanced(forces, near, self._solver(step), self._free, self.tolerance)
        after = 2.0 / step * (found - u) - v
        lost = self.body.dissipated(u, found, step) if any(self.body.viscosity) else 0.0
        return Motion(
            motion.time + step,
            found,
            after,
            (after - v) / step,
            motion.dissipated + lost,
            iterations,
        )

    def _solver(self, step: float) -> Increments:
        """Systems of a step; steps that are halved have others."""
        if step not in self._increments:
            body = self.body
            near = body.mass / (self.beta * step**2) + body.conduction_like()
            self._increments[step] = Increments(near, self._free, body.dimension)
        return self._increments[step]


class _Potential:
    """The incremental potential of one step."""

    def __init__(
        self, rule: Newmark, predicted: np.ndarray, inertia: float, viscous: Viscous | None
    ) -> None:
        self.rule = rule
        self.predicted = predicted
        self.inertia = inertia
        self.viscous = viscous

    def value(self, u: np.ndarray) -> tuple[float, float]:
        """P, and the sum of the sizes of its terms, mJ."""
        rule = self.rule
        change = u - self.predicted
        terms = [
            0.5 * self.inertia * float((change * (rule.body.mass @ change)).sum()),
            rule.body.energy(u, self.viscous),
            *(contact.energy(u) for contact in rule.contacts),
            -float((rule.load * u).sum()),
        ]
        return sum(terms), sum(abs(term) for term in terms)

    def slope(self, u: np.ndarray) -> tuple[np.ndarray, float]:
        """Derivative of P, (size, d), and the largest norm of its terms, N."""
        rule = self.rule
        terms = [
            self.inertia * (rule.body.mass @ (u - self.predicted)),
            rule.body.forces(u, self.viscous),
            *(contact.forces(u) for contact in rule.contacts),
            -rule.load,
        ]
        return sum(terms), max(float(np.linalg.norm(term)) for term in terms)

    def tangent(self, u: np.ndarray, projected: bool) -> sparse.csr_matrix:
        """Second derivative of P, (d size, d size)."""
        body = self.rule.body
        total = sparse.kron(sparse.identity(body.dimension), self.inertia * body.mass, "csr")
        total = total + body.tangent(u, self.viscous, projected=projected)
        for contact in self.rule.contacts:
            total = total + contact.tangent(u)
        return total.tocsr()


class _Conserving:
    """Forces of one step whose work is the change of the energies."""

    def __init__(self, rule: Newmark, start: Motion, step: float) -> None:
        self.rule = rule
        self.before = start.displacement
        self.predicted = start.displacement + step * start.velocity
        self.step = step

    def slope(self, u: np.ndarray) -> tuple[np.ndarray, float]:
        """Sum of the forces, (size, d), and the largest norm of its terms, N."""
        rule = self.rule
        terms = [
            2.0 / self.step**2 * (rule.body.mass @ (u - self.predicted)),
            rule.body.forces_between(self.before, u, self.step),
            *(contact.forces_between(self.before, u) for contact in rule.contacts),
            -rule.load,
        ]
        return sum(terms), max(float(np.linalg.norm(term)) for term in terms)

    def tangent(self, u: np.ndarray, projected: bool) -> sparse.csr_matrix:
        """Near their derivative, (d size, d size)."""
        body = self.rule.body
        inertia = 2.0 / self.step**2 * body.mass
        total = sparse.kron(sparse.identity(body.dimension), inertia, "csr")
        total = total + body.tangent_between(self.before, u, self.step, projected=projected)
        for contact in self.rule.contacts:
            total = total + contact.tangent_between(self.before, u)
        return total.tocsr()
