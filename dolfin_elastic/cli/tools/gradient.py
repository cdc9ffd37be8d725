"""The command `gradient`: its options and its table."""
# ruff: noqa: D301

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from dolfin_elastic.cli.run import CaseFile, Output, Petsc, Quiet, Trust, begin
from dolfin_elastic.core.errors import InputError, check_kept
from dolfin_elastic.core.petsc_options import parse_arguments
from dolfin_elastic.core.signals import Stop
from dolfin_elastic.core.startup.libraries import start

if TYPE_CHECKING:
    from dolfin_elastic.study.gradient.table import Derivative, Gradient, GradientTable

_ORDER = re.compile(r"norm:(\d+) ")
_DOUBTS = {
    " (!)": (
        -math.inf,
        1.9,
        "order below 2 (!): the remainder falls like that of a wrong derivative, or of a kink; it "
        "is not to be relied on",
    ),
    " (?)": (
        2.3,
        math.inf,
        "order above 2 (?): the remainder is not of second order either, and confirms nothing: "
        "round-off, a kink between both steps, or no curvature; `sweep` shows which",
    ),
}
"""Mark to the orders of Taylor's remainder that have it, from and to, and what they mean."""


def gradient(
    case: CaseFile,
    petsc: Petsc = None,
    *,
    of: Annotated[
        list[str],
        typer.Option("--of", metavar="NUMBER", help='What changes: "displacement_z of tip".'),
    ],
    by: Annotated[
        list[str] | None,
        typer.Option("--by", metavar="KEY", help="A number of the case: materials.steel.E."),
    ] = None,
    field: Annotated[
        list[str] | None,
        typer.Option("--field", metavar="KEY", help="A constant of a material in each cell."),
    ] = None,
    offset: Annotated[
        list[str] | None,
        typer.Option("--offset", metavar="SURFACE", help="A surface moves along its normal."),
    ] = None,
    verify: Annotated[
        bool, typer.Option("--verify", help="Solve twice more for each parameter, to see it.")
    ] = False,
    output: Output = None,
    trust: Trust = False,
    quiet: Quiet = False,
) -> None:
    """Say how results of a static case change with its numbers, cell by cell and with its shape.

    \b
      dolfin-elastic gradient hook.toml --of "displacement_z of tip" --by materials.steel.E
      dolfin-elastic gradient hook.toml --of "von_mises on fillet" --by "load[0].value[2]" \\
                                        --offset fillet --verify
      dolfin-elastic gradient hook.toml --of strain_energy --field materials.steel.E

    NUMBER is strain_energy, displacement_z of a probe, an edge or a point, reaction_x of a support,
    mean, integral or norm:16 of a field on a part: "mean von_mises on fillet", frequency_1 of
    [modal] or load_factor_1 of [buckling].  A largest value has no derivative where it jumps
    between places; a smooth norm stands for it.
    KEY is a key of the case file with dots, numbers of rows in brackets.
    One adjoint solution for each NUMBER gives all its derivatives.  The table, a plot and fields
    for ParaView go to CASE_gradient.
    """
    options, at_start = parse_arguments(petsc or [])
    start(at_start)
    from dolfin_elastic.case.case import read_case
    from dolfin_elastic.cli.console import show_files
    from dolfin_elastic.study.gradient.gradient import Asked, gradients_of
    from dolfin_elastic.study.gradient.table import GradientTable
    from dolfin_elastic.study.gradient.written import largest_values, write_gradient

    asked = Asked(*(tuple(dict.fromkeys(names or ())) for names in (of, by, field, offset)))
    if not (asked.by or asked.fields or asked.offsets):
        raise InputError(
            "nothing changes",
            where="--by",
            expected="--by materials.NAME.E, --field materials.NAME.E or --offset SURFACE",
        )
    comm = begin(quiet)
    read = read_case(case, comm=comm, trust=trust)
    folder = output if output is not None else read.folder_beside("gradient")
    check_kept(folder, "--output" if output is not None else "output.folder")
    Stop(folder)
    found = gradients_of(read, asked, petsc=options, verify=verify, comm=comm)
    names, fields = write_gradient(found, folder), largest_values(found)
    if comm.rank == 0 and not quiet:
        show(GradientTable(found.gradients), fields, verified=verify)
        show_files(folder, names)


def show(table: GradientTable, fields: Sequence[str], *, verified: bool) -> None:
    """Prints the table.

    Args:
        fields: What is told of each field.
        verified: Also Taylor's orders.
    """
    from rich.box import SIMPLE_HEAD
    from rich.table import Table

    from dolfin_elastic.cli.console import TYPED, console, show_table
    from dolfin_elastic.core.si_text import quantity

    screen, doubts = console(), list[str]()
    for one in table.gradients:
        screen.tell(f"{one.name} = {quantity(one.value, one.unit)}".translate(TYPED))
        rows = Table(box=SIMPLE_HEAD, pad_edge=False)
        heads = ["by", "at", "derivative", "1 % more"]
        for head in heads + ["order"] * verified:
            rows.add_column(head, justify="left" if head == "by" else "right")
        for d in one.by:
            order, meaning = order_text(d.order)
            rows.add_row(*cells_of(one, d), *([order] if verified else []))
            doubts.append(meaning)
        if one.by:
            show_table(screen, rows)
    for text in (*fields, *filter(None, dict.fromkeys(doubts))):
        screen.tell(text.translate(TYPED))
    for p in {found[1]: "" for one in table.gradients if (found := _ORDER.match(one.name))}:
        screen.tell(f"norm:{p} is the p-norm of order {p}, which is below the largest value")


def cells_of(one: Gradient, d: Derivative) -> list[str]:
    """A row of the table without the order: by, at, derivative, 1 % more."""
    from dolfin_elastic.cli.console import TYPED
    from dolfin_elastic.core.si_text import scaled_unit
    from dolfin_elastic.study.gradient.table import told_change

    factor, unit = scaled_unit(d.value, one.unit)
    per = f"{unit or 1} per {d.unit}" if d.unit else unit
    change, by = told_change(one, d)
    value = f"{d.value / factor:.5g} {per}".rstrip() if change else "0"
    return [
        d.key,
        f"{d.at:g} {d.unit}".rstrip() if d.at else "0",
        value.translate(TYPED),
        f"{change:+.3g} %{f' for {by}' if by else ''}"
        if change and math.isfinite(change)
        else "0" * (change == 0.0),
    ]


def order_text(order: float) -> tuple[str, str]:
    """Order of Taylor's remainder with a mark where it is not 2, and what the mark means."""
    if not math.isfinite(order):
        return "round-off", ""
    for mark, (low, high, meaning) in _DOUBTS.items():
        if low < order < high:
            return f"{order:.2f}{mark}", meaning
    return f"{order:.2f}", ""
