"""`plot`: pictures, films and curves of a finished run, without computing it again."""
# ruff: noqa: D301

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from dolfin_elastic.core.errors import InputError, UnitError, nearest
from dolfin_elastic.core.startup.libraries import start

if TYPE_CHECKING:
    from dolfin_elastic.core.types import FloatArray
    from dolfin_elastic.results.finished.curves import Curves
    from dolfin_elastic.results.finished.run import FinishedRun
    from dolfin_elastic.results.scene.appearance import Appearance
    from dolfin_elastic.results.scene.clip import Clip
    from dolfin_elastic.results.scene.scene import Up, View
    from dolfin_elastic.results.scene.series import Limits

_FILMS = (".mp4", ".gif")
_VIEWS: tuple[View, ...] = ("isometric", "x", "y", "z", "-x", "-y", "-z")
_OUTPUT = "png, mp4 or gif; of curves png, csv, svg or pdf."
_NUMBERS = ("history.csv", "modes.csv", "results.csv", "converge.csv", "converge.png")
"""Files of a run with the suffixes of what is written here; its pictures are named in the case."""


def plot(
    folder: Annotated[Path, typer.Argument(metavar="DIR", hidden=True)],
    *,
    field: Annotated[
        list[str] | None,
        typer.Option("--field", "-f", help="Field to show; repeat for pictures side by side."),
    ] = None,
    step: Annotated[
        int, typer.Option("--step", help="Which step: 0 is the first, -1 the last.")
    ] = -1,
    view: Annotated[str, typer.Option("--view", help="isometric, x, y, z, -x, -y or -z.")] = (
        "isometric"
    ),
    up: Annotated[
        str | None,
        typer.Option("--up", help="Vertical axis: x, y or z (default: against gravity)."),
    ] = None,
    scale: Annotated[float, typer.Option("--scale", help="Magnification of displacements.")] = 1.0,
    ends: Annotated[
        str | None, typer.Option("--range", help="Range of the colours: 0:2e8, 2%:98%.")
    ] = None,
    clip: Annotated[
        list[str] | None,
        typer.Option("--clip", help="Cut away x>0.01; with x=0.01 the side in front."),
    ] = None,
    line: Annotated[
        str | None, typer.Option("--line", help="Field along x0,y0,z0:x1,y1,z1.")
    ] = None,
    circle: Annotated[
        str | None,
        typer.Option("--circle", help="Field around x,y,z:radius:axis, from x (about x: y)."),
    ] = None,
    curve: Annotated[
        str | None, typer.Option("--curve", help="Columns of history.csv: x:y, or x:y,z.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", metavar="FILE", help=_OUTPUT),
    ] = None,
    fps: Annotated[float, typer.Option("--fps", help="Frames a second of a film.")] = 30.0,
    speed: Annotated[
        float | None, typer.Option("--speed", help="Time [s] in a second of a film.")
    ] = None,
    plain: Annotated[bool, typer.Option("--plain", help="Draw the body alone.")] = False,
    listing: Annotated[bool, typer.Option("--list", help="List what there is to plot.")] = False,
) -> None:
    """Draw a finished run: pictures, films, curves.

    \b
      dolfin-elastic plot beam_results --list
      dolfin-elastic plot beam_results --field von_mises --clip y=0.005
      dolfin-elastic plot beam_results --field von_mises --field displacement --output both.png
      dolfin-elastic plot beam_results --output film.mp4 --fps 60 --speed 0.1
      dolfin-elastic plot beam_results --curve tip_x:reaction_left_x
      dolfin-elastic plot beam_results --line 0,0,0:0.1,0,0 --field von_mises --output line.csv

    Places are those of the undeformed body in metres.  Curves are drawn, and written as CSV beside
    the picture.

    \f
    Raises:
        InputError: Something of it is not there, or cannot be read.
    """
    start()
    from mpi4py import MPI

    from dolfin_elastic.core.parallel import on_root
    from dolfin_elastic.results.finished import draw  # noqa: F401
    from dolfin_elastic.results.finished.run import FinishedRun

    limits = None if ends is None else _limits(ends)

    def work() -> None:
        run = FinishedRun(folder)
        given = [n for n, v in (("line", line), ("circle", circle), ("curve", curve)) if v]
        if listing:
            _show(run)
        elif len(given) > 1:
            raise InputError(
                f"--{given[0]} and --{given[1]} are given together", expected="one of them"
            )
        elif given:
            if curve is not None:
                result = _history(run, curve)
            else:
                result = _along(run, field, step, line=line, circle=circle)
            file = output or folder / f"plot_{given[0]}.png"
            _write_curves(run, result, file, f"--{given[0]}")
        else:
            seen_from = _view(view)
            check_positive("--scale", scale, "--scale 20", zero=True)
            look = _look(seen_from, _axis(up), scale, limits, clip, plain=plain)
            _draw(run, _fields(run, field, step), look, step, output, fps, speed)

    on_root(MPI.COMM_WORLD, work)


def _draw(
    run: FinishedRun,
    fields: list[str],
    look: Appearance,
    step: int,
    output: Path | None,
    fps: float,
    speed: float | None,
) -> None:
    from dolfin_elastic.results.finished.draw import draw, film
    from dolfin_elastic.results.outputs import check_frames

    file = output or run.folder / f"plot_{'_'.join(fields)}.png"
    _check_apart(run, file)
    # Also of a picture, for which they are nothing: who gives them expects them to be obeyed.
    check_positive("--fps", fps, "--fps 25")
    if speed is not None:
        check_positive("--speed", speed, "--speed 0.1")
    if file.suffix == ".gif":
        check_frames(fps, "--fps")
    if file.suffix in _FILMS:
        look = replace(look, marks=False)
        film(run, fields, look, file, fps=fps, speed=speed or (1.0 if run.timed else 0.2))
    elif file.suffix == ".png":
        draw(run, fields, look, file, step)
    else:
        raise InputError(
            f"'{file.name}' is neither picture nor film",
            where="--output",
            expected="a name that ends in .png, .mp4 or .gif; curves (--line, --circle, --curve) "
            "also in .csv, .svg or .pdf",
        )
    print(f"{file} written")


def _look(
    view: View,
    up: Up | None,
    scale: float,
    limits: Limits | None,
    clip: list[str] | None,
    *,
    plain: bool,
) -> Appearance:
    from dolfin_elastic.results.scene.appearance import Appearance
    from dolfin_elastic.results.scene.series import Limits

    return Appearance(
        scale,
        view,
        limits=limits or Limits(),
        marks=not plain,
        obstacles=not plain,
        bare=plain,
        clips=[_clip(text) for text in clip or ()],
        up=up,
    )


def check_positive(option: str, value: float, example: str, *, zero: bool = False) -> None:
    """Refuses numbers that are no size of anything: below 0, without end, nan.

    Args:
        zero: 0 is right, too.
    """
    if value < 0 or (value == 0 and not zero) or not isfinite(value):
        least = "not below 0" if zero else "above 0"
        raise InputError(
            f"a finite number {least} is needed, not {value:g}",
            where=option,
            expected=f"for example {example}",
        )


def _view(name: str) -> View:
    for view in _VIEWS:
        if name == view:
            return view
    raise InputError(f"there is no view '{name}'", where="--view", expected=nearest(name, _VIEWS))


def _axis(name: str | None) -> Up | None:
    from dolfin_elastic.results.scene.scene import AXES

    for axis in AXES:
        if name == axis:
            return axis
    if name is not None:
        raise InputError(f"'{name}' is no axis", where="--up", expected="x, y or z")
    return None


def _limits(text: str) -> Limits:
    from dolfin_elastic.results.outputs import limits_of

    try:
        return limits_of([part.strip() for part in text.split(":")])
    except InputError as error:
        raise InputError(
            error.what, where="--range", expected="for example 0:2e8, '0:200 MPa' or 2%:98%"
        ) from None


def fixed_limits(text: str) -> tuple[float, float]:
    """Ends of the colours [SI] that do not follow from the values.

    Raises:
        InputError: They are none, or percentiles.
    """
    limits = _limits(text)
    if limits.share or limits.ends is None:
        raise InputError(
            "percentiles are for pictures and films", where="--range", expected="for example 0:2e8"
        )
    return limits.ends


def _fields(run: FinishedRun, given: Sequence[str] | None, step: int) -> list[str]:
    """The fields that are asked for; else the von Mises stress, or the first there is."""
    if given:
        return list(given)
    known = run.fields(step)
    if not known:
        raise InputError(
            "the step holds no fields",
            where=str(run.folder),
            expected="name fields in output.fields and compute again",
        )
    return ["von_mises" if "von_mises" in known else known[0]]


def _clip(text: str) -> Clip:
    from dolfin_elastic.core.units import to_si
    from dolfin_elastic.results.scene.clip import Clip

    expected = "for example x=0.01 or x<0.01 [m], or 'x=10 mm'"
    for sign in ("=", ">", "<"):
        axis, separator, number = text.partition(sign)
        if separator and axis.strip() in ("x", "y", "z"):
            above = {"=": None, ">": True, "<": False}[sign]
            try:
                return Clip("xyz".index(axis.strip()), to_si(number.strip(), "m"), above)
            except UnitError as error:
                what = f"'{text}' is no plane: {error.what}"
                raise InputError(what, where="--clip", expected=expected) from None
    raise InputError(f"'{text}' is no plane", where="--clip", expected=expected)


def _numbers(run: FinishedRun, text: str, where: str, expected: str) -> list[float]:
    """A place of the body or a direction, with a third coordinate of 0 in a plane."""
    try:
        result = [float(part) for part in text.split(",")]
    except ValueError:
        result = []
    if len(result) not in (run.dim, 3) or not all(isfinite(x) for x in result):
        raise InputError(
            f"'{text}' is no point in {run.dim} dimensions", where=where, expected=expected
        )
    return [*result, 0.0][:3]


def _along(
    run: FinishedRun,
    field: list[str] | None,
    step: int,
    *,
    line: str | None,
    circle: str | None,
) -> Curves:
    from dolfin_elastic.results.finished import curves

    if line is not None:
        expected = "for example 0,0,0:0.1,0,0 [m]"
        parts = line.split(":")
        if len(parts) != 2:
            raise InputError(f"'{line}' is no line", where="--line", expected=expected)
        points, over = curves.line(*(_numbers(run, part, "--line", expected) for part in parts))
        axis = curves.Axis("distance", over, "m")
    else:
        assert circle is not None
        points, over = _circle(run, circle)
        axis = curves.Axis("angle", over, "rad")
    return curves.along(run, _fields(run, field, step), points, axis, step)


def _circle(run: FinishedRun, text: str) -> tuple[FloatArray, FloatArray]:
    from dolfin_elastic.results.finished import curves

    expected = "for example 0,0,0:0.005:z [m], the axis x, y, z or a vector"
    parts = [*text.split(":"), "z"][:3]
    try:
        centre, radius = _numbers(run, parts[0], "--circle", expected), float(parts[1])
    except (ValueError, IndexError):
        raise InputError(f"'{text}' is no circle", where="--circle", expected=expected) from None
    if parts[2] in ("x", "y", "z"):
        normal = [float(name == parts[2]) for name in "xyz"]
    else:
        normal = _numbers(run, parts[2], "--circle", expected)
    if not 0 < radius < float("inf") or not any(normal):
        raise InputError(f"'{text}' is no circle", where="--circle", expected=expected)
    return curves.circle(centre, radius, normal)


def _history(run: FinishedRun, text: str) -> Curves:
    from dolfin_elastic.results.finished.curves import history_curves

    over, separator, names = text.partition(":")
    if not run.history:
        raise InputError(
            "it holds no history.csv",
            where=str(run.folder),
            expected="a run of [statics] or [dynamics]",
        )
    if not separator or not names:
        over, names = "t", text
    return history_curves(run, over, names.split(","))


def _check_apart(run: FinishedRun, *files: Path) -> None:
    """Refuses to write over files of the run itself."""
    rows = (run.case.get("output") or {}).get("pictures") or []
    pictures = [Path(str(row.get("file", "picture.png"))) for row in rows]
    series = [rf"{re.escape(p.stem)}(_\d{{4,}})?{re.escape(p.suffix)}" for p in pictures]
    for file in files:
        if file.parent.resolve() == run.folder.resolve() and (
            file.name in _NUMBERS or any(re.fullmatch(one, file.name) for one in series)
        ):
            raise InputError(
                f"{file} is a file of the run, which this would overwrite",
                where="--output",
                expected="another name",
            )


def _write_curves(run: FinishedRun, curves: Curves, file: Path, option: str) -> None:
    from dolfin_elastic.results.finished.curves import draw_curves, write_csv

    if file.suffix not in (".png", ".svg", ".pdf", ".csv"):
        raise InputError(
            f"'{file.name}' is no picture of a curve",
            where="--output",
            expected="a name that ends in .png, .svg, .pdf, or .csv for the table alone",
        )
    units = {curve.unit or "1" for curve in curves.curves}
    if len(units) > 2 and file.suffix != ".csv":
        raise InputError(
            f"the curves have {len(units)} units: {', '.join(sorted(units))}",
            where=option,
            expected="at most two in a picture; a table (--output NAME.csv) holds any number",
        )
    table = file.with_suffix(".csv")
    _check_apart(run, table, file)
    write_csv(curves, table)
    if file.suffix != ".csv":
        draw_curves(curves, file)
        print(f"{file} written, the numbers in {table}")
    else:
        print(f"{file} written")


def _show(run: FinishedRun) -> None:
    """Prints what there is to plot."""
    from textwrap import fill

    what = "times [s]" if run.timed else "load parameters"
    rows = {
        "fields": ", ".join(run.fields()) if run.frames else "none",
        f"steps ({len(run.steps)})": _few([f"{t:g}" for t in run.steps]) + f"  {what}",
        "columns": ", ".join(f"{n} [{u}]" if u else n for n, u in run.units.items()) or "none",
    }
    for name, text in rows.items():
        print(fill(text, 98, initial_indent=f"{name:<12} ", subsequent_indent=13 * " "))


def _few(texts: Sequence[str]) -> str:
    shown = texts if len(texts) <= 10 else [*texts[:4], "...", *texts[-2:]]
    return ", ".join(shown)
