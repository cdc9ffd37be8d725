"""What one Newton solve went through, and when it counts as done."""

from __future__ import annotations

from dataclasses import dataclass, field

UNSTABLE = "an unstable equilibrium"
BEYOND = "the strain energy has no finite value: a material is beyond its limit"
ANOTHER = "another equilibrium than that of the path"


@dataclass
class Progress:
    """What one Newton solve went through.

    Attributes:
        residuals: Norm of the free residual at each iterate [N].
        reference: Force the residual is measured against [N].
        newton: Iterations.
        krylov: Linear iterations.
        reason: PETSc's name of why it ended.
        converged: Whether equilibrium was found.
        rejected: Trial states refused because a cell was inside out.
        worst: Smallest det F of them, and the reference place of its cell [m].
        target: Norm of the free residual that would have been small enough [N].
        predicted: Norm of the first Newton step [m].
        floor: Norm of the free residual that round-off alone may leave [N].
    """

    residuals: list[float] = field(default_factory=list)
    reference: float = 0.0
    newton: int = 0
    krylov: int = 0
    reason: str = ""
    converged: bool = False
    rejected: int = 0
    worst: tuple[float, tuple[float, ...]] | None = None
    target: float = 0.0
    predicted: float = 0.0
    floor: float = 0.0


@dataclass(frozen=True)
class Tolerance:
    """When equilibrium counts as found.

    Attributes:
        rtol: Free residual over the larger of applied forces and reactions.
        atol: Free residual [N].
        max_iterations: Newton iterations after which a step is given up.
    """

    rtol: float = 1e-8
    atol: float = 0.0
    max_iterations: int = 30
