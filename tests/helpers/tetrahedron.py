"""One linear tetrahedron: its corners, the gradients of its shape functions, its volume."""

from __future__ import annotations

import numpy as np

CORNERS = np.array([[1.0, 1, 0], [3, 1, 0], [1, 3, 0], [1, 1, 1]])
GRADIENTS = np.array([[-0.5, -0.5, -1], [0.5, 0, 0], [0, 0.5, 0], [0, 0, 1]])
V0 = 2 / 3
