"""Steps of Abaqus and CalculiX as analyses of a case."""

from __future__ import annotations

from collections.abc import Callable

from dolfin_elastic.case.decks.abaqus.materials import floats, place
from dolfin_elastic.case.decks.abaqus.state import Reading
from dolfin_elastic.case.decks.deck import Quantity, Step
from dolfin_elastic.mesh.formats.abaqus.cards import Card

OTHER_ANALYSES = frozenset(
    (
        *("VISCO", "MODAL DYNAMIC", "STEADY STATE DYNAMICS", "HEAT TRANSFER", "COMPLEX FREQUENCY"),
        *("COUPLED TEMPERATURE-DISPLACEMENT", "UNCOUPLED TEMPERATURE-DISPLACEMENT", "SENSITIVITY"),
        *("GREEN", "SUBSTRUCTURE GENERATE", "ELECTROMAGNETICS", "CFD", "CRACK PROPAGATION"),
        *("RANDOM RESPONSE", "RESPONSE SPECTRUM", "GEOSTATIC", "SOILS", "ANNEAL"),
        *("FEASIBLE DIRECTION", "ROBUST DESIGN"),
    )
)
"""Keywords of analyses that the program lacks."""
_MOST = 100_000


def begin_step(state: Reading, card: Card) -> None:
    """*STEP: what kind it is, the keywords below it say."""
    state.finish_step()
    if card.options.get("NLGEOM", "NO" if "NLGEOM" not in card.options else "YES").upper() != "NO":
        state.large = True
    state.card, state.period, state.fresh = card, 1.0, set()
    state.step = Step("statics", place(card))


def end_step(state: Reading, card: Card) -> None:
    """*END STEP."""
    del card
    state.finish_step()


def take_procedure(state: Reading, card: Card) -> None:
    """The keyword that says what a step computes."""
    if card.word in OTHER_ANALYSES:
        state.fault(card, "this analysis is not there")
        state.step = None
        return
    if state.step is None:
        raise card.error("it stands outside of a step", expected="*STEP above it")
    PROCEDURES[card.word](state, card)


def _preloaded(state: Reading) -> bool:
    """The equilibrium of the static step before it counts: as both programs have it."""
    before = state.deck.steps[-1] if state.deck.steps else None
    perturbation = state.card is not None and "PERTURBATION" in state.card.options
    return before is not None and before.kind == "statics" and (before.nonlinear or perturbation)


def _static(state: Reading, card: Card) -> None:
    assert state.step is not None
    numbers = [*(floats(card, 0) if card.lines else []), *[0.0] * 4][:4]
    first, period, _, most = numbers
    before = state.large or state.loads or state.forces
    if before and state.card is not None and "PERTURBATION" in state.card.options:
        text = "PERTURBATION: a small change of the state before it, under its own loads alone"
        state.fault(state.card, text)
    state.period = period or 1.0
    if "RIKS" in card.options:
        state.step.settings["method"] = "arc-length"
        state.note(card, "the path ends at the full load, not where RIKS says")
    elif "DIRECT" in card.options and 0 < first < state.period:
        state.step.settings["steps"] = min(round(state.period / first), _MOST)
    else:
        increments = {"first_step": first / state.period, "max_step": most / state.period}
        state.step.increments = {k: v for k, v in increments.items() if 1 / _MOST <= v < 1}
    if "STABILIZE" in card.options:
        state.note(card, "STABILIZE: where no equilibrium is near, the case lets the body flow")


def _frequency(state: Reading, card: Card) -> None:
    assert state.step is not None
    words = [word.strip() for word in (card.lines[0] if card.lines else "").split(",")]
    numbers = [*floats(card, 0), 0.0, 0.0, 0.0][:3] if card.lines else [0.0] * 3
    state.step.kind = "modal"
    settings: dict[str, object] = {"count": max(int(numbers[0]), 1)} if words[0] else {}
    if not settings and numbers[2]:
        settings = {"below": Quantity(numbers[2], "frequency")}
    elif numbers[1] or numbers[2]:
        state.note(card, "limits of frequency; the number of modes holds, from the lowest on")
    state.step.settings = settings
    state.step.preloaded = _preloaded(state)
    if state.step.preloaded:
        state.step.loads = []


def _buckle(state: Reading, card: Card) -> None:
    assert state.step is not None
    numbers = floats(card, 0) if card.lines else [1.0]
    state.step.kind = "buckling"
    state.step.settings = {"count": max(int(numbers[0]), 1)}
    if state.loads or state.forces:
        state.fault(card, "loads of earlier steps, about which it would be linearised")


def _dynamic(state: Reading, card: Card) -> None:
    assert state.step is not None
    numbers = [*floats(card, 0), 0.0, 0.0][:2] if card.lines else [0.0, 1.0]
    dt, end = numbers[0], numbers[1] or 1.0
    state.period, state.step.kind = end, "dynamics"
    if state.card is not None and state.card.options.get("AMPLITUDE", "").upper() == "RAMP":
        state.fault(state.card, "AMPLITUDE=RAMP: give the loads an *AMPLITUDE of their own")
    settings: dict[str, object] = {"end": Quantity(end, "time")}
    if any(key.startswith("EXPLICIT") for key in card.options):
        settings["scheme"] = "central-differences"
    elif not dt:
        raise card.error("the time step is missing", expected="a line such as 1.e-3, 1.")
    else:
        settings["dt"] = Quantity(dt, "time")
        if "DIRECT" not in card.options:
            settings["adaptive"] = True
    if "ALPHA" in card.options:
        state.note(card, "ALPHA: the scheme is generalized-alpha, with a damping of its own")
    if state.velocity:
        settings["initial_velocity"] = [Quantity(v, "velocity") for v in state.velocity]
    alpha, beta = max(state.damping.values(), default=(0.0, 0.0))
    if alpha or beta:
        if len(set(state.damping.values())) > 1 or len(state.damping) < len(state.materials):
            state.fault(card, "*DAMPING that differs between materials")
        inverse = Quantity(alpha, "frequency") if alpha else 0
        settings["rayleigh"] = {"mass": inverse, "stiffness": Quantity(beta, "time")}
    state.step.settings = settings
    before = state.deck.steps[-1] if state.deck.steps else None
    if before is not None:
        state.fault(card, "it goes on from the end of the step before it")


PROCEDURES: dict[str, Callable[[Reading, Card], None]] = {
    "STATIC": _static,
    "FREQUENCY": _frequency,
    "BUCKLE": _buckle,
    "DYNAMIC": _dynamic,
}
"""Keyword of an analysis to what reads it."""
