# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What ``./run.sh reproduce dynamics`` computes: drops, flights, frequencies, rigid motions."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import brentq
from scipy.special import spherical_jn

from HybridVolume.core import bspline
from HybridVolume.core.analysis.contact import PlaneContact
from HybridVolume.core.analysis.coupling import CollocationSpace, NitscheSpace
from HybridVolume.core.analysis.fields import FieldSpace
from HybridVolume.core.analysis.hyperelastic import Hyperelastic
from HybridVolume.core.analysis.modal import modal
from HybridVolume.core.analysis.newmark import Motion, Newmark
from HybridVolume.core.analysis.rigid import coefficient_points, rigid_motions
from HybridVolume.core.recovery import Material, von_mises
from HybridVolume.exports.solution_vtu import SolutionFile, write_pvd

logger = logging.getLogger(__name__)

Space = CollocationSpace | NitscheSpace
Progress = Callable[[float, str], None]
CELLS = 3
"""Parts of a knot span's sides in pictures."""


@dataclass(frozen=True)
class Drop:
    """A body that falls onto a plane without friction.

    Attributes
    ----------
    young : float
        MPa
    poisson : float
    density : float
        t/mm³
    gravity : float
        mm/s²
    speed : float
        mm/s, when it touches the plane.
    up : tuple of float
        Away from the plane, in the body's frame.
    contact : float
        Penalty, MPa/mm, as a multiple of Young's modulus, 1/mm.
    step : float
        s
    steps : int
    every : int
        Steps from one file of the series to the next.
    pictures : int
        Moments that are drawn.
    """

    young: float = 0.006
    poisson: float = 0.3
    density: float = 1e-9
    gravity: float = 9810.0
    speed: float = 110.0
    up: tuple[float, float, float] = (0.10, -0.15, -0.98)
    contact: float = 2.0
    step: float = 5e-4
    steps: int = 50
    every: int = 2
    pictures: int = 8


def dropped(space: Space, drop: Drop, folder: Path, name: str, told: Progress) -> dict[str, Any]:
    """Drop a body with the rule that keeps energy, write a series for ParaView, and tell of it.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
    drop : Drop
    folder : Path
        Gets ``NAME.pvd`` and its files, and ``NAME.npz`` with what pictures need.
    name : str
    told : callable
        Gets the share that is done, and words.
    """
    up = np.array(drop.up) / np.linalg.norm(drop.up)
    material = Material(drop.young, drop.poisson)
    body = Hyperelastic(space, material, drop.density)
    floor = float((body.reference @ up).min()) - drop.step * drop.speed
    plane = PlaneContact(up, floor, drop.contact * drop.young)
    rule = Newmark(
        body,
        drop.step,
        gravity=-drop.gravity * up,
        contacts=[plane],
        rule="conserving",
        tolerance=1e-6,
    )
    motion = rule.start(-drop.speed * up)
    series = _Series(space, material, folder, name)
    skin = Skin.of(space)
    shown = np.unique(np.linspace(0, drop.steps, drop.pictures).round().astype(int))
    rows, drawn, spent = [_row(rule, motion, up)], [], []
    for number in range(drop.steps + 1):
        if number:
            started = time.process_time()
            motion = rule.advance(motion)
            spent.append(time.process_time() - started)
            rows.append(_row(rule, motion, up))
            told(number / drop.steps, f"{1e3 * motion.time:.4g} ms, {motion.iterations} iterations")
        if number % drop.every == 0:
            series.add(motion)
        if number in shown:
            drawn.append((motion.time, *skin.moved(motion.displacement, material)))
    series.close()
    np.savez_compressed(
        folder / f"{name}.npz",
        triangles=skin.triangles,
        lines=skin.lines,
        up=up,
        floor=floor,
        time=np.array([one[0] for one in drawn]),
        points=np.array([one[1] for one in drawn], dtype=np.float32),
        stress=np.array([one[2] for one in drawn], dtype=np.float32),
    )
    total = np.array([row["total"] for row in rows])
    elastic = np.array([row["elastic"] for row in rows])
    touching = np.array([row["contact"] for row in rows]) > 0.0
    return {
        "drop": asdict(drop),
        **_sizes(space),
        "energies": rows,
        "kinetic": rows[0]["kinetic"],
        "drift": float(np.abs(total / rows[0]["kinetic"] - total[0] / rows[0]["kinetic"]).max()),
        "most_elastic": float(elastic.max() / rows[0]["kinetic"]),
        "lowest": min(row["height"] for row in rows),
        "impacts": int((np.diff(touching.astype(int)) == 1).sum()) + int(touching[0]),
        "least_volume": min(min(row["least_volume"]) for row in rows),
        "seconds_step": float(np.mean(spent)),
        "iterations": float(np.mean([row["iterations"] for row in rows[1:]])),
        "files": len(series.written),
    }


def _row(rule: Newmark, motion: Motion, up: np.ndarray) -> dict[str, Any]:
    """Energies, mJ, and what else is told of one moment."""
    energies = rule.energies(motion)
    least = rule.body.least_volumes(motion.displacement)
    weights = rule.body.weights
    return {
        "time": motion.time,
        **asdict(energies),
        "total": energies.total,
        "iterations": motion.iterations,
        "least_volume": [float(part.min()) for part in least],
        "flipped": int(sum((part <= 0.0).sum() for part in least)),
        "height": float(weights @ (motion.displacement @ up) / weights.sum()),
    }


def _sizes(space: Space) -> dict[str, int]:
    spline = space.spline
    return {
        "unknowns": 3 * space.size,
        "spline_elements": spline.shell.element_count * spline.parts,
        "tets": len(space.tets.elements),
        "degree": space.tets.degree,
        "degree_w": spline.shell.degree_w,
    }


class _Series:
    """Files for ParaView: displacement and von Mises stress on the body's exact elements."""

    def __init__(self, space: Space, material: Material, folder: Path, name: str) -> None:
        self.fields = FieldSpace(space)
        self.file = SolutionFile(self.fields)
        self.material = material
        self.list = folder / f"{name}.pvd"
        self.folder = folder / name
        self.folder.mkdir(parents=True, exist_ok=True)
        self.written: list[tuple[float, Path]] = []

    def add(self, motion: Motion) -> None:
        """Write one moment."""
        moved = self.fields.of(motion.displacement)
        stress = self.fields.derived(
            moved, lambda _, gradients: equivalent(gradients, self.material)[:, None]
        )
        path = self.folder / f"{len(self.written):04d}.vtu"
        fields = {"displacement": moved, "von Mises stress": stress}
        self.file.write(path, fields, time=motion.time)
        self.written.append((motion.time, path))

    def close(self) -> None:
        """Write the list."""
        write_pvd(self.list, self.written)


def equivalent(gradients: np.ndarray, material: Material) -> np.ndarray:
    """Von Mises' equivalent of Cauchy's stress, MPa, of St. Venant-Kirchhoff's material.

    Parameters
    ----------
    gradients : (m, 3, 3) array
        ``[:, d, c]`` is the derivative of the displacement's component c along d.
    material : Material
    """
    deformation = np.swapaxes(gradients, 1, 2) + np.eye(3)
    strain = 0.5 * (np.swapaxes(deformation, 1, 2) @ deformation - np.eye(3))
    stress = 2.0 * material.shear * strain
    stress += material.lame * np.trace(strain, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    cauchy = deformation @ stress @ np.swapaxes(deformation, 1, 2)
    cauchy /= np.linalg.det(deformation)[:, None, None]
    rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    return von_mises(cauchy[:, rows, columns])


@dataclass(frozen=True)
class Skin:
    """The body's surface as triangles, and the lines between its knot spans.

    Attributes
    ----------
    space : CollocationSpace or NitscheSpace
    basis : (m, size) sparse matrix
        Functions of the coupled unknowns at the m points.
    slopes : three (m, size) sparse matrices
    triangles : (t, 3) int array
    lines : (n, 2) int array
    """

    space: Space
    basis: Any
    slopes: tuple[Any, ...]
    triangles: np.ndarray
    lines: np.ndarray

    @classmethod
    def of(cls, space: Space) -> Skin:
        """Of the outer boundary of a space."""
        places, triangles, lines, count = [], [], [], 0
        for number, patch in enumerate(space.spline.shell.surface.patches):
            u, v = (_fine(bspline.breakpoints(knots)) for knots in patch.knots)
            at = np.stack(np.meshgrid(u, v, indexing="ij"), axis=-1)
            grid = count + np.arange(len(u) * len(v)).reshape(len(u), len(v))
            a, b, c, d = (
                grid[i : len(u) - 1 + i, k : len(v) - 1 + k].ravel()
                for i, k in ((0, 0), (1, 0), (1, 1), (0, 1))
            )
            triangles += [np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)]
            for along in (grid[::CELLS], grid.T[::CELLS]):
                lines.append(np.stack([along[:, :-1], along[:, 1:]], axis=-1).reshape(-1, 2))
            places.append((np.full(grid.size, number), at.reshape(-1, 2)))
            count += grid.size
        patch, uv = (np.concatenate(column) for column in zip(*places, strict=True))
        spline, w = space.spline, np.zeros(count)
        basis = spline.basis_at(patch, uv, w)
        slopes = tuple(spline.gradients_at(patch, uv, w))
        return cls(space, basis, slopes, np.concatenate(triangles), np.concatenate(lines))

    def moved(self, displacement: np.ndarray, material: Material) -> tuple[np.ndarray, np.ndarray]:
        """Points (m, 3), mm, and von Mises stress (m,), MPa."""
        spline = self.space.spline
        shell, _ = self.space.parts(displacement)
        gradients = np.stack([slope @ shell for slope in self.slopes], axis=1)
        points = self.basis @ (spline.control_points + shell)
        return points, equivalent(gradients, material)


def _fine(lines: np.ndarray) -> np.ndarray:
    share = np.arange(CELLS) / CELLS
    return np.append((lines[:-1, None] + np.diff(lines)[:, None] * share).ravel(), lines[-1])


def flown(space: Space, rule: str, steps: int, told: Progress) -> dict[str, Any]:
    """Throw a body that turns, stretches and swings; tell how momenta and energy are kept.

    It turns by more than a radian, and its own shear waves pass a step in its largest extent's
    twentieth part.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
    rule : str
        Of `Newmark`.
    steps : int
    told : callable
    """
    material, density = Material(0.1, 0.3), 1e-9
    body = Hyperelastic(space, material, density)
    x = body.reference
    weights = body.weights
    middle = weights @ x / weights.sum()
    size = float(np.ptp(x, axis=0).max())
    speed = float(np.sqrt(material.shear / density))
    turn = 2.0 * speed / size * np.array([0.15, 0.95, 0.25])
    velocity = np.cross(turn, x - middle)
    velocity += 0.6 * speed / size * (x - middle) * [1.0, -0.5, 0.2] + 0.1 * speed
    motion = Newmark(body, 0.05 * size / speed, rule=rule, tolerance=1e-11)
    now = start = motion.start(velocity)
    flow, spin = motion.momentum(start)
    energy = motion.energies(start).total
    rows = []
    for number in range(steps):
        now = motion.advance(now)
        energies = motion.energies(now)
        found = motion.momentum(now)
        rows.append(
            {
                "time": now.time,
                "linear": float(np.linalg.norm(found[0] - flow) / np.linalg.norm(flow)),
                "angular": float(np.linalg.norm(found[1] - spin) / np.linalg.norm(spin)),
                "energy": energies.total / energy - 1.0,
                "elastic": energies.elastic / energy,
            }
        )
        told((number + 1) / steps, f"{number + 1} steps")
    return {
        "rule": rule,
        **_sizes(space),
        "steps": steps,
        "turned": float(np.linalg.norm(turn) * now.time),
        **{word: max(abs(row[word]) for row in rows) for word in ("linear", "angular", "energy")},
        "elastic": max(row["elastic"] for row in rows),
        "rows": rows,
    }


def sphere_frequencies(poisson: float) -> list[tuple[str, float, int]]:
    """Free sphere (Lamb 1882): name, omega R / c_s and multiplicity of its slowest modes.

    Roots of the characteristic equations of Eringen and Suhubi, Elastodynamics II, 1975.

    Parameters
    ----------
    poisson : float
    """
    ratio = float(np.sqrt((1.0 - 2.0 * poisson) / (2.0 - 2.0 * poisson)))

    def torsion(n: int, x: np.ndarray | float) -> np.ndarray | float:
        return (n - 1) * spherical_jn(n, x) - x * spherical_jn(n + 1, x)

    def spheroid(n: int, k: np.ndarray | float) -> np.ndarray | float:
        h = ratio * k
        jh, jk, jh1, jk1 = (spherical_jn(m, x) for m in (n, n + 1) for x in (h, k))
        a = (n * n - n - k * k / 2) * jh + 2 * h * jh1
        if n == 0:
            return a
        b = n * (n + 1) * ((n - 1) * jk - k * jk1)
        c = (n - 1) * jh - h * jh1
        return a * ((n * n - 1 - k * k / 2) * jk + k * jk1) - b * c

    found = []
    x = np.linspace(0.5, 6.0, 2000)
    for letter, function, orders in (("T", torsion, (2, 3)), ("S", spheroid, (0, 1, 2, 3))):
        for n in orders:
            values = function(n, x)
            crossing = np.flatnonzero(values[:-1] * values[1:] < 0.0)[0]
            root = brentq(lambda k, n=n, f=function: f(n, k), x[crossing], x[crossing + 1])
            found.append((f"{letter}{n}", float(root), 2 * n + 1))
    return sorted(found, key=lambda row: row[1])


def swung(space: Space, poisson: float) -> dict[str, Any]:
    """Frequencies of a free sphere of radius 1 mm beside the exact ones.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
        Of the sphere.
    poisson : float
    """
    exact = sphere_frequencies(poisson)
    # mu = 1 MPa and 1 t/mm³, so that omega is omega R / c_s
    material = Material(2.0 * (1.0 + poisson), poisson)
    count = 6 + sum(number for _, _, number in exact[:5])
    started = time.process_time()
    modes = modal(space, material, 1.0, count)
    spent = time.process_time() - started
    rows, first = [], 6
    for name, omega, number in exact[:5]:
        found = modes.angular[first : first + number]
        off = float(np.abs(found / omega - 1.0).max())
        rows.append({"mode": name, "exact": omega, "mean": float(found.mean()), "off": off})
        first += number
    return {
        **_sizes(space),
        "modes": rows,
        "rigid": float(modes.angular[:6].max()),
        "off": max(row["off"] for row in rows),
        "seconds_modes": spent,
    }


def at_rest(space: Space) -> dict[str, Any]:
    """Energy of rigid motions, as a share of that of a stretch of the same size.

    Parameters
    ----------
    space : CollocationSpace or NitscheSpace
    """
    material = Material(1.0, 0.3)
    linear = Hyperelastic(space, material, 1e-9, law="linear")
    x = coefficient_points(space)
    x = x - x.mean(axis=0)
    size = float(np.abs(x).max())
    stretch = linear.energy(x / size)
    motions = rigid_motions(x)
    rigid = [abs(linear.energy(u / np.abs(u).max())) for u in motions]
    body = Hyperelastic(space, material, 1e-9)
    turned = max(abs(body.energy(_turned(x, axis, 2.0))) for axis in np.eye(3))
    return {
        **_sizes(space),
        "linear": max(rigid) / stretch,
        "svk": turned / body.energy(0.5 * x),
    }


def _turned(x: np.ndarray, axis: Sequence[float], angle: float) -> np.ndarray:
    """Displacement of points that are turned about an axis through the origin."""
    cross = np.cross(np.eye(3), -np.asarray(axis, dtype=float))
    turn = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return x @ (turn - np.eye(3)).T
