# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Local untangling of curved wedges and tets: free nodes move until every Jacobian is positive.

Energy of Garanzha et al. 2021, of the map from the straight element with the same corners; its
barrier is softened until nothing is inverted at the sample points.
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
class _Batch:
    """Elements of one kind, and gradients (ne, n, 3 m) with respect to their target."""

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
    size = float(np.linalg.norm(np.ptp(local, axis=0)))
    batches = [_batch(kind, number[c], local, density) for kind, c in touched if len(c)]
    lengths = [np.ptp(local[b.connectivity], axis=1).max(axis=1) for b in batches]
    unit = float(np.median(np.concatenate(lengths))) if lengths else size
    problem = _Problem(local, number[movable], batches, unit)
    result = nodes.copy()
    result[movable] = problem.solve()
    return result


def _batch(kind: str, connectivity: np.ndarray, nodes: np.ndarray, density: int) -> _Batch:
    """Gradients with respect to the straight element, so that the map is x times gradients."""
    points = bernstein_lattice(kind, density)
    straight = _STRAIGHT[kind]
    corners = nodes[connectivity[:, : reference(straight).corners]]
    target = jacobians(straight, corners, points)
    lengths = np.linalg.norm(target, axis=2)
    volume = np.linalg.det(target) / lengths.prod(axis=2)
    # where the straight element is flat itself, a regular one of the same size is the target
    flat = volume < 0.02
    regular = np.eye(3) * np.cbrt(lengths.prod(axis=2))[..., None, None]
    target = np.where(flat[..., None, None], regular, target)
    gradients = np.einsum("mnd,emdk->enkm", shape_gradients(kind, points), np.linalg.inv(target))
    shape = (len(connectivity), connectivity.shape[1], -1)
    return _Batch(connectivity, np.ascontiguousarray(gradients.reshape(shape)))


class _Problem:
    """Energy of the free nodes' places, in units of an element."""

    def __init__(
        self, nodes: np.ndarray, movable: np.ndarray, batches: list[_Batch], unit: float
    ) -> None:
        self.nodes, self.movable, self.batches, self.unit = nodes.copy(), movable, batches, unit
        self.origin = nodes[movable]
        self.softness = _SOFTEST

    def solve(self) -> np.ndarray:
        """Places of the free nodes, (nf, 3)."""
        place = np.zeros(3 * len(self.movable))
        for _ in range(_ROUNDS):
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
        self.nodes[self.movable] = self.origin + self.unit * place.reshape(-1, 3)

    def _maps(self, batch: _Batch) -> np.ndarray:
        """Jacobians of the maps from the targets, (ne, 3, 3, m)."""
        x = self.nodes[batch.connectivity].transpose(0, 2, 1)
        return (x @ batch.gradients).reshape(len(x), 3, 3, -1)

    def _least(self) -> float:
        """Smallest determinant at the sample points."""
        return min(float(_determinants(self._maps(b))[0].min()) for b in self.batches)

    def energy(self, place: np.ndarray) -> tuple[float, np.ndarray]:
        """Energy and its gradient."""
        self._move(place)
        total, slope = 0.0, np.zeros_like(self.nodes)
        for batch in self.batches:
            a = self._maps(batch)
            det, cofactor = _determinants(a)
            root = np.sqrt(self.softness**2 + det**2)
            below = np.where(det > 0.0, 1.0, root - det)
            chi = np.where(det > 0.0, 0.5 * (det + root), 0.5 * self.softness**2 / below)
            trace = np.einsum("eckm,eckm->em", a, a) / 3.0
            power = chi ** (-2.0 / 3.0)
            size = _VOLUME_SHARE * (1.0 + det**2) / chi
            total += float((trace * power + size).sum())
            # the derivative of chi with respect to det is chi / root
            by_det = 2.0 * _VOLUME_SHARE * det / chi
            by_det -= ((2.0 / 3.0) * trace * power + size) / root
            a *= (2.0 / 3.0) * power[:, None, None]
            cofactor *= by_det[:, None, None]
            a += cofactor
            pull = a.reshape(len(a), 3, -1) @ batch.gradients.transpose(0, 2, 1)
            for axis in range(3):
                slope[:, axis] += np.bincount(
                    batch.connectivity.ravel(), pull[:, axis].ravel(), len(self.nodes)
                )
        return total, self.unit * slope[self.movable].ravel()


def _determinants(a: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Determinants (ne, m) and cofactors (ne, 3, 3, m) of (ne, 3, 3, m) matrices."""
    cofactor = np.empty_like(a)
    for i in range(3):
        j, k = (i + 1) % 3, (i + 2) % 3
        for p in range(3):
            q, r = (p + 1) % 3, (p + 2) % 3
            cofactor[:, i, p] = a[:, j, q] * a[:, k, r] - a[:, j, r] * a[:, k, q]
    return np.einsum("ekm,ekm->em", a[:, 0], cofactor[:, 0]), cofactor
