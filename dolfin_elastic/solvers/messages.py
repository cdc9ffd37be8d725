"""Texts of diagnoses and errors, and the advice that goes with them."""

from __future__ import annotations

import logging
from collections.abc import Sequence

from dolfin_elastic.core.errors import InputError
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.problem.terms.undefined import undefined_load

log = logging.getLogger("dolfin_elastic")

HOLD = (
    "a support on that piece; or, if it was meant to be joined to the rest, a mesh whose nodes "
    "the pieces share"
)
LIFTED = (
    "a support or a weak spring that holds it where it leaves its obstacles, a smaller load, or a "
    "prescribed displacement in place of the load"
)
SLIDES = (
    "more friction, a support or a prescribed displacement against the sliding, or [dynamics], in "
    "which the body slides"
)
RELEASE = (
    "a motion of the obstacle that ends before these nodes, a support that moves with it or leaves "
    "their normal direction free, or a contact without the surfaces that the support holds"
)
HUGE = (
    "a smaller load, or stiffer materials: was a unit of a load or of a modulus forgotten? "
    "dolfin-elastic check compares them"
)
DOMAIN = (
    "a smaller load or more load steps; the material cannot be strained further than its formula "
    "has values"
)
LOAD = "a formula of that load that has a finite value for every displacement and time"
SMALLER = "more load steps, a smaller load, or a finer mesh where the elements are crushed"
SMALL_STRAINS = (
    "a smaller load or displacement, or stiffer materials: was a unit of a load or of a modulus "
    "forgotten? Strains as large as these need a law such as 'neo-hookean'"
)
BUCKLING = (
    "a small imperfection that leads into the mode (a side load, a bent mesh), or statics.method = "
    '"arc-length" to follow the path, or [dynamics] to see where the body goes'
)
LIMIT_POINT = (
    'statics.method = "arc-length", which follows the path beyond, or a prescribed displacement in '
    "place of the load, or a smaller load"
)
MATERIAL = (
    "a law that stays elliptic at such strains (dolfin-elastic material says how far), or a "
    "smaller load; a finer mesh does not help"
)
STALLED = "more load steps or a smaller load; beyond a limit point no static equilibrium exists"
JUMP = "a curve or a formula of the support that takes some time from one position to the other"
WITHOUT_SLIVERS = (
    "mesh anew without such slivers (dolfin-elastic check lists the worst elements), or "
    "law = 'fixed-corotated', which goes on with inverted elements"
)
MIRRORED = (
    "the law is a function of C alone, which cannot tell an element from its mirror image: it does "
    "not resist being turned inside out, and an inverted element would stay so"
)
SEES_INVERSION = (
    "law = 'neo-hookean', which resists inversion, or law = 'fixed-corotated', which goes on with "
    "inverted elements and turns them back"
)
SMALLER_STEP = (
    "a smaller dt, or a scheme that damps more (a smaller spectral_radius, implicit-euler)"
)


def far_motion(what: str, far: str, longest: str) -> str:
    """The suspicion that the unit of a prescribed motion was forgotten.

    Args:
        far: How far it goes, with the unit.
        longest: The longest side of the body, with the unit.
    """
    return (
        f"{what} is to move by {far}, and the body is {longest} long: is a unit "
        "missing? Bare numbers and formulas are in m"
    )


def in_motion(advice: str) -> str:
    """Advice of statics as it holds in motion, which has time steps and no load steps."""
    return advice.replace("more load steps", "a smaller dt").replace("statics.", "dynamics.")


_KSP = {
    "DIVERGED_MAX_IT": (
        "its iterations (ksp_max_it) were not enough",
        'solver.method = "direct", or a larger ksp_max_it',
    ),
    "DIVERGED_DTOL": ("its residual grew", 'solver.method = "direct"'),
    "DIVERGED_BREAKDOWN": ("its iterations broke down", 'solver.method = "direct"'),
    "DIVERGED_INDEFINITE_PC": (
        "the preconditioner is not positive definite",
        'solver.method = "direct"',
    ),
    "DIVERGED_INDEFINITE_MAT": (
        "the tangent is not positive definite, which conjugate gradients need",
        'solver.method = "direct", or more load steps',
    ),
    "DIVERGED_NANORINF": (
        "it met a number that is not finite: the tangent may be singular",
        'solver.method = "direct"; is every piece of the body supported?',
    ),
    "DIVERGED_PCSETUP_FAILED": (
        "the preconditioner or factorisation failed: the tangent is singular, or memory ran out",
        "is every piece of the body supported? Otherwise more load steps",
    ),
}


_ENDS = {
    # Newton's method (SNES)
    "DIVERGED_FNORM_NAN": "the forces out of balance grow without bound or have no value",
    "DIVERGED_FUNCTION_NANORINF": (  # its name from PETSc 3.25 on
        "the forces out of balance grow without bound or have no value"
    ),
    "DIVERGED_FUNCTION_DOMAIN": (
        "step after step of Newton's method was shortened, lest elements turn inside out"
    ),
    "DIVERGED_LINE_SEARCH": "no step along Newton's direction brings the forces nearer to balance",
    "DIVERGED_LOCAL_MIN": "no step along Newton's direction brings the forces nearer to balance",
    "DIVERGED_INNER": "an inner solver of Newton's method failed",
    "DIVERGED_TR_DELTA": "the trust region of Newton's method has become too small",
    "DIVERGED_DTOL": "the forces out of balance grow without bound",
    "DIVERGED_MAX_IT": "the iterations of Newton's method were not enough",
    # time steps (TS)
    "DIVERGED_NONLINEAR_SOLVE": "Newton's method finds no motion, however short the step",
    "DIVERGED_STEP_REJECTED": "every step that was tried was refused, however short",
}
"""Ends of Newton's method and of time steps."""

_EPS = {
    "DIVERGED_ITS": "its iterations (eps_max_it) were not enough",
    "DIVERGED_BREAKDOWN": "its iterations broke down",
    "DIVERGED_SYMMETRY_LOST": "its matrices are not symmetric",
}


def in_words(reason: str) -> str:
    """Why a solver has ended; PETSc's name of it is logged as a detail.

    Args:
        reason: PETSc's name of the end of a SNES or TS, that of a KSP in parentheses where it is
            the linear solver's; other texts are returned as they are.
    """
    name = reason.partition(" (")[0]
    if "LINEAR_SOLVE" in name and "NONLINEAR" not in name:
        return f"the linear solver failed: {linear(reason)[0]}"
    if reason in _ENDS:
        log.debug("%s", reason)
        return _ENDS[reason]
    return reason


def eigenvalues(reason: str) -> str:
    """Why SLEPc's EPS has ended; see `in_words`."""
    log.debug("%s", reason)
    return _EPS.get(reason, "it did not converge")


def ahead(fault: str) -> str:
    """The text where Newton's next step inverts cells."""
    return f"every step of Newton's method turns elements inside out: {fault}"


def linear(reason: str) -> tuple[str, str]:
    """A linear solver's end in words, and advice; see `in_words`."""
    name = reason.partition("(")[2].rstrip(")") or reason
    text, advice = _KSP.get(name, ("it did not converge", 'solver.method = "direct"'))
    log.debug("%s", name)
    return text, advice


def load_not_finite(problem: Problem, t: float) -> InputError:
    """The error where loads have no finite value: the formula and its place. Collective.

    Args:
        t: Time [s], or load parameter.
    """
    formula = undefined_load(problem, t)
    if formula is not None:
        return formula
    return InputError(f"a load has no finite value at t = {t:g}", where="load", expected=LOAD)


def count(number: int, thing: str) -> str:
    """A number of things in words."""
    return f"{number} {thing}" + ("" if number == 1 else "s")


def sliver(quality: float) -> str:
    """A badly shaped cell that was inverted, in words.

    Args:
        quality: Of the cell: 1 of a regular one, 0 of a flat one.
    """
    return (
        f"it is a sliver: its quality is {quality:.2g}, where 1 is a regular element, so that a "
        "small motion of a node turns it inside out"
    )


def material(problem: Problem, names: Sequence[str]) -> str:
    """Materials in words, or the body where there is only one."""
    if len(problem.regions) == 1 or not names:
        return "the body"
    return f"material{'s' if len(names) > 1 else ''} '{', '.join(names)}'"


def constants(named: Sequence[str]) -> str:
    """Advice where constants of the wrong sign have made a material unstable."""
    which = " and ".join(text.partition(" ")[0] for text in named)
    return (
        f"other constants than {which}, fitted to tests that reach these stretches and kept "
        "positive; dolfin-elastic material shows the stretches up to which the material is stable"
    )


def another_law(names: Sequence[str]) -> str:
    """Advice where a law has lost ellipticity.

    Args:
        names: Laws of the same constants that go on; none are known if empty.
    """
    if not names:
        return MATERIAL
    laws = " or ".join(f"'{name}'" for name in names)
    return (
        f"law = {laws} with the same constants, which stay elliptic there; or a smaller load; a "
        "finer mesh does not help"
    )


def iterations(fall: str) -> str:
    """Advice where the number of iterations was the end."""
    if fall.startswith("still"):
        return "a larger statics.max_iterations, or more load steps"
    return STALLED


def round_off(relative: float) -> str:
    """Advice where rounding errors are larger than the tolerance."""
    enough = min(0.1, 10.0 * relative)
    return (
        f"rtol = {enough:.0e}; or a body that is not carried so far, or materials that differ less "
        "in stiffness"
    )
