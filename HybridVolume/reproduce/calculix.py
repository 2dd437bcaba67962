# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Linear elasticity through CalculiX, from arrays to arrays, with all digits of the solution.

CalculiX prints six digits (``.frd``) or seven (``.dat``). The file from which it could go on with a
further step holds displacements and stresses at the Gauss points as it computed them, in double
precision; they are read from there and compared with what is printed. Errors of meshes that are
compared with one another are then those of the meshes, and a patch test has room below 1e-6.
"""

from __future__ import annotations

import logging
import os
import re
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from HybridVolume.core.elements import CALCULIX_NAMES, FACES, reference
from HybridVolume.core.recovery import Material
from HybridVolume.errors import FaultError, InputError, SetupError, WorkerError

logger = logging.getLogger(__name__)

Elements = Sequence[tuple[str, np.ndarray]]
"""Kinds of `HybridVolume.core.elements` and their connectivities (m, k), in the order of Abaqus."""

GAUSS_POINTS = {"tet4": 1, "tet10": 4, "penta6": 2, "penta15": 9, "hex8": 8, "hex20": 27}
"""Points at which CalculiX has the stress of each kind."""

_JOB = "case"
_PRINTED = 6e-6
"""Relative error of a number of six digits."""


@dataclass(frozen=True)
class Solution:
    """What CalculiX found.

    Attributes
    ----------
    displacement : (n, 3) array
        mm, in double precision; not a number at nodes of no element.
    stress : (n, 6) array
        MPa, as CalculiX extrapolates it to the nodes, six digits; components in the order of
        `HybridVolume.core.recovery.COMPONENTS`.
    force : (n, 3) array
        N: what acts on each node from outside, reactions of supports included, six digits.
    gauss_stress : tuple of (m, p, 6) arrays
        MPa, in double precision, of every block of elements at its Gauss points.
    volume : float
        mm³: the sum over CalculiX's Gauss points.
    warnings : tuple of str
        What CalculiX warned of.
    """

    displacement: np.ndarray
    stress: np.ndarray
    force: np.ndarray
    gauss_stress: tuple[np.ndarray, ...]
    volume: float
    warnings: tuple[str, ...] = ()


def solve(
    nodes: np.ndarray,
    elements: Elements,
    material: Material,
    prescribed: np.ndarray,
    *,
    forces: np.ndarray | None = None,
    pressures: Sequence[tuple[np.ndarray, float | np.ndarray]] = (),
    density: float = 0.0,
    gravity: Sequence[float] = (0.0, 0.0, 0.0),
    equations: Sequence[Sequence[tuple[int, int, float]]] = (),
    folder: str | os.PathLike | None = None,
    time_limit: float = 600.0,
    solver: str = "SPOOLES",
) -> Solution:
    """Solve one linear static step.

    Parameters
    ----------
    nodes : (n, 3) array
        mm.
    elements : sequence of (str, (m, k) int array)
    material : Material
        Of all elements.
    prescribed : (n, 3) array
        Displacements, mm; not a number where a node is free.
    forces : (n, 3) array, optional
        N.
    pressures : sequence of ((m, 3) or (m, 6) int array, float or (m,) array)
        Outer faces of elements by their nodes, in any order, and the pressure on them in MPa,
        positive towards the body.
    density : float
        t/mm³
    gravity : (3,) floats
        mm/s², used where there is a density.
    equations : sequence of sequences of (node, axis, factor)
        Sums of displacements that are zero; the first of each depends on the others.
    folder : path, optional
        Where the deck and CalculiX's files stay; nothing stays otherwise.
    time_limit : float
        Seconds.
    solver : str
        CalculiX's name of the solver of the linear system.

    Raises
    ------
    SetupError
        CalculiX is not installed.
    InputError
        Arrays do not belong together, or a face is no outer face of an element.
    WorkerError
        CalculiX ended with an error, or not in time, or did not take every element.
    FaultError
        Its files are not what they should be.
    """
    program = shutil.which("ccx")
    if program is None:
        raise SetupError("CalculiX (ccx) is not installed", remedy="install calculix-ccx")
    nodes, prescribed = np.asarray(nodes, dtype=float), np.asarray(prescribed, dtype=float)
    forces = np.zeros_like(nodes) if forces is None else np.asarray(forces, dtype=float)
    elements = [(kind, np.asarray(c, dtype=np.int64)) for kind, c in elements if len(c)]
    _check(nodes, elements, prescribed, forces)
    if not equations:
        used = np.unique(np.concatenate([connectivity.ravel() for _, connectivity in elements]))
        check_support(nodes[used], prescribed[used])
    loads = element_loads(elements, pressures)
    with ExitStack() as stack:
        if folder is None:
            folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="ccx-"))
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        for old in folder.glob(f"{_JOB}.*"):
            old.unlink()
        with open(folder / f"{_JOB}.inp", "w", encoding="ascii") as file:
            file.writelines(
                line + "\n"
                for part in (
                    _model(nodes, elements, material, density, equations),
                    _step(
                        prescribed,
                        forces,
                        loads,
                        np.asarray(gravity, dtype=float) if density else np.zeros(3),
                        solver,
                    ),
                )
                for line in part
            )
        said = _run(program, folder, time_limit)
        restart = folder / f"{_JOB}.rout"
        try:
            found = _read(folder, restart, nodes, elements)
        finally:
            restart.unlink(missing_ok=True)
    return Solution(*found, _warnings(said))


def _check(
    nodes: np.ndarray, elements: Elements, prescribed: np.ndarray, forces: np.ndarray
) -> None:
    if not elements:
        raise InputError("there are no elements")
    for kind, connectivity in elements:
        if kind not in GAUSS_POINTS or connectivity.shape[1] != len(reference(kind).nodes):
            raise InputError(f"CalculiX has no {kind} with {connectivity.shape[1]} nodes")
        if connectivity.min() < 0 or connectivity.max() >= len(nodes):
            raise InputError(f"a {kind} has a node that is not there")
    if prescribed.shape != nodes.shape or forces.shape != nodes.shape:
        raise InputError(f"displacements or forces do not belong to {len(nodes)} nodes")
    if not (np.isfinite(nodes).all() and np.isfinite(forces).all()):
        raise InputError("coordinates or forces are not finite numbers")


def check_support(nodes: np.ndarray, prescribed: np.ndarray) -> None:
    """Refuse a body that is free to move: CalculiX answers with numbers all the same.

    Parameters
    ----------
    nodes : (n, 3) array
        mm.
    prescribed : (n, 3) array
        As of `solve`.

    Raises
    ------
    InputError
    """
    node, axis = np.nonzero(~np.isnan(prescribed))
    x = nodes - nodes.mean(axis=0)
    x = x[node] / np.abs(x).max()
    # what each rigid motion does at the components that are held
    moves = np.eye(3)[axis]
    motions = np.concatenate([moves, np.cross(x, moves)], axis=1)
    if np.linalg.matrix_rank(motions, tol=1e-6 * np.sqrt(len(motions) + 1.0)) < 6:
        raise InputError(
            f"{len(node)} prescribed displacements do not hold the body",
            remedy="prescribe six at three nodes at least",
        )


def element_loads(
    elements: Elements, pressures: Sequence[tuple[np.ndarray, float | np.ndarray]]
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Pressures on faces by their nodes as loads on sides of elements.

    Parameters
    ----------
    elements : sequence of (str, (m, k) int array)
    pressures : as of `solve`

    Returns
    -------
    list of ((m,), (m,), (m,)) arrays
        Numbers of elements and of their sides, both from 1, and pressures in MPa.

    Raises
    ------
    InputError
        A face belongs to no element, or to two.
    """
    if not pressures:
        return []
    count = 1 + max(int(connectivity.max()) for _, connectivity in elements)
    keys, owners, sides = [], [], []
    start = 1
    for kind, connectivity in elements:
        for side, face in enumerate(FACES.get(kind, ()), 1):
            keys.append(_keys(connectivity[:, list(face)], count))
            owners.append(start + np.arange(len(connectivity)))
            sides.append(np.full(len(connectivity), side))
        start += len(connectivity)
    if not keys:
        raise InputError("pressure on elements whose faces are not known")
    key, owner, side = (np.concatenate(part) for part in (keys, owners, sides))
    order = np.lexsort(key.T)
    key, owner, side = key[order], owner[order], side[order]
    position = {tuple(row): n for n, row in enumerate(key.tolist())}
    double = {tuple(row) for row in key[1:][(key[1:] == key[:-1]).all(axis=1)].tolist()}
    loads = []
    for faces, pressure in pressures:
        rows = [tuple(row) for row in _keys(np.asarray(faces), count).tolist()]
        outer = [position.get(row) for row in rows]
        lost = sum(n is None for n in outer) + sum(row in double for row in rows)
        if lost:
            raise InputError(f"pressure on {lost} faces that are no outer faces of elements")
        place = np.array(outer, dtype=int)
        loads.append((owner[place], side[place], np.broadcast_to(pressure, len(rows))))
    return loads


def _keys(faces: np.ndarray, count: int) -> np.ndarray:
    """Corners of triangles or quads in one order, (m, 4); a triangle's last is ``count``."""
    corners = 3 if faces.shape[1] in (3, 6) else 4
    rows = np.full((len(faces), 4), count, dtype=np.int64)
    rows[:, :corners] = np.sort(faces[:, :corners], axis=1)
    return rows


def _model(
    nodes: np.ndarray,
    elements: Elements,
    material: Material,
    density: float,
    equations: Sequence[Sequence[tuple[int, int, float]]],
) -> Iterator[str]:
    yield "*NODE, NSET=NALL"
    # CalculiX reads 20 characters of a number
    yield from (f"{n},{x:.13e},{y:.13e},{z:.13e}" for n, (x, y, z) in enumerate(nodes.tolist(), 1))
    start = 1
    for kind, connectivity in elements:
        yield f"*ELEMENT, TYPE={CALCULIX_NAMES[kind]}, ELSET=EALL"
        for number, row in enumerate((connectivity + 1).tolist(), start):
            members = [str(number), *map(str, row)]
            # at most 16 entries a line; a comma at its end goes on
            for first in range(0, len(members), 16):
                more = "," if first + 16 < len(members) else ""
                yield ",".join(members[first : first + 16]) + more
        start += len(connectivity)
    yield "*ELSET, ELSET=ELAST"
    yield str(start - 1)
    for terms in equations:
        yield "*EQUATION"
        yield str(len(terms))
        yield from (f"{node + 1},{axis + 1},{factor:.13e}" for node, axis, factor in terms)
    yield "*MATERIAL, NAME=MATERIAL"
    yield "*ELASTIC"
    yield f"{material.young:.13e},{material.poisson:.13e}"
    if density:
        yield "*DENSITY"
        yield f"{density:.13e}"
    yield "*SOLID SECTION, ELSET=EALL, MATERIAL=MATERIAL"


def _step(
    prescribed: np.ndarray,
    forces: np.ndarray,
    loads: Sequence[tuple[np.ndarray, np.ndarray, np.ndarray]],
    gravity: np.ndarray,
    solver: str,
) -> Iterator[str]:
    yield "*RESTART, WRITE, FREQUENCY=1"
    yield "*STEP"
    yield f"*STATIC, SOLVER={solver}"
    given = np.argwhere(~np.isnan(prescribed))
    if len(given):
        yield "*BOUNDARY"
        for (node, axis), value in zip(
            (given + 1).tolist(), prescribed[tuple(given.T)].tolist(), strict=True
        ):
            yield f"{node},{axis},{axis},{value:.13e}"
    loaded = np.argwhere(forces)
    if len(loaded):
        yield "*CLOAD"
        for (node, axis), value in zip(
            (loaded + 1).tolist(), forces[tuple(loaded.T)].tolist(), strict=True
        ):
            yield f"{node},{axis},{value:.13e}"
    size = float(np.linalg.norm(gravity))
    if loads or size:
        yield "*DLOAD"
    for owner, side, pressure in loads:
        for one in zip(owner.tolist(), side.tolist(), pressure.tolist(), strict=True):
            yield "{},P{},{:.13e}".format(*one)
    if size:
        direction = ",".join(f"{part:.13e}" for part in (gravity / size).tolist())
        yield f"EALL,GRAV,{size:.13e},{direction}"
    yield "*NODE FILE"
    yield "U,RF"
    yield "*EL FILE"
    yield "S"
    yield "*EL PRINT, ELSET=ELAST"
    yield "S"
    yield "*EL PRINT, ELSET=EALL, TOTALS=ONLY"
    yield "EVOL"
    yield "*END STEP"


def _run(program: str, folder: Path, time_limit: float) -> str:
    """Run CalculiX and return what it said."""
    variables = {**os.environ}
    variables.setdefault("OMP_NUM_THREADS", "1")
    try:
        done = subprocess.run(
            [program, _JOB],
            cwd=folder,
            env=variables,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            timeout=time_limit,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise WorkerError(
            f"CalculiX did not finish within {time_limit:g} s",
            figure=time_limit,
            remedy="give it more time or a coarser mesh",
        ) from None
    said = done.stdout.decode("utf-8", "replace")
    errors = re.findall(r"\*ERROR[^\n]*(?:\n +\S[^\n]*)?", said)
    if done.returncode or errors or "Job finished" not in said:
        reason = " ".join((errors[0] if errors else said[-300:]).split())
        raise WorkerError(f"CalculiX ended with {done.returncode}: {reason or 'no word'}")
    return said


def _warnings(said: str) -> tuple[str, ...]:
    """Warnings, each once."""
    found = re.findall(r"\*WARNING[^\n]*(?:\n +[a-z][^\n]*)?", said)
    return tuple(dict.fromkeys(" ".join(text.split()) for text in found))


def _read(folder: Path, restart: Path, nodes: np.ndarray, elements: Elements) -> tuple:
    """Displacement, stress, forces, stress at the Gauss points, and volume."""
    used = np.unique(np.concatenate([connectivity.ravel() for _, connectivity in elements]))
    count = sum(len(connectivity) for _, connectivity in elements)
    frd = (folder / f"{_JOB}.frd").read_bytes()
    taken = re.search(rb"^ +3C +(\d+)", frd, re.MULTILINE)
    if taken is None or int(taken[1]) != count:
        raise WorkerError(f"CalculiX took {int(taken[1]) if taken else 0} of {count} elements")
    numbers, printed = frd_block(frd, "DISP", 3)
    if not np.array_equal(numbers, used + 1):
        raise WorkerError(f"CalculiX has displacements at {len(numbers)} of {len(used)} nodes")
    blocks = {name: np.full((len(nodes), width), np.nan) for name, width in
              (("STRESS", 6), ("FORC", 3))}  # fmt: skip
    for name, values in blocks.items():
        numbers, rows = frd_block(frd, name, values.shape[1])
        values[numbers - 1] = rows
    # sxx syy szz sxy syz szx
    stress = blocks["STRESS"][:, [0, 1, 2, 3, 5, 4]]
    if np.isnan(stress[used]).any():
        raise WorkerError("CalculiX has no stress at some nodes")
    last, volume = _printed(folder / f"{_JOB}.dat")
    displacement, gauss = _exact(restart, len(nodes), count, used, printed, last)
    displacement[np.setdiff1d(np.arange(len(nodes)), used)] = np.nan
    parts, start = [], 0
    for kind, connectivity in elements:
        parts.append(gauss[start : start + len(connectivity), : GAUSS_POINTS[kind]])
        start += len(connectivity)
    return displacement, stress, blocks["FORC"], tuple(parts), volume


def frd_block(frd: bytes, name: str, width: int) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of nodes (m,) and values (m, width) of one result in an ``.frd`` file.

    Raises
    ------
    FaultError
        The file has no such result, or several.
    """
    blocks = re.findall(
        rb"^ -4  " + name.encode() + rb" .*\n((?: -5 .*\n)*)((?: -1.*\n)*) -3", frd, re.MULTILINE
    )
    if len(blocks) != 1:
        raise FaultError(f"CalculiX wrote {len(blocks)} blocks of {name}")
    text = blocks[0][1]
    line = 13 + 12 * width
    rows = np.frombuffer(text, dtype=np.uint8)
    if len(rows) % (line + 1) or not (rows[line :: line + 1] == ord("\n")).all():
        # an exponent of three digits makes a line longer
        number = re.compile(rb"-?\d\.\d+E[+-]\d+")
        lines = text.splitlines()
        values = np.array([[float(x) for x in number.findall(one[13:])] for one in lines])
        return np.array([int(one[3:13]) for one in lines]), values.reshape(-1, width)
    fields = [("key", "S3"), ("node", "S10"), ("values", "S12", (width,)), ("end", "S1")]
    table = np.frombuffer(text, dtype=np.dtype(fields))
    return table["node"].astype(np.int64), table["values"].astype(float)


def _printed(path: Path) -> tuple[np.ndarray, float]:
    """Stress at the Gauss points of the last element, and the volume, from the ``.dat``."""
    text = path.read_text(encoding="ascii")
    stress = re.search(r"stresses \(.*\n\s*\n((?:\s*\d+\s+\d+(?:\s+\S+){6}\s*\n)+)", text)
    volume = re.search(r"total volume .*\n\s*\n\s*(\S+)", text)
    if stress is None or volume is None:
        raise FaultError("CalculiX did not print stress and volume")
    rows = [line.split()[2:] for line in stress[1].splitlines() if line.strip()]
    return np.array(rows, dtype=float), float(volume[1])


def _exact(
    path: Path, nodes: int, count: int, used: np.ndarray, printed: np.ndarray, last: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Displacements (n, 3) and stresses (count, points, 6) of the restart file.

    A record is known by its length and its values: they have to be those that are printed.
    """
    wanted = 32 * nodes
    found = None
    for record in _records(path):
        if found is not None:
            # the stresses follow the displacements
            gauss = np.frombuffer(record).reshape(count, -1, 6) if (
                len(record) and len(record) % (48 * count) == 0
            ) else np.zeros((count, 0, 6))  # fmt: skip
            if gauss.shape[1] >= len(last) and _agrees(gauss[-1, : len(last)], last):
                return found, gauss
            found = None
        if len(record) == wanted:
            values = np.frombuffer(record).reshape(nodes, 4)[:, 1:]
            if _agrees(values[used], printed):
                found = values.copy()
    raise FaultError("CalculiX's restart file does not hold what is printed")


def _agrees(exact: np.ndarray, printed: np.ndarray) -> bool:
    slack = _PRINTED * np.abs(printed) + 1e-14 * np.abs(printed).max(initial=0.0)
    return bool((np.abs(exact - printed) <= slack).all())


def _records(path: Path) -> Iterator[bytes]:
    """Records of a file that Fortran wrote; long ones are in parts with a negative mark."""
    with open(path, "rb") as file:
        parts: list[bytes] = []
        while mark := file.read(4):
            size = int.from_bytes(mark, "little", signed=True)
            parts.append(file.read(abs(size)))
            if len(parts[-1]) != abs(size) or len(file.read(4)) != 4:
                raise FaultError("CalculiX's restart file ends too early")
            if size >= 0:
                yield b"".join(parts)
                parts = []
