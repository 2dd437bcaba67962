# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Spline patches over the layout of a quad mesh, fitted to a triangulated surface."""
