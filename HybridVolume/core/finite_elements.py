# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""One conforming finite element mesh of shell and core.

Every column of the shell over an interface triangle is cut into wedges, one a Bézier layer; their
triangles are the faces of the core's tets, so that nodes are shared and nothing is tied. Quadratic
elements have their mid nodes on the exact map of the shell; on the outer boundary that is the CAD
face itself. Nodes are merged by topology, never by distance, and every element's Jacobian is
proved positive.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from ..errors import FaultError, MesherError
from .columns import evaluate_columns, layer_parameters
from .curving import untangle
from .density import Density
from .element_jacobians import prove_positive, relative_bound, scaled_jacobian, volumes
from .elements import EDGES, FACES, quadrature, shape_functions, shape_gradients
from .interior import Interface, Interior, build_interface, fill_interior
from .mid_nodes import outer_mids
from .shell import Shell

logger = logging.getLogger(__name__)

_ROUNDS = 6
_KEPT_QUALITY = 0.5
"""Share of its straight scaled Jacobian that a curved tet should have."""
_POOR, _WORST = 0.02, 0.002
"""Scaled Jacobians below which wedges, and below which all elements, are worth an optimisation."""


REPAIRS = ("straightened", "untangled", "flipped", "refined")
"""Kinds of repairs that are counted."""


@dataclass(frozen=True)
class FiniteElementMesh:
    """Wedges of the shell and tets of the core on shared nodes, in the node order of Abaqus.

    Attributes
    ----------
    order : int
        1 or 2: six-node wedges and four-node tets, or fifteen and ten nodes.
    nodes : (n, 3) array
        mm
    wedges : (m, 15) or (m, 6) int array
        Bottom towards the core, top towards the outer boundary.
    wedge_patch, wedge_layer : (m,) int arrays
        Patch of the shell, and Bézier layer (0 is the outermost).
    tets : (k, 10) or (k, 4) int array
    boundary : (nf, 6) or (nf, 3) int array
        Triangles of the outer boundary, oriented outward: tops of wedges.
    boundary_face : (nf,) int array
        Position of each in ``face_names``.
    boundary_wedge : (nf,) int array
        Wedge under each.
    interface : (ni, 6) or (ni, 3) int array
        Triangles between shell and core, oriented out of the core.
    face_names : tuple of str
        CAD faces.
    wedge_quality, tet_quality : (m,), (k,) arrays
        Smallest scaled Jacobian of each element.
    wedge_bound, tet_bound : (m,), (k,) arrays
        Proved lower bound of det J over the mean edge product of each element.
    repairs : mapping of str to int
        What was done so that all elements are valid: "straightened" mid nodes (moved towards the
        middle of their edge), "untangled" nodes, "flipped" diagonals of cells, and "refined" cells
        (cut finer than was wanted).
    density : Density
        As it was wanted.
    surface_nodes : (nb,) int array
        Nodes of the outer boundary, mid nodes too.
    surface_patch : (nb,) int array
        A patch that each lies on.
    surface_uv : (nb, 2) array
        Its parameters there, on the shell's surface: positions and normals can be evaluated.
    """

    order: int
    nodes: np.ndarray
    wedges: np.ndarray
    wedge_patch: np.ndarray
    wedge_layer: np.ndarray
    tets: np.ndarray
    boundary: np.ndarray
    boundary_face: np.ndarray
    boundary_wedge: np.ndarray
    interface: np.ndarray
    face_names: tuple[str, ...]
    wedge_quality: np.ndarray
    tet_quality: np.ndarray
    wedge_bound: np.ndarray
    tet_bound: np.ndarray
    repairs: Mapping[str, int] = field(default_factory=lambda: dict.fromkeys(REPAIRS, 0))
    density: Density = field(default_factory=Density)
    surface_nodes: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    surface_patch: np.ndarray = field(default_factory=lambda: np.zeros(0, dtype=np.int64))
    surface_uv: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))

    @property
    def wedge_kind(self) -> str:
        """Kind of the wedges in `elements`."""
        return "penta15" if self.order == 2 else "penta6"

    @property
    def tet_kind(self) -> str:
        """Kind of the tets in `elements`."""
        return "tet10" if self.order == 2 else "tet4"

    @property
    def face_kind(self) -> str:
        """Kind of the boundary and interface triangles in `elements`."""
        return "tri6" if self.order == 2 else "tri3"

    @property
    def min_scaled_jacobian(self) -> float:
        """Smallest scaled Jacobian of all elements."""
        return float(min(self.wedge_quality.min(), self.tet_quality.min()))

    @property
    def volume(self) -> float:
        """Sum of the elements' exact volumes, mm³."""
        return self.shell_volume + self.core_volume

    @property
    def shell_volume(self) -> float:
        """Volume of the wedges, mm³."""
        return float(volumes(self.wedge_kind, self.nodes[self.wedges]).sum())

    @property
    def core_volume(self) -> float:
        """Volume of the tets, mm³."""
        return float(volumes(self.tet_kind, self.nodes[self.tets]).sum())

    @property
    def boundary_volume(self) -> float:
        """Volume that the boundary triangles enclose, mm³; an independent sum."""
        return enclosed_volume(self.face_kind, self.nodes, self.boundary)

    def face_triangles(self, name: str) -> np.ndarray:
        """Boundary triangles of a CAD face, (nt, 6) or (nt, 3)."""
        return self.boundary[self.boundary_face == self.face_names.index(name)]

    def face_nodes(self, name: str) -> np.ndarray:
        """Nodes on a CAD face, mid nodes included, sorted."""
        return np.unique(self.face_triangles(name))


def enclosed_volume(kind: str, nodes: np.ndarray, triangles: np.ndarray) -> float:
    """Volume inside closed triangles ("tri3" or "tri6") that are oriented outward, mm³."""
    points, weights = quadrature("tri", 4)
    x = nodes[triangles] - nodes[triangles].mean(axis=(0, 1))
    position = np.einsum("qn,tnc->tqc", shape_functions(kind, points), x)
    tangents = np.einsum("qnd,tnc->tqcd", shape_gradients(kind, points), x)
    normal = np.cross(tangents[..., 0], tangents[..., 1])
    return float(np.einsum("tqc,tqc,q->", position, normal, weights) / 3.0)


def conforming_mesh(
    shell: Shell,
    interface: Interface,
    interior: Interior,
    order: int = 2,
    density: Density | None = None,
) -> FiniteElementMesh:
    """Wedges and tets on shared nodes (decision 10 of the design).

    Parameters
    ----------
    shell : Shell
    interface : Interface
    interior : Interior
    order : {1, 2}
    density : Density, optional
        What the interface was made for.

    Raises
    ------
    MesherError
        Elements stay unproved with straight inner edges; the faces over them are named.
    FaultError
        Faces of elements do not match, or the volumes do not add up.
    """
    if order not in (1, 2):
        raise ValueError(f"order is 1 or 2, not {order}")
    builder = _Builder(shell, interface, interior, order)
    repairs, wedge_bound, tet_bound = builder.prove()
    nodes = builder.nodes
    wedge_kind, tet_kind = ("penta15", "tet10") if order == 2 else ("penta6", "tet4")
    names = tuple(dict.fromkeys(patch.face for patch in shell.surface.patches))
    position = np.array([names.index(patch.face) for patch in shell.surface.patches])
    mesh = FiniteElementMesh(
        order=order,
        nodes=nodes,
        wedges=builder.wedges,
        wedge_patch=np.tile(interface.triangle_patch, builder.layers),
        wedge_layer=np.repeat(np.arange(builder.layers), len(interface.triangles)),
        tets=builder.tets,
        boundary=builder.triangles(0),
        boundary_face=position[interface.triangle_patch],
        boundary_wedge=np.arange(len(interface.triangles)),
        interface=builder.triangles(builder.layers),
        face_names=names,
        wedge_quality=scaled_jacobian(wedge_kind, nodes[builder.wedges]),
        tet_quality=scaled_jacobian(tet_kind, nodes[builder.tets]),
        wedge_bound=wedge_bound,
        tet_bound=tet_bound,
        repairs=dict.fromkeys(REPAIRS, 0) | repairs,
        density=density or Density(),
        **builder.surface_places(),
    )
    _check(mesh)
    logger.info(
        "finite elements: %d nodes, %d wedges, %d tets, smallest scaled Jacobian %.3f, %s",
        len(nodes),
        len(mesh.wedges),
        len(mesh.tets),
        mesh.min_scaled_jacobian,
        ", ".join(f"{count} {kind}" for kind, count in mesh.repairs.items()),
    )
    return mesh


def completed(mesh: FiniteElementMesh, shell: Shell, interface: Interface) -> FiniteElementMesh:
    """A mesh as files before version 4 hold it, with what can be told about it since."""
    if len(mesh.surface_nodes):
        return mesh
    density = Density(interface.nodes, interface.subdivide)
    wanted = interface.triangles
    blocks = [(mesh.boundary[:, :3], wanted, interface.vertex_patch, interface.vertex_uv)]
    if mesh.order == 2:
        mids = evaluate_columns(shell, interface.edge_patch, interface.edge_uv, np.zeros(1))[0]
        _, patch, uv = outer_mids(shell, interface, mids)
        blocks.append((mesh.boundary[:, 3:], interface.triangle_edges, patch, uv))
    nodes = []
    for boundary, number, patch, _ in blocks:
        place = np.empty(len(patch), dtype=np.int64)
        place[number] = boundary
        nodes.append(place)
    return replace(
        mesh,
        density=density,
        surface_nodes=np.concatenate(nodes),
        surface_patch=np.concatenate([patch for _, _, patch, _ in blocks]),
        surface_uv=np.concatenate([uv for *_, uv in blocks]),
    )


def build_finite_elements(
    shell: Shell,
    density: Density | None = None,
    *,
    order: int = 2,
    finest: int = 4,
    engine: str = "auto",
    free: bool | None = None,
    max_size: float | None = None,
    time_limit: float = 120.0,
) -> tuple[Interface, Interior, FiniteElementMesh]:
    """Interface, core and conforming mesh; the interface is refined until all three hold.

    A coarse grid may give facets that cut each other, or wedges that cannot be proved, although the
    shell is certified; then every cell is cut finer, up to ``finest`` parts a side.

    Parameters
    ----------
    shell : Shell
    density : Density, optional
        Wanted density; by default the cells and layers of the shell.
    order : {1, 2}
    finest : int
        Parts of each cell's side to end with.
    engine, free, max_size, time_limit
        As for `fill_interior`.

    Raises
    ------
    MesherError
        The last reason, when the finest grid failed too.
    """
    density = density or Density()
    for parts in range(density.subdivide, max(density.subdivide, finest) + 1):
        try:
            interface = build_interface(shell, density.nodes, parts)
            interior = fill_interior(
                interface,
                engine,
                surface=shell.surface,
                max_size=max_size,
                free=free,
                time_limit=time_limit,
            )
            mesh = conforming_mesh(shell, interface, interior, order, density)
        except MesherError as error:
            if parts >= finest:
                raise
            logger.info("interface with %d parts a cell: %s", parts, error.line)
            continue
        return interface, interior, mesh
    raise AssertionError("the loop returns or raises")


class _Builder:
    """Node numbers, coordinates and elements on the way to a mesh.

    Nodes stand in blocks: corners level by level from outside, then mid nodes between levels, mid
    nodes of the triangles' edges level by level, vertices of the core, mid nodes of its edges.
    """

    def __init__(self, shell: Shell, interface: Interface, interior: Interior, order: int) -> None:
        self.shell, self.interface, self.order = shell, interface, order
        self.layers = shell.layer_count
        self.n, self.e = len(interface.vertices), len(interface.edges)
        w = layer_parameters(shell, between=order == 2)
        corners = evaluate_columns(shell, interface.vertex_patch, interface.vertex_uv, w)
        corners[-1] = interface.vertices
        blocks = [corners[::order].reshape(-1, 3)]
        if order == 2:
            blocks.append(corners[1::2].reshape(-1, 3))
            mids = evaluate_columns(shell, interface.edge_patch, interface.edge_uv, w[::2])
            mids[-1] = interface.midpoints
            mids[0], self.edge_patch, self.edge_uv = outer_mids(shell, interface, mids[0])
            blocks.append(mids.reshape(-1, 3))
        blocks.append(interior.mesh.vertices[self.n :])
        starts = np.cumsum([0, *(len(b) for b in blocks)])
        self.between, self.edge = (starts[1], starts[2]) if order == 2 else (0, 0)
        core = np.append(self.layers * self.n + np.arange(self.n),
                         starts[-2] + np.arange(len(blocks[-1])))  # fmt: skip
        self.nodes = np.concatenate(blocks)
        self.core_start = starts[-2]
        self.tets = core[interior.mesh.tets]
        if order == 2:
            self._add_tet_mids(interior.mesh.tets)
        self.wedges = self._wedges()

    def triangles(self, level: int) -> np.ndarray:
        """Interface triangles seen on a level, with their mid nodes."""
        corners = level * self.n + self.interface.triangles
        if self.order == 1:
            return corners
        mids = self.edge + level * self.e + self.interface.triangle_edges
        return np.concatenate([corners, mids], axis=1)

    def _wedges(self) -> np.ndarray:
        parts = []
        for layer in range(self.layers):
            bottom, top = self.triangles(layer + 1), self.triangles(layer)
            columns = [bottom[:, :3], top[:, :3]]
            if self.order == 2:
                between = self.between + layer * self.n + self.interface.triangles
                columns += [bottom[:, 3:], top[:, 3:], between]
            parts.append(np.concatenate(columns, axis=1))
        return np.concatenate(parts)

    def _add_tet_mids(self, tets: np.ndarray) -> None:
        """Mid nodes of the tets: those of the interface where an edge is one, else new ones."""
        count = int(tets.max()) + 1
        ends = np.sort(tets[:, np.array(EDGES["tet10"])], axis=2).reshape(-1, 2)
        keys, inverse = np.unique(ends[:, 0] * count + ends[:, 1], return_inverse=True)
        known = self.interface.edges[:, 0] * count + self.interface.edges[:, 1]
        order = np.argsort(known)
        place = np.clip(np.searchsorted(known[order], keys), 0, len(known) - 1)
        shared = known[order][place] == keys
        if np.count_nonzero(shared) != len(known):
            raise FaultError(
                f"the core has {np.count_nonzero(shared)} of {len(known)} interface edges",
                remedy="take another mesher",
            )
        number = np.empty(len(keys), dtype=np.int64)
        number[shared] = self.edge + self.layers * self.e + order[place[shared]]
        number[~shared] = len(self.nodes) + np.arange(np.count_nonzero(~shared))
        mids = number[inverse.reshape(-1)].reshape(-1, 6)
        corners = np.column_stack([keys // count, keys % count])[~shared]
        x = np.concatenate([self.interface.vertices, self._inner_vertices()])
        self.nodes = np.concatenate([self.nodes, x[corners].mean(axis=1)])
        self.tets = np.concatenate([self.tets, mids], axis=1)

    def _inner_vertices(self) -> np.ndarray:
        return self.nodes[self.core_start :]

    def _movable(self) -> tuple[np.ndarray, np.ndarray]:
        """Mid nodes inside the body that are not straight by construction, and their ends."""
        levels = np.arange(1, self.layers + 1)[:, None]
        nodes = [self.between + np.arange(self.layers * self.n)]
        above = np.arange(self.layers * self.n)
        ends = [np.column_stack([above, above + self.n])]
        nodes.append((self.edge + levels * self.e + np.arange(self.e)).ravel())
        ends.append((levels[..., None] * self.n + self.interface.edges).reshape(-1, 2))
        return np.concatenate(nodes), np.concatenate(ends)

    def surface_places(self) -> dict[str, np.ndarray]:
        """Nodes of the outer boundary with their patch and parameters."""
        nodes = [np.arange(self.n)]
        patch, uv = [self.interface.vertex_patch], [self.interface.vertex_uv]
        if self.order == 2:
            nodes.append(self.edge + np.arange(self.e))
            patch.append(self.edge_patch)
            uv.append(self.edge_uv)
        return {
            "surface_nodes": np.concatenate(nodes),
            "surface_patch": np.concatenate(patch),
            "surface_uv": np.concatenate(uv),
        }

    def prove(self) -> tuple[dict[str, int], np.ndarray, np.ndarray]:
        """Prove all elements; where that fails, straighten inner edges step by step, then untangle.

        Tets that curving made much worse are straightened as well.

        Returns
        -------
        repairs : dict
            Counts of moved nodes, as in `FiniteElementMesh`.
        wedge_bound, tet_bound : arrays
        """
        curved = straightened = self.nodes
        if self.order == 2:
            movable, ends = self._movable()
            straight = curved.copy()
            straight[movable] = curved[ends].mean(axis=1)
            least = _KEPT_QUALITY * scaled_jacobian("tet10", straight[self.tets])
            self.nodes = curved.copy()
            self._straighten(curved, straight, movable, least)
            straightened = self.nodes.copy()
            self._untangle(movable)
        proofs = [prove_positive(kind, self.nodes[c]) for kind, c in self._elements]
        if not all(p.proved.all() for p in proofs):
            self._refuse([p.proved for p in proofs])
        wedge_bound, tet_bound = (
            relative_bound(kind, self.nodes[c], p.lower_bound)
            for (kind, c), p in zip(self._elements, proofs, strict=True)
        )
        moved = {"straightened": (curved, straightened), "untangled": (straightened, self.nodes)}
        repairs = {
            kind: int(np.count_nonzero((before != after).any(axis=1)))
            for kind, (before, after) in moved.items()
        }
        return repairs, wedge_bound, tet_bound

    @property
    def _elements(self) -> list[tuple[str, np.ndarray]]:
        kinds = ("penta15", "tet10") if self.order == 2 else ("penta6", "tet4")
        return [(kinds[0], self.wedges), (kinds[1], self.tets)]

    def _straighten(
        self, curved: np.ndarray, straight: np.ndarray, movable: np.ndarray, least: np.ndarray
    ) -> None:
        """Move mid nodes of bad elements half-way to straight, again and again.

        Bad are elements that are not proved, and tets whose scaled Jacobian is below ``least``.
        """
        good = [np.zeros(len(c), dtype=bool) for _, c in self._elements]
        share = np.ones(len(self.nodes))
        moved = np.ones(len(self.nodes), dtype=bool)
        may_move = np.zeros(len(self.nodes), dtype=bool)
        may_move[movable] = True
        for round_ in range(_ROUNDS):
            for flags, (kind, c) in zip(good, self._elements, strict=True):
                again = np.flatnonzero(moved[c].any(axis=1))
                flags[again] = prove_positive(kind, self.nodes[c[again]]).proved
                if kind == "tet10":
                    quality = scaled_jacobian(kind, self.nodes[c[again]])
                    flags[again] &= quality >= least[again]
            bad = [c[~flags].ravel() for flags, (_, c) in zip(good, self._elements, strict=True)]
            bad = np.unique(np.concatenate(bad))
            bad = bad[may_move[bad] & (share[bad] > 0.0)]
            if not len(bad):
                break
            share[bad] = 0.0 if round_ == _ROUNDS - 1 else 0.5 * share[bad]
            moved = np.zeros(len(self.nodes), dtype=bool)
            moved[bad] = True
            mix = share[bad, None]
            self.nodes[bad] = mix * curved[bad] + (1.0 - mix) * straight[bad]

    def _untangle(self, movable: np.ndarray) -> None:
        """Move nodes inside near elements that are not proved, and near poor wedges.

        What was proved stays proved: a step that loses an element or quality is not taken.
        """
        may_move = np.zeros(len(self.nodes), dtype=bool)
        may_move[movable] = True
        may_move[self.core_start :] = True
        for density, rings, least in ((3, 0, (_POOR, 0.0)), (4, 1, (_WORST, _WORST))):
            before = self._quality(self.nodes)
            # many tets are as flat as the mesher left them: only wedges can gain much
            poor = [q < low for q, low in zip(before, least, strict=True)]
            if not any(p.any() for p in poor):
                break
            near = np.zeros(len(self.nodes), dtype=bool)
            for flags, (_, c) in zip(poor, self._elements, strict=True):
                near[c[flags]] = True
            for _ in range(rings):
                for _, c in self._elements:
                    near[c[near[c].any(axis=1)]] = True
            free = near & may_move
            around = [(kind, c[free[c].any(axis=1)]) for kind, c in self._elements]
            fresh = untangle(self.nodes, around, free, density)
            after = self._quality(fresh)
            if min(q.min() for q in after) > min(q.min() for q in before):
                self.nodes = fresh

    def _quality(self, nodes: np.ndarray) -> list[np.ndarray]:
        """Scaled Jacobian of each element, -1 where it is not proved."""
        found = []
        for kind, c in self._elements:
            quality = scaled_jacobian(kind, nodes[c])
            found.append(np.where(prove_positive(kind, nodes[c]).proved, quality, -1.0))
        return found

    def _refuse(self, proved: list[np.ndarray]) -> None:
        bad_wedges, bad_tets = (np.flatnonzero(~p) for p in proved)
        patches = self.interface.triangle_patch[bad_wedges % len(self.interface.triangles)]
        at_interface = np.isin(self.interface.triangles, self.tets[bad_tets] - self.layers * self.n)
        patches = np.union1d(patches, self.interface.triangle_patch[at_interface.any(axis=1)])
        raise MesherError(
            f"{len(bad_wedges)} wedges and {len(bad_tets)} tets of order {self.order} are not"
            " proved valid",
            faces=list(dict.fromkeys(self.shell.surface.patches[k].face for k in patches)),
            figure=float(len(bad_wedges) + len(bad_tets)),
            remedy="subdivide the interface or choose a smaller w0",
        )


def _check(mesh: FiniteElementMesh) -> None:
    """Every face belongs to two elements or to the boundary, and the volumes add up."""
    for size in {len(f) for kind in (mesh.wedge_kind, mesh.tet_kind) for f in FACES[kind]}:
        rows = [
            connectivity[:, face]
            for kind, connectivity in ((mesh.wedge_kind, mesh.wedges), (mesh.tet_kind, mesh.tets))
            for face in FACES[kind]
            if len(face) == size
        ]
        if size == mesh.boundary.shape[1]:
            rows.append(mesh.boundary)
        rows = np.sort(np.concatenate(rows), axis=1)
        rows = np.ascontiguousarray(rows[np.lexsort(rows.T)])
        if len(rows) % 2 or not np.array_equal(rows[::2], rows[1::2]):
            raise FaultError("faces of the finite elements do not match in pairs")
        if (rows[1:-1:2] == rows[2::2]).all(axis=1).any():
            raise FaultError("more than two finite elements share a face")
    volume, enclosed = mesh.volume, mesh.boundary_volume
    if abs(volume - enclosed) > 1e-10 * abs(enclosed):
        raise FaultError(
            f"the finite elements have {volume:.12g} mm³, their boundary encloses"
            f" {enclosed:.12g} mm³",
            figure=volume - enclosed,
        )
