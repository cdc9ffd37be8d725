"""Contact of quadratic faces: Hertz, the tangent and motion; patch tests are in test_contact."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from helpers.states import last
from helpers.tangents import against_differences

from dolfin_elastic import (
    Contact,
    Dynamics,
    LinearElastic,
    NeoHookean,
    Pressure,
    Problem,
    Statics,
    StVenantKirchhoff,
    Support,
    box_body,
    read_body,
    rectangle_body,
)

FREE = "free"
E, NU = 1e6, 0.3


def everywhere(problem: Problem, *arrays: np.ndarray) -> list[np.ndarray]:
    return [np.concatenate(problem.body.comm.allgather(array)) for array in arrays]


def curved(path: Any, dim: int, h: float, order: int) -> None:
    """An eighth of a ball, or a quarter of a disc, of radius 1 that stands on 0; fine there."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ = gmsh.model.occ
    if dim == 3:
        whole, cut = occ.addSphere(0, 0, 1, 1), occ.addBox(0, 0, 0, 1, 1, 1)
    else:
        whole, cut = occ.addDisk(0, 1, 0, 1, 1), occ.addRectangle(0, 0, 0, 1, 1)
    occ.intersect([(dim, whole)], [(dim, cut)])
    occ.synchronize()
    field = gmsh.model.mesh.field
    field.add("Ball", 1)
    for key, value in {"VIn": h, "VOut": 0.3, "Radius": 0.13, "Thickness": 0.9}.items():
        field.setNumber(1, key, value)
    field.setAsBackgroundMesh(1)
    for key in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{key}", 0)
    gmsh.model.mesh.generate(dim)
    gmsh.model.mesh.setOrder(order)
    for _, tag in gmsh.model.getEntities(dim - 1):
        centre = np.array(occ.getCenterOfMass(dim - 1, tag))
        names = {"x0": abs(centre[0]) < 1e-6, "top": abs(centre[dim - 1] - 1) < 1e-6}
        names["y0"] = dim == 3 and abs(centre[1]) < 1e-6
        name = next((name for name, is_it in names.items() if is_it), "skin")
        gmsh.model.addPhysicalGroup(dim - 1, [tag], name=name)
    gmsh.model.addPhysicalGroup(dim, [tag for _, tag in gmsh.model.getEntities(dim)], name="body")
    gmsh.write(str(path))
    gmsh.finalize()


@pytest.mark.parametrize("order", [1, 2], ids=["straight", "curved"])
@pytest.mark.parametrize("kind", ["ball", "plane-strain", "axisymmetric"])
def test_hertz(kind, order, folder, comm):
    """The pressure of a ball or cylinder of radius 1 on a rigid plane, at every vertex within.

    Source: K. L. Johnson, Contact Mechanics (1985), (4.22) to (4.24) and (4.43) to (4.45).
    Conditions at all nodes are 37 % off at the vertices of straight faces.
    """
    dim = 3 if kind == "ball" else 2
    if comm.rank == 0:
        curved(folder / "round.msh", dim, 0.025, order)
    comm.barrier()
    down = [FREE] * (dim - 1) + [-0.01 if kind != "plane-strain" else -0.02]
    supports = [
        Support(on="x0", displacement=[0, *[FREE] * (dim - 1)]),
        Support(on="top", displacement=down),
    ]
    if dim == 3:
        supports.append(Support(on="y0", displacement=[FREE, 0, FREE]))
    problem = Problem(
        read_body(folder / "round.msh"),
        LinearElastic(E=E, nu=NU),
        degree=2,
        geometry="plane-strain" if dim == 3 else kind,
        supports=supports,
        contacts=[Contact(on="skin", plane={"axis": "xyz"[dim - 1], "at": 0}, name="floor")],
    )
    state = last(problem, steps=1)
    (pair,) = problem.contact_pairs
    P, effective = abs(state.reactions["floor"][-1]), E / (1 - NU**2)
    if kind == "plane-strain":
        a = np.sqrt(4 * 2 * P / (np.pi * effective))
        peak = 2 * 2 * P / (np.pi * a)
    else:
        P *= 4 if dim == 3 else 1
        a = (3 * P / 4 / effective) ** (1 / 3)
        peak = 3 * P / (2 * np.pi * a**2)
    area = {"plane-strain": a, "axisymmetric": np.pi * a**2, "ball": np.pi * a**2 / 4}[kind]
    # Its edge lies within an element: 1 to 8 % found, and up to 28 % from areas around vertices.
    assert state.numbers["contact_area_floor"] == pytest.approx(area, rel=0.1)
    places, found = everywhere(problem, pair.places(), pair.pressures())
    r = np.linalg.norm(places[:, : dim - 1], axis=1)
    exact = peak * np.sqrt(np.maximum(0, 1 - (r / a) ** 2))
    inner = r < 0.9 * a
    assert inner.sum() >= (10 if dim == 3 else 3)
    # Four cells in the radius: 0.1 % (cylinder), 2 % (ball), on the axis of straight cells 3.3 %.
    off = (found - exact)[inner] / peak
    assert abs(found.max() / peak - 1) < 0.04
    assert np.sqrt(np.mean(off**2)) < 0.04
    assert not found[r > 1.3 * a].any()


SHAPES = {
    "plane": {"point": [0, 0.02, 0], "normal": [0.1, 1, 0.2]},
    "sphere": {"center": [0.5, -0.7, 0.4], "radius": 0.75},
    "cylinder": {"point": [0.5, 1.0, 0], "radius": 1.05, "inside": True},
    "box": {"center": [0.52, -0.5, 0.5], "size": [0.8, 1.0, 0.7], "x": [1, 0.02, 0]},
    "cone": {"tip": [0.45, 0.03, 0.4], "axis": "-y", "half_angle": 75},
}


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("dim", [2, 3])
def test_tangent(dim, shape):
    """Against central differences, and symmetric."""
    body = (
        rectangle_body(size=(1, 1), cells=(3, 3))
        if dim == 2
        else box_body(size=(1, 1, 1), cells=(2, 2, 2))
    )
    row = {key: v[:dim] if isinstance(v, list) else v for key, v in SHAPES[shape].items()}
    on = "bottom" if dim == 2 else "front"
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU),
        contacts=[Contact.model_validate({"on": on, "name": "it", shape: row})],
        degree=2,
    )
    pair, comm = problem.contact_pairs[0], problem.body.comm
    pair.lam.x.array[:] = 5e6  # presses at gaps of 0.1, round an edge, too
    with against_differences(problem) as (assembler, off, size):
        assert comm.allreduce(int(np.sum(pair.pressures() > 0))) > 0
        # Cancellation: 1e-16 of the forces over 1e-7 of the place.
        assert off < 1e-7 * size
        assert assembler.tangent.matrix.isSymmetric(1e-9 * size)


@pytest.mark.long
def test_a_block_bounces():
    """What the pressures store comes back as motion: the forces have that potential."""
    body = box_body(size=(1, 1, 1), cells=(2, 2, 2))
    problem = Problem(
        body,
        NeoHookean(E=E, nu=NU, density=1000),
        contacts=[Contact(on="bottom", sphere={"center": [0.4, 0.6, -1.02], "radius": 1.0})],
        degree=2,
    )
    settings: dict[str, Any] = {"dt": 2e-3, "spectral_radius": 1.0, "end": 0.15}
    states = list(Dynamics(problem, initial_velocity=[0, 0, -1.0], **settings).steps())
    energies = [state.energies["total"] for state in states]
    stored = [state.energies["contact"] for state in states]
    assert max(stored) > 0.01 * energies[0]
    assert states[-1].momenta["linear"][2] > 0
    np.testing.assert_allclose(energies, energies[0], rtol=1e-10)


@pytest.mark.long
def test_a_slender_body_stays_on_what_it_presses_on():
    """A cantilever that a round edge bends and rubs.

    Where vertices open in any iteration, steps end unsettled, with forces ten times too large.
    """
    problem = Problem(
        rectangle_body(size=(40.0, 1.0), cells=(60, 2)),
        StVenantKirchhoff(E=1e9, nu=NU),
        degree=2,
        geometry="plane-stress",
        supports=[Support(on="left")],
        contacts=[
            Contact(
                on="top",
                name="edge",
                cylinder={"axis": "z", "point": [38.0, 2.05], "radius": 1.0},
                motion=["-t", "-0.6*t"],
                friction=0.2,
            )
        ],
    )
    for state in Statics(problem).steps():
        assert not state.audit.reasons
    # 3 E I/L^3 times the deflection; the moment of friction about the axis, and the edge, add 7 %.
    assert -state.reactions["edge"][1] == pytest.approx(1e9 / 4 / 37**3 * 0.55, rel=0.1)


@pytest.mark.long
@pytest.mark.parametrize("dim", [2, 3])
def test_rubber_on_a_floor_stays_flat_under_pressure(dim):
    """A block that cannot widen, under a pressure of six times its shear modulus.

    Of pressures above two moduli free bulges make the uniform state unstable, see `bulges`.
    """
    cells = (4, 2) if dim == 2 else (2, 2, 1)
    body = box_body(size=[n / 2 for n in cells], cells=cells)
    sides = [Support(on=side, displacement=[0, *[FREE] * (dim - 1)]) for side in ("left", "right")]
    ends = [Support(on=side, displacement=[FREE, 0, FREE]) for side in ("front", "back")]
    mu = 1e6
    problem = Problem(
        body,
        NeoHookean(E=2.98 * mu, nu=0.49),
        degree=2,
        formulation="mixed",
        supports=sides if dim == 2 else [*sides, *ends],
        loads=[Pressure(on="top", value=6 * mu)],
        contacts=[Contact(on="bottom", plane={"axis": "xyz"[dim - 1], "at": 0}, name="floor")],
    )
    last(problem, steps=2)
    # Uniform, so that no bulge is left: to Newton's tolerance.
    across = problem.u.x.array.reshape(-1, dim)[:, :-1]
    assert np.abs(across).max(initial=0.0) < 1e-9
