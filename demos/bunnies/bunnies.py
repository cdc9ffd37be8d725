"""Two bunnies of jelly fall on the floor, and one on the other.

Problem
    Two bunnies, 49 mm high, one above the other and facing the other way, come down with 0.8 m/s
    on a smooth floor.  The upper one presses the ears of the lower one down and slides off.

Equations
    Neo-Hookean with E = 30 kPa, nu = 0.4 and the weight; no part of the surface passes through
    another one: incremental potential contact, by the package ipctk, with Coulomb's friction of
    0.3.  The floor is a rigid plane.

Discretisation
    Linear tetrahedra of Gmsh, 3,000 unknowns; implicit Euler, one step for each of 60 pictures a
    second.

Result
    No state has an intersection, by ipctk's own test, and no step has to be repeated with a smaller
    one.  Implicit Euler and friction take energy out: no step adds any to the sum of strain,
    kinetic, contact and potential energy.

        python3 demos/bunnies/bunnies.py
        mpirun -n 2 python3 demos/bunnies/bunnies.py
"""

from __future__ import annotations

from pathlib import Path

import ipctk
import numpy as np
from dolfinx.mesh import entities_to_geometry, exterior_facet_indices
from mpi4py import MPI

from dolfin_elastic import read_case, run

HERE = Path(__file__).parent
GAIN = 1e-6
"""Of energy in a step, over what is lost in all: what Newton's method leaves out of balance."""


def intersects(u):
    """Whether any two faces of the deformed surface intersect."""
    V, mesh = u.function_space, u.function_space.mesh
    mesh.topology.create_connectivity(2, 3)
    faces = entities_to_geometry(mesh, 2, exterior_facet_indices(mesh.topology))
    nodes = np.empty(len(mesh.geometry.x), dtype=np.int32)
    nodes[mesh.geometry.dofmap] = V.dofmap.list  # linear elements: the same corners
    own = V.dofmap.index_map.size_local
    places = (V.tabulate_dof_coordinates() + u.x.array.reshape(-1, 3))[:own]
    corners = V.dofmap.index_map.local_to_global(nodes[faces].ravel())
    x, corners = (np.concatenate(mesh.comm.allgather(part)) for part in (places, corners))
    faces = np.asfortranarray(corners.reshape(-1, 3).astype(np.int32))
    x = np.asfortranarray(x)
    return ipctk.has_intersections(ipctk.CollisionMesh(x, ipctk.edges(faces), faces), x)


def main():
    energies, nearest, iterations, times = [], [], [], []
    for state in run(read_case(HERE / "case.toml")):
        energies.append(state.energies["total"] + state.energies["potential"])
        nearest.append(state.numbers["smallest_distance_bunnies"])
        iterations.append(state.newton)
        times.append(state.t)
        assert not intersects(state.u)
    gain = np.diff(energies).max() / np.ptp(energies)
    if MPI.COMM_WORLD.rank == 0:
        print(f"{len(times) - 1} steps, {np.mean(iterations[1:]):.1f} iterations a step")
        print(f"smallest distance {1e6 * min(nearest):.0f} um of {1e6 * nearest[0]:.0f} um")
        print(
            f"largest gain of energy in a step: {gain:.1e} of all that is lost (allowed {GAIN:.0e})"
        )
    assert np.ptp(np.diff(times)) < 1e-9  # no step had to be cut
    assert min(nearest) < 0.9 * nearest[0]  # they touch
    assert gain < GAIN


if __name__ == "__main__":
    main()
