# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""The file of a hybrid volume: bit for bit, and no surprise from damaged or foreign files."""

import json
import math
import zipfile
from dataclasses import fields, is_dataclass

import numpy as np
import pytest
from shells import make_volume

from HybridVolume.core import hybrid as module
from HybridVolume.core.hybrid import HybridVolume, load_midstructure, save_midstructure
from HybridVolume.core.midstructure import Figures, Midstructure, Sheet
from HybridVolume.errors import FileFormatError


def differences(a, b, place="volume"):
    """Places where two values are not the same to the last bit."""
    if type(a) is not type(b):
        return [f"{place}: {type(a).__name__} and {type(b).__name__}"]
    if isinstance(a, np.ndarray):
        same = a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
        return [] if same else [place]
    if is_dataclass(a):
        pairs = [(f.name, getattr(a, f.name), getattr(b, f.name)) for f in fields(a)]
    elif isinstance(a, dict):
        pairs = [(k, a.get(k), b.get(k)) for k in sorted({*a, *b})]
    elif isinstance(a, list | tuple):
        pairs = [(str(k), x, y) for k, (x, y) in enumerate(zip(a, b, strict=True))]
    else:
        same = a == b or (isinstance(a, float) and math.isnan(a) and math.isnan(b))
        return [] if same else [place]
    return [found for name, x, y in pairs for found in differences(x, y, f"{place}.{name}")]


@pytest.fixture(scope="module")
def stored(tmp_path_factory):
    path = tmp_path_factory.mktemp("hybrid") / "torus.npz"
    make_volume("torus").save(path)
    return path


@pytest.mark.parametrize("name, order", [("torus", 2), ("hollow sphere", 1)])
def test_a_volume_is_read_back_bit_for_bit(tmp_path, name, order):
    volume = make_volume(name, order)
    volume.save(tmp_path / "a.npz")
    again = HybridVolume.load(tmp_path / "a.npz")
    assert differences(volume, again) == []
    assert again.surface is again.shell.surface
    assert again.shell.volume() == volume.shell.volume()
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]
    # the same volume gives the same numbers again
    again.save(tmp_path / "b.npz")
    with np.load(tmp_path / "a.npz") as a, np.load(tmp_path / "b.npz") as b:
        assert all(a[key].tobytes() == b[key].tobytes() for key in a.files)


def test_numpy_reads_the_file_without_pickles(stored):
    with np.load(stored, allow_pickle=False) as file:
        assert {file[key].dtype.kind for key in file.files} <= set("biuf")
        assert b'"format": "HybridVolume"' in file["header"].tobytes()


def refused(path, word):
    with pytest.raises(FileFormatError) as caught:
        HybridVolume.load(path)
    assert word in caught.value.line and "\n" not in caught.value.line
    assert path.name in caught.value.line


@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.9, 0.9999])
def test_truncated_files_are_refused(stored, tmp_path, share):
    data = stored.read_bytes()
    path = tmp_path / "cut.npz"
    path.write_bytes(data[: int(share * len(data))])
    refused(path, "damaged" if share else "not a hybrid volume")


def test_flipped_bytes_are_refused_or_change_nothing(stored, tmp_path):
    volume = make_volume("torus")
    data = stored.read_bytes()
    rng = np.random.default_rng(5)
    # anywhere, and in the directory at the end of the file where there is little room
    places = [*rng.integers(0, len(data), 150), *rng.integers(0, 400, 100)]
    places += (len(data) - rng.integers(1, 700, 150)).tolist()
    path = tmp_path / "flipped.npz"
    for place in places:
        broken = bytearray(data)
        broken[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(broken)
        try:
            again = HybridVolume.load(path)
        except FileFormatError:
            continue
        assert differences(volume, again) == []


def test_foreign_files_are_refused(tmp_path):
    path = tmp_path / "foreign.npz"
    np.savez(path, a=np.arange(3))
    refused(path, "not a hybrid volume")
    path.write_text("solid cube\n", encoding="utf-8")
    refused(path, "not a hybrid volume")
    with open(path, "wb") as file:
        np.save(file, np.arange(3))
    refused(path, "not a hybrid volume")
    with zipfile.ZipFile(path, "w") as file:
        file.writestr("Document.xml", "<Document/>")
    refused(path, "not a hybrid volume")
    refused(tmp_path / "missing.npz", "does not exist")
    refused(tmp_path, "cannot be read")


def rewritten(stored, path, old, new):
    with np.load(stored) as file:
        arrays = {key: file[key] for key in file.files}
    text = arrays["header"].tobytes()
    assert old in text
    arrays["header"] = np.frombuffer(text.replace(old, new), dtype=np.uint8)
    np.savez(path, **arrays)


@pytest.mark.parametrize(
    "old, new, word",
    [
        (b'"version": 4', b'"version": 5', "version 5"),
        (b'"format": "HybridVolume"', b'"format": "something"', "not a hybrid volume"),
        (b'"degree_w": 3', b'"degree_q": 3', "degree_q"),
        (b'"type": "Shell"', b'"type": "Popen"', "damaged"),
        (b'"start": ', b'"start": 9', "damaged"),
        (b'"root": {"type"', b'"root": {"list": [], "type"', "no hybrid volume"),
        (b'{"tuple"', b'{"touple"', "damaged"),
        (b"[", b"", "damaged"),
    ],
)
def test_headers_that_do_not_fit_are_refused(stored, tmp_path, old, new, word):
    path = tmp_path / "other.npz"
    rewritten(stored, path, old, new)
    refused(path, word)


def test_a_save_that_fails_leaves_the_old_file(stored, tmp_path, monkeypatch):
    path = tmp_path / "kept.npz"
    path.write_bytes(b"old")

    def fail(file, **arrays):
        file.write(b"half")
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(module.np, "savez", fail)
    with pytest.raises(OSError, match="No space"):
        make_volume("torus").save(path)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_what_a_file_cannot_hold_is_said_when_it_is_written(tmp_path):
    volume = make_volume("torus")
    for value in (object(), {1: 2}, np.array(["a"])):
        volume.report["odd"] = value
        try:
            with pytest.raises(TypeError, match="cannot hold"):
                volume.save(tmp_path / "a.npz")
        finally:
            del volume.report["odd"]
    assert list(tmp_path.iterdir()) == []


def a_midstructure():
    """A triangle, a line and a point, with figures of two cells."""
    figures = Figures(
        of_facet=np.array([0, 1, 1]),
        patch=np.array([[0, 1], [1, 2]]),
        foot=np.linspace(0.0, 1.0, 8).reshape(2, 2, 2),
        centre=np.eye(3)[:2],
        **{name: np.array([0.1, 1.0 / 3.0]) for name in ("radius", "length", "angle")},
        **{name: np.array([0.7, 0.2]) for name in ("area", "spacing")},
        wedge=np.array([True, False]),
        ridge=np.array([False, True]),
        group=np.array([0, 4]),
        edges=np.array([[0, 1]]),
        edge=np.array([0]),
    )
    sheets = tuple(
        Sheet(faces, 1.5, (0.1, 0.2), (60.0, 180.0), kept, "between", (0.0, 0.5, 1.0), (0.25, 0.75))
        for faces, kept in ((("Face1", "Face2"), True), (("Face2", "Face3"), False))
    )
    return Midstructure(
        vertices=np.eye(4, 3),
        facets=np.array([[0, 1, 2], [0, 3, 3], [2, 2, 2]]),
        sheet=np.array([0, 1, 1]),
        kept=np.array([True, False, False]),
        radius=np.array([0.1, 0.2, 0.3, 0.4]),
        sheets=sheets,
        faces=("Face1", "Face2", "Face3"),
        figures=figures,
        probe_points=np.eye(3),
        probe_radius=np.full(3, 0.5),
        unmatched=("keep Face7+Face8",),
    )


def test_a_midstructure_alone_is_read_back_bit_for_bit(stored, tmp_path):
    path = tmp_path / "sheets.npz"
    found = a_midstructure()
    save_midstructure(found, path)
    again = load_midstructure(path)
    assert differences(found, again) == []
    assert again.sheets[0].name == "Face1+Face2@0.25,0.75"
    refused(path, "no hybrid volume")
    with pytest.raises(FileFormatError, match="holds no midstructure"):
        load_midstructure(stored)


@pytest.mark.parametrize("version", [1, 3])
def test_a_volume_of_an_earlier_version_is_read(stored, tmp_path, version):
    with np.load(stored) as file:
        arrays = {key: file[key] for key in file.files}
    header = json.loads(arrays["header"].tobytes())
    fem = header["root"]["fields"]["fem"]["fields"]
    for name in ("density", "surface_nodes", "surface_patch", "surface_uv"):
        del fem[name]
    fem["repairs"] = 7
    header["version"] = version
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), dtype=np.uint8)
    np.savez(tmp_path / "old.npz", **arrays)
    volume, again = make_volume("torus"), HybridVolume.load(tmp_path / "old.npz")
    assert all(place.startswith("volume.fem.repairs") for place in differences(volume, again))
    assert again.fem.repairs == dict.fromkeys(volume.fem.repairs, 0) | {"straightened": 7}
