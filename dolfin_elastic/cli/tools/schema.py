"""The command `schema`."""
# ruff: noqa: D301

from __future__ import annotations

import json


def schema() -> None:
    """Print the JSON schema of case files, by which editors complete and check.

    \b
      dolfin-elastic schema > dolfin-elastic.schema.json

    Then write `#:schema ./dolfin-elastic.schema.json` as the first line of a case, and open it in
    an editor with taplo or "Even Better TOML".
    """
    from dolfin_elastic.case.reference.json_schema import case_schema

    print(json.dumps(case_schema(), indent=1, ensure_ascii=False))
