"""Materials of a case file or by name, and the files of their tests at a material point."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from dolfin_elastic.case.case import locate_errors, read_materials
from dolfin_elastic.case.tables import Material
from dolfin_elastic.core.errors import CaseError, InputError, nearest
from dolfin_elastic.core.schema import known_keys
from dolfin_elastic.core.startup.elsewhere import plain_matplotlib
from dolfin_elastic.core.types import FloatArray
from dolfin_elastic.core.units import stress_unit
from dolfin_elastic.model.materials.law import Law
from dolfin_elastic.model.materials.library import alike, in_words, library
from dolfin_elastic.model.materials.plasticity import Plastic
from dolfin_elastic.model.materials.registry import MATERIALS
from dolfin_elastic.model.point.cyclic_curve import CyclicCurve
from dolfin_elastic.model.point.homogeneous_tests import ResponseCurve
from dolfin_elastic.model.point.report import MaterialReport
from dolfin_elastic.model.point.time_curves import TimeCurves
from dolfin_elastic.model.point.viscous_curves import ViscousCurves
from dolfin_elastic.results.files import drafted, make_folder, replace_text

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_PARTS = ("11", "22", "33", "12", "13", "23")

_STRETCH = 2.0
_STIFF = 1.02
"""Largest stretch of the curves of a material that is stiffer than `_HARD`."""
_YIELD_STRAINS = 10.0
"""The same of a metal, over its strain at yield: the curves show how it hardens."""
_HARD = 5e8
"""Young's modulus [Pa] between soft and stiff materials: metals, wood and bone lie above it,
rubbers and tissues below."""


def usual_stretch(law: Law) -> float:
    """Largest stretch of a law's curves: stiff solids bear little of it."""
    from dolfin_elastic.problem.material_regions import young

    if isinstance(law, Plastic) and law.first_yield is not None and isinstance(law.E, float):
        return 1 + _YIELD_STRAINS * law.first_yield / law.E
    try:
        return _STIFF if young(law) > _HARD else _STRETCH
    except (TypeError, ValueError, AttributeError):
        return _STRETCH


def read_laws(
    what: str, constants: Mapping[str, object], only: str | None = None
) -> dict[str, Law]:
    """The materials of a case file, or one law with constants from the command line.

    Not collective.

    Args:
        what: A case file, of which nothing but [materials] is read, or the name of a law or of a
            material of the library.
        constants: Name to value as written, for these.
        only: Name of the one material of the file that is wanted.

    Raises:
        InputError: There is no such file, law or material, or a value is wrong.
    """
    if what in MATERIALS:
        with locate_errors(what):
            return {what: MATERIALS[what](**constants)}
    if not what.endswith(".toml") and not Path(what).is_file():
        try:
            name = in_words(what)[0]
        except InputError:
            near = nearest(what, MATERIALS)
            near = alike(what, library()) if near.startswith("known: ") else near
            raise CaseError(
                f"'{what}' is neither a case file, nor a law, nor a material of the library",
                expected=near,
            ) from None
        with locate_errors(what):
            return {name: Material.read({"material": name, **constants}).law}
    if constants:
        raise CaseError(
            f"--{next(iter(constants))} is a constant of a law, and this is a case file",
            where=what,
            expected="write it in the file",
        )
    laws = {name: material.law for name, material in read_materials(what).items()}
    if only is not None and only not in laws:
        raise CaseError(f"there is no material '{only}'", where=what, expected=nearest(only, laws))
    return laws if only is None else {only: laws[only]}


def read_constants(words: Sequence[str]) -> dict[str, object]:
    """``["--E", "10 MPa", "--nu=0.3"]`` as a dictionary; a value in brackets is a list.

    Raises:
        InputError: A word is no option, or an option has no value.
    """
    result: dict[str, object] = {}
    rest = list(words)
    while rest:
        word = rest.pop(0)
        name, equals, value = word.removeprefix("--").partition("=")
        if not word.startswith("--") or not name:
            raise CaseError(f"'{word}' is no option", expected="write --E '10 MPa'")
        if not equals and not rest:
            raise CaseError(f"--{name} has no value", expected=f"write --{name} VALUE")
        result[name] = _value(name, value if equals else rest.pop(0))
    return result


def _value(name: str, text: str) -> object:
    if not text.startswith("["):
        return text
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        raise CaseError(f"--{name}: {text} is no list", expected="for example [1, 0, 0]") from None


def law_table() -> list[dict[str, object]]:
    """Every law with formula, parameters and source, from the docstring of its class."""
    return [
        {
            "law": name,
            "what": _summary_and_formula(kind)[0],
            "formula": _summary_and_formula(kind)[1],
            "parameters": _parameters(kind),
            "source": _source(kind),
        }
        for name, kind in MATERIALS.items()
    ]


def _paragraphs(kind: type[Law]) -> list[str]:
    text = (kind.__doc__ or "").split("Attributes:")[0]
    return [" ".join(part.split()) for part in text.split("\n\n") if part.strip()]


def _summary_and_formula(kind: type[Law]) -> tuple[str, str]:
    """First line of a class's docstring, and its first sentence with an equation."""
    first, *others = _paragraphs(kind) or [""]
    with_equation = [part for part in others if "=" in part and not part.startswith("Source")]
    formula = with_equation[0] if with_equation else ""
    return first, formula.split(". ")[0].rstrip(".")


def _source(kind: type[Law]) -> str:
    texts = [part for part in _paragraphs(kind) if part.startswith("Source:")]
    return texts[0].removeprefix("Source:").strip() if texts else ""


def _parameters(kind: type[Law]) -> dict[str, str]:
    """Name of each key to its text under `Attributes:` in the class or its bases."""
    texts: dict[str, str] = {}
    for base in reversed(kind.__mro__):
        _, _, attributes = (base.__dict__.get("__doc__") or "").partition("Attributes:")
        for line in attributes.splitlines():
            name, colon, text = line.strip().partition(": ")
            if colon and name.isidentifier():
                texts[name] = text
    names = [name for name in kind.model_fields if name not in ("law", "density")]
    return {name: texts.get(name, "") for name in names if name in known_keys(kind)}


# --- what is written ---


def write(name: str, report: MaterialReport, folder: Path) -> list[Path]:
    """Writes a CSV file for each curve, and one picture of all; of what relaxes or yields another.

    Not collective.

    Args:
        name: Of the material; begins the files' names.
        folder: Where the files go; made if missing.

    Returns:
        The files.

    Raises:
        OutputError: Something cannot be written.
    """
    make_folder(folder)
    paths = []
    for mode, curve in report.curves.items():
        paths.append(folder / f"{_file_name(name)}_{mode}.csv")
        replace_text(paths[-1], table(curve))
    if report.curves:
        paths.append(folder / f"{_file_name(name)}.png")
        _draw(name, report, paths[-1])
    if report.viscous is not None:
        paths += _write_viscous(folder / f"{_file_name(name)}", report.viscous)
    if report.over_time is not None:
        paths += _write_over_time(folder / f"{_file_name(name)}", report.over_time)
    if report.cyclic is not None:
        paths += _write_cyclic(folder / f"{_file_name(name)}", report.cyclic)
    return paths


def _write_viscous(begin: Path, curves: ViscousCurves) -> list[Path]:
    """Two tables and a picture of what relaxes.

    Args:
        begin: Of the files' names, with their folder.
    """
    over_time = {"time": curves.t, "relative": curves.relaxation}
    over_frequency = {
        "omega": curves.omega,
        "storage": curves.storage,
        "loss": curves.loss,
        "loss_factor": curves.loss_factor,
    }
    if curves.mu is not None:
        over_time["mu"] = curves.mu * curves.relaxation
        over_frequency["storage_mu"] = curves.mu * curves.storage
        over_frequency["loss_mu"] = curves.mu * curves.loss
    paths = []
    for what, columns in (("relaxation", over_time), ("oscillation", over_frequency)):
        paths.append(begin.with_name(f"{begin.name}_{what}.csv"))
        replace_text(paths[-1], _columns(columns))
    paths.append(begin.with_name(f"{begin.name}_relaxation.png"))
    _draw_viscous(curves, paths[-1])
    return paths


def _write_over_time(begin: Path, curves: TimeCurves) -> list[Path]:
    """Tables and a picture of relaxation and creep, and of loops, under uniaxial stress.

    Args:
        begin: Of the files' names, with their folder.
    """
    loops = {
        "frequency": np.repeat([x.frequency for x in curves.loops], len(curves.loops[0].stretch)),
        "stretch": np.concatenate([loop.stretch for loop in curves.loops]),
        "nominal_stress": np.concatenate([loop.nominal for loop in curves.loops]),
    }
    held = {"time": curves.t, "nominal_stress_held": curves.relaxation, "stretch": curves.creep}
    paths = []
    for what, columns in (("creep", held if len(curves.t) else {}), ("loops", loops)):
        if columns:
            paths.append(begin.with_name(f"{begin.name}_{what}.csv"))
            replace_text(paths[-1], _columns(columns))
    paths.append(begin.with_name(f"{begin.name}_loops.png"))
    _draw_over_time(curves, paths[-1])
    return paths


def _columns(columns: Mapping[str, FloatArray]) -> str:
    """Columns of equal length by name, as CSV."""
    rows = np.column_stack(list(columns.values()))
    lines = [",".join(f"{value:.12g}" for value in row) for row in rows]
    return "\n".join([",".join(columns), *lines]) + "\n"


def _write_cyclic(begin: Path, curve: CyclicCurve) -> list[Path]:
    """A table and a picture of the cycles of a metal.

    Args:
        begin: Of the files' names, with their folder.
    """
    columns = {
        "stretch": curve.stretch,
        "lateral_stretch": curve.lateral,
        "strain": curve.strain,
        "stress": curve.stress,
        "nominal_stress": curve.nominal,
        "cauchy_stress": curve.cauchy,
        "plastic_strain": curve.plastic,
    }
    paths = [begin.with_name(f"{begin.name}_cyclic{end}") for end in (".csv", ".png")]
    replace_text(paths[0], _columns(columns))
    _draw_cyclic(curve, paths[1])
    return paths


@plain_matplotlib()
def _draw_cyclic(curve: CyclicCurve, path: Path) -> None:
    """Stress over strain."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.8), layout="constrained")
    FigureCanvasAgg(figure)
    axis = figure.subplots()
    size, unit = stress_unit(float(np.abs(curve.stress).max()))
    axis.plot(100 * curve.strain, curve.stress / size, color="#1f5f8b")
    axis.plot([0], [0], "o", color="#303840", markersize=3)
    strain, stress = curve.measures
    axis.set(title="uniaxial, cycles", xlabel=f"{strain} [%]", ylabel=f"{stress} [{unit}]")
    axis.grid(color="#dde1e5")
    _save(figure, path)


@plain_matplotlib()
def _draw_over_time(curves: TimeCurves, path: Path) -> None:
    """Stress and strain over time beside stress over strain in cycles."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    panels = 3 if len(curves.t) else 1
    figure = Figure(figsize=(13 if panels > 1 else 6.4, 4), layout="constrained")
    FigureCanvasAgg(figure)
    *held, right = figure.subplots(1, panels, squeeze=False)[0]
    size, unit = stress_unit(curves.largest)
    stress = f"nominal stress [{unit}]"
    for loop, color in zip(curves.loops, ("#1f5f8b", "#b0562f", "#4f7a3a"), strict=False):
        strain = 100 * (loop.stretch - 1)
        right.plot(strain, loop.nominal / size, color=color, label=loop.name)
    right.set(title="cycles", xlabel="strain [%]", ylabel=stress)
    right.legend(fontsize=8)
    if held:
        title = f"relaxation at a strain of {100 * (curves.held - 1):.3g} %"
        held[0].semilogx(curves.t[1:], curves.relaxation[1:] / size, color="#1f5f8b")
        held[0].set(title=title, xlabel="time [s]", ylabel=stress)
        title = f"creep at a nominal stress of {curves.relaxation[0] / size:.3g} {unit}"
        held[1].semilogx(curves.t[1:], 100 * (curves.creep[1:] - 1), color="#1f5f8b")
        held[1].set(title=title, xlabel="time [s]", ylabel="strain [%]")
    for axis in held:
        axis.set_ylim(bottom=0)
    for axis in (*held, right):
        axis.grid(color="#dde1e5")
    _save(figure, path)


@plain_matplotlib()
def _draw_viscous(curves: ViscousCurves, path: Path) -> None:
    """Relaxation over time beside storage and loss over frequency."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 4), layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2)
    size, unit = (1.0, "1") if curves.mu is None else stress_unit(curves.mu * curves.law.sudden)
    factor = (curves.mu or 1.0) / size
    what = "modulus over that of the constants" if curves.mu is None else f"shear modulus [{unit}]"
    left.semilogx(curves.t, factor * curves.relaxation, color="#1f5f8b")
    left.set(title="relaxation", xlabel="time after a sudden strain [s]", ylabel=what)
    hertz = curves.omega / (2 * np.pi)
    right.semilogx(hertz, factor * curves.storage, label="storage", color="#1f5f8b")
    right.semilogx(hertz, factor * curves.loss, "--", label="loss", color="#b0562f")
    right.set(title="oscillation", xlabel="frequency [Hz]", ylabel=what)
    right.legend(fontsize=8)
    for axis in (left, right):
        axis.set_ylim(bottom=0)
        axis.grid(color="#dde1e5")
    _save(figure, path)


def _file_name(name: str) -> str:
    """A name with everything but letters, digits, - and _ replaced."""
    return "".join(c if c.isalnum() or c in "-_" else "_" for c in name)


def table(curve: ResponseCurve) -> str:
    """A curve as CSV: stretch or shear, F, J, P and Cauchy stress [Pa], energy [J/m^3]."""
    heads = [curve.mode.symbol, *(f"F{p}" for p in _PARTS), "J"]
    heads += [*(f"P{p}" for p in _PARTS), *(f"sigma{p}" for p in _PARTS), "energy"]
    rows, columns = np.array([[int(c) - 1 for c in p] for p in _PARTS]).T
    stacked = np.column_stack(
        [
            curve.values,
            curve.F[:, rows, columns],
            curve.J,
            curve.P[:, rows, columns],
            curve.cauchy[:, rows, columns],
            curve.energy,
        ]
    )
    lines = [",".join(f"{value:.12g}" for value in row) for row in stacked]
    return "\n".join([",".join(heads), *lines]) + "\n"


@plain_matplotlib()
def _draw(name: str, report: MaterialReport, path: Path) -> None:
    """One picture of all curves."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6.4), layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(2, 3).ravel()
    for axis, curve in zip(axes, report.curves.values(), strict=False):
        _panel(axis, curve)
    axes[-1].axis("off")
    lines = [
        f"{f.check}: {f.text}" for f in report.findings if f.check.startswith(("ell", "small"))
    ]
    axes[-1].text(0, 1, "\n".join([f"{name}", *lines]), va="top", fontsize=8, wrap=True)
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    with drafted(path) as draft:
        figure.savefig(draft, dpi=130, format=path.suffix[1:])


def _panel(axis: Axes, curve: ResponseCurve) -> None:
    i, j = curve.mode.shown
    nominal, true = curve.P[:, i, j], curve.cauchy[:, i, j]
    top = float(np.abs(nominal).max()) or 1.0
    size, unit = stress_unit(top)
    axis.plot(curve.values, nominal / size, label=f"nominal P{i + 1}{j + 1}", color="#1f5f8b")
    axis.plot(curve.values, true / size, "--", label=f"Cauchy {i + 1}{j + 1}", color="#b0562f")
    axis.plot([curve.mode.rest], [0], "o", color="#303840", markersize=3)
    axis.set(title=curve.mode.name, xlabel=curve.mode.symbol, ylabel=f"stress [{unit}]")
    axis.grid(color="#dde1e5")
    axis.legend(fontsize=8)
