"""The command `fit`: its options, its tables, and its exit code."""
# ruff: noqa: D301

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

import typer

from dolfin_elastic.cli.fit_case import (
    INTERVAL,
    CaseFit,
    check_of_case,
    constant_rows,
    refuse_earlier,
    show_rows,
)
from dolfin_elastic.cli.run import Output
from dolfin_elastic.core.errors import CaseError, SolveError, check_kept, nearest
from dolfin_elastic.core.startup.libraries import start

if TYPE_CHECKING:
    from dolfin_elastic.study.fit.fit import Fit

Files: TypeAlias = list[Path] | None
Texts: TypeAlias = list[str] | None


def fit(
    law: Annotated[Path, typer.Argument(metavar="LAW", hidden=True)],
    *,
    uniaxial: Annotated[
        Files, typer.Option("--uniaxial", metavar="CSV", help="Tension or compression of a bar.")
    ] = None,
    equibiaxial: Annotated[
        Files, typer.Option("--equibiaxial", metavar="CSV", help="A sheet pulled both ways.")
    ] = None,
    planar: Annotated[
        Files, typer.Option("--planar", metavar="CSV", help="A wide sheet pulled one way.")
    ] = None,
    shear: Annotated[Files, typer.Option("--shear", metavar="CSV", help="Simple shear.")] = None,
    volumetric: Annotated[
        Files, typer.Option("--volumetric", metavar="CSV", help="Volume ratio and pressure.")
    ] = None,
    relaxation: Annotated[
        Files,
        typer.Option("--relaxation", metavar="CSV", help="Time, stress and the stretch held."),
    ] = None,
    cyclic: Annotated[
        Files, typer.Option("--cyclic", metavar="CSV", help="A bar strained to and fro.")
    ] = None,
    measured: Annotated[
        Files,
        typer.Option("--measured", metavar="CSV", help="Curve or displacements of a whole part."),
    ] = None,
    of: Annotated[
        Texts, typer.Option("--of", metavar="X:Y", help='What it is: "t:reaction_x of top".')
    ] = None,
    vary: Annotated[
        Texts, typer.Option("--vary", metavar="KEY", help="Value of the case that is sought.")
    ] = None,
    field: Annotated[
        str | None,
        typer.Option("--field", metavar="KEY", help="Constant that is sought in each element."),
    ] = None,
    noise: Annotated[
        str | None,
        typer.Option("--noise", metavar="LENGTH", help='Scatter of displacements: "2 um".'),
    ] = None,
    smooth: Annotated[
        float | None, typer.Option("--smooth", metavar="A", help="Weight of jumps of --field.")
    ] = None,
    penalty: Annotated[
        str, typer.Option("--penalty", metavar="KIND", help="tv allows edges, tikhonov none.")
    ] = "tv",
    unit: Annotated[
        str | None,
        typer.Option("--unit", help="Unit of stresses without one in their heading, else Pa."),
    ] = None,
    true: Annotated[bool, typer.Option("--true", help="Stresses are Cauchy's.")] = False,
    weight: Annotated[
        Texts,
        typer.Option("--weight", metavar="TEST=W", help="Of a test or a file: uniaxial=2."),
    ] = None,
    fix: Annotated[
        Texts, typer.Option("--fix", metavar="NAME", help="A constant that keeps its value.")
    ] = None,
    bounds: Annotated[
        Texts,
        typer.Option("--bounds", metavar="NAME=LOW:HIGH", help='Range: "mu=0.1 MPa:10 MPa".'),
    ] = None,
    only: Annotated[
        str | None,
        typer.Option("--material", metavar="NAME", help="Only this material of the file."),
    ] = None,
    starts: Annotated[
        int | None, typer.Option("--starts", min=1, metavar="N", help="Largest number of starts.")
    ] = None,
    steps: Annotated[
        int, typer.Option("--steps", min=1, metavar="N", help="Largest number of steps from each.")
    ] = 400,
    stable: Annotated[
        bool, typer.Option("--stable", help="A law that is stable over the range of the tests.")
    ] = False,
    output: Output = None,
    force: Annotated[bool, typer.Option("--force", help="Overwrite an earlier fit.")] = False,
    json: Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")] = False,
) -> None:
    """Fit the constants of a material, or values of a whole case, to what was measured.

    \b
      dolfin-elastic fit law.toml --uniaxial a.csv --equibiaxial b.csv --unit MPa
      dolfin-elastic fit law.toml --uniaxial a.csv --fix nu --bounds "mu=0.1 MPa:10 MPa"
      dolfin-elastic fit law.toml --relaxation r.csv --weight relaxation=2
      dolfin-elastic fit law.toml --uniaxial a.csv --stable --output stable
      dolfin-elastic fit case.toml --measured curve.csv --of "t:reaction_x of top" \\
                                   --vary materials.rubber.mu

    LAW is a case file, of which nothing but [materials] is read, or a law's table alone.  Its
    numbers are starting values; mu = "fit" has none.  Files have columns of stretch (or strain)
    and nominal stress, which their headings name: "stress [MPa]".  Prints constants with
    intervals of 95 %, what the tests do not tell, and a table [materials.NAME] that `run` reads;
    it, a picture and tables go to LAW_fitted.  Exit code 3: the search has not ended.

    With --measured the whole case is run again and again.  KEY is as `sweep --set` takes it; X and
    Y are results as `sweep --tell` takes them, t is the load parameter or time.  Headings may name
    them.  A file with columns x, y and ux, uy has displacements at points.  --field finds a
    constant of a material in each element from such files.
    """
    start()
    from mpi4py import MPI

    from dolfin_elastic.case.case import locate_errors
    from dolfin_elastic.core.parallel import on_root
    from dolfin_elastic.study.fit.fit import fit_curves, read_curves, start_of
    from dolfin_elastic.study.fit.written import files_of

    files = {
        "uniaxial": uniaxial,
        "equibiaxial": equibiaxial,
        "planar": planar,
        "shear": shear,
        "volumetric": volumetric,
        "relaxation": relaxation,
        "cyclic": cyclic,
    }
    limits = _pairs("--bounds", bounds)
    data = {kind: paths for kind, paths in files.items() if paths}
    if measured or vary or of or field:
        others = {"unit": unit, "true": true, "fix": fix, "material": only, "stable": stable}
        check_of_case(
            [name for name, given in {**files, **others}.items() if given], measured or []
        )
        begun = CaseFit(law, measured or [], limits, _weights(weight), steps, output, force, json)
        if field is not None:
            begun.find_field(field, vary or [], noise=noise, smooth=smooth, penalty=penalty)
        else:
            begun.find_values(vary or [], of or [], starts or 1)
        return
    folder = output if output is not None else Path(f"{law.stem}_fitted")

    def on_one_rank() -> None:
        name, table = _read_law(law, only)
        check_kept(folder, "--output")
        if not force:
            refuse_earlier(files_of(name, folder))
        curves = read_curves(data, _weights(weight), unit=unit, true=true)
        with locate_errors(f"{law}: materials.{name}"):
            begun = start_of(table, curves)
        result = fit_curves(
            begun,
            curves,
            fix=fix or [],
            bounds=limits,
            starts=starts,
            evaluations=steps,
            stable=stable,
        )
        _show(name, result, folder, json)

    on_root(MPI.COMM_WORLD, on_one_rank)


def _read_law(file: Path, only: str | None) -> tuple[str, Mapping[str, object]]:
    """Name and table of the material that is fitted."""
    from dolfin_elastic.case.case import locate_errors
    from dolfin_elastic.case.curve_files import with_series
    from dolfin_elastic.case.toml import read_toml

    tables: Mapping[str, object] = read_toml(str(file))
    if "law" in tables or "energy" in tables:
        tables = {"materials": {only or file.stem: tables}}
    with locate_errors(str(file)):
        tables = with_series(tables, file.parent)
    materials = tables.get("materials")
    rows = {
        name: row
        for name, row in (materials.items() if isinstance(materials, Mapping) else ())
        if isinstance(row, Mapping)
    }
    if not rows:
        raise CaseError(
            "there is no material",
            where=str(file),
            expected="a table [materials.NAME], or law = ...",
        )
    if only is None and len(rows) > 1:
        raise CaseError(
            f"there are several materials: {', '.join(rows)}",
            where=str(file),
            expected="name one by --material",
        )
    name = next(iter(rows)) if only is None else only
    if name not in rows:
        raise CaseError(
            f"there is no material '{name}'", where=str(file), expected=nearest(name, rows)
        )
    return name, rows[name]


def _pairs(option: str, texts: Texts) -> dict[str, str]:
    """``["mu=1:2"]`` as a dictionary."""
    result = {}
    for text in texts or []:
        name, equals, value = text.partition("=")
        if not equals or not value:
            raise CaseError(f"'{text}' is no NAME=VALUE", where=option)
        result[name.strip()] = value.strip()
    return result


def _weights(texts: Texts) -> dict[str, float]:
    """``["uniaxial=2"]`` as a dictionary."""
    result = {}
    for kind, text in _pairs("--weight", texts).items():
        try:
            result[kind] = float(text)
        except ValueError:
            raise CaseError(
                f"{kind}: '{text}' is no weight", where="--weight", expected="a number above 0"
            ) from None
    return result


def _show(name: str, fit: Fit, folder: Path, json: bool) -> None:
    """Prints and writes a fit.

    Raises:
        SolveError: It has not ended.
    """
    from dolfin_elastic.cli.console import console
    from dolfin_elastic.cli.console_materials import as_json
    from dolfin_elastic.study.fit.written import material_toml, write_fit

    files = write_fit(name, fit, folder)
    if json:
        print(as_json(_plain(fit)))
    else:
        screen = console()
        screen.print(name, style="bold")
        _tables(fit)
        for line in (*fit.unknown, *fit.stability, *fit.notes):
            screen.tell(line)
        screen.print()
        print(material_toml(name, fit))
        screen.print(f"written: {folder}: {', '.join(f.name for f in files)}")
    if not fit.ended:
        raise SolveError(
            f"the fit has not ended: {fit.why}; the best so far is written",
            advice="more --steps or --starts, --bounds, or --fix what the tests do not tell",
        )


def _tables(fit: Fit) -> None:
    """Prints constants and errors."""
    from dolfin_elastic.core.si_text import percent
    from dolfin_elastic.study.least_squares.fitted import error_text

    # Constants that a condition holds scatter less than the curves alone would let them.
    which = f"{INTERVAL}, without the condition" if fit.condition else INTERVAL
    show_rows(("constant", "value", which), constant_rows(fit.constants))
    show_rows(
        ("test", "points", "r.m.s. error", "of the largest stress"),
        (
            (
                curve.measured.kind,
                str(len(curve.stress)),
                error_text(curve.rms, curve.relative, "Pa"),
                percent(curve.relative),
            )
            for curve in fit.curves
        ),
    )


def _plain(fit: Fit) -> dict[str, object]:
    """A fit as plain values, for scripts."""
    return {
        "ended": fit.ended,
        "why": fit.why,
        "constants": {
            row.name: {
                "value": row.value,
                "unit": row.unit,
                "interval": list(row.interval),
                "held": row.held,
            }
            for row in fit.constants
        },
        "condition": fit.condition,
        "correlation": {
            "names": [row.name for row in fit.fitted],
            "matrix": fit.correlation.tolist(),
        },
        "tests": [
            {
                "test": curve.measured.kind,
                "rms": curve.rms,
                "relative": curve.relative,
                "fitted": curve.stress.tolist(),
            }
            for curve in fit.curves
        ],
        "unknown": list(fit.unknown),
        "stability": list(fit.stability),
        "notes": list(fit.notes),
    }
