"""The console of rich, for texts of case and mesh files."""

from __future__ import annotations

import textwrap
from typing import Any, TextIO

from rich.console import Console
from rich.text import Text

from dolfin_elastic.cli.pipes import printable


class Screen(Console):
    """A console that shows texts as they are: no markup, no control characters.

    It writes the colours and movements of its own past the filter of the stream.

    Args:
        width: Columns; None: those of the terminal.
        terminal: Whether it is a terminal; None: as the stream says.
    """

    def __init__(self, stream: TextIO, width: int | None, terminal: bool | None) -> None:
        super().__init__(
            file=getattr(stream, "unfiltered", stream),
            width=width,
            force_terminal=terminal,
            highlight=False,
            markup=False,
            emoji=False,
        )

    def render_str(self, text: str, **options: Any) -> Text:
        """See `Console.render_str`."""
        return super().render_str(printable(text), **options)

    def tell(self, text: str, style: str | None = None) -> None:
        """Prints a text: on a terminal broken between words, elsewhere its lines as they are."""
        shown = wrapped(printable(text), self.width) if self.is_terminal else text
        self.print(shown, style=style, soft_wrap=True)


def wrapped(text: str, width: int) -> str:
    """Breaks long lines, with indented continuation; words and paths stay whole."""
    broken = (
        textwrap.wrap(
            line,
            width,
            subsequent_indent="    ",
            break_long_words=False,
            break_on_hyphens=False,
        )
        or [""]
        for line in text.split("\n")
    )
    return "\n".join(part for lines in broken for part in lines)
