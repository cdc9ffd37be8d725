"""Material laws with their example constants, at points and in homogeneous states."""

from __future__ import annotations

from typing import Any

import numpy as np
from helpers.law_at_points import Point
from mpi4py import MPI

from dolfin_elastic import (
    Problem,
    Statics,
    Support,
    box_body,
)
from dolfin_elastic.mesh import Body
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.plasticity import Plastic
from dolfin_elastic.model.materials.registry import MATERIALS

E, NU = 1e6, 0.3
MU, LMBDA = E / (2 * (1 + NU)), E * NU / ((1 + NU) * (1 - 2 * NU))
I = np.eye(3)


NEVER = {"E": E, "yield_stress": 1e12, "hardening": 0.0}
"""Constants of plastic laws with which nothing yields: they are elastic laws then."""


def make(name: str, **more: Any) -> Law:
    kind = MATERIALS[name]
    elastic = NEVER if issubclass(kind, Plastic) else {}
    return kind(**{**kind.example, **elastic, **more})


_POINTS: dict[str, Point] = {}


def point(name: str) -> Point:
    if name not in _POINTS:
        _POINTS[name] = Point(make(name))
    return _POINTS[name]


def random_F(seed: int) -> np.ndarray:
    F = I + 0.25 * np.random.default_rng(seed).uniform(-1, 1, (3, 3))
    assert np.linalg.det(F) > 0.2
    return F


def rotation(seed: int) -> np.ndarray:
    Q, _ = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))
    return Q * np.linalg.det(Q)


def differences(f: Any, F: np.ndarray, h: float = 1e-3) -> np.ndarray:
    """df/dF by central differences of fourth order: exact for energies of degree 4 in F."""
    rows = []
    for i, j in np.ndindex(3, 3):
        D = np.zeros((3, 3))
        D[i, j] = h
        rows.append((8 * (f(F + D) - f(F - D)) - (f(F + 2 * D) - f(F - 2 * D))) / (12 * h))
    return np.moveaxis(np.array(rows).reshape(3, 3, *np.shape(rows[0])), (0, 1), (-2, -1))


def irregular(body: Body, size: tuple[float, ...]) -> Body:
    """Moves nodes about, along faces on faces; a function of place, so all ranks agree."""
    x, start = body.mesh.geometry.x, body.mesh.geometry.x.copy()
    for i, L in enumerate(size):
        s, others = start[:, i] / L, start @ np.roll([0.0, 3.1, 1.7], i)
        x[:, i] += L / 8 * s * (1 - s) * np.sin(4 * others + i)
    return body


def homogeneous(
    law: Law,
    prescribed: dict[str, list[Any]],
    size: tuple[float, ...],
) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Corner displacement over size, and reactions over area, of a stretched irregular body."""
    body = irregular(box_body(size=size, cells=(3,) * len(size)), size)
    supports = [Support(on=name, displacement=values) for name, values in prescribed.items()]
    problem = Problem(body, law, supports=supports, degree=1)
    *_, state = Statics(problem, steps=2, rtol=1e-13).steps()
    bs = len(size)
    u = problem.u.x.array.reshape(-1, bs)
    places = problem.V.tabulate_dof_coordinates()
    at = np.flatnonzero(np.abs(places[:, :bs] - np.array(size)).max(axis=1) < 1e-9)
    corner = u[at[0]] / size if len(at) else np.full(bs, -np.inf)
    # Every node, not only the corner: the state is homogeneous.
    stretch = np.max(body.comm.allgather(corner), axis=0)
    spread = np.abs(u - places[:, :bs] * stretch).max(initial=0.0)
    assert body.comm.allreduce(spread, op=MPI.MAX) < 1e-9
    area = {"right": np.prod(size[1:]), "top": np.prod(size[:-1])}
    return 1 + stretch, {k: state.reactions[k] / a for k, a in area.items() if k in prescribed}


SIZE = (1.0, 0.7, 0.5)
FREE = "free"
ROLLERS = {"left": [0, FREE, FREE], "front": [FREE, 0, FREE], "bottom": [FREE, FREE, 0]}
