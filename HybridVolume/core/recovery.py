# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Strain and stress at the nodes, from the displacements.

CalculiX extrapolates the stress from points inside the elements to the boundary, where stress
counts, and loses most of the accuracy of a 15-node wedge by that. Here

- inside, the strain is a polynomial through the most accurate points of all elements around a node;
- on the boundary, the strain along the surface is the derivative of the surface's displacement,
  and the stress across it is the face's traction, which the forces on the nodes tell exactly where
  the load is simple; Hooke's law gives the rest.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ..errors import InputError
from .boundary_surface import Boundary, BoundarySurface, free_facets
from .elements import reference
from .nodal_forces import face_loads, nodal_forces, without_body_force
from .patch_recovery import extrapolated, gradient_at, mean_at_nodes, smooth_inside, strain_of

COMPONENTS = ("xx", "yy", "zz", "xy", "xz", "yz")
"""Order of the components of strain and stress; shear strains are those of the tensor."""

_WEAK = 0.05
"""Weight of the elements' strain on the boundary against loads and the surface's displacement."""
_WEAKER = 0.01
"""The same where the load of a face is known."""
_EDGE, _SHARP = 0.1, 25.0
"""Weight of a surface's one-sided displacement at edges between known loads, which say nearly all;
and degrees between the normals there."""
_UNSURE = 0.02
"""Weight of the surface's displacement on faces whose load is not known."""
_FAINT = 1e-2
"""Least stress of a face to compare its load with, as a share of the whole boundary's."""


@dataclass(frozen=True)
class Material:
    """An isotropic linear elastic material.

    Attributes
    ----------
    young : float
        Young's modulus, MPa.
    poisson : float
        Poisson's ratio, in (-1, .5).

    Raises
    ------
    InputError
        A value is out of its range.
    """

    young: float
    poisson: float

    def __post_init__(self) -> None:
        if not 0.0 < self.young < np.inf:
            raise InputError(
                f"Young's modulus is {self.young:g} MPa", remedy="give the material one above 0"
            )
        if not -1.0 < self.poisson < 0.5:
            raise InputError(
                f"Poisson's ratio is {self.poisson:g}", remedy="give the material one below 0.5"
            )

    @property
    def shear(self) -> float:
        """Shear modulus, MPa."""
        return self.young / (2.0 * (1.0 + self.poisson))

    @property
    def lame(self) -> float:
        """Lamé's first constant, MPa."""
        return self.young * self.poisson / ((1.0 + self.poisson) * (1.0 - 2.0 * self.poisson))

    def stress(self, strain: np.ndarray) -> np.ndarray:
        """Stress of a strain, both (..., 6) in the order of `COMPONENTS`, MPa."""
        stress = 2.0 * self.shear * np.asarray(strain, dtype=float)
        stress[..., :3] += self.lame * np.sum(strain[..., :3], axis=-1, keepdims=True)
        return stress


@dataclass(frozen=True)
class NodalStress:
    """Strain and stress at nodes of one material.

    Attributes
    ----------
    nodes : (m,) int array
        Numbers of the nodes, sorted.
    strain, stress : (m, 6) array
        In the order of `COMPONENTS`; stress in MPa.
    loads : tuple of (int, str)
        Number and load of each smooth face of the boundary, in the order of the numbers; a face
        that sharp edges cut has several. See `HybridVolume.core.nodal_forces.FaceLoads`.
    """

    nodes: np.ndarray
    strain: np.ndarray
    stress: np.ndarray
    loads: tuple[tuple[int, str], ...] = ()

    @property
    def von_mises(self) -> np.ndarray:
        """Equivalent stress, (m,), MPa."""
        return von_mises(self.stress)

    @property
    def principal(self) -> np.ndarray:
        """Principal stresses, largest first, (m, 3), MPa."""
        return np.linalg.eigvalsh(tensor(self.stress))[:, ::-1]


def tensor(components: np.ndarray) -> np.ndarray:
    """Symmetric tensors (m, 3, 3) of (m, 6) components."""
    return np.asarray(components)[:, [0, 3, 4, 3, 1, 5, 4, 5, 2]].reshape(-1, 3, 3)


def von_mises(stress: np.ndarray) -> np.ndarray:
    """Equivalent stress of (m, 6) components, (m,)."""
    normal, shear = stress[:, :3], stress[:, 3:]
    deviator = normal - normal.mean(axis=1, keepdims=True)
    return np.sqrt(1.5 * np.sum(deviator**2, axis=1) + 3.0 * np.sum(shear**2, axis=1))


@dataclass(frozen=True)
class BoundaryStress:
    """Stress at boundary nodes as their surface sees it, MPa.

    Attributes
    ----------
    normal, shear : (m,) arrays
        Along the normal (pressure is negative), and the size of what acts across it.
    tangential : (m, 2) array
        Largest and smallest normal stress in directions along the surface.
    """

    normal: np.ndarray
    shear: np.ndarray
    tangential: np.ndarray


def in_frame(stress: np.ndarray, normal: np.ndarray) -> BoundaryStress:
    """Stress (m, 6) in the frames of unit normals (m, 3)."""
    full = tensor(stress)
    traction = np.einsum("mij,mj->mi", full, normal)
    along = np.sum(traction * normal, axis=1)
    shear = np.linalg.norm(traction - along[:, None] * normal, axis=1)
    least = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    first = np.cross(normal, least)
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    frame = np.stack([first, np.cross(normal, first)], axis=1)
    plane = np.einsum("mai,mij,mbj->mab", frame, full, frame)
    return BoundaryStress(along, shear, np.linalg.eigvalsh(plane)[:, ::-1])


def element_strain(
    kind: str, nodes: np.ndarray, connectivity: np.ndarray, displacement: np.ndarray
) -> np.ndarray:
    """Strain of every element at each of its nodes.

    Parameters
    ----------
    kind : str
        Of `HybridVolume.core.elements`, e.g. ``"penta15"``.
    nodes, displacement : (n, 3) arrays
        mm.
    connectivity : (ne, k) int array

    Returns
    -------
    (ne, k, 6) array
    """
    places = reference(kind).nodes
    return strain_of(gradient_at(kind, nodes, connectivity, displacement, places))


def averaged(
    nodes: np.ndarray,
    elements: Sequence[tuple[str, np.ndarray]],
    displacement: np.ndarray,
    material: Material,
) -> NodalStress:
    """Mean of the elements' own strains at each node, without any fit: to compare with.

    Parameters and result are those of `recover`.
    """
    nodes, displacement, used = _checked(nodes, elements, displacement)
    parts = [(c, element_strain(kind, nodes, c, displacement)) for kind, c in elements]
    strain = mean_at_nodes(len(nodes), parts)[used]
    return NodalStress(used, strain, material.stress(strain))


def recover(
    nodes: np.ndarray,
    elements: Sequence[tuple[str, np.ndarray]],
    displacement: np.ndarray,
    material: Material,
    *,
    boundary: Boundary | None = None,
) -> NodalStress:
    """Strain and stress at the nodes of all elements of one material.

    Parameters
    ----------
    nodes, displacement : (n, 3) arrays
        mm; displacements of a static, linear analysis.
    elements : sequence of (str, (ne, k) int array)
        Kinds and connectivities.
    material : Material
    boundary : Boundary, optional
        Triangles of the outer boundary with their CAD faces and, if known, exact normals; else the
        free faces of the elements, one face up to each sharp edge.

    Returns
    -------
    NodalStress

    Raises
    ------
    InputError
        There are displacements for another number of nodes, or some are not finite.
    """
    nodes, displacement, used = _checked(nodes, elements, displacement)
    if not len(used):
        return NodalStress(used, np.zeros((0, 6)), np.zeros((0, 6)))
    free, others = free_facets(elements)
    if boundary is None:
        boundary = Boundary(free)
    boundary = _within(boundary, free, others)
    outside = np.zeros(len(nodes), dtype=bool)
    outside[free] = outside[others] = True
    rough = extrapolated(nodes, elements, displacement)
    strain = smooth_inside(nodes, elements, displacement, strain_of(rough), outside)
    found: tuple[tuple[int, str], ...] = ()
    if len(boundary.triangles):
        strain, found = _on_boundary(
            nodes, elements, displacement, material, strain, rough, boundary, outside
        )
    return NodalStress(used, strain[used], material.stress(strain[used]), found)


def _checked(
    nodes: np.ndarray, elements: Sequence[tuple[str, np.ndarray]], displacement: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Nodes about their middle and displacements as arrays, and the nodes in use, sorted."""
    nodes, displacement = np.asarray(nodes, dtype=float), np.asarray(displacement, dtype=float)
    if displacement.shape != nodes.shape:
        raise InputError(
            f"{len(displacement)} displacements do not belong to {len(nodes)} nodes",
            remedy="take the result of this mesh",
        )
    used = [np.unique(connectivity) for _, connectivity in elements]
    used = np.unique(np.concatenate([np.zeros(0, dtype=int), *used]))
    if not np.isfinite(displacement[used]).all():
        raise InputError(
            "some displacements are not finite numbers",
            figure=float(np.count_nonzero(~np.isfinite(displacement[used]).all(axis=1))),
            remedy="look at the solver's messages and at the supports",
        )
    # far from the origin digits of the differences would be lost
    middle = nodes[used].mean(axis=0) if len(used) else 0.0
    return nodes - middle, displacement, used


def _within(boundary: Boundary, free: np.ndarray, others: np.ndarray) -> Boundary:
    """Only the triangles of a boundary that are free faces of the elements at hand.

    Other free faces, between two materials, have no load: their nodes are set aside.
    """
    key = np.sort(np.asarray(boundary.triangles)[:, :3], axis=1)
    own = np.sort(free[:, :3], axis=1)
    size = 1 + max(int(key.max(initial=0)), int(own.max(initial=0)))

    def one(rows: np.ndarray) -> np.ndarray:
        return (rows[:, 0] * size + rows[:, 1]) * size + rows[:, 2]

    kept = np.isin(one(key), one(own))
    apart = free[~np.isin(one(own), one(key))]
    return Boundary(
        np.asarray(boundary.triangles)[kept],
        None if boundary.face is None else np.asarray(boundary.face)[kept],
        None if boundary.normals is None else np.asarray(boundary.normals)[kept],
        np.union1d(np.union1d(others, boundary.others), apart).astype(int),
        None if boundary.pressure is None else np.asarray(boundary.pressure)[kept],
    )


def _on_boundary(
    nodes: np.ndarray,
    elements: Sequence[tuple[str, np.ndarray]],
    displacement: np.ndarray,
    material: Material,
    strain: np.ndarray,
    rough: np.ndarray,
    boundary: Boundary,
    outside: np.ndarray,
) -> tuple[np.ndarray, tuple[tuple[int, str], ...]]:
    """Strain at the nodes, on the boundary with loads and the surface's displacement."""
    surface = BoundarySurface(nodes, boundary)
    if boundary.face is not None:
        surface.join(boundary)
    forces = nodal_forces(nodes, elements, displacement, material.stress)
    inside = np.flatnonzero((forces.weight != 0.0) & ~outside)
    force = without_body_force(forces, inside)
    digits = rounding(displacement)
    noise = nodal_forces(
        nodes, elements, np.random.default_rng(0).uniform(-1.0, 1.0, nodes.shape) * digits,
        material.stress,
    ).force  # fmt: skip
    noise = np.linalg.norm(noise, axis=1)
    size = np.sum(tensor(material.stress(strain[surface.point_node])) ** 2, axis=(1, 2))
    count = np.bincount(surface.point_face, minlength=surface.faces)
    level = np.sqrt(np.bincount(surface.point_face, size, minlength=surface.faces) / count)
    level = np.maximum(level, _FAINT * np.sqrt(size.mean()))
    loads = face_loads(surface, force, noise, level)
    number = np.zeros(surface.faces, dtype=int)
    if boundary.face is not None:
        number[surface.point_face[surface.points[:, 0]]] = boundary.face
    found = sorted(zip(number.tolist(), loads.kinds, strict=True))
    along = surface.tangential_strain(displacement, rough)
    return combined(surface, along, loads.traction, strain, material), tuple(found)


def rounding(values: np.ndarray) -> np.ndarray:
    """Half a unit of the last digit of values that were printed with few digits, else of doubles.

    CalculiX prints displacements with six digits into its result files.
    """
    sizes = np.abs(values)
    decade = 10.0 ** np.floor(np.log10(np.maximum(sizes, 1e-300)))
    for digits in (5, 6):
        unit = decade * 10.0**-digits
        whole = values / unit
        if np.all(np.abs(whole - np.round(whole)) < 1e-4):
            return 0.5 * np.where(sizes > 0.0, unit, 0.0)
    return np.finfo(float).eps * np.broadcast_to(sizes.max(initial=0.0), values.shape)


def combined(
    surface: BoundarySurface,
    along: np.ndarray,
    traction: np.ndarray,
    strain: np.ndarray,
    material: Material,
) -> np.ndarray:
    """Strain that fits what is known of each boundary node best: least squares.

    Parameters
    ----------
    surface : BoundarySurface
    along : (np, 3) array
        Strain along the surface, see `BoundarySurface.tangential_strain`.
    traction : (np, 3) array
        MPa, at the surface's points in their frames; nan where unknown.
    strain : (n, 6) array
        From the elements; it fills in what loads and surface leave open.
    material : Material

    Returns
    -------
    (n, 6) array
        As ``strain``, but for the surface's nodes.
    """
    modulus = material.young / (1.0 + material.poisson)
    frame = surface.frame
    known = np.isfinite(traction)
    # a face without a known load leaves the strain as the elements have it: better than half of it
    both, doubtful = _at_edges(surface, known.all(axis=1))
    known &= ~doubtful[:, None]
    sure = known.all(axis=1)
    trust = np.where(sure, np.where(both, _EDGE, 1.0), _UNSURE)[:, None]
    rows, values = [], []
    for number, (a, b, weight) in enumerate(((0, 0, 1.0), (1, 1, 1.0), (0, 1, 2.0**0.5))):
        rows.append(trust * modulus * weight * _product(frame[:, a], frame[:, b]))
        values.append(trust[:, 0] * modulus * weight * along[:, number])
    sigma = tensor(material.stress(np.eye(6)))  # stress of each component of strain
    across = np.einsum("sij,pj->psi", sigma, surface.normal)
    for axis in range(3):
        rows.append(known[:, axis, None] * np.einsum("psi,pi->ps", across, frame[:, axis]))
        values.append(np.where(known[:, axis], traction[:, axis], 0.0))
    act, wanted = np.stack(rows, axis=1), np.stack(values, axis=1)
    count, node = len(strain), surface.point_node
    matrix, right = np.zeros((count, 6, 6)), np.zeros((count, 6))
    np.add.at(matrix, node, np.swapaxes(act, 1, 2) @ act)
    np.add.at(right, node, np.einsum("pri,pr->pi", act, wanted))
    members = np.unique(node[known.any(axis=1)])
    weak = np.full(count, _WEAK)
    weak[node[sure]] = _WEAKER
    double = np.array([1.0, 1.0, 1.0, 2.0, 2.0, 2.0]) * (weak[members, None] * modulus) ** 2
    matrix = matrix[members] + double[:, :, None] * np.eye(6)
    right = right[members] + double * strain[members]
    result = strain.copy()
    result[members] = np.linalg.solve(matrix, right[..., None])[..., 0]
    return result


def _at_edges(surface: BoundarySurface, known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How points fare whose node has others.

    Parameters
    ----------
    surface : BoundarySurface
    known : (np,) bool array
        Whether the load of each point is.

    Returns
    -------
    both : (np,) bool array
        Points that share their node with one of another normal, all of known loads.
    doubtful : (np,) bool array
        Points whose load says nothing at their node: at edges that point into the body, where
        stresses have no bound, and where a support begins beside them on a smooth surface.
    """
    order = np.argsort(surface.point_node, kind="stable")
    both, doubtful = np.zeros((2, len(known)), dtype=bool)
    sharp = np.cos(np.radians(_SHARP))
    for step in range(1, int(np.bincount(surface.point_node).max())):
        one, other = order[:-step], order[step:]
        same = surface.point_node[one] == surface.point_node[other]
        one, other = one[same], other[same]
        cosine = np.sum(surface.normal[one] * surface.normal[other], axis=1)
        pair = (cosine < sharp) & known[one] & known[other]
        both[one[pair]] = both[other[pair]] = True
        rise = np.sum(surface.normal[one] * surface.inward[other], axis=1)
        rise = np.maximum(rise, np.sum(surface.normal[other] * surface.inward[one], axis=1))
        bad = (cosine < sharp) & (rise > np.sin(np.radians(_SHARP)))
        bad |= (cosine > sharp) & (known[one] != known[other])
        doubtful[one[bad]] = doubtful[other[bad]] = True
    # a node is as good as the worst pair of its points
    worst = np.zeros(len(surface.node_area), dtype=bool)
    worst[surface.point_node[doubtful]] = True
    return both, worst[surface.point_node]


def _product(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Rows that give a strain's component between two directions, (m, 6)."""
    i, j = [0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]
    twice = np.array([0.0, 0.0, 0.0, 1.0, 1.0, 1.0])
    return a[:, i] * b[:, j] + twice * a[:, j] * b[:, i]
