# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Bodies of any faces covered with four-sided patches: intervals, quads, patches."""
