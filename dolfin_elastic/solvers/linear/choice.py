"""Which KSP and PC solve the linear systems, and why.

Small systems are factorised (MUMPS).  Large ones are solved by conjugate gradients, or by GMRES
when the tangent is not symmetric, with multigrid that knows the rigid-body modes: smoothed
aggregation for linear elements; for quadratic ones a first coarsening from quadratic to linear
elements, then the same.  It is our own, see `hierarchy`; with options of PETSc's multigrid, PCMG
and GAMG do the same.  A pressure is split off (PCFIELDSPLIT).
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from typing import Literal

from pydantic import Field, field_validator

from dolfin_elastic.core.petsc_options import PetscOptions, PetscValue, refuse_beyond_solvers
from dolfin_elastic.core.schema import Record
from dolfin_elastic.problem.problem import Problem

log = logging.getLogger("dolfin_elastic")

DIRECT_LIMIT = {2: 150_000, 3: 20_000}
"""Largest number of unknowns that are factorised by default, by dimension."""

MIXED_LIMIT = {2: 100_000, 3: 10_000}
"""The same with a pressure beside the displacement."""

MIXED_MOVING = {2: 400_000, 3: 150_000}
"""The same in motion, where short steps make the pressure hard for iterations."""

LAST_DIRECT = {2: 1_000_000, 3: 150_000}
"""Largest number of unknowns that are factorised when iterations have failed."""


GMRES: dict[str, PetscValue] = {
    "ksp_type": "gmres",
    "ksp_gmres_restart": 100,
    "ksp_pc_side": "right",
}

GAMG: dict[str, PetscValue] = {
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.01,
    "pc_gamg_coarse_eq_limit": 500,
    "pc_gamg_agg_nsmooths": 1,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "pbjacobi",
}

BLOCKS: dict[str, PetscValue] = {"pc_type": "python"}
"""Multigrid in blocks, see `hierarchy.Multigrid`, which is set up by no option."""

BY_SYMMETRIC_PART: dict[str, PetscValue] = {"ksp_type": "preonly", "pc_type": "python"}
"""A direct solver that no option sets up, see `symmetric_part.SymmetricPart`.  Scalar unknowns need
a solve each, which costs more than with factors of the tangent itself."""

P_MULTIGRID: dict[str, PetscValue] = {
    "pc_type": "mg",
    "pc_mg_galerkin": "both",
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "pbjacobi",
    **{f"mg_coarse_{name}": value for name, value in GAMG.items()},
}
"""From quadratic elements to linear ones, which GAMG coarsens on; see `PMultigrid`."""

SCHUR: dict[str, PetscValue] = {
    "pc_type": "fieldsplit",
    "pc_fieldsplit_type": "schur",
    "pc_fieldsplit_schur_fact_type": "upper",
    "pc_fieldsplit_schur_precondition": "user",
    "fieldsplit_u_ksp_type": "preonly",
    "fieldsplit_p_ksp_type": "preonly",
    "fieldsplit_p_pc_type": "sor",
}
"""Displacement and pressure apart; see `PressureSplit`."""


class LinearSettings(Record):
    """How linear systems are solved; by default `choose` decides.

    Attributes:
        method: "auto", "direct" (MUMPS) or "iterative" (Krylov with multigrid).
        petsc: PETSc options that override everything else, for example {ksp_type = "gmres"}.
    """

    method: Literal["auto", "direct", "iterative"] = "auto"
    petsc: dict[str, bool | int | float | str] = Field(default_factory=dict)

    @field_validator("petsc")
    @classmethod
    def _choose_solvers(cls, options: PetscOptions) -> PetscOptions:
        refuse_beyond_solvers(options, "")
        return options


@dataclass(frozen=True)
class Choice:
    """A linear solver.

    Attributes:
        direct: Factorisation, not iterations.
        options: PETSc options without prefix.
        why: Unknowns and the kind of solver, for people.
        detail: Its methods, for those who ask.
    """

    direct: bool
    options: dict[str, PetscValue]
    why: str
    detail: str = ""

    def report(self) -> None:
        """Logs it: the methods at the level of details."""
        log.info("%s", self.why)
        log.debug("%s", self.detail)


def choose(problem: Problem, settings: LinearSettings, *, moving: bool = False) -> Choice:
    """Chooses a linear solver for a problem and says why. Not collective.

    Args:
        problem: Its unknowns and the symmetry of its tangent decide.
        moving: The system is that of a time step.
    """
    dofs, limit = problem.num_dofs, DIRECT_LIMIT[problem.body.dim]
    mixed = bool(problem.unknowns.auxiliary_fields)
    if mixed:
        limit = (MIXED_MOVING if moving else MIXED_LIMIT)[problem.body.dim]
    direct = settings.method == "direct" or (settings.method == "auto" and dofs <= limit)
    direct = direct or problem.unknowns.has("stretch")  # only ever in a plane: cheap to factorise
    symmetric = problem.symmetric
    size = f"{dofs} unknowns"
    if settings.method != "auto":
        size += f' (solver.method = "{settings.method}")'
    if direct:
        kind, options = "Cholesky-like LDL^T" if symmetric else "LU", factorising(symmetric)
        if problem.terms.bars and dofs <= limit:
            options |= CHANGING
        scalars = problem.terms.scalars or problem.cell is not None
        nearly = not problem.terms.dissipates  # friction is far from symmetric where it slides
        if nearly and not (symmetric or moving or scalars or settings.petsc):
            kind, options = "LDL^T of the symmetric part", options | BY_SYMMETRIC_PART
        return Choice(True, options, f"{size}, direct solver", f"MUMPS, {kind}")
    krylov = "CG" if symmetric and not mixed else "GMRES"
    grid = grids(problem.degree)
    if mixed:
        grid = f"pressure by its mass matrix, displacement by {grid}"
    options = _iterative(problem, symmetric and not mixed)
    return Choice(False, options, f"{size}, iterative solver", f"{krylov}, {grid}")


def grids(degree: int) -> str:
    """The levels of multigrid in words."""
    above = "multigrid from quadratic to linear elements, then" if degree > 1 else "multigrid"
    return f"{above} by aggregates with rigid-body modes"


def factorising(symmetric: bool) -> dict[str, PetscValue]:
    """Options of a direct solver.

    Args:
        symmetric: The tangent is symmetric, though it may be indefinite.
    """
    return {
        "ksp_type": "preonly",
        "pc_type": "cholesky" if symmetric else "lu",
        "pc_factor_mat_solver_type": "mumps",
        "mat_mumps_icntl_14": 50,  # room for pivoting on indefinite tangents
        "mat_mumps_icntl_13": 1,  # no ScaLAPACK at the root: it counts no negative pivots
        "mat_mumps_icntl_33": int(not symmetric),  # the determinant's sign, where no pivots count
        "mat_mumps_icntl_24": 1,  # a singular tangent is Newton's affair, not MUMPS's error
        "mat_mumps_icntl_20": 0,  # PETSc's distributed right-hand side can fail (dolfinx#4362)
    }


def _iterative(problem: Problem, symmetric: bool) -> dict[str, PetscValue]:
    """Options of a Krylov method, by conjugate gradients where the whole system is symmetric."""
    krylov: dict[str, PetscValue] = {
        "ksp_type": "cg" if symmetric else "gmres",
        "ksp_max_it": 500,
        "ksp_rtol": 1e-8,
    }
    if not symmetric:
        krylov |= GMRES
    if problem.unknowns.auxiliary_fields:
        return krylov | SCHUR | {f"fieldsplit_u_{name}": value for name, value in BLOCKS.items()}
    return krylov | BLOCKS


CHANGING: dict[str, PetscValue] = {"mat_mumps_icntl_7": 2}
"""Order of elimination where pairs that meet change the pattern in nearly each iteration: by least
fill, which takes a fifth of the time that MUMPS takes by default.  Up to `DIRECT_LIMIT` the factors
are about as large, of many more unknowns larger."""

HARMLESS = (
    *("snes_monitor", "snes_max_it", "snes_view", "snes_converged_reason", "log_"),
    *("ksp_monitor", "ksp_max_it", "ksp_view", "ksp_converged_reason", "ksp_rtol", "ksp_atol"),
)
"""Beginnings of options that ask the tangent for nothing but products."""


def in_blocks(choice: Choice, users: PetscOptions) -> bool:
    """Whether the tangent is asked for products and its blocks alone. Not collective.

    Args:
        users: PETSc options of the user, without prefix.
    """
    by_cg = choice.options.get("ksp_type") == "cg"
    ours = choice.options.get("pc_type") == BLOCKS["pc_type"]
    return by_cg and ours and all(name.startswith(HARMLESS) for name in users)


def petsc_multigrid(options: PetscOptions, users: PetscOptions, degree: int) -> PetscOptions:
    """PETSc's multigrid in place of ours, where options of the user shape it.

    Args:
        options: PETSc's, among which ours may be.
        users: Those of the user, without prefix.

    Returns:
        Options to be changed; none where the user gives no options of levels.
    """
    kind = "pc_type"
    ours = [n for n, value in options.items() if n.endswith(kind) and value == BLOCKS[kind]]
    prefix = ours[0].removesuffix(kind) if ours else ""
    shaping = tuple(prefix + name for name in ("pc_gamg_", "pc_mg_", "mg_levels_", "mg_coarse_"))
    if not ours or not any(name.startswith(shaping) for name in users):
        return {}
    theirs = GAMG if degree == 1 else P_MULTIGRID
    return {prefix + name: value for name, value in theirs.items()}
