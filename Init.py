# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""FreeCAD runs this at its start, with and without a window: it names the files it can read."""

import FreeCAD

# Loads nothing else of the workbench before such a file is opened.
from HybridVolume import mesh_import

FreeCAD.addImportType(mesh_import.FILTER, mesh_import.__name__)
