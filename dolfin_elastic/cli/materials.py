"""The commands about materials: `material` and `materials`."""
# ruff: noqa: D301

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from dolfin_elastic.core.errors import CaseError


def material(
    context: typer.Context,
    what: Annotated[str, typer.Argument(metavar="FILE|LAW", hidden=True)],
    *,
    only: Annotated[
        str | None, typer.Option("--material", metavar="NAME", help="One material of the file.")
    ] = None,
    stretch: Annotated[
        float,
        typer.Option("--stretch", help="Largest stretch of the curves (2).", show_default=False),
    ] = 2.0,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="DIR", help="Write curves (CSV, PNG) here."),
    ] = None,
    json: Annotated[bool, typer.Option("--json", help="As JSON, for scripts.")] = False,
) -> None:
    """Try a material on the bench, before there is any mesh.

    \b
      dolfin-elastic material case.toml
      dolfin-elastic material case.toml --material gel --output bench
      dolfin-elastic material neo-hookean --E '10 MPa' --nu 0.45

    Checks what every material must keep, says how far it goes, and draws its curves: uniaxial,
    equibiaxial, planar, simple shear, volumetric.
    """
    from mpi4py import MPI

    # On all ranks: PETSc starts with it, which is collective.
    from dolfin_elastic.case.material_report import constants_of
    from dolfin_elastic.core.parallel import on_root

    constants = constants_of(context.args)
    on_root(MPI.COMM_WORLD, lambda: _bench(what, only, constants, stretch, output, json))


def materials(
    json: Annotated[bool, typer.Option("--json", help="As JSON, for scripts.")] = False,
) -> None:
    """List the material laws, and typical constants with their sources."""
    from dataclasses import asdict

    from dolfin_elastic.case.material_report import listed
    from dolfin_elastic.cli.console import console
    from dolfin_elastic.cli.console_materials import as_json, show_laws
    from dolfin_elastic.material_point.library import TYPICAL_MATERIALS

    if json:
        print(as_json({"laws": listed(), "typical": [asdict(item) for item in TYPICAL_MATERIALS]}))
    else:
        show_laws(console(), listed(), TYPICAL_MATERIALS)


def _bench(
    what: str,
    only: str | None,
    constants: dict[str, Any],
    stretch: float,
    output: Path | None,
    json: bool,
) -> None:
    """Tries materials and shows what was found; rank 0 only."""
    from dolfin_elastic.case.case import located
    from dolfin_elastic.case.material_report import laws_of, write
    from dolfin_elastic.cli.console import console
    from dolfin_elastic.cli.console_materials import as_json, bench_table, show_bench
    from dolfin_elastic.material_point.report import material_report

    laws, tables, failed = laws_of(what, constants, only), {}, ""
    for name, law in laws.items():
        with located(what if name == what else f"{what}: materials.{name}"):
            found = material_report(law, largest=stretch)
        files = write(name, found, output) if output else []
        tables[name] = bench_table(found)
        if not json:
            show_bench(console(), name, found, files)
        if found.failed:
            failed = failed or f"{name}: {found.failed[0].check}: {found.failed[0].text}"
    if json:
        print(as_json(tables))
    if failed:
        raise CaseError(failed, where=what)
