"""What an expert would write for the block alone, in plain DOLFINx and PETSc.

    mpirun -n 2 python3 benchmarks/expert.py DEGREE N

The block: [0,2]x[0,1]x[0,1] m in (2N, N, N) cubes of six tetrahedra, held at x = 0, a dead traction
of (0, 0, -13 kPa) on x = 2, neo-Hookean with E = 1 MPa and nu = 0.3, one load step, residual down
by 1e-8.  Hand-written stress, full Newton steps, conjugate gradients with GAMG set up once.
Prints one line of JSON.
"""

from __future__ import annotations

import json
import resource
import sys
import time

BEGIN = time.time()

import numpy as np
import ufl
from dolfinx import fem, la, mesh
from dolfinx.fem import petsc as fem_petsc
from mpi4py import MPI
from petsc4py import PETSc

SOLVER = {
    "snes_type": "newtonls",
    "snes_linesearch_type": "basic",
    "snes_rtol": 1e-8,
    "snes_atol": 0,
    "snes_stol": 0,
    "snes_lag_preconditioner": 20,
    "snes_ksp_ew": True,
    "snes_ksp_ew_rtol0": 1e-3,
    "snes_ksp_ew_rtolmax": 1e-3,
    "ksp_type": "cg",
    "ksp_max_it": 500,
    "pc_type": "gamg",
    "pc_gamg_threshold": 0.01,
    "pc_gamg_coarse_eq_limit": 500,
    "mg_levels_ksp_type": "chebyshev",
    "mg_levels_ksp_max_it": 1,
    "mg_levels_pc_type": "pbjacobi",
}
FLAGS = ["-O3", "-march=native", "-ffast-math"]


def block(n: int) -> tuple[mesh.Mesh, np.ndarray, np.ndarray]:
    """The mesh and its facets at x = 0 and x = 2."""
    body = mesh.create_box(
        MPI.COMM_WORLD,
        [[0, 0, 0], [2, 1, 1]],
        [2 * n, n, n],
        mesh.CellType.tetrahedron,
        ghost_mode=mesh.GhostMode.none,
    )
    ends = [
        mesh.locate_entities_boundary(body, 2, lambda x, at=at: np.isclose(x[0], at))
        for at in (0.0, 2.0)
    ]
    return body, ends[0], ends[1]


def rigid_modes(V: fem.FunctionSpace) -> PETSc.NullSpace:
    """The six rigid-body modes."""
    size = V.dofmap.index_map.size_local
    x = V.tabulate_dof_coordinates()[:size]
    vectors = [la.vector(V.dofmap.index_map, bs=3) for _ in range(6)]
    for k, vector in enumerate(vectors):
        rows = vector.array[: 3 * size].reshape(-1, 3)
        if k < 3:
            rows[:, k] = 1
        else:
            i, j = [(0, 1), (1, 2), (2, 0)][k - 3]
            rows[:, i], rows[:, j] = -x[:, j], x[:, i]
    la.orthonormalize(vectors)
    return PETSc.NullSpace().create(
        comm=V.mesh.comm,
        vectors=[
            PETSc.Vec().createWithArray(v.array[: 3 * size], bsize=3, comm=V.mesh.comm)
            for v in vectors
        ],
    )


def main(degree: int, n: int) -> None:
    body, left, right = block(n)
    V = fem.functionspace(body, ("Lagrange", degree, (3,)))
    u, v, du = fem.Function(V), ufl.TestFunction(V), ufl.TrialFunction(V)
    F = ufl.Identity(3) + ufl.grad(u)
    mu, lmbda = (fem.Constant(body, value) for value in (1e6 / 2.6, 1e6 * 0.3 / (1.3 * 0.4)))
    traction = fem.Constant(body, np.array([0, 0, -1.3e4]))
    P = mu * (F - ufl.inv(F).T) + lmbda * ufl.ln(ufl.det(F)) * ufl.inv(F).T
    dx = ufl.Measure("dx", domain=body, metadata={"quadrature_degree": 2 * degree - 1})
    tags = mesh.meshtags(body, 2, np.sort(right), np.full(len(right), 1, dtype=np.int32))
    ds = ufl.Measure("ds", domain=body, subdomain_data=tags)
    residual = ufl.inner(P, ufl.grad(v)) * dx - ufl.inner(traction, v) * ds(1)
    jit = {"cffi_extra_compile_args": FLAGS, "timeout": 600}
    f_form = fem.form(residual, jit_options=jit)
    j_form = fem.form(ufl.derivative(residual, u, du), jit_options=jit)
    bc = fem.dirichletbc(np.zeros(3), fem.locate_dofs_topological(V, 2, left), V)
    A, b = fem_petsc.create_matrix(j_form), fem_petsc.create_vector(f_form)
    A.setNearNullSpace(rigid_modes(V))

    def function(snes: PETSc.SNES, x: PETSc.Vec, f: PETSc.Vec) -> None:
        x.copy(u.x.petsc_vec)
        u.x.scatter_forward()
        with f.localForm() as local:
            local.set(0)
        fem_petsc.assemble_vector(f, f_form)
        f.ghostUpdate(addv=PETSc.InsertMode.ADD, mode=PETSc.ScatterMode.REVERSE)
        fem_petsc.set_bc(f, [bc], x, -1.0)

    def jacobian(snes: PETSc.SNES, x: PETSc.Vec, J: PETSc.Mat, Pm: PETSc.Mat) -> None:
        Pm.zeroEntries()
        fem_petsc.assemble_matrix(Pm, j_form, [bc])
        Pm.assemble()

    for name, value in SOLVER.items():
        PETSc.Options()[name] = value
    snes = PETSc.SNES().create(body.comm)
    snes.setFunction(function, b)
    snes.setJacobian(jacobian, A)
    snes.setFromOptions()
    x = A.createVecRight()
    begin = time.time()
    snes.solve(None, x)
    seconds = time.time() - begin
    x.copy(u.x.petsc_vec)
    u.x.scatter_forward()
    tip = body.comm.allreduce(fem.assemble_scalar(fem.form(u[2] * ds(1))))
    usage = resource.getrusage(resource.RUSAGE_SELF)
    memory = body.comm.allreduce(1024 * usage.ru_maxrss)
    nonzeros = A.getInfo(PETSc.Mat.InfoType.GLOBAL_SUM)["nz_used"]  # collective
    if body.comm.rank == 0:
        print(
            json.dumps(
                {
                    "dofs": 3 * V.dofmap.index_map.size_global,
                    "uz": tip,
                    "newton": snes.getIterationNumber(),
                    "krylov": snes.getLinearSolveIterations(),
                    "reason": snes.getConvergedReason(),
                    "nonzeros": nonzeros,
                    "solve": seconds,
                    "memory": memory,
                    "seconds": time.time() - BEGIN,
                }
            )
        )


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
