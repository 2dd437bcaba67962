# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""FreeCAD runs this at its start, with and without a window; the workbench needs nothing here."""
