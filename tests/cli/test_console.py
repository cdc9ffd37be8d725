"""What commands print: the log, `info`, the tests of a material as JSON."""

from __future__ import annotations

import logging
from pathlib import Path

import pytest

from dolfin_elastic import LinearElastic
from dolfin_elastic.cli import info
from dolfin_elastic.cli.console import (
    LogHandler,
    ProgressLines,
    _times,
    console,
)
from dolfin_elastic.cli.console_materials import report_table
from dolfin_elastic.cli.console_modes import show_modes
from dolfin_elastic.model.point.report import MaterialReport
from dolfin_elastic.model.point.tested import Finding
from dolfin_elastic.problem.state import Mode, State


def test_warnings_and_errors_have_the_word_in_front(capfd):
    """On rank 0; on another one only what it alone can say is shown, with the word, too."""
    for rank, shown in ((0, "a\nwarning: b\nerror: c\n"), (1, "error: c\n")):
        handler = LogHandler(rank, lambda: console(stderr=True))
        for level, text in ((logging.INFO, "a"), (logging.WARNING, "b"), (logging.ERROR, "c")):
            record = logging.LogRecord("dolfin_elastic", level, __file__, 1, text, (), None)
            if text == "c":
                record.every_rank = True
            handler.handle(record)
        assert capfd.readouterr().err == shown


def test_a_search_is_one_line(capfd):
    """In a file the first trial of a step; without a display for them, as with -v, all of them."""
    record = logging.LogRecord("dolfin_elastic", logging.INFO, __file__, 1, "load 0.1", (), None)
    record.search = True
    handler, lines = LogHandler(0, lambda: console(stderr=True)), ProgressLines(motion=False)
    handler.handle(record)
    assert capfd.readouterr().err == "load 0.1\n"
    handler.show_searches(lines)
    for trials in (3, 2):
        for _ in range(trials):
            handler.handle(record)
        lines.show(State(1, 0.1, None))  # type: ignore[arg-type]
    out, err = capfd.readouterr()
    assert err == ""
    assert out.count("load 0.1 ... (-v shows every trial)\n") == 2 == out.count("load 0.1")


@pytest.mark.parametrize(("curves", "place"), [(False, "load 150 %  "), (True, "parameter 1.5")])
def test_curves_have_a_load_parameter(curves, place, capfd):
    """Where a load follows a curve, a formula or a record, 150 % of it is no load that acts."""
    ProgressLines(motion=False, curves=curves).show(State(1, 1.5, None, load_factor=1.5))  # type: ignore[arg-type]
    assert capfd.readouterr().out.startswith(f"step    1   {place}")


def test_results_stand_above_a_bar(capfd):
    """They go to standard output, but for a terminal with a bar: where that is drawn."""
    record = logging.LogRecord("dolfin_elastic", logging.INFO, __file__, 1, "254 kPa", (), None)
    record.result = True
    handler = LogHandler(0, lambda: console(stderr=True))
    handler.handle(record)
    assert capfd.readouterr() == ("254 kPa\n", "")
    handler.print_above_bar()
    handler.handle(record)
    assert capfd.readouterr() == ("", "254 kPa\n")


LIBRARIES = {"openblas": "/a/libopenblas.so.0", "mkl": "/b/libmkl_rt.so.2", "slow": "/c/libblas.so"}


@pytest.mark.parametrize(
    ("loaded", "named", "advised"),
    [
        (["openblas", "slow"], "openblas", False),
        (["mkl"], "mkl", False),
        (["slow"], "slow", True),
        ([], None, False),
    ],
)
def test_which_blas_is_loaded(
    loaded: list[str], named: str | None, advised: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reference library is slow, which is said; a fast one beside it is used."""
    maps = "".join(f"7f00-7f01 r-xp 0 0:0 1 {LIBRARIES[name]}\n" for name in loaded)
    monkeypatch.setattr(Path, "read_text", lambda *_, **__: maps + "7f02-7f03 rw-p 0 0:0 0\n")
    name, advice = info._blas()
    assert name == (LIBRARIES[named] if named else "unknown")
    assert bool(advice) == advised
    assert all("libopenblas0-pthread" in line for line in advice)


@pytest.mark.parametrize("verdict", ["pass", "fail", "note"])
def test_a_material_passes_unless_a_test_fails(verdict: str) -> None:
    """A note is no fault."""
    finding = Finding("stress", verdict, "0.1 %", {})  # type: ignore[arg-type]
    found = MaterialReport(LinearElastic(E=1.0, nu=0.0), (finding,), {}, ())
    assert report_table(found)["passed"] is (verdict != "fail")


def test_times_of_a_run_in_plain_form() -> None:
    """No powers of ten where people read seconds."""
    seconds = {"mesh": 0.004, "compile": 0.25, "solve": 1234.5, "output": 150.2, "total": 1385.0}
    assert _times(seconds) == "1385 s (compile 0.25, solve 1234, output 150)"


@pytest.mark.parametrize(("kind", "what"), [("elastic", "modes"), ("buckling", "buckling loads")])
def test_the_error_of_modes_is_not_estimated(kind, what, capsys):
    """One line below their table, as the report has it."""
    mass = {"x": 1.0}
    mode = Mode(1, kind, None, None, 4.0, 0.3, effective=mass, whole=mass)
    show_modes([mode], [{"shape": "bending"}], {"total": 1.0})
    last = capsys.readouterr().out.splitlines()[-1]
    assert last == f"the error by the size of the elements is not estimated for {what}"
