# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Another finite element mesh for a hybrid volume of a document: what panel and macros do."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from HybridVolume.core.density import Density
from HybridVolume.errors import InputError, OutOfDateError
from HybridVolume.job import Job, Progress, worker_python
from HybridVolume.mesh_job import changed_density, check_order, mesh_job

from .density import density_of, density_parameters, set_values
from .properties import transaction
from .stored_mesh import volume_object_of
from .volume import mesh_parameters, mesh_values, source_fingerprint, update_status

ORDERS = {1: "First", 2: "Second"}
PROPERTIES = {
    "nodes": "Density",
    "subdivide": "Subdivide",
    "size": "Size",
    "face_sizes": "FaceSizes",
    "gradation": "Gradation",
    "fem_layers": "Layers",
    "growth": "Growth",
}
"""Properties of a mesh object for the keywords of the density."""


class MeshEditor:
    """Sets how fine the mesh of a hybrid volume should be, and meshes again; the shell stays.

    Parameters
    ----------
    obj : App.DocumentObject
        A hybrid volume, one of its parts such as its mesh, or the body it was made of.

    Attributes
    ----------
    volume : App.DocumentObject
        The hybrid volume.

    Raises
    ------
    InputError
        There is no hybrid volume, or it has no result yet.
    """

    def __init__(self, obj: Any) -> None:
        self.volume = volume_object_of(obj)
        if not self.volume.Result or self.volume.FemMesh is None:
            raise InputError(
                f"{self.volume.Label} has no result yet", remedy="complete the volume first"
            )

    def wanted(self, **values: Any) -> tuple[Density, int]:
        """Density and order by the mesh object's properties, with some of them changed.

        Raises
        ------
        InputError
            A value is out of its range, or there is no such keyword.
        """
        parameters = mesh_parameters(self.volume.FemMesh)
        orders = {name: number for number, name in ORDERS.items()}
        order = check_order(values.pop("order", orders[parameters["FemMesh.Order"]]))
        return changed_density(density_of(mesh_values(parameters)), **values), order

    def set(self, **values: Any) -> None:
        """Set the mesh object's properties, as one step of Undo; nothing is computed.

        Parameters
        ----------
        **values
            As for :meth:`remesh`.

        Raises
        ------
        InputError
            A value is out of its range, or there is no such keyword.
        """
        density, order = self.wanted(**values)
        mesh = self.volume.FemMesh
        with transaction(mesh.Document, "Density of the mesh"):
            mesh.Order = ORDERS[order]
            set_values(mesh, density_parameters(density))
            update_status(self.volume)

    def remesh(
        self,
        *,
        progress: Callable[[Progress], None] | None = None,
        python: str | None = None,
        engine: str = "auto",
        **values: Any,
    ) -> Any:
        """Mesh again and put the mesh into the document, as one step of Undo; wait for it.

        Parameters
        ----------
        progress : callable, optional
            Called now and then.
        python : str, optional
            Interpreter of the worker.
        engine : {"auto", "netgen", "gmsh"}
            Mesher of the core.
        **values
            ``order``, ``nodes``, ``subdivide``, ``size``, ``face_sizes``, ``gradation``,
            ``fem_layers``, ``growth`` as of :class:`HybridVolume.core.pipeline.Options`. What is
            not given stays as the mesh object's properties say.

        Returns
        -------
        App.DocumentObject
            The mesh object.

        Raises
        ------
        HybridVolumeError
            A value is out of its range, the body changed since the shell was computed, or no
            valid mesh was found; the document is as it was.
        """
        density, order = self.wanted(**values)
        with self.job(density, order, python=worker_python(python), engine=engine) as job:
            job.run(progress)
            return self.insert(job)

    # The steps of it, which a window takes one after the other.

    def job(self, density: Density, order: int, *, engine: str = "auto", **keywords: Any) -> Job:
        """The job that meshes again; ``keywords`` are those of `Job`.

        Raises
        ------
        OutOfDateError
            The body changed since the shell was computed.
        """
        if self.volume.ComputedFrom.get("Source") != source_fingerprint(self.volume.Source):
            # said before the work, not after it
            raise OutOfDateError(
                f"{self.volume.Label} is out of date: the body changed",
                remedy="complete the hybrid volume again",
            )
        return mesh_job(
            self.volume.Result,
            density,
            order,
            engine=engine,
            name=self.volume.Label,
            source=_source(self.volume),
            **keywords,
        )

    def insert(self, job: Job) -> Any:
        """Put the result of a job into the document, as one step of Undo; return the mesh object.

        Raises
        ------
        HybridVolumeError
            The body changed meanwhile, or FreeCAD did not take the mesh; the document is as it
            was.
        """
        from .document import replace_mesh

        return replace_mesh(self.volume, job.result(), result=job.result_file, report=job.report())


def density_values(**values: Any) -> dict[str, Any]:
    """Values of a mesh object's properties for keywords of the density.

    Raises
    ------
    InputError
        A value is out of its range, or there is no such keyword.
    """
    found = density_parameters(changed_density(Density(), **values))
    return {PROPERTIES[word]: found[PROPERTIES[word]] for word in values}


def _source(volume: Any) -> dict[str, Any]:
    """What is known about the input of a hybrid volume, for the report."""
    return {
        "file": volume.Report.get("input.file", volume.Source.Label if volume.Source else ""),
        "bodies": int(volume.Report.get("input.bodies", 1)),
    }
