# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What macros and scripts call, in FreeCAD's Python; reached as ``HybridVolume.complete(...)``."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from HybridVolume.errors import InputError
from HybridVolume.job import Job, Progress

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.midstructure import Midstructure
    from HybridVolume.core.surface import PatchSurface, SplineFace
    from HybridVolume.objects.midstructure_editor import Editor
    from HybridVolume.objects.volume_editor import VolumeEditor
    from HybridVolume.sources import Body


def read_mesh(
    path: str | os.PathLike,
    scheme: str = "auto",
    steps: int | None = None,
    sharp_angle: float = 0.0,
) -> list[Body]:
    """Read the bodies of an OBJ, OFF or PLY file with a closed mesh.

    Parameters
    ----------
    path : path
    scheme : {"auto", "bilinear", "catmull-clark", "smooth"}
        How the mesh becomes patches; by itself Catmull-Clark where there are creases or other
        faces than quads or a sharp angle, else one bilinear patch a quad.
    steps : int, optional
        Subdivisions first.
    sharp_angle : float
        Edges of a cage that turn by more, degrees, are creases; 0: only those that are named.

    Returns
    -------
    list of Body
        ``origin["mesh"]["notes"]`` tells what was mended and how the patches were made.

    Raises
    ------
    InputError
        The file cannot be read, or the mesh is no closed surface; elements are named by their
        numbers in the file.
    """
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
    from HybridVolume.sources import Surfacing, read_file

    return read_file(path, Surfacing(scheme, steps, sharp_angle))


def import_mesh(
    path: str | os.PathLike,
    document: Any = None,
    *,
    scheme: str = "auto",
    steps: int | None = None,
    sharp_angle: float = 0.0,
) -> list[Any]:
    """Put the bodies of an OBJ, OFF or PLY file into a document, each with its mesh.

    Parameters
    ----------
    path : path
    document : App.Document, optional
        By itself the active one, or a new one where there is none.
    scheme, steps, sharp_angle
        As for :func:`read_mesh`; they are properties of the objects afterwards, which are
        recomputed when these change.

    Returns
    -------
    list of App.DocumentObject
        One a body.

    Raises
    ------
    InputError
        As for :func:`read_mesh`; the document is as it was.
    """
    from HybridVolume.freecad_python import import_freecad

    freecad = import_freecad()
    from HybridVolume import mesh_import
    from HybridVolume.objects import mesh_body
    from HybridVolume.sources import Surfacing

    # before anything can fail: who is answered by an error need not be asked either
    mesh_import.withdraw(path)
    surfacing = Surfacing(scheme, steps, sharp_angle)
    made_here = document is None and freecad.ActiveDocument is None
    if document is None:
        document = freecad.newDocument() if made_here else freecad.ActiveDocument
    try:
        return mesh_body.import_mesh(path, document, surfacing)
    except BaseException:
        if made_here:
            freecad.closeDocument(document.Name)
        raise


def read_step(
    path: str | os.PathLike,
    *,
    cover: bool = True,
    cover_tolerance: float | None = None,
    free_only: bool = False,
    progress: Callable[[Progress], None] | None = None,
    python: str | None = None,
) -> list[Body]:
    """Read the bodies of a STEP or BREP file.

    Parameters
    ----------
    path : path
    cover : bool
        Cover trimmed faces, and those with seams, poles or T-junctions, with patches; a body that
        has some is refused otherwise.
    cover_tolerance : float, optional
        Largest distance of patches from such faces, mm; 1e-4 of the diagonal by itself.
    free_only : bool
        Cover without the GPL parts.
    progress : callable, optional
        Called with a :class:`HybridVolume.job.Progress` now and then while bodies are covered.
    python : str, optional
        Interpreter for that.

    Returns
    -------
    list of Body
        One a solid; a refused one carries its ``error``. ``origin["geometry"]`` tells of every face
        whether it is kept bit for bit, exactly, or how closely.

    Raises
    ------
    InputError
        The file cannot be read, or every body is refused.
    """
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
    from HybridVolume.sources import read_file

    how = _reading(cover, cover_tolerance, progress, python)
    return read_file(path, free_only=free_only, **how)


def _reading(cover: bool, tolerance: float | None, progress: Any, python: str | None) -> dict:
    """Keywords of a new reading; progress is told without the body's name."""
    from HybridVolume.sources.covering import forget_limits

    forget_limits()
    told = None if progress is None else lambda _, news: progress(news)
    return {"cover": cover, "tolerance": tolerance, "progress": told, "python": python}


def complete(
    body: Any,
    w0: float = 0.5,
    *,
    thickness: str | float | None = None,
    face_factors: Mapping[str, float] | None = None,
    layers: int = 2,
    spacing: str = "volume",
    degree: int = 3,
    own: Any = None,
    pictures: str | os.PathLike | None = None,
    cover: bool = True,
    cover_tolerance: float | None = None,
    progress: Callable[[Progress], None] | None = None,
    python: str | None = None,
    **options: Any,
) -> HybridVolume:
    """Complete the volume of a body; wait for the worker process.

    Parameters
    ----------
    body : Body, Part.Shape, App.DocumentObject, PatchSurface or sequence of SplineFace
        One closed body, mm.
    w0 : float
        Thickness of the shell: share of the way to the midstructure, in (0, 1).
    thickness : str or float, optional
        In place of w0: ``"2 mm"`` (or the number 2.0) everywhere, ``"mean 2 mm"``,
        ``"min 2 mm"`` at the thinnest place, or ``"30 %"`` of the local radius, which is half the
        body's thickness.
    face_factors : mapping of str to float, optional
        By what it is multiplied at CAD faces, e.g. ``{"Face3": 1.5}``.
    layers : int
        Layers of elements, 1 to 50.
    spacing : str
        Their heights: ``"volume"`` or ``"distance"`` (equal ones), ``"ratio 1.5"`` (each over the
        one outside of it), or ``"first 0.2 mm"`` (of the outermost).
    degree : int
        Across the shell, 1 to 6.
    own : sequence of App.DocumentObject or Part.Shape, or (vertices, facets), optional
        Points, wires or faces inside the body that serve as its midstructure, mm.
    pictures : path, optional
        Folder for the pictures of the stages, ``NAME_field.png`` and the others of
        :data:`HybridVolume.job.PICTURES`.
    cover, cover_tolerance
        Of a shape or an object, as for :func:`read_step`.
    progress : callable, optional
        Called with a :class:`HybridVolume.job.Progress` now and then.
    python : str, optional
        Interpreter of the worker.
    **options
        Further options of :class:`HybridVolume.core.pipeline.Options`, such as ``midstructure``,
        ``decisions=("remove Face3+Face9",)``, or of the finite elements ``order``, ``size=2.0``
        and ``face_sizes={"Face3": 0.5}``.

    Returns
    -------
    HybridVolume
        Its ``report`` tells what was reached: ``sentence``, and ``faces`` with the thickness of
        each, as in docs/report.md.

    Raises
    ------
    HybridVolumeError
        The body is refused, no valid shell was found, or the worker died.
    """
    if own is not None:
        options.setdefault("midstructure", "own")
    job = Job(
        faces_of(body, **_reading(cover, cover_tolerance, progress, python)),
        name=_stem(body),
        options={
            "w0": w0,
            "thickness": _thickness_text(thickness),
            "face_factors": dict(face_factors or {}),
            "layers": layers,
            "spacing": spacing,
            "degree": degree,
            "strict_decisions": True,
            **options,
        },
        own=_own(own),
        exports=("pictures",) if pictures is not None else (),
        python=python,
    )
    with job:
        volume = job.run(progress)
        if pictures is not None:
            Path(pictures).mkdir(parents=True, exist_ok=True)
            for file in job.exported_files("pictures"):
                shutil.copyfile(file, Path(pictures) / file.name)
        return volume


def _thickness_text(thickness: str | float | None) -> str:
    if thickness is None:
        return ""
    return thickness if isinstance(thickness, str) else f"{float(thickness)!r} mm"


def _stem(body: Any) -> str:
    """Name of a body as the stem of a file."""
    name = str(getattr(body, "name", None) or getattr(body, "Label", None) or "body")
    return re.sub(r"[^\w.-]", "_", name)


def find_midstructure(
    body: Any,
    method: str = "auto",
    *,
    own: Any = None,
    cover: bool = True,
    cover_tolerance: float | None = None,
    progress: Callable[[Progress], None] | None = None,
    python: str | None = None,
    **search: Any,
) -> Midstructure:
    """Find the midstructure of a body; wait for the worker process.

    Parameters
    ----------
    body, own, cover, cover_tolerance, progress, python
        As for :func:`complete`.
    method : {"auto", "medial-axis", "skeleton", "distance", "own"}
    **search
        ``samples``, ``angle``, ``minimum_size``, ``depth``, ``decisions`` as of
        :class:`HybridVolume.core.midstructure.Search`.

    Returns
    -------
    Midstructure
        Its ``choose`` keeps other sheets.

    Raises
    ------
    HybridVolumeError
        The body is refused, a value is out of range, or a decision fits no sheet.
    """
    if own is not None and method == "auto":
        method = "own"
    job = Job(
        faces_of(body, **_reading(cover, cover_tolerance, progress, python)),
        options={"midstructure": method, "strict_decisions": True, **search},
        goal="midstructure",
        own=_own(own),
        python=python,
    )
    with job:
        return job.run(progress)


def edit_midstructure(obj: Any) -> Editor:
    """Return what changes a midstructure of a document, each change as one step of Undo.

    Parameters
    ----------
    obj : App.DocumentObject
        A midstructure, or the hybrid volume that it belongs to.

    Raises
    ------
    InputError
        It is neither.
    """
    from HybridVolume.objects.midstructure_editor import Editor

    return Editor(getattr(obj, "Midstructure", None) or obj)


def edit_volume(obj: Any) -> VolumeEditor:
    """Return what completes the volume of a body in a document, as the panel does.

    Parameters
    ----------
    obj : App.DocumentObject
        A body, which gets a new hybrid volume, or a hybrid volume, which is computed again.

    Raises
    ------
    InputError
        The hybrid volume has no body.
    """
    from HybridVolume.objects.volume_editor import VolumeEditor

    return VolumeEditor(obj)


def _own(own: Any) -> Any:
    """Vertices and facets of the user's geometry."""
    if own is None or (isinstance(own, tuple) and len(own) == 2 and hasattr(own[0], "dtype")):
        return own
    from HybridVolume.objects.own_geometry import tessellate

    return tessellate(own if isinstance(own, list | tuple) else [own])


def medial_axis(body: Any, samples: int | None = None) -> Midstructure:
    """Compute the automatic midstructure of a body in this process (needs scipy).

    Parameters
    ----------
    body
        As for :func:`complete`.
    samples : int, optional
        Surface samples aimed at.
    """
    from HybridVolume.core.assembly import build_surface
    from HybridVolume.core.midstructure import medial_axis as compute
    from HybridVolume.core.surface import PatchSurface

    surface = body if isinstance(body, PatchSurface) else build_surface(list(faces_of(body)))
    return compute(surface) if samples is None else compute(surface, samples)


def to_document(
    volume: HybridVolume,
    doc: Any,
    body: Any,
    report: dict[str, Any] | None = None,
    *,
    cover_tolerance: float | None = None,
) -> Any:
    """Add a hybrid volume with all its parts to a document, as the workbench does.

    Parameters
    ----------
    volume : HybridVolume
    doc : App.Document
    body : App.DocumentObject
        The body that it was computed from.
    report : dict, optional
        Its figures; computed here otherwise.
    cover_tolerance : float, optional
        With which the body was covered, mm, where one was given.

    Returns
    -------
    App.DocumentObject
    """
    import tempfile

    from HybridVolume.objects import document
    from HybridVolume.objects.volume import parameters_of, source_fingerprint
    from HybridVolume.report import volume_report

    read = _body_of(volume, body, cover_tolerance)
    origin = {"file": body.Label, "bodies": 1, **read.origin}
    parameters = {**parameters_of(volume), "CoverTolerance": cover_tolerance or 0.0}
    with tempfile.TemporaryDirectory(prefix="hybridvolume-") as folder:
        path = Path(folder) / "result.npz"
        volume.save(path)
        prepared = document.Prepared(
            document.Completed(
                body=read,
                solid=1,
                volume=volume,
                result=path,
                report=report or volume_report(volume, origin, {}),
                parameters=parameters,
                fingerprint=source_fingerprint(body),
            )
        )
        (obj,) = document.insert(doc, body, [prepared])
    return obj


def _body_of(volume: HybridVolume, body: Any, tolerance: float | None) -> Body:
    """The body that a volume was computed from, with the patches that it has."""
    from HybridVolume import sources
    from HybridVolume.objects.stored_body import body_to_search

    if not sources.coverings(body, tolerance=tolerance):
        # nothing has to be covered, or it was lately
        (read,) = sources.read_object(body, tolerance=tolerance)
        names = [patch.face for patch in volume.surface.patches]
        if names == [face.name for face in read.faces]:
            return read
    return body_to_search(body, volume.surface, tolerance)


def faces_of(body: Any, **keywords: Any) -> Sequence[SplineFace]:
    """Faces of anything that :func:`complete` takes.

    Parameters
    ----------
    body
        As for :func:`complete`.
    **keywords
        How a shape or an object is read, as for :func:`HybridVolume.sources.read_shape`.

    Raises
    ------
    InputError
        It is refused, or holds several bodies.
    """
    from HybridVolume.core.surface import PatchSurface

    if isinstance(body, PatchSurface):
        return _faces_of_surface(body)
    if isinstance(body, list | tuple):
        return body
    if not hasattr(body, "domains"):  # not a Body yet
        from HybridVolume import sources

        read = sources.read_object if hasattr(body, "Document") else sources.read_shape
        bodies = read(body, **keywords)
        if len(bodies) > 1:
            raise InputError(
                f"there are {len(bodies)} bodies", remedy="give one, e.g. shape.Solids[0]"
            )
        (body,) = bodies
    if body.error:
        raise body.error
    return body.faces


def _faces_of_surface(surface: PatchSurface) -> list[SplineFace]:
    from HybridVolume.core.surface import SplineFace

    return [
        SplineFace(
            name=patch.face,
            degrees=patch.degrees,
            knots=patch.knots,
            control_points=surface.control_points[patch.index],
            weights=patch.weights,
        )
        for patch in surface.patches
    ]
