"""Shear waves in a brain whose skull turns: a linear viscoelastic disc in a rigid shell.

The disc of plane strain is what the ball of G. N. Bycroft (J. Biomech. 6 (1973) 487) is in space:
it turns in rings, u_phi(r, t), with rho u_tt = G * (u'' + u'/r - u/r^2), convolved with G(t).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mpi4py import MPI

from dolfin_elastic import Dynamics, LinearElastic, Problem, Rotation, read_body
from dolfin_elastic.core.parallel import largest, on_root
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh import Selector, name_parts

RADIUS, RHO, SUDDEN = 0.08, 1040.0, 10e3
BRANCHES = [(0.5, 0.01), (0.3, 0.1)]
"""Ratios to the sudden stress, and times [s]: 2 kPa are left."""
AMPLITUDE, RATE, END = 1e-5, 100.0, 0.06
"""The skull turns by AMPLITUDE (1 - cos(RATE t))^2, which begins as t^4."""


def theory(t: float, r: FloatArray) -> FloatArray:
    """Angle over AMPLITUDE by which rings of radius r > 0 have turned at time t.

    By Laplace transform: u = AMPLITUDE R J1(kr)/J1(kR) with k^2 = -rho s/G(s); J1(ix) = i I1(x).
    A signal of four times END is transformed, its copies damped by e^-20.
    """
    from scipy.special import ive

    count, period = 4096, 4 * END
    times, damping = np.arange(count) * period / count, 20 / period
    s = damping + 2j * np.pi * np.fft.rfftfreq(count, period / count)
    modulus = SUDDEN * (
        1 - sum(g for g, _ in BRANCHES) + sum(g * s * tau / (1 + s * tau) for g, tau in BRANCHES)
    )
    q = s * np.sqrt(RHO / modulus)
    skull = np.fft.rfft((1 - np.cos(RATE * times)) ** 2 * np.exp(-damping * times))
    x, whole = q * r[:, None], q * RADIUS
    ratio = RADIUS / r[:, None] * ive(1, x) / ive(1, whole) * np.exp(x.real - whole.real)
    found = np.fft.irfft(ratio * skull, count, axis=1) * np.exp(damping * times)
    return np.asarray(found[:, round(t / period * count)])


def disc(folder: Path) -> Problem:
    """Triangles of an eighth of the radius, their pressure an unknown."""
    text = (
        'SetFactory("OpenCASCADE");\n'
        f"Disk(1) = {{0, 0, 0, {RADIUS}}};\n"
        'Physical Surface("brain") = {1};\n'
        f"Mesh.MeshSizeMax = {RADIUS / 8};\n"
    )
    on_root(MPI.COMM_WORLD, lambda: (folder / "disc.geo").write_text(text))
    body = name_parts(read_body(folder / "disc.geo"), surfaces={"skull": Selector(all=True)})
    law = LinearElastic(
        mu=SUDDEN, nu=0.5, density=RHO, prony=[{"g": g, "tau": tau} for g, tau in BRANCHES]
    )
    angle = f"{AMPLITUDE}*(1 - cos({RATE}*t))^2"
    skull = Rotation(on="skull", point=[0, 0], axis="z", angle=angle)
    return Problem(body, law, supports=[skull], geometry="plane-strain", degree=2)


def top(values: FloatArray) -> float:
    """Largest magnitude of all ranks."""
    return largest(MPI.COMM_WORLD, float(np.abs(values).max(initial=0.0)))


@pytest.mark.long
def test_rings_turn_as_the_theory_says(folder: Path) -> None:
    """Every node, at half the time and at the end, to 0.5 % of the largest angle at that time.

    Steps of END/96: (2 RATE dt)^2/12, 0.13 %, in the phase of the faster part.
    """
    problem = disc(folder)
    x = problem.places[:, :2]
    r = np.linalg.norm(x, axis=1)
    off = r > RADIUS / 8
    compared = 0
    for state in Dynamics(problem, end=END, dt=END / 96).steps():
        if state.step not in (48, 96):
            continue
        compared += 1
        u = state.u.x.array.reshape(-1, 2)[: len(x)]
        turned = (x[:, 0] * u[:, 1] - x[:, 1] * u[:, 0])[off] / r[off] ** 2 / AMPLITUDE
        outwards = (x * u).sum(axis=1)[off] / r[off] ** 2 / AMPLITUDE
        wanted = theory(state.t, r[off])
        scale = top(wanted)
        assert top(turned - wanted) < 0.005 * scale
        assert top(outwards) < 0.001 * scale
    assert compared == 2
