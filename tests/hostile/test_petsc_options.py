"""[solver] petsc of a case chooses solvers; it neither imports a module nor writes a file."""

from __future__ import annotations

from pathlib import Path

import pytest
from helpers.cube import cube
from helpers.processes import cli
from helpers.runs import begun, case, finished

from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.petsc_options import PetscValue, refuse_beyond_solvers
from dolfin_elastic.solvers.linear import choice

CASE = cube()

GIVEN: dict[str, PetscValue] = {
    "ksp_type": "gmres",
    "-ksp_rtol": 1e-9,
    "elastic_ksp_max_it": 50,
    "ksp_gmres_restart": 60,
    "ksp_monitor": True,
    "ksp_monitor_true_residual": "ascii",
    "ksp_view": "::ascii_info_detail",
    "snes_monitor": None,
    "snes_linesearch_type": "bt",
    "snes_lag_jacobian": -2,
    "mg_levels_ksp_max_it": 3,
    "mg_coarse_pc_gamg_threshold": 0.02,
    "mg_coarse_mg_levels_0_ksp_type": "richardson",
    "fieldsplit_u_mg_levels_pc_type": "sor",
    "sub_pc_factor_levels": 1,
    "mat_mumps_icntl_14": 80,
    "mat_mumps_cntl_1": 0.01,
    "pc_factor_mat_solver_type": "mumps",
    "pc_hypre_boomeramg_strong_threshold": 0.5,
    "eps_ncv": 60,
    "st_ksp_rtol": 1e-9,
    "ts_adapt_type": "none",
}

REFUSED: dict[str, PetscValue] = {
    "pc_type": "python",
    "ksp_type": "python",
    "sub_pc_type": "shell",
    "pc_python_type": "mine.Preconditioner",
    "ksp_python_type": "mine.Solver",
    "snes_python_type": "mine.Solver",
    "ksp_view": "ascii:victim.txt",
    "ksp_monitor": "ascii:victim.txt",
    "-ksp_monitor_true_residual": ":victim.txt",
    "snes_view": "binary",
    "snes_monitor": "draw",
    "ksp_view_mat": "binary:victim",
    "ksp_view_solution": "hdf5:victim.h5",
    "pc_mg_dump_matlab": True,
    "snes_monitor_solution": "vtk:victim.vtu",
    "pc_asm_print_subdomains": "victim.txt",
    "sub_pc_gasm_print_subdomains": "victim.txt",
    "ksp_converged_rate": "binary",
    "mat_mumps_icntl_1": 7,
    "mat_mumps_icntl_3": 7,
    "mat_mumps_icntl_22": 1,
    "mat_mumps_ooc_tmpdir": "/tmp",
    "dll_append": "./mine.so",
    "options_file": "other",
    "log_view": ":victim.txt",
    "ts_monitor_solution_vtk": "victim-%03d.vtu",
    "pc_factor_mat_solver_type": "/tmp/mine.so:solve",
    "fieldsplit_u_pc_python_type": "mine.Preconditioner",
    "ksp_type -pc_type": "gmres",
    "eps_view_vectors": "ascii:victim.txt",
}


@pytest.mark.parametrize("name", GIVEN)
def test_solvers_are_chosen(name: str) -> None:
    refuse_beyond_solvers({name: GIVEN[name]}, "")


@pytest.mark.parametrize("name", REFUSED)
def test_others_are_refused(name: str) -> None:
    with pytest.raises(CaseError, match="on the command line") as caught:
        refuse_beyond_solvers({name: REFUSED[name]}, "solver.petsc")
    assert name.lstrip("-") in str(caught.value)


def test_what_the_program_chooses_is_among_them() -> None:
    """A user who takes over an option of the defaults to change its value is not refused."""
    for table in (choice.GMRES, choice.GAMG, choice.P_MULTIGRID, choice.SCHUR):
        refuse_beyond_solvers(table, "")


@pytest.mark.parametrize("command", ["check", "run"])
@pytest.mark.parametrize("option", ['pc_type = "python"', 'ksp_view = "ascii:victim.txt"'])
def test_before_the_run(tmp_path: Path, serial_only: None, command: str, option: str) -> None:
    """The first imported a module of the current folder, the second overwrote a file."""
    (tmp_path / "victim.txt").write_text("mine")
    (tmp_path / "petsc4py.py").write_text("raise SystemExit(77)\n")
    (tmp_path / "case.toml").write_text(f"{CASE}[solver]\npetsc = {{{option}}}\n")
    code, out, err = cli(command, "case.toml", folder=tmp_path)
    assert code == 2, out + err
    name = option.split(maxsplit=1)[0]
    assert f"case.toml: solver.petsc: a case file may not give the PETSc option -{name}" in err
    assert (tmp_path / "victim.txt").read_text() == "mine"


def test_a_folder_of_results(tmp_path: Path, serial_only: None, caplog) -> None:
    """The options of a run that is continued are data, too."""
    victim = tmp_path / "victim.txt"
    victim.write_text("mine")
    given: dict[str, PetscValue] = {"ksp_view": f"ascii:{victim}", "ksp_rtol": 1e-9}
    begun(case(), tmp_path / "results", 2, petsc=given)
    victim.write_text("mine")
    assert finished(tmp_path / "results")
    assert victim.read_text() == "mine"
    assert "left out, give them again: -ksp_view" in caplog.text
