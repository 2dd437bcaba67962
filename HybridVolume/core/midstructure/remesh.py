# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Triangles of even size and good shape by splits, collapses, flips and smoothing (section 5).

Sheets may meet three or more at an edge. Rims, seams and creases are *curves*: edges with any
number of triangles but two, and edges at which two sheets meet at an angle. Vertices of curves stay
on their curve, and corners, where curves end, branch or turn sharply, stay where they are.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from ..tetmesh.mesh import row_keys
from .shapes import Edges, normals, opening_sides, shape, smallest_angles

# In units of the wanted length: edges beyond these are split or collapsed.
LONG, SHORT = 1.4, 0.72
# Sheets that meet at more than this angle make a crease, degrees.
CREASE = 35.0
# Normals turn by no more than this in one step, as a cosine.
TURN = 0.6


class Remesher:
    """A triangle complex that is changed in place.

    Parameters
    ----------
    vertices : (n, 3) array
        mm.
    triangles : (f, 3) int array
    sheet : (f,) int array
    size : callable
        Wanted edge lengths, mm, at points (k, 3).
    wanted : (n,) array
        The same at the vertices.
    sharp : bool
        Whether there are creases inside of sheets, too.
    """

    def __init__(
        self,
        vertices: np.ndarray,
        triangles: np.ndarray,
        sheet: np.ndarray,
        size: Callable[[np.ndarray], np.ndarray],
        wanted: np.ndarray,
        *,
        sharp: bool = False,
    ) -> None:
        self.x, self.t, self.sheet, self.size = vertices, triangles, sheet, size
        self.h, self.sharp = wanted, sharp
        self.fixed = np.zeros(len(vertices), dtype=bool)

    # ------------------------------------------------------------------ what is where

    def edges(self) -> tuple[Edges, np.ndarray, np.ndarray]:
        """Edges, whether each is part of a curve, and the number of such edges at each vertex."""
        n = len(self.x)
        edges = Edges.of(self.t, n)
        curve = edges.count != 2
        inner, sides = edges.two()
        f, g = sides.T // 3
        if not self.sharp:
            border = self.sheet[f] != self.sheet[g]
            inner, sides, f, g = inner[border], sides[border], f[border], g[border]
        if len(inner):
            unit = normals(self.x[self.t])
            same = self.t[f, sides[:, 0] % 3] == self.t[g, sides[:, 1] % 3]
            cosine = np.einsum("ki,ki->k", unit[f], unit[g]) * np.where(same, -1.0, 1.0)
            curve[inner[cosine < np.cos(np.radians(CREASE))]] = True
        degree = np.bincount(edges.ends[curve].ravel(), minlength=n)
        return edges, curve, degree

    def stars(self) -> tuple[np.ndarray, np.ndarray]:
        """Triangles around the vertices: those of v are ``triangles[start[v]:start[v + 1]]``."""
        flat = self.t.ravel()
        order = np.argsort(flat, kind="stable")
        start = np.searchsorted(flat[order], np.arange(len(self.x) + 1))
        return start, order // 3

    def compact(self) -> None:
        """Drop vertices without triangle."""
        used, triangles = np.unique(self.t, return_inverse=True)
        self.t = triangles.reshape(-1, 3)
        self.x, self.h, self.fixed = self.x[used], self.h[used], self.fixed[used]

    def patches(self) -> np.ndarray:
        """Connected part of each triangle, over edges with two triangles, (f,)."""
        f, g = Edges.of(self.t, len(self.x)).two()[1].T // 3
        count = len(self.t)
        graph = coo_matrix((np.ones(len(f)), (f, g)), shape=(count, count))
        return connected_components(graph, directed=False)[1]

    # ------------------------------------------------------------------ changes

    def merge(self, to: np.ndarray) -> None:
        """Put vertices together, whatever that does to the topology.

        What comes twice from one patch was folded over by it: it cancels, and so rims stay rims.

        Parameters
        ----------
        to : (n,) int array
            Vertex that takes the place of each; that one stays itself.
        """
        self.take(to[self.t], self.sheet, self.patches())

    def take(self, triangles: np.ndarray, sheet: np.ndarray, patch: np.ndarray) -> None:
        """Take triangles that may have equal corners or come more than once.

        Parameters
        ----------
        triangles : (f, 3) int array
        sheet : (f,) int array
        patch : (f,) int array
            What comes twice from one patch was folded over: it cancels.
        """
        solid = (triangles != triangles[:, [1, 2, 0]]).all(axis=1)
        triangles, sheet, patch = triangles[solid], sheet[solid], patch[solid]
        keys = row_keys(triangles, len(self.x))
        _, group = np.unique(np.column_stack([keys, patch]), axis=0, return_inverse=True)
        odd = np.bincount(group.ravel())[group.ravel()] % 2 == 1
        _, first = np.unique(keys[odd], return_index=True)
        self.t, self.sheet = triangles[odd][first], sheet[odd][first]
        self.compact()

    def unfold(self, angle: float, limit: float = 1.0) -> int:
        """Merge opposite corners of triangles that lie one upon the other; how many merged."""
        done = 0
        for _ in range(10):
            c, d = self._folds(angle)
            length = np.linalg.norm(self.x[c] - self.x[d], axis=1)
            near = (length < limit * self.h[c]) & (c != d)
            c, d, length = c[near], d[near], length[near]
            if not len(c):
                break
            n = len(self.x)
            _, _, degree = self.edges()
            swap = (degree[c] > 0) & (degree[d] == 0) | self.fixed[c]
            c, d = np.where(swap, d, c), np.where(swap, c, d)
            best = np.full(n, len(c))
            rank = np.empty(len(c), dtype=np.int64)
            rank[np.argsort(length, kind="stable")] = np.arange(len(c))
            np.minimum.at(best, c, rank)
            np.minimum.at(best, d, rank)
            go = (best[c] == rank) & (best[d] == rank)
            to = np.arange(n)
            to[c[go]] = d[go]
            self.merge(to)
            done += int(go.sum())
        return done

    def _folds(self, angle: float) -> tuple[np.ndarray, np.ndarray]:
        """Opposite corners of the triangles at a common edge that open by less than an angle."""
        sides = opening_sides(self.x, self.t, angle)
        f, k = np.divmod(sides, 3)
        c, d = self.t[f, (k + 2) % 3].T
        return c, d

    def relax(
        self,
        back: Callable[[np.ndarray], np.ndarray],
        steps: int = 3,
        which: np.ndarray | None = None,
    ) -> None:
        """Move vertices inside of sheets to the mean of their neighbours, come what may."""
        edges, _, degree = self.edges()
        both = np.vstack([edges.ends, edges.ends[:, ::-1]])
        free = degree == 0
        if which is not None:
            free &= np.isin(np.arange(len(self.x)), which)
        for _ in range(steps):
            mean = self._mean(np.ones(len(both)), both[:, 0], self.x[both[:, 1]])
            self.x = np.where(free[:, None], mean, self.x)
        if free.any():
            self.x[free] = back(self.x[free])
        self.h = self.size(self.x)

    def split(self, limit: float = LONG) -> int:
        """Split long edges at their middle; the number of splits."""
        before = len(self.x)
        for _ in range(20):
            start = len(self.x)
            near, far = self._around_long(limit)
            outside = np.zeros(len(self.x), dtype=bool)
            outside[self.t[far]] = True
            part, sheet = self.t[near], self.sheet[near]
            for _ in range(40 if len(near) else 0):
                number = len(self.x)
                part, sheet, outside = self._split_some(part, sheet, outside, limit)
                if len(self.x) == number:
                    break
            self.t = np.vstack([self.t[far], part])
            self.sheet = np.append(self.sheet[far], sheet)
            if len(self.x) == start:
                break
        return len(self.x) - before

    def _split_some(
        self, t: np.ndarray, sheet: np.ndarray, outside: np.ndarray, limit: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """One split at most in each of some triangles.

        Parameters
        ----------
        t : (f, 3) int array
        sheet : (f,) int array
        outside : (n,) bool array
            Vertices of other triangles: edges between two of them are left alone.
        limit : float

        Returns
        -------
        t, sheet, outside
        """
        n = len(self.x)
        edges = Edges.of(t, n)
        a, b = edges.ends.T
        length = np.linalg.norm(self.x[a] - self.x[b], axis=1)
        ratio = length / (0.5 * (self.h[a] + self.h[b]))
        # equal lengths are told apart, so that neighbours agree about the longest side
        rank = np.empty(len(length), dtype=np.int64)
        rank[np.argsort(length, kind="stable")] = np.arange(len(length))
        side = rank[edges.of_triangle].argmax(axis=1)
        longest = edges.of_triangle[np.arange(len(t)), side]
        agreed = np.bincount(longest, minlength=len(rank)) == edges.count
        agreed &= ~(outside[a] & outside[b])
        chosen = (ratio > limit) & agreed
        if not chosen.any():
            # a long side that is nobody's longest waits for the longer ones
            chosen[longest[ratio[edges.of_triangle].max(axis=1) > limit]] = True
            chosen &= agreed
        which = np.flatnonzero(chosen[longest])
        number = np.full(len(rank), -1)
        number[chosen] = n + np.arange(chosen.sum())
        k, new = side[which], number[longest[which]]
        first, second = t[which].copy(), t[which].copy()
        at = np.arange(len(which))
        first[at, (k + 1) % 3] = new
        second[at, k] = new
        rest = ~chosen[longest]
        middle = 0.5 * (self.x[a[chosen]] + self.x[b[chosen]])
        self.x = np.vstack([self.x, middle])
        self.h = np.append(self.h, self.size(middle))
        no = np.zeros(len(middle), dtype=bool)
        self.fixed = np.append(self.fixed, no)
        return (
            np.vstack([t[rest], first, second]),
            np.concatenate([sheet[rest], sheet[which], sheet[which]]),
            np.append(outside, no),
        )

    def _around_long(self, limit: float) -> tuple[np.ndarray, np.ndarray]:
        """Triangles with a long side, with those around them; and the others."""
        x, h = self.x[self.t], self.h[self.t]
        length = np.linalg.norm(x[:, [1, 2, 0]] - x, axis=2)
        long = (length > limit * 0.5 * (h + h[:, [1, 2, 0]])).any(axis=1)
        for _ in range(2 if long.any() else 0):
            mark = np.zeros(len(self.x), dtype=bool)
            mark[self.t[long]] = True
            long = mark[self.t].any(axis=1)
        return np.flatnonzero(long), np.flatnonzero(~long)

    def collapse(self, limit: float = SHORT, rounds: int = 30, worst: float = 0.0) -> int:
        """Collapse short edges where that changes neither the topology nor the shape.

        Parameters
        ----------
        limit : float
            In units of the wanted length.
        rounds : int
        worst : float
            Edges of triangles with a smallest angle below this (degrees) are collapsed, too.

        Returns
        -------
        int
            Vertices that went.
        """
        done = 0
        n = len(self.x)
        refused = np.zeros(0, dtype=np.int64)
        for _ in range(rounds):
            edges, curve, degree = self.edges()
            pairs, edge, priority = self._short(edges, curve, degree, limit, worst)
            new = ~np.isin(pairs[:, 0] * n + pairs[:, 1], refused)
            pairs, edge, priority = pairs[new], edge[new], priority[new]
            if not len(pairs):
                break
            chosen = self._apart(pairs, priority)
            pairs, edge = pairs[chosen], edge[chosen]
            good = self._keeps_topology(pairs, edges, edge, curve)
            good[good] = self._keeps_shape(pairs[good])
            refused = np.append(refused, pairs[~good, 0] * n + pairs[~good, 1])
            to = np.arange(n)
            to[pairs[good, 0]] = pairs[good, 1]
            self.t = to[self.t]
            solid = (self.t != self.t[:, [1, 2, 0]]).all(axis=1)
            self.t, self.sheet = self.t[solid], self.sheet[solid]
            done += int(good.sum())
        self.compact()
        return done

    def _short(
        self, edges: Edges, curve: np.ndarray, degree: np.ndarray, limit: float, worst: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Moves (vertex, where to) along short edges, (k, 2), their edges, and their order."""
        a, b = edges.ends.T
        length = np.linalg.norm(self.x[a] - self.x[b], axis=1)
        ratio = length / (0.5 * (self.h[a] + self.h[b]))
        wanted = ratio < limit
        if worst > 0.0:
            bad = smallest_angles(self.x[self.t]) < worst
            side = length[edges.of_triangle[bad]].argmin(axis=1)
            wanted[edges.of_triangle[bad, side]] = True
        some = np.flatnonzero(wanted)
        pairs = np.vstack([edges.ends[some], edges.ends[some][:, ::-1]])
        edge = np.tile(some, 2)
        go = pairs[:, 0]
        allowed = ~self.fixed[go] & ((degree[go] == 0) | ((degree[go] == 2) & curve[edge]))
        pairs, edge = pairs[allowed], edge[allowed]
        # vertices inside of sheets go first
        return pairs, edge, ratio[edge] + (degree[pairs[:, 0]] > 0)

    def _apart(self, pairs: np.ndarray, priority: np.ndarray) -> np.ndarray:
        """Numbers of moves, the first of their surroundings, no two of them at one triangle."""
        best = np.full(len(self.x), len(pairs))
        rank = np.empty(len(pairs), dtype=np.int64)
        rank[np.argsort(priority, kind="stable")] = np.arange(len(pairs))
        np.minimum.at(best, pairs[:, 0], rank)
        np.minimum.at(best, pairs[:, 1], rank)
        around = best.copy()
        least = best[self.t].min(axis=1)
        for k in range(3):
            np.minimum.at(around, self.t[:, k], least)
        return np.flatnonzero((rank <= around[pairs[:, 0]]) & (rank <= around[pairs[:, 1]]))

    def _keeps_topology(
        self, pairs: np.ndarray, edges: Edges, edge: np.ndarray, curve: np.ndarray
    ) -> np.ndarray:
        """The link condition: what is joined to both ends lies opposite, in a triangle of the edge.

        And curves must not close upon themselves.
        """
        n = len(self.x)
        go, stay = pairs.T
        a, b = edges.ends.T
        one = np.ones(len(a))
        net = coo_matrix((one, (a, b)), shape=(n, n)).tocsr()
        net = net + net.T
        common = np.asarray(net[go].multiply(net[stay]).sum(axis=1)).ravel()
        bend = coo_matrix((one[curve], (a[curve], b[curve])), shape=(n, n)).tocsr()
        bend = bend + bend.T
        third = np.asarray(bend[go].multiply(bend[stay]).sum(axis=1)).ravel()
        return (common == edges.count[edge]) & (third == 0)

    def _keeps_shape(self, pairs: np.ndarray) -> np.ndarray:
        """Whether triangles keep their side and get no bad shape, and none comes twice."""
        start, around = self.stars()
        number = start[pairs[:, 0] + 1] - start[pairs[:, 0]]
        move = np.repeat(np.arange(len(pairs)), number)
        first = np.repeat(np.cumsum(number) - number, number)
        tri = around[start[pairs[move, 0]] + np.arange(len(move)) - first]
        stays = ~(self.t[tri] == pairs[move, 1][:, None]).any(axis=1)
        move, tri = move[stays], tri[stays]
        old = self.t[tri]
        new = np.where(old == pairs[move, 0][:, None], pairs[move, 1][:, None], old)
        x, y = self.x[old], self.x[new]
        before, after = shape(x), shape(y)
        turn = np.einsum("ki,ki->k", normals(x), normals(y))
        bad = (turn < TURN) & (before > 0.1) | (turn < 0.0)
        bad |= (after < 0.3) & (after < 0.9 * before)
        size = self.h[new].mean(axis=1)
        longest = np.linalg.norm(y[:, [1, 2, 0]] - y, axis=2).max(axis=1)
        grown = longest > 1.01 * np.linalg.norm(x[:, [1, 2, 0]] - x, axis=2).max(axis=1)
        bad |= (longest > 1.6 * size) & grown
        keys = row_keys(self.t, len(self.x))
        bad |= np.isin(row_keys(new, len(self.x)), keys)
        result = np.ones(len(pairs), dtype=bool)
        result[move[bad]] = False
        return result

    def flip(self, rounds: int = 4) -> int:
        """Flip edges inside of sheets where that makes the smallest angle larger."""
        done = 0
        for _ in range(rounds):
            n = len(self.x)
            edges, curve, _ = self.edges()
            inner, sides = edges.two()
            use = ~curve[inner]
            sides = sides[use]
            f, g = sides.T // 3
            i, j = sides.T % 3
            a, b, c = self.t[f, i], self.t[f, (i + 1) % 3], self.t[f, (i + 2) % 3]
            d = self.t[g, (j + 2) % 3]
            x = self.x
            old = np.stack([x[np.stack([a, b, c], 1)], x[np.stack([b, a, d], 1)]])
            new = np.stack([x[np.stack([a, d, c], 1)], x[np.stack([d, b, c], 1)]])
            before = np.minimum(*(smallest_angles(y) for y in old))
            after = np.minimum(*(smallest_angles(y) for y in new))
            n1, n2 = (normals(y) for y in old)
            n3, n4 = (normals(y) for y in new)
            mean = n1 + n2
            good = (after > before + 1.0) & (c != d)
            thin = np.minimum(shape(old[0]), shape(old[1])) < 0.2
            good &= (np.einsum("ki,ki->k", n1, n2) > 0.5) | thin
            good &= np.einsum("ki,ki->k", n3, n4) > 0.5
            good &= np.minimum(*(np.einsum("ki,ki->k", m, mean) for m in (n3, n4))) > 0.4
            key = row_keys(np.column_stack([c, d]), n)
            good &= ~np.isin(key, edges.keys)
            rows = np.flatnonzero(good)
            if not len(rows):
                break
            rows = rows[np.argsort(before[rows] - after[rows], kind="stable")]
            rows = rows[np.sort(np.unique(key[rows], return_index=True)[1])]
            # the best flip of each triangle, where both triangles agree
            best = np.full(len(self.t), len(rows))
            rank = np.arange(len(rows))
            np.minimum.at(best, f[rows], rank)
            np.minimum.at(best, g[rows], rank)
            rows = rows[(best[f[rows]] == rank) & (best[g[rows]] == rank)]
            self.t[f[rows]] = np.column_stack([a[rows], d[rows], c[rows]])
            self.t[g[rows]] = np.column_stack([d[rows], b[rows], c[rows]])
            done += len(rows)
        return done

    def smooth(
        self,
        back: Callable[[np.ndarray], np.ndarray],
        back_to_curve: Callable[[np.ndarray], np.ndarray],
    ) -> None:
        """Move vertices towards the middle of their triangles, or along their curves.

        Parameters
        ----------
        back, back_to_curve : callables
            Take points (k, 3) back to the sheets, and to the curves.
        """
        edges, curve, degree = self.edges()
        corner = self.x[self.t]
        area = np.linalg.norm(
            np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]), axis=1
        )
        weight = np.maximum(area, 1e-300) / self.h[self.t].mean(axis=1) ** 2
        moved = self._mean(np.repeat(weight, 3), self.t.ravel(), corner.mean(axis=1).repeat(3, 0))
        line = (degree == 2) & ~self.fixed
        ends = np.vstack([edges.ends[curve], edges.ends[curve][:, ::-1]])
        between = self._mean(np.ones(len(ends)), ends[:, 0], self.x[ends[:, 1]])
        moved[line] = 0.5 * (self.x[line] + between[line])
        free = degree == 0
        target = self.x.copy()
        if free.any():
            target[free] = back(moved[free])
        if line.any():
            target[line] = back_to_curve(moved[line])
        self.move(target)

    def _mean(self, weight: np.ndarray, to: np.ndarray, values: np.ndarray) -> np.ndarray:
        n = len(self.x)
        total = np.maximum(np.bincount(to, weight, n), 1e-300)
        sums = [np.bincount(to, weight * values[:, k], n) for k in range(3)]
        return np.column_stack(sums) / total[:, None]

    def move(self, target: np.ndarray) -> None:
        """Go where no triangle turns over or gets a much worse shape by it."""
        before = self.x[self.t]
        unit, quality = normals(before), shape(before)
        step = np.ones(len(self.x))
        for attempt in range(6):
            x = self.x + step[:, None] * (target - self.x)
            after = x[self.t]
            turn = np.einsum("ki,ki->k", unit, normals(after))
            bad = (turn < TURN) & (quality > 0.1)
            bad |= (shape(after) < 0.5) & (shape(after) < 0.9 * quality)
            if not bad.any():
                break
            step[self.t[bad]] *= 0.5 if attempt < 3 else 0.0
        else:
            return
        self.x = x
        self.h = self.size(x)
