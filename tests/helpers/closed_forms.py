"""A table of cases with closed forms, as a user types them: laws, units, bodies, supports, loads.

A row says what is solved, which numbers are known, and how far off the answer may be.  Formulas are
typed here apart from the program's; energies of laws come from `reference_energies`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from typing import Any

import mpmath as mp
import numpy as np
from helpers.reference_energies import ENERGIES
from helpers.reference_meshes import ring

from dolfin_elastic.model.materials.registry import MATERIALS

FREE = "free"
Tables = dict[str, Any]
Known = Mapping[str, float]


@dataclass(frozen=True)
class Row:
    """One case.

    Attributes:
        name: Of the test.
        case: The tables of the case.
        known: Place of a number in the results, see `Answers.read`, to its value in SI units; or
            what finds them, where that takes a while.
        within: Relative error that the mesh or the time step leaves.
        geo: Text of the mesh file `body.geo`.
        says: The answer is off by more than that, and this is said of it.
    """

    name: str
    case: Tables
    known: Known | Callable[[], Known]
    within: float
    geo: str = ""
    says: str = ""

    def numbers(self) -> Known:
        """The numbers that are known."""
        return self.known() if callable(self.known) else self.known


def cube(dim: int, side: float, cells: int, unit: str, **mesh: Any) -> Tables:
    """A cube, or a square, as [mesh]."""
    kind = "box" if dim == 3 else "rectangle"
    return {kind: {"size": [side] * dim, "cells": [cells] * dim}, "unit": unit, **mesh}


def bar(size: list[float], cells: list[int], **mesh: Any) -> Tables:
    """A box or a rectangle as [mesh]."""
    return {"box" if len(size) == 3 else "rectangle": {"size": size, "cells": cells}, **mesh}


def rollers(dim: int, *, axial: bool = False) -> list[Tables]:
    """Planes of symmetry at the lower sides; a body of revolution has its axis at the left."""
    names = ["bottom"] if axial else ["left", "front", "bottom"] if dim == 3 else ["left", "bottom"]
    return [{"kind": "symmetry", "on": name} for name in names]


# --- stretched bodies: a law's own stress ---

LAWS: dict[str, tuple[Tables, Tables]] = {
    "st-venant-kirchhoff": ({"E": "1 MPa", "nu": 0.3}, {"E": 1e6, "nu": 0.3}),
    "corotated": ({"E": "2 N/mm^2", "nu": 0.25}, {"E": 2e6, "nu": 0.25}),
    "fixed-corotated": ({"mu": "400 kPa", "lambda": "600 kPa"}, {"mu": 4e5, "lambda": 6e5}),
    "hencky": ({"E": "10 bar", "nu": 0.35}, {"E": 1e6, "nu": 0.35}),
    "neo-hookean": ({"K": "1 MPa", "mu": "0.5 MPa"}, {"K": 1e6, "mu": 5e5}),
    "neo-hookean-split": ({"E": 1e6, "nu": 0.4}, {"E": 1e6, "nu": 0.4}),
    "mooney-rivlin": (
        {"c10": "200 kPa", "c01": "50 kPa", "K": "1.5 MPa", "volumetric": "quadratic"},
        {"c10": 2e5, "c01": 5e4, "K": 1.5e6, "volumetric": "quadratic"},
    ),
    "yeoh": (
        {"c10": "0.2 MPa", "c20": "-5 kPa", "c30": "1 kPa", "nu": 0.3, "volumetric": "log"},
        {"c10": 2e5, "c20": -5e3, "c30": 1e3, "nu": 0.3, "volumetric": "log"},
    ),
    "ogden": (
        {"mu": ["600 kPa", "-20 kPa"], "alpha": [1.3, -2], "nu": 0.4},
        {"mu": [6e5, -2e4], "alpha": [1.3, -2], "nu": 0.4},
    ),
    "arruda-boyce": (
        {"mu": "0.3 MPa", "limit": 3, "nu": 0.4},
        {"mu": 3e5, "limit": 3, "nu": 0.4},
    ),
    "gent": (
        {"mu": "300 kPa", "limit": 40, "K": "2 MPa"},
        {"mu": 3e5, "limit": 40, "K": 2e6},
    ),
    "blatz-ko": ({"mu": "400 kPa", "nu": 0.25}, {"mu": 4e5, "nu": 0.25}),
}
"""Law to its constants as a user types them, and in SI units."""


def drawn(law: Any, s: float, geometry: str) -> tuple[float, float]:
    """Lateral stretch and P11 of a bar that is stretched by s: dW/ds = 0 across it."""

    def energy(a: Any, b: Any, c: Any) -> Any:
        return ENERGIES[law.name()](law, mp.diag([a, b, c]))

    def lateral(b: Any) -> Any:
        return energy(s, b, 1) if geometry == "plane-strain" else energy(s, b, b)

    start = mp.mpf(s) ** -0.35
    across = mp.findroot(lambda b: mp.diff(lateral, b), start)
    third = 1 if geometry == "plane-strain" else across
    return float(across), float(mp.diff(lambda a: energy(a, across, third), s))


def bar_numbers(
    name: str, constants: Tables, s: float, kind: str, place: Mapping[str, Any]
) -> Known:
    """Reaction and lateral motion of a bar 20 mm wide."""
    across, stress = drawn(MATERIALS[name](**constants), s, kind)
    return {
        f"reaction pull {place['side']}": stress * place["area"],
        f"number corner_{place['other']}": 0.02 * (across - 1),
    }


def stretched() -> Iterator[Row]:
    """Bars of all isotropic laws, pulled and pressed in space, planes and about an axis: exact."""
    kinds = ["solid", "plane-strain", "plane-stress", "axisymmetric"]
    for n, (name, kind) in enumerate(product(LAWS, kinds)):
        typed, plain = LAWS[name]
        s = 1.3 if (n + n // 4) % 2 else 0.85
        dim, axial = 3 if kind == "solid" else 2, kind == "axisymmetric"
        degree = {"degree": 1} if n % 3 == 0 else {}
        geometry = {} if dim == 3 else {"geometry": kind}
        if kind == "plane-stress":
            geometry["thickness"] = "1 cm"
        mesh = cube(dim, 20, 1 + n % 2, "mm", **geometry, **degree)
        pull, axis = ("top", "y") if axial else ("right", "x")
        moved: list[Any] = [FREE] * dim
        moved[1 if axial else 0] = f"{20 * (s - 1):.12g} mm"
        area = (
            np.pi * 4e-4 if axial else 4e-4 if dim == 3 else 2e-4 if "thickness" in mesh else 0.02
        )
        side = {"x": 0, "y": 1}[axis]
        other = "x" if axial else "y"
        yield Row(
            f"{name} {kind} {s:g}",
            {
                "mesh": mesh,
                "materials": {"m": {"law": name, **typed}},
                "support": [
                    *rollers(dim, axial=axial),
                    {"on": pull, "displacement": moved, "name": "pull"},
                ],
                "output": {"probes": {"corner": [20] * dim}},
            },
            partial(
                bar_numbers, name, plain, s, kind, {"side": side, "other": other, "area": area}
            ),
            1e-6,
        )


def incompressible_stress(law: Any, s: float, plane: bool) -> float:
    """P11 of an incompressible bar: the energy's slope along stretches that keep the volume."""

    def energy(a: Any) -> Any:
        b = 1 / a if plane else 1 / mp.sqrt(a)
        return ENERGIES[law.name()](law, mp.diag([a, b, 1 if plane else b]))

    return float(mp.diff(energy, s))


RUBBERS: dict[str, Tables] = {
    "neo-hookean": {"mu": "0.4 MPa"},
    "mooney-rivlin": {"c10": 0.15e6, "c01": "40 kPa"},
    "yeoh": {"c10": "0.2 MPa", "c20": "-5 kPa", "c30": "1 kPa"},
    "gent": {"mu": "300 kPa", "limit": 40},
    "ogden": {"mu": ["600 kPa", "-20 kPa"], "alpha": [1.3, -2]},
}


def rubber_force(name: str, s: float, kind: str) -> Known:
    """Force on a bar of unit width, in a body of revolution of unit radius."""
    law = MATERIALS[name](**RUBBERS[name], nu=0.3)  # the volume stays, so that nu takes no part
    stress = incompressible_stress(law, s, kind == "plane-strain")
    if kind == "axisymmetric":
        return {"reaction pull 1": stress * np.pi}
    return {"reaction pull 0": stress}


def incompressible() -> Iterator[Row]:
    """nu = 0.5 exactly, with the pressure of each kind of element."""
    kinds = ["solid", "plane-strain", "axisymmetric"]
    for n, (name, kind) in enumerate(product(RUBBERS, kinds)):
        dim, axial = 3 if kind == "solid" else 2, kind == "axisymmetric"
        s = [1.5, 0.8, 1.2][n % 3] if n % 2 else [0.75, 1.4, 2.0][n % 3]
        how = {"degree": 1, "formulation": "mixed"} if n % 4 == 0 else {}
        geometry = {} if dim == 3 else {"geometry": kind}
        moved: list[Any] = [FREE] * dim
        moved[1 if axial else 0] = s - 1
        yield Row(
            f"incompressible {name} {kind} {s:g}",
            {
                "mesh": cube(dim, 1, 2, "m", **geometry, **how),
                "materials": {"m": {"law": name, **RUBBERS[name], "nu": 0.5}},
                "support": [
                    *rollers(dim, axial=axial),
                    {"on": "top" if axial else "right", "displacement": moved, "name": "pull"},
                ],
            },
            partial(rubber_force, name, s, kind),
            1e-6,
        )


# --- small strains: bars ---


def oedometric(E: float, nu: float) -> float:
    """Modulus of uniaxial strain [Pa]."""
    return E * (1 - nu) / ((1 + nu) * (1 - 2 * nu))


def confined(dim: int) -> list[Tables]:
    """Walls all around, and a bottom (in space of z, in a plane of y)."""
    sides = ["left", "right", "front", "back"] if dim == 3 else ["left", "right"]
    return [{"kind": "symmetry", "on": [*sides]}, {"kind": "symmetry", "on": "bottom"}]


def columns() -> Iterator[Row]:
    """Columns between smooth walls: weight, pressure, springs, obstacles; quadratic, so exact."""
    steel, soil = (210e9, 0.3, 7850.0), (30e6, 0.2, 1900.0)
    for dim, (E, nu, rho), names in (
        (3, steel, ("210 GPa", "7.85 g/cm^3")),
        (2, soil, ("30 MN/m^2", "1900 kg/m^3")),
    ):
        M, high = oedometric(E, nu), 4.0
        mesh = bar([1, 1, high] if dim == 3 else [1, high], [1, 1, 3] if dim == 3 else [1, 3])
        material = {"law": "linear-elastic", "E": names[0], "nu": nu, "density": names[1]}
        up, mid = "z" if dim == 3 else "y", [0.5, 0.5][: dim - 1]
        base = {
            "mesh": mesh,
            "materials": {"m": material},
            "support": confined(dim),
            "output": {"probes": {"top": [*mid, high], "middle": [*mid, high / 2]}},
        }
        weight = rho * 9.81
        yield Row(
            f"column {dim}D weight",
            {**base, "load": [{"kind": "gravity"}]},
            {
                f"number top_{up}": -weight * high**2 / (2 * M),
                f"number middle_{up}": -weight * 3 * high**2 / (8 * M),
                f"reaction bottom {dim - 1}": weight * high,
            },
            1e-8,
        )
        yield Row(
            f"column {dim}D pressed",
            {**base, "load": [{"kind": "pressure", "on": "top", "value": "3 bar"}]},
            {f"number top_{up}": -3e5 * high / M, "energy strain": 3e5**2 * high / (2 * M)},
            1e-8,
        )
        k = 2e7
        spring = {"kind": "spring", "on": "bottom", "normal": k}
        yield Row(
            f"column {dim}D on springs",
            {
                **base,
                "support": [*confined(dim)[:1], spring],
                "load": [{"kind": "force", "on": "top", "value": [*[0] * (dim - 1), "-50 kN"]}],
            },
            {f"number top_{up}": -5e4 * (high / M + 1 / k), f"reaction bottom {dim - 1}": 5e4},
            1e-8,
        )
        plate = {
            "on": "top",
            "name": "plate",
            "plane": {"axis": f"-{up}", "at": f"{high} m"},
            "motion": [*[0] * (dim - 1), "-2 mm"],
            "gap_tolerance": "1 um",
        }
        yield Row(
            f"column {dim}D under a plate",
            {
                **base,
                "contact": [plate],
            },
            {f"number top_{up}": -2e-3, f"reaction plate {dim - 1}": -M * 2e-3 / high},
            2e-3,  # the gap of 1 um that is allowed, over 2 mm
        )
        yield Row(
            f"column {dim}D heated",
            {
                **base,
                "materials": {"m": {**material, "expansion": "12 ppm/K"}},
                "load": [{"kind": "thermal", "value": "50 degC"}],
            },
            # M e = (3 lambda + 2 mu) alpha T, with free expansion upwards.
            {f"number top_{up}": high * 6e-4 * (1 + nu) / (1 - nu)},
            1e-8,
        )
        yield Row(
            f"column {dim}D clamped and heated",
            {
                **base,
                "materials": {"m": {**material, "expansion": 1.2e-5}},
                "support": [*confined(dim), {"kind": "symmetry", "on": "top", "name": "lid"}],
                "load": [{"kind": "thermal", "value": "90 degF"}],
            },
            {f"reaction lid {dim - 1}": -E / (1 - 2 * nu) * 1.2e-5 * 50},
            1e-8,
        )


def free_bodies() -> Iterator[Row]:
    """Held against rigid motions only, at points."""
    E, nu = 70e9, 0.33
    held = {
        "points": {
            "a": {"nearest": [0, 0, 0]},
            "b": {"nearest": [2, 0, 0]},
            "c": {"nearest": [0, 1, 0]},
        },
        "support": [
            {"on": "a", "displacement": [0, 0, 0]},
            {"on": "b", "displacement": [FREE, 0, 0]},
            {"on": "c", "displacement": [FREE, FREE, 0]},
        ],
    }
    aluminium = {"law": "linear-elastic", "E": "70 GPa", "nu": nu, "expansion": "23 ppm/K"}
    probe = {"output": {"probes": {"far": [2, 1, 1]}}}
    mesh = bar([2, 1, 1], [2, 1, 1], unit="dm")
    yield Row(
        "warm and free",
        {
            "mesh": mesh,
            "materials": {"m": aluminium},
            **held,
            **probe,
            "load": [{"kind": "thermal", "value": 40}],
        },
        {
            f"number far_{c}": 23e-6 * 40 * size
            for c, size in zip("xyz", (0.2, 0.1, 0.1), strict=True)
        },
        1e-8,
    )
    yield Row(
        "squeezed from all sides",
        {
            "mesh": mesh,
            "materials": {"m": aluminium},
            **held,
            **probe,
            "load": [
                {
                    "kind": "pressure",
                    "on": ["left", "right", "front", "back", "bottom", "top"],
                    "value": "100 MPa",
                }
            ],
        },
        {
            f"number far_{c}": -1e8 * (1 - 2 * nu) / E * size
            for c, size in zip("xyz", (0.2, 0.1, 0.1), strict=True)
        },
        1e-8,
    )
    wood = {
        "law": "orthotropic",
        **{"E1": "12 GPa", "E2": "1 GPa", "E3": "0.6 GPa"},
        **{"nu12": 0.4, "nu13": 0.45, "nu23": 0.5},
        **{"G12": "0.8 GPa", "G13": "0.7 GPa", "G23": "0.1 GPa"},
    }
    for degrees in (0, 30, 90):
        c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
        # S. G. Lekhnitskii, Theory of Elasticity of an Anisotropic Body (1981): off-axis modulus.
        slope = c**4 / 12e9 + s**4 / 1e9 + (1 / 0.8e9 - 2 * 0.4 / 12e9) * c**2 * s**2
        pulls = [
            {"kind": "traction", "on": name, "value": [sign * 1e6, 0, 0]}
            for name, sign in (("left", -1), ("right", 1))
        ]
        yield Row(
            f"wood at {degrees} degrees",
            {
                "mesh": mesh,
                "materials": {"m": {**wood, "axis1": [c, s, 0], "axis2": [-s, c, 0]}},
                **held,
                "load": pulls,
                "output": {"probes": {"b": [2, 0, 0]}},
            },
            {"number b_x": 0.2 * 1e6 * slope},
            1e-8,
        )


def graded() -> Iterator[Row]:
    """Moduli that vary along a bar, and two layers."""
    pull = [{"kind": "traction", "on": "right", "value": ["1 MPa", 0]}]
    for name, formula, flexibility in (
        ("linear", "1e9*(1 + x)", np.log(2) / 1e9),
        ("exponential", "1e9*exp(-x)", (np.e - 1) / 1e9),
        ("step", "where(x < 0.5, 1e9, 4e9)", 0.5 / 1e9 + 0.5 / 4e9),
    ):
        yield Row(
            f"modulus {name}",
            {
                "mesh": bar([1, 0.1], [20, 1]),
                "materials": {"m": {"law": "linear-elastic", "E": formula, "nu": 0}},
                "support": rollers(2),
                "load": pull,
                "output": {"probes": {"end": [1, 0.1]}},
            },
            {"number end_x": 1e6 * flexibility},
            1e-5,
        )
    layers = {
        "regions": {"a": {"box": [[0, 0], [1, 0.25]]}},
        "materials": {
            "soft": {"law": "linear-elastic", "E": "1 GPa", "nu": 0},
            "stiff": {"law": "linear-elastic", "E": "8 GPa", "nu": 0, "on": "a"},
        },
        "mesh": bar([1, 1], [4, 4]),
    }
    along, across = 0.25 * 8e9 + 0.75e9, 1 / (0.25 / 8e9 + 0.75 / 1e9)
    for name, gradient, number, modulus in (
        ("along", [[1.001, 0], [0, FREE]], "P11", along),
        ("across", [[FREE, 0], [0, 1.001]], "P22", across),
    ):
        pairs = [["left", "right"], ["bottom", "top"]]
        yield Row(
            f"laminate {name}",
            {**layers, "periodic": {"pairs": pairs, "gradient": gradient}},
            {f"number {number}": modulus * 1e-3},
            1e-8,
        )


# --- round bodies ---


def tube_radial(a: float, b: float, p: float, E: float, nu: float, r: float) -> float:
    """Lame's tube in plane strain under inner pressure: radial displacement."""
    c = p * a**2 / (b**2 - a**2)
    return (1 + nu) / E * c * ((1 - 2 * nu) * r + b**2 / r)


def sphere_radial(a: float, b: float, p: float, E: float, nu: float, r: float) -> float:
    """Lame's hollow sphere under inner pressure."""
    c = p * a**3 / (b**3 - a**3)
    return c / E * ((1 - 2 * nu) * r + (1 + nu) * b**3 / (2 * r**2))


def lame() -> Iterator[Row]:
    """Quarter rings that follow the arcs, 12 x 16 quadratic cells."""
    held = [{"on": "side0", "displacement": [FREE, 0]}, {"on": "side2", "displacement": [0, FREE]}]
    data = [
        (1.0, 2.0, 0.0, "m", "1 MPa", 1e6, "0.1 MPa", 1e5),
        (1.0, 1.5, 0.3, "mm", "210 GPa", 210e9, "200 bar", 2e7),
        (2.0, 5.0, 0.45, "cm", "3 MPa", 3e6, "50 kPa", 5e4),
        (1.0, 3.0, 0.4999, "inch", "1 ksi", 6.894757293168361e6, "10 psi", 6.894757293168361e4),
    ]
    for (a, b, nu, unit, modulus, E, pressure, p), kind in product(
        data, ("plane-strain", "axisymmetric", "plane-stress")
    ):
        scale = {"m": 1.0, "mm": 1e-3, "cm": 1e-2, "inch": 0.0254}[unit]
        axial = kind == "axisymmetric"
        if kind == "plane-stress":
            E_, nu_ = E * (1 + 2 * nu) / (1 + nu) ** 2, nu / (1 + nu)
            exact = [tube_radial(a, b, p, E_, nu_, r) for r in (a, b)]
        else:
            exact = [(sphere_radial if axial else tube_radial)(a, b, p, E, nu, r) for r in (a, b)]
        yield Row(
            f"ring {kind} nu {nu:g} {unit}",
            {
                "mesh": {"file": "body.geo", "unit": unit, "geometry": kind},
                "materials": {"m": {"law": "linear-elastic", "E": modulus, "nu": nu}},
                "support": held[:1] if axial else held,
                "load": [{"kind": "pressure", "on": "side3", "value": pressure}],
                "output": {"probes": {"a": [a, 0], "b": [b, 0]}},
            },
            {"number a_x": exact[0] * scale, "number b_x": exact[1] * scale},
            1e-3,
            geo=ring(a, b, (12, 16), 1.08),
        )


def spinning() -> Iterator[Row]:
    """A disc with a hole, thin and long.  S. P. Timoshenko & J. N. Goodier (1970), section 32."""
    held = [{"on": "side0", "displacement": [FREE, 0]}, {"on": "side2", "displacement": [0, FREE]}]
    rho, E, nu, a, b = 7800.0, 200e9, 0.3, 0.1, 0.3
    for speed, w in (("3000 rpm", 100 * np.pi), (500, 500.0)):
        # u(a) = rho w^2 a/(4 E) ((3 + nu) b^2 + (1 - nu) a^2)
        inner = rho * w**2 * a / (4 * E) * ((3 + nu) * b**2 + (1 - nu) * a**2)
        yield Row(
            f"disc at {speed}",
            {
                "mesh": {"file": "body.geo", "geometry": "plane-stress", "thickness": "5 mm"},
                "materials": {"m": {"law": "linear-elastic", "E": E, "nu": nu, "density": rho}},
                "support": held,
                "load": [{"kind": "centrifugal", "value": speed}],
                "output": {"probes": {"a": [a, 0]}},
            },
            {"number a_x": inner},
            3e-4,
            geo=ring(a, b, (12, 16), 1.08),
        )


def balloons() -> Iterator[Row]:
    """Incompressible tubes and spheres far blown up, of several walls and constants.

    Pressure by quadrature of dW/ds over the hoop stretch: A. E. Green & W. Zerna, Theoretical
    Elasticity (1968), section 3.10.
    """
    held = [{"on": "side0", "displacement": [FREE, 0]}, {"on": "side2", "displacement": [0, FREE]}]
    for b, c10, c01, s in (
        (1.5, 0.35e6, 0.0, 1.3),
        (2.0, 0.3e6, 0.05e6, 1.4),
        (3.0, 0.2e6, 0.1e6, 1.2),
    ):
        for sphere in (True, False):
            power = 3 if sphere else 2
            outer = (b**power + s**power - 1) ** (1 / power) / b

            def slope(x: Any, sphere: bool = sphere, c10: float = c10, c01: float = c01) -> Any:
                if sphere:
                    return (c10 * (4 * x - 4 * x**-5) + c01 * (4 * x**3 - 4 * x**-3)) / (x**3 - 1)
                return (c10 + c01) * (2 * x - 2 * x**-3) / (x**2 - 1)

            with mp.workdps(15):
                pressure = float(mp.quad(slope, [outer, s]))
            law = {"law": "mooney-rivlin", "c10": c10, "c01": c01, "nu": 0.5}
            if not c01:
                law = {"law": "neo-hookean", "mu": 2 * c10, "nu": 0.5}
            yield Row(
                f"{'sphere' if sphere else 'tube'} blown up, wall {b:g}",
                {
                    "mesh": {
                        "file": "body.geo",
                        "geometry": "axisymmetric" if sphere else "plane-strain",
                    },
                    "materials": {"m": law},
                    "support": held[:1] if sphere else held,
                    "load": [{"kind": "pressure", "on": "side3", "value": pressure}],
                    "output": {"probes": {"a": [1, 0], "b": [b, 0]}},
                },
                {"number a_x": s - 1, "number b_x": b * (outer - 1)},
                1e-3,
                geo=ring(1, b, (8, 12), 1.08),
            )


ROD = """
SetFactory("OpenCASCADE");
Cylinder(1) = {{0, 0, 0, 0, 0, {long}, {radius}}};
"""


def rods() -> Iterator[Row]:
    """Round rods from CAD, twisted: T = G J angle/L (Saint-Venant); cells of a half radius."""
    for long, radius, unit, scale, E, nu in (
        (30, 10, "mm", 1e-3, 210e9, 0.3),
        (2, 0.5, "m", 1.0, 1e6, 0.45),
    ):
        shear, polar = E / (2 * (1 + nu)), np.pi * (radius * scale) ** 4 / 2
        angle = 1e-3
        yield Row(
            f"rod twisted, {unit}",
            {
                "mesh": {"file": "body.geo", "unit": unit, "size": radius / 2},
                "surfaces": {n: {"plane": "z", "at": n} for n in ("min", "max")},
                "materials": {"m": {"law": "linear-elastic", "E": E, "nu": nu}},
                "support": [
                    {"on": "min"},
                    {
                        "kind": "rotation",
                        "on": "max",
                        "axis": "z",
                        "point": [0, 0, 0],
                        "angle": angle,
                    },
                ],
            },
            # The chord of the turned points is short by angle^2/6.
            {"energy strain": shear * polar * angle**2 / (2 * long * scale)},
            2e-4,
            geo=ROD.format(long=long, radius=radius),
        )


# --- beams ---


def beams() -> Iterator[Row]:
    """Cantilevers of quadratic cells: S. P. Timoshenko, Phil. Mag. 41 (1921) 744, shear with 5/6.

    The clamped end holds the section's contraction, too: some 0.3 % at twenty thicknesses.
    """
    for kind, long, cells, nu in (
        ("plane-stress", 20, [30, 2], 0.3),
        ("plane-strain", 20, [30, 2], 0.2),
        ("plane-stress", 40, [40, 1], 0.0),
        ("solid", 15, [20, 2, 2], 0.1),
    ):
        E, solid = 2e9, kind == "solid"
        bending = E / (1 - nu**2) if kind == "plane-strain" else E
        shear = E / (2 * (1 + nu))
        exact = long**3 / (3 * bending / 12) + long / (5 / 6 * shear)
        size = [long, 1, 1] if solid else [long, 1]
        yield Row(
            f"beam {kind} {long}",
            {
                "mesh": bar(size, cells, **({} if solid else {"geometry": kind})),
                "materials": {"m": {"law": "linear-elastic", "E": "2 GPa", "nu": nu}},
                "support": [{"on": "left"}],
                "load": [
                    {"kind": "traction", "on": "right", "value": [*[0] * (len(size) - 1), 1e3]}
                ],
                "output": {"probes": {"tip": [long, *[0.5] * (len(size) - 1)]}},
            },
            {f"number tip_{'z' if solid else 'y'}": 1e3 * exact},
            8e-3,
        )


ELASTICA = {1: (0.30172077, 0.05643324), 2: (0.49345748, 0.16064172), 5: (0.71379152, 0.38762836)}
"""P L^2/EI to deflection and shortening over L: elliptic integrals (Bisshopp & Drucker 1945)."""


def elastica() -> Iterator[Row]:
    """A strip, a hundred times as long as thick, bent far down; three laws."""
    for (load, (down, short)), law in zip(
        ELASTICA.items(), ("st-venant-kirchhoff", "neo-hookean", "fixed-corotated"), strict=True
    ):
        force = load / 12 / 100**2  # E = 1, h = 1, nu = 0
        yield Row(
            f"elastica {load} {law}",
            {
                "mesh": bar([100, 1], [60, 1]),
                "materials": {"m": {"law": law, "E": 1e6, "nu": 0}},
                "support": [{"on": "left"}],
                "load": [{"kind": "traction", "on": "right", "value": [0, -1e6 * force]}],
                "output": {"probes": {"tip": [100, 0.5]}},
            },
            {"number tip_y": -100 * down, "number tip_x": -100 * short},
            3e-4,
        )


def columns_that_buckle() -> Iterator[Row]:
    """Euler's column with the shear of F. Engesser (1891), in plane strain and plane stress."""
    for kind, long, nu in (
        ("plane-strain", 10, 0.3),
        ("plane-stress", 20, 0.3),
        ("plane-stress", 15, 0.0),
    ):
        E = 1e7
        bending = (E / (1 - nu**2) if kind == "plane-strain" else E) / 12
        euler = np.pi**2 * bending / (4 * long**2)
        exact = euler / (1 + euler / (5 / 6 * E / (2 * (1 + nu))))
        yield Row(
            f"column buckles {kind} {long}",
            {
                "mesh": bar([long, 1], [2 * long, 2], geometry=kind),
                "materials": {"m": {"law": "st-venant-kirchhoff", "E": "10 MPa", "nu": nu}},
                "support": [{"on": "left"}],
                "load": [{"kind": "traction", "on": "right", "value": [-1, 0]}],
                "buckling": {"count": 1},
            },
            {"factor 0": exact},
            5e-3,
        )


# --- vibration and motion ---


def modes() -> Iterator[Row]:
    """Waves along a bar between walls, a block on soft springs, a cantilever."""
    for dim, E, nu, rho, long in ((2, 210e9, 0.3, 7850.0, 2.0), (3, 3e9, 0.4, 1200.0, 0.5)):
        speed = np.sqrt(oedometric(E, nu) / rho)
        size = [0.1 * long] * (dim - 1) + [long]
        yield Row(
            f"waves in a bar {dim}D",
            {
                "mesh": bar(size, [1] * (dim - 1) + [12]),
                "materials": {"m": {"law": "linear-elastic", "E": E, "nu": nu, "density": rho}},
                "support": confined(dim),
                "modal": {"count": 2},
            },
            {f"frequency {n}": (2 * n + 1) * speed / (4 * long) for n in (0, 1)},
            1e-3,
        )
    k, side, rho = 1e5, 0.2, 2000.0
    yield Row(
        "block on springs",
        {
            "mesh": cube(3, side, 1, "m"),
            "materials": {
                "m": {"law": "linear-elastic", "E": "100 GPa", "nu": 0.3, "density": rho}
            },
            "support": [
                {"kind": "spring", "on": "bottom", "normal": k},
                {"kind": "symmetry", "on": ["left", "front"]},
            ],
            "modal": {"count": 1},
        },
        {"frequency 0": np.sqrt(k / (rho * side)) / (2 * np.pi)},
        1e-4,
    )
    yield Row(
        "cantilever in plane strain",
        {
            "mesh": bar([10, 1], [40, 4]),
            "materials": {"m": {"law": "linear-elastic", "E": 1e7, "nu": 0.3, "density": 1e3}},
            "support": [{"on": "left"}],
            "modal": {"count": 2},
        },
        # Elements of order 4 to 10, an independent code.
        {"frequency 0": 0.1682806, "frequency 1": 1.006599},
        1.5e-3,
    )


SCHEMES: dict[str, tuple[Callable[[float, float], float], float]] = {
    "generalized-alpha": (lambda t, dt: t**2 / 2, 1e-6),
    "newmark": (lambda t, dt: t**2 / 2, 1e-6),
    "alpha2": (lambda t, dt: t**2 / 2, 1e-6),
    "implicit-euler": (lambda t, dt: t * (t + dt) / 2, 1e-6),
    "symplectic-euler": (lambda t, dt: t * (t + dt) / 2, 1e-6),
    "central-differences": (lambda t, dt: t**2 / 2, 1e-6),
}
"""Scheme to the fall after t under g = 1, in exact arithmetic."""


def motion() -> Iterator[Row]:
    """Free fall by all schemes, and a bar that swings along itself."""
    dt = 1e-3
    for scheme, (fall, within) in SCHEMES.items():
        yield Row(
            f"fall {scheme}",
            {
                "mesh": cube(2, 10, 1, "cm"),
                "materials": {
                    "m": {"law": "neo-hookean", "E": "10 kPa", "nu": 0.3, "density": 900}
                },
                "load": [{"kind": "gravity"}],
                "dynamics": {"scheme": scheme, "dt": dt, "end": 0.1},
                "output": {"probes": {"corner": [10, 10]}},
            },
            {"number corner_y": -9.81 * fall(0.1, dt)},
            within,
        )
    E, nu, rho, long = 1e7, 0.3, 1000.0, 1.0
    omega = np.pi * np.sqrt(oedometric(E, nu) / rho) / (2 * long)
    end, count = 1.0 / omega, 200
    for scheme in ("generalized-alpha", "newmark", "central-differences"):
        swing = {"initial_displacement": [0, "1e-3*sin(pi*y/2)"]}
        yield Row(
            f"bar swings {scheme}",
            {
                "mesh": bar([0.1, long], [1, 20]),
                "materials": {"m": {"law": "linear-elastic", "E": E, "nu": nu, "density": rho}},
                "support": confined(2),
                "dynamics": {"scheme": scheme, "dt": end / count, "end": end, **swing},
                "output": {"probes": {"end": [0.05, long]}},
            },
            {"number end_y": 1e-3 * np.cos(1.0)},
            3e-4,
        )


# --- homogeneous deformations ---


def sheared_numbers(name: str, constants: Tables, shear: float) -> Known:
    """Energy and shear stress of a square: Cauchy's is P12 there."""
    law = MATERIALS[name](**constants)

    def energy(a: Any) -> Any:
        return ENERGIES[name](law, mp.matrix([[1, a, 0], [0, 1, 0], [0, 0, 1]]))

    return {
        "energy strain": float(energy(mp.mpf(shear))),
        "number middle_cauchy_stress_xy": float(mp.diff(energy, shear)),
    }


def swollen_numbers(name: str, constants: Tables, s: float) -> Known:
    """Energy and stress of a cube."""
    law = MATERIALS[name](**constants)

    def energy(a: Any) -> Any:
        return ENERGIES[name](law, mp.diag([a, a, a]))

    return {
        "energy strain": float(energy(mp.mpf(s))),
        "number middle_cauchy_stress_xx": float(mp.diff(energy, s)) / (3 * s**2),
    }


def prescribed() -> Iterator[Row]:
    """Simple shear of squares and swelling of cubes, by all isotropic laws: exact."""
    for n, (name, (typed, plain)) in enumerate(LAWS.items()):
        shear, s = 0.3 + 0.05 * (n % 4), 1.1 if n % 2 else 0.9
        for what, dim, moved, known in (
            ("sheared", 2, [f"{shear}*y*t", 0], partial(sheared_numbers, name, plain, shear)),
            (
                "swollen",
                3,
                [f"{s - 1:.3g}*{c}*t" for c in "xyz"],
                partial(swollen_numbers, name, plain, s),
            ),
        ):
            faces = ["left", "right", "bottom", "top", "front", "back"][: 2 * dim]
            probe = {"at": [0.5] * dim, "fields": ["cauchy_stress"]}
            yield Row(
                f"{what} {name}",
                {
                    "mesh": cube(dim, 1, 2, "m", **({"degree": 1} if (n + dim) % 2 else {})),
                    "materials": {"m": {"law": name, **typed}},
                    "support": [{"on": face, "displacement": moved} for face in faces],
                    "statics": {"steps": 2},
                    "output": {"probes": {"middle": probe}},
                },
                known,
                1e-6,
            )


FIBRES: dict[str, Tables] = {
    "guccione": {"C": 1e5, "bf": 8, "bt": 2, "bfs": 4, "K": 2e6, "fibre": [1, 0, 0]},
    "holzapfel-gasser-ogden": {
        **{"mu": 3e5, "k1": 2e5, "k2": 0.8, "kappa": 0.1, "K": 2e6},
        "fibre": [1, 0, 0],
    },
}


def fibres() -> Iterator[Row]:
    """Tissue that is pulled along its fibres, soft in volume: across them it is isotropic."""
    for name, constants in FIBRES.items():
        place = {"side": 0, "other": "y", "area": 4e-4}
        yield Row(
            f"fibres {name}",
            {
                "mesh": cube(3, 20, 1, "mm"),
                "materials": {"m": {"law": name, **constants}},
                "support": [
                    *rollers(3),
                    {"on": "right", "displacement": ["3 mm", FREE, FREE], "name": "pull"},
                ],
                "output": {"probes": {"corner": [20, 20, 20]}},
            },
            partial(bar_numbers, name, constants, 1.15, "solid", place),
            1e-6,
        )


# --- rigid ends, cavities, growth, plates ---


def turned() -> Iterator[Row]:
    """Strips that a moment at a rigid end rolls up into arcs: M = EI angle/L."""
    for angle, law, E in ((0.5, "st-venant-kirchhoff", 1e6), (1.5, "neo-hookean", 3e9)):
        L, h = 1.0, 0.02
        yield Row(
            f"rolled up by {angle} {law}",
            {
                "mesh": bar([L, h], [24, 1], unit="m"),
                "materials": {"m": {"law": law, "E": E, "nu": 0}},
                "support": [
                    {"on": "left"},
                    {
                        "kind": "rigid",
                        "on": "right",
                        "force": [0, 0],
                        "moment": E * h**3 / 12 * angle / L,
                    },
                ],
            },
            {
                "number right_ux": L * (np.sin(angle) / angle - 1),
                "number right_uy": L * (1 - np.cos(angle)) / angle,
                "number right_rz": angle,
            },
            1e-3,
        )


def cavities() -> Iterator[Row]:
    """Incompressible tubes and spheres whose inner volume is given."""
    held = [{"on": "side0", "displacement": [FREE, 0]}, {"on": "side2", "displacement": [0, FREE]}]
    for b, s, mu, sphere in ((2.0, 1.3, 1e6, True), (1.5, 1.2, 4e5, False), (2.5, 2.5, 1e6, True)):
        power = 3 if sphere else 2
        outer = (b**power + s**power - 1) ** (1 / power) / b

        def slope(x: Any, sphere: bool = sphere, mu: float = mu) -> Any:
            if sphere:
                return mu * (2 * x - 2 * x**-5) / (x**3 - 1)
            return mu * (x - x**-3) / (x**2 - 1)

        with mp.workdps(15):
            pressure = float(mp.quad(slope, [outer, s]))
        yield Row(
            f"{'sphere' if sphere else 'tube'} with {s:g} times the radius inside",
            {
                "mesh": {
                    "file": "body.geo",
                    "geometry": "axisymmetric" if sphere else "plane-strain",
                },
                "materials": {"m": {"law": "neo-hookean", "mu": mu, "nu": 0.5}},
                "support": held[:1] if sphere else held,
                "load": [
                    {
                        "kind": "cavity",
                        "on": "side3",
                        "volume_ratio": s**power,
                        "name": "inside",
                    }
                ],
                "output": {"probes": {"a": [1, 0]}},
            },
            {"number pressure_inside": pressure, "number a_x": s - 1},
            6e-4,
            geo=ring(1, b, (12, 16), 1.08),
        )


def grown() -> Iterator[Row]:
    """Free bodies that grow, or are warm, far: they keep no stress."""
    for law in ("neo-hookean", "hencky", "mooney-rivlin", "blatz-ko"):
        yield Row(
            f"grown {law}",
            {
                "mesh": bar([2, 1, 1], [2, 1, 1], unit="cm"),
                "materials": {"m": {"law": law, **LAWS[law][0], "expansion": 1e-3}},
                "support": rollers(3),
                "load": [
                    {"kind": "growth", "value": [1.3, 0.8, 1.1]},
                    {"kind": "thermal", "value": 100},
                ],
                "output": {"probes": {"far": [2, 1, 1]}},
            },
            {
                "number far_x": 0.02 * (1.3 * 1.1 - 1),
                "number far_y": 0.01 * (0.8 * 1.1 - 1),
                "number far_z": 0.01 * (1.1 * 1.1 - 1),
            },
            1e-6,
        )


def plates() -> Iterator[Row]:
    """Clamped round plates as bodies of revolution: S. P. Timoshenko & S. Woinowsky-Krieger (1959),
    sections 17 and 20, with shear p a^2/(4 k G h), k = 5/6.

    The edge holds the section's contraction, too: up to 1 % at twenty thicknesses.
    """
    for a, h, nu in ((10.0, 0.5, 0.3), (20.0, 0.5, 0.2), (10.0, 0.25, 0.0)):
        E, p = 2e9, 1e3
        bending = E * h**3 / (12 * (1 - nu**2))
        exact = p * a**4 / (64 * bending) + p * a**2 / (4 * 5 / 6 * E / (2 * (1 + nu)) * h)
        yield Row(
            f"plate {a:g} {h:g}",
            {
                "mesh": bar([a, h], [40, 2], geometry="axisymmetric"),
                "materials": {"m": {"law": "linear-elastic", "E": "2 GPa", "nu": nu}},
                "support": [{"on": "right"}],
                "load": [{"kind": "pressure", "on": "top", "value": "1 kPa"}],
                "output": {"probes": {"middle": [0, h / 2]}},
            },
            {"number middle_y": -exact},
            1e-2,
        )


def damped() -> Iterator[Row]:
    """A stiff block that sinks on a dashpot, and one that settles on springs with damped mass."""
    g, rho, side = 9.81, 2000.0, 0.1
    stiff = {"law": "linear-elastic", "E": "1 GPa", "nu": 0.3, "density": rho}
    mass = rho * side  # per area of the foot
    base = {
        "mesh": cube(2, side, 1, "m"),
        "materials": {"m": stiff},
        "load": [{"kind": "gravity"}],
        "output": {"probes": {"foot": [0.05, 0]}},
    }
    wall = {"kind": "symmetry", "on": "left"}
    tau = 0.05
    for scheme in ("generalized-alpha", "newmark"):
        yield Row(
            f"sinks on a dashpot {scheme}",
            {
                **base,
                "support": [wall, {"kind": "dashpot", "on": "bottom", "normal": mass / tau}],
                "dynamics": {"scheme": scheme, "dt": 5e-4, "end": 0.1},
            },
            {"number foot_y": -g * tau * (0.1 - tau * (1 - np.exp(-0.1 / tau)))},
            1e-4,
        )
    k, a, end = 1e6, 20.0, 0.1
    decay = a / 2
    omega = np.sqrt(k / mass - decay**2)
    swing = np.cos(omega * end) + decay / omega * np.sin(omega * end)
    for scheme in ("generalized-alpha", "central-differences"):
        keys: Tables = {"dt": 5e-4} if scheme == "generalized-alpha" else {}
        if scheme == "generalized-alpha":
            keys["rayleigh"] = [a, 0]
        law = {**stiff, "E": "100 MPa"}
        still = np.cos(np.sqrt(k / mass) * end)
        yield Row(
            f"settles on springs {scheme}",
            {
                **base,
                "materials": {"m": law},
                "support": [wall, {"kind": "spring", "on": "bottom", "normal": k}],
                "dynamics": {"scheme": scheme, "end": end, **keys},
            },
            {
                "number foot_y": -mass
                * g
                / k
                * (1 - (np.exp(-decay * end) * swing if "rayleigh" in keys else still))
            },
            1e-2,  # the block is no point: it shortens by 1e-3 of the springs' way
        )


# --- wrong, and said to be ---


def told() -> Iterator[Row]:
    """What linear elements and straight cells cannot do, with what a run says of it."""
    for size, cells in (([10, 1], [10, 1]), ([10, 1, 1], [20, 2, 2]), ([20, 1], [20, 2])):
        exact = 4 * size[0] ** 3 / 1e6 + size[0] / (5 / 6 * 5e5)
        plane = {"geometry": "plane-stress"} if len(size) == 2 else {}
        yield Row(
            f"linear cells bend {len(size)}D {size[0]} {cells[1]}",
            {
                "mesh": bar(size, cells, degree=1, **plane),
                "materials": {"m": {"law": "linear-elastic", "E": 1e6, "nu": 0}},
                "support": [{"on": "left"}],
                "load": [{"kind": "traction", "on": "right", "value": [*[0] * (len(size) - 1), 1]}],
                "output": {"probes": {"tip": [size[0], *[0.5] * (len(size) - 1)]}},
            },
            {f"number tip_{'y' if len(size) == 2 else 'z'}": exact},
            8e-3,
            says="times too stiff in bending",
        )
    held = [{"on": "side0", "displacement": [FREE, 0]}, {"on": "side2", "displacement": [0, FREE]}]
    for kind in ("plane-strain", "axisymmetric"):
        axial = kind == "axisymmetric"
        radial = sphere_radial if axial else tube_radial
        yield Row(
            f"linear cells lock {kind}",
            {
                "mesh": {"file": "body.geo", "geometry": kind, "degree": 1, "curved": False},
                "materials": {"m": {"law": "linear-elastic", "E": 1e6, "nu": 0.4999}},
                "support": held[:1] if axial else held,
                "load": [{"kind": "pressure", "on": "side3", "value": 1e5}],
                "output": {"probes": {"a": [1, 0]}},
            },
            {"number a_x": radial(1, 2, 1e5, 1e6, 0.4999, 1)},
            1e-3,
            geo=ring(1, 2, (8, 12), diagonals="Right").replace("Mesh.ElementOrder = 2;", ""),
            says="linear elements lock at nu = 0.4999",
        )


ROWS: list[Row] = [
    row
    for family in (
        stretched,
        incompressible,
        columns,
        free_bodies,
        graded,
        lame,
        spinning,
        balloons,
        rods,
        beams,
        elastica,
        columns_that_buckle,
        modes,
        motion,
        prescribed,
        fibres,
        turned,
        cavities,
        grown,
        plates,
        damped,
        told,
    )
    for row in family()
]


@dataclass
class Answers:
    """What a run has yielded.

    Attributes:
        states: The last state, and all modes.
    """

    states: list[Any] = field(default_factory=list)

    def read(self, key: str) -> float:
        """A number of the results: "number NAME", "reaction NAME COMPONENT", "energy NAME",
        "frequency N" or "factor N"."""
        kind, *names = key.split(" ")
        last = self.states[-1]
        if kind == "number":
            return float(last.numbers[names[0]])
        if kind == "reaction":
            return float(last.reactions[names[0]][int(names[1])])
        if kind == "energy":
            return float(last.energies[names[0]])
        mode = self.states[int(names[0])]
        return float(mode.frequency if kind == "frequency" else mode.load_factor)
