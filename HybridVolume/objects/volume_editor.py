# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Completing the volume of a body in a document: what the panel does, as macros repeat it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any

from HybridVolume.core.goals import Thickness
from HybridVolume.core.levels import Spacing
from HybridVolume.errors import InputError
from HybridVolume.job import Job, Progress, worker_python
from HybridVolume.mesh_job import KEYWORDS, check_order, density_keywords
from HybridVolume.sources import read_object

from . import density, face_geometry, spans
from . import thickness as shell
from .mesh_editor import ORDERS, density_values
from .midstructure import METHODS, own_geometry
from .properties import transaction
from .volume import (
    complete_parameters,
    current_parameters,
    mesh_parameters,
    mesh_values,
    options_of,
    source_fingerprint,
    update_status,
)

if TYPE_CHECKING:
    from HybridVolume.sources import Body


class VolumeEditor:
    """Sets how the shell of a body should be, and completes the volume.

    Parameters
    ----------
    obj : App.DocumentObject
        A body, which gets a new hybrid volume (one for each of its solids); or a hybrid volume,
        which is computed again.

    Attributes
    ----------
    source : App.DocumentObject
        The body.
    volume : App.DocumentObject or None
    """

    def __init__(self, obj: Any) -> None:
        is_volume = getattr(getattr(obj, "Proxy", None), "Type", "") == "HybridVolume::Volume"
        self.volume = obj if is_volume else None
        self.source = obj.Source if is_volume else obj
        if self.source is None:
            raise InputError(f"{obj.Label} has no body", remedy="set its Source")

    def set(self, **values: Any) -> None:
        """Set values of a hybrid volume, as one step of Undo; nothing is computed.

        Parameters
        ----------
        **values
            As for :meth:`complete`, without ``midstructure``.

        Raises
        ------
        InputError
            A value is out of its range, or there is no hybrid volume yet.
        """
        if self.volume is None:
            raise InputError(
                f"{self.source.Label} has no hybrid volume", remedy="complete its volume first"
            )
        changed = changed_parameters(**values)
        obj = self.volume
        with transaction(obj.Document, "Shell thickness"):
            own = {name: changed[name] for name in shell.DEFAULTS if name in changed}
            shell.set_values(obj, {**shell.values_of(obj), **own})
            spans.set_values(obj, {**spans.values_of(obj), **changed})
            face_geometry.set_values(obj, {**face_geometry.values_of(obj), **changed})
            if obj.FemMesh:
                mesh = {**mesh_parameters(obj.FemMesh), **changed}
                obj.FemMesh.Order = mesh["FemMesh.Order"]
                density.set_values(obj.FemMesh, mesh_values(mesh))
            update_status(obj)

    def complete(
        self,
        *,
        progress: Callable[[Progress], None] | None = None,
        python: str | None = None,
        engine: str = "auto",
        **values: Any,
    ) -> list[Any]:
        """Compute and put the result into the document, as one step of Undo; wait for it.

        Parameters
        ----------
        progress : callable, optional
            Called now and then.
        python : str, optional
            Interpreter of the worker.
        engine : {"auto", "netgen", "gmsh"}
            Mesher of the core.
        **values
            What is not given stays as it is:

            ``thickness``
                As for ``Thickness.parse``: ``"0.5"`` (a level w0), ``"2 mm"``, ``"mean 2 mm"``,
                ``"min 2 mm"`` or ``"30 %"``.
            ``face_factors``
                Face to factor, e.g. ``{"Face3": 1.5}``.
            ``layers``, ``degree``
            ``spacing``
                ``"volume"``, ``"distance"``, ``"ratio 1.5"`` or ``"first 0.2 mm"``.
            ``span_size``, ``span_aspect``, ``span_turn``
                How even the faces' knot spans are made first: longest side (mm), longest over
                shortest side, turn of the normal (degrees); 0: as the shell needs.
            ``cover_tolerance``
                How far patches may be from trimmed faces, mm; 0: 1e-4 of the body's diagonal.
            ``order``
                Of the FEM mesh, 1 or 2.
            ``nodes``, ``subdivide``, ``size``, ``face_sizes``, ``gradation``, ``fem_layers``, \
``growth``
                How fine the FEM mesh is, as of :class:`HybridVolume.core.pipeline.Options`.
            ``midstructure``
                Of a new hybrid volume: ``"auto"``, ``"medial-axis"``, ``"skeleton"``,
                ``"distance"``.

        Returns
        -------
        list of App.DocumentObject
            The hybrid volumes.

        Raises
        ------
        HybridVolumeError
            A value is out of its range, a body is refused, or no valid shell was found; the
            document is as it was.
        """
        parameters = self.parameters(**values)
        fingerprint, bodies = self.read(parameters, python=python)
        refused = [body.error for _, body in bodies if body.error]
        if refused:
            raise refused[0]
        jobs = self.jobs(bodies, parameters, python=worker_python(python), engine=engine)
        try:
            for job in jobs:
                job.run(progress)
            return self.insert(bodies, jobs, parameters, fingerprint)
        finally:
            for job in jobs:
                job.close()

    # The steps of it, which a window takes one after the other.

    def parameters(self, **values: Any) -> dict[str, Any]:
        """Parameters by the names of `volume.current_parameters`, with some of them changed."""
        before = current_parameters(self.volume) if self.volume else complete_parameters({})
        return {**before, **changed_parameters(**values)}

    def read(
        self, parameters: Mapping[str, Any] | None = None, **keywords: Any
    ) -> tuple[str, list[tuple[int, Body]]]:
        """Fingerprint of the source, and its solids with their numbers.

        Refused ones carry their error. Faces that are no patches are covered, which takes a while
        where it was not done before.

        Parameters
        ----------
        parameters : mapping, optional
            Their ``CoverTolerance`` counts; by default that of the volume.
        **keywords
            ``python``, ``free_only``, ``progress`` of `sources.read_object`.

        Raises
        ------
        InputError
            The source has no solid, or not that of the volume any more.
        """
        fingerprint = source_fingerprint(self.source)
        parameters = self.parameters() if parameters is None else parameters
        tolerance = face_geometry.tolerance_of(complete_parameters(parameters))
        found = read_object(self.source, tolerance=tolerance, **keywords)
        bodies = list(enumerate(found, start=1))
        if self.volume:
            bodies = [(number, body) for number, body in bodies if number == self.volume.Solid]
            if not bodies:
                raise InputError(
                    f"{self.source.Label} has no solid {self.volume.Solid} any more",
                    remedy="remove this hybrid volume and make a new one",
                )
        return fingerprint, bodies

    def jobs(
        self,
        bodies: Sequence[tuple[int, Body]],
        parameters: Mapping[str, Any],
        *,
        engine: str = "auto",
        **keywords: Any,
    ) -> list[Job]:
        """A job for each solid; ``keywords`` are those of `Job`."""
        options = {**options_of(parameters), "engine": engine}
        own = own_geometry(self.volume.Midstructure) if self.volume else None
        return [
            Job(
                body.faces,
                name=body.name,
                options=options,
                source={"file": self.source.Label, "bodies": len(bodies), **body.origin},
                own=own,
                **keywords,
            )
            for _, body in bodies
        ]

    def insert(
        self,
        bodies: Sequence[tuple[int, Body]],
        jobs: Sequence[Job],
        parameters: Mapping[str, Any],
        fingerprint: str,
    ) -> list[Any]:
        """Put the results of jobs into the document, as one step of Undo."""
        from . import document

        prepared = [
            document.Prepared(
                document.Completed(
                    body=body,
                    solid=number,
                    volume=job.result(),
                    result=job.result_file,
                    report=job.report(),
                    parameters=parameters,
                    fingerprint=fingerprint,
                )
            )
            for (number, body), job in zip(bodies, jobs, strict=True)
        ]
        return document.insert(self.source.Document, self.source, prepared, self.volume)


def changed_parameters(**values: Any) -> dict[str, Any]:
    """Parameters by the names of `volume.current_parameters` for the keywords of an editor.

    Raises
    ------
    InputError
        A value is out of its range, or there is no such keyword.
    """
    known = ("thickness", "face_factors", "layers", "degree", "spacing", "order", "midstructure")
    known += (*spans.KEYWORDS, "cover_tolerance")
    fine = {name: values.pop(name) for name in KEYWORDS if name in values}
    unknown = sorted(set(values) - set(known))
    if unknown:
        raise InputError(f"no such value: {', '.join(unknown)}", remedy=f"use {', '.join(known)}")
    found: dict[str, Any] = {}
    if "thickness" in values:
        found |= shell.thickness_parameters(Thickness.parse(str(values["thickness"])))
        del found["FaceFactors"]
    if "face_factors" in values:
        factors = Thickness(factors=dict(values["face_factors"])).factors
        found["FaceFactors"] = shell.factor_texts(factors)
    if "spacing" in values:
        found |= shell.spacing_parameters(Spacing.parse(str(values["spacing"])))
    found |= spans.changed_values(values)
    if "cover_tolerance" in values:
        found[face_geometry.COVER] = face_geometry.parse_tolerance(values["cover_tolerance"])
    for name, key in (("layers", "Layers"), ("degree", "Degree")):
        if name in values:
            found[key] = int(values[name])
    if "order" in values:
        found["FemMesh.Order"] = ORDERS[check_order(values["order"])]
    found |= {f"FemMesh.{name}": value for name, value in density_values(**fine).items()}
    if "midstructure" in values:
        if values["midstructure"] not in METHODS:
            raise InputError(
                f"midstructure is {values['midstructure']!r}",
                remedy=f"choose one of {', '.join(METHODS)}",
            )
        found["Midstructure.Method"] = values["midstructure"]
    return found


def keywords_of(parameters: Mapping[str, Any]) -> dict[str, Any]:
    """Keywords of an editor that ask for parameters; the reverse of `changed_parameters`."""
    parameters = complete_parameters(parameters)
    thickness = shell.thickness_of(parameters)
    orders = {name: number for number, name in ORDERS.items()}
    return {
        "thickness": thickness.text,
        "face_factors": dict(thickness.factors),
        "layers": parameters["Layers"],
        "degree": parameters["Degree"],
        "spacing": shell.spacing_of(parameters).text,
        **spans.options_of(parameters),
        "cover_tolerance": parameters[face_geometry.COVER],
        "order": orders[parameters["FemMesh.Order"]],
        **density_keywords(density.density_of(mesh_values(parameters))),
    }
