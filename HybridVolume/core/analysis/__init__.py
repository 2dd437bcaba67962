# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Analysis on the hybrid volume: spline unknowns in the shell, polynomials in the core."""
