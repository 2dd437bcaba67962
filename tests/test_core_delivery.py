# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Output folders: everything arrives, or everything is as it was."""

import os

import pytest

from HybridVolume.delivery import OutputFolder
from HybridVolume.errors import InputError


def tree(folder):
    return {
        str(path.relative_to(folder)): path.read_text() if path.is_file() else None
        for path in folder.rglob("*")
    }


def write(output, **files):
    for name, text in files.items():
        (output.files / name).write_text(text)


def test_a_new_folder_appears_whole(tmp_path):
    with OutputFolder(tmp_path / "a" / "b") as output:
        write(output, one="1", two="2")
        (output.scratch / "rest").write_text("x")
        assert not (tmp_path / "a" / "b").exists()
        assert output.deliver() == ["one", "two"]
    assert tree(tmp_path) == {"a": None, "a/b": None, "a/b/one": "1", "a/b/two": "2"}
    assert (tmp_path / "a" / "b").stat().st_mode & 0o777 == 0o777 & ~_umask()


def _umask():
    mask = os.umask(0)
    os.umask(mask)
    return mask


def test_without_delivery_nothing_stays(tmp_path):
    with pytest.raises(KeyboardInterrupt), OutputFolder(tmp_path / "a" / "b") as output:
        write(output, one="1")
        raise KeyboardInterrupt
    assert tree(tmp_path) == {}


def test_an_existing_folder_keeps_its_other_files(tmp_path):
    (tmp_path / "mine").write_text("kept")
    (tmp_path / "one").write_text("old")
    with OutputFolder(tmp_path) as output:
        write(output, one="new", two="2")
        output.deliver()
    assert tree(tmp_path) == {"mine": "kept", "one": "new", "two": "2"}


def test_a_folder_in_the_way_changes_nothing(tmp_path):
    (tmp_path / "one").write_text("old")
    (tmp_path / "two").mkdir()
    (tmp_path / "two" / "precious").write_text("kept")
    before = tree(tmp_path)
    with pytest.raises(InputError, match="two cannot be written"), OutputFolder(tmp_path) as output:
        write(output, one="new", two="2", three="3")
        output.deliver()
    assert tree(tmp_path) == before


@pytest.mark.parametrize("place", ["file", "file/below"])
def test_a_place_that_cannot_be_written_is_told_at_once(tmp_path, place):
    (tmp_path / "file").write_text("x")
    with pytest.raises(InputError, match="-o"), OutputFolder(tmp_path / place):
        pytest.fail("it must not get this far")
    assert tree(tmp_path) == {"file": "x"}
