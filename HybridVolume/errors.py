# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The one family of errors: what is wrong, on which faces, by how much, and what to do about it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass


@dataclass(frozen=True)
class Place:
    """A place on the body where something is wrong.

    Attributes
    ----------
    face : str
        Name of the CAD face, e.g. ``"Face7"``.
    u, v : float, optional
        Where on the face, as shares of its parameter ranges, in [0, 1]; none where the face is
        made of many patches.
    point : tuple of float
        The same place in space, mm.
    what : str
        What is wrong there, in a few words.
    """

    face: str
    u: float | None
    v: float | None
    point: tuple[float, float, float]
    what: str

    @property
    def where(self) -> str:
        """The parameters in words; the point where there are none."""
        if self.u is None or self.v is None:
            return "({:.4g}, {:.4g}, {:.4g}) mm".format(*self.point)
        return f"u = {self.u:.4g}, v = {self.v:.4g}"


class HybridVolumeError(Exception):
    """A failure that a user can understand and act on.

    Parameters
    ----------
    message : str
        What is wrong, with the figure and its unit.
    faces : sequence of str
        Names of the CAD faces concerned, e.g. ``("Face7", "Face12")``.
    figure : float, optional
        The figure that decided (mm, or relative as the message says).
    remedy : str
        What the user can do.
    places : sequence of Place
        Where, as exactly as is known.
    """

    code = "error"

    def __init__(
        self,
        message: str,
        *,
        faces: Sequence[str] = (),
        figure: float | None = None,
        remedy: str = "",
        places: Sequence[Place] = (),
    ) -> None:
        self.message = message
        # a face may be made of many patches
        self.faces = tuple(dict.fromkeys(faces))
        self.figure = figure
        self.remedy = remedy
        self.places = tuple(places)
        super().__init__(self.line)

    @property
    def line(self) -> str:
        """The whole error in one line: faces, message, remedy."""
        shown = ", ".join(self.faces[:8])
        if len(self.faces) > 8:
            shown += f" and {len(self.faces) - 8} more"
        text = f"{shown}: {self.message}" if shown else self.message
        return f"{text}; {self.remedy}" if self.remedy else text

    def to_dict(self) -> dict:
        """The error as plain values, for a worker's answer; :func:`from_dict` reverses it."""
        return {
            "code": self.code,
            "message": self.message,
            "faces": list(self.faces),
            "figure": self.figure,
            "remedy": self.remedy,
            "places": [asdict(place) for place in self.places],
        }


class InputError(HybridVolumeError):
    """The file or the body cannot be used as it is."""

    code = "input"


class OutOfDateError(InputError):
    """A result is older than what it was made from; computing it again is the remedy."""

    code = "out-of-date"


class TrimmedFaceError(InputError):
    """A face is not the whole rectangle of its surface."""

    code = "trimmed-face"


class SeamError(InputError):
    """A face meets itself along a seam."""

    code = "seam"


class DegenerateSideError(InputError):
    """A side of a face has no length (a pole)."""

    code = "degenerate-side"


class InexactFaceError(InputError):
    """A face has no exact NURBS form."""

    code = "inexact-face"


class GapError(InputError):
    """Two sides that should meet are farther apart than the tolerance."""

    code = "gap"


class TJunctionError(InputError):
    """A side is shared by more than one neighbour."""

    code = "t-junction"


class OpenBodyError(InputError):
    """A side has no neighbour: the body is not closed."""

    code = "open-body"


class NonManifoldError(InputError):
    """More than two faces meet at a side, or faces touch only in a point."""

    code = "non-manifold"


class OrientationError(InputError):
    """Inside and outside of the body cannot be told."""

    code = "orientation"


class SingularSurfaceError(InputError):
    """A patch is folded or singular: no shell can follow it."""

    code = "singular-surface"


class SelfIntersectionError(InputError):
    """The body's surface cuts itself."""

    code = "self-intersection"


class LimitError(InputError):
    """A limit of time or memory ended the work on a body: another try may go farther."""

    code = "limit"


class ThicknessError(HybridVolumeError):
    """No valid shell at any thickness was found."""

    code = "thickness"


class MesherError(HybridVolumeError):
    """A tetrahedral mesher gave nothing usable."""

    code = "mesher"
    triangles: Sequence[int] = ()
    """Triangles of the interface at fault, as far as they are known; not handed on."""


class FileFormatError(HybridVolumeError):
    """A stored result is damaged or of another version."""

    code = "file-format"


class SetupError(HybridVolumeError):
    """Something that the work needs is not installed."""

    code = "environment"


class WorkerError(HybridVolumeError):
    """The worker process died, was stopped, or answered nonsense."""

    code = "worker"


class FaultError(HybridVolumeError):
    """A fault of our own: a check between two stages failed."""

    code = "fault"


def _family(cls: type[HybridVolumeError]) -> dict[str, type[HybridVolumeError]]:
    found = {cls.code: cls}
    for child in cls.__subclasses__():
        found.update(_family(child))
    return found


def from_dict(values: dict) -> HybridVolumeError:
    """Rebuild an error from :meth:`HybridVolumeError.to_dict`."""
    cls = _family(HybridVolumeError).get(values.get("code", ""), HybridVolumeError)
    return cls(
        values["message"],
        faces=values.get("faces", ()),
        figure=values.get("figure"),
        remedy=values.get("remedy", ""),
        places=[
            Place(**{**place, "point": tuple(place["point"])}) for place in values.get("places", ())
        ],
    )
