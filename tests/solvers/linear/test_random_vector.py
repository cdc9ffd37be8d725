"""Numbers that look random, without numpy.random."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers.processes import clean_environment

from dolfin_elastic.solvers.linear.smoother import random_vector

CASE = """
[mesh]
box = {size = [1, 1, 1], cells = [2, 2, 2]}
[materials.rubber]
law = "neo-hookean"
E = "1 MPa"
nu = 0.3
[[support]]
on = "left"
[[load]]
kind = "traction"
on = "right"
value = [0, 0, "-1 kPa"]
[solver]
method = "iterative"
"""
LIST = """
import sys
from dolfin_elastic.cli.app import guarded
code = guarded()
print(*sys.modules)
sys.exit(code)
"""


def test_they_are_spread_evenly_and_independent() -> None:
    """Mean 0, variance 1/3, and no correlation with those that stand 1 to 100 places further on."""
    count = 40_000
    x = random_vector(0, count)
    near = 4.0 / np.sqrt(count)
    assert np.abs(x).max() <= 1.0
    assert abs(x.mean()) < near
    assert x.var() == pytest.approx(1.0 / 3.0, abs=near)
    assert np.abs(np.histogram(x, 20, (-1.0, 1.0))[0] * 20 / count - 1.0).max() < 20 * near
    for lag in (1, 2, 3, 6, 75, 100):
        assert abs(np.mean(x[lag:] * x[:-lag])) < near


def test_each_rank_has_its_part() -> None:
    """The numbers depend on their places alone."""
    assert np.array_equal(random_vector(0, 50)[20:], random_vector(20, 30))


def test_they_are_those_of_splitmix64() -> None:
    """The first ones of seed 0, as S. Vigna's program prints them."""
    expected = [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F]
    assert np.array_equal(random_vector(0, 3), [(z >> 11) * 2.0**-52 - 1.0 for z in expected])


@pytest.mark.usefixtures("serial_only")
def test_no_run_needs_those_of_numpy(tmp_path: Path) -> None:
    """With multigrid, whose estimates need a vector: importing numpy.random takes 1.5 MB."""
    (tmp_path / "case.toml").write_text(CASE)
    command = [sys.executable, "-c", LIST, "run", "case.toml", "--output", "results"]
    done = subprocess.run(
        command, cwd=tmp_path, env=clean_environment(), capture_output=True, text=True, check=True
    )
    modules = set(done.stdout.splitlines()[-1].split())
    assert "dolfin_elastic.solvers.linear.smoother" in modules
    assert "numpy.random" not in modules
