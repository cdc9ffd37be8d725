"""Monitors that write into files, and the option that PETSc refuses."""

from __future__ import annotations

from pathlib import Path

import pytest
from mpi4py import MPI

from dolfin_elastic import NeoHookean, Problem, Statics, Support, Traction, box_body
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.parallel import on_root


def bent(comm: MPI.Comm, **petsc: str) -> Statics:
    body = box_body(size=(2, 1, 1), cells=(4, 2, 2), comm=comm)
    problem = Problem(
        body,
        NeoHookean(E=1e6, nu=0.3),
        supports=[Support(on="left")],
        loads=[Traction(on="right", value=[0, 0, -13e3])],
        degree=1,
    )
    return Statics(problem, steps=2, petsc=petsc)


def test_monitors_in_files(comm: MPI.Comm, folder: Path):
    """A line for each residual of each step, however often the solver reads its options."""
    names = {f"{kind}_monitor": f"ascii:{folder / kind}" for kind in ("snes", "ksp")}
    on_root(comm, lambda: (folder / "snes").write_text("of an older run\n"))
    states = [*bent(comm, ksp_type="gmres", pc_type="jacobi", **names).steps()]
    kinds = ("snes", "ksp")
    lines = {kind: on_root(comm, (folder / kind).read_text).splitlines() for kind in kinds}
    residuals = [norm for state in states[1:] for norm in state.residuals]
    assert len(lines["snes"]) == len(residuals)
    assert [float(line.split()[-1]) for line in lines["snes"]] == pytest.approx(residuals, rel=1e-6)
    newton, krylov = (sum(getattr(s, kind) for s in states) for kind in ("newton", "krylov"))
    assert len(lines["ksp"]) == newton + krylov


def test_a_file_that_cannot_be_written(comm: MPI.Comm, folder: Path):
    with pytest.raises(
        InputError, match=r"-snes_monitor: the file .*/none/a cannot be written: no"
    ):
        [*bent(comm, snes_monitor=f"ascii:{folder}/none/a").steps()]


def test_a_refused_option_is_named(comm: MPI.Comm):
    """That one alone, of several."""
    given = {"snes_linesearch_type": "bt", "mat_mumps_icntl_14": "x"}
    with pytest.raises(InputError, match=r"the option -mat_mumps_icntl_14 x: Input string x has"):
        [*bent(comm, **given).steps()]
