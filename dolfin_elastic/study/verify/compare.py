"""Results of one case from several numbers of ranks, compared.

What is compared are the last rows of `history.csv` and all of `modes.csv`.  Counts of iterations
and sums that are round-off by nature may differ, and are left out.  A force that is zero but for
round-off, as that of a roller nothing pushes, is judged by the energy over the displacement.
"""

from __future__ import annotations

import csv
import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from dolfin_elastic.core.errors import InputError

_NO_RESULT = re.compile(r"step|newton|krylov|balance_|verdict|mode$|kind|name|direction")
_COMPONENT = re.compile(r"_?(r?[xyz]|[xyz]{2}|[0-9]{2})$")


@dataclass(frozen=True)
class Difference:
    """A number of the results on several numbers of ranks.

    Attributes:
        name: Its column, with the mode's number.
        values: One for each number of ranks.
        scale: Largest absolute value of the column, of those of the other components, and of what
            energy, displacement and time make of its unit.
    """

    name: str
    values: Sequence[float]
    scale: float

    @property
    def relative(self) -> float:
        """Largest difference of two of the values over the scale."""
        apart = max(self.values) - min(self.values)
        return apart / self.scale if self.scale > 0 else 0.0


def compare(folders: Sequence[Path]) -> list[Difference]:
    """Compares results of the same case.

    Args:
        folders: Of the results, one for each number of ranks.

    Raises:
        InputError: They have different columns, or different numbers of modes.
    """
    tables = [_numbers(folder) for folder in folders]
    for folder, other in zip(folders, tables, strict=True):
        if other.keys() != tables[0].keys():
            raise InputError(
                "other columns or modes than on the first number of ranks",
                where=str(folder),
                expected="please report it, with the case",
            )
    scales: dict[str, float] = defaultdict(float)
    for numbers in tables:
        for name, (_, scale) in numbers.items():
            group = _COMPONENT.sub("", name)
            scales[group] = max(scales[group], scale, _least_scale(group, numbers))
    return [
        Difference(name, [one[name][0] for one in tables], scales[_COMPONENT.sub("", name)])
        for name in tables[0]
    ]


def _numbers(folder: Path) -> dict[str, tuple[float, float]]:
    """Column to its last value, and to its largest absolute one."""
    result = {}
    rows = _rows(folder / "history.csv")
    for name in _columns(rows):
        values = [float(row[name]) for row in rows]
        result[name] = (values[-1], max(map(abs, values)))
    for number, row in enumerate(_rows(folder / "modes.csv"), start=1):
        for name in ("frequency", "load_factor"):
            if row.get(name):
                result[f"{name} of mode {number}"] = (float(row[name]), abs(float(row[name])))
    return result


def _least_scale(group: str, numbers: Mapping[str, tuple[float, float]]) -> float:
    """A force, moment or momentum that the energy of the body could make; 0 of other numbers."""
    energy = max((one for name, (_, one) in numbers.items() if "energy" in name), default=0.0)
    moved, time = (numbers.get(name, (0.0, 0.0))[1] for name in ("max_displacement", "t"))
    force = energy / moved if moved > 0 else 0.0
    for word, scale in (
        ("reaction", force),
        ("angular_momentum", energy * time),
        ("momentum", force * time),
        ("moment", energy),
        ("torque", energy),
    ):
        if group.startswith(word):
            return scale
    return 0.0


def _columns(rows: Sequence[Mapping[str, str]]) -> list[str]:
    """Names of the columns of numbers that are results."""
    return [name for name in (rows[-1] if rows else ()) if not _NO_RESULT.match(name)]


def _rows(file: Path) -> list[dict[str, str]]:
    if not file.exists():
        return []
    with file.open(encoding="utf-8", newline="") as lines:
        return list(csv.DictReader(lines))
