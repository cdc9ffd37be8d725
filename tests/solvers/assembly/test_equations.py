"""Residual and tangent as PETSc objects: one is the derivative of the other."""

from __future__ import annotations

import numpy as np
import pytest

from dolfin_elastic import (
    Equations,
    NeoHookean,
    Normal,
    Problem,
    Statics,
    Support,
    Traction,
    box_body,
)


@pytest.mark.parametrize("support", [Support(on="left"), Normal(on="left")], ids=["fixed", "skew"])
def test_the_tangent_is_the_derivative(support: Support | Normal) -> None:
    """By central differences; in the equilibrium that `Statics` has found the residual is zero."""
    problem = Problem(
        box_body(size=[1, 0.2], cells=[4, 1]),
        NeoHookean(E=1e6, nu=0.3),
        supports=[Support(on="bottom", displacement=["free", 0]), support],
        loads=[Traction(on="right", value=[2e4, 1e3])],
        degree=1,
    )
    *_, state = Statics(problem, rtol=1e-12).steps()
    with Equations(problem) as equations:
        x = equations.x
        K, F = equations.tangent(x), equations.residual(x)
        assert F.norm() < 1e-6
        d, up, down, product = (x.duplicate() for _ in range(4))
        begin = d.getOwnershipRange()[0]
        d.array_w[:] = np.sin(begin + np.arange(d.getLocalSize()))
        K.mult(d, product)
        for y, sign in ((up, 1e-6), (down, -1e-6)):
            x.copy(y)
            y.axpy(sign, d)
            equations.residual(y).copy(y)
        up.axpy(-1.0, down)
        up.scale(0.5e6)
        up.axpy(-1.0, product)
        # Prescribed columns of K are zero, and F has their share by lifting.
        assert up.norm() < 1e-6 * product.norm()
        for vector in (d, up, down, product):
            vector.destroy()
    assert state.max_displacement > 0
