# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""FreeCAD document objects: what a document keeps of a hybrid volume. Needs FreeCAD, never its GUI.

Proxy classes are stored in documents by module and name: they stay where they are.
"""
