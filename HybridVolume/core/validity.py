# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A certificate that det J > 0 everywhere in every Bézier element, and the scaled Jacobian.

An element is a convex combination of its Bernstein coefficients at every point: if all coefficients
of det J exceed their rounding error, det J > 0 is proved (Johnen, Remacle and Geuzaine, J. Comput.
Phys. 233, 2013). A coefficient at a corner is a value: if it is not positive, the element is proved
invalid. Otherwise the element is halved in all directions and asked again. The coefficients, and
the proof of their rounding errors, are in :mod:`.jacobian`.

det J > 0 is a local statement; :mod:`.intersection` asks whether a surface cuts itself.
"""

from __future__ import annotations

import logging
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import FaultError
from .bezier import BezierElements, bernstein
from .jacobian import (
    EPSILON,
    coefficients_by_products,
    coefficients_by_sampling,
    determinant_nets,
    sampling_error,
    subdivide,
)
from .singular import HALF_CLASSES, class_indices, watched_coefficients, without_excused

log = logging.getLogger(__name__)

VALID_INSIDE = 2
VALID = 1
UNDECIDED = 0
INVALID = -1

# Elements worked on at once: their arrays stay in the processor's cache.
_SAMPLING_CHUNK = 32
_PRODUCTS_CHUNK = 32
_BOX_CHUNK = 64

# Around places where the given surface itself is singular nothing is proved within this share of
# the element: their coefficients are zero only to rounding.
_NEIGHBOURHOOD = 1e-7

# Above this error (relative to the magnitude of the determinant) sampling proves next to nothing.
_SAMPLING_ERROR = 1e-2

# Boxes that an element may have on one level of the subdivision; fewer, to look for a point that
# proves it invalid, once it cannot be proved valid any more. A group of boxes is halved at once.
_BOXES_EACH = 256
_BOXES_LOST = 8
_GROUP_BYTES = 12_000_000


@dataclass(frozen=True)
class Certificate:
    """What was proved about every Bézier element, in the order of the element numbers.

    Attributes
    ----------
    element : (ne,) int array
        Element numbers, ascending.
    patch : (ne,) int array
        Patch of each element.
    status : (ne,) int8 array
        VALID (1): det J > 0 proved on the whole closed element. VALID_INSIDE (2): the same but for
        corners or sides of its outer face where the given surface's own normal is zero, and with
        it det J of every shell. INVALID (-1): det J <= 0 proved at a point, or a weight that is
        not positive, or coordinates that are not finite. UNDECIDED (0): neither.
    min_bernstein : (ne,) array
        Proved lower bound of det J over the product of the mean lengths of the control polygons in
        the three directions (1 for a box; no unit). It is positive if and only if the element is
        VALID, zero where it is VALID_INSIDE; -inf where there is no bound. It is sharp only where
        VALID.
    depth : int
        Number of halvings that the deepest box needed.
    """

    element: np.ndarray
    patch: np.ndarray
    status: np.ndarray
    min_bernstein: np.ndarray
    depth: int = 0

    def __len__(self) -> int:
        return len(self.element)

    @property
    def valid(self) -> int:
        """Number of elements proved valid, those that are VALID_INSIDE among them."""
        return int(np.count_nonzero(self.status >= VALID))

    @property
    def valid_inside(self) -> int:
        """Number of elements proved valid but for singular places of the given surface."""
        return int(np.count_nonzero(self.status == VALID_INSIDE))

    @property
    def undecided(self) -> int:
        """Number of elements neither proved valid nor invalid."""
        return int(np.count_nonzero(self.status == UNDECIDED))

    @property
    def invalid(self) -> int:
        """Number of elements proved invalid."""
        return int(np.count_nonzero(self.status == INVALID))

    @property
    def all_valid(self) -> bool:
        """Whether there are elements and every one is proved valid."""
        return len(self) > 0 and self.valid == len(self)

    @property
    def failed(self) -> np.ndarray:
        """Numbers of the elements that are not proved valid."""
        return self.element[self.status < VALID]

    def merge(self, other: Certificate) -> Certificate:
        """This certificate with the elements of another added; where both know one, the other's."""
        own = ~np.isin(self.element, other.element)
        return _certificate(
            *(
                np.concatenate([getattr(self, name)[own], getattr(other, name)])
                for name in ("element", "patch", "status", "min_bernstein")
            ),
            max(self.depth, other.depth),
        )


def _certificate(element, patch, status, min_bernstein, depth) -> Certificate:
    order = np.argsort(element, kind="stable")
    element = element[order]
    if np.any(element[1:] == element[:-1]):
        raise FaultError("two elements of a certificate have the same number")
    return Certificate(element, patch[order], status[order], min_bernstein[order], depth)


def certify(batches: Iterable[BezierElements], max_depth: int = 7) -> Certificate:
    """Prove det J > 0 (or find a point where it is not) for every element of the batches.

    Parameters
    ----------
    batches : iterable of BezierElements
        Any degrees p, q, r >= 1; mm. Element numbers must differ.
    max_depth : int
        Halvings before an element stays undecided.

    Returns
    -------
    Certificate

    Raises
    ------
    FaultError
        When shapes do not fit the degrees, or element numbers repeat.
    """
    parts, depth = [], 0
    for batch in batches:
        _check(batch)
        status = np.full(len(batch), INVALID, dtype=np.int8)
        lower = np.full(len(batch), -np.inf)
        for members, weights in _families(batch):
            for chunk in np.array_split(members, -(-len(members) // _PRODUCTS_CHUNK)):
                state, bound, used = _certify_chunk(
                    batch.control_points[chunk],
                    None if weights is None else weights[chunk],
                    max_depth,
                    None if batch.singular is None else batch.singular[chunk],
                )
                status[chunk], lower[chunk], depth = state, bound, max(depth, used)
        parts.append((np.asarray(batch.element), np.asarray(batch.patch), status, lower))
    if not parts:
        parts.append((np.zeros(0, int), np.zeros(0, int), np.zeros(0, np.int8), np.zeros(0)))
    result = _certificate(*(np.concatenate(a) for a in zip(*parts, strict=True)), depth)
    log.debug(
        "certificate: %d valid, %d undecided, %d invalid, depth %d",
        *(result.valid, result.undecided, result.invalid, depth),
    )
    return result


def _check(batch: BezierElements) -> None:
    """A batch must be what it says, or every later figure is about something else."""
    shape = (len(batch), *(p + 1 for p in batch.degrees))
    fits = (
        min(batch.degrees) >= 1
        and batch.control_points.shape == (*shape, 3)
        and (batch.weights is None or batch.weights.shape == shape)
        and len(batch.element) == len(batch.patch) == len(batch)
    )
    if not fits:
        raise FaultError(f"a batch of Bézier elements does not have its degrees {batch.degrees}")


def _families(batch: BezierElements) -> list[tuple[np.ndarray, np.ndarray | None]]:
    """Members that are polynomial (weights None) and members that are rational.

    Elements with weights that are not positive or anything that is not finite are in neither.
    """
    axes = tuple(range(1, 4))
    finite = np.isfinite(batch.control_points).all(axis=(*axes, 4))
    # The largest differences must not overflow either.
    finite &= (
        np.abs(np.where(finite[:, None, None, None, None], batch.control_points, 0.0)).max(
            axis=(*axes, 4), initial=0.0
        )
        < 1e300
    )
    if batch.weights is None:
        families = [(np.flatnonzero(finite), None)]
    else:
        lightest, heaviest = batch.weights.min(axis=axes), batch.weights.max(axis=axes)
        usable = finite & (lightest > 0.0) & np.isfinite(heaviest)
        equal = lightest == heaviest
        families = [
            (np.flatnonzero(usable & equal), None),
            (np.flatnonzero(usable & ~equal), batch.weights),
        ]
    return [(members, weights) for members, weights in families if len(members)]


def _certify_chunk(
    points: np.ndarray, weights: np.ndarray | None, max_depth: int, singular: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, int]:
    """Status, scale-free lower bound and depth for a few elements of one degree."""
    count = len(points)
    status = np.zeros(count, dtype=np.int8)
    lower = np.full(count, -np.inf)
    scale = np.ones((2, count))
    depth = 0
    routes = [(coefficients_by_products, _PRODUCTS_CHUNK, max_depth)]
    degrees = tuple(n - 1 for n in points.shape[1:4])
    if sampling_error(degrees, weights is not None) < _SAMPLING_ERROR:
        routes.insert(0, (coefficients_by_sampling, _SAMPLING_CHUNK, min(max_depth, 3)))
    for route, size, limit in routes:
        pending = np.flatnonzero(status == UNDECIDED)
        for part in np.array_split(pending, -(-len(pending) // size)) if len(pending) else []:
            nets = determinant_nets(points[part], None if weights is None else weights[part])
            scale[:, part] = _scales(nets)
            excused = None
            if singular is not None and singular[part].any():
                excused = np.moveaxis(singular[part], 0, -1)
            status[part], lower[part], used = decide(*route(nets), limit, excused)
            depth = max(depth, used)
    with np.errstate(invalid="ignore", over="ignore"):
        lower = lower * np.where(lower > 0.0, scale[0], scale[1])
        lower -= 64 * EPSILON * np.abs(lower)
    lower[np.isnan(lower)] = -np.inf
    # A bound that only the last scaling lost to underflow is no longer a bound: say so.
    status[(status == VALID) & ~(lower > 0.0)] = UNDECIDED
    return status, lower, depth


def _scales(nets) -> np.ndarray:
    """(2, ne): factors from determinant to det J over mean edge product, for + and for - values."""
    lightest, heaviest = nets.weight_range
    with np.errstate(divide="ignore", over="ignore"):
        return 1.0 / (nets.edges * np.stack([heaviest, lightest]) ** 4)


def decide(
    coefficients: np.ndarray,
    bound: np.ndarray,
    max_depth: int = 7,
    excused: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray, int]:
    """Sign of polynomials on the unit cube by their Bernstein coefficients and subdivision.

    Parameters
    ----------
    coefficients : (N1, N2, N3, n) array
        Bernstein coefficients of n polynomials.
    bound : (n,) array
        Proved bound of the coefficients' errors.
    max_depth : int
    excused : (3, 3, n) bool array, optional
        Corners and sides of the face w = 0 where the polynomials may be zero, as
        :attr:`HybridVolume.core.bezier.BezierElements.singular`.

    Returns
    -------
    status : (n,) int8 array
        VALID: positive everywhere; VALID_INSIDE: positive but within 1e-7 of excused places;
        INVALID: not positive somewhere; UNDECIDED: neither was proved.
    lower : (n,) array
        Proved lower bound of each polynomial; positive if and only if VALID; 0 if VALID_INSIDE.
    depth : int
        Halvings used.
    """
    count = coefficients.shape[-1]
    invalid, lost = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
    nearest = np.full(count, np.inf)  # least coefficient of the boxes at excused places
    if excused is not None:
        coefficients, slack = without_excused(coefficients, bound, excused)
        # at a share x of the element away from the places the excused polynomials' sum B is at
        # most (1 - x)^n, so B > c / (c + slack) only where x < slack / (n c)
        fall = min(coefficients.shape[:3]) - 1
    root = watched_coefficients(coefficients, excused).min(axis=(0, 1, 2)) - bound
    lower = np.full(count, np.inf)
    deepest = 0
    stack = [(0, coefficients, bound, np.arange(count), excused)]
    while stack:
        level, coefficients, bound, owner, flags = stack.pop()
        deepest = max(deepest, level)
        watched = watched_coefficients(coefficients, flags)
        least = watched.min(axis=(0, 1, 2)) - bound
        corner = _corners(watched).min(axis=(0, 1, 2))
        if flags is not None:
            beside = flags.any(axis=(0, 1)) & (least > 0.0)
            np.minimum.at(nearest, owner[beside], least[beside])
        invalid[owner[corner + bound <= 0.0]] = True
        # A value at a corner keeps its error for ever: such a box will never be proved positive.
        lost[owner[~(corner > bound)]] = True
        positive = least > 0.0
        np.minimum.at(lower, owner[positive], least[positive])
        active = np.flatnonzero(~positive & ~invalid[owner])
        if level == max_depth:
            kept = active[:0]
        else:
            kept = active[_within_budget(owner[active], least[active], lost)]
        dropped = np.setdiff1d(active, kept, assume_unique=True)
        lost[owner[dropped]] = True
        np.minimum.at(lower, owner[dropped], least[dropped])
        for group in _groups(kept, owner, coefficients[..., 0].nbytes):
            parts = np.array_split(group, -(-len(group) // _BOX_CHUNK))
            halves = [
                _halve(
                    coefficients[..., k],
                    bound[k],
                    owner[k],
                    lower,
                    None if flags is None else flags[..., k],
                    nearest,
                )
                for k in parts
            ]
            coefficients_, bound_, owner_, flags_ = zip(*halves, strict=True)
            if sum(map(len, owner_)):
                stack.append(
                    (
                        level + 1,
                        np.concatenate(coefficients_, axis=-1),
                        np.concatenate(bound_),
                        np.concatenate(owner_),
                        None if flags is None else np.concatenate(flags_, axis=-1),
                    )
                )
            deepest = max(deepest, level + 1)
    status = np.where(invalid, INVALID, np.where(lost, UNDECIDED, VALID)).astype(np.int8)
    lower = np.where(invalid, root, np.maximum(lower, root))
    if excused is not None:
        proved = excused.any(axis=(0, 1)) & (status == VALID)
        inside = proved & (slack <= _NEIGHBOURHOOD * fall * nearest)
        status[proved], lower[proved] = UNDECIDED, -slack[proved]
        status[inside], lower[inside] = VALID_INSIDE, 0.0
    return status, lower, deepest


def _corners(coefficients: np.ndarray) -> np.ndarray:
    """The (2, 2, 2, nb) corner coefficients of boxes: values of the polynomial."""
    n1, n2, n3 = (n - 1 for n in coefficients.shape[:3])
    return coefficients[::n1, ::n2, ::n3]


def _within_budget(owner: np.ndarray, least: np.ndarray, lost: np.ndarray) -> np.ndarray:
    """Positions of the boxes that stay: for each owner its most negative ones, up to its budget."""
    order = np.lexsort((least, owner))
    sorted_owner = owner[order]
    rank = np.arange(len(order)) - np.searchsorted(sorted_owner, sorted_owner)
    return order[rank < np.where(lost[sorted_owner], _BOXES_LOST, _BOXES_EACH)]


def _groups(boxes: np.ndarray, owner: np.ndarray, size: int) -> list[np.ndarray]:
    """Split boxes between owners so that a group stays within the memory meant for it."""
    if not len(boxes):
        return []
    boxes = boxes[np.argsort(owner[boxes], kind="stable")]
    starts = np.flatnonzero(np.diff(owner[boxes], prepend=-1))
    number = np.cumsum(np.diff(starts, append=len(boxes))) * size // _GROUP_BYTES
    cuts = starts[1:][np.diff(number) > 0]
    return np.split(boxes, cuts)


def _halve(
    coefficients: np.ndarray,
    bound: np.ndarray,
    owner: np.ndarray,
    lower: np.ndarray,
    flags: np.ndarray | None,
    nearest: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray | None]:
    """The children of boxes that are not proved positive; for the others bounds are updated."""
    shape = coefficients.shape[:3]
    children, bound = subdivide(coefficients, bound)
    watched, halves = children, None
    if flags is not None:
        # classes of the halves, (a, 3, b, 3, box); the upper half in w has none
        halves = flags[HALF_CLASSES][:, :, HALF_CLASSES]
        mask = halves[:, class_indices(shape[0])][:, :, :, class_indices(shape[1])]
        watched = children.copy()
        watched[:, :, :, :, 0, 0][mask] = np.inf
    least = watched.min(axis=(1, 3, 5)) - bound
    owners = np.broadcast_to(owner, least.shape)
    np.minimum.at(lower, owners[least > 0.0], least[least > 0.0])
    if halves is not None:
        beside = halves.any(axis=(1, 3)) & (least[:, :, 0] > 0.0)
        np.minimum.at(nearest, owners[:, :, 0][beside], least[:, :, 0][beside])
    a, b, c, box = np.nonzero(~(least > 0.0))
    # Advanced indices apart from each other come first in the result: (k, N1, N2, N3).
    open_children = children[a, :, b, :, c, :, box]
    if halves is not None:
        # the children's own flags, those of the lower half in w only
        halves = np.moveaxis(halves[a, :, b, :, box] & (c == 0)[:, None, None], 0, -1)
    return np.moveaxis(open_children.reshape(-1, *shape), 0, -1), bound[box], owner[box], halves


def _sampled_minimum(
    points: np.ndarray, weights: np.ndarray | None, tables: list[dict[int, np.ndarray]]
) -> tuple[np.ndarray, np.ndarray]:
    """Least scaled Jacobian over a grid, and its flat index, for a few elements of one degree."""
    nets = determinant_nets(points, weights)
    values = []
    for a in nets.columns:
        for d in range(3):
            table = tables[d][a.shape[d] - 1]
            a = np.moveaxis(np.tensordot(table, a, axes=(1, d)), 0, d)
        values.append(np.moveaxis(a, 3, 0).reshape(a.shape[3], -1, a.shape[4]))
    if nets.rational:
        h = values[0]
        values = [a[1:] * h[0] - h[1:] * a[0] for a in values[1:]]
    lengths = [np.sqrt(np.einsum("cmn,cmn->mn", a, a)) for a in values]
    size = lengths[0] * lengths[1] * lengths[2]
    det = np.einsum("cmn,cmn->mn", values[0], np.cross(values[1], values[2], axis=0))
    with np.errstate(invalid="ignore", divide="ignore"):
        scaled = np.where(size > 0.0, det / size, 0.0)
    worst = scaled.argmin(axis=0)
    return np.take_along_axis(scaled, worst[None], axis=0)[0], worst


def worst_points(
    batches: Sequence[BezierElements], points: int = 6
) -> tuple[np.ndarray, np.ndarray]:
    """Least scaled Jacobian det J / (|x_u| |x_v| |x_w|) of each element, and where it is.

    Parameters
    ----------
    batches : sequence of BezierElements
    points : int
        Points per direction, equally spaced, ends included; at least 2.

    Returns
    -------
    scaled : (ne,) array
        In [-1, 1], in the order of the element numbers; 0 where a derivative vanishes, -1 for
        elements with coordinates that are not finite or weights that are not positive.
    where : (ne, 3) array
        Parameters (u, v, w) of that point in the element, in [0, 1].
    """
    grid = np.linspace(0.0, 1.0, points)
    elements, found, places = [], [], []
    for batch in batches:
        _check(batch)
        tables = [{degree: bernstein(degree, grid) for degree in (p - 1, p)} for p in batch.degrees]
        scaled, where = np.full(len(batch), -1.0), np.zeros((len(batch), 3))
        for members, weights in _families(batch):
            for chunk in np.array_split(members, -(-len(members) // _SAMPLING_CHUNK)):
                scaled[chunk], worst = _sampled_minimum(
                    batch.control_points[chunk],
                    None if weights is None else weights[chunk],
                    tables,
                )
                where[chunk] = grid[np.stack(np.unravel_index(worst, (points,) * 3), axis=-1)]
        elements.append(np.asarray(batch.element))
        found.append(scaled)
        places.append(where)
    if not elements:
        return np.zeros(0), np.zeros((0, 3))
    order = np.argsort(np.concatenate(elements), kind="stable")
    return np.concatenate(found)[order], np.concatenate(places)[order]


def scaled_jacobian(batches: Sequence[BezierElements], points: int = 6) -> np.ndarray:
    """Least scaled Jacobian of each element over points^3; see :func:`worst_points`.

    Returns
    -------
    (ne,) array
        In the order of the element numbers.
    """
    return worst_points(batches, points)[0]
