"""The worst that an audit has found in a run, check by check."""

from __future__ import annotations

import logging
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field, replace
from typing import Any

from dolfin_elastic.problem.state import Audit, Verdict

FAILING_GAIN = 0.2
"""Spurious gain of energy, over the largest energy of the motion, above which its results are
unreliable: amplitudes are wrong by more than a tenth."""

_SAME = 1e-3
"""Relative difference of sizes that count as equal."""

log = logging.getLogger("dolfin_elastic")


@dataclass(frozen=True)
class Violation:
    """A violation of one check of the audit by one state.

    Attributes:
        text: In words.
        size: How bad it is, to be compared with others of the same check.
        fails: The results of the run are unreliable.
        when: Time or load factor, in words.
        since: The same of the first violation of this check.
    """

    text: str
    size: float
    fails: bool = False
    when: str = ""
    since: str = ""

    def worse_than(self, other: Violation) -> bool:
        """Whether it is worse than another violation of the same check.

        One that fails is worse than one that does not; else the size decides, up to `_SAME`.
        """
        if self.fails != other.fails:
            return self.fails
        return self.size > (1 + _SAME) * other.size

    def __str__(self) -> str:
        when = self.when if self.since == self.when else f"worst at {self.when}, since {self.since}"
        return f"{self.text} ({when})"


Violations = dict[str, Violation]
"""Violations of one state by the name of the check."""


def add_worse(worst: Violations, others: Mapping[str, Violation]) -> None:
    """Keeps the worse violation of each check.

    Args:
        worst: Receives those of `others` that are worse than what it has.
        others: By the name of the check.
    """
    for check, violation in others.items():
        if check not in worst or violation.worse_than(worst[check]):
            worst[check] = violation


def verdict(violations: Iterable[Violation]) -> Verdict:
    """The verdict on a state with some violations."""
    fails = [violation.fails for violation in violations]
    return "fail" if any(fails) else "warn" if fails else "pass"


@dataclass
class WorstViolations:
    """The worst violation of each check since the start, with its time. Not collective.

    Attributes:
        worst: By the name of the check; empty where nothing speaks against a run.
    """

    worst: Violations = field(default_factory=dict)

    def add(self, violations: Mapping[str, Violation], when: str) -> None:
        """Adds the violations of one state; warns of the first one of each check, and of a failure.

        Args:
            violations: By the name of the check.
        """
        for check, violation in violations.items():
            before = self.worst.get(check)
            now = replace(violation, when=when, since=before.since if before else when)
            if before is None or (violation.fails and not before.fails):
                log.warning("audit: %s", now)
            if before is None or now.worse_than(before):
                self.worst[check] = now

    def texts(self) -> tuple[str, ...]:
        """All of them in words, those that fail first."""
        ordered = sorted(self.worst.values(), key=lambda violation: not violation.fails)
        return tuple(map(str, ordered))

    def verdict(self) -> Verdict:
        """The verdict on the run so far."""
        return verdict(self.worst.values())

    def judged(self, audit: Audit, violations: Mapping[str, Violation]) -> Audit:
        """An audit with its verdicts and reasons.

        Args:
            violations: Violations of that state, which have been added.
        """
        return replace(
            audit,
            verdict=verdict(violations.values()),
            reasons=tuple(violation.text for violation in violations.values()),
            so_far=self.texts(),
            verdict_so_far=self.verdict(),
        )

    def restart_state(self) -> dict[str, Any]:
        """See `Restartable`."""
        return {check: asdict(violation) for check, violation in self.worst.items()}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`; an older checkpoint has the first violations as texts."""
        self.worst = {check: restored(violation) for check, violation in saved.items()}


def restored(saved: Any) -> Violation:
    """A violation from JSON data, or from the text that older checkpoints have."""
    if isinstance(saved, str):
        text, _, when = saved.rpartition(" (")
        when = when.rstrip(")")
        return Violation(text or saved, 0.0, when=when, since=when)
    return Violation(**saved)
