"""What the command line shows of a check, at most 100 columns wide."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.table import Table

from dolfin_elastic.cli.console import TYPED, console, described_tables, show_tables, vector_text
from dolfin_elastic.cli.look.show import Lengths, parts_table
from dolfin_elastic.core.units import LENGTHS

if TYPE_CHECKING:
    from dolfin_elastic.case.check.initial_state import ContactGap
    from dolfin_elastic.case.check.report import Report
    from dolfin_elastic.case.check.sizes import PartSize
    from dolfin_elastic.solvers.diagnostics.rigid_body import FreeBody


def show_check(report: Report) -> None:
    """Prints the report of a check."""
    screen = console()
    title = " ".join(report.title.split())  # one line, whatever it holds
    screen.print(f"{report.case}: {title}" if title else report.case, style="bold")
    size = _lengths(report)
    for name, text in _head(report, size):
        screen.tell(f"  {name:<10} {text}")
    tables = []
    for kind in ("surface", "edge", "point", "region", "material"):
        rows: Sequence[PartSize] = getattr(report, f"{kind}s")
        if rows:
            use = "law" if kind == "material" else "used by"
            tables.append(parts_table(kind, rows, size, use=use))
    tables += described_tables(report.described)
    if report.contacts:
        tables.append(_contacts(report.contacts, size))
    show_tables(screen, [*tables, *([_loads(report)] if report.loads else [])])
    if report.loads:
        screen.tell(_about_loads(report))
    for field in report.fields:
        screen.tell(f"field {field}")
    for note in report.notes:
        screen.tell(f"note: {note}")
    count = len(report.notes)
    screen.print(
        f"no errors; {count} note{'s' if count > 1 else ''}" if count else "nothing is wrong"
    )


def _lengths(report: Report) -> Lengths:
    unit = report.unit if report.unit in LENGTHS else "m"
    return Lengths(unit, LENGTHS[unit], report.dim, max(report.extent))


def _head(report: Report, size: Lengths) -> list[tuple[str, str]]:
    kind = "" if report.dim == 3 else f" ({report.geometry})"
    whole, elements = report.regions[0], {1: "linear", 2: "quadratic"}[report.degree]
    by = f" by {report.scheme}" if report.scheme else ""
    rows = [
        ("mesh", f"{report.mesh}, {report.dim}D{kind}, {report.cells} elements"),
        *(("", text) for text in report.information),
        ("extent", size.text(*report.extent)),
        *([] if report.thickness is None else [("thickness", size.text(report.thickness))]),
        ("analysis", f"{report.analysis}{by}, {elements} elements, {report.unknowns} unknowns"),
        *(("damping", text) for text in report.damping),
        ("equations", report.linear_solver),
        ("memory", f"about {report.memory.total / 1e9:.2g} GB of all ranks together"),
    ]
    if whole.mass is not None:
        middle = f"{size.place(whole.centre_of_mass)} {size.unit}"
        mounted = whole.mass - sum(row.mass or 0.0 for row in report.materials)
        of = f", {mounted:.4g} kg of it mounted" if mounted > 1e-9 * whole.mass else ""
        rows.append(("mass", f"{whole.mass:.4g} kg{of}, centre of mass {middle}"))
    for text in report.constants:  # the source of a material is an indented line of its own
        rows.append(("" if text.startswith(" ") else "material", text.translate(TYPED)))
    return [*rows, *(("body", _body(body, len(report.bodies))) for body in report.bodies[:5])]


def _body(body: FreeBody, bodies: int) -> str:
    name = f"`{body.name}` " if bodies > 1 else ""
    free = "is constrained against every rigid motion"
    if body.motions:
        free = f"can {', '.join(body.motions)}"
    return f"{name}{free}" + (f" (one of {bodies} that share no nodes)" if bodies > 1 else "")


def _loads(report: Report) -> Table:
    heads = ("load", "force [N]", "moment about the origin [N m]")
    table = Table(*heads, box=SIMPLE_HEAD, pad_edge=False)
    moving = report.analysis == "dynamics"
    if moving:
        table.add_column("at t [s]", justify="right")
    for load in report.loads:
        time = [f"{load.time:.4g}"] if moving else []
        table.add_row(load.load, _resultant(load.force), _resultant(load.moment), *time)
    return table


def _about_loads(report: Report) -> str:
    at = f"at load parameter {max((load.time for load in report.loads), default=1.0):g}"
    when = "when it is largest in the motion" if report.analysis == "dynamics" else at
    text = f"Loads are summed up on the undeformed body, each {when}."
    if any(load.force is None for load in report.loads):
        text += " Those without numbers depend on more than that body."
    return text


def _contacts(contacts: Sequence[ContactGap], size: Lengths) -> Table:
    heads = ("contact", f"smallest gap at the start [{size.unit}]", f"at [{size.unit}]")
    table = Table(*heads, box=SIMPLE_HEAD, pad_edge=False)
    for row in contacts:
        table.add_row(row.contact, f"{row.gap / size.metres:.4g}", size.place(row.place))
    return table


def _resultant(vector: Sequence[float] | None) -> str:
    """A force or moment; "?" of loads that depend on the deformation."""
    if vector is None:
        return "?"
    return f"{vector[0]:.5g}" if len(vector) == 1 else vector_text(vector) if vector else ""
