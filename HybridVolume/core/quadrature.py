# SPDX-License-Identifier: LGPL-2.1-or-later
# SPDX-FileCopyrightText: The HybridVolume authors
"""Gauss-Lobatto quadrature on [0, 1]: its nodes are places of samples that include the ends."""

from __future__ import annotations

import numpy as np
from numpy.polynomial.legendre import Legendre


def lobatto(number: int) -> tuple[np.ndarray, np.ndarray]:
    """Nodes and weights, exact to degree 2 n - 3.

    Parameters
    ----------
    number : int
        At least 2.

    Returns
    -------
    nodes, weights : (n,) arrays
        The ends are among the nodes; the weights add up to 1.
    """
    last = Legendre.basis(number - 1)
    inner = np.real(last.deriv().roots())
    x = np.concatenate([[-1.0], inner, [1.0]])
    weight = 2.0 / (number * (number - 1) * last(x) ** 2)
    return 0.5 * (x + 1.0), 0.5 * weight
