"""The case that `dolfin-elastic new` writes: it runs as it is; comments say what to change."""

TEMPLATE = """\
# A cantilever under its own weight and a load at its tip.
#
#   dolfin-elastic check {name}             what will be computed, and what is wrong
#   dolfin-elastic run {name}               compute it
#   mpirun -n 4 dolfin-elastic run {name}   the same on four cores
#
# Bare numbers in [mesh], [surfaces] and [regions] are in the mesh's unit, all others in SI units
# (m, kg, s, N, Pa).  Any number may have a unit of its own: "2 mm", "210 GPa", "5 kN/m^3".

title = "Cantilever"

[mesh]
box = {{size = [100, 10, 10], cells = [24, 3, 3]}}   # surfaces: left right front back bottom top
# file = "part.msh"         # or .xdmf .inp .vtu .med; or CAD: .step .geo with size = "2 mm"
unit = "mm"
# degree = 1               # linear elements: faster and, in bending, far too stiff

# [surfaces]               # names for places that the mesh does not name
# foot = {{plane = "z", at = "min"}}
# bore = {{cylinder = {{axis = "z", point = [0, 0, 0], radius = 5}}}}

[materials.rubber]         # without `on` it fills everything; else on = "a region"
law = "neo-hookean"        # linear-elastic, st-venant-kirchhoff, neo-hookean
E = "1 MPa"                # any two of E, nu, K, lambda, mu
nu = 0.45
density = "1100 kg/m^3"    # needed for weight and for motion

[[support]]
on = "left"
displacement = [0, 0, 0]   # a number, "2 mm", a formula such as "0.1*x*t", or "free"

[[load]]
kind = "gravity"           # 9.81 m/s^2 against z if no value is given

[[load]]
kind = "traction"          # force per reference area
on = "right"
value = [0, 0, "-0.2 kPa"] # components may be formulas in x, y, z [m] and t

[statics]                  # equilibrium; or [dynamics] with dt and end for motion in time
steps = 4                  # loads grow from nothing to all in so many steps

# [output]
# folder = "results"       # default: this file's name with "_results"
# fields = ["displacement", "von_mises"]
"""


def case_template(name: str) -> str:
    """The text of a first case file.

    Args:
        name: What the file will be called.
    """
    return TEMPLATE.format(name=name)
