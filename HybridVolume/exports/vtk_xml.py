# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The common parts of VTK's XML files: compressed arrays after the tags that describe them."""

from __future__ import annotations

import base64
import struct
import zlib
from collections.abc import Sequence
from typing import BinaryIO

import numpy as np

HEADER = (
    '<?xml version="1.0"?>\n'
    '<VTKFile type="UnstructuredGrid" version="2.2" byte_order="LittleEndian"'
    ' header_type="UInt64" compressor="vtkZLibDataCompressor">\n<UnstructuredGrid>\n'
)
"""First lines of an unstructured grid."""

_BLOCK = 1 << 20
_TYPES = {"f8": "Float64", "i8": "Int64", "i4": "Int32", "u1": "UInt8", "i1": "Int8"}


def strings_tag(name: str, texts: Sequence[str]) -> str:
    """Tag of an array of texts, which stand in it as UTF-8 codes."""
    codes = " ".join(str(code) for text in texts for code in (*text.encode("utf-8"), 0))
    return (
        f'<DataArray type="String" Name="{name}" NumberOfTuples="{len(texts)}" format="ascii">'
        f"{codes}</DataArray>\n"
    )


class Appended:
    """Arrays for the appended part: base64 of zlib blocks, and the tag of each."""

    def __init__(self) -> None:
        self._parts: list[bytes] = []
        self._length = 0

    def tag(self, name: str, values: np.ndarray) -> str:
        """Store an array, (n,) or (n, components); its DataArray tag."""
        components = 1 if values.ndim == 1 else values.shape[1]
        little = np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<"))
        text = _encoded(little.tobytes())
        tag = (
            f'<DataArray type="{_TYPES[little.dtype.str[1:]]}" Name="{name}"'
            f' NumberOfComponents="{components}" format="appended" offset="{self._length}"/>\n'
        )
        self._parts.append(text)
        self._length += len(text)
        return tag

    def finish(self, file: BinaryIO) -> None:
        """Write everything stored, and the end of the file."""
        file.write(b'<AppendedData encoding="base64">\n_')
        file.writelines(self._parts)
        file.write(b"\n</AppendedData>\n</VTKFile>\n")


def _encoded(raw: bytes) -> bytes:
    blocks = [zlib.compress(raw[s : s + _BLOCK], 5) for s in range(0, len(raw), _BLOCK)]
    rest = len(raw) % _BLOCK
    header = struct.pack(
        f"<{3 + len(blocks)}Q", len(blocks), _BLOCK, rest, *(len(b) for b in blocks)
    )
    return base64.b64encode(header) + base64.b64encode(b"".join(blocks))
