"""The page: a template filled in, with a policy that lets nothing run or load but its own.

Whatever comes from the case, the mesh or the results is text, which the template engine escapes;
and scripts and styles run by the hash of their content only, so that a text which got through would
neither run nor load anything.
"""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping
from importlib.resources import files

from markupsafe import Markup

_FILES = files("dolfin_elastic.report")
_MEANT = "<>&"
"""Letters that mean something to HTML; JSON escapes those that end a line of a script."""


def render(contents: Mapping[str, object], template: str = "report.html") -> str:
    """The page as text.

    Args:
        contents: See `report_contents`.
        template: Its file.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("dolfin_elastic.report", "template"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=StrictUndefined,
    )
    style = _read("template/report.css")
    script = _read("viewer/viewer.min.js") if contents.get("scene") is not None else ""
    return environment.get_template(template).render(
        **contents,
        style=Markup(style),
        script=Markup(script),
        scene_text=json_text(contents.get("scene")),
        policy=_policy(style, script),
    )


def _read(name: str) -> str:
    return _FILES.joinpath(name).read_text(encoding="utf-8")


def _policy(style: str, script: str) -> str:
    """The content security policy."""
    rules = ["default-src 'none'", "img-src data:", f"style-src {_hash(style)}"]
    if script:
        rules.append(f"script-src {_hash(script)}")
    return "; ".join([*rules, "base-uri 'none'", "form-action 'none'"])


def _hash(text: str) -> str:
    digest = hashlib.sha256(text.encode()).digest()
    return f"'sha256-{base64.b64encode(digest).decode('ascii')}'"


def json_text(value: object) -> Markup:
    """JSON that a script element can hold, whatever is in it."""
    text = json.dumps(value, separators=(",", ":"), allow_nan=False)
    for letter in _MEANT:
        text = text.replace(letter, f"\\u{ord(letter):04x}")
    return Markup(text)
