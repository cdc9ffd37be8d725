"""Loads: resultants, closed forms, and each one's tangent against differences."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from dolfinx.mesh import locate_entities
from helpers.annulus import FREE, annulus, radial, solved
from helpers.load_examples import EXAMPLES, example
from helpers.nodal_forces import forces, moved, total
from mpi4py import MPI

from dolfin_elastic import (
    BodyForce,
    Cavity,
    Centrifugal,
    Contact,
    Corotated,
    Fixed,
    Force,
    Gravity,
    Growth,
    LinearElastic,
    LineForce,
    PointForce,
    Pressure,
    Problem,
    Spring,
    Statics,
    StVenantKirchhoff,
    Support,
    Traction,
    box_body,
    rectangle_body,
)
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.units import Length
from dolfin_elastic.mesh import EdgeSelector, PointSelector, name_parts
from dolfin_elastic.model.amplitude import RAMP
from dolfin_elastic.model.loads import LOADS, LoadPoints, ScalarLoad
from dolfin_elastic.solvers.assembly.assembler import Assembler, compiled, integral

E, NU, RHO = 1e6, 0.3, 1000.0
KINDS = [kind for kind in LOADS if kind not in ("cavity", "bearing", "bolt")]
"""Others have tests of their own: scalar unknowns in test_scalars.py and test_bolts.py, bores in
test_bearing.py."""


def body(dim: int) -> Any:
    make = box_body if dim == 3 else rectangle_body
    return make(size=(1,) * dim, cells=(2,) * dim)


def test_every_kind_has_an_example():
    assert set(EXAMPLES) == set(KINDS)


@pytest.mark.sample(3)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("dim", [2, 3])
def test_tangent_of_every_load(monkeypatch, kind, dim):
    """Against differences of fourth order; and symmetric exactly where it says so."""
    law = StVenantKirchhoff(E=E, nu=NU, density=RHO, expansion="1000 ppm/K")
    problem = Problem(body(dim), law, loads=[LOADS[kind](**example(kind, dim))], degree=1)
    symmetric = problem.symmetric
    monkeypatch.setattr(Problem, "symmetric", False)
    problem.set_time(1.0)
    assembler = Assembler(problem)
    x, y, out = (assembler.create_vector() for _ in range(3))
    vectors = []
    for seed in (1, 2, 3):
        moved(problem, 0.1, seed)
        assembler.get(x)
        vectors.append(x.array_r.copy())
    u, w, other = vectors
    h = 1e-3

    def residual(at: np.ndarray) -> np.ndarray:
        x.array_w[:] = at
        assembler.residual.evaluate(x, out)
        return out.array_r.copy()

    near, far = (residual(u + s * w) - residual(u - s * w) for s in (h, 2 * h))
    residual(u)
    assembler.tangent.assemble(x)
    x.array_w[:], y.array_w[:] = w, other
    assembler.tangent.matrix.mult(x, out)
    off = out.array_r - (8 * near - far) / (12 * h)
    comm = problem.body.comm
    worst, size = (
        comm.allreduce(float(np.abs(a).max(initial=0.0)), op=MPI.MAX) for a in (off, out.array_r)
    )
    # Differences of a polynomial of third degree are exact: round-off over h is left.
    assert worst < 1e-9 * size
    forth = out.dot(y)
    assembler.tangent.matrix.mult(y, out)
    skew = abs(forth - out.dot(x)) / abs(forth)
    assert skew < 1e-12 if symmetric else skew > 1e-5
    for vector in (x, y, out):
        vector.destroy()
    assembler.destroy()


# --- resultants ---


@pytest.mark.parametrize(
    "terms",
    [
        {"loads": [BodyForce(value=["4*t", 3])]},
        {"loads": [Force(on="right", value=["4*t", 3])]},
        {"loads": [PointForce(at=[1, 1], value=["4*t", 3])]},
        {"supports": [Spring(on="right", stiffness=[1, 1], displacement=["4*t", 3])]},
    ],
)
def test_numbers_beside_formulas_grow(terms):
    """At half the load 4 t is 2, and the number beside it half of its own."""
    problem = Problem(body(2), LinearElastic(E=E, nu=NU), degree=1, **terms)
    problem.set_time(0.5, default=RAMP)
    if "loads" in terms:
        _, nodal = forces(problem)
    else:
        assembler = Assembler(problem)
        nodal = assembler.reactions.restraints().reshape(-1, 2)
        assembler.destroy()
    np.testing.assert_allclose(total(problem, nodal), [2, 1.5], rtol=1e-13)


def test_stretches_beside_formulas_grow():
    """1 + t is 1.5 at half the load, and the stretch of 3 is 2."""
    law = LinearElastic(E=E, nu=NU)
    problem = Problem(body(2), law, loads=[Growth(value=["1 + t", 3])], degree=1)
    problem.set_time(0.5, default=RAMP)
    (G,) = problem.eigenstrains.values()
    form = compiled(problem, [G[0, 0] * G[1, 1] * G[2, 2] * problem.weak_form.volume(None, 2)])[0]
    assert integral(problem, form) == pytest.approx(3.0, rel=1e-13)


@pytest.mark.parametrize(
    ("geometry", "thickness"), [("plane-strain", 1.0), ("plane-strain", 0.2), ("axisymmetric", 1.0)]
)
def test_total_force_in_a_plane(geometry, thickness):
    """The force is the total, whatever the area: thickness and circumference counted."""
    problem = Problem(
        rectangle_body(size=(1, 2), cells=(2, 3), origin=(1, 0)),
        LinearElastic(E=E, nu=NU),
        loads=[Force(on=["top", "right"], value=["3 kN", -2])],
        geometry=geometry,
        thickness=thickness,
        degree=1,
    )
    _, nodal = forces(problem)
    np.testing.assert_allclose(total(problem, nodal), [3000, -2], rtol=1e-13)


@pytest.mark.parametrize(
    "geometry", ["solid", "edge", "points", "plane-strain", "plane-stress", "axisymmetric"]
)
@pytest.mark.sample(2)
def test_what_is_fixed_bears_the_total_force(geometry):
    """In a plane that on the whole thickness, of a body of revolution on the whole ring."""
    plane = {"geometry": geometry, "thickness": 0.2} if geometry.startswith("plane") else {}
    if geometry == "axisymmetric":
        plane = {"geometry": geometry}
    if plane:
        made = rectangle_body(size=(1, 2), cells=(2, 3), origin=(1, 0))
        on, value = ["top", "right"], [0, "-3 kN"]
    else:
        made = name_parts(
            box_body(size=(1, 2, 3), cells=(2, 2, 2)),
            edges={"ridge": EdgeSelector(between=["right", "top"])},
            points={"tips": PointSelector(of="ridge"), "lid": PointSelector(of="top")},
        )
        on = {"edge": "ridge", "points": ["tips", "lid"]}.get(geometry, ["top", "right"])
        value = [7, 0, "-3 kN"]
    problem = Problem(
        made,
        LinearElastic(E=1e9, nu=NU),
        supports=[Fixed(on="bottom")],
        loads=[Force(on=on, value=value)],
        degree=1,
        **plane,
    )
    *_, state = Statics(problem).steps()
    wanted = [0, 3000] if plane else [-7, 0, 3000]
    along = slice(geometry == "axisymmetric", None)  # round the axis hoop stresses bear, too
    found = state.reactions["bottom"][along]
    np.testing.assert_allclose(found, wanted[along], rtol=1e-12, atol=1e-9)


def test_bar_pulled_by_a_force():
    """u = F L / (E A) = 500 N 2 m / (1 MPa 1 m^2), exact in linear elements."""
    bar = box_body(size=(2, 1, 1), cells=(2, 1, 1))
    law = LinearElastic(E=E, nu=0)
    supports, loads = [Fixed(on="left")], [Force(on="right", value=["500 N", 0, 0])]
    problem = Problem(bar, law, supports=supports, loads=loads, degree=1)
    *_, state = Statics(problem).steps()
    x = problem.V.tabulate_dof_coordinates()[:, 0]
    u = state.u.x.array.reshape(-1, 3)
    np.testing.assert_allclose(u[:, 0], 1e-3 * x / 2, atol=1e-13)
    np.testing.assert_allclose(u[:, 1:], 0, atol=1e-13)


@pytest.mark.parametrize("degree", [1, 2])
def test_total_force_of_wind(degree):
    problem = Problem(
        box_body(size=(1, 2, 3), cells=(2, 2, 2)),
        LinearElastic(E=E, nu=NU),
        degree=degree,
        loads=[Force(on="right", value=["3*t", 0, "2*z"])],
    )
    problem.set_time(2.0)
    _, nodal = forces(problem)
    np.testing.assert_allclose(total(problem, nodal), [6, 0, 3], rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("degree", [1, 2])
def test_point_force_keeps_force_and_moment(dim, degree):
    """Inside, at a corner, on a face, and a little off the body: shape functions are a partition
    of unity that holds linear fields, so both are exact.
    """
    law = LinearElastic(E=E, nu=NU)
    f = np.array([3.0, -2.0, 5.0])[:dim]
    for at, near in (
        ([0.3, 0.41, 0.77], None),
        ([1, 1, 1], None),
        ([1.0005, 0.3, 0.4], [1.0, 0.3, 0.4]),
        ([0.5, 0.5, 0.5], None),
    ):
        load = PointForce(at=at[:dim], value=list(f))
        problem = Problem(body(dim), law, degree=degree, loads=[load])
        problem.set_time(1.0)
        x, nodal = forces(problem)
        place = np.array(near or at, dtype=float)[:dim]
        np.testing.assert_allclose(total(problem, nodal), f, rtol=1e-13)
        moment = total(problem, np.einsum("ni,nj->nij", x, nodal))
        # A point off the body is put onto it by an iteration that ends at 1e-10 or so.
        np.testing.assert_allclose(moment, np.outer(place, f), atol=1e-12 if near is None else 1e-8)


@pytest.mark.parametrize("dim", [2, 3])
def test_line_force_keeps_force_and_moment(dim):
    """Through the inside and along an edge; growing along its length and in time."""
    law = LinearElastic(E=E, nu=NU)
    for start, end in (([0.1, 0.2, 0.3], [0.9, 0.5, 0.3]), ([0, 1, 1], [1, 1, 1])):
        a, b = (np.array(p, dtype=float)[:dim] for p in (start, end))
        load = LineForce(start=list(a), end=list(b), value=[0, "6*t", 0][:dim])
        problem = Problem(body(dim), law, loads=[load], degree=1)
        problem.set_time(0.5)
        x, nodal = forces(problem)
        length = np.linalg.norm(b - a)
        f = np.array([0, 3.0, 0])[:dim] * length
        np.testing.assert_allclose(total(problem, nodal), f, rtol=1e-13, atol=1e-13)
        moment = total(problem, np.einsum("ni,nj->nij", x, nodal))
        np.testing.assert_allclose(moment, np.outer((a + b) / 2, f), atol=1e-12)


def test_line_force_is_a_traction_on_a_narrow_strip():
    """In a plane: a line force on an edge does what a traction there does, in every node.

    Each part of the line lies in one cell here, so two Gauss points are exact.
    """
    law = LinearElastic(E=E, nu=NU)
    found = []
    for load in (
        Traction(on="top", value=[2.0, -3.0]),
        LineForce(start=[0, 1], end=[1, 1], value=[2.0, -3.0]),
    ):
        problem = Problem(rectangle_body(size=(1, 1), cells=(4, 4)), law, loads=[load], degree=1)
        problem.set_time(1.0)
        found.append(forces(problem)[1])
    np.testing.assert_allclose(found[0], found[1], atol=1e-13)


def test_supports_carry_a_point_force():
    """Through a whole solution: the reaction is the force, at every moment of its curve."""
    problem = Problem(
        box_body(size=(2, 1, 1), cells=(3, 2, 2)),
        LinearElastic(E=E, nu=NU),
        supports=[Support(on="left")],
        loads=[PointForce(at=[2, 0.5, 1], value=["1 kN", 0, -500], curve="load-unload")],
        degree=1,
    )
    for state in Statics(problem, steps=4).steps():
        share = 1 - abs(2 * state.t - 1)
        np.testing.assert_allclose(
            state.reactions["left"], [-1000 * share, 0, 500 * share], atol=1e-6
        )


# --- spinning bodies ---


def test_spinning_rod():
    """nu = 0: the pull at the axis is rho A omega^2 L^2/2, whatever the mesh."""
    problem = Problem(
        box_body(size=(2, 0.1, 0.1), cells=(8, 1, 1)),
        LinearElastic(E=E, nu=0.0, density=RHO),
        supports=[Support(on="left")],
        loads=[Centrifugal(value="60 rpm")],
        degree=2,
    )
    assert problem.linear
    omega = 2 * np.pi
    state = solved(problem, 1)
    pull = RHO * 0.01 * omega**2 * 2**2 / 2
    assert state.reactions["left"][0] == pytest.approx(-pull, rel=1e-12)


def test_spinning_rod_that_stretches():
    """Corotated at nu = 0, P = E (x' - 1): x'' = -k^2 x with k^2 = rho omega^2/E, x(0) = 0 and
    x'(L) = 1, so x(L) = tan(kL)/k; here kL = 0.8, and the rod grows by 29 %.
    """
    n, k = 16, 0.8
    problem = Problem(
        rectangle_body(size=(1, 1 / n), cells=(n, 1)),
        Corotated(E=E, nu=0.0, density=RHO),
        supports=[
            Support(on="left", displacement=[0, FREE]),
            Support(on="bottom", displacement=[FREE, 0]),
        ],
        loads=[Centrifugal(value=float(k * np.sqrt(E / RHO)))],
        degree=2,
    )
    assert not problem.linear
    assert problem.symmetric
    solved(problem)
    assert radial(problem, 1) == pytest.approx(np.tan(k) / k - 1, rel=1e-5)


def test_spinning_disc():
    """Annular disc in plane stress: the hoop stress inside is rho omega^2/4 ((3 + nu) b^2
    + (1 - nu) a^2), and u(a) = a/E times that.  Timoshenko & Goodier (1951), section 30.
    """
    problem = Problem(
        annulus(MPI.COMM_WORLD, 8),
        LinearElastic(E=E, nu=NU, density=RHO),
        degree=2,
        supports=[
            Support(on="x0", displacement=[0, FREE]),
            Support(on="y0", displacement=[FREE, 0]),
        ],
        loads=[Centrifugal(value=3)],
        geometry="plane-stress",
    )
    solved(problem, 1)
    hoop = RHO * 9 / 4 * ((3 + NU) * 4 + (1 - NU))
    assert radial(problem, 1) == pytest.approx(hoop / E, rel=2e-4)


def test_spin_about_an_axis_in_space():
    """Force per volume of a body at rest: omega^2 times the distance from the axis."""
    axis, point = np.array([1.0, 2.0, 2.0]) / 3, np.array([0.3, -0.1, 0.2])
    problem = Problem(
        body(3),
        LinearElastic(E=E, nu=NU, density=RHO),
        loads=[Centrifugal(value=2, axis=[1, 2, 2], point=list(point))],
        degree=1,
    )
    _, nodal = forces(problem)
    r = np.array([0.5, 0.5, 0.5]) - point
    exact = RHO * 4 * (r - (axis @ r) * axis)
    np.testing.assert_allclose(total(problem, nodal), exact, rtol=1e-12)


# --- what is refused ---


@pytest.mark.parametrize(("name", "row"), [("x", [1, 0, 0]), ("y", [0, 1, 0]), ("z", [0, 0, 1])])
def test_a_centrifugal_axis_with_a_name(name, row):
    """It is the direction that the components would say."""
    places = LoadPoints(np.array([[1.0, 2.0, 3.0]]), 0.0, density=np.ones(1))
    by_name, by_row = (Centrifugal(value=2, axis=axis).intensity(places) for axis in (name, row))
    np.testing.assert_array_equal(by_name, by_row)
    np.testing.assert_allclose(by_name, 4 * (1 - np.array([row])) * places.X)


@pytest.mark.parametrize(
    ("kind", "keys", "says"),
    [
        ("traction", {"on": "top"}, "value: this key is missing"),
        (
            "traction",
            {"on": "top", "force": [1, 2]},
            "'force'; a total force [N] is",
        ),
        ("force", {"on": "top", "value": ["1 Pa", 2]}, "value[0]: '1 Pa' has the wrong unit"),
        ("force", {"value": [1, 2]}, "on: this key is missing"),
        ("force", {"on": "top", "force": [1, 2]}, "'force'; it is the value, as in value = [0"),
        (
            "point-force",
            {"on": "top", "value": [1, 2], "total": True},
            "'total'; a total force [N] of all that `on` names is kind = \"force\"",
        ),
        ("traction", {"on": [], "value": [1, 2]}, "on: no name is given"),
        ("traction", {"on": "top", "moment": [1, 2, 3]}, "'moment'; a moment on a surface is kind"),
        ("gravity", {"on": []}, "on: no name is given; a region's name; left out, it is the"),
        ("centrifugal", {"value": "2 mm"}, "value: '2 mm' has the wrong unit"),
        ("centrifugal", {"value": "x"}, "value: a body spins with one speed"),
        ("centrifugal", {"value": 1, "axis": [0, 0, 0]}, "axis: a direction cannot be zero"),
        ("centrifugal", {"value": 1, "point": [0, "x", 0]}, "point[1]: 'x' is not a number"),
        ("point-force", {"value": [1, 0, 0]}, "at: this key is missing"),
        ("point-force", {"value": [1, 0, 0], "at": [0, "t", 0]}, "at[1]: 't' is not a number"),
        ("line-force", {"value": [1, 0], "start": [0, 0], "end": [0, 0]}, "end: the line has no"),
        ("line-force", {"value": [1, 0], "start": [0, 0], "end": [0, 0, 1]}, "end: 3 components"),
    ],
)
def test_what_is_no_load(kind, keys, says):
    with pytest.raises(InputError) as caught:
        LOADS[kind](**keys)
    assert says in str(caught.value)


@pytest.mark.parametrize(
    ("load", "says"),
    [
        (PointForce(at=[1.5, 0.5, 0.5], value=[1, 0, 0]), "load[1].at: (1.5, 0.5, 0.5) m is 0.5 m"),
        (PointForce(at=[0.5, 0.5], value=[1, 0, 0]), "load[1].at: 2 components"),
        (PointForce(at=[0.5, 0.5, 0.5], value=[1, 0]), "load[1].value: 2 components"),
        (
            LineForce(start=[0, 0, 0], end=[0, 0, 2], value=[1, 0, 0]),
            "load[1].end: on the line (0,",
        ),
        (Centrifugal(value=1, point=[0, 0]), "load[1].point: 2 components"),
        (Centrifugal(value=1), "materials.body"),
        (Force(on="none", value=[0, 0, 1]), "load[1].on: the surface has no area"),
        (Traction(on="rigth", value=[0, 0, 1]), "load[1].on: no surface 'rigth' in"),
    ],
)
def test_loads_that_do_not_fit_the_body(load, says):
    law = LinearElastic(E=E, nu=NU, density=RHO if "point" in load.vectors else None)
    with pytest.raises(InputError) as caught:
        cube = body(3).named(surfaces={"none": np.empty(0, dtype=np.int32)})
        Problem(cube, law, loads=[BodyForce(value=[0, 0, 1]), load], degree=1)
    assert says in str(caught.value)


def test_weight_of_a_body_of_revolution_is_along_its_axis():
    weight = Gravity(value=[1, -9.81])
    with pytest.raises(InputError, match=r"load\[0\].value\[0\]: the weight of a body of rev"):
        Problem(
            body(2),
            LinearElastic(E=E, nu=NU, density=RHO),
            loads=[weight],
            geometry="axisymmetric",
            degree=1,
        )


FACING: list[tuple[dict[str, Any], str]] = [
    ({"loads": [Pressure(on="cut", value=1)]}, "load[0].on"),
    ({"loads": [Cavity(on=["left", "cut"], pressure=1)]}, "load[0].on"),
    ({"supports": [Spring(on="cut", normal=1)]}, "support[0].on"),
    ({"contacts": [Contact(on="cut", sphere={"center": [5, 0, 0], "radius": 1})]}, "contact[0].on"),
]


@pytest.mark.parametrize(("terms", "where"), FACING)
def test_a_surface_inside_the_body_has_no_normal(terms, where):
    """Which of its two sides counts would be up to the numbering of cells, and so to the ranks."""
    cube = body(3)
    cut = locate_entities(cube.mesh, 2, lambda x: np.isclose(x[0], 0.5))
    with pytest.raises(InputError, match="'cut' lies inside the body") as caught:
        Problem(
            cube.named(surfaces={"cut": np.sort(cut)}), LinearElastic(E=E, nu=NU), degree=1, **terms
        )
    assert caught.value.where == where


def test_a_tolerance_lets_points_lie_off_the_body():
    load = PointForce(at=[1.5, 0.5, 0.5], value=[1, 0, 0], tolerance="0.6 m")
    problem = Problem(
        body(3), LinearElastic(E=E, nu=NU), loads=[load, Pressure(on="top", value=0)], degree=1
    )
    problem.set_time(1.0)
    x, nodal = forces(problem)
    place = total(problem, x * nodal[:, :1])
    np.testing.assert_allclose(place, [1, 0.5, 0.5], atol=1e-8)


def test_keys_of_new_loads_are_told_with_their_units():
    """Lists of lengths, too: nothing but the class says that they are."""

    class Blast(ScalarLoad):
        kind: str = "blast"
        centre: list[Length]
        further: list[Length] | None = None
        unit = "Pa"

    load = Blast(value="30 kPa", centre=["200 cm", 0, 1], further=[1, 2])
    assert load.describe() == "blast of 30 kPa; centre (2, 0, 1) m; further (1, 2) m"
