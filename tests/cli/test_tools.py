"""Commands for those who begin: new, schema, names that are misspelt, completion."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from conftest import ROOT
from helpers.processes import PROGRAM, clean_environment, cli, started
from jsonschema import Draft7Validator
from mpi4py import MPI

from dolfin_elastic.cli.tools.files import TEMPLATES, Kind
from dolfin_elastic.cli.tools.report import report
from dolfin_elastic.cli.tools.verify import _write, verify
from dolfin_elastic.core.errors import CaseError, OutputError

pytestmark = pytest.mark.skipif(MPI.COMM_WORLD.size > 1, reason="starts processes of its own")


@pytest.mark.parametrize(
    ("word", "answer"),
    [
        ("chekc", "There is no command 'chekc': did you mean 'check'?"),
        ("reestart", "There is no command 'reestart': did you mean 'restart'?"),
        ("beam.toml", "There is no command 'beam.toml': known: check, "),
    ],
)
def test_misspelt_command(word: str, answer: str, tmp_path: Path) -> None:
    code, out, err = cli(word, folder=tmp_path)
    assert (code, out) == (2, "")
    assert f"Error: {answer}" in err


@pytest.mark.long
def test_schema(tmp_path: Path) -> None:
    """It is printed as JSON, on several ranks once."""
    code, out, err = cli("schema", folder=tmp_path, ranks=2)
    assert code == 0, err
    Draft7Validator.check_schema(json.loads(out))


def test_there_is_a_template_of_each_kind() -> None:
    assert {path.stem for path in TEMPLATES.iterdir()} == {*Kind}


def test_kinds_are_listed(tmp_path: Path) -> None:
    """One line each, and a row in the guide; an unknown one is answered with the nearest."""
    code, out, err = cli("new", "--list", folder=tmp_path)
    assert (code, err) == (0, "")
    assert [line.split()[0] for line in out.splitlines()] == [*Kind]
    assert all(len(line.split()) > 5 and len(line) < 120 for line in out.splitlines())
    page = (ROOT / "docs/guide/installation.md").read_text()
    assert re.findall(r"^\| `([\w-]+)`", page.partition("| case |")[2], re.M) == [*Kind]
    code, out, err = cli("new", "--kind", "bones", folder=tmp_path)
    assert (code, out) == (2, "")
    assert err == "error: --kind: there is no kind 'bones'; did you mean 'bone'?\n"
    assert os.listdir(tmp_path) == []


def test_a_first_case_with_its_geometry(tmp_path: Path) -> None:
    """Both files are written, under the name of the case, and neither is overwritten."""
    (tmp_path / "arm.geo").write_text("mine")
    words = ("new", "arm.toml", "--kind", "bracket")
    code, _, err = cli(*words, folder=tmp_path)
    assert (code, os.listdir(tmp_path)) == (2, ["arm.geo"])
    assert err.startswith("error: arm.geo: this file exists already; ")
    code, out, _ = cli(*words, "--force", folder=tmp_path)
    assert (code, out.partition(";")[0]) == (0, "arm.toml and arm.geo written")
    assert 'file = "arm.geo"' in (tmp_path / "arm.toml").read_text()
    assert "Fillet" in (tmp_path / "arm.geo").read_text()


@pytest.mark.long
@pytest.mark.parametrize("kind", Kind)
def test_first_cases_run(kind: Kind, tmp_path: Path) -> None:
    """What `new` writes runs as it is, with an audit that passes, and without a warning."""
    assert cli("new", "first.toml", "--kind", kind, folder=tmp_path)[0] == 0
    code, out, err = cli("run", "first.toml", folder=tmp_path)
    assert code == 0, out + err
    assert "warning" not in err
    summary = json.loads((tmp_path / "first_results/summary.json").read_text())
    assert summary["status"] == "completed"
    if kind != Kind.MODAL:  # modes are not audited
        assert summary["audit"]["verdict"] == "pass"


def test_completion(tmp_path: Path) -> None:
    """The shell asks the program, which knows its commands."""
    asked = {"_DOLFIN_ELASTIC_COMPLETE": "complete_bash", "COMP_WORDS": "dolfin-elastic con"}
    done = subprocess.run(
        PROGRAM,
        cwd=tmp_path,
        env={**clean_environment(), **asked, "COMP_CWORD": "1"},
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout.split() == ["converge", "convert"]
    assert os.listdir(tmp_path) == []


FEW = """\
import sys
from dataclasses import replace
import dolfin_elastic.study.verify.suite as suite, dolfin_elastic.cli.app
suite.SUITE = [one for one in suite.SUITE if one.name == "lame"]
suite.SUITE += [replace(one, reference={factor}*one.reference) for one in suite.SUITE]
sys.argv = ["dolfin-elastic", "verify", "--json", "table.json"]
dolfin_elastic.cli.app.main()
"""


@pytest.mark.long
@pytest.mark.parametrize(("factor", "code"), [(1.01, 1), (1, 0)])
def test_verify(factor: float, code: int, tmp_path: Path) -> None:
    """A table, and exit code 1 where a result is off."""
    command = [sys.executable, "-c", FEW.format(factor=factor)]
    with started(command, tmp_path, 2) as process:
        out, err = process.communicate(timeout=240)
    assert process.returncode == code, out + err
    lines = out.splitlines()
    assert lines[0].split() == ["case", "ranks", "computed", "reference", "error", "limit", "time"]
    assert lines[1].split()[:4] == ["lame", "2", "1.31239e-05", "1.312381e-05"]
    assert (lines[2].endswith("FAILED"), lines[3].startswith("1 of 2 FAILED: lame")) == (
        bool(code),
        bool(code),
    )
    rows = json.loads((tmp_path / "table.json").read_text())
    assert [row["passed"] for row in rows] == [True, not code]


@pytest.mark.long
def test_verify_compares_ranks(tmp_path: Path) -> None:
    """Of a case of the user's own, on one rank and on two."""
    text = (TEMPLATES / "axisymmetric.toml").read_text()
    (tmp_path / "tube.toml").write_text(text)
    code, out, err = cli("verify", "--case", "tube.toml", "--ranks", "1,2", folder=tmp_path)
    assert code == 0, out + err
    assert out.splitlines()[:2] == ["tube.toml on 1 rank: done", "tube.toml on 2 ranks: done"]
    assert re.search(r"all \d+ numbers agree to 1e-06", out)
    tight = ("verify", "--case", "tube.toml", "--tolerance", "0")
    code, out, _ = cli(*tight, folder=tmp_path)
    assert code == 1
    assert re.search(r"DIFFERS\n(.*\n)*\d+ of \d+ numbers differ by more than 0\n$", out)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["tube.toml"]


def test_verify_without_mpirun_or_room(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One message each: the table is a result, which cannot be written."""
    with pytest.raises(OutputError, match=r"cannot write .*table\.json"):
        _write(tmp_path / "nowhere" / "table.json", [])
    monkeypatch.setattr(shutil, "which", lambda name: None)
    with pytest.raises(CaseError, match="--ranks: there is no mpirun on the PATH"):
        verify(ranks="1,2")


def test_verify_refuses(tmp_path: Path) -> None:
    """Numbers of ranks that are none."""
    code, _, err = cli("verify", "--ranks", "1,two", folder=tmp_path)
    assert code == 2
    assert "--ranks 1,two: numbers with commas, for example 1,2,4" in err
    code, _, err = cli("verify", "--case", "x.toml", "--ranks", "2", folder=tmp_path)
    assert code == 2
    assert "at least two numbers of ranks" in err


@pytest.mark.parametrize("first", [".", "../a", "inner/.."])
def test_report_of_several_lies_beside_the_first(
    first: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """From inside a folder, too, whose own page it would replace."""
    for name in ("a/inner", "b"):
        (tmp_path / name).mkdir(parents=True)
    monkeypatch.chdir(tmp_path / "a")
    monkeypatch.setattr(
        "dolfin_elastic.report.several.write_pages", lambda _runs, page, *_: page.touch() or page
    )
    report([Path(first), Path("../b")])
    assert [path.relative_to(tmp_path) for path in tmp_path.rglob("*.html")] == [
        Path("report.html")
    ]
