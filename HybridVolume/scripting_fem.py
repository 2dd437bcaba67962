# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What macros call about finite elements: meshes, files, analyses; ``HybridVolume.to_fem(...)``."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from HybridVolume.job import Progress

if TYPE_CHECKING:
    from HybridVolume.core.hybrid import HybridVolume


def to_fem(volume: HybridVolume, doc: Any, order: int = 2, body: Any | None = None) -> Any:
    """Add the conforming mesh of a hybrid volume to a document, ready for an analysis.

    Parameters
    ----------
    volume : HybridVolume
    doc : App.Document
    order : {1, 2}
    body : App.DocumentObject, optional
        The body; loads and supports go on its faces, which are then checked.

    Returns
    -------
    App.DocumentObject
        A FEM mesh object with the groups Shell, Core, Interface and one for each CAD face.

    Raises
    ------
    FaultError
        FreeCAD did not take the whole mesh, or does not find its nodes on the body's faces.
    """
    from HybridVolume.core.finite_elements import conforming_mesh
    from HybridVolume.objects import document

    fem = volume.fem
    if fem.order != order:
        fem = conforming_mesh(
            volume.shell, volume.interface, volume.interior, order, volume.fem.density
        )
    return document.insert_mesh(doc, fem, body, getattr(volume, "surface", None))


def remesh(
    volume: Any,
    *,
    progress: Callable[[Progress], None] | None = None,
    python: str | None = None,
    engine: str = "auto",
    **values: Any,
) -> Any:
    """Give a hybrid volume another finite element mesh; its shell stays as it is.

    Parameters
    ----------
    volume : HybridVolume or App.DocumentObject
        An object is a hybrid volume, one of its parts such as its mesh, or the body it was made of.
    progress : callable, optional
        Called with a :class:`HybridVolume.job.Progress` now and then.
    python : str, optional
        Interpreter of the worker.
    engine : {"auto", "netgen", "gmsh"}
        Mesher of the core.
    **values
        ``order`` (1 or 2), ``nodes``, ``subdivide`` (parts of the shell's elements), ``size``
        (mm), ``face_sizes`` (mm by face, ``{"Face3": 0.5}``), ``gradation``, ``fem_layers``
        (layers of wedges; 0: by themselves) and ``growth``, as of
        :class:`HybridVolume.core.pipeline.Options`. What is not given stays as it is.

    Returns
    -------
    HybridVolume or App.DocumentObject
        A new hybrid volume; of an object its mesh object, which has the new mesh (one step of
        Undo), so that analyses keep it.

    Raises
    ------
    HybridVolumeError
        A value is out of its range, or no valid mesh was found; nothing has changed.
    """
    if hasattr(volume, "Document"):
        from HybridVolume.objects.mesh_editor import MeshEditor

        return MeshEditor(volume).remesh(progress=progress, python=python, engine=engine, **values)
    from HybridVolume.mesh_job import changed_density, check_order, mesh_job

    order = check_order(values.pop("order", volume.fem.order))
    density = changed_density(volume.fem.density, **values)
    with mesh_job(volume, density, order, engine=engine, python=python) as job:
        return job.run(progress)


def export_mesh(volume_or_object: Any, path: str | os.PathLike) -> None:
    """Write the conforming mesh of a hybrid volume to a file, by the ending of its name.

    Parameters
    ----------
    volume_or_object : HybridVolume, FiniteElementMesh or App.DocumentObject
        An object is a hybrid volume, one of its parts, the body it was made of, or a mesh.
    path : path
        ``.inp`` (CalculiX, Abaqus), ``.unv``, ``.med`` (Salome, Code_Aster), ``.msh`` (Gmsh 4.1) or
        ``.vtu`` (ParaView). Lengths are mm; groups are Shell, Core, each CAD face, and Interface.

    Raises
    ------
    InputError
        No format has this ending, or the object has no result.
    FaultError
        FreeCAD did not write the whole mesh (``.med``).
    OSError
        The place cannot be written.
    """
    from HybridVolume.exports.mesh_file import check_format, write_mesh

    check_format(path)
    mesh = getattr(volume_or_object, "fem", volume_or_object)
    if hasattr(mesh, "Document"):
        from HybridVolume.objects.stored_mesh import stored_mesh

        mesh = stored_mesh(mesh)
    write_mesh(path, mesh)


def export_shell(volume_or_object: Any, path: str | os.PathLike, *, degree: int = 2) -> list[Path]:
    """Write a hybrid volume for solvers that know splines: the shell, and the core beside it.

    Beside NAME.mesh or NAME.xml there will be NAME_core.msh (Gmsh 2.2, curved tetrahedra),
    NAME_interface.csv (the patch and parameters where each node of the interface lies on the
    shell) and NAME_interface_triangles.csv (the same for the corners of each triangle there).

    Parameters
    ----------
    volume_or_object : HybridVolume or App.DocumentObject
        An object is a hybrid volume, one of its parts, or the body it was made of.
    path : path
        ``.mesh`` (MFEM NURBS mesh v1.0; boundary attributes are the CAD faces and the interface,
        their names are comments) or ``.xml`` (G+Smo multipatch with interfaces; a boundary for
        each CAD face). Lengths are mm.
    degree : {1, 2, 3}
        Of the core's tetrahedra.

    Returns
    -------
    list of Path
        The files.

    Raises
    ------
    InputError
        No format has this ending, the object has no result, or the core has no valid curved
        tetrahedra of this degree.
    MesherError
        The core could not be filled anew where those need it.
    OSError
        The place cannot be written.
    """
    from HybridVolume.exports.solver_files import check_shell_format, write_solver_files

    check_shell_format(path, degree)
    volume = volume_or_object
    if hasattr(volume, "Document"):
        from HybridVolume.objects.stored_mesh import stored_volume

        volume = stored_volume(volume)
    return write_solver_files(path, volume, degree)


def export_step(body: Any, path: str | os.PathLike) -> None:
    """Write the surface of a body as one solid of untrimmed B-spline faces.

    So that a body that came from a mesh can be opened by any CAD program.

    Parameters
    ----------
    body : Body, HybridVolume, Part.Shape, App.DocumentObject, PatchSurface or faces
        As for :func:`HybridVolume.complete`; of a hybrid volume, the surface that it keeps.
    path : path
        ``.step``, ``.stp``, ``.brep`` or ``.brp``; mm.

    Raises
    ------
    InputError
        It is another kind of file, or the body is refused.
    FaultError
        OCC did not write the file, or not a closed solid of the body's volume.
    OSError
        The place cannot be written.
    """
    from HybridVolume.freecad_python import import_freecad

    import_freecad()
    from HybridVolume.core.assembly import build_surface
    from HybridVolume.core.hybrid import HybridVolume
    from HybridVolume.core.surface import PatchSurface
    from HybridVolume.exports.step import write_solid
    from HybridVolume.scripting import faces_of

    if isinstance(body, HybridVolume):
        body = body.surface
    surface = body if isinstance(body, PatchSurface) else build_surface(list(faces_of(body)))
    write_solid(path, surface)


def make_analysis(obj: Any, materials_apart: bool = False) -> Any:
    """Make an analysis of the FEM workbench on a hybrid volume; loads and supports are left to do.

    Parameters
    ----------
    obj : App.DocumentObject
        A hybrid volume, its mesh, or the body it was made of.
    materials_apart : bool
        A material for the shell and another for the core.

    Returns
    -------
    App.DocumentObject
        The analysis, with mesh, steel as material, and a CalculiX solver.

    Raises
    ------
    InputError
        There is no mesh, or it is older than its body.
    """
    from HybridVolume.objects.analysis import make_analysis as make

    return make(obj, materials_apart=materials_apart)


def solve(analysis: Any, folder: str | os.PathLike | None = None) -> Any:
    """Solve an analysis with CalculiX and add the accurate stresses to it.

    Parameters
    ----------
    analysis : App.DocumentObject
        With supports and loads.
    folder : path, optional
        Where the solver's files stay; else they are removed.

    Returns
    -------
    App.DocumentObject
        The result of :func:`recover_stress`; the solver's own is beside it.

    Raises
    ------
    HybridVolumeError
        Something is missing or wrong: the mesh is out of date, a support or load is on another
        body, there is none at all, CalculiX is not installed or does not solve it.
    """
    from HybridVolume.objects.analysis import solve as run

    return run(analysis, folder)


def recover_stress(analysis: Any) -> Any:
    """Add a result with stresses at the nodes straight from the solver's displacements.

    CalculiX extrapolates the stress of 15-node wedges from inside; these are more accurate.

    Parameters
    ----------
    analysis : App.DocumentObject
        A solved analysis with the mesh of a hybrid volume.

    Returns
    -------
    App.DocumentObject

    Raises
    ------
    InputError
        Nothing was solved yet, or the mesh is older than its body.
    """
    from HybridVolume.objects.stress import recover_stress as recover

    return recover(analysis)
