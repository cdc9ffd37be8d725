"""The worst of the audits of a run's steps."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import asdict
from typing import Any

import numpy as np

from dolfin_elastic.problem.state import Audit, State


class WorstAudit:
    """Takes in the audit of each step and tells the worst of all.  Not collective.

    Args:
        saved: Restart state: the worst audits before the checkpoint.
    """

    def __init__(self, saved: Iterable[Mapping[str, Any]] = ()) -> None:
        self._audits = [_audit(table) for table in saved]

    def restart_state(self) -> list[dict[str, Any]]:
        """The worst audits so far, as JSON data."""
        return [asdict(audit) for audit in self._audits]

    def take(self, state: State) -> None:
        """Takes in one step; keeps nothing but what is worst so far."""
        if state.audit is not None:
            self._audits = _extremes([*self._audits, state.audit])

    def told(self) -> dict[str, Any]:
        """Verdict, reasons and the worst numbers, for JSON; empty where nothing is audited."""
        if not self._audits:
            return {}
        every, last = self._audits, self._audits[-1]
        low = min(every, key=lambda audit: audit.min_jacobian)
        high = max(every, key=lambda audit: audit.max_jacobian)
        force = [audit.force for audit in every if np.isfinite(audit.force)]
        moment = [audit.moment for audit in every if np.isfinite(audit.moment)]
        return {
            "verdict": "warn" if last.so_far else "pass",
            "reasons": list(last.so_far),
            "notes": list(last.notes),
            "balance_force": max(force, default=None),
            "balance_moment": max(moment, default=None),
            "external_work": last.work,
            "stored_energy": last.energy,
            "min_jacobian": {"value": low.min_jacobian, "place": list(low.min_place)},
            "max_jacobian": {"value": high.max_jacobian, "place": list(high.max_place)},
        }


def _audit(table: Mapping[str, Any]) -> Audit:
    """From JSON, which knows lists only."""
    values: dict[str, Any] = {
        key: tuple(value) if isinstance(value, list) else value for key, value in table.items()
    }
    return Audit(**values)


def _extremes(audits: list[Audit]) -> list[Audit]:
    """Those with the worst of each number, and the last one."""
    worst = [
        max(audits, key=lambda audit: np.nan_to_num(audit.force)),
        max(audits, key=lambda audit: np.nan_to_num(audit.moment)),
        min(audits, key=lambda audit: audit.min_jacobian),
        max(audits, key=lambda audit: audit.max_jacobian),
    ]
    return [*worst, audits[-1]]
