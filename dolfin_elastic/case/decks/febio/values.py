"""Numbers, load curves and names in the tags of an FEBio model."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

from dolfin_elastic.case.decks.deck import Deck, Place
from dolfin_elastic.core.errors import MeshError
from dolfin_elastic.mesh.formats.febio.tags import Tag

LINEAR = ((0.0, 0.0), (1.0, 1.0))


def place(tag: Tag) -> Place:
    """Where a tag stands."""
    kind = tag.attributes.get("type")
    return Place(tag.file, tag.line, f'<{tag.name} type="{kind}">' if kind else f"<{tag.name}>")


def numbers(tag: Tag, count: int | None = None) -> list[float]:
    """The numbers that a tag contains.

    Args:
        count: How many there must be; None: any.

    Raises:
        MeshError: It contains something else.
    """
    words = tag.text.replace(",", " ").split()
    try:
        values = [float(word) for word in words]
    except ValueError:
        values = []
    if (
        not values
        or (count is not None and len(values) != count)
        or not all(map(math.isfinite, values))
    ):
        wanted = "numbers" if count is None else "a number" if count == 1 else f"{count} numbers"
        raise tag.error(f"<{tag.name}> contains '{tag.text[:60]}'", wanted)
    return values


def is_set(tag: Tag | None) -> bool:
    """Whether a switch is on."""
    return tag is not None and tag.text not in ("", "0", "false")


def flag(parent: Tag, name: str) -> bool:
    """Whether a switch below a tag is on."""
    return is_set(parent.first(name))


@dataclass(frozen=True)
class Curve:
    """A load curve.

    Attributes:
        place: Where it stands.
        rows: Times and values.
        linear: It is linear between its rows, so that these say all of it.
        beyond: How it goes on after its last row.
    """

    place: Place
    rows: tuple[tuple[float, float], ...]
    linear: bool
    beyond: str

    def known_at(self, t: float) -> bool:
        """Whether its value at a time is that of `at`."""
        inside = self.rows[0][0] <= t <= self.rows[-1][0]
        on_row = any(math.isclose(t, time, rel_tol=1e-9) for time, _ in self.rows)
        return on_row or (self.linear if inside else self.beyond in ("constant", "extrapolate"))

    def at(self, t: float) -> float:
        """Its value, linear between rows."""
        rows = self.rows
        if t <= rows[0][0] or len(rows) == 1:
            return rows[0][1]
        i = next((i for i in range(1, len(rows)) if t <= rows[i][0]), len(rows) - 1)
        (t0, f0), (t1, f1) = rows[i - 1], rows[i]
        if t > t1 and self.beyond != "extrapolate":
            return f1
        return f0 + (f1 - f0) * (t - t0) / (t1 - t0)

    def until(self, end: float) -> list[tuple[float, float]]:
        """Its rows from 0 to a time."""
        inside = [(t, f) for t, f in self.rows if 0 < t < end and not math.isclose(t, end)]
        return [(0.0, self.at(0.0)), *inside, (end, self.at(end))]


def curves(root: Tag, deck: Deck) -> dict[str, Curve]:
    """Load curves by their numbers."""
    result = dict[str, Curve]()
    for section in root.all("LoadData"):
        for tag in section.children:
            if tag.name == "loadcurve" or tag.attributes.get("type") == "loadcurve":
                result[tag.attributes.get("id", "")] = _curve(tag)
            else:
                text = f"the load controller {tag.attributes.get('id', '')} is no curve of points"
                deck.leave_out(place(tag), text, "changes the answer")
    return result


def _curve(tag: Tag) -> Curve:
    points = tag.first("points")
    rows = [numbers(row, 2) for row in (points or tag).all("pt", "point", "loadpoint")]
    kind = tag.content("interpolate", tag.attributes.get("type", "linear")).lower()
    if not rows or any(b[0] <= a[0] for a, b in pairwise(rows)):
        raise tag.error("the times of this load curve do not increase, or there are none")
    # A smooth curve through two points is a line.
    linear = kind == "linear" or (kind == "smooth" and len(rows) == 2)
    beyond = tag.content("extend", tag.attributes.get("extend", "constant")).lower()
    return Curve(place(tag), tuple((t, f) for t, f in rows), linear, beyond)


@dataclass(frozen=True)
class Amount:
    """Numbers that change over time.

    Attributes:
        values: At the end of the analysis, or in motion those that the ramp multiplies.
        ramp: See `Entry.ramp`.
    """

    values: list[float]
    ramp: tuple[tuple[float, float], ...] | None


@dataclass(frozen=True)
class Clock:
    """The time of an analysis.

    Attributes:
        deck: Which learns what curves cannot say.
        curves: Load curves by their numbers.
        end: When it ends.
        motion: It is a motion.
    """

    deck: Deck
    curves: Mapping[str, Curve]
    end: float
    motion: bool

    def amount(self, owner: Tag, tags: Iterable[tuple[Tag | None, int]]) -> Amount:
        """The product of some tags, of which at most one has a load curve.

        Args:
            owner: The load or support that they belong to, for the line of a message.
            tags: Each with the count of its numbers; those that are None count as 1.
        """
        values, ramp = [1.0], None
        for tag, count in tags:
            if tag is None:
                continue
            own = numbers(tag, count)
            values = [a * b for a in values for b in own]
            if (number := tag.attributes.get("lc")) is None:
                continue
            if number not in self.curves:
                raise tag.error(f"there is no load curve {number}")
            if ramp is not None:
                raise owner.error("two load curves multiply each other")
            ramp = self._rows(self.curves[number], tag)
        return self._scaled(values, ramp)

    def _rows(self, curve: Curve, tag: Tag) -> list[tuple[float, float]]:
        rows = curve.until(self.end)
        if self.motion:
            if not curve.linear or not curve.known_at(self.end):
                text = f"{curve.place} is not linear between its points; here it is"
                self.deck.leave_out(place(tag), text, "changes the answer")
            return rows
        if not curve.known_at(self.end):
            text = f"its value at the end of {curve.place} is between points that are no line"
            self.deck.leave_out(place(tag), text, "changes the answer")
        elif not curve.linear:
            self.deck.leave_out(
                curve.place, "not linear between its points; here it is, on the way"
            )
        return [(t / self.end, f) for t, f in rows]

    def _scaled(self, values: list[float], rows: Sequence[tuple[float, float]] | None) -> Amount:
        if rows is None:
            return Amount(values, None)
        size = rows[-1][1] or max((f for _, f in rows), key=abs)
        if not size:
            return Amount([0.0 for _ in values], None)
        ramp = tuple((t, f / size) for t, f in rows)
        return Amount(
            [size * v for v in values], None if not self.motion and ramp == LINEAR else ramp
        )


def named_part(tag: Tag, attribute: str) -> str:
    """Name of the surface or set of nodes on which something acts.

    Raises:
        MeshError: There is none.
    """
    word = tag.attributes.get(attribute) or tag.attributes.get("set", "")
    kind, _, name = word.rpartition(":") if word.startswith("@") else ("", "", word)
    if not name or kind not in ("", "@surface", "@node_set", "@edge"):
        raise unnamed(tag, attribute)
    return name


def unnamed(tag: Tag, attribute: str) -> MeshError:
    """The error where something lists its own nodes."""
    return tag.error(
        f"<{tag.name}> names no set of the mesh", f'{attribute}="..." with a name of the mesh'
    )
