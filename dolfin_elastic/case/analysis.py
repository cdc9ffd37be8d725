"""What is computed of a body: equilibrium, motion, vibration or buckling, and what is written."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, Self, TypeAlias

from pydantic import PrivateAttr, model_validator

from dolfin_elastic.case.model_tables import ModelTables
from dolfin_elastic.case.tables import Output
from dolfin_elastic.core.errors import InputError
from dolfin_elastic.core.petsc_options import PetscOptions
from dolfin_elastic.core.schema import UnusedKeys, WhenGiven, refuse_unused_keys
from dolfin_elastic.problem.problem import Problem
from dolfin_elastic.results.writer import Output as File
from dolfin_elastic.solvers.dynamics.settings import DynamicsSettings
from dolfin_elastic.solvers.eigen.settings import BucklingSettings, ModalSettings
from dolfin_elastic.solvers.linear.choice import LinearSettings
from dolfin_elastic.solvers.statics.settings import StaticsSettings

if TYPE_CHECKING:
    from dolfin_elastic.solvers.dynamics.dynamics import Dynamics
    from dolfin_elastic.solvers.eigen.buckling import Buckling
    from dolfin_elastic.solvers.eigen.modal import Modal
    from dolfin_elastic.solvers.statics.statics import Statics

    Solver: TypeAlias = Statics | Dynamics | Modal | Buckling

Analysis = Literal["statics", "dynamics", "modal", "buckling"]

ANALYSES: tuple[Analysis, ...] = ("statics", "modal", "buckling", "dynamics")
"""Keys of their tables, in the order in which they run."""
EXPLICIT_STATES = 200
"""States whose fields are written of an explicit motion, which takes too many steps for all."""


class AnalysisTables(ModelTables):
    """The body, what is computed of it, and what is written.

    Attributes:
        statics: Equilibrium under growing load; the analysis of a case without any of these tables.
            It also says how the preload of the others is found.
        dynamics: Motion in time.
        modal: Natural frequencies and modes.
        buckling: Load factors at which it buckles.
        solver: How linear systems are solved.
        output: What is written.
    """

    statics: WhenGiven[StaticsSettings] | None = None
    dynamics: WhenGiven[DynamicsSettings] | None = None
    modal: WhenGiven[ModalSettings] | None = None
    buckling: WhenGiven[BucklingSettings] | None = None
    solver: WhenGiven[LinearSettings] = LinearSettings.model_construct()
    output: WhenGiven[Output] = Output.model_construct()

    _part: Analysis | None = PrivateAttr(default=None)
    _whole: Self | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _cross_check(self) -> Self:
        _check_periodic(self)
        _check_contacts(self)
        _check_output(self)
        return self

    @property
    def given(self) -> tuple[Analysis, ...]:
        """What is computed, in the order in which it runs."""
        if self._part is not None:
            return (self._part,)
        return tuple(key for key in ANALYSES if getattr(self, key) is not None) or ("statics",)

    @property
    def analysis(self) -> Analysis:
        """What is computed, the first of several: "statics", "modal", "buckling" or "dynamics"."""
        return self.given[0]

    @property
    def whole(self) -> Self:
        """The case of which this is one analysis, see `analyses`; else this one."""
        return self._whole or self

    def analyses(self) -> tuple[Self, ...]:
        """A case for each analysis, in the order in which they run; this one, if it has one.

        Their results go into folders of one, named after the analysis.  Those with a preload have
        the settings of [statics] for the way to it.
        """
        given = self.given
        return tuple(self._only(one) for one in given) if len(given) > 1 else (self,)

    def first_of(self, *kinds: str) -> Self:
        """The first analysis of these kinds as a case of its own; this one if there is none."""
        return next((one for one in self.analyses() if one.analysis in kinds), self)

    def _only(self, analysis: Analysis) -> Self:
        keys: dict[str, object] = {key: None for key in ANALYSES if key != analysis}
        modes, motion = analysis in ("modal", "buckling"), analysis == "dynamics"
        preloaded = analysis != "statics" and getattr(self, analysis).preload
        if preloaded and self.statics is not None:
            keys["statics"] = self.statics.as_way(ends=analysis == "modal")
        if motion and self.explicit:
            keys["solver"] = LinearSettings.model_construct()
        mixed = "dynamics" in self.given
        keys["output"] = self.output.only(
            modes=modes, states=not modes or preloaded, motion=motion if mixed else None
        )
        part = self.model_copy(update=keys)
        part._part, part._whole = analysis, self
        return part

    @property
    def gives_modes(self) -> bool:
        """The analysis is an eigenvalue problem."""
        return self.analysis in ("modal", "buckling")

    @property
    def timed(self) -> bool:
        """Time passes [s]: in motion, and in statics where materials or times with units say so."""
        memories = [material.law.memory for material in self.materials.values()]
        timed = any(memory is not None and memory.timed for memory in memories)
        timed = timed or (self.statics is not None and bool(self.statics.in_time))
        return self.dynamics is not None or (timed and not self.gives_modes)

    @property
    def final_load(self) -> float:
        """Load parameter at which statics ends; 1 is the full load."""
        return self.statics.end if self.statics is not None and self.analysis == "statics" else 1.0

    @property
    def preloaded(self) -> bool:
        """An equilibrium comes before the modes or the motion."""
        settings = self.modal or self.buckling or self.dynamics
        return settings is not None and bool(settings.preload)

    @property
    def preload_of_statics(self) -> bool:
        """The preload is the equilibrium that [statics] of the same case ends with."""
        end = self.whole.statics.end if self.whole.statics is not None else 1.0
        if self.buckling is not None:
            return self.buckling.preload == end
        return self.modal is not None and self.modal.preload

    @property
    def file_of_start(self) -> str | None:
        """Results that a motion starts from."""
        start = self.dynamics.start if self.dynamics is not None else None
        return start.file if start is not None else None

    @property
    def explicit(self) -> bool:
        """Motion by an explicit scheme, so that no equations are solved."""
        return self.dynamics is not None and not self.dynamics.implicit

    @property
    def degree(self) -> int:
        """Degree of the displacement: as [mesh] says; else quadratic, linear where mass is lumped.

        Linear tetrahedra are several times too stiff in bending, see `bending_notes`; quadratic
        ones have no positive lumped mass.
        """
        return self.mesh.degree or (1 if self.explicit else 2)

    @property
    def curved(self) -> bool | None:
        """Whether cells of CAD files follow curved surfaces, see `read_body`.

        As [mesh] says; else where the surfaces are curved and the displacement is quadratic.  A
        displacement that is linear in curved cells contains no rigid rotation.
        """
        return None if self.mesh.curved is None and self.degree > 1 else bool(self.mesh.curved)

    def solver_for(self, problem: Problem, petsc: PetscOptions | None) -> Solver:
        """The solver of the analysis. Collective.

        Args:
            petsc: PETSc options that win over those of [solver].

        Raises:
            InputError: The analysis cannot be made of this problem.
        """
        # Each is imported where it is needed: together they are a fifth of the package.
        if self.dynamics is not None:
            from dolfin_elastic.solvers.dynamics.dynamics import Dynamics

            statics, linear = self.statics, self.solver
            return Dynamics(problem, self.dynamics, statics=statics, linear=linear, petsc=petsc)
        if self.modal is not None:
            from dolfin_elastic.solvers.eigen.modal import Modal

            return Modal(problem, self.modal, statics=self.statics, linear=self.solver, petsc=petsc)
        if self.buckling is not None:
            from dolfin_elastic.solvers.eigen.buckling import Buckling

            return Buckling(
                problem, self.buckling, statics=self.statics, linear=self.solver, petsc=petsc
            )
        from dolfin_elastic.solvers.statics.statics import Statics

        output = self.output
        shown = output.every is not None or any(
            p.film or p.every != "last" for p in output.pictures
        )
        return Statics(problem, self.statics, linear=self.solver, petsc=petsc, gradual=shown)

    def files(self) -> list[File]:
        """Everything that is written."""
        return self.output.files(
            EXPLICIT_STATES if self.explicit else None,
            self.title,
            states=not self.gives_modes or self.preloaded,
            modes=self.gives_modes,
        )


# --- what fits together ---


def _check_periodic(case: AnalysisTables) -> None:
    """A periodic cell has statics only.

    Raises:
        InputError: It has another analysis.
    """
    others = [key for key in case.given if key != "statics"]
    if case.periodic is not None and others:
        what = {"dynamics": "motion", "modal": "modes of its own", "buckling": "modes of its own"}
        raise InputError(
            f"a periodic cell has no {what[others[0]]}",
            where=others[0],
            expected="leave it out, or write [statics]",
        )


def _check_contacts(case: AnalysisTables) -> None:
    """Refuses keys of [[contact]] without effect in motion."""
    rule = UnusedKeys(
        ["gap_tolerance"],
        "in motion the penalty decides how far a surface penetrates",
        "leave it out; a higher `stiffness` makes it less",
    )
    for key, contact in case.pairs.items() if case.given == ("dynamics",) else ():
        refuse_unused_keys(contact, [rule], key)


def _check_output(case: AnalysisTables) -> None:
    """Refuses keys of [output] for what none of the analyses gives."""
    parts = case.analyses()
    names = " and ".join(f"[{part.analysis}]" for part in parts)
    rules = []
    if not any(part.gives_modes for part in parts):
        words = " and ".join(case.given)
        rules.append(UnusedKeys(["frames", "amplitude"], f"there are no modes in {words}"))
    if all(part.gives_modes for part in parts):
        if not case.output.checkpoint.off:
            what = f"a run of {names} has no checkpoints and cannot be restarted"
            rules.append(UnusedKeys(["checkpoint"], what))
        if not any(part.preloaded for part in parts):
            what = "modes without a preload have no states with fields, probes or steps"
            expected = f"leave it out, or write {case.analysis}.preload"
            rules.append(UnusedKeys(["fields", "every", "probes"], what, expected))
    refuse_unused_keys(case.output, rules, "output")
