"""The commands about materials: `material` and `materials`."""
# ruff: noqa: D301

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from dolfin_elastic.core.errors import CaseError
from dolfin_elastic.core.startup.libraries import start


def material(
    context: typer.Context,
    what: Annotated[str | None, typer.Argument(metavar="FILE|LAW|MATERIAL", hidden=True)] = None,
    *,
    only: Annotated[
        str | None,
        typer.Option("--material", metavar="NAME", help="Only this material of the file."),
    ] = None,
    stretch: Annotated[
        float | None,
        typer.Option("--stretch", help="Largest stretch of the curves (2; 1.02 if stiff)."),
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="DIR", help="Write curves (CSV, PNG) here."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")] = False,
) -> None:
    """Test a material at a point, before there is any mesh.

    \b
      dolfin-elastic material case.toml
      dolfin-elastic material case.toml --material gel --output bench
      dolfin-elastic material neo-hookean --E '10 MPa' --nu 0.45
      dolfin-elastic material 'steel S235'      one of the library
      dolfin-elastic material                   list the library

    Checks what every material must keep, says how far it goes, and draws its curves: uniaxial,
    equibiaxial, planar, simple shear, volumetric; of metals that yield a few cycles; of
    materials that take time relaxation, creep and cycles.
    """
    start()
    from mpi4py import MPI

    from dolfin_elastic.case.material_report import read_constants
    from dolfin_elastic.cli.console import console
    from dolfin_elastic.cli.console_materials import show_library
    from dolfin_elastic.core.parallel import on_root

    if what is None:
        show_library(console())
        return
    constants = read_constants(context.args)
    on_root(MPI.COMM_WORLD, lambda: _test_materials(what, only, constants, stretch, output, json))


def materials(
    json: Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")] = False,
) -> None:
    """List the material laws, and the materials of the library with their sources."""
    from dolfin_elastic.case.material_report import law_table
    from dolfin_elastic.cli.console import console
    from dolfin_elastic.cli.console_materials import as_json, show_laws, show_library
    from dolfin_elastic.model.materials.library import library

    if json:
        print(as_json({"laws": law_table(), "library": library()}))
    else:
        show_laws(console(), law_table())
        show_library(console())


def _test_materials(
    what: str,
    only: str | None,
    constants: dict[str, object],
    stretch: float | None,
    output: Path | None,
    json: bool,
) -> None:
    """Tests materials and prints the results. On rank 0."""
    from dolfin_elastic.case.case import locate_errors
    from dolfin_elastic.case.material_report import read_laws, usual_stretch, write
    from dolfin_elastic.cli.console import console
    from dolfin_elastic.cli.console_materials import (
        as_json,
        report_table,
        show_library,
        show_report,
    )
    from dolfin_elastic.model.materials.registry import MATERIALS
    from dolfin_elastic.model.point.report import material_report

    laws, tables, failed = read_laws(what, constants, only), {}, ""
    if not json and not what.endswith(".toml") and what not in MATERIALS:
        show_library(console(), *laws)
    for name, law in laws.items():
        with locate_errors(f"{what}: materials.{name}" if what.endswith(".toml") else what):
            largest = usual_stretch(law) if stretch is None else stretch
            report = material_report(law, largest=largest)
        files = write(name, report, output) if output else []
        tables[name] = report_table(report)
        if not json:
            show_report(console(), name, report, files)
        if report.failed:
            failed = failed or f"{name}: {report.failed[0].check}: {report.failed[0].text}"
    if json:
        print(as_json(tables))
    if failed:
        raise CaseError(failed, where=what)
