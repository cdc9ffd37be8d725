"""The documentation site: Sphinx, MyST and Furo, all Debian packages; see docs/build."""

from __future__ import annotations

import gc
import re
import sys
from pathlib import Path

from docutils import nodes
from docutils.utils.math.latex2mathml import tex2mathml
from pygments.lexers.configs import TOMLLexer
from sphinx.application import Sphinx
from sphinx.writers.html5 import HTML5Translator

HERE = Path(__file__).parent
CODE = HERE.parent / "dolfin_elastic/core/__init__.py"
sys.path[:0] = [str(HERE / "_ext"), str(HERE.parent)]

gc.disable()  # trees of documents are large and stay: to look for garbage is a fifth of the time

import reference  # noqa: E402  it stands in docs/_ext

reference.write(HERE / "reference/generated")

project = "dolfin_elastic"
author = "the authors of dolfin_elastic"
copyright = "the authors of dolfin_elastic; LGPL-3.0-or-later"  # noqa: A001
release = version = re.findall(r'__version__ = "(.*)"', CODE.read_text(encoding="utf-8"))[0]
extensions = ["myst_parser", "quick"]
source_suffix = {".md": "markdown"}
exclude_patterns = ["_build", "reference/generated"]
myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 4
html_theme = "furo"
html_title = f"dolfin_elastic {release}"
html_copy_source = False
html_theme_options = {"top_of_page_buttons": []}
html_static_path = ["_static"]
html_css_files = ["site.css"]
nitpicky = True


def visit_math(self: HTML5Translator, node: nodes.math) -> None:
    """Formulae as MathML, which browsers draw without a script from anywhere."""
    self.body.append(f'<math xmlns="http://www.w3.org/1998/Math/MathML">{mathml(node, "inline")}')
    self.body.append("</math>")
    raise nodes.SkipNode


def visit_displaymath(self: HTML5Translator, node: nodes.math_block) -> None:
    """The same on a line of its own."""
    self.body.append('<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">')
    self.body.append(f"{mathml(node, 'block')}</math>")
    raise nodes.SkipNode


def mathml(node: nodes.Node, kind: str) -> str:
    """What stands within the element <math>.

    Args:
        node: The formula in TeX.
        kind: "inline" or "block".
    """
    text = tex2mathml(node.astext(), as_block=kind == "block")
    text = re.sub(r"^\s*<math[^>]*>|</math>\s*$", "", text.strip())
    # Upright Greek: italic letters of mathematics are in few fonts.
    return re.sub(r"<mi>([^\x00-\x7f]+)</mi>", r'<mi mathvariant="normal">\1</mi>', text)


def setup(app: Sphinx) -> None:
    """Formulae, and the names that tests give to blocks of TOML."""
    app.add_html_math_renderer("mathml", (visit_math, None), (visit_displaymath, None))
    text = "".join(page.read_text(encoding="utf-8") for page in HERE.glob("**/*.md"))
    for name in set(re.findall(r"^```(toml-\w+)$", text, re.MULTILINE)):
        app.add_lexer(name, TOMLLexer)


html_math_renderer = "mathml"
