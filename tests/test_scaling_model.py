"""The model of many ranks in `benchmarks/`: it must give back what it was made from."""

from __future__ import annotations

import sys

import pytest
from conftest import ROOT

sys.path.insert(0, str(ROOT / "benchmarks"))
from scaling_model import PARTS, Machine, Model

HERE = 8e9
STAGES = [name for part in PARTS.values() for name in part.stages]
COUNTED = {"messages": 14, "bytes": 4e6, "collectives": 10, "collective_bytes": 2e5, "alltoalls": 4}


def measured(dofs: int, linear: int) -> dict:
    """Iterations take 3 us an unknown and 1 ms besides, all other stages 20 us and 0.1 s."""
    timings = dict.fromkeys(STAGES, 2e-5 * dofs + 0.1)
    return {
        "N": 16,
        "dofs": dofs,
        "newton": 5,
        "linear": linear,
        "timings": {**timings, "solve": linear * (3e-6 * dofs + 1e-3)},
        "counts": {name: {**COUNTED, "file_bytes": 0.0} for name in STAGES},
        "peaks": dict.fromkeys(STAGES, 2e8 + 1e3 * dofs),
    }


def model(machine: Machine) -> Model:
    small, block = measured(10_000, 30), measured(30_000, 40)
    return Model(small, block, block, HERE, machine)


def test_one_rank_of_this_machine_takes_what_was_measured():
    """A line through two sizes goes through both, whatever else grows: equal but for rounding."""
    here = model(Machine(memory_bandwidth=HERE))
    found = here.seconds(1, 30_000)
    found.pop("iterations: coarsest level")  # once more beside its part of the iterations
    assert sum(found.values()) == pytest.approx(sum(here.one["timings"].values()), rel=1e-12)
    assert here.memory(1, 30_000)["solve"] == pytest.approx(2.3e8, rel=1e-4)  # (a row a rank)


def test_slower_memory_and_more_ranks():
    """Half the bandwidth of memory doubles what grows, 100 ranks share it; the rest stays."""
    found = model(Machine(memory_bandwidth=HERE / 2)).seconds(100, 30_000)
    assert found["partitioning: cells"] == pytest.approx(2 * 2e-5 * 300)
    assert found["iterations: matrix, vectors"] == pytest.approx(2 * 40 * 3e-6 * 300)
    rest = found["what no rank shares: calls from Python, small arrays"]
    assert rest == pytest.approx(0.1 * (len(STAGES) - 1) + 40 * 1e-3)


def test_messages_on_two_ranks_are_those_counted():
    """Seven messages a rank, with a neighbour; three trees of one level and two to all."""
    found = model(Machine(latency=1e-3, bandwidth=1e6)).seconds(2, 30_000)
    face = 6 * 5000 ** (2 / 3) / 17**2
    assert found["iterations: latency of messages"] == pytest.approx(7e-3)
    assert found["iterations: bytes of messages"] == pytest.approx(2.0 * face)
    assert found["iterations: reductions"] == pytest.approx(3e-3)
    assert found["iterations: each rank to all"] == pytest.approx(2 * (1e-3 + 16e-6))
    assert found["reading: named surfaces, to all ranks"] == pytest.approx(0.1)


def test_what_stops_scaling_is_named():
    """Work on cells goes down with the ranks; surfaces that all get, and calls, do not."""
    stops = model(Machine()).stops(10_000, 1e9)
    assert "reading: named surfaces, to all ranks" in stops
    assert "what no rank shares: calls from Python, small arrays" in stops
    assert not any(name.endswith(("cells", "matrix, vectors", "products")) for name in stops)
