# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Workers multiply matrices in one thread, whatever their surroundings ask for."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from HybridVolume.worker_process import worker_variables

COUNT = """
import os
import numpy
a = numpy.ones((600, 600))
assert (a @ a == 600.0).all()
print(len(os.listdir("/proc/self/task")))
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="threads are told by /proc")
def test_workers_have_one_thread(tmp_path, monkeypatch):
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        monkeypatch.setenv(name, "3")

    def threads(variables):
        command = [sys.executable, "-c", COUNT]
        return int(subprocess.run(command, env=variables, capture_output=True, check=True).stdout)

    assert threads(worker_variables(tmp_path)) == 1
    # the count sees them where they are: OpenBLAS makes as many as there are cores at most
    if (os.cpu_count() or 1) > 1:
        assert threads(dict(os.environ)) > 1
