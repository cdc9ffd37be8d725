"""Loads: one external virtual-work term each, and their table."""

from __future__ import annotations

from dolfin_elastic.model.loads.base import Load as Load
from dolfin_elastic.model.loads.base import LoadContext as LoadContext
from dolfin_elastic.model.loads.base import LoadPoints as LoadPoints
from dolfin_elastic.model.loads.base import ScalarLoad as ScalarLoad
from dolfin_elastic.model.loads.bearing import Bearing as Bearing
from dolfin_elastic.model.loads.bolt import Bolt as Bolt
from dolfin_elastic.model.loads.cavity import Cavity as Cavity
from dolfin_elastic.model.loads.eigenstrain import Eigenstrain as Eigenstrain
from dolfin_elastic.model.loads.eigenstrain import Growth as Growth
from dolfin_elastic.model.loads.eigenstrain import Thermal as Thermal
from dolfin_elastic.model.loads.forces import BaseAcceleration as BaseAcceleration
from dolfin_elastic.model.loads.forces import BodyForce as BodyForce
from dolfin_elastic.model.loads.forces import Centrifugal as Centrifugal
from dolfin_elastic.model.loads.forces import Force as Force
from dolfin_elastic.model.loads.forces import Gravity as Gravity
from dolfin_elastic.model.loads.forces import Traction as Traction
from dolfin_elastic.model.loads.point_loads import ConcentratedLoad as ConcentratedLoad
from dolfin_elastic.model.loads.point_loads import LineForce as LineForce
from dolfin_elastic.model.loads.point_loads import PointForce as PointForce
from dolfin_elastic.model.loads.pressure import Pressure as Pressure
from dolfin_elastic.model.loads.remote import RemoteForce as RemoteForce

LOADS: dict[str, type[Load]] = {
    str(kind.model_fields["kind"].default): kind
    for kind in (
        Traction,
        Force,
        Pressure,
        Bearing,
        RemoteForce,
        Cavity,
        BodyForce,
        Gravity,
        BaseAcceleration,
        Centrifugal,
        PointForce,
        LineForce,
        Bolt,
        Thermal,
        Growth,
    )
}
_MOMENT = Load.key_hints["moment"]
LOAD_WORDS = {
    "moment": _MOMENT,
    "torque": _MOMENT,
    "displacement": "a prescribed displacement is a [[support]]",
}
"""Words that are no kind of load, and what to write for them."""
