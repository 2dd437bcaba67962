# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""What the command line shows of bodies that are worked on side by side."""

from HybridVolume.protocol import Progress
from HybridVolume.screen import Screen


def test_each_body_tells_a_stage_once(capsys):
    screen = Screen()
    for share in (0.1, 0.2, 0.3):
        screen.progress("a", Progress("field", share, "harmonic field"))
        screen.progress("b", Progress("shell", share, "front"))
    screen.progress("b", Progress("field", 0.4, "harmonic field"))
    screen.line("a: done")
    assert capsys.readouterr().out.splitlines() == [
        "a [ 10 %] field: harmonic field",
        "b [ 10 %] shell: front",
        "b [ 40 %] field: harmonic field",
        "a: done",
    ]
