"""A strip is bent by a moment and let go: its radius before and after, by Johnson & Mellor.

Ideally plastic, plane strain: R1/R2 = 4 x^3 - 3 x + 1 with x = R1 Y'/(E' t), Y' = 2 Y/sqrt(3) and
E' = E/(1 - nu^2), of an elastic core and fully plastic flanks.

Source: W. Johnson and P. B. Mellor, Engineering Plasticity (1973), section 5.3; F. J. Gardiner,
Trans. ASME 79 (1957) 1.
"""

from __future__ import annotations

import pytest

from dolfin_elastic import J2Logarithmic, Problem, Rigid, Statics, Support, rectangle_body

E, NU, YIELD = 200e9, 0.49, 500e6
LENGTH, THICK, ANGLE = 20.0, 1.0, 1.0
"""Of half of the strip, and by how much its end turns [rad]: R = 20 t, 2.5 % in the skin."""


@pytest.mark.long
def test_the_radius_after_springback() -> None:
    """Turned by ANGLE and back by what the theory says, the moment is gone.

    Within 0.8 % of its largest: half of it is the end, which keeps its section in shape; the rest
    are twelve elements across, of which the elastic core is one (0.3 % of the moment, eight: 0.7).
    """
    modulus, flow = E / (1 - NU**2), 2 / 3**0.5 * YIELD
    x = LENGTH / ANGLE * flow / (modulus * THICK)
    free = ANGLE * (4 * x**3 - 3 * x + 1)
    body = rectangle_body(size=(LENGTH, THICK), cells=(24, 12))
    curve = [[0, 0], [1, ANGLE], [2, free]]
    supports = [
        Support(on="left", displacement=[0, "free"]),
        Rigid(on="right", displacement=["free", 0], rotation=1, curve=curve),
    ]
    law = J2Logarithmic(E=E, nu=NU, yield_stress=YIELD)
    problem = Problem(body, law, supports=supports, geometry="plane-strain")
    moments = {}
    for state in Statics(problem, end=2, steps=12).steps():
        moments[round(state.t, 9)] = float(state.numbers["moment_right_z"])
    bending = flow * THICK**2 / 4 * (1 - (2 * x) ** 2 / 3)
    assert moments[1.0] == pytest.approx(bending, rel=0.005)
    assert abs(moments[2.0]) < 0.008 * bending
