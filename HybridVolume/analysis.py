# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Analysis on hybrid volumes: on the exact shell and the core themselves, without another mesh.

::

    from HybridVolume import analysis

    heat = analysis.poisson(volume, fixed={"Face1": 20.0, "Face4": 80.0}, conductivity=0.043)
    heat.at([[1.0, 2.0, 3.0]])                       # temperatures of points
    pull = analysis.elasticity(volume, fixed={"Face1": 0.0}, force={"Face4": (0, 0, -500.0)})
    pull.displacement("Face4").max(), pull.von_mises(points), pull.reaction("Face1")
    pull.save_vtu("pull.vtu")                        # for ParaView, on the true geometry
    pull.to_document(FreeCAD.ActiveDocument)         # for the FEM workbench's result panel

Units are mm, N, MPa, t (1000 kg), s and W: Young's modulus in MPa, density in t/mm³ (steel:
7.9e-9), accelerations in mm/s² (gravity: 9810), conductivity in W/(mm K) (steel: 0.043). Everything
runs in this process, with numpy and scipy alone, or faster on large bodies with pyamg.

A value on a face is a number, a vector, or a function of (m, 3) points (mm) that returns m of them.
Where every face is meant, the value can stand without a face.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from HybridVolume.analysis_results import DisplacementResult, ModalResult, ScalarResult
from HybridVolume.analysis_values import FaceValues, OnFaces, added, as_function, body_forces
from HybridVolume.core.analysis.coupling import CollocationSpace, NitscheSpace
from HybridVolume.core.analysis.elasticity import solve_elasticity
from HybridVolume.core.analysis.hybrid_space import of_volume, refined
from HybridVolume.core.analysis.poisson import solve_poisson
from HybridVolume.core.analysis.spline_space import check_faces
from HybridVolume.core.hybrid import HybridVolume, load
from HybridVolume.core.recovery import Material
from HybridVolume.core.tetmesh.door import meshers_of
from HybridVolume.errors import InputError, SetupError
from HybridVolume.worker_process import worker_python

__all__ = [
    "STEEL",
    "STEEL_DENSITY",
    "DisplacementResult",
    "Material",
    "ModalResult",
    "ScalarResult",
    "elasticity",
    "modal",
    "poisson",
    "space",
]

STEEL = Material(210000.0, 0.3)
"""FreeCAD's CalculiX-Steel, MPa."""
STEEL_DENSITY = 7.9e-9
"""Its density, t/mm³."""


def space(
    volume: Any,
    *,
    degree: int = 2,
    coupling: str = "collocation",
    parts: int = 1,
    refine: int = 0,
) -> CollocationSpace | NitscheSpace:
    """The unknowns on a hybrid volume, to be used for several problems or other ones.

    Parameters
    ----------
    volume : HybridVolume, path or App.DocumentObject
        A path is a stored hybrid volume (``.npz``); an object a hybrid volume, one of its parts, or
        the body it was made of.
    degree : {1, 2, 3}
        Of the core's tetrahedra; the shell keeps its own degrees, raised to this one where they are
        lower. 3 needs ``coupling="nitsche"``.
    coupling : {"collocation", "nitsche"}
        How the core follows the shell: point by point (the paper's way), or in the mean, which
        passes linear solutions exactly where the interface is flat, keeps the order of cubics, and
        has far better stresses at the interface: a ball of 24 knot spans of degree 4 under a
        pressure of 5 MPa should have no von Mises stress; it has up to 8.0 MPa by collocation and
        .28 MPa by Nitsche's method, with the same elements.
    parts : int
        Parts that each layer of the shell is cut into.
    refine : int
        How often every element is halved along all directions: unknowns grow eightfold each time.

    Raises
    ------
    InputError
        It is no hybrid volume, or a value is out of its range.
    MesherError, SetupError
        The core had to be filled anew, under a finer interface, and could not.
    """
    given = volume_of(volume)
    if isinstance(refine, bool) or not isinstance(refine, int) or refine < 0:
        raise InputError(f"refine = {refine!r}", remedy="give 0, 1, 2, ...")
    if isinstance(parts, bool) or not isinstance(parts, int) or parts < 1:
        raise InputError(f"parts = {parts!r}", remedy="give 1, 2, ...")
    with contextlib.ExitStack() as stack:
        # where this Python has no mesher, as FreeCAD's own, the worker's are there
        with contextlib.suppress(SetupError):
            stack.enter_context(meshers_of(worker_python()))
        found = of_volume(given, degree=degree, coupling=coupling, parts=parts)
        for _ in range(refine):
            found = refined(found)
    return found


def volume_of(volume: Any) -> HybridVolume:
    """The hybrid volume that is meant; see `space`.

    Raises
    ------
    InputError
        It is none, or has no result yet.
    """
    if isinstance(volume, HybridVolume):
        return volume
    if isinstance(volume, str | os.PathLike):
        return load(volume)
    if hasattr(volume, "Document"):
        from HybridVolume.objects.inner import stored_volume
        from HybridVolume.objects.stored_mesh import volume_object_of

        return stored_volume(volume_object_of(volume))
    raise InputError(
        f"a {type(volume).__name__} is no hybrid volume",
        remedy="give the result of HybridVolume.complete, its file, or its object",
    )


def poisson(
    volume: Any,
    *,
    fixed: OnFaces,
    source: float | Callable = 0.0,
    flux: OnFaces | None = None,
    conductivity: float = 1.0,
    core_conductivity: float | None = None,
    **options: Any,
) -> ScalarResult:
    """Solve -div(k grad u) = f: steady heat, or any potential.

    Parameters
    ----------
    volume : HybridVolume, path, App.DocumentObject, or a space of `space`
    fixed : mapping of str to value, or value
        Temperature on CAD faces (or on all), °C or K: numbers or functions of points. Through other
        faces nothing flows unless ``flux`` says so.
    source : float or callable
        Heat made inside, W/mm³; a function takes (m, 3) points, mm, and returns (m,) values.
    flux : mapping of str to value, or value, optional
        Heat that flows in through CAD faces, W/mm².
    conductivity : float
        k, W/(mm K).
    core_conductivity : float, optional
        Of the core, where it is another.
    **options
        ``degree``, ``coupling``, ``parts`` and ``refine`` of `space`; ``coupling="nitsche"`` has
        far better gradients and stresses at the interface.

    Returns
    -------
    ScalarResult

    Raises
    ------
    InputError
        It is no hybrid volume, there is no such face, nothing is fixed, or a value has a wrong
        shape or is not finite.
    FaultError
        The linear system was not solved.

    Examples
    --------
    >>> warm = poisson(volume, fixed={"Face1": 20.0, "Face4": 80.0}, conductivity=0.043)
    >>> warm.at([[1.0, 2.0, 3.0]])  # °C
    """
    given, on = _space_of(volume, options)
    k = [conductivity, conductivity if core_conductivity is None else core_conductivity]
    for one in k:
        if not (np.isscalar(one) and 0.0 < float(one) < np.inf):
            raise InputError(f"a conductivity of {one!r} W/(mm K)", remedy="give one above 0")
    faces = FaceValues(on.spline, 1)
    held = faces.given("fixed", fixed)
    if not held:
        raise InputError("no temperature is given", remedy="give it on one face at least")
    solution = solve_poisson(
        on,
        as_function("source", source, 1),
        held,
        (float(k[0]), float(k[1])),
        faces.given("flux", flux),
    )
    return ScalarResult(on, given, solution, (float(k[0]), float(k[1])))


def elasticity(
    volume: Any,
    material: Material = STEEL,
    *,
    fixed: OnFaces | None = None,
    pressure: OnFaces | None = None,
    traction: OnFaces | None = None,
    force: Mapping[str, Sequence[float]] | None = None,
    body_force: Sequence[float] | Callable | None = None,
    acceleration: Sequence[float] | None = None,
    density: float | Sequence[float] | None = None,
    core_material: Material | None = None,
    balanced: bool = False,
    **options: Any,
) -> DisplacementResult:
    """Solve linear elasticity, static.

    Parameters
    ----------
    volume : HybridVolume, path, App.DocumentObject, or a space of `space`
    material : Material
        Young's modulus (MPa) and Poisson's ratio.
    fixed : mapping of str to value, or value
        Displacements on CAD faces, mm: 0, a vector (x, y, z) in which None leaves a direction free
        (a plane of symmetry), or a function of points that returns (m, 3).
    pressure : mapping of str to value, or value, optional
        On CAD faces (or on all), MPa; it pushes inward.
    traction : mapping of str to vector or function, optional
        Force over area, MPa.
    force : mapping of str to vector, optional
        Total force on a CAD face, N, spread evenly.
    body_force : vector or callable, optional
        N/mm³.
    acceleration : vector, optional
        mm/s²; its force is density times acceleration: (0, 0, -9810) is weight.
    density : float or (float, float), optional
        t/mm³, needed with ``acceleration``; of shell and core where there are two.
    core_material : Material, optional
        Of the core, where it is another.
    balanced : bool
        Nothing is fixed: the loads balance, and the result has no rigid motion (in L2).
    **options
        ``degree``, ``coupling``, ``parts`` and ``refine`` of `space`; ``coupling="nitsche"`` has
        far better gradients and stresses at the interface.

    Returns
    -------
    DisplacementResult

    Raises
    ------
    InputError
        It is no hybrid volume, there is no such face, nothing is fixed, the loads do not balance,
        or a value has a wrong shape or is not finite.
    FaultError
        The linear system was not solved: the body can still move freely.

    Examples
    --------
    >>> bent = elasticity(volume, STEEL, fixed={"Face1": 0.0}, force={"Face4": (0.0, 0.0, -500.0)})
    >>> bent.displacement("Face4")[:, 2].min()  # mm
    """
    given, on = _space_of(volume, options)
    for one in (material, core_material or material):
        if not isinstance(one, Material):
            raise InputError(
                f"{one!r} is no material",
                remedy="give HybridVolume.analysis.Material(young, poisson), MPa",
            )
    faces = FaceValues(on.spline, 3)
    loads = [
        faces.pressures(pressure),
        faces.tractions(traction),
        faces.forces(force),
    ]
    weights = body_forces(body_force, acceleration, density)
    solution = solve_elasticity(
        on,
        (material, core_material or material),
        fixed=faces.given("fixed", fixed, partly=True),
        tractions=added(loads),
        body_force=weights,
        balanced=balanced,
    )
    return DisplacementResult(on, given, solution, (material, core_material or material))


def modal(
    volume: Any,
    material: Material = STEEL,
    density: float | Sequence[float] = STEEL_DENSITY,
    *,
    fixed: Sequence[str] = (),
    count: int = 12,
    core_material: Material | None = None,
    **options: Any,
) -> ModalResult:
    """Find the slowest natural vibrations.

    Parameters
    ----------
    volume : HybridVolume, path, App.DocumentObject, or a space of `space`
    material : Material
    density : float or (float, float)
        t/mm³, of all or of shell and core.
    fixed : sequence of str
        CAD faces that are held.
    count : int
        Number of modes; a body that nothing holds has six rigid ones of frequency 0 first.
    core_material : Material, optional
        Of the core, where it is another.
    **options
        ``degree``, ``coupling``, ``parts`` and ``refine`` of `space`; ``coupling="nitsche"`` has
        far better gradients and stresses at the interface.

    Returns
    -------
    ModalResult

    Raises
    ------
    InputError
        It is no hybrid volume, there is no such face, or a value is out of its range.
    FaultError
        The modes were not found.
    """
    from HybridVolume.core.analysis.modal import modal as solve

    given, on = _space_of(volume, options)
    names = [fixed] if isinstance(fixed, str) else list(fixed)
    check_faces(on.spline.face_names, names)
    materials = material, core_material or material
    return ModalResult(on, given, solve(on, materials, density, count, fixed=names), materials)


def _space_of(
    volume: Any, options: Mapping[str, Any]
) -> tuple[HybridVolume | None, CollocationSpace | NitscheSpace]:
    if isinstance(volume, CollocationSpace | NitscheSpace):
        if options:
            raise InputError(
                f"{', '.join(options)}: the space is already made",
                remedy="give it to HybridVolume.analysis.space",
            )
        return None, volume
    known = ("degree", "coupling", "parts", "refine")
    unknown = [name for name in options if name not in known]
    if unknown:
        raise InputError(
            f"{', '.join(unknown)}: no such argument", remedy=f"there are {', '.join(known)}"
        )
    given = volume_of(volume)
    return given, space(given, **options)
