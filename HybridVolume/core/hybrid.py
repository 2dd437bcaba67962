# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The hybrid volume (V, T, I) of section 3.4, Eq. 5, with what led to it, and its file.

The file is an .npz without pickles: a JSON header that describes the dataclasses, and one array for
each kind of number that holds all arrays one after the other. It is read back bit for bit.
"""

from __future__ import annotations

import json
import logging
import os
import zipfile
import zlib
from dataclasses import dataclass, field, fields, is_dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import FileFormatError
from .atomic import replacing
from .finite_elements import FiniteElementMesh
from .interior import Interface, Interior
from .midstructure import Midstructure
from .shell import Shell
from .surface import PatchSurface
from .validity import Certificate

logger = logging.getLogger(__name__)

FORMAT = "HybridVolume"
VERSION = 1
"""Goes up when a file of the earlier version cannot be read any more."""

_HOMES = {
    "Certificate": "validity",
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

_REMEDY = "compute the hybrid volume again"


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
    writer = _Writer()
    header = {"format": FORMAT, "version": VERSION, "root": writer.encode(volume)}
    buffers = writer.buffers()
    text = np.frombuffer(json.dumps(header).encode("utf-8"), dtype=np.uint8)
    with replacing(path) as file:
        np.savez(file, header=text, **buffers)
    logger.info("%s written", path)


def load(path: str | os.PathLike) -> HybridVolume:
    """Read a hybrid volume; see `HybridVolume.load`."""
    name = Path(path).name
    try:
        with np.load(path, allow_pickle=False) as file:
            if not isinstance(file, np.lib.npyio.NpzFile) or "header" not in file.files:
                raise FileFormatError(f"{name} is not a hybrid volume", remedy=_REMEDY)
            header = json.loads(file["header"].tobytes().decode("utf-8"))
            _check_header(name, header)
            buffers = {key: file[key] for key in file.files if key != "header"}
        found = _Reader(buffers).decode(header["root"])
    except FileFormatError:
        raise
    except FileNotFoundError:
        raise FileFormatError(f"{name} does not exist", remedy="name another file") from None
    except (zipfile.BadZipFile, zlib.error, EOFError, ValueError, KeyError, TypeError) as error:
        raise FileFormatError(f"{name} is damaged ({_short(error)})", remedy=_REMEDY) from error
    except (IndexError, AttributeError, OverflowError, NotImplementedError, MemoryError) as error:
        raise FileFormatError(f"{name} is damaged ({_short(error)})", remedy=_REMEDY) from error
    except OSError as error:
        raise FileFormatError(
            f"{name} cannot be read: {error.strerror or error}", remedy="name another file"
        ) from error
    if not isinstance(found, HybridVolume):
        raise FileFormatError(f"{name} holds no hybrid volume", remedy=_REMEDY)
    return found


def _short(error: BaseException) -> str:
    text = " ".join(str(error).split())
    return (text or type(error).__name__)[:120]


def _check_header(name: str, header: Any) -> None:
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        raise FileFormatError(f"{name} is not a hybrid volume", remedy=_REMEDY)
    if header.get("version") != VERSION:
        raise FileFormatError(
            f"{name} has version {header.get('version')} of the format, this program reads"
            f" {VERSION}",
            remedy=_REMEDY,
        )


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
        unknown = set(parts) - {f.name for f in fields(made)}
        if unknown:
            raise FileFormatError(
                f"the file's {name} has {', '.join(sorted(unknown))}, which this program does not"
                " know",
                remedy=_REMEDY,
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
