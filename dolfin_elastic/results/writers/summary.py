"""`summary.json`: how a run ended, its last state, the worst audits, extremes and costs."""

from __future__ import annotations

import json
import logging
import math
import re
import time
from collections.abc import Iterable, Mapping
from dataclasses import asdict
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import dolfinx
import numpy as np
from mpi4py import MPI
from petsc4py import PETSc

from dolfin_elastic.core import __version__, timing
from dolfin_elastic.core.errors import SolveError
from dolfin_elastic.core.parallel import on_root
from dolfin_elastic.core.si_text import time_or_load
from dolfin_elastic.mesh.body import span
from dolfin_elastic.problem.material_regions import locking_notes, shear_modulus
from dolfin_elastic.problem.state import Audit, Mode, Stability, State, plain
from dolfin_elastic.results.derived.mode_shape import shape_in_words
from dolfin_elastic.results.files import json_data, make_folder, replace_text
from dolfin_elastic.results.quantity import Extremes, Measured
from dolfin_elastic.results.recovery.error import ErrorEstimate, ErrorEstimator
from dolfin_elastic.results.recovery.locking import unseen_locking
from dolfin_elastic.results.recovery.motion_peaks import MotionPeaks
from dolfin_elastic.results.recovery.peaks import ERROR, peaks_of
from dolfin_elastic.results.recovery.slender import may_buckle
from dolfin_elastic.results.verdict import follows_curves, verdict_of
from dolfin_elastic.results.writer import LastState, Numbers
from dolfin_elastic.results.writers.modes import row

if TYPE_CHECKING:
    from dolfin_elastic.problem.problem import Problem

log = logging.getLogger("dolfin_elastic")
UNLOADED = 1e-6
"""Share of the run's largest displacement below which a body has gone back to where it was."""
_INTERVAL = 1.0
"""Seconds between two updates of the file."""
_STAGES = (*timing.STAGES, "total")
UNITS = {
    "t": "s (in statics the load parameter)",
    "max_displacement": "m",
    "energies": "J",
    "strain_energy": "J",
    "reactions": "N",
    "moment": "N m",
    "about": "m",
    "place": "m",
    "von_mises": "Pa",
    "frequency": "Hz",
    "omega": "rad/s",
    "mass": "kg",
    "effective": "kg (about axes kg m^2)",
    "timings": "s",
    "peak_memory": "byte",
}


class SummaryWriter:
    """Writes `summary.json`, and updates it about once a second.  All of it is collective.

    The file is valid JSON at any moment.  Its ``status`` is "running", then "completed", "stopped"
    or "failed" with the ``reason``; after a kill it remains "running".  The numbers are those of
    the last converged step; ``extremes`` are evaluated at the end of the run only.

    Args:
        path: The file; an old one is overwritten.
        saved: Its restart state: counts and seconds before the checkpoint are added.
        case: Tables of the case, of which the file holds a copy.
        model: What is noted of its model, see `case/model_record.py`.

    Raises:
        OutputError: The file cannot be written.
    """

    def __init__(
        self,
        problem: Problem,
        path: Path,
        saved: Numbers | None = None,
        *,
        case: Mapping[str, object] | None = None,
        model: Mapping[str, object] | None = None,
    ) -> None:
        self.problem, self.path, self.comm = problem, path, problem.body.comm
        self._copies = {"case": dict(case or {}), "model": dict(model or {})}
        self._begin = self._written = time.monotonic()
        before = dict(saved or {})
        self._started = before.get("started", _now())
        self._newton, self._krylov = before.get("newton", 0), before.get("krylov", 0)
        self._last: dict[str, object] = before.get("last", _NUMBERS)
        self._convergence: dict[str, dict[str, object]] = before.get("convergence", {})
        self._largest: dict[str, float] = before.get("largest", {})
        self._strained: dict[str, float] = before.get("strained", {})
        self._spent: dict[str, float] = before.get("timings", {})
        self._restarts: list[dict[str, object]] = before.get("restarts", [])
        if saved is not None:
            again = {"step": self._last["steps"], "t": self._last["t"], "ranks": self.comm.size}
            self._restarts = [*self._restarts, {**again, "at": _now()}]
        self._last_state = LastState()
        self._audits = WorstAudit(before.get("audits", ()))
        self._motion = MotionPeaks(problem, before.get("motion", {}))
        self._extremes: Extremes | None = None
        self._estimator: ErrorEstimator | None = None
        self._modes: list[Mode] = []
        self._shapes: list[str] = []
        self._logs = True
        with timing.stage("output"):
            on_root(self.comm, lambda: make_folder(path.parent))
            self._save("running")

    def _compile(self, state: State) -> None:
        if self._extremes is None:
            self._extremes = Extremes(self.problem)
            self._estimator = ErrorEstimator(self.problem) if state.v is None else None

    def prepare(self, state: State) -> None:
        """Estimates the error of the last state of statics before outputs write it.

        So they need not recover its stress, too.  Collective.
        """
        with timing.stage("output"):
            self._compile(state)
            if self._estimator and self._moved(state) and not self._released(state):
                self._estimator(state)

    def write(self, state: State) -> None:
        """Takes the numbers of one step; updates the file if that is due."""
        with timing.stage("output"):
            self._compile(state)
            self._newton += state.newton
            self._krylov += state.krylov
            self._last_state.copy(state)
            self._last = _numbers(state)
            self._convergence = _convergence(self._convergence, state)
            self._audits.add(state)
            if state.v is None:
                self._note_largest(state)
            else:
                self._motion.add(state)
            self._save_if_due()

    def _moved(self, state: State) -> bool:
        """Whether displacements are not round-off beside the largest of the run."""
        most = self._largest.get("max_displacement", 0.0)
        return state.max_displacement >= UNLOADED * most

    def _note_largest(self, state: State) -> None:
        """Notes the largest displacement and strain energy of a run in statics."""
        at, energy = {"step": state.step, "load_factor": plain(state.load_factor)}, _strain(state)
        if state.max_displacement > self._largest.get("max_displacement", 0.0):
            self._largest = {**at, "max_displacement": state.max_displacement}
        if energy > self._strained.get("strain_energy", 0.0):
            self._strained = {**at, "strain_energy": energy}

    def _released(self, state: State) -> bool:
        """Whether of the largest strain energy of the run nothing is left but round-off.

        The body may be elsewhere then, as a snap-fit that has passed its seat.
        """
        return abs(_strain(state)) < UNLOADED**2 * self._strained.get("strain_energy", 0.0)

    def _unloaded(self, state: State, extremes: Mapping[str, Measured]) -> bool:
        """Whether a state has nothing left of the largest of the run but round-off. Collective.

        A body that is held may have stress without displacement, where it is heated or contracts:
        it is compared to that of strains as large as the displacement over the body's size.

        Args:
            extremes: Its extremes; without them nothing is known.
        """
        if self._released(state):
            return True
        if not extremes or self._moved(state):
            return False
        most = self._largest.get("max_displacement", 0.0)
        stiff = max(shear_modulus(part.typical) for part in self.problem.regions)
        limit = UNLOADED * stiff * most / span(self.problem.body)
        return extremes["von_mises"].value < limit

    def silence(self) -> None:
        """Logs nothing of the estimated error at the end, as of a mesh that others follow."""
        self._logs = False

    def write_mode(self, mode: Mode) -> None:
        """Takes the numbers of one mode; updates the file if that is due."""
        with timing.stage("output"):
            self._modes.append(mode)
            rigid = mode.kind == "rigid"
            self._shapes.append("" if rigid else shape_in_words(self.problem, mode.u))
            self._save_if_due()

    def _save_if_due(self) -> None:
        # Clocks differ between ranks: the first one decides for all.
        if self.comm.bcast(time.monotonic() - self._written > _INTERVAL):
            self._save("running")

    def restart_state(self) -> Numbers:
        """See `Writer`."""
        content = {
            "started": self._started,
            "newton": self._newton,
            "krylov": self._krylov,
            "last": json_data(self._last),
            "convergence": json_data(self._convergence),
            "largest": self._largest,
            "strained": self._strained,
            "timings": self._timings(),
            "restarts": self._restarts,
            "audits": self._audits.restart_state(),
            "motion": self._motion.restart_state(),
        }
        return self.comm.bcast(content)  # clocks differ

    def close(self, status: str = "completed", error: object = None) -> None:
        """See `Writer`; adds status, reason and the extremes of the last converged step."""
        with timing.stage("output"):
            state = self._last_state.state
            content = self._extremes.of(state) if state and self._extremes else {}
            unloaded = state is not None and self._unloaded(state, content)
            # What remains of stresses is round-off, of which there is no error to estimate.
            wanted = None if unloaded else self._estimator
            estimate = wanted(state) if state and wanted else None
            if state and unloaded and self._logs:
                log.info("%s", self._unloaded_text(state), extra={"result": True})
            extra: dict[str, object] = {
                "finished": _now(),
                "extremes": {
                    name: {"value": one.value, "place": one.place, "part": one.part}
                    for name, one in content.items()
                },
            }
            if unloaded:
                most = self._strained or self._largest
                extra["unloaded"] = {key: most[key] for key in ("step", "load_factor")}
            if state and estimate:
                extra["error"] = _error(self.problem, state, estimate, logs=self._logs)
                stress = estimate.stress.stress
                if isinstance(self._last["stability"], dict):
                    self._last["stability"]["may_buckle"] = may_buckle(self.problem, stress)
            if isinstance(error, SolveError) and error.diagnosis is not None:
                extra["diagnosis"] = asdict(error.diagnosis)
            if self.problem.mixed and content:
                J = [content[name].value for name in ("min_jacobian", "max_jacobian")]
                extra["volume_change"] = max(abs(value - 1) for value in J)
            self._save(status, str(error) if error else "", extra)

    def _unloaded_text(self, state: State) -> str:
        most, what = self._largest, "displacement of the run is {max_displacement:.5g} m"
        if self._moved(state):
            most, what = self._strained, "strain energy of the run is {strain_energy:.5g} J"
        curves = follows_curves(self._copies["case"])
        timed = bool(self._last["timed"])
        when = time_or_load(most["load_factor"], timed=timed, curves=curves)
        return (
            "the last state is unloaded, and so are its stress and pictures; the largest "
            f"{what.format(**most)} in step {most['step']} ({when}); "
            "another step is drawn by dolfin-elastic plot --step"
        )

    def _save(
        self, status: str, reason: str = "", extra: Mapping[str, object] | None = None
    ) -> None:
        content: dict[str, object] = {
            "verdict": None,
            "status": status,
            "reason": reason,
            **self._sizes(),
            **self._numbers(),
            "extremes": {},
            "timings": self._timings(),
            "peak_memory": peak_memory(self.comm),
            "versions": versions(),
            "units": UNITS,
            "started": self._started,
            "restarts": self._restarts,
            **self._copies,
            **(extra or {}),
        }
        verdict = verdict_of(content)
        content["verdict"] = verdict and verdict.as_json()
        on_root(self.comm, lambda: replace_text(self.path, _text(content)))
        self._written = time.monotonic()

    def _sizes(self) -> dict[str, object]:
        return {
            "dofs": self.problem.num_dofs,
            "cells": self.problem.body.num_cells,
            "ranks": self.comm.size,
            "degree": self.problem.degree,
        }

    def _numbers(self) -> dict[str, object]:
        counts = {"newton_iterations": self._newton, "krylov_iterations": self._krylov}
        content: dict[str, object] = {
            "audit": self._audits.as_json(),
            "convergence": self._convergence,
        }
        if self._largest:
            content["largest"] = self._largest
        if motion := self._motion.as_json():
            content["motion"] = motion
        return {**self._last, **counts, **content, **self._of_modes()}

    def _of_modes(self) -> dict[str, object]:
        """The modes, masses and inertias of the body, and shares of the modes' effective masses."""
        if not self._modes:
            return {}
        whole, rows = (
            self._modes[0].whole,
            [
                {**row(mode), "shape": shape}
                for mode, shape in zip(self._modes, self._shapes, strict=True)
            ],
        )
        solver = "; ".join(dict.fromkeys(mode.solver for mode in self._modes))
        found: dict[str, object] = {"modes": rows, "eigensolver": solver}
        if not whole:
            return found
        sums = {name: sum(mode.effective[name] for mode in self._modes) for name in whole}
        shares = {name: sums[name] / whole[name] for name in whole if whole[name] > 0.0}
        return {**found, "whole": dict(whole), "effective_shares": shares}

    def _timings(self) -> dict[str, float]:
        measured = {"total": time.monotonic() - self._begin, **timing.totals()}
        names = dict.fromkeys((*_STAGES, *measured))
        return {
            name: round(measured.get(name, 0.0) + self._spent.get(name, 0.0), 4) for name in names
        }


_NUMBERS: dict[str, object] = {
    "steps": 0,
    "t": None,
    "load_factor": None,
    "timed": False,
    "newton_iterations": 0,
    "krylov_iterations": 0,
    "max_displacement": None,
    "strain_energy": None,
    "energies": {},
    "reactions": {},
    "moments": {},
    "numbers": {},
    "limit_points": [],
    "limit_point_errors": [],
    "stability": None,
}
"""Numbers of the last step, in the file's order, before there is one."""


def _numbers(state: State) -> dict[str, object]:
    """Numbers of one step."""
    return {
        **_NUMBERS,
        "steps": state.step,
        "t": plain(state.t),
        "load_factor": plain(state.load_factor),
        "timed": state.timed,
        "max_displacement": state.max_displacement,
        "strain_energy": state.energies.get("strain"),
        "energies": dict(state.energies),
        "reactions": dict(state.reactions),
        "moments": {
            name: {"moment": moment.value, "about": moment.about}
            for name, moment in state.moments.items()
        },
        "numbers": dict(state.numbers),
        "limit_points": list(state.limit_points),
        "limit_point_errors": list(state.limit_errors),
        "stability": None if state.stability is None else _stability(state.stability),
    }


def _strain(state: State) -> float:
    """Its strain energy [J]; NaN where a law has none."""
    return state.energies.get("strain", math.nan)


def _stability(stability: Stability) -> dict[str, object]:
    """Whether the equilibrium of a state is stable; a verdict without a look has a reason."""
    return {
        "verdict": stability.verdict,
        "negative_eigenvalues": stability.negative,
        "at_least": stability.at_least,
        "reason": stability.reason,
    }


def _convergence(
    before: Mapping[str, dict[str, object]], state: State
) -> dict[str, dict[str, object]]:
    """Residuals of Newton's method in the step with most iterations, and in the last one.

    Args:
        before: The same of the steps before.
    """
    if len(state.residuals) < 2:
        return dict(before)
    now: dict[str, object] = {
        "step": state.step,
        "t": plain(state.t),
        "newton": state.newton,
        "residuals": [float(f"{value:.4g}") for value in state.residuals],
    }
    most = before.get("most_iterations", now)
    more = state.newton > cast(int, most["newton"])
    return {"most_iterations": now if more else most, "last": now}


def _error(
    problem: Problem, state: State, estimate: ErrorEstimate, *, logs: bool
) -> dict[str, object]:
    """The estimated error and the largest stresses. Collective.

    Args:
        problem: The problem that is solved, in the state of the estimate.
        logs: They are also logged.
    """
    peaks = peaks_of(problem, state, estimate)
    locking = unseen_locking(problem, estimate.relative)
    if logs and peaks.largest.value > 0:
        for line in peaks.lines(estimate.relative):
            log.info("%s", line, extra={"result": True})
        if locking is not None:
            log.info("  not to be relied on     %s", locking.text(), extra={"result": True})
    table = {
        "energy_norm": estimate.relative,
        "energy": estimate.energy,
        "von_mises": peaks.largest.as_json(),
        "elsewhere": peaks.elsewhere.as_json() if peaks.elsewhere else None,
        "may_be_larger": peaks.rival.as_json() if peaks.rival else None,
        "straight_cells": peaks.cut_off,
        "reservations": [
            *peaks.reservations(estimate.relative),
            *([f"{ERROR}: {locking.text()}"] if locking else []),
            *locking_notes(problem.body, problem.regions, problem.degree, problem.geometry),
        ],
        "locking": asdict(locking) if locking else None,
    }
    if peaks.safety is not None:
        other, rival = peaks.safety_elsewhere, peaks.safety_rival
        table["safety_factor"] = peaks.safety.as_json()
        table["safety_factor_elsewhere"] = other.as_json() if other else None
        table["safety_factor_may_be_smaller"] = rival.as_json() if rival else None
    return table


def mark_stopped(
    folder: Path, reason: str = "on request, at once", *, before: str = "running"
) -> None:
    """Changes the status to "stopped" in the summary of a run that its writer does not close.

    Not collective: called on any ranks, of which the first to come changes it.

    Args:
        before: The status that is changed; another one stays.
    """
    path = folder / "summary.json"
    if not path.exists():
        return
    text = json.loads(path.read_text(encoding="utf-8"))
    if text["status"] == before:
        text |= {"status": "stopped", "reason": reason}
        verdict = verdict_of(text)
        text["verdict"] = verdict and verdict.as_json()
        replace_text(path, _text(text))


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")


def peak_memory(comm: MPI.Comm) -> dict[str, int]:
    """Peak memory [byte]: "sum" over the ranks and "largest_rank". Collective.

    Linux's VmHWM of each rank; pages that ranks share count once for each of them.
    """
    own = _high_water()
    return {"sum": comm.allreduce(own), "largest_rank": comm.allreduce(own, op=MPI.MAX)}


def _high_water() -> int:
    try:
        status = Path("/proc/self/status").read_text(encoding="ascii")
    except OSError:
        return 0
    line = next((x for x in status.splitlines() if x.startswith("VmHWM")), "VmHWM: 0 kB")
    return int(line.split()[1]) * 1024


def versions() -> dict[str, str]:
    """Versions of this package and of DOLFINx, PETSc and numpy. Not collective."""
    petsc = ".".join(str(number) for number in PETSc.Sys.getVersion())
    return {
        "dolfin_elastic": __version__,
        "dolfinx": dolfinx.__version__,
        "petsc": petsc,
        "numpy": np.__version__,
    }


def _text(content: object) -> str:
    """JSON for people, too: a list of numbers stands in one line."""
    text = json.dumps(json_data(content), indent=2, ensure_ascii=False, allow_nan=False)
    return _NUMBERS_ONLY.sub(lambda value: f"[{' '.join(value[0][1:-1].split())}]", text) + "\n"


# A text holds no line break in JSON, so that nothing in one can look like this.
_NUMBERS_ONLY = re.compile(r"\[\n\s+[-\d][-+.\deE]*(?:,\n\s+[-\d][-+.\deE]*)*\n\s+\]")


# --- the worst audit of a run ---


class WorstAudit:
    """Collects the audits of all steps and keeps the worst ones.  Not collective.

    Args:
        saved: Restart state: the worst audits before the checkpoint.
    """

    def __init__(self, saved: Iterable[Mapping[str, object]] = ()) -> None:
        self._audits, self._failure = [_audit(table) for table in saved], ""

    def restart_state(self) -> list[dict[str, object]]:
        """The worst audits so far, as JSON data."""
        return [asdict(audit) for audit in self._audits]

    def add(self, state: State) -> None:
        """Takes the audit of one step, if it has one."""
        self._failure = state.failure
        if state.audit is not None:
            self._audits = _extremes([*self._audits, state.audit])

    def as_json(self) -> dict[str, object]:
        """Verdict, reasons and the worst numbers; empty where nothing is audited."""
        if not self._audits:  # explicit motion
            return {"verdict": "fail", "reasons": [self._failure]} if self._failure else {}
        every, last = self._audits, self._audits[-1]
        low = min(every, key=lambda audit: audit.min_jacobian)
        high = max(every, key=lambda audit: audit.max_jacobian)
        force = [audit.force for audit in every if np.isfinite(audit.force)]
        moment = [audit.moment for audit in every if np.isfinite(audit.moment)]
        inverted = {}
        if last.inverted is not None:
            most = max(audit.inverted or 0 for audit in every)
            inverted = {"inverted_cells": {"last": last.inverted, "most": most}}
        return {
            "verdict": last.verdict_so_far,
            "reasons": list(last.so_far),
            "notes": list(last.notes),
            "balance_force": max(force, default=None),
            "balance_moment": max(moment, default=None),
            "external_work": last.work,
            "stored_energy": last.energy,
            "min_jacobian": {"value": low.min_jacobian, "place": list(low.min_place)},
            "max_jacobian": {"value": high.max_jacobian, "place": list(high.max_place)},
            **inverted,
        }


def _audit(table: Mapping[str, Any]) -> Audit:
    """An audit from JSON data, whose lists become tuples."""
    values: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in table.items()
    }
    return Audit(**values)


def _extremes(audits: list[Audit]) -> list[Audit]:
    """The audits that are worst by one of their numbers, and the last one."""
    worst = [
        max(audits, key=lambda audit: np.nan_to_num(audit.force)),
        max(audits, key=lambda audit: np.nan_to_num(audit.moment)),
        min(audits, key=lambda audit: audit.min_jacobian),
        max(audits, key=lambda audit: audit.max_jacobian),
        max(audits, key=lambda audit: audit.inverted or 0),
    ]
    return [*worst, audits[-1]]
