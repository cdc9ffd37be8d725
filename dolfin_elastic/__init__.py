"""dolfin_elastic: an MPI-parallel solver for deformable elastic bodies on DOLFINx and PETSc.

The parts, in the order of the work; each is imported when it is first used::

    from dolfin_elastic import NeoHookean, Problem, Statics, Support, Traction, box_body

    body = box_body(size=[1, 0.1, 0.1], cells=[20, 2, 2])
    problem = Problem(body, NeoHookean(E=1e6, nu=0.45),
                      supports=[Support(on="left")],
                      loads=[Traction(on="right", value=[0, 0, -100])])
    for state in Statics(problem, steps=5).steps():
        print(state.load_factor, state.max_displacement)
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from dolfin_elastic.core import __version__ as __version__

if TYPE_CHECKING:
    from dolfin_elastic.case.case import Case as Case
    from dolfin_elastic.case.case import read_case as read_case
    from dolfin_elastic.case.run import restart as restart
    from dolfin_elastic.case.run import run as run
    from dolfin_elastic.core.shapes.turn import Turn as Turn
    from dolfin_elastic.mesh import Body as Body
    from dolfin_elastic.mesh import EdgeSelector as EdgeSelector
    from dolfin_elastic.mesh import Placed as Placed
    from dolfin_elastic.mesh import PointSelector as PointSelector
    from dolfin_elastic.mesh import Selector as Selector
    from dolfin_elastic.mesh import box_body as box_body
    from dolfin_elastic.mesh import mesh_body as mesh_body
    from dolfin_elastic.mesh import name_parts as name_parts
    from dolfin_elastic.mesh import parts_body as parts_body
    from dolfin_elastic.mesh import read_body as read_body
    from dolfin_elastic.mesh import rectangle_body as rectangle_body
    from dolfin_elastic.model.axes import CylindricalAxes as CylindricalAxes
    from dolfin_elastic.model.axes import RectangularAxes as RectangularAxes
    from dolfin_elastic.model.contact import Contact as Contact
    from dolfin_elastic.model.loads import BaseAcceleration as BaseAcceleration
    from dolfin_elastic.model.loads import Bearing as Bearing
    from dolfin_elastic.model.loads import BodyForce as BodyForce
    from dolfin_elastic.model.loads import Bolt as Bolt
    from dolfin_elastic.model.loads import Cavity as Cavity
    from dolfin_elastic.model.loads import Centrifugal as Centrifugal
    from dolfin_elastic.model.loads import Force as Force
    from dolfin_elastic.model.loads import Gravity as Gravity
    from dolfin_elastic.model.loads import Growth as Growth
    from dolfin_elastic.model.loads import LineForce as LineForce
    from dolfin_elastic.model.loads import PointForce as PointForce
    from dolfin_elastic.model.loads import Pressure as Pressure
    from dolfin_elastic.model.loads import RemoteForce as RemoteForce
    from dolfin_elastic.model.loads import Thermal as Thermal
    from dolfin_elastic.model.loads import Traction as Traction
    from dolfin_elastic.model.loads.own import OwnLoad as OwnLoad
    from dolfin_elastic.model.materials.laws.arruda_boyce import ArrudaBoyce as ArrudaBoyce
    from dolfin_elastic.model.materials.laws.blatz_ko import BlatzKo as BlatzKo
    from dolfin_elastic.model.materials.laws.corotated import Corotated as Corotated
    from dolfin_elastic.model.materials.laws.fixed_corotated import FixedCorotated as FixedCorotated
    from dolfin_elastic.model.materials.laws.gent import Gent as Gent
    from dolfin_elastic.model.materials.laws.guccione import Guccione as Guccione
    from dolfin_elastic.model.materials.laws.hencky import Hencky as Hencky
    from dolfin_elastic.model.materials.laws.holzapfel_gasser_ogden import (
        HolzapfelGasserOgden as HolzapfelGasserOgden,
    )
    from dolfin_elastic.model.materials.laws.j2 import J2 as J2
    from dolfin_elastic.model.materials.laws.j2_logarithmic import J2Logarithmic as J2Logarithmic
    from dolfin_elastic.model.materials.laws.linear_elastic import LinearElastic as LinearElastic
    from dolfin_elastic.model.materials.laws.mooney_rivlin import MooneyRivlin as MooneyRivlin
    from dolfin_elastic.model.materials.laws.neo_hookean import NeoHookean as NeoHookean
    from dolfin_elastic.model.materials.laws.neo_hookean_split import (
        NeoHookeanSplit as NeoHookeanSplit,
    )
    from dolfin_elastic.model.materials.laws.ogden import Ogden as Ogden
    from dolfin_elastic.model.materials.laws.orthotropic import Orthotropic as Orthotropic
    from dolfin_elastic.model.materials.laws.st_venant_kirchhoff import (
        StVenantKirchhoff as StVenantKirchhoff,
    )
    from dolfin_elastic.model.materials.laws.textbook import Textbook as Textbook
    from dolfin_elastic.model.materials.laws.yeoh import Yeoh as Yeoh
    from dolfin_elastic.model.materials.user import Energy as Energy
    from dolfin_elastic.model.materials.user import SplitEnergy as SplitEnergy
    from dolfin_elastic.model.periodic import Periodic as Periodic
    from dolfin_elastic.model.point.report import material_report as material_report
    from dolfin_elastic.model.point_mass import PointMass as PointMass
    from dolfin_elastic.model.self_contact import SelfContact as SelfContact
    from dolfin_elastic.model.supports.displacement import Fixed as Fixed
    from dolfin_elastic.model.supports.displacement import Normal as Normal
    from dolfin_elastic.model.supports.displacement import Rotation as Rotation
    from dolfin_elastic.model.supports.displacement import Support as Support
    from dolfin_elastic.model.supports.displacement import Symmetry as Symmetry
    from dolfin_elastic.model.supports.rigid_surface import Rigid as Rigid
    from dolfin_elastic.model.supports.springs import Dashpot as Dashpot
    from dolfin_elastic.model.supports.springs import Spring as Spring
    from dolfin_elastic.model.tie import Tie as Tie
    from dolfin_elastic.notebook.report_view import show_report as show_report
    from dolfin_elastic.problem.problem import Problem as Problem
    from dolfin_elastic.results.derived.sections import Section as Section
    from dolfin_elastic.results.derived.sections import SectionForces as SectionForces
    from dolfin_elastic.results.finished.run import FinishedRun as FinishedRun
    from dolfin_elastic.results.outputs import History as History
    from dolfin_elastic.results.outputs import Modes as Modes
    from dolfin_elastic.results.outputs import Picture as Picture
    from dolfin_elastic.results.outputs import Summary as Summary
    from dolfin_elastic.results.outputs import Xdmf as Xdmf
    from dolfin_elastic.results.probes import Probe as Probe
    from dolfin_elastic.solvers.assembly.equations import Equations as Equations
    from dolfin_elastic.solvers.dynamics.dynamics import Dynamics as Dynamics
    from dolfin_elastic.solvers.eigen.buckling import Buckling as Buckling
    from dolfin_elastic.solvers.eigen.modal import Modal as Modal
    from dolfin_elastic.solvers.statics.statics import Statics as Statics
    from dolfin_elastic.study.fit.fit import fit as fit
    from dolfin_elastic.study.gradient.gradient import gradient as gradient
    from dolfin_elastic.study.identify.cells import identify_field as identify_field
    from dolfin_elastic.study.identify.identify import identify as identify
    from dolfin_elastic.study.sweep.sweep import sweep as sweep

_PLACES = {
    "case.case": ("Case", "read_case"),
    "case.run": ("restart", "run"),
    "core.shapes.turn": ("Turn",),
    "mesh": (
        "Body",
        "EdgeSelector",
        "Placed",
        "PointSelector",
        "Selector",
        "box_body",
        "mesh_body",
        "name_parts",
        "parts_body",
        "read_body",
        "rectangle_body",
    ),
    "model.materials.laws.arruda_boyce": ("ArrudaBoyce",),
    "model.materials.laws.blatz_ko": ("BlatzKo",),
    "model.materials.laws.corotated": ("Corotated",),
    "model.materials.laws.fixed_corotated": ("FixedCorotated",),
    "model.materials.laws.gent": ("Gent",),
    "model.materials.laws.guccione": ("Guccione",),
    "model.materials.laws.hencky": ("Hencky",),
    "model.materials.laws.j2": ("J2",),
    "model.materials.laws.j2_logarithmic": ("J2Logarithmic",),
    "model.materials.laws.holzapfel_gasser_ogden": ("HolzapfelGasserOgden",),
    "model.materials.laws.linear_elastic": ("LinearElastic",),
    "model.materials.laws.mooney_rivlin": ("MooneyRivlin",),
    "model.materials.laws.neo_hookean": ("NeoHookean",),
    "model.materials.laws.neo_hookean_split": ("NeoHookeanSplit",),
    "model.materials.laws.ogden": ("Ogden",),
    "model.materials.laws.orthotropic": ("Orthotropic",),
    "model.materials.laws.st_venant_kirchhoff": ("StVenantKirchhoff",),
    "model.materials.laws.textbook": ("Textbook",),
    "model.materials.laws.yeoh": ("Yeoh",),
    "model.materials.user": ("Energy", "SplitEnergy"),
    "model.axes": ("CylindricalAxes", "RectangularAxes"),
    "model.periodic": ("Periodic",),
    "model.point.report": ("material_report",),
    "model.point_mass": ("PointMass",),
    "model.tie": ("Tie",),
    "model.contact": ("Contact",),
    "model.self_contact": ("SelfContact",),
    "model.supports.displacement": ("Fixed", "Normal", "Rotation", "Support", "Symmetry"),
    "model.supports.rigid_surface": ("Rigid",),
    "model.supports.springs": ("Dashpot", "Spring"),
    "model.loads": (
        "BaseAcceleration",
        "Bearing",
        "BodyForce",
        "Bolt",
        "Cavity",
        "Centrifugal",
        "Force",
        "Gravity",
        "Growth",
        "LineForce",
        "PointForce",
        "Pressure",
        "RemoteForce",
        "Thermal",
        "Traction",
    ),
    "model.loads.own": ("OwnLoad",),
    "problem.problem": ("Problem",),
    "solvers.assembly.equations": ("Equations",),
    "solvers.statics.statics": ("Statics",),
    "solvers.dynamics.dynamics": ("Dynamics",),
    "study.sweep.sweep": ("sweep",),
    "study.gradient.gradient": ("gradient",),
    "solvers.eigen.modal": ("Modal",),
    "solvers.eigen.buckling": ("Buckling",),
    "study.fit.fit": ("fit",),
    "study.identify.cells": ("identify_field",),
    "study.identify.identify": ("identify",),
    "notebook.report_view": ("show_report",),
    "results.finished.run": ("FinishedRun",),
    "results.outputs": ("History", "Modes", "Picture", "Summary", "Xdmf"),
    "results.probes": ("Probe",),
    "results.derived.sections": ("Section", "SectionForces"),
}
_WHERE = {name: place for place, names in _PLACES.items() for name in names}
__all__ = sorted(_WHERE)  # noqa: PLE0605


def __dir__() -> list[str]:
    return __all__


def __getattr__(name: str) -> Any:
    if name not in _WHERE:
        raise AttributeError(f"module 'dolfin_elastic' has no attribute '{name}'")
    module = import_module(f"dolfin_elastic.{_WHERE[name]}")
    globals()[name] = getattr(module, name)
    return globals()[name]
