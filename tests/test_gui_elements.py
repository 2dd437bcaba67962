# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Colours of elements in FreeCAD's real window."""

from gui_play import needs_window, play

pytestmark = needs_window


def test_colours_are_on_their_elements(tmp_path):
    found = play("gui_elements.colours", tmp_path)
    # each wedge has its face on the box, and one towards the core, of four triangles each
    assert found["Shell"] == [96, 96, 96]
    assert found["Core"] == [48, 48, 48]
