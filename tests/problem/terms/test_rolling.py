"""Balls and discs that roll down a slope without sliding: friction does no work on them."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import ufl
from dolfinx import fem
from mpi4py import MPI

from dolfin_elastic import Contact, Dynamics, Gravity, NeoHookean, Problem, read_body

G, SLOPE = 9.81, np.radians(20)


def round_body(path: Path, dim: int, h: float) -> None:
    """A disc or ball of radius 1 that stands on 0, coarse inside."""
    import gmsh

    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ, field = gmsh.model.occ, gmsh.model.mesh.field
    whole = occ.addSphere(0, 0, 1, 1) if dim == 3 else occ.addDisk(0, 1, 0, 1, 1)
    occ.synchronize()
    for key in ("ExtendFromBoundary", "FromPoints", "FromCurvature"):
        gmsh.option.setNumber(f"Mesh.MeshSize{key}", 0)
    field.add("MathEval", 1)
    off = "x^2+y^2+(z-1)^2" if dim == 3 else "x^2+(y-1)^2"
    field.setString(1, "F", f"{h} + ({0.6 - h})*(1 - Sqrt({off}))")
    field.setAsBackgroundMesh(1)
    gmsh.model.mesh.generate(dim)
    skin = [tag for _, tag in gmsh.model.getEntities(dim - 1)]
    gmsh.model.addPhysicalGroup(dim - 1, skin, name="skin")
    gmsh.model.addPhysicalGroup(dim, [whole], name="body")
    gmsh.write(str(path))
    gmsh.finalize()


@pytest.mark.long
@pytest.mark.parametrize(
    ("dim", "h", "E", "exact"), [(2, 0.06, 1e7, 2 / 3), (3, 0.15, 5e6, 5 / 7)], ids=["disc", "ball"]
)
def test_what_rolls_down_a_slope(
    dim: int, h: float, E: float, exact: float, folder: Path, comm: MPI.Comm
) -> None:
    """With 2/3 or 5/7 of g sin a: the moment of inertia over m R^2 is 1/2 or 2/5.

    0.2 % was found: it gives way by some thousandths of the radius and is a polyhedron.
    """
    if comm.rank == 0:
        round_body(folder / "round.msh", dim, h)
    comm.barrier()
    body, up = read_body(folder / "round.msh"), "xyz"[dim - 1]
    slowly = "*(1 - cos(5*pi*min(t, 0.2)))/2"
    along, down = f"{G * np.sin(SLOPE)}{slowly}", f"{-G * np.cos(SLOPE)}{slowly}"
    problem = Problem(
        body,
        NeoHookean(E=E, nu=0.3, density=1000),
        loads=[Gravity(value=[along, *[0] * (dim - 2), down])],
        contacts=[Contact(on="skin", plane={"axis": up, "at": 0}, friction=0.5, name="floor")],
        degree=1,
    )
    settings: dict[str, Any] = {"dt": 1e-2, "end": 0.6, "spectral_radius": 0.0}
    rows = [(s.t, s.momenta["linear"][0]) for s in Dynamics(problem, **settings).steps()]
    one = fem.form(problem.constant(1000.0) * ufl.Measure("dx", domain=body.mesh))
    mass = comm.allreduce(fem.assemble_scalar(one), op=MPI.SUM)
    t, momentum = np.array(rows).T
    late = t > 0.22
    acceleration = np.polyfit(t[late], momentum[late], 1)[0] / mass
    assert acceleration == pytest.approx(exact * G * np.sin(SLOPE), rel=0.01)
