"""Kinds of support: rollers, symmetry, rotation, springs, dashpots."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx import fem
from petsc4py import PETSc

from dolfin_elastic import (
    BodyForce,
    Dashpot,
    Dynamics,
    LinearElastic,
    NeoHookean,
    Normal,
    Problem,
    Rotation,
    Selector,
    Spring,
    Statics,
    Support,
    Symmetry,
    Traction,
    box_body,
    name_parts,
    rectangle_body,
)
from dolfin_elastic.case import Case
from dolfin_elastic.check import check
from dolfin_elastic.errors import InputError
from dolfin_elastic.parallel import largest, total
from dolfin_elastic.solvers.assembler import Assembler
from dolfin_elastic.solvers.linear import LinearSettings
from dolfin_elastic.solvers.rigid import free_motions

E, NU = 1e6, 0.3
FREE = "free"


def last(problem: Problem, **settings: Any) -> Any:
    *_, state = Statics(problem, **settings).steps()
    return state


def turned(body: Any, axis: Any, angle: float) -> np.ndarray:
    """Turns a body's mesh about the origin; returns the rotation."""
    n = np.asarray(axis, dtype=float) / np.linalg.norm(axis)
    K = np.array([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
    R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    body.mesh.geometry.x[:] = body.mesh.geometry.x @ R.T
    return R


def rows(problem: Problem) -> np.ndarray:
    """Displacements of this rank's nodes."""
    return problem.u.x.array.reshape(-1, problem.body.dim)


def off(problem: Problem, wanted: np.ndarray) -> float:
    """Largest deviation of the displacement on all ranks."""
    local = float(np.max(np.abs(rows(problem) - wanted), initial=0.0))
    return largest(problem.body.comm, local)


# --- rollers on flat surfaces ---


@pytest.mark.parametrize("method", ["direct", "iterative"])
@pytest.mark.parametrize(
    ("law", "degree", "formulation"),
    [
        (LinearElastic(E=E, nu=NU), 1, "displacement"),
        (NeoHookean(E=E, nu=NU), 2, "displacement"),
        (NeoHookean(E=E, nu=0.49), 2, "mixed"),
    ],
)
def test_turned_block_on_slanted_rollers(law, degree, formulation, method):
    """A block on three rollers, pulled: turned by 30 degrees about an oblique axis it is the same.

    The tolerance is that of the equilibrium, 1e-10 of the forces, times the conditioning.
    """
    found = []
    for angle in (0.0, np.pi / 6):
        body = box_body(size=(1.0, 0.6, 0.5), cells=(3, 2, 2))
        R = turned(body, (1, 2, 3), angle)
        problem = Problem(
            body,
            law,
            degree=degree,
            formulation=formulation,
            supports=[
                Normal(on="left"),
                Symmetry(on=["front", "bottom"]),
                Normal(on="right", displacement=0.1),
            ],
            loads=[BodyForce(value=list(R @ [0, 5e4, 0]))],
        )
        state = last(problem, linear=LinearSettings(method=method), rtol=1e-10)
        assert state.newton <= 6  # quadratic: the tangent is the residual's
        found.append((rows(problem) @ R, {k: R.T @ f for k, f in state.reactions.items()}))
    assert off(problem, found[0][0] @ R.T) < 1e-10
    for label, force in found[0][1].items():
        np.testing.assert_allclose(found[1][1][label], force, rtol=0, atol=1e-5)
    np.testing.assert_allclose(sum(found[1][1].values()), [0, -1.5e4, 0], rtol=0, atol=1e-5)
