"""Contact: unilateral contact of surfaces with rigid obstacles or with one another.

With Coulomb friction or without.

The gap g of a point is its signed distance to the obstacle, positive outside, and n the obstacle's
outward normal there: see `Shape.gap`.  An obstacle's motion is a displacement as that of a support,
in metres, and it may turn; or a force drives it along a direction, and how far it moves is an
unknown.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, cached_property
from typing import Annotated, Any, ClassVar, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from dolfin_elastic.core.errors import InputError, UnitError, keyed
from dolfin_elastic.core.formula import Formula
from dolfin_elastic.core.shapes.directions import Direction, check_components, unit_vector
from dolfin_elastic.core.shapes.rigid_mesh import RigidMesh
from dolfin_elastic.core.shapes.shapes import (
    CylinderObstacle,
    Plane,
    PositiveLength,
    Shape,
    SphereObstacle,
)
from dolfin_elastic.core.shapes.sharp import BoxObstacle, ConeObstacle
from dolfin_elastic.core.shapes.turned import Turned
from dolfin_elastic.core.si_text import given
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import (
    ForceDensity,
    Mass,
    Velocity,
    finite_length,
    members_of,
)
from dolfin_elastic.model.amplitude import Amplitude, Curve
from dolfin_elastic.model.describe import ALONE, Setting, other_keys
from dolfin_elastic.model.turning import Turning
from dolfin_elastic.model.values import (
    Component,
    OnSurfaces,
    amplitude_of,
    at_time,
    component,
    components,
)

_OF_OBSTACLES = ("motion", "rotation", "force", "direction", "mass", "velocity")
_OF_BODIES = ("interference", "adjust")
_WORDS = ("resolve", "ignore")


def _of_file(value: object) -> object:
    return {"file": value} if isinstance(value, str) else value


def _word_or_length(value: float | str) -> float | str:
    if value in _WORDS:
        return value
    try:
        return finite_length(value)
    except (UnitError, ValueError):
        raise InputError(
            f"'{value}' is no interference",
            expected=f'"{_WORDS[0]}", "{_WORDS[1]}" or a length such as "0.02 mm"',
        ) from None


class Contact(OnSurfaces):
    """Surfaces of the body that cannot penetrate a rigid obstacle, or one another.

    A field that is a `Shape` is one that an obstacle may have: the row of that shape.

    Attributes:
        on: Name of a surface that may touch an obstacle, or several.
        between: In place of an obstacle two surfaces of the mesh that may touch, each a name or
            several.
        plane: A half space; exactly one of these shapes is given, or `between`.
        sphere: A ball, or the spherical cavity in which the body lies.
        cylinder: A cylinder, or the bore in which the body lies.
        box: A box with sharp edges, or the case in which the body lies.
        cone: A cone, or the funnel in which the body lies.
        mesh: What the triangles of a file enclose: a table, or the file alone.
        motion: Displacement of the obstacle [m]: numbers, texts with units, or formulas in t.
        rotation: Of the obstacle beside its motion, over time: a table.
        force: In place of a motion the force on the obstacle [N], positive along `direction`: a
            number, a text with a unit, or a formula in t.
        direction: Along which a force may move it: x, y, z, -x, ... or components.
        mass: Of an obstacle that moves along it in implicit motion [kg], under the force, if any.
        velocity: That such an obstacle begins with, along it [m/s].
        curve: Amplitude of motion and rotation, force or interference over time, as that of a load.
        friction: Coulomb's coefficient: tangential over normal force where they slide; 0: none.
        gap_tolerance: Penetration that statics leaves; 1e-3 of the cells' size there, and no more
            than 1e-2 of how far the pressure squeezes a cell.
        stiffness: Pressure per depth [Pa/m]; about 10 (K + 4 mu/3)/h of the cells there.
        interference: What becomes of an overlap of `between` at the start: "resolve", it acts with
            the amplitude; "ignore", it counts as no gap; or a length that acts in its place.
        adjust: Gaps and overlaps of `between` at the start up to this one count as none.

    Example:
        Contact(on="bottom", plane={"point": [0, 0, 0], "normal": [0, 0, 1]})
    """

    lengths: ClassVar[tuple[str, ...]] = ("gap_tolerance", *_OF_BODIES)
    key_hints: ClassVar[Mapping[str, str]] = {
        **dict.fromkeys(
            ("intersection_free", "method"),
            'surfaces that never pass through each other: self = ["a", "b"] in place of `between`',
        ),
        **dict.fromkeys(
            ("distance", "slow"),
            "it belongs to contact of a surface with itself: `self` in place of `on`, "
            "or all = true",
        ),
    }

    on: str | list[str] = ""
    between: list[str | list[str]] | None = None
    plane: Plane | None = None
    sphere: SphereObstacle | None = None
    cylinder: CylinderObstacle | None = None
    box: BoxObstacle | None = None
    cone: ConeObstacle | None = None
    mesh: Annotated[RigidMesh | None, BeforeValidator(_of_file)] = None
    motion: list[Any] = Field(default=[])
    rotation: Turning | None = None
    force: Any = None
    direction: Direction | None = None
    mass: Mass | None = Field(default=None, gt=0)
    velocity: Velocity = Field(default=0.0)
    curve: Curve | None = None
    friction: float = Field(default=0.0, ge=0, allow_inf_nan=False)
    gap_tolerance: PositiveLength | None = None
    stiffness: ForceDensity | None = Field(default=None, gt=0)
    interference: Annotated[float | str, AfterValidator(_word_or_length)] = "resolve"
    adjust: PositiveLength | None = None

    def given_lengths(self) -> dict[str, object]:
        """See `Record`: an interference may be a word."""
        every = super().given_lengths()
        return {key: value for key, value in every.items() if value not in _WORDS}

    def _check_sides(self) -> None:
        """Raises where `between` is no two surfaces, or something of an obstacle is given, too."""
        other = next(
            (key for key in ("on", *obstacle_shapes(), *_OF_OBSTACLES) if getattr(self, key)), None
        )
        if other is not None:
            raise InputError(
                "contact between two surfaces of the mesh has no obstacle",
                where=other,
                expected="`between`, or `on` and an obstacle",
            )
        if len(self.sides) != 2 or not all(name for side in self.sides for name in side):
            raise InputError(
                f"{len(self.sides)} surfaces are given",
                where="between",
                expected='two that may touch each other, for example ["jaw", "bone"]',
            )
        if both := set(self.sides[0]) & set(self.sides[1]):
            raise InputError(
                f"'{min(both)}' is in contact with itself",
                where="between",
                expected="two different surfaces",
            )

    @model_validator(mode="after")
    def _somewhere(self) -> Self:
        if not any(self.surfaces):
            raise InputError(
                "no name is given",
                where="on",
                expected="`on` with an obstacle, `between`, `self` or `all`",
            )
        return self

    @model_validator(mode="after")
    def _one_shape(self) -> Contact:
        if self.between is not None:
            self._check_sides()
        elif other := self.model_fields_set.intersection(_OF_BODIES):
            raise InputError(
                "an obstacle begins where it is drawn",
                where=min(other),
                expected="contact `between` two surfaces; a `motion` of the obstacle",
            )
        known = obstacle_shapes()
        given = [key for key in known if getattr(self, key) is not None]
        if len(given) != (self.between is None):
            what = f"{' and '.join(given)} are given" if given else "the obstacle has no shape"
            raise InputError(what, expected=f"exactly one of {', '.join(known)}, or `between`")
        self._check_force()
        for index, value in enumerate(self.values):
            if isinstance(value, Formula) and value.names - {"t"}:
                raise InputError(
                    "the obstacle is rigid: its motion depends on t only",
                    where=f"motion[{index}]",
                    expected='for example "0.01*sin(pi*t)"',
                )
        return self

    def _check_force(self) -> None:
        """Raises where force, direction and motion do not fit together."""
        if self.velocity and self.mass is None:
            raise InputError(
                "an obstacle without a mass has no velocity of its own",
                where="velocity",
                expected="a mass beside it, or a motion in its place",
            )
        if (self.force is None and self.mass is None) != (self.direction is None):
            missing = "direction" if self.direction is None else "force"
            raise InputError(
                "an obstacle that a force moves needs the force and its direction",
                where=missing,
                expected='for example force = "200 N", direction = [0, 0, -1]',
            )
        if self.push is None:
            return
        if self.friction > 0:
            raise InputError(
                "an obstacle that a force moves has no friction",
                where="friction",
                expected="0, or a motion in place of the force",
            )
        if self.motion or self.rotation is not None:
            key = "motion" if self.motion else "rotation"
            raise InputError(
                f"{key} and force are given together",
                where="force",
                expected="one of them: an obstacle that a force moves does so along `direction`",
            )
        if isinstance(self.push, Formula) and self.push.names - {"t"}:
            raise InputError(
                "the obstacle is rigid: its force depends on t only",
                where="force",
                expected='for example "200*t"',
            )

    def overlap_at(self, t: float, default: Amplitude) -> tuple[float, float]:
        """Share of the overlap of the mesh that acts at time t, and what is added to it [m].

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the contact has no curve.
        """
        share = default.of(self.curve, t)
        if isinstance(self.interference, str):
            return (min(max(share, 0.0), 1.0) if self.interference == "resolve" else 0.0), 0.0
        return 0.0, share * self.interference

    @property
    def key_of_names(self) -> str:
        """The key that names its surfaces."""
        return "on" if self.between is None else "between"

    @property
    def sides(self) -> tuple[tuple[str, ...], ...]:
        """Names of the surfaces of both sides of `between`; () with an obstacle."""
        sides = self.between or ()
        return tuple((side,) if isinstance(side, str) else tuple(side) for side in sides)

    @property
    def surfaces(self) -> tuple[str, ...]:
        """See `OnSurfaces`; of both sides."""
        return super().surfaces if self.between is None else tuple(sum(self.sides, ()))

    @cached_property
    def push(self) -> float | Formula | None:
        """The force that moves the obstacle along `direction` [N]; None: nothing does."""
        if self.force is None:
            return None if self.mass is None else 0.0
        with keyed("force"):
            return component(self.force, "N")

    def force_at(self, t: float, default: Amplitude) -> float:
        """That force at time t [N].

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the contact has no curve.
        """
        return default.of(amplitude_of(self.push, self.curve), t) * at_time(self.push, t)

    def way(self, dim: int) -> FloatArray:
        """Unit vector along which a force moves the obstacle, shape (dim,)."""
        assert self.direction is not None
        return np.array(unit_vector(self.direction)[:dim])

    @cached_property
    def values(self) -> tuple[float | Formula, ...]:
        """Components of the obstacle's displacement; empty: it is at rest."""
        return components(self.motion, "m", key="motion") if self.motion else ()  # type: ignore[return-value]

    @property
    def moves(self) -> tuple[Component, ...]:
        """Components of its displacement [m] and its angle [rad], as far as they are given."""
        return self.values if self.rotation is None else (*self.values, self.rotation.value)

    @property
    def centre(self) -> tuple[float, ...] | None:
        """The point about which the obstacle, in metres, turns; None: it does not."""
        return None if self.rotation is None else self.rotation.point

    @property
    def shape(self) -> str:
        """Which of `obstacle_shapes` is given, or "between"."""
        shapes = (key for key in obstacle_shapes() if getattr(self, key) is not None)
        return next(shapes, "between")

    @property
    def obstacle(self) -> Shape:
        """The rigid obstacle, of any shape."""
        shape: Shape = getattr(self, self.shape)
        return shape

    def describe(self, setting: Setting = ALONE) -> str:
        """What its surfaces may touch."""
        if self.between is not None:
            return f"may touch each other{other_keys(self, 'between')}"
        shape = self.obstacle
        keys = shape.model_dump(exclude_unset=True, exclude_none=True)
        told = (f"{k} {given(v, 'm' if k in shape.lengths else '')}" for k, v in keys.items())
        return f"may touch a rigid {self.shape} ({', '.join(told)}){other_keys(self, self.shape)}"

    def in_metres(self, scale: float) -> Self:
        """See `Record`: the obstacle, too.

        Args:
            scale: Metres per unit of length of the mesh.
        """
        parts: dict[str, object] = {}
        if self.between is None:
            parts[self.shape] = self.obstacle.in_metres(scale)
        if self.rotation is not None:
            parts["rotation"] = self.rotation.in_metres(scale)
        return super().in_metres(scale).converted(parts)

    def displacement_at(self, t: float, default: Amplitude, dim: int) -> list[float]:
        """Displacement of the obstacle at time t [m], `dim` components.

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the contact has no curve.
        """
        if not self.values:
            return [0.0] * dim
        return [default.of(amplitude_of(v, self.curve), t) * at_time(v, t) for v in self.values]

    def angle_at(self, t: float, default: Amplitude) -> float:
        """By which the obstacle has turned at time t [rad], see `displacement_at`."""
        if self.rotation is None:
            return 0.0
        angle = self.rotation.value
        return float(default.of(amplitude_of(angle, self.curve), t) * at_time(angle, t))

    def pose_at(self, t: float, default: Amplitude, dim: int) -> FloatArray:
        """See `Pose.now`, at time t; for the arguments see `displacement_at`."""
        turn = np.eye(dim)
        if self.rotation is not None:
            turn = self.rotation.matrix(self.angle_at(t, default), dim)
        return np.column_stack([self.displacement_at(t, default, dim), turn])

    def turned(self, shape: Shape, pose: FloatArray) -> Shape:
        """Its obstacle as it has turned.

        Args:
            shape: The obstacle [m], its file read.
            pose: Of `pose_at`.
        """
        if self.rotation is None:
            return shape
        return Turned.of(shape, pose[:, 1:], self.rotation.point)

    def check(self, dim: int, *, axisymmetric: bool) -> None:
        """Raises where the obstacle, in metres, or its motion does not fit the body.

        Raises:
            InputError: With the key inside the contact's table.
        """
        if self.between is not None:
            return
        with keyed(self.shape):
            self.obstacle.check(dim, axisymmetric=axisymmetric)
        if self.values:
            check_components([0.0] * len(self.values), dim, "motion")
        if self.rotation is not None:
            with keyed("rotation"):
                self.rotation.check(dim, axisymmetric=axisymmetric)
        if axisymmetric and self.values and self.values[0] != 0.0:
            raise InputError(
                "an obstacle about the axis moves along it only",
                where="motion[0]",
                expected="0",
            )
        check_components(self.direction, dim, "direction")
        if axisymmetric and self.direction is not None and self.way(dim)[0] != 0.0:
            raise InputError(
                "an obstacle about the axis moves along it only",
                where="direction[0]",
                expected="0",
            )


@cache
def obstacle_shapes() -> dict[str, type[Shape]]:
    """Key of each shape that an obstacle may have, to the shape."""
    return {
        key: kind
        for key, field in Contact.model_fields.items()
        for kind in members_of(field.annotation)
        if isinstance(kind, type) and issubclass(kind, Shape)
    }
