"""Commands for those who begin: new, schema, names that are misspelt, completion."""

from __future__ import annotations

import json
import os
import subprocess
from pathlib import Path

import pytest
from helpers.processes import PROGRAM, clean_environment, cli
from jsonschema import Draft7Validator
from mpi4py import MPI

from dolfin_elastic.cli.tools.new import TEMPLATES, Kind

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


def test_schema(tmp_path: Path) -> None:
    """It is printed as JSON, on several ranks once."""
    code, out, err = cli("schema", folder=tmp_path, ranks=2)
    assert code == 0, err
    Draft7Validator.check_schema(json.loads(out))


def test_there_is_a_template_of_each_kind() -> None:
    assert {path.stem for path in TEMPLATES.iterdir()} == {*Kind}


@pytest.mark.long
@pytest.mark.parametrize("kind", Kind)
def test_first_cases_run(kind: Kind, tmp_path: Path) -> None:
    """What `new` writes runs as it is, with an audit that passes."""
    assert cli("new", "first.toml", "--kind", kind, folder=tmp_path)[0] == 0
    code, out, err = cli("run", "first.toml", folder=tmp_path)
    assert code == 0, out + err
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
    assert done.stdout.split() == ["converge"]
    assert os.listdir(tmp_path) == []
