# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""A body's outline and geometry, and its cover, as files between FreeCAD and the mesher's process.

The process is ``python -m HybridVolume.core.covering.exchange FOLDER``. It reads ``body.brep``,
``body.npz`` and ``task.json``, tells its progress a JSON object a line as :mod:`...protocol` has
it, and writes ``cover.npz``; or ``error.json``, and ends with 2 where the body is refused, with 1
where the fault is our own. It ends itself when its time is over, when who asked is gone, and says
so when the memory is too small.
"""

from __future__ import annotations

import json
import logging
import sys
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np

from ...errors import FaultError, HybridVolumeError, InputError, SetupError, from_dict
from ..surface import SplineFace
from ..tetmesh.run import end_with_parent
from .cover import Cover, cover_body
from .effort import Effort
from .geometry import SplineCurve
from .limits import end_after, end_with_input, limit_memory, too_large, too_long
from .outline import Outline
from .quad_mesh import Meshers

logger = logging.getLogger(__name__)

BREP, BODY, TASK, COVER, ERROR = (
    *("body.brep", "body.npz", "task.json"),
    *("cover.npz", "error.json"),
)

SECONDS = 240.0
"""Longest time of the processor for a body, if the task says no other."""
WORTH = 0.15
"""No other sizes are tried when less than this share of the time is left."""
ATTEMPTS = (
    {"turn": 60.0, "share": 5.0},
    {"turn": 45.0, "share": 8.0},
    {"turn": 60.0, "share": 5.0, "first": "netgen"},
    {"turn": 30.0, "share": 12.0},
)
"""Sizes of the first quads: the largest turn of an edge in an interval, degrees, and how often an
interval goes into the diagonal; and the mesher that is asked first, if not the usual one."""


def write_body(
    folder: Path,
    outline: Outline,
    curves: Sequence[SplineCurve | None],
    surfaces: Sequence[SplineFace],
    task: Mapping[str, float],
) -> None:
    """Write what the process needs besides the solid itself.

    Parameters
    ----------
    folder : Path
    outline : Outline
    curves, surfaces : sequences
    task : mapping
        Keywords of :func:`.cover.cover_body`; ``seconds`` for all that is tried, and ``memory``,
        the most address space in bytes.
    """
    arrays = {f"outline/{f.name}": getattr(outline, f.name) for f in fields(Outline)}
    for k, curve in enumerate(curves):
        if curve is not None:
            arrays |= {f"curve/{k}/{name}": value for name, value in asdict(curve).items()}
    arrays |= _face_arrays("surface", surfaces)
    np.savez(folder / BODY, curves=len(curves), surfaces=len(surfaces), **arrays)
    (folder / TASK).write_text(json.dumps(dict(task)))


def read_body(
    folder: Path,
) -> tuple[Outline, list[SplineCurve | None], list[SplineFace], dict[str, float]]:
    """What :func:`write_body` wrote."""
    with np.load(folder / BODY) as file:
        outline = Outline(**{f.name: file[f"outline/{f.name}"] for f in fields(Outline)})
        curves = [
            SplineCurve(
                int(file[f"curve/{k}/degree"]),
                *(file[f"curve/{k}/{name}"] for name in ("knots", "control_points", "weights")),
                float(file[f"curve/{k}/tolerance"]),
            )
            if f"curve/{k}/degree" in file
            else None
            for k in range(int(file["curves"]))
        ]
        surfaces = _faces(file, "surface", int(file["surfaces"]))
    return outline, curves, surfaces, json.loads((folder / TASK).read_text())


def _face_arrays(what: str, faces: Sequence[SplineFace]) -> dict[str, np.ndarray]:
    arrays = {}
    for k, face in enumerate(faces):
        arrays |= {
            f"{what}/{k}/name": np.array(face.name),
            f"{what}/{k}/u": face.knots[0],
            f"{what}/{k}/v": face.knots[1],
            f"{what}/{k}/points": face.control_points,
            f"{what}/{k}/weights": face.weights,
            f"{what}/{k}/exact": np.array(face.exact),
        }
    return arrays


def _faces(file: Mapping[str, np.ndarray], what: str, count: int) -> list[SplineFace]:
    found = []
    for k in range(count):
        u, v, points, weights = (file[f"{what}/{k}/{name}"] for name in ("u", "v", "points",
                                                                           "weights"))  # fmt: skip
        degrees = (len(u) - points.shape[0] - 1, len(v) - points.shape[1] - 1)
        found.append(
            SplineFace(
                str(file[f"{what}/{k}/name"]), degrees, (u, v), points, weights,
                bool(file[f"{what}/{k}/exact"]),
            )
        )  # fmt: skip
    return found


def read_cover(folder: Path) -> Cover:
    """The cover that the process wrote."""
    with np.load(folder / COVER) as file:
        faces = _faces(file, "patch", int(file["patches"]))
        kinds = tuple(str(kind) for kind in file["kinds"])
        return Cover(tuple(faces), file["origin"], file["deviation"], int(file["quads"]), kinds)


def read_error(folder: Path) -> HybridVolumeError | None:
    """Why the process gave no cover; None where it did not say."""
    path = folder / ERROR
    return from_dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else None


def main(arguments: Sequence[str] | None = None) -> int:
    """Cover the body in a folder."""
    folder = Path((sys.argv[1:] if arguments is None else arguments)[0])
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(message)s")
    outline, curves, surfaces, task = read_body(folder)
    seconds = float(task.pop("seconds", SECONDS))
    where = ["preparing"]

    def refused(error: HybridVolumeError) -> int:
        part = folder / f"{ERROR}.part"
        part.write_text(json.dumps(error.to_dict()), encoding="utf-8")
        part.replace(folder / ERROR)
        return 2 if isinstance(error, InputError) else 1

    def progress(share: float, words: str) -> None:
        where[0] = words
        line = {"stage": "covering", "fraction": share, "text": words}
        print(json.dumps(line), flush=True)

    end_with_parent()
    end_with_input()
    limit = end_after(seconds, lambda: refused(too_long(seconds, where[0])))
    most = limit_memory(task.pop("memory", None))
    try:
        cover = _cover(folder, outline, curves, surfaces, task, 0.9 * seconds, progress)
    except MemoryError:
        return refused(too_large(most))
    except HybridVolumeError as error:
        return refused(error)
    except Exception as fault:
        traceback.print_exc()
        return refused(_fault(fault))
    finally:
        limit.set()
    part = folder / f"part-{COVER}"
    np.savez(
        part,
        patches=len(cover.faces),
        origin=cover.origin,
        deviation=cover.deviation,
        quads=cover.quads,
        kinds=np.array(cover.kinds),
        **_face_arrays("patch", cover.faces),
    )
    part.replace(folder / COVER)
    return 0


def _cover(
    folder: Path,
    outline: Outline,
    curves: Sequence[SplineCurve | None],
    surfaces: Sequence[SplineFace],
    task: Mapping[str, float],
    seconds: float,
    progress: Callable[[float, str], None],
) -> Cover:
    """The cover that is found first, with one size of quads after the other.

    Raises
    ------
    FaultError
        None is found, and with one size at least something went wrong that must not.
    HybridVolumeError
        None is found: the failure that concerns the fewest faces.
    """
    attempts = [{}] if "turn" in task else ATTEMPTS
    engines = {way.engine for way in Meshers.available().ways}
    failures: list[HybridVolumeError] = []
    effort = Effort()
    for number, attempt in enumerate(attempts):
        sizes = dict(attempt)
        first = sizes.pop("first", "")
        if first and engines == {first}:
            continue  # it was the only one before, too
        left = seconds - effort.seconds()
        if failures and left < WORTH * seconds:
            break
        done = 1.0 - 0.5**number

        def told(share: float, words: str, done: float = done) -> None:
            progress(done + 0.5 * (1.0 - done) * share, words)

        last = number == len(attempts) - 1
        try:
            return cover_body(
                folder / BREP,
                outline,
                curves,
                surfaces,
                **{**sizes, **task},
                seconds=left if last else 0.5 * left,
                progress=told,
                meshers=Meshers.available(first),
            )
        except (SetupError, MemoryError):
            raise
        except HybridVolumeError as error:
            logger.info("attempt %d: %s", number + 1, error.line)
            failures.append(error)
        except (
            ArithmeticError,
            LookupError,
            ValueError,
            TypeError,
            np.linalg.LinAlgError,
        ) as fault:
            # a fault of ours with these quads need not be one with others
            logger.exception("attempt %d", number + 1)
            failures.append(_fault(fault))
    raise told_failure(failures)


def told_failure(failures: Sequence[HybridVolumeError]) -> HybridVolumeError:
    """What is told of a body that was tried in several ways, none of which gave a cover.

    A fault of ours is told before anything about the body, which may be good.

    Parameters
    ----------
    failures : sequence of HybridVolumeError
        In the order of the ways; at least one.
    """
    faults = [error for error in failures if isinstance(error, FaultError)]
    named = [error for error in failures if error.faces]
    if faults:
        return faults[0]
    return min(named, key=lambda error: len(error.faces)) if named else failures[0]


def _fault(fault: Exception) -> FaultError:
    """An exception that nobody expected, in words."""
    where = traceback.extract_tb(fault.__traceback__)[-1]
    place = f"{Path(where.filename).name}:{where.lineno}"
    return FaultError(
        f"covering the faces failed: {type(fault).__name__} in {place}: {fault}".replace("\n", " "),
        remedy="please report this body",
    )


if __name__ == "__main__":
    sys.exit(main())
