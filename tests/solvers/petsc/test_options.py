"""PETSc's options: in force for one solver only, the user's first, none unused without a word."""

from __future__ import annotations

import logging

import pytest
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.compat import petsc_errors
from dolfin_elastic.core.errors import InputError, StoppedError
from dolfin_elastic.core.petsc_options import PREFIX, PetscOptions
from dolfin_elastic.solvers.eigen.slepc import destroy
from dolfin_elastic.solvers.petsc.options import Options, ksp_reason, snes_reason, ts_reason


def in_database() -> dict[str, str]:
    return {
        name: value for name, value in PETSc.Options().getAll().items() if name.startswith(PREFIX)
    }


def test_the_user_wins_with_or_without_prefix() -> None:
    options = Options(
        {"ksp_type": "cg", "ksp_rtol": 1e-3}, {"-elastic_ksp_type": "gmres", "pc_type": "none"}
    )
    with options.in_force(ksp_type="preonly", ksp_max_it=7):
        assert in_database() == {
            "elastic_ksp_type": "gmres",
            "elastic_ksp_rtol": "0.001",
            "elastic_pc_type": "none",
            "elastic_ksp_max_it": "7",
        }
    assert not in_database()
    options.update({"ksp_type": "cg", "pc_type": "lu", "ksp_rtol": 1e-5})
    with options.in_force():
        assert in_database()["elastic_ksp_type"] == "gmres"
        assert in_database()["elastic_pc_type"] == "none"
        assert in_database()["elastic_ksp_rtol"] == "1e-05"
    assert not in_database()


def test_options_are_taken_out_after_a_failure() -> None:
    options = Options({"ksp_type": "cg"}, {})
    with pytest.raises(ZeroDivisionError), options.in_force():
        _ = 1 / 0
    assert not in_database()


def test_what_was_used_in_one_solve_counts_for_all(caplog: pytest.LogCaptureFixture) -> None:
    """And what nothing has asked for is named once."""
    options = Options({}, {"ksp_max_it": 3, "ksp_max_itt": 3})
    ksp = PETSc.KSP().create(MPI.COMM_WORLD)
    ksp.setOptionsPrefix(PREFIX)
    with options.in_force():
        ksp.setFromOptions()
    assert ksp.getTolerances()[3] == 3
    ksp.destroy()
    with caplog.at_level(logging.WARNING, logger="dolfin_elastic"), options.in_force():
        options.report_unused()
        options.report_unused()
    found = [record.getMessage() for record in caplog.records]
    if MPI.COMM_WORLD.rank == 0:  # the others keep warnings to themselves
        assert found == ["PETSc option '-ksp_max_itt' was not used by any solver"]


def test_a_refusal_is_one_message() -> None:
    options = Options({}, {"ksp_type": "conjugate"})
    ksp = PETSc.KSP().create(MPI.COMM_WORLD)
    ksp.setOptionsPrefix(PREFIX)
    with pytest.raises(InputError) as caught, options.in_force(), options.elastic_errors():
        ksp.setFromOptions()
    ksp.destroy()
    assert "PETSc refuses the option -ksp_type conjugate" in str(caught.value)
    assert not in_database()


@pytest.mark.parametrize("given", [{}, {"ksp_rtol": 0.1}])
def test_an_error_of_a_function_that_petsc_calls_stays_itself(given: PetscOptions) -> None:
    """A signal amid the compiling of what a residual needs; it was an error of PETSc, code 1."""
    options, error = Options({}, given), StoppedError("stopped on request")
    x = PETSc.Vec().createMPI((1, None), comm=MPI.COMM_WORLD)
    outer, inner = PETSc.SNES().create(MPI.COMM_WORLD), PETSc.SNES().create(MPI.COMM_WORLD)

    def stopped(snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        raise error

    inner.setFunction(stopped, x.duplicate())
    outer.setFunction(lambda *_: inner.solve(None, x.duplicate()), x.duplicate())
    for snes in (inner, outer):
        with pytest.raises(StoppedError) as caught, options.elastic_errors():
            snes.solve(None, x.duplicate())
        assert caught.value is error
    for one in (outer, inner, x):
        one.destroy()


def test_an_error_within_an_eigenvalue_solver_stays_itself() -> None:
    """slepc4py 3.25 wraps that of PETSc once more."""
    from slepc4py import SLEPc

    options, error = Options({}, {}), StoppedError("stopped on request")
    error.__cause__ = OSError("what it came of")

    class Stopped:
        def mult(self, A: PETSc.Mat, x: PETSc.Vec, y: PETSc.Vec) -> None:
            raise error

    size = ((2, None), (2, None))
    shell = PETSc.Mat().createPython(size, Stopped(), comm=MPI.COMM_WORLD)
    shell.setUp()
    eps = SLEPc.EPS().create(MPI.COMM_WORLD)
    eps.setOperators(shell)
    eps.setProblemType(SLEPc.EPS.ProblemType.HEP)
    with pytest.raises(StoppedError) as caught, options.elastic_errors(), petsc_errors():
        eps.solve()
    assert caught.value is error
    destroy(eps, shell)


def test_reasons_have_names() -> None:
    assert snes_reason(-3) == "DIVERGED_LINEAR_SOLVE"
    assert ksp_reason(-3) == "DIVERGED_MAX_IT"
    assert ts_reason(1) == "CONVERGED_TIME"
    assert ksp_reason(-999) == "-999"
