# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The midstructure in a document: how it is found, what was found, which sheets are kept.

What is found (``Facets``) depends on the body, the method, the samples, the depth and the user's
geometry. Which of it is kept is chosen from ``Angle``, ``MinimumSize`` and ``Decisions`` at any
time: everything shown is a function of the properties, so that Undo needs no more than those.
"""

from __future__ import annotations

import os
from collections import OrderedDict
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import FreeCAD

from HybridVolume.core.hybrid import load_midstructure
from HybridVolume.core.midstructure import METHODS, Search
from HybridVolume.core.midstructure.search import ANGLES, SAMPLES, SIZES
from HybridVolume.errors import HybridVolumeError, InputError

from . import face_geometry
from .own_geometry import geometry_fingerprint, tessellate
from .properties import DocumentObject, Property, include

if TYPE_CHECKING:
    import numpy as np

    from HybridVolume.core.midstructure import Midstructure

UP_TO_DATE = "Up to date"
NOT_FOUND = "Not found"

PARAMETERS = {
    "Method": "auto",
    "Samples": 0,
    "Angle": 125.0,
    "MinimumSize": 1.0,
    "Depth": "50%",
    "Decisions": (),
}
"""Properties that say what is found and what of it is kept, with their defaults."""

_KEYWORDS = {
    "Method": "method",
    "Samples": "samples",
    "Angle": "angle",
    "MinimumSize": "minimum_size",
    "Depth": "depth",
    "Decisions": "decisions",
}

_FOUND = "Found"
_SEARCH = "Search"


class MidstructureObject(DocumentObject):
    """Proxy of the midstructure; a change of its search makes the hybrid volume out of date."""

    Type = "HybridVolume::Midstructure"
    SCHEMA = 2
    PROPERTIES = {
        "Method": Property(
            "App::PropertyEnumeration",
            _SEARCH,
            "How the midstructure is found; auto takes the medial axis, own the Geometry.",
            choices=METHODS,
        ),
        "Samples": Property(
            "App::PropertyIntegerConstraint",
            _SEARCH,
            "Samples of the surface; 0 chooses by the body.",
            (PARAMETERS["Samples"], 0, SAMPLES[1], 1000),
        ),
        "Angle": Property(
            "App::PropertyFloatConstraint",
            _SEARCH,
            "Smallest angle under which a kept part of a medial axis sees the surface, degrees.",
            (PARAMETERS["Angle"], *ANGLES, 1.0),
        ),
        "MinimumSize": Property(
            "App::PropertyFloatConstraint",
            _SEARCH,
            "Smallest area of a kept part of a medial axis, in squares of its distance to the "
            "surface.",
            (PARAMETERS["MinimumSize"], *SIZES, 0.1),
        ),
        "Depth": Property(
            "App::PropertyString",
            _SEARCH,
            'Of a surface of equal distance: a share such as "50%" or a length such as "2 mm".',
            PARAMETERS["Depth"],
        ),
        "Geometry": Property(
            "App::PropertyLinkListGlobal",
            _SEARCH,
            "Points, wires or faces inside the body, for the method own.",
        ),
        "Decisions": Property(
            "App::PropertyStringList",
            _SEARCH,
            "What was decided by hand, in this order: keep, remove or only, the two faces of the "
            "sheet, and a place on the first.",
        ),
        "Kept": Property(
            "App::PropertyBoolList",
            _FOUND,
            "Whether each sheet is kept; the largest comes first.",
            mode=("ReadOnly",),
        ),
        "Unmatched": Property(
            "App::PropertyStringList",
            _FOUND,
            "Decisions that fit no sheet of the body as it is.",
            mode=("ReadOnly",),
        ),
        "MethodUsed": Property(
            "App::PropertyString", _FOUND, "Method that gave the midstructure.", mode=("ReadOnly",)
        ),
        "Facets": Property(
            "App::PropertyFileIncluded",
            _FOUND,
            "The midstructure itself, as HybridVolume's .npz.",
            mode=("ReadOnly", "Hidden"),
        ),
        "FoundFrom": Property(
            "App::PropertyMap",
            _FOUND,
            "What the sheets were found from.",
            mode=("ReadOnly", "Hidden"),
        ),
        "Status": Property(
            "App::PropertyString", "Base", "Up to date, or why not.", mode=("ReadOnly",)
        ),
    }

    def prepare(self, obj: Any) -> None:
        """Say that nothing is there yet."""
        obj.Status = NOT_FOUND

    def execute(self, obj: Any) -> None:
        """Choose again what is kept, where a property was changed; nothing is searched for."""
        update_choice(obj)

    def migrate(self, obj: Any, version: int) -> None:
        """Drop what an earlier version found: it tells too little to be chosen from."""
        if version < 2:
            # these told what had been decided automatically; nothing was decided by hand
            obj.Decisions = []
            obj.Kept = []
            # an included file cannot be taken out of its property
            obj.removeProperty("Facets")
            self.ensure_properties(obj)
            obj.Status = f"{NOT_FOUND}: computed by an earlier version; find it again"


def make_midstructure(doc: Any, name: str = "Midstructure") -> Any:
    """Add an empty midstructure to a document."""
    obj = doc.addObject("App::FeaturePython", name)
    MidstructureObject(obj)
    return obj


def is_midstructure(obj: Any) -> bool:
    """Whether an object is a midstructure."""
    return getattr(getattr(obj, "Proxy", None), "Type", "") == MidstructureObject.Type


def volume_of(obj: Any) -> Any | None:
    """The hybrid volume that a midstructure belongs to."""
    return next(
        (one for one in obj.InList if getattr(one, "Midstructure", None) is obj),
        None,
    )


# ------------------------------------------------------------------------- what is asked for


def parameters(obj: Any) -> dict[str, Any]:
    """Values of :data:`PARAMETERS` of an object."""
    values = {name: getattr(obj, name) for name in PARAMETERS}
    return {**values, "Decisions": tuple(values["Decisions"])}


def search_of(values: Mapping[str, Any]) -> Search:
    """Return the search for values of :data:`PARAMETERS`.

    Raises
    ------
    InputError
        A value is out of its range.
    """
    return Search(**{word: values[name] for name, word in _KEYWORDS.items()})


def relevant(values: Mapping[str, Any]) -> dict[str, str]:
    """The parameters that the method looks at, as text by name."""
    method = values["Method"]
    names = ["Method", "Decisions"]
    if method in ("auto", "medial-axis"):
        names += ["Samples", "Angle", "MinimumSize"]
    elif method == "skeleton":
        names.append("Samples")
    elif method == "distance":
        names.append("Depth")
    texts = {name: values[name] for name in names}
    texts["Decisions"] = "; ".join(values["Decisions"])
    return {name: text if isinstance(text, str) else repr(text) for name, text in texts.items()}


def own_geometry(obj: Any) -> tuple[np.ndarray, np.ndarray] | None:
    """Vertices (m, 3), mm, and facets (f, 3) of the user's geometry, where the method is own.

    Raises
    ------
    InputError
        An object has no shape that serves.
    """
    return tessellate(obj.Geometry) if obj.Method == "own" and obj.Geometry else None


def search_inputs(obj: Any) -> dict[str, str]:
    """What a search would find its sheets from now, as text by name.

    What is only chosen afterwards (angle, size, decisions) is no part of it.
    """
    from .volume import source_fingerprint

    volume = volume_of(obj)
    values = relevant(parameters(obj))
    texts = {name: values[name] for name in ("Samples", "Depth") if name in values}
    texts["Method"] = "medial-axis" if obj.Method == "auto" else obj.Method
    if obj.Method == "own":
        texts["Geometry"] = geometry_fingerprint(obj.Geometry)
    if volume is not None:
        texts["Source"] = source_fingerprint(volume.Source)
        texts["Solid"] = str(volume.Solid)
        texts["Tolerance"] = repr(volume.Tolerance)
        if not volume.ComputedFrom or face_geometry.COVER in volume.ComputedFrom:
            cover = face_geometry.values_of(volume)
            texts |= face_geometry.relevant(cover) if cover[face_geometry.COVER] else {}
    return texts


# ------------------------------------------------------------------------------ what is there


def loaded(obj: Any) -> Midstructure | None:
    """The midstructure as it was found; None where there is none yet.

    Raises
    ------
    FileFormatError
        The stored file is damaged.
    """
    # an object of an earlier version is asked before it is migrated, while its document opens
    if not obj.Facets or obj.SchemaVersion < MidstructureObject.SCHEMA:
        return None
    return _cached(("found", *_identity(obj)), lambda: load_midstructure(obj.Facets))


def chosen(obj: Any) -> Midstructure | None:
    """The midstructure with what is kept by the object's angle, size and decisions.

    Raises
    ------
    InputError
        A decision cannot be read.
    FileFormatError
        The stored file is damaged.
    """
    found = loaded(obj)
    if found is None:
        return None
    search = search_of(parameters(obj))
    key = ("chosen", *_identity(obj), search.angle, search.minimum_size, search.decisions)
    return _cached(
        key,
        lambda: found.choose(
            angle=search.angle, minimum_size=search.minimum_size, decisions=search.decisions
        ),
    )


def insert_found(
    obj: Any, path: str | os.PathLike, found_from: Mapping[str, str] | None = None
) -> None:
    """Take in a midstructure that was found, and replay the decisions on it.

    Called inside a transaction.

    Parameters
    ----------
    obj : App.DocumentObject
    path : path
        A stored midstructure; the document takes a copy.
    found_from : mapping, optional
        What :func:`search_inputs` gave when the search began; now otherwise.

    Raises
    ------
    HybridVolumeError
        The file is no midstructure, or a decision cannot be read.
    """
    found = load_midstructure(path)
    include(obj, "Facets", path)
    obj.FoundFrom = search_inputs(obj) if found_from is None else dict(found_from)
    obj.MethodUsed = found.method
    update_choice(obj, strict=True)
    for decision in obj.Unmatched:
        FreeCAD.Console.PrintWarning(f"HybridVolume: {obj.Label}: {decision} fits no sheet\n")


def update_choice(obj: Any, *, strict: bool = False) -> None:
    """Bring Kept, Unmatched and Status in line with the other properties and with the body.

    Parameters
    ----------
    strict : bool
        Raise what is wrong with a value; otherwise Status tells it.

    Raises
    ------
    HybridVolumeError
    """
    try:
        now = chosen(obj)
    except HybridVolumeError as error:
        if strict:
            raise
        _set(obj, "Status", f"Failed: {error.line}")
        return
    _set(obj, "Kept", [] if now is None else [sheet.kept for sheet in now.sheets])
    _set(obj, "Unmatched", [] if now is None else list(now.unmatched))
    _set(obj, "Status", (obj.Status or NOT_FOUND) if now is None else _status(obj))


def _status(obj: Any) -> str:
    before, now = obj.FoundFrom, search_inputs(obj)
    changed = [name for name in now if before.get(name) != now[name]]
    if "Method" in changed:
        # another method looks at other parameters: the method says it all
        changed = [name for name in changed if name in ("Method", "Source")]
    if changed:
        words = ["the body" if name in ("Source", "Solid") else name for name in changed]
        return f"Out of date: {', '.join(dict.fromkeys(words))} changed"
    if not any(obj.Kept):
        return "Nothing is kept: keep a sheet"
    if obj.Unmatched:
        return f"{UP_TO_DATE}, but no sheet fits: {', '.join(obj.Unmatched)}"
    return UP_TO_DATE


def _set(obj: Any, name: str, value: Any) -> None:
    # what has the value already is not touched
    old = getattr(obj, name)
    if (list(old) if isinstance(value, list) else old) != value:
        setattr(obj, name, value)


_T = TypeVar("_T")
_KEPT_IN_MEMORY = 8
_memory: OrderedDict[tuple, Any] = OrderedDict()


def _cached(key: tuple, make: Callable[[], _T]) -> _T:
    if key not in _memory:
        _memory[key] = make()
    _memory.move_to_end(key)
    while len(_memory) > _KEPT_IN_MEMORY:
        _memory.popitem(last=False)
    return _memory[key]


def _identity(obj: Any) -> tuple:
    # of the file, not of another property: Undo sets them one after the other
    file = os.stat(obj.Facets)
    return obj.Facets, file.st_ino, file.st_mtime_ns, file.st_size


def require(obj: Any) -> Midstructure:
    """Return :func:`chosen`, or refuse.

    Raises
    ------
    InputError
        Nothing was found yet.
    """
    found = chosen(obj)
    if found is None:
        raise InputError(
            f"{obj.Label}: no midstructure was found yet", remedy="call find(), or press Find"
        )
    return found
