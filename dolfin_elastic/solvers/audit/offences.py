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
class Offence:
    """A violation of one check of the audit by one state.

    Attributes:
        text: In words.
        size: How bad it is, to be compared with others of the same check.
        fails: The results of the run are unreliable.
        when: Time or load factor, in words.
        since: The same of the first offence of this check.
    """

    text: str
    size: float
    fails: bool = False
    when: str = ""
    since: str = ""

    def worse_than(self, other: Offence) -> bool:
        """Whether it is worse than another offence of the same check.

        One that fails is worse than one that does not; else the size decides, up to `_SAME`.
        """
        if self.fails != other.fails:
            return self.fails
        return self.size > (1 + _SAME) * other.size

    def __str__(self) -> str:
        when = self.when if self.since == self.when else f"worst at {self.when}, since {self.since}"
        return f"{self.text} ({when})"


Found = dict[str, Offence]
"""Offences of one state by the name of the check."""


def add_worse(found: Found, others: Mapping[str, Offence]) -> None:
    """Keeps the worse offence of each check.

    Args:
        found: Receives those of `others` that are worse than what it has.
        others: By the name of the check.
    """
    for check, offence in others.items():
        if check not in found or offence.worse_than(found[check]):
            found[check] = offence


def verdict(offences: Iterable[Offence]) -> Verdict:
    """The verdict on a state with some offences."""
    fails = [offence.fails for offence in offences]
    return "fail" if any(fails) else "warn" if fails else "pass"


@dataclass
class WorstOffences:
    """The worst offence of each check since the start, with its time. Not collective.

    Attributes:
        worst: By the name of the check; empty where nothing speaks against a run.
    """

    worst: Found = field(default_factory=dict)

    def add(self, found: Mapping[str, Offence], when: str) -> None:
        """Adds the offences of one state; warns of the first one of each check, and of a failure.

        Args:
            found: By the name of the check.
        """
        for check, offence in found.items():
            before = self.worst.get(check)
            now = replace(offence, when=when, since=before.since if before else when)
            if before is None or (offence.fails and not before.fails):
                log.warning("audit: %s", now)
            if before is None or now.worse_than(before):
                self.worst[check] = now

    def texts(self) -> tuple[str, ...]:
        """All of them in words, those that fail first."""
        ordered = sorted(self.worst.values(), key=lambda offence: not offence.fails)
        return tuple(map(str, ordered))

    def verdict(self) -> Verdict:
        """The verdict on the run so far."""
        return verdict(self.worst.values())

    def judged(self, audit: Audit, found: Mapping[str, Offence]) -> Audit:
        """An audit with its verdicts and reasons.

        Args:
            found: Offences of that state, which have been added.
        """
        return replace(
            audit,
            verdict=verdict(found.values()),
            reasons=tuple(offence.text for offence in found.values()),
            so_far=self.texts(),
            verdict_so_far=self.verdict(),
        )

    def restart_state(self) -> dict[str, Any]:
        """See `Restartable`."""
        return {check: asdict(offence) for check, offence in self.worst.items()}

    def restore(self, saved: Mapping[str, Any]) -> None:
        """See `Restartable`; an older checkpoint has the first offences as texts."""
        self.worst = {check: restored(offence) for check, offence in saved.items()}


def restored(saved: Any) -> Offence:
    """An offence from JSON data, or from the text that older checkpoints have."""
    if isinstance(saved, str):
        text, _, when = saved.rpartition(" (")
        when = when.rstrip(")")
        return Offence(text or saved, 0.0, when=when, since=when)
    return Offence(**saved)
