# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Local untangling of curved elements: free nodes move until every Jacobian is positive.

Energy of Garanzha et al. 2021, of the map from the straight element with the same corners; its
barrier is softened until nothing is inverted at the sample points. Elements may be curved tets and
wedges in space, or triangles in the plane.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from .element_jacobians import bernstein_lattice
from .elements import jacobians, reference, shape_gradients

_STRAIGHT = {"tet10": "tet4", "penta15": "penta6"}
_VOLUME_SHARE = 0.05
_SOFTEST = 1e-3
_STEPS = 30
_ROUNDS = 6


@dataclass(frozen=True, eq=False)
class Batch:
    """Elements of one kind, and gradients (ne, n, d m) with respect to their target.

    Gradients are those of n shape functions at m sample points.
    """

    connectivity: np.ndarray
    gradients: np.ndarray


def untangle(
    nodes: np.ndarray, elements: list[tuple[str, np.ndarray]], free: np.ndarray, density: int = 4
) -> np.ndarray:
    """Move free nodes so that the elements around them become valid.

    Parameters
    ----------
    nodes : (n, 3) array
        mm
    elements : list of (kind, connectivity)
        "tet10" and "penta15"; elements without a free node do not matter.
    free : (n,) bool array
    density : int
        Sample points along an edge of an element, less one.

    Returns
    -------
    (n, 3) array
        Whether all elements are valid is for the caller to prove.
    """
    movable = np.flatnonzero(free)
    touched = [(kind, c[free[c].any(axis=1)]) for kind, c in elements]
    used = np.unique(np.concatenate([c.ravel() for _, c in touched]))
    number = np.full(len(nodes), -1)
    number[used] = np.arange(len(used))
    local = nodes[used]
    batches = [_batch(kind, number[c], local, density) for kind, c in touched if len(c)]
    result = nodes.copy()
    result[movable] = relaxed(local, number[movable], batches)
    return result


def relaxed(
    nodes: np.ndarray, movable: np.ndarray, batches: list[Batch], rounds: int = _ROUNDS
) -> np.ndarray:
    """Places of least energy of movable nodes.

    Parameters
    ----------
    nodes : (n, d) array
        mm
    movable : (k,) int array
    batches : list of Batch
    rounds : int
        How often the barrier is softened anew while elements are inverted.

    Returns
    -------
    (k, d) array
    """
    lengths = [np.ptp(nodes[b.connectivity], axis=1).max(axis=1) for b in batches]
    size = float(np.linalg.norm(np.ptp(nodes, axis=0)))
    unit = float(np.median(np.concatenate(lengths))) if lengths else size
    return _Problem(nodes, movable, batches, unit).solve(rounds)


def _batch(kind: str, connectivity: np.ndarray, nodes: np.ndarray, density: int) -> Batch:
    """Gradients with respect to the straight element."""
    points = bernstein_lattice(kind, density)
    straight = _STRAIGHT[kind]
    corners = nodes[connectivity[:, : reference(straight).corners]]
    target = jacobians(straight, corners, points)
    return batch_towards(connectivity, shape_gradients(kind, points), target)


def batch_towards(connectivity: np.ndarray, slopes: np.ndarray, target: np.ndarray) -> Batch:
    """Elements with the maps that they should have, so that the map is x times gradients.

    Parameters
    ----------
    connectivity : (ne, n) int array
    slopes : (m, n, d) array
        Derivatives of the shape functions at m points of the reference element.
    target : (ne, m or 1, d, d) array
        Jacobian matrices dx/dxi that are wanted there. Where one is flat, a regular one of the
        same size is wanted instead.
    """
    dim = target.shape[-1]
    lengths = np.linalg.norm(target, axis=2)
    volume = np.linalg.det(target) / lengths.prod(axis=2)
    flat = volume < 0.02
    regular = np.eye(dim) * (lengths.prod(axis=2) ** (1.0 / dim))[..., None, None]
    target = np.where(flat[..., None, None], regular, target)
    inverse = np.broadcast_to(np.linalg.inv(target), (len(target), len(slopes), dim, dim))
    gradients = np.einsum("mnd,emdk->enkm", slopes, inverse)
    shape = (len(connectivity), connectivity.shape[1], -1)
    return Batch(connectivity, np.ascontiguousarray(gradients.reshape(shape)))


class _Problem:
    """Energy of the free nodes' places, in units of an element."""

    def __init__(
        self, nodes: np.ndarray, movable: np.ndarray, batches: list[Batch], unit: float
    ) -> None:
        self.nodes, self.movable, self.batches, self.unit = nodes.copy(), movable, batches, unit
        self.origin = nodes[movable]
        self.softness = _SOFTEST

    def solve(self, rounds: int) -> np.ndarray:
        """Places of the free nodes, (nf, d)."""
        place = np.zeros(self.origin.size)
        for _ in range(rounds):
            self._move(place)
            least = self._least()
            if least < 0.02:
                self.softness = max(_SOFTEST, 0.5 * (0.02 - least))
            else:
                self.softness = _SOFTEST
            found = minimize(
                self.energy,
                place,
                jac=True,
                method="L-BFGS-B",
                options={"maxiter": _STEPS, "maxcor": 12},
            )
            place = found.x
            if least >= 0.02:
                break
        self._move(place)
        return self.nodes[self.movable]

    def _move(self, place: np.ndarray) -> None:
        self.nodes[self.movable] = self.origin + self.unit * place.reshape(self.origin.shape)

    def _maps(self, batch: Batch) -> np.ndarray:
        """Jacobians of the maps from the targets, (ne, d, d, m)."""
        x = self.nodes[batch.connectivity].transpose(0, 2, 1)
        return (x @ batch.gradients).reshape(len(x), x.shape[1], x.shape[1], -1)

    def _least(self) -> float:
        """Smallest determinant at the sample points."""
        return min(float(_determinants(self._maps(b))[0].min()) for b in self.batches)

    def energy(self, place: np.ndarray) -> tuple[float, np.ndarray]:
        """Energy and its gradient."""
        self._move(place)
        total, slope = 0.0, np.zeros_like(self.nodes)
        dim = self.nodes.shape[1]
        for batch in self.batches:
            a = self._maps(batch)
            det, cofactor = _determinants(a)
            root = np.sqrt(self.softness**2 + det**2)
            below = np.where(det > 0.0, 1.0, root - det)
            chi = np.where(det > 0.0, 0.5 * (det + root), 0.5 * self.softness**2 / below)
            trace = np.einsum("eckm,eckm->em", a, a) / dim
            power = chi ** (-2.0 / dim)
            size = _VOLUME_SHARE * (1.0 + det**2) / chi
            total += float((trace * power + size).sum())
            # the derivative of chi with respect to det is chi / root
            by_det = 2.0 * _VOLUME_SHARE * det / chi
            by_det -= ((2.0 / dim) * trace * power + size) / root
            a *= (2.0 / dim) * power[:, None, None]
            cofactor *= by_det[:, None, None]
            a += cofactor
            pull = a.reshape(len(a), dim, -1) @ batch.gradients.transpose(0, 2, 1)
            for axis in range(dim):
                slope[:, axis] += np.bincount(
                    batch.connectivity.ravel(), pull[:, axis].ravel(), len(self.nodes)
                )
        return total, self.unit * slope[self.movable].ravel()


def _determinants(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Determinants (ne, m) and cofactors (ne, d, d, m) of (ne, d, d, m) matrices."""
    cofactor = np.empty_like(a)
    if a.shape[1] == 2:
        cofactor[:, 0] = np.stack([a[:, 1, 1], -a[:, 1, 0]], axis=1)
        cofactor[:, 1] = np.stack([-a[:, 0, 1], a[:, 0, 0]], axis=1)
        return np.einsum("ekm,ekm->em", a[:, 0], cofactor[:, 0]), cofactor
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for p in range(3):
            q, r = (p + 1) % 3, (p + 2) % 3
            cofactor[:, i, p] = a[:, j, q] * a[:, k, r] - a[:, j, r] * a[:, k, q]
    return np.einsum("ekm,ekm->em", a[:, 0], cofactor[:, 0]), cofactor
