"""Ends of PETSc's solvers in words."""

from __future__ import annotations

import pytest
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core.compat import norm_without_value
from dolfin_elastic.core.units import coordinates
from dolfin_elastic.solvers.messages import eigenvalues, in_words
from dolfin_elastic.solvers.nonlinear.convergence import ANOTHER
from dolfin_elastic.solvers.petsc.options import ksp_reason, snes_reason, ts_reason

SNES, KSP, TS = (kind.ConvergedReason for kind in (PETSc.SNES, PETSc.KSP, PETSc.TS))


@pytest.mark.parametrize(
    "reason",
    [
        snes_reason(SNES.DIVERGED_FUNCTION_DOMAIN),
        snes_reason(norm_without_value()),
        snes_reason(SNES.DIVERGED_LINE_SEARCH),
        snes_reason(SNES.DIVERGED_MAX_IT),
        ts_reason(TS.DIVERGED_NONLINEAR_SOLVE),
        ts_reason(TS.DIVERGED_STEP_REJECTED),
    ],
)
def test_names_are_details(reason: str, caplog: pytest.LogCaptureFixture) -> None:
    """They stood in lines for users."""
    with caplog.at_level("DEBUG", "dolfin_elastic"):
        words = in_words(reason)
    if MPI.COMM_WORLD.rank == 0:  # which logs
        assert caplog.messages == [reason]  # for those who ask for details
    assert "DIVERGED" not in words
    assert len(words.split()) > 4


@pytest.mark.parametrize(
    ("place", "text"),
    [
        ((5.53e-20, -5.53e-20, -1.92e-19), "(0, 0, 0)"),
        ((5e-4, -1.077e-20), "(0.0005, 0)"),
        ((1e-9, -2.5e-9, 0.0), "(1e-09, -2.5e-09, 0)"),
    ],
)
def test_round_off_has_no_digits(place: tuple[float, ...], text: str) -> None:
    assert coordinates(place) == text


def test_the_linear_solver_is_named() -> None:
    whole = in_words(f"DIVERGED_LINEAR_SOLVE ({ksp_reason(KSP.DIVERGED_MAX_IT)})")
    text = "the linear solver failed: its iterations (ksp_max_it) were not enough"
    assert whole == text


def test_other_words_stay() -> None:
    assert in_words(ANOTHER) == ANOTHER
    assert eigenvalues("DIVERGED_ITS") == "its iterations (eps_max_it) were not enough"
