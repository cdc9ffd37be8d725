"""Connected components against those of scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_array, csgraph

from dolfin_elastic.mesh.body import connected_components


@pytest.mark.parametrize("size", [1, 7, 300])
@pytest.mark.parametrize("nodes", [2, 4])
def test_random(size, nodes):
    """The same numbers of the same components as scipy's, on graphs from sparse to dense."""
    rng = np.random.default_rng(size)
    for count in (0, size // 4, size // 2, 2 * size):
        sets = rng.integers(0, size, (count, nodes))
        links = np.repeat(sets[:, 0], nodes), sets.ravel()
        graph = coo_array((np.ones(len(links[0])), links), shape=(size, size))
        found, label = csgraph.connected_components(graph, directed=False)
        assert connected_components(size, sets)[0] == found
        # scipy too numbers components by their first nodes
        assert np.array_equal(connected_components(size, sets)[1], label)


def test_path():
    """A path whose nodes are numbered at random, the hardest for labels that spread from node to
    node, is one component."""
    order = np.random.default_rng(1).permutation(20000)
    assert connected_components(20000, np.column_stack([order[1:], order[:-1]]))[0] == 1
