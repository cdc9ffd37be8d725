from mpi4py import MPI
import dolfinx, numpy as np, ufl, time
from dolfinx import fem, mesh
from dolfinx.fem.petsc import LinearProblem
t=time.time()
n=int(__import__('sys').argv[1]) if len(__import__('sys').argv)>1 else 12
m=mesh.create_unit_cube(MPI.COMM_WORLD,n,n,n)
V=fem.functionspace(m,("P",1,(3,)))
u,v=ufl.TrialFunction(V),ufl.TestFunction(V)
m.topology.create_connectivity(2,3)
f=mesh.exterior_facet_indices(m.topology)
bc=fem.dirichletbc(np.zeros(3),fem.locate_dofs_topological(V,2,f),V)
p=LinearProblem(ufl.inner(ufl.grad(u),ufl.grad(v))*ufl.dx,ufl.inner(ufl.as_vector([1.,2,3]),v)*ufl.dx,[bc],petsc_options={"ksp_type":"cg","pc_type":"gamg","ksp_rtol":1e-10})
uh=p.solve()
print(MPI.COMM_WORLD.rank, MPI.COMM_WORLD.size, uh.x.petsc_vec.norm(), time.time()-t, flush=True)
