"""What Sphinx would compute anew for each page, and is the same on many."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any

from sphinx.application import Sphinx
from sphinx.search.en import SearchEnglish

ALIKE = "reference/messages/"
"""Pages that stand in no table of contents: all of them have the same one beside them."""


class English(SearchEnglish):
    """Finds the stem of a word once: pages share most of their words."""

    def __init__(self, options: dict[str, str]) -> None:
        super().__init__(options)
        self.stem = lru_cache(maxsize=None)(super().stem)  # type: ignore[method-assign]


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.add_search_language(English)
    trees: dict[tuple[tuple[str, object], ...], str] = {}

    def share(_: Sphinx, page: str, __: str, context: dict[str, Any], ___: object) -> None:
        make: Callable[..., str] = context["toctree"]

        def toctree(**how: object) -> str:
            key = tuple(sorted(how.items()))
            if key not in trees:
                trees[key] = make(**how)
            return trees[key]

        if page.startswith(ALIKE):
            context["toctree"] = toctree

    app.connect("html-page-context", share, priority=100)  # before the theme asks for it
