# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""FreeCAD's window: commands, the task panel, preferences, and how the objects look."""
