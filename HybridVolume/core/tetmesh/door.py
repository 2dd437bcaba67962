# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Fill closed triangle surfaces with tetrahedra, and believe no mesher without a check."""

from __future__ import annotations

import importlib.util
import logging
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from ...errors import MesherError, SetupError
from .mesh import FACES, TetMesh, row_keys, tet_volumes

log = logging.getLogger(__name__)

CONFORMING = ("gmsh", "netgen")
GPL = ("gmsh",)
REMEDY = "look for self-intersections or refine the surface"

_elsewhere: list[str] = []
"""Interpreters whose meshers are taken where this one has none, the last one first."""


@contextmanager
def meshers_of(python: str) -> Iterator[None]:
    """Take the meshers of another interpreter where this one has none.

    Parameters
    ----------
    python : str
        Such as the worker's, where this is FreeCAD's own.
    """
    _elsewhere.append(python)
    try:
        yield
    finally:
        _elsewhere.pop()


def free_only() -> bool:
    """Whether the environment forbids parts under the GPL (``HYBRIDVOLUME_FREE_ONLY=1``)."""
    return os.environ.get("HYBRIDVOLUME_FREE_ONLY", "") not in ("", "0")


def available_engines(*, free: bool | None = None) -> tuple[str, ...]:
    """Meshers that are installed, the quickest conforming one first.

    Parameters
    ----------
    free : bool, optional
        Leave out those under the GPL; by default as :func:`free_only` says.
    """
    free = free_only() if free is None else free
    return tuple(
        name
        for name in (*CONFORMING, "pytetwild")
        if not (free and name in GPL) and importlib.util.find_spec(name) is not None
    )


def enclosed_volume(vertices: np.ndarray, triangles: np.ndarray) -> float:
    """Volume inside closed triangles that are oriented outward, mm³."""
    x = vertices[triangles] - vertices[triangles].mean(axis=(0, 1))
    return float(np.einsum("ti,ti->", x[:, 0], np.cross(x[:, 1], x[:, 2])) / 6.0)


def fill(
    vertices: np.ndarray,
    triangles: np.ndarray,
    *,
    facets: np.ndarray | None = None,
    max_size: float | None = None,
    grading: float | None = None,
    engine: str = "auto",
    free: bool | None = None,
    optimise: bool = True,
    time_limit: float = 120.0,
) -> TetMesh:
    """Tetrahedra inside closed triangle surfaces.

    Parameters
    ----------
    vertices : (n, 3) array
        mm; each is used by a triangle or a facet.
    triangles : (t, 3) int array
        One or several closed surfaces, oriented out of the material (so that cavities look into
        themselves).
    facets : (f, 3) int array, optional
        Triangles inside that become faces of tetrahedra.
    max_size : float, optional
        Wanted largest edge inside, mm.
    grading : float, optional
        How many mm the edges grow by a mm away from the surface (0 to 1); by default as the mesher
        does it.
    engine : {"auto", "gmsh", "netgen", "pytetwild"}
        ``"auto"`` tries the installed conforming ones in turn. Only pytetwild accepts surfaces
        that cut themselves; its boundary is not the given one.
    free : bool, optional
        Use nothing under the GPL; by default as :func:`free_only` says.
    optimise : bool
        Let the mesher improve the shape of its tetrahedra.
    time_limit : float
        Seconds for each mesher.

    Returns
    -------
    TetMesh
        ``engine`` says which one ran. With a conforming engine the given vertices come first, bit
        for bit, the given triangles are the boundary, the facets are faces, and the volume agrees.

    Raises
    ------
    SetupError
        No mesher is installed.
    MesherError
        Every mesher failed; the sentence holds the reason of each.
    """
    vertices = np.ascontiguousarray(vertices, dtype=float)
    triangles = np.ascontiguousarray(triangles, dtype=np.int64).reshape(-1, 3)
    facets = np.zeros((0, 3), dtype=np.int64) if facets is None else np.asarray(facets, np.int64)
    _check_input(vertices, triangles, facets)
    engines = _engines(engine, free)
    options = {
        "max_size": np.nan if max_size is None else max_size,
        "grading": np.nan if grading is None else grading,
        "optimise": optimise,
    }
    reasons = []
    for name in engines:
        started = time.perf_counter()
        try:
            mesh = _run(name, vertices, triangles, facets, options, time_limit)
        except MesherError as error:
            log.info("%s", error.message)
            reasons.append(error.message)
            continue
        log.info("%s: %d tetrahedra in %.2f s", name, len(mesh), time.perf_counter() - started)
        return mesh
    raise MesherError("; ".join(reasons), remedy=REMEDY)


def _engines(engine: str, free: bool | None) -> Sequence[str]:
    available = available_engines(free=free)
    if engine == "auto":
        engines = [name for name in available if name in CONFORMING]
        if not engines and _elsewhere:
            free = free_only() if free is None else free
            engines = [name for name in CONFORMING if not (free and name in GPL)]
    elif engine in (*CONFORMING, "pytetwild"):
        engines = [engine] if engine in available else []
    else:
        raise ValueError(f"no mesher is called {engine!r}")
    if not engines:
        wanted = "netgen" if engine == "auto" else engine
        raise SetupError(
            f"the mesher {wanted} is not installed or not allowed",
            remedy="make the environment again, or install netgen-mesher",
        )
    return engines


def _check_input(vertices: np.ndarray, triangles: np.ndarray, facets: np.ndarray) -> None:
    if not len(triangles) or not np.isfinite(vertices).all():
        raise MesherError("no triangles, or coordinates that are no numbers", remedy=REMEDY)
    n = len(vertices)
    used = np.zeros(n, dtype=bool)
    used[triangles] = True
    used[facets] = True
    if not used.all():
        raise ValueError(f"{int((~used).sum())} vertices belong to no triangle")
    directed = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
    forward = np.sort(directed[:, 0] * n + directed[:, 1])
    backward = np.sort(directed[:, 1] * n + directed[:, 0])
    if not np.array_equal(forward, backward) or (np.diff(forward) == 0).any():
        raise MesherError("the triangles do not close the body", remedy=REMEDY)


def interpreter() -> str:
    """The Python that runs this code, also where it is embedded in another program."""
    path = Path(sys.executable or "")
    if path.name.lower().startswith("python"):
        return str(path)
    for folder in (Path(sys.exec_prefix), Path(sys.exec_prefix) / "bin"):
        for name in (f"python{sys.version_info[0]}.{sys.version_info[1]}", "python3", "python.exe"):
            if (folder / name).is_file():
                return str(folder / name)
    raise SetupError("no Python interpreter was found to run the mesher in")


def _run(
    name: str,
    vertices: np.ndarray,
    triangles: np.ndarray,
    facets: np.ndarray,
    options: dict,
    time_limit: float,
) -> TetMesh:
    root = Path(__file__).resolve().parents[3]
    # meshers have absolute tolerances; a power of two changes no bit but the exponent
    scale = 2.0 ** np.round(np.log2(64.0 / max(float(np.ptp(vertices, axis=0).max()), 1e-300)))
    sizes = {**options, "max_size": options["max_size"] * scale}
    environment = dict(os.environ)
    path = [str(root), *(p for p in environment.get("PYTHONPATH", "").split(os.pathsep) if p)]
    environment["PYTHONPATH"] = os.pathsep.join(path)
    environment["PYTHONSAFEPATH"] = "1"
    with tempfile.TemporaryDirectory(prefix="hybridvolume-") as temporary:
        folder = Path(temporary)
        np.savez(
            folder / "input.npz",
            vertices=vertices * scale,
            triangles=triangles,
            facets=facets,
            **sizes,
        )
        python = _elsewhere[-1] if name not in available_engines() and _elsewhere else interpreter()
        command = [python, "-m", f"{__package__}.run", str(folder), name]
        with open(folder / "log.txt", "wb") as output:
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
                env=environment,
                cwd=folder,
            )
            try:
                code = process.wait(time_limit)
            except subprocess.TimeoutExpired:
                raise MesherError(
                    f"{name} gave no answer within {time_limit:g} s", figure=time_limit
                ) from None
            finally:
                if process.poll() is None:
                    process.kill()
                    process.wait()
        said = (folder / "log.txt").read_text(encoding="utf-8", errors="replace")
        log.debug("%s said: %s", name, said[-2000:])
        answer = folder / "output.npz"
        if not answer.is_file():
            raise MesherError(_reason(name, code, folder / "error.txt", said))
        with np.load(answer) as data:
            points, tets = data["vertices"] / scale, data["tets"]
    return _checked(name, vertices, triangles, facets, points, tets)


def _reason(name: str, code: int, error: Path, said: str) -> str:
    if error.is_file():
        text = " ".join(error.read_text(encoding="utf-8").split())
        return f"{name} failed ({text[:200]})"
    if code < 0:
        return f"{name} crashed (signal {-code})"
    lines = [line for line in said.splitlines() if line.strip()]
    return f"{name} ended with code {code} ({(lines or ['no message'])[-1].strip()[:200]})"


def _checked(
    name: str,
    vertices: np.ndarray,
    triangles: np.ndarray,
    facets: np.ndarray,
    points: np.ndarray,
    tets: np.ndarray,
) -> TetMesh:
    """Orient the tetrahedra and check everything that was promised."""
    if not len(tets):
        raise MesherError(f"{name} gave no tetrahedra", figure=0)
    if not np.isfinite(points).all():
        raise MesherError(f"{name} gave coordinates that are no numbers")
    exact = name in CONFORMING
    if exact:
        points, tets = _given_first(name, vertices, points, tets)
    volumes = tet_volumes(points, tets)
    tets = np.where((volumes < 0.0)[:, None], tets[:, [0, 1, 3, 2]], tets)
    flat = int((volumes == 0.0).sum())
    if flat:
        raise MesherError(f"{name} gave {flat} tetrahedra without volume", figure=flat)
    tets, points = _compact(points, tets, len(vertices) if exact else 0)
    mesh = TetMesh(points, tets, name, exact)
    if not exact:
        return mesh
    n = len(points)
    boundary = np.sort(row_keys(mesh.boundary_triangles, n))
    if not np.array_equal(boundary, np.sort(row_keys(triangles, n))):
        kept = np.isin(row_keys(triangles, n), boundary).sum()
        raise MesherError(
            f"{name} kept {kept} of {len(triangles)} boundary triangles", figure=float(kept)
        )
    if len(facets):
        faces = np.unique(row_keys(tets[:, FACES].reshape(-1, 3), n))
        missing = int((~np.isin(row_keys(facets, n), faces)).sum())
        if missing:
            raise MesherError(f"{name} lost {missing} inner triangles", figure=missing)
    wanted = enclosed_volume(vertices, triangles)
    if not abs(mesh.volume - wanted) <= 1e-9 * abs(wanted):
        raise MesherError(
            f"{name} filled {mesh.volume:.9g} of {wanted:.9g} mm³", figure=mesh.volume - wanted
        )
    return mesh


def _given_first(
    name: str, vertices: np.ndarray, points: np.ndarray, tets: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Number the mesher's points so that the given vertices come first, bit for bit."""
    given = len(vertices)
    if len(points) >= given and np.array_equal(points[:given], vertices):
        return points, tets
    both = np.ascontiguousarray(np.vstack([vertices, points])) + 0.0  # -0.0 becomes 0.0
    rows = both.view(np.dtype((np.void, both.dtype.itemsize * 3))).ravel()
    _, label = np.unique(rows, return_inverse=True)
    place = np.full(label.max() + 1, -1)
    place[label[given:]] = np.arange(len(points))
    found = place[label[:given]]
    if (found < 0).any() or len(np.unique(found)) < given:
        lost = given - len(np.unique(found[found >= 0]))
        raise MesherError(f"{name} lost {lost} of {given} given vertices", figure=lost)
    rest = np.setdiff1d(np.arange(len(points)), found)
    order = np.concatenate([found, rest])
    number = np.empty(len(points), dtype=np.int64)
    number[order] = np.arange(len(points))
    return np.vstack([vertices, points[rest]]), number[tets]


def _compact(points: np.ndarray, tets: np.ndarray, keep: int) -> tuple[np.ndarray, np.ndarray]:
    """Drop points that no tetrahedron uses, except the first ``keep``."""
    used = np.zeros(len(points), dtype=bool)
    used[:keep] = True
    used[tets] = True
    number = np.cumsum(used) - 1
    return number[tets], points[used]
