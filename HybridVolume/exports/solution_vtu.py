# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Fields on the true geometry: rational Bézier hexahedra of the shell and curved tets in one .vtu.

ParaView evaluates a field with the functions of its cells, which are those that it was solved with:
displacements and temperatures are shown as they are, between the control points too. For a series
in time there is one .vtu a step, and a .pvd that lists them.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np

from HybridVolume.core.analysis.coupling import CollocationSpace, NitscheSpace
from HybridVolume.core.analysis.fields import Field, FieldSpace
from HybridVolume.core.analysis.simplex_space import lattice
from HybridVolume.core.atomic import replacing
from HybridVolume.errors import FaultError, InputError

from .vtk_xml import HEADER, Appended, strings_tag
from .vtu import BEZIER_HEXAHEDRON, bezier_order

_TETS = {1: 10, 2: 24, 3: 71}
"""VTK's linear, quadratic and Lagrange tetrahedra by degree."""

TENSOR = ("XX", "YY", "ZZ", "XY", "YZ", "XZ")
"""Order in which ParaView takes six components for a symmetric tensor."""
_OWN_ORDER = (0, 1, 2, 3, 5, 4)
"""Places of these in the program's own order of stresses: xx yy zz xy xz yz."""

_RESERVED = ("RationalWeights", "HigherOrderDegrees", "part", "patch", "face", "layer")


class SolutionFile:
    """Writes fields of one space; geometry is worked out once for all steps of a series.

    Parameters
    ----------
    space : CollocationSpace, NitscheSpace or FieldSpace
    """

    def __init__(self, space: CollocationSpace | NitscheSpace | FieldSpace) -> None:
        space = space if isinstance(space, FieldSpace) else FieldSpace(space)
        self.space = space
        cells, tets = space.cells, space.space.tets
        spline = space.space.spline
        orders = [bezier_order(batch.degrees) for batch in cells.batches]
        first, label = cells.shared
        self._chosen = first
        points = np.concatenate([batch.points.reshape(-1, 3) for batch in cells.batches])
        weights = np.concatenate([batch.weights.ravel() for batch in cells.batches])
        self._points = np.concatenate([points[first], tets.nodes])
        self._weights = np.concatenate([weights[first], np.ones(len(tets.nodes))])
        names = list(spline.face_names)
        place = {name: number for number, name in enumerate(names)}
        face = np.array([place[patch.face] for patch in spline.shell.surface.patches])
        connectivity, sizes, degrees, rows = [], [], [], []
        start = 0
        for batch, order in zip(cells.batches, orders, strict=True):
            end = start + len(order) * len(batch)
            connectivity.append(label[start:end].reshape(-1, len(order))[:, order].ravel())
            sizes.append(np.full(len(batch), len(order)))
            degrees.append(np.tile(np.array(batch.degrees, dtype=float), (len(batch), 1)))
            rows.append(np.column_stack([batch.patch, face[batch.patch], batch.layer]))
            start = end
        count = len(tets.elements)
        inside = tets.elements[:, vtk_tet_order(tets.degree)] + len(first)
        connectivity.append(inside.ravel())
        sizes.append(np.full(count, inside.shape[1]))
        degrees.append(np.zeros((count, 3)))
        rows.append(np.full((count, 3), -1))
        self._connectivity = np.concatenate(connectivity).astype(np.int64)
        self._offsets = np.cumsum(np.concatenate(sizes)).astype(np.int64)
        self._types = np.full(len(self._offsets), BEZIER_HEXAHEDRON, dtype=np.uint8)
        self._types[len(cells) :] = _TETS[tets.degree]
        self._degrees = np.concatenate(degrees)
        self._rows = np.concatenate(rows).astype(np.int32)
        self._part = (np.arange(len(self._offsets)) >= len(cells)).astype(np.int8)
        self._names = names

    def write(
        self,
        path: str | os.PathLike,
        fields: Mapping[str, Field | np.ndarray],
        *,
        time: float | None = None,
    ) -> None:
        """Write one file; an existing one is replaced in one step, or stays as it was.

        Parameters
        ----------
        path : path
            ``.vtu``
        fields : mapping of str to Field or array
            Point data by name: fields, or coefficients (size,) or (size, k) of the coupled
            unknowns. Three components are a vector, six a symmetric tensor in the program's order
            xx yy zz xy xz yz (written in ParaView's, with names).
        time : float, optional
            Stored as TimeValue, s.

        Raises
        ------
        InputError
            A field does not belong to this space, or has a name that the file needs itself.
        FaultError
            A field is not finite.
        OSError
            The place cannot be written.
        """
        appended = Appended()
        tags = [self._tag(appended, name, field) for name, field in fields.items()]
        head = strings_tag("face_names", self._names)
        if time is not None:
            head += (
                '<DataArray type="Float64" Name="TimeValue" NumberOfTuples="1" format="ascii">'
                f"{time!r}</DataArray>\n"
            )
        text = [
            HEADER,
            f"<FieldData>\n{head}</FieldData>\n"
            f'<Piece NumberOfPoints="{len(self._points)}" NumberOfCells="{len(self._offsets)}">\n'
            '<PointData RationalWeights="RationalWeights">\n',
            appended.tag("RationalWeights", self._weights),
            *tags,
            '</PointData>\n<CellData HigherOrderDegrees="HigherOrderDegrees">\n',
            appended.tag("HigherOrderDegrees", self._degrees),
            appended.tag("part", self._part),
            *(
                appended.tag(name, column)
                for name, column in zip(("patch", "face", "layer"), self._rows.T, strict=True)
            ),
            "</CellData>\n<Points>\n",
            appended.tag("Points", self._points),
            "</Points>\n<Cells>\n",
            appended.tag("connectivity", self._connectivity),
            appended.tag("offsets", self._offsets),
            appended.tag("types", self._types),
            "</Cells>\n</Piece>\n</UnstructuredGrid>\n",
        ]
        with replacing(path) as file:
            file.write("".join(text).encode("utf-8"))
            appended.finish(file)

    def _tag(self, appended: Appended, name: str, field: Field | np.ndarray) -> str:
        if name in _RESERVED:
            raise InputError(f"the file has data of its own named {name}", remedy="rename it")
        if not isinstance(field, Field):
            field = self.space.of(field)
        width = field.width
        values = np.concatenate([part.reshape(-1, width) for part in field.shell])[self._chosen]
        if len(field.core) != self.space.space.tets.size:
            raise InputError(f"{name} belongs to another space", remedy="give fields of this one")
        values = np.concatenate([values, field.core])
        if not np.isfinite(values).all():
            raise FaultError(f"{name} is not finite at some points")
        tag = appended.tag(name, values[:, _OWN_ORDER] if width == 6 else values.squeeze())
        if width == 6:
            titles = "".join(f' ComponentName{k}="{text}"' for k, text in enumerate(TENSOR))
            tag = tag.replace(" NumberOfComponents", f"{titles} NumberOfComponents", 1)
        return tag


def write_pvd(path: str | os.PathLike, steps: Sequence[tuple[float, str | os.PathLike]]) -> None:
    """Write the list of a series, which ParaView opens as one data set.

    Parameters
    ----------
    path : path
        ``.pvd``
    steps : sequence of (float, path)
        Time, s, and file of each step; files are named relative to the list.

    Raises
    ------
    InputError
        A file is not there.
    OSError
        The place cannot be written.
    """
    folder = Path(path).resolve().parent
    lines = []
    for time, file in steps:
        full = Path(file).resolve()
        if not full.is_file():
            raise InputError(f"{file} is not there", remedy="write the steps before the list")
        name = quoteattr(os.path.relpath(full, folder).replace(os.sep, "/"))
        lines.append(f'<DataSet timestep="{float(time)!r}" part="0" file={name}/>\n')
    text = (
        '<?xml version="1.0"?>\n<VTKFile type="Collection" version="0.1"'
        f' byte_order="LittleEndian">\n<Collection>\n{"".join(lines)}</Collection>\n</VTKFile>\n'
    )
    with replacing(path) as file:
        file.write(text.encode("utf-8"))


@cache
def vtk_tet_order(degree: int) -> np.ndarray:
    """VTK's order of the nodes of a tetrahedron: its list is ``nodes[order]`` of the lattice's.

    Corners, then along the edges 0-1, 1-2, 2-0, 0-3, 1-3, 2-3, then inside the faces 0-1-3, 1-2-3,
    2-0-3, 0-2-1.
    """
    counts = {tuple(count): k for k, count in enumerate(lattice(3, degree).tolist())}
    unit = np.eye(4, dtype=int)
    found = [degree * unit[corner] for corner in range(4)]
    for a, b in ((0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)):
        found += [(degree - k) * unit[a] + k * unit[b] for k in range(1, degree)]
    if degree == 3:
        faces = ((0, 1, 3), (1, 2, 3), (0, 2, 3), (0, 1, 2))
        found += [unit[list(face)].sum(axis=0) for face in faces]
    return np.array([counts[tuple(count.tolist())] for count in found])
