"""Bodies whose buckling loads have closed forms, and the solver at one of their equilibria."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from petsc4py import PETSc
from scipy.optimize import brentq

from dolfin_elastic import (
    NeoHookean,
    Pressure,
    Problem,
    Rigid,
    Spring,
    StVenantKirchhoff,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.mesh.body import Body
from dolfin_elastic.model.amplitude import PROPORTIONAL
from dolfin_elastic.solvers.assembly.assembler import Assembler
from dolfin_elastic.solvers.linear.choice import LinearSettings, choose, in_blocks
from dolfin_elastic.solvers.nonlinear.convergence import Tolerance
from dolfin_elastic.solvers.nonlinear.jacobian import JacobianWatch
from dolfin_elastic.solvers.nonlinear.newton import Newton, scalar_unknowns
from dolfin_elastic.solvers.statics.retry import RetryStrategy

FREE = "free"
E, NU = 1e6, 0.3
PLANE = E / (1 - NU**2)
"""Modulus of plane strain [Pa]."""
NH = NeoHookean(E=E, nu=NU)
SVK = StVenantKirchhoff(E=E, nu=NU)
RUBBER = NeoHookean(E=E, nu=0.4999)
INCOMPRESSIBLE = NeoHookean(E=E, nu=0.5)


@dataclass(frozen=True)
class Case:
    """A body under a load.

    Attributes:
        name: Of the test.
        problem: Makes the body under a share of the load of the closed form.
        critical: Share at which the discrete body buckles, by bisection with pivots.
        within: By how much that may differ from 1: theory of beams and shells, and the mesh.
        steps: In which the load is applied.
    """

    name: str
    problem: Callable[[float], Problem]
    critical: float
    within: float
    steps: int = 1


# --- plane columns, 1 wide and 10 long; factors of E I/L^2 ---

LENGTH, INERTIA = 10.0, 1 / 12
ONE_END, PROPPED, BOTH_ENDS, SWAYING, HINGED = (
    np.pi**2 / 4,
    20.1907,  # the square of the first root of tan x = x
    4 * np.pi**2,
    np.pi**2,
    np.pi**2,
)


def column(
    share: float,
    factor: float,
    *supports: Any,
    law: Any = NH,
    modulus: float = PLANE,
    cells: tuple[int, int] = (2, 16),
    side: float = 0.0,
    **settings: Any,
) -> Problem:
    """Clamped below, with a free end that supports may hold; `side` is a pressure on its side."""
    value = share * factor * modulus * INERTIA / LENGTH**2
    loads: list[Any] = [Traction(on="top", value=[0, -value])]
    loads += [Pressure(on="left", value=side)] if side else []
    return Problem(
        rectangle_body(size=(1, LENGTH), cells=cells),
        law,
        degree=settings.pop("degree", 2),
        supports=[Support(on="bottom"), *supports],
        loads=loads,
        **settings,
    )


def between_plates(
    share: float, factor: float, below: dict[str, Any], above: dict[str, Any]
) -> Problem:
    """Between two rigid plates, of which the upper one is loaded."""
    force = [0.0, -share * factor * PLANE * INERTIA / LENGTH**2]
    return Problem(
        rectangle_body(size=(1, LENGTH), cells=(2, 16), origin=(-0.5, 0.0)),
        NH,
        degree=2,
        supports=[
            Rigid(on="bottom", displacement=[0, 0], **below),
            Rigid(on="top", force=force, **above),
        ],
    )


def bedded(share: float, waves: int = 8, length: float = 80.0) -> Problem:
    """On springs between smooth plates: it buckles in many half waves, P = 2 sqrt(k E I).

    Source: M. Hetenyi, Beams on Elastic Foundation (1946), chapter VII.
    """
    k = PLANE * INERTIA * (waves * np.pi / length) ** 4
    strain = share * 2 * np.sqrt(k * PLANE * INERTIA) / PLANE
    return Problem(
        rectangle_body(size=(1, length), cells=(1, 64)),
        SVK,
        degree=2,
        supports=[
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="top", displacement=[FREE, -strain * length]),
            Spring(on=["left", "right"], stiffness=[k / 2, 0]),
        ],
    )


# --- rings, arches and shells ---


def bent(body: Body, angle: float, start: float = 0.0) -> Body:
    """A strip along y, of x from the inner to the outer radius, bent round the origin."""
    x = body.mesh.geometry.x
    r, phi = x[:, 0].copy(), start + angle * x[:, 1]
    x[:, 0], x[:, 1] = r * np.cos(phi), r * np.sin(phi)
    return body


def strip(thickness: float, cells: tuple[int, int], length: float = 1.0) -> Body:
    """Of mean radius 1."""
    return rectangle_body(size=(thickness, length), cells=cells, origin=(1 - thickness / 2, 0.0))


def ring(share: float, t: float = 0.1) -> Problem:
    """A quarter of a ring under pressure, p = 3 E I/R^3.

    Source: S. Timoshenko and J. Gere, Theory of Elastic Stability (1961), section 7.3.
    """
    return Problem(
        bent(strip(t, (1, 12)), np.pi / 2),
        SVK,
        degree=2,
        supports=[
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="top", displacement=[0, FREE]),
        ],
        loads=[Pressure(on="right", value=share * 3 * PLANE * t**3 / 12)],
    )


def arch(share: float, t: float = 0.1) -> Problem:
    """A clamped half ring under pressure, p = 8 E I/R^3: as `ring`, section 7.6."""
    return Problem(
        bent(strip(t, (1, 24)), np.pi),
        SVK,
        degree=2,
        supports=[Support(on="bottom"), Support(on="top")],
        loads=[Pressure(on="right", value=share * 8 * PLANE * t**3 / 12)],
    )


def pipe(share: float, t: float = 0.1) -> Problem:
    """As `ring` in space, one of whose faces is free, which pressure follows."""
    body = box_body(size=(t, 1, 0.2), cells=(1, 8, 1), origin=(1 - t / 2, 0, 0))
    return Problem(
        bent(body, np.pi / 2),
        SVK,
        degree=2,
        supports=[
            Support(on="front", displacement=[FREE, 0, FREE]),
            Support(on="back", displacement=[0, FREE, FREE]),
            Support(on="bottom", displacement=[FREE, FREE, 0]),
        ],
        loads=[Pressure(on="right", value=share * 3 * E * t**3 / 12)],
    )


def cylinder(share: float, t: float = 0.02, waves: int = 4) -> Problem:
    """A tube pressed along its axis between smooth plates, which wrinkles into rings.

    The stress is E t/(R sqrt(3 (1 - nu^2))), half a wave sqrt(R t) pi/(12 (1 - nu^2))^(1/4) long:
    as `ring`, section 11.1.
    """
    length = waves * np.pi * np.sqrt(t) / (12 * (1 - NU**2)) ** 0.25
    strain = share * t / np.sqrt(3 * (1 - NU**2))
    return Problem(
        strip(t, (1, 12 * waves // 2), length),
        SVK,
        degree=2,
        geometry="axisymmetric",
        supports=[
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="top", displacement=[FREE, -strain * length]),
        ],
    )


def sphere(share: float, t: float = 0.05) -> Problem:
    """A spherical shell under pressure, p = 2 E t^2/(R^2 sqrt(3 (1 - nu^2))).

    Source: R. Zoelly, dissertation, ETH Zurich (1915); as `ring`, section 11.13.
    """
    return Problem(
        bent(strip(t, (1, 24)), np.pi / 2),
        SVK,
        degree=2,
        geometry="axisymmetric",
        supports=[
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="top", displacement=[0, FREE]),
        ],
        loads=[Pressure(on="right", value=share * 2 * E * t**2 / np.sqrt(3 * (1 - NU**2)))],
    )


# --- in space ---


def plate(share: float, t: float = 0.05) -> Problem:
    """A quarter of a square plate, hinged on all edges, sigma = pi^2 E/(3 (1 - nu^2)) (t/a)^2.

    Source: G. Bryan, Proc. London Math. Soc. 22 (1891) 54; as `ring`, section 9.2.
    """
    stress = share * np.pi**2 * E / 3 / (1 - NU**2) * t**2
    return Problem(
        box_body(size=(0.5, 0.5, t), cells=(4, 4, 1)),
        SVK,
        degree=2,
        supports=[
            Support(on="left", displacement=[0, FREE, FREE]),
            Support(on="front", displacement=[FREE, 0, FREE]),
            Support(on=["right", "back"], displacement=[FREE, FREE, 0]),
        ],
        loads=[Traction(on="right", value=[-stress, 0, 0])],
    )


def rubber_column(share: float, law: Any = RUBBER) -> Problem:
    """Clamped below, of nearly incompressible rubber, 1 x 1 x 10."""
    return Problem(
        box_body(size=(1, 1, LENGTH), cells=(1, 1, 8)),
        law,
        degree=2,
        supports=[Support(on="bottom")],
        loads=[Traction(on="top", value=[0, 0, -share * ONE_END * E * INERTIA / LENGTH**2])],
    )


SQUARE = 1.0106
"""Share at which `square_column` buckles."""


def square_column(share: float, side: float = 1e-3) -> Problem:
    """Clamped below, 1 x 1 x 10, with two equal modes, and a pressure that follows its side."""
    value = share * ONE_END * E * INERTIA / LENGTH**2
    return Problem(
        box_body(size=(1, 1, LENGTH), cells=(2, 2, 12)),
        NH,
        degree=2,
        supports=[Support(on="bottom")],
        loads=[Traction(on="top", value=[0, 0, -value]), Pressure(on="left", value=side)],
    )


def two_columns(share: float, soft: float = 1e-6) -> Problem:
    """Two of `column`, pressed sideways, and what is between them next to nothing."""
    inside, value = "abs(x - 2.5) > 1.5", share * ONE_END * PLANE * INERTIA / LENGTH**2
    return Problem(
        rectangle_body(size=(5, LENGTH), cells=(10, 16)),
        NeoHookean(E=f"{E:g}*where({inside}, 1, {soft:g})", nu=NU),
        degree=2,
        supports=[Support(on="bottom")],
        loads=[
            Traction(on="top", value=[0, f"-{value!r}*where({inside}, 1, 0)"]),
            Pressure(on="left", value=1e-3),
        ],
    )


# --- large strains ---

THICK = 2.5
"""Length of `block`, whose width is 1."""


def thick_block(k: float = np.pi / THICK) -> float:
    """Stretch at which an incompressible neo-Hookean block bends between smooth plates.

    (1 + x^2)^2 tanh q = 4 x tanh(q x) with x the square of the stretch and q = k/2/x, for k h << 1
    Euler's load.  Source: M. Biot, Mechanics of Incremental Deformations (1965), section 3.5.
    """

    def bends(x: float) -> float:
        q = k / 2 / x
        return float((1 + x**2) ** 2 * np.tanh(q) - 4 * x * np.tanh(q * x))

    return float(np.sqrt(brentq(bends, 0.4, 0.95)))


def block(share: float) -> Problem:
    """Compressed by a share of the critical compression; a point in its middle holds it."""
    body = rectangle_body(size=(1, THICK), cells=(4, 10), origin=(-0.5, 0.0))
    x = body.mesh.geometry.x
    middle = np.flatnonzero(np.hypot(x[:, 0], x[:, 1] - THICK / 2) < 1e-9).astype(np.int32)
    return Problem(
        body.named(points={"middle": middle}),
        INCOMPRESSIBLE,
        degree=2,
        supports=[
            Support(on="bottom", displacement=[FREE, 0]),
            Support(on="top", displacement=[FREE, -share * (1 - thick_block()) * THICK]),
            Support(on="middle", displacement=[0, FREE]),
        ],
    )


CASES = [
    Case("one end clamped", partial(column, factor=ONE_END), 1.0067, 0.01),
    Case(
        "one end clamped, one guided",
        lambda share: column(share, PROPPED, Support(on="top", displacement=[0, FREE])),
        0.9874,
        0.02,
    ),
    Case(
        "both ends clamped",
        lambda share: between_plates(
            share, BOTH_ENDS, {"rotation": 0}, {"displacement": [0, FREE], "rotation": 0}
        ),
        1.0214,
        0.03,
    ),
    Case(
        "swaying",
        lambda share: between_plates(
            share, SWAYING, {"rotation": 0}, {"displacement": [FREE, FREE], "rotation": 0}
        ),
        1.0138,
        0.02,
    ),
    Case(
        "both ends hinged",
        lambda share: between_plates(
            share, HINGED, {"rotation": FREE}, {"displacement": [0, FREE], "rotation": FREE}
        ),
        1.0038,
        0.01,
    ),
    Case("pressed sideways", partial(column, factor=ONE_END, side=1e-3), 1.0062, 0.01),
    Case(
        "of nu = 0.5",
        lambda share: column(share, ONE_END, law=INCOMPRESSIBLE, modulus=E / 0.75),
        1.0267,
        0.03,
    ),
    Case(
        "of nu = 0.4999, pressed sideways",
        lambda share: column(share, ONE_END, law=RUBBER, modulus=E / 0.75, side=1e-3),
        1.0243,
        0.03,
    ),
    Case(
        "of linear elements and pressures",
        lambda share: column(
            share,
            ONE_END,
            law=RUBBER,
            modulus=E / 0.75,
            degree=1,
            cells=(8, 80),
            formulation="mixed",
        ),
        1.0437,
        0.05,
    ),
    Case("on springs", bedded, 0.9956, 0.01),
    Case("a ring", ring, 0.9979, 0.01),
    Case("an arch", arch, 0.9903, 0.02),
    Case("a pipe", pipe, 1.0021, 0.01),
    Case("a cylinder", cylinder, 1.0050, 0.01),
    Case("a sphere", sphere, 0.9517, 0.05),
    Case("a plate", plate, 0.9950, 0.01),
    Case("a rubber column", rubber_column, 1.0536, 0.06),
    Case("a rubber block", block, 1.0009, 2e-3, 4),
]


LU = {"pc_type": "lu"}
"""Options of the user with which an unsymmetric tangent is factorised itself."""


@contextmanager
def equilibrium(problem: Problem, method: str, steps: int = 1) -> Iterator[Newton]:
    """Newton's method after it has found the equilibrium of the full load. Collective.

    Args:
        problem: Under its load.
        method: "direct", "lu", with factors of an unsymmetric tangent itself, or "iterative".
        steps: In which the load is applied.
    """
    linear = LinearSettings(method="direct", petsc=LU) if method == "lu" else None
    choice = choose(problem, linear or LinearSettings(method=method))
    problem.terms.begin(moving=False)
    assembler = Assembler(problem, iterated=in_blocks(choice, {}))
    scalars = scalar_unknowns(assembler)
    newton = Newton(
        assembler, choice, Tolerance(1e-8, 0.0, 25), scalars=scalars, watch=JacobianWatch(problem)
    )
    retry = RetryStrategy(newton)
    try:
        for step in range(steps):
            problem.set_time((step + 1) / steps, default=PROPORTIONAL)
            result = retry.solve([("", newton.unknowns())])
            assert result.converged, result.reason
        yield newton
    finally:
        newton.destroy()
        assembler.destroy()


def referee(newton: Newton) -> int:
    """Negative eigenvalues of the last tangent by L D L^T of its symmetric part. Collective.

    Those of pressures and constraints are left out.
    """
    assembler = newton.assembler
    if newton.shift > 0.0 or not (newton.result.newton or newton.factorised):
        newton.factorise()
    beside = 0 if newton.bordered is None else newton.bordered.negative()
    with assembler.tangent.entries() as A:
        S = A.copy()
        if not assembler.problem.symmetric:
            transposed = A.duplicate(copy=True)
            transposed.transpose()
            S.axpy(0.5, transposed, PETSc.Mat.Structure.DIFFERENT_NONZERO_PATTERN)
            S.axpy(-0.5, A, PETSc.Mat.Structure.SUBSET_NONZERO_PATTERN)
            transposed.destroy()
        S.setOption(PETSc.Mat.Option.SYMMETRIC, True)
        pc = PETSc.PC().create(A.comm)
        pc.setType("cholesky")
        pc.setFactorSolverType("mumps")
        pc.setOperators(S)
        pc.setFactorSetUpSolverType()
        factors = pc.getFactorMatrix()
        for number, value in ((14, 80), (13, 1), (24, 1), (20, 0)):
            factors.setMumpsIcntl(number, value)
        pc.setUp()
        found = int(factors.getMumpsInfog(12)) - assembler.pressures + beside
        pc.destroy()
        S.destroy()
    return found
