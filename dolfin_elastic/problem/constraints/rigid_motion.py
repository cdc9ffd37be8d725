"""Rigid motions of surfaces, with some of their degrees of freedom unknown."""

from __future__ import annotations

import numpy as np

from dolfin_elastic.core.shapes.directions import check_components
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.mesh.body import Body, centre_of
from dolfin_elastic.model.amplitude import CONSTANT, Amplitude
from dolfin_elastic.model.supports.rigid_surface import Rigid

SMALL = 1e-4
"""Angle [rad] below which series stand for quotients."""


class RigidMotion:
    """The motion of a rigid surface: u = d + (R(theta) - I)(X - c). Collective to make.

    Degrees of freedom are d and theta, in a plane d and the angle about z.

    Attributes:
        support: What is prescribed.
        label: What results call it.
        centre: The reference point c [m], of shape (3,).
        free: Numbers of the free degrees of freedom.
        values: Their values, which a solver changes [m, rad].
        names: Of all degrees of freedom: ux, uy, ... rz.
    """

    needs_flat = False

    def __init__(self, support: Rigid, body: Body) -> None:
        self.support, self.label, self._dim = support, support.label, body.dim
        self._motion, self._action = support.motion(body.dim), support.action(body.dim)
        self.free = tuple(i for i, value in enumerate(self._motion) if value is None)
        self.values = np.zeros(len(self.free))
        self.names = [f"u{x}" for x in "xyz"[: body.dim]]
        self.names += ["rx", "ry", "rz"] if body.dim == 3 else ["rz"]
        self.centre = np.zeros(3)
        check_components(support.point, body.dim, f"support '{support.label}'.point")
        self.centre[: body.dim] = support.point or centre_of(body, support.surfaces)

    def all_at(self, t: float, default: Amplitude) -> FloatArray:
        """All degrees of freedom at time t [m, rad].

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the user gave none.
        """
        result = np.array(self.support.at_time(self._motion, t, default))
        result[list(self.free)] = self.values
        return result

    def applied(self, t: float, default: Amplitude) -> FloatArray:
        """Forces and moments on the free degrees of freedom [N, N m].

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the user gave none.
        """
        return np.array(self.support.at_time(self._action, t, default))[list(self.free)]

    def at(self, which: int, x: FloatArray, t: float, default: Amplitude = CONSTANT) -> FloatArray:
        """A component of the displacement at reference places of shape (n, 3) [m].

        Args:
            x: Reference places, of shape (n, 3) [m].
            t: Time [s], or load parameter.
            default: Amplitude where the user gave none.
        """
        q = self.all_at(t, default)
        d, theta = self._apart(q)
        r = x - self.centre
        return np.asarray(d[which] + (r @ rotation_less_one(theta).T)[:, which])

    def directions(self, x: FloatArray, t: float, default: Amplitude) -> FloatArray:
        """du/dq of all degrees of freedom at reference places, of shape (n, dim, dofs).

        The rotation's variation is the spin T(theta) e_i: it moves a place by its cross product
        with R (X - c).  Source: A. Ibrahimbegovic, F. Frey, I. Kozar, Int. J. Numer. Meth. Engng
        38 (1995) 3653.

        Args:
            x: Reference places, of shape (n, 3) [m].
            t: Time [s], or load parameter.
            default: Amplitude where the user gave none.
        """
        _, theta = self._apart(self.all_at(t, default))
        arms = (x - self.centre) @ rotation(theta).T
        spins = np.cross(tangent(theta).T[None], arms[:, None])  # point, rotation, component
        result = np.zeros((len(x), self._dim, len(self.names)))
        result[:, range(self._dim), range(self._dim)] = 1.0
        about = slice(None) if self._dim == 3 else slice(2, 3)
        result[:, :, self._dim :] = spins[:, about, : self._dim].transpose(0, 2, 1)
        return result

    def place(self, t: float, default: Amplitude) -> FloatArray:
        """The reference point's present place [m], of shape (3,).

        Args:
            t: Time [s], or load parameter.
            default: Amplitude where the user gave none.
        """
        d, _ = self._apart(self.all_at(t, default))
        return np.asarray(self.centre + d)

    def _apart(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        d, theta = np.zeros(3), np.zeros(3)
        d[: self._dim] = q[: self._dim]
        theta[0 if self._dim == 3 else 2 :] = q[self._dim :]
        return d, theta


def cross_matrix(v: FloatArray) -> FloatArray:
    """K with K w = v x w."""
    return np.array([[0.0, -v[2], v[1]], [v[2], 0.0, -v[0]], [-v[1], v[0], 0.0]])


def rotation(theta: FloatArray) -> FloatArray:
    """Rotation matrix R of a rotation vector [rad], see `Rigid`."""
    return np.asarray(np.eye(3) + rotation_less_one(theta))


def rotation_less_one(theta: FloatArray) -> FloatArray:
    """R - I, which keeps the digits of a small rotation."""
    a = float(np.linalg.norm(theta))
    K = cross_matrix(theta)
    first = np.sinc(a / np.pi)
    second = 0.5 * np.sinc(a / (2 * np.pi)) ** 2  # (1 - cos a)/a^2
    return np.asarray(first * K + second * K @ K)


def tangent(theta: FloatArray) -> FloatArray:
    """T with spin = T dtheta: I + (1 - cos a)/a^2 K + (a - sin a)/a^3 K^2, see `directions`."""
    a = float(np.linalg.norm(theta))
    K = cross_matrix(theta)
    second = 0.5 * np.sinc(a / (2 * np.pi)) ** 2
    third = 1 / 6 - a * a / 120 if a < SMALL else (a - np.sin(a)) / a**3
    return np.asarray(np.eye(3) + second * K + third * K @ K)
