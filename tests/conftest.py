# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Fixtures of all tests."""

import os
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(PROJECT))


@pytest.fixture(scope="session")
def shared_data() -> Path:
    """Folder of the shared input files, which are not part of the project."""
    named = os.environ.get("HYBRIDVOLUME_SHARED")
    folder = Path(named) if named else PROJECT.parent / "shared" / "data"
    if not (folder / "untrimmed").is_dir():
        pytest.skip(f"no shared input files in {folder} (HYBRIDVOLUME_SHARED names another place)")
    return folder


@pytest.fixture(scope="session")
def python():
    """The worker's interpreter."""
    from HybridVolume.errors import SetupError
    from HybridVolume.job import worker_python

    try:
        return worker_python()
    except SetupError as missing:
        pytest.skip(missing.line)


@pytest.fixture
def place(tmp_path):
    """An empty working folder, and beside it one for temporary files that must end empty."""
    (tmp_path / "here").mkdir()
    (tmp_path / "temporary").mkdir()
    return tmp_path / "here"
