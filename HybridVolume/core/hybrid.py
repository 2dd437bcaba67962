# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The hybrid volume (V, T, I) of section 3.4, Eq. 5, with what led to it, and its file.

The file is an .npz without pickles: a JSON header that describes the dataclasses, and one array for
each kind of number that holds all arrays one after the other. It is read back bit for bit.
"""

from __future__ import annotations

import io
import json
import logging
import os
import struct
import zipfile
import zlib
from dataclasses import dataclass, field, fields, is_dataclass, replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError
from .atomic import replacing
from .finite_elements import REPAIRS, FiniteElementMesh
from .interior import Interface, Interior
from .midstructure import Midstructure
from .old_meshes import completed
from .shell import Shell
from .surface import PatchSurface
from .validity import Certificate

logger = logging.getLogger(__name__)

FORMAT = "HybridVolume"
VERSION = 4
"""Goes up when an earlier program cannot read a new file any more."""

READ = (1, 2, 3, 4)
"""Versions that can be read; 1 knows no figures of medial cells, 2 no levels of columns, 3 no
wanted density of the finite elements and no parameters of their outer nodes."""

_HOMES = {
    "Certificate": "validity",
    "Density": "density",
    "Figures": "midstructure",
    "FiniteElementMesh": "finite_elements",
    "HybridVolume": "hybrid",
    "Interface": "interior",
    "Interior": "interior",
    "Midstructure": "midstructure",
    "Patch": "surface",
    "PatchSurface": "surface",
    "Sheet": "midstructure",
    "Shell": "shell",
    "TetMesh": "tetmesh",
}
"""Dataclasses that a file may contain, and the module of each; nothing else is ever made."""


@dataclass(frozen=True)
class HybridVolume:
    """A completed body: H = (V, T, I).

    Attributes
    ----------
    surface : PatchSurface
        The outer boundary S.
    midstructure : Midstructure
    field : dict
        Figures of the harmonic field (plain values).
    shell : Shell
        V.
    certificate : Certificate
        Proof for every Bézier element of the shell.
    interior : Interior
        T.
    interface : Interface
        I.
    fem : FiniteElementMesh
        One conforming mesh of both.
    gap_volume : float
        Signed volume between the core's flat facets and the inner surface, mm³;
        shell + core + gap is the body's volume.
    report : dict
        Figures of the run (plain values).
    """

    surface: PatchSurface
    midstructure: Midstructure
    field: dict[str, Any]
    shell: Shell
    certificate: Certificate
    interior: Interior
    interface: Interface
    fem: FiniteElementMesh
    gap_volume: float
    report: dict[str, Any] = field(default_factory=dict)

    def save(self, path: str | os.PathLike) -> None:
        """Write the file; an existing one is replaced in one step, or stays as it was.

        Raises
        ------
        OSError
            The place cannot be written.
        """
        save(self, path)

    @staticmethod
    def load(path: str | os.PathLike) -> HybridVolume:
        """Read a file that `save` wrote.

        Raises
        ------
        FileFormatError
            The file is missing, damaged, foreign or of another version.
        """
        return load(path)


def save(volume: HybridVolume, path: str | os.PathLike) -> None:
    """Write a hybrid volume; see `HybridVolume.save`."""
    _save(volume, path)


def load(path: str | os.PathLike) -> HybridVolume:
    """Read a hybrid volume; see `HybridVolume.load`."""
    found = _load(path, HybridVolume, "hybrid volume")
    return replace(found, fem=completed(found.fem, found.shell, found.interface))


def save_midstructure(midstructure: Midstructure, path: str | os.PathLike) -> None:
    """Write a midstructure alone; an existing file is replaced in one step, or stays as it was.

    Raises
    ------
    OSError
        The place cannot be written.
    """
    _save(midstructure, path)


def load_midstructure(path: str | os.PathLike) -> Midstructure:
    """Read a file that `save_midstructure` wrote, bit for bit.

    Raises
    ------
    FileFormatError
        The file is missing, damaged, foreign or of another version.
    """
    return _load(path, Midstructure, "midstructure")


def _save(value: HybridVolume | Midstructure, path: str | os.PathLike) -> None:
    writer = _Writer()
    header = {"format": FORMAT, "version": VERSION, "root": writer.encode(value)}
    buffers = writer.buffers()
    text = np.frombuffer(json.dumps(header).encode("utf-8"), dtype=np.uint8)
    with replacing(path) as file:
        np.savez(file, header=text, **buffers)
    logger.info("%s written", path)


def _load(path: str | os.PathLike, kind: type, word: str) -> Any:
    name = Path(path).name
    remedy = f"compute the {word} again"
    try:
        header, buffers = _read(path)
        found = _Reader(buffers).decode(header["root"])
    except _ForeignError as error:
        raise FileFormatError(f"{name} {error}", remedy=remedy) from None
    except FileNotFoundError:
        raise FileFormatError(f"{name} does not exist", remedy="name another file") from None
    except OSError as error:
        raise FileFormatError(
            f"{name} cannot be read: {error.strerror or error}", remedy="name another file"
        ) from error
    except _DAMAGE as error:
        raise FileFormatError(f"{name} is damaged ({_short(error)})", remedy=remedy) from error
    if not isinstance(found, kind):
        raise FileFormatError(f"{name} holds no {word}", remedy=remedy)
    return found


_DAMAGE = (
    *(zipfile.BadZipFile, zlib.error, EOFError, struct.error, RecursionError, MemoryError),
    *(ValueError, KeyError, TypeError, IndexError, AttributeError, NotImplementedError),
    *(OverflowError, SyntaxError, RuntimeError),
)
"""What numpy, zipfile and the decoder raise on damaged files."""


class _ForeignError(Exception):
    """The file is whole but is not what this program reads."""


def _read(path: str | os.PathLike) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """Header and buffers of a file of the right format and version."""
    foreign = "is not a hybrid volume"
    with open(path, "rb") as file:
        if file.read(2) != b"PK":
            raise _ForeignError(foreign)
        with zipfile.ZipFile(file) as archive:
            names = {member.removesuffix(".npy") for member in archive.namelist()}
            if "header" not in names:
                raise _ForeignError(foreign)
            header = json.loads(_member(archive, "header").tobytes().decode("utf-8"))
            if not isinstance(header, dict) or header.get("format") != FORMAT:
                raise _ForeignError(foreign)
            if header.get("version") not in READ:
                raise _ForeignError(
                    f"has version {header.get('version')} of the format, this program reads"
                    f" {' and '.join(map(str, READ))}"
                )
            return header, {name: _member(archive, name) for name in names - {"header"}}


def _member(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    # read as a whole, so that its checksum is compared before anything is made of it
    data = archive.read(f"{name}.npy")
    return np.lib.format.read_array(io.BytesIO(data), allow_pickle=False)


def _short(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return (text or type(error).__name__)[:120]


class _Writer:
    """Turns dataclasses into plain values; arrays go to the buffers, shared objects are named."""

    def __init__(self) -> None:
        self._arrays: dict[str, list[np.ndarray]] = {}
        self._lengths: dict[str, int] = {}
        self._seen: dict[int, int] = {}
        # keeps ids unique while encoding
        self._alive: list[Any] = []

    def buffers(self) -> dict[str, np.ndarray]:
        """One flat array for each kind of number."""
        return {key: np.concatenate(parts) for key, parts in self._arrays.items()}

    def encode(self, value: Any) -> Any:
        if value is None or isinstance(value, bool | int | float | str):
            return value
        if isinstance(value, np.generic):
            return value.item()
        if isinstance(value, np.ndarray):
            return self._array(value)
        if isinstance(value, tuple):
            return {"tuple": [self.encode(v) for v in value]}
        if isinstance(value, list):
            return {"list": [self.encode(v) for v in value]}
        if isinstance(value, dict) and all(isinstance(key, str) for key in value):
            return {"dict": {key: self.encode(v) for key, v in value.items()}}
        if is_dataclass(value) and type(value).__name__ in _HOMES:
            return self._object(value)
        raise TypeError(f"a hybrid volume's file cannot hold a {type(value).__name__}")

    def _object(self, value: Any) -> dict:
        if id(value) in self._seen:
            return {"same": self._seen[id(value)]}
        number = len(self._alive)
        self._seen[id(value)] = number
        self._alive.append(value)
        parts = {f.name: self.encode(getattr(value, f.name)) for f in fields(value) if f.init}
        return {"type": type(value).__name__, "number": number, "fields": parts}

    def _array(self, value: np.ndarray) -> dict:
        if value.dtype.kind not in "biuf":
            raise TypeError(f"a hybrid volume's file cannot hold an array of {value.dtype}")
        little = np.ascontiguousarray(value).astype(value.dtype.newbyteorder("<"), copy=False)
        key = little.dtype.str[1:]
        start = self._lengths.get(key, 0)
        self._arrays.setdefault(key, []).append(little.ravel())
        self._lengths[key] = start + little.size
        return {"array": key, "start": start, "shape": list(value.shape)}


class _Reader:
    """Reverses `_Writer`."""

    def __init__(self, buffers: dict[str, np.ndarray]) -> None:
        self._buffers = buffers
        self._objects: dict[int, Any] = {}

    def decode(self, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        if "array" in value:
            return self._array(value)
        if "tuple" in value:
            return tuple(self.decode(v) for v in value["tuple"])
        if "list" in value:
            return [self.decode(v) for v in value["list"]]
        if "dict" in value:
            return {key: self.decode(v) for key, v in value["dict"].items()}
        if "same" in value:
            return self._objects[value["same"]]
        name = value["type"]
        made = getattr(import_module(f".{_HOMES[name]}", __package__), name)
        parts = {key: self.decode(v) for key, v in value["fields"].items()}
        if isinstance(parts.get("repairs"), int):
            # one count up to version 3
            parts["repairs"] = dict.fromkeys(REPAIRS, 0) | {"straightened": parts["repairs"]}
        unknown = set(parts) - {f.name for f in fields(made)}
        if unknown:
            raise _ForeignError(
                f"has a {name} with {', '.join(sorted(unknown))}, which this program does not know"
            )
        found = made(**parts)
        self._objects[value["number"]] = found
        return found

    def _array(self, value: dict) -> np.ndarray:
        shape = tuple(value["shape"])
        size = int(np.prod(shape, dtype=np.int64))
        part = self._buffers[value["array"]][value["start"] : value["start"] + size]
        if len(part) != size:
            raise ValueError("an array is cut off")
        return part.reshape(shape).copy()
