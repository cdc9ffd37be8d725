import numpy as np,h5py,sys,os
from mpi4py import MPI
from dolfinx import mesh,fem
out=sys.argv[1]
for deg,kind,nn in ((1,"Tetrahedron",4),(2,"Tetrahedron_10",10)):
    d=f"{out}/P{deg}"; os.makedirs(d+"/r_data",exist_ok=True)
    m=mesh.create_unit_cube(MPI.COMM_SELF,3,3,3)
    V=fem.functionspace(m,("P",deg))
    x=V.tabulate_dof_coordinates(); cells=V.dofmap.list
    if deg==2: cells=cells[:,[0,1,2,3,9,6,8,7,5,4]]
    fr=[]
    with h5py.File(d+"/r_data/mesh.h5","w") as f: f["points"]=x; f["cells"]=cells
    for i in range(3):
        t=.1*i
        with h5py.File(d+f"/r_data/{i:06d}.h5","w") as f:
            f["displacement"]=x*(1+t); f["von_mises"]=np.arange(len(cells))[:,None]*1e5*(1.+t); f["cauchy_stress"]=np.random.rand(len(x),9)
        it=lambda n,s,k,F,P:f'<DataItem Dimensions="{s[0]} {s[1]}" NumberType="{k}" Precision="{P}" Format="HDF">r_data/{F}:/{n}</DataItem>'
        a=''.join(f'<Attribute Name="{n}" AttributeType="{ty}" Center="{c}">{it(n,s,"Float",f"{i:06d}.h5",8)}</Attribute>' for n,ty,c,s in (("displacement","Vector","Node",(len(x),3)),("von_mises","Scalar","Cell",(len(cells),1)),("cauchy_stress","Tensor","Node",(len(x),9))))
        fr.append(f'<Grid Name="step {i}" GridType="Uniform"><Topology TopologyType="{kind}" NumberOfElements="{len(cells)}" NodesPerElement="{nn}">{it("cells",cells.shape,"Int","mesh.h5",4)}</Topology><Geometry GeometryType="XYZ">{it("points",x.shape,"Float","mesh.h5",8)}</Geometry><Time Value="{t!r}"/>{a}</Grid>')
    open(d+"/r.xdmf","w").write('<?xml version="1.0"?><Xdmf Version="3.0"><Domain><Grid Name="results" GridType="Collection" CollectionType="Temporal">'+''.join(fr)+'</Grid></Domain></Xdmf>')
