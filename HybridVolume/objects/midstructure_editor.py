# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Deciding about sheets by hand: what the panel and macros do with a midstructure.

Every call is one step of Undo; what it decides stands in the object's properties alone.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from HybridVolume.core.midstructure import Decision, Sheet
from HybridVolume.core.midstructure.choice import find_sheets
from HybridVolume.errors import InputError
from HybridVolume.job import Job, Progress
from HybridVolume.sources import read_object

from . import face_geometry
from . import midstructure as objects
from .properties import transaction
from .volume import NOT_COMPUTED, current_parameters, options_of, set_status, update_status

if TYPE_CHECKING:
    from HybridVolume.core.midstructure import Midstructure
    from HybridVolume.core.midstructure.hints import Hints

NAMED = 10
"""Sheets that an error names."""

_PARAMETERS = {
    "angle": "Angle",
    "minimum_size": "MinimumSize",
    "method": "Method",
    "samples": "Samples",
    "depth": "Depth",
    "geometry": "Geometry",
}


class Editor:
    """Changes a midstructure of a document as a user does.

    A sheet is named by its place in the list (``"Sheet4"``), by its name (as `Sheet.name`), or by
    ``faces=("Face3", "Face9")`` and, where these have several sheets between them, ``at=(u, v)``.

    Parameters
    ----------
    obj : App.DocumentObject
        The midstructure.

    Attributes
    ----------
    object : App.DocumentObject

    Raises
    ------
    InputError
        It is no midstructure.
    """

    def __init__(self, obj: Any) -> None:
        if not objects.is_midstructure(obj):
            raise InputError(
                f"{getattr(obj, 'Label', obj)} is no midstructure",
                remedy='give the object of a hybrid volume, e.g. doc.getObject("Midstructure")',
            )
        self.object = obj

    @property
    def midstructure(self) -> Midstructure:
        """What was found, with what is kept now.

        Raises
        ------
        InputError
            Nothing was found yet.
        """
        return objects.require(self.object)

    @property
    def sheets(self) -> tuple[Sheet, ...]:
        """The sheets, the largest first: ``Sheet1``, ``Sheet2``, ..."""
        return self.midstructure.sheets

    # Decisions.

    def remove(
        self,
        *sheets: str,
        faces: tuple[str, str] | None = None,
        at: tuple[float, float] | None = None,
    ) -> None:
        """Keep nothing of the sheets.

        Raises
        ------
        InputError
            There is no such sheet; nothing is changed.
        """
        self._decide("remove", sheets, faces, at)

    def keep(
        self,
        *sheets: str,
        faces: tuple[str, str] | None = None,
        at: tuple[float, float] | None = None,
    ) -> None:
        """Keep the sheets, except for rims that run into the surface.

        Raises
        ------
        InputError
            There is no such sheet; nothing is changed.
        """
        self._decide("keep", sheets, faces, at)

    def only(
        self,
        *sheets: str,
        faces: tuple[str, str] | None = None,
        at: tuple[float, float] | None = None,
    ) -> None:
        """Keep the sheets and no other; earlier decisions are forgotten.

        Raises
        ------
        InputError
            There is no such sheet; nothing is changed.
        """
        found = self.midstructure
        new = self._decisions("only", sheets, faces, at)
        self._write(_title("Keep only", self._about(found, new)), [str(d) for d in new])

    def invert(
        self,
        *sheets: str,
        faces: tuple[str, str] | None = None,
        at: tuple[float, float] | None = None,
    ) -> None:
        """Remove those of the sheets that are kept, keep the others; of all where none is named.

        Raises
        ------
        InputError
            There is no such sheet; nothing is changed.
        """
        found = self.midstructure
        if sheets or faces is not None:
            numbers = self._about(found, self._decisions("keep", sheets, faces, at))
        else:
            numbers = list(range(len(found.sheets)))
        new = [
            Decision.about("remove" if found.sheets[k].kept else "keep", found.sheets[k].name)
            for k in numbers
        ]
        self._write(_title("Invert", numbers), self._merged(found, new))

    def automatic(self) -> None:
        """Forget all decisions."""
        self._write("Automatic choice of the sheets", [])

    def forget(self) -> None:
        """Drop the decisions that fit no sheet of the body as it is."""
        unmatched = set(self.object.Unmatched)
        left = [d for d in self.object.Decisions if str(Decision.parse(d)) not in unmatched]
        self._write("Forget decisions that fit no sheet", left)

    def _decide(
        self,
        action: str,
        sheets: Sequence[str],
        faces: tuple[str, str] | None,
        at: tuple[float, float] | None,
    ) -> None:
        found = self.midstructure
        new = self._decisions(action, sheets, faces, at)
        title = _title(action.capitalize(), self._about(found, new))
        self._write(title, self._merged(found, new))

    def _decisions(
        self,
        action: str,
        sheets: Sequence[str],
        faces: tuple[str, str] | None,
        at: tuple[float, float] | None,
    ) -> list[Decision]:
        """Decisions about the named sheets, each of which fits one at least."""
        found = self.midstructure
        made = [_named(found, action, name) for name in sheets]
        if faces is not None:
            if isinstance(faces, str) or len(faces) != 2:
                raise InputError(
                    f"{faces!r} is no pair of faces", remedy='give e.g. faces=("Face3", "Face9")'
                )
            place = None if at is None else (float(at[0]), float(at[1]))
            made.append(Decision(action, (str(faces[0]), str(faces[1])), place))
        elif at is not None:
            raise InputError("a place without faces", remedy="give faces=(...) with at=(u, v)")
        if not made:
            raise InputError("no sheet is named", remedy='name one, e.g. "Sheet1"')
        for decision in made:
            if not len(find_sheets(found, decision)):
                raise _no_sheet(found, "+".join(decision.faces))
        return made

    @staticmethod
    def _about(found: Midstructure, decisions: Sequence[Decision]) -> list[int]:
        """Numbers of the sheets that decisions are about."""
        numbers = {int(k) for decision in decisions for k in find_sheets(found, decision)}
        return sorted(numbers)

    def _merged(self, found: Midstructure, new: Sequence[Decision]) -> list[str]:
        """The object's decisions with new ones behind, without those that these make needless."""
        old = [Decision.parse(text) for text in self.object.Decisions]
        about = set(self._about(found, new))
        kept = []
        for decision in old:
            # An "only" says something about all other sheets too: it stays. One that fits no sheet
            # now may fit again.
            matched = set(self._about(found, [decision]))
            if decision.action == "only" or not matched or not matched <= about:
                kept.append(str(decision))
        return [*kept, *(text for text in dict.fromkeys(map(str, new)) if text not in kept)]

    def _write(self, title: str, decisions: list[str]) -> None:
        with self._step(title):
            self.object.Decisions = decisions

    # The search.

    def set(self, **parameters: Any) -> None:
        """Change how the midstructure is found or chosen.

        Another angle or size only chooses again. Another method, number of samples, depth or
        geometry makes what was found out of date until :meth:`find`.

        Parameters
        ----------
        **parameters
            ``angle`` (degrees), ``minimum_size``, ``method``, ``samples``, ``depth`` as in
            :class:`HybridVolume.core.midstructure.Search`; ``geometry``, a list of document
            objects.

        Raises
        ------
        InputError
            A value is out of its range; nothing is changed.
        """
        unknown = set(parameters) - set(_PARAMETERS)
        if unknown:
            raise InputError(
                f"no parameter {', '.join(sorted(unknown))}",
                remedy=f"give {', '.join(_PARAMETERS)}",
            )
        values = {_PARAMETERS[name]: value for name, value in parameters.items()}
        # refuses what is out of range, which FreeCAD would clip without a word
        objects.search_of({**objects.parameters(self.object), **values})
        words = ", ".join(name.replace("_", " ") for name in parameters)
        with self._step(f"Midstructure: {words}"):
            for name, value in values.items():
                setattr(self.object, name, value)

    def job(self, **keywords: Any) -> Job:
        """Return the job that finds the midstructure by the object's properties.

        Parameters
        ----------
        **keywords
            ``python`` and ``free_only`` of :class:`HybridVolume.job.Job`.

        Raises
        ------
        InputError
            The body is refused, or there is none.
        """
        return self._job("midstructure", **keywords)

    def thickness_job(self, w0: float, **keywords: Any) -> Job:
        """Return the job that tells how thick a shell up to ``w0`` will be; see :meth:`job`."""
        return self._job("thickness", w0=w0, **keywords)

    def find(
        self, progress: Callable[[Progress], None] | None = None, **keywords: Any
    ) -> tuple[Sheet, ...]:
        """Find the midstructure in the worker, wait, and replay the decisions on it.

        Parameters
        ----------
        progress : callable, optional
        **keywords
            As for :meth:`job`.

        Returns
        -------
        tuple of Sheet

        Raises
        ------
        HybridVolumeError
            The search failed; the document is as it was.
        """
        found_from = objects.search_inputs(self.object)
        with self.job(**keywords) as job:
            job.run(progress)
            self.insert(job.result_file, found_from)
        return self.sheets

    def insert(self, path: Any, found_from: dict[str, str] | None = None) -> None:
        """Take in what a job of :meth:`job` found, as one step of Undo.

        Parameters
        ----------
        path : path
            The job's ``result_file``.
        found_from : dict, optional
            ``search_inputs`` when the job was made.
        """
        with self._step("Find the midstructure"):
            objects.insert_found(self.object, path, found_from)

    def thickness(self, w0: float, **keywords: Any) -> dict[str, Any]:
        """Tell how thick a shell up to ``w0`` will be, exactly; wait for the worker.

        Returns
        -------
        dict
            As :func:`HybridVolume.core.thickness.shell_thickness`, mm.

        Raises
        ------
        HybridVolumeError
        """
        with self.thickness_job(w0, **keywords) as job:
            return job.run()

    def hints(self, w0: float = 0.5) -> Hints:
        """Estimate what the choice does to a shell up to ``w0``."""
        from HybridVolume.core.midstructure.hints import hints

        return hints(self.midstructure, w0)

    def _job(self, goal: str, w0: float | None = None, **keywords: Any) -> Job:
        volume = objects.volume_of(self.object)
        if volume is None or volume.Source is None:
            raise InputError(
                f"{self.object.Label} belongs to no body", remedy="give the volume a Source"
            )
        tolerance = face_geometry.tolerance_of(face_geometry.values_of(volume))
        bodies = read_object(
            volume.Source,
            tolerance=tolerance,
            python=keywords.get("python"),
            free_only=keywords.get("free_only", False),
        )
        if volume.Solid > len(bodies):
            raise InputError(
                f"{volume.Source.Label} has no solid {volume.Solid} any more",
                remedy="remove this hybrid volume and make a new one",
            )
        body = bodies[volume.Solid - 1]
        if body.error:
            raise body.error
        options = options_of(current_parameters(volume))
        if w0 is not None:
            options["w0"] = w0
        return Job(
            body.faces,
            name=body.name,
            options=options,
            goal=goal,
            own=objects.own_geometry(self.object),
            **keywords,
        )

    @contextlib.contextmanager
    def _step(self, title: str) -> Iterator[None]:
        """One step of Undo, at whose end all that depends on the midstructure is right."""
        with transaction(self.object.Document, title):
            yield
            objects.update_choice(self.object, strict=True)
            volume = objects.volume_of(self.object)
            if volume is not None:
                if not volume.Result:
                    # why a computation failed may be what was changed just now
                    set_status(volume, NOT_COMPUTED)
                update_status(volume)
            self.object.purgeTouched()


def _named(found: Midstructure, action: str, name: str) -> Decision:
    """Decision about a sheet that is named by its place in the list or by its faces."""
    place = re.fullmatch(r"Sheet([0-9]+)", name)
    if not place:
        return Decision.about(action, name)
    number = int(place[1])
    if not 1 <= number <= len(found.sheets):
        raise _no_sheet(found, name)
    return Decision.about(action, found.sheets[number - 1].name)


def _no_sheet(found: Midstructure, name: str) -> InputError:
    known = [f"Sheet{k} ({sheet.name})" for k, sheet in enumerate(found.sheets[:NAMED], start=1)]
    more = len(found.sheets) - len(known)
    listed = ", ".join(known) + (f" and {more} more" if more > 0 else "")
    return InputError(f"there is no sheet {name}", remedy=f"the largest are {listed}")


def _title(word: str, numbers: Sequence[int]) -> str:
    """Name of a step of Undo, e.g. ``Remove Sheet3, Sheet7``."""
    shown = ", ".join(f"Sheet{k + 1}" for k in numbers[:3])
    more = f" and {len(numbers) - 3} more" if len(numbers) > 3 else ""
    return f"{word} {shown}{more}"
