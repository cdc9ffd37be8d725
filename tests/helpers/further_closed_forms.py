"""Further cases with closed forms: units, bodies of revolution, isochoric states, waves, wood.

See `closed_forms`, whose rows these follow.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from itertools import product

import numpy as np
from helpers.closed_forms import (
    FIBRES,
    FREE,
    Row,
    Tables,
    bar,
    confined,
    cube,
    oedometric,
    rollers,
    sheared_numbers,
    tube_radial,
)

UNITS = [
    ("mm", "N/mm^2", 1e6, 200e3, "kN", 1e3, 3.0),
    ("cm", "GPa", 1e9, 70.0, "kgf", 9.80665, 200.0),
    ("inch", "psi", 6894.757293168361, 10e6, "lbf", 4.4482216152605, 500.0),
    ("ft", "ksi", 6894757.293168361, 29e3, "kip", 4448.2216152605, 20.0),
    ("um", "kPa", 1e3, 50.0, "uN", 1e-6, 0.4),
    ("m", "bar", 1e5, 2e6, "MN", 1e6, 5.0),
    ("nm", "MPa", 1e6, 130e3, "nN", 1e-9, 2e3),
]
"""Length; modulus, its SI unit and number; force, its SI unit and number."""
LENGTHS = {
    **{"nm": 1e-9, "um": 1e-6, "mm": 1e-3, "cm": 1e-2, "inch": 0.0254, "ft": 0.3048, "m": 1.0}
}


def units() -> Iterator[Row]:
    """A bar of 10 x 2 x 2 units of length, pulled by a force: F L/(E A) in any units."""
    for unit, modulus, pascal, E, force, newton, F in UNITS:
        scale = LENGTHS[unit]
        long = F * newton * 10 * scale / (E * pascal * 4 * scale**2)
        yield Row(
            f"pulled in {unit}, {modulus}, {force}",
            {
                "mesh": bar([10, 2, 2], [2, 1, 1], unit=unit),
                "materials": {"m": {"law": "linear-elastic", "E": f"{E} {modulus}", "nu": 0.3}},
                "support": rollers(3),
                "load": [{"kind": "force", "on": "right", "value": [f"{F} {force}", 0, 0]}],
                "output": {"probes": {"end": [10, 2, 2]}},
            },
            {
                "number end_x": long,
                "number end_y": -0.3 * long / 5,
                "reaction left 0": -F * newton,
                "energy strain": F * newton * long / 2,
            },
            1e-8,
        )
    for density, SI in (("7.85 g/cm^3", 7850.0), ("490 lb/ft^3", 490 * 16.018463373960142)):
        yield Row(
            f"weight of {density}",
            {
                "mesh": bar([1, 1, 8], [1, 1, 2], unit="ft"),
                "materials": {
                    "m": {"law": "linear-elastic", "E": "29000 ksi", "nu": 0.3, "density": density}
                },
                "support": confined(3),
                "load": [{"kind": "gravity", "value": [0, 0, "-32.174 ft/s^2"]}],
                "output": {"probes": {"top": [0.5, 0.5, 8]}},
            },
            {
                "reaction bottom 2": SI * 32.174 * 0.3048 * 8 * 0.3048**3,
                "number top_z": -SI
                * 32.174
                * 0.3048
                * (8 * 0.3048) ** 2
                / (2 * oedometric(29e3 * 6894757.293168361, 0.3)),
            },
            1e-8,
        )


def washers() -> Iterator[Row]:
    """Long tubes as slices of bodies of revolution: plane strain in them.

    u = A r + B/r + particular; S. P. Timoshenko & J. N. Goodier (1970), sections 28, 32 and 135.
    """
    a, b, E, nu = 0.1, 0.25, 70e9, 0.33
    held = [{"kind": "symmetry", "on": ["bottom"]}, {"kind": "symmetry", "on": ["top"]}]
    material = {"law": "linear-elastic", "E": "70 GPa", "nu": nu, "density": "2.7 g/cm^3"}
    base = {
        "mesh": {
            "rectangle": {"size": [b - a, 0.05], "cells": [24, 4], "origin": [a, 0]},
            "geometry": "axisymmetric",
        },
        "materials": {"m": {**material, "expansion": "23 ppm/K"}},
        "support": held,
        "output": {"probes": {"a": [a, 0], "b": [b, 0]}},
    }
    # Plane strain is plane stress with E/(1 - nu^2) and nu/(1 - nu).
    E1, nu1, w = E / (1 - nu**2), nu / (1 - nu), 6000 * np.pi / 30

    def spun(r: float) -> float:
        c = 2700 * w**2 / (8 * E1)
        even = (3 + nu1) * (1 - nu1) * (a**2 + b**2) * r
        return float(c * (even + (3 + nu1) * (1 + nu1) * a**2 * b**2 / r - (1 - nu1**2) * r**3))

    yield Row(
        "washer spins",
        {**base, "load": [{"kind": "centrifugal", "value": "6000 rpm"}]},
        {"number a_x": spun(a), "number b_x": spun(b)},
        1e-4,
    )
    yield Row(
        "washer under pressure",
        {**base, "load": [{"kind": "pressure", "on": "left", "value": "200 bar"}]},
        {f"number {n}_x": tube_radial(a, b, 2e7, E, nu, r) for n, r in (("a", a), ("b", b))},
        1e-4,
    )
    outer = {"kind": "normal", "on": "right", "displacement": "-0.1 mm", "name": "shrunk"}
    q = 1e-4 / ((1 + nu) / E * b / (b**2 - a**2) * ((1 - 2 * nu) * b**2 + a**2))
    inner = 2 * (1 - nu**2) / E * q * a * b**2 / (b**2 - a**2)
    yield Row(
        "washer shrunk on",
        {**base, "support": [*held, outer]},
        {"number a_x": -inner, "reaction shrunk 0": -q * 2 * np.pi * b * 0.05},
        1e-4,
    )
    T = 100.0
    steady = f"{T}*ln({b}/x)/ln({b}/{a})"

    def heat(r: float) -> float:
        """Integral of T r from a to r."""
        ends = [x**2 / 2 * np.log(b / x) + x**2 / 4 for x in (a, r)]
        return float(T / np.log(b / a) * (ends[1] - ends[0]))

    def warm(r: float) -> float:
        k = 23e-6 * (1 + nu) / (1 - nu)
        whole = heat(b) / (b**2 - a**2)
        return float(k * (heat(r) / r + whole * ((1 - 2 * nu) * r + a**2 / r)))

    yield Row(
        "washer with hot bore",
        {**base, "load": [{"kind": "thermal", "value": steady}]},
        {"number a_x": warm(a), "number b_x": warm(b)},
        1e-4,
    )
    rod = {
        "mesh": bar([0.05, 1], [1, 8], geometry="axisymmetric"),
        "materials": {"m": {"law": "linear-elastic", "E": "70 GPa", "nu": 0, "density": 2700}},
        "support": rollers(2, axial=True),
    }
    yield Row(
        "waves in a round rod",
        {**rod, "modal": {"count": 2}},
        {f"frequency {n}": (2 * n + 1) * np.sqrt(70e9 / 2700) / 4 for n in (0, 1)},
        1e-4,
    )
    yield Row(
        "round rod under its weight",
        {**rod, "load": [{"kind": "gravity"}], "output": {"probes": {"top": [0, 1]}}},
        {
            "number top_y": -2700 * 9.81 / (2 * 70e9),
            "reaction bottom 1": 2700 * 9.81 * np.pi * 0.05**2,
        },
        1e-8,
    )


def isochoric_modes() -> Iterator[Row]:
    """G. Lame's modes of a free square, that shear it: frequency c/(sqrt(2) L) whatever nu.

    One quarter, held at its planes of symmetry; lowest of the modes that these leave.
    """
    E, rho, side = 3e6, 1100.0, 0.2
    for nu, how in (
        (0.0, {}),
        (0.3, {}),
        (0.45, {"formulation": "mixed"}),
        (0.4999, {}),
        (0.5, {}),
    ):
        yield Row(
            f"square sheared in vibration nu {nu:g}",
            {
                "mesh": cube(2, side / 2, 6, "m", **how),
                "materials": {"m": {"law": "neo-hookean", "E": "3 MPa", "nu": nu, "density": rho}},
                "support": [{"kind": "symmetry", "on": n} for n in ("right", "top")],
                "modal": {"count": 1},
            },
            {"frequency 0": np.sqrt(E / (2 * (1 + nu)) / rho / 2) / side},
            1e-4,
        )


def unstretched() -> Iterator[Row]:
    """Pure bending and simple shear of nearly hard rubber, with a pressure as unknown: exact.

    Bending: S. P. Timoshenko & J. N. Goodier (1970), section 102, with plane strain's constants.
    """
    for nu in (0.3, 0.4999, 0.5):
        E, peak, long = 6e6, 1e3, 10.0
        yield Row(
            f"bar bent by moments nu {nu:g}",
            {
                "mesh": bar([long, 2], [5, 2], formulation="mixed"),
                "points": {"middle": {"nearest": [0, 1]}},
                "materials": {"m": {"law": "linear-elastic", "E": "6 MPa", "nu": nu}},
                "support": [
                    {"kind": "symmetry", "on": "left"},
                    {"on": "middle", "displacement": [FREE, 0]},
                ],
                "load": [{"kind": "traction", "on": "right", "value": [f"{peak}*(y - 1)", 0]}],
                "output": {"probes": {"tip": [long, 1], "corner": [long, 2]}},
            },
            {
                "number tip_y": -peak * (1 - nu**2) / (2 * E) * long**2,
                "number corner_x": peak * (1 - nu**2) / E * long,
                "number corner_y": -peak * (1 - nu**2) / (2 * E) * (long**2 + nu / (1 - nu)),
                "energy strain": peak**2 * (1 - nu**2) / (2 * E) * long * 2 / 3,
            },
            1e-7,
        )
    for nu in (0.4999, 0.5):
        mu, shear = 4e5, 0.8
        yield Row(
            f"rubber sheared nu {nu:g}",
            {
                "mesh": cube(3, 1, 2, "m"),
                "materials": {"m": {"law": "neo-hookean", "mu": mu, "nu": nu}},
                "support": [
                    {"on": face, "displacement": [f"{shear}*z*t", 0, 0]}
                    for face in ("left", "right", "front", "back", "bottom")
                ],
                "load": [
                    {"kind": "traction", "on": "top", "value": [mu * shear, 0, 0]},
                ],
                "output": {"probes": {"top": [0.5, 0.5, 1]}},
            },
            {"number top_x": shear, "energy strain": mu * shear**2 / 2},
            1e-6,
        )


def waves() -> Iterator[Row]:
    """Bars that are hit, shaken and turned: d'Alembert's waves, rigid rotation."""
    E, rho, long = 1e7, 1000.0, 1.0
    c = np.sqrt(E / rho)
    law = {"law": "linear-elastic", "E": E, "nu": 0, "density": rho}
    base = {"mesh": bar([long, 0.1], [40, 1]), "materials": {"m": law}}
    probe = {"output": {"probes": {"end": [long, 0.05]}}}
    for scheme, end in product(("generalized-alpha", "newmark", "central-differences"), (0.8, 1.6)):
        # The end moves at p/(rho c) until the wave comes back.
        yield Row(
            f"bar hit {scheme} {end:g}",
            {
                **base,
                **probe,
                "support": [{"kind": "symmetry", "on": "left"}],
                "load": [{"kind": "traction", "on": "right", "value": ["1 kPa", 0]}],
                "dynamics": {"scheme": scheme, "dt": 0.01 / c, "end": end / c},
            },
            {"number end_x": 1e3 * end / E},
            5e-3,
        )
    w = float(2 * np.pi * c / (4 * long))
    for scheme in ("generalized-alpha", "newmark", "central-differences"):
        # A wall that moves as A (1 - cos wt): free end A 2 (1 - cos w(t - L/c)) until 3 L/c.
        end = 2.2 / c
        yield Row(
            f"bar shaken {scheme}",
            {
                **base,
                **probe,
                "support": [
                    {"on": "left", "displacement": [f"1e-3*(1 - cos({w!r}*t))", FREE]},
                    {"kind": "symmetry", "on": "bottom"},
                ],
                "dynamics": {"scheme": scheme, "dt": 0.01 / c, "end": end},
            },
            {"number end_x": 2e-3 * (1 - np.cos(w * (end - long / c)))},
            1e-3,
        )
    spin, end = 20.0, 0.03
    turn = spin * end
    for scheme in ("generalized-alpha", "newmark", "central-differences"):
        stiff = {"law": "neo-hookean", "E": "1 GPa", "nu": 0.3, "density": 1000}
        yield Row(
            f"square turns {scheme}",
            {
                "mesh": {"rectangle": {"size": [1, 1], "cells": [2, 2], "origin": [-0.5, -0.5]}},
                "materials": {"m": stiff},
                "dynamics": {
                    "scheme": scheme,
                    **({} if scheme == "central-differences" else {"dt": 1.5e-4}),
                    "end": end,
                    "initial_velocity": [f"-{spin}*y", f"{spin}*x"],
                },
                "output": {"probes": {"corner": [0.5, 0.5]}},
            },
            {
                "number corner_x": 0.5 * (np.cos(turn) - np.sin(turn) - 1),
                "number corner_y": 0.5 * (np.sin(turn) + np.cos(turn) - 1),
                # Lumped masses at 3 x 3 nodes have 3/2 of the moment of inertia.
                "energy kinetic": 1000 * spin**2 / 12 * (1.5 if "central" in scheme else 1),
            },
            1e-3,  # the square stretches by rho w^2 L^2/E = 4e-4, and breathes
        )


WOOD: Tables = {
    "law": "orthotropic",
    **{"E1": "12 GPa", "E2": "1 GPa", "E3": "0.6 GPa"},
    **{"nu12": 0.4, "nu13": 0.45, "nu23": 0.5},
    **{"G12": "0.8 GPa", "G13": "0.7 GPa", "G23": "0.1 GPa"},
}


def wood() -> Iterator[Row]:
    """All nine constants of an orthotropic block, by pulling and shearing it along its axes.

    Strain i under stress j is -nu_ij/E_i, with the smaller of i and j in front.
    """
    size, faces = (2.0, 1.0, 1.5), ("left right", "front back", "bottom top")
    E, nu = (12e9, 1e9, 0.6e9), {(0, 1): 0.4, (0, 2): 0.45, (1, 2): 0.5}
    mesh = bar([*size], [2, 1, 1])
    places = {"a": [0, 0, 0], "b": [size[0], 0, 0], "c": [0, size[1], 0]}
    held = {
        "points": {name: {"nearest": at} for name, at in places.items()},
        "support": [
            {"on": "a", "displacement": [0, 0, 0]},
            {"on": "b", "displacement": [FREE, 0, 0]},
            {"on": "c", "displacement": [FREE, FREE, 0]},
        ],
    }
    for j, pair in enumerate(faces):
        pulls = [
            {"kind": "traction", "on": name, "value": [sign * 1e6 * (i == j) for i in range(3)]}
            for name, sign in zip(pair.split(), (-1, 1), strict=True)
        ]
        strain = [
            1e6 / E[j] if i == j else -nu[min(i, j), max(i, j)] / E[min(i, j)] * 1e6
            for i in range(3)
        ]
        yield Row(
            f"wood pulled along {'xyz'[j]}",
            {
                "mesh": mesh,
                "materials": {"m": WOOD},
                **held,
                "load": pulls,
                "output": {"probes": {"far": [*size]}},
            },
            {f"number far_{'xyz'[i]}": strain[i] * size[i] for i in range(3)},
            1e-8,
        )
    for (i, j), G in {(0, 1): 0.8e9, (0, 2): 0.7e9, (1, 2): 0.1e9}.items():
        moved = ["0", "0", "0"]
        moved[i] = f"1e-3*{'xyz'[j]}*t"
        yield Row(
            f"wood sheared in {'xyz'[i]}{'xyz'[j]}",
            {
                "mesh": mesh,
                "materials": {"m": WOOD},
                "support": [
                    {"on": face, "displacement": moved} for pair in faces for face in pair.split()
                ],
            },
            {"energy strain": G * 1e-6 / 2 * 3.0},
            1e-8,
        )


def sheared_fibres() -> Iterator[Row]:
    """Tissue that is sheared along and across its fibres."""
    faces = ["left", "right", "bottom", "top", "front", "back"]
    for (name, constants), (where, fibre) in product(
        FIBRES.items(), (("along", [1, 0, 0]), ("across", [0, 1, 0]))
    ):
        typed = {**constants, "fibre": fibre}
        yield Row(
            f"{name} sheared {where} its fibres",
            {
                "mesh": cube(3, 1, 1, "m"),
                "materials": {"m": {"law": name, **typed}},
                "support": [{"on": face, "displacement": ["0.2*y*t", 0, 0]} for face in faces],
                "output": {
                    "probes": {"middle": {"at": [0.5, 0.5, 0.5], "fields": ["cauchy_stress"]}}
                },
            },
            partial(sheared_numbers, name, typed, 0.2),
            1e-6,
        )


FURTHER: list[Row] = [
    row
    for family in (units, washers, isochoric_modes, unstretched, waves, wood, sheared_fibres)
    for row in family()
]
