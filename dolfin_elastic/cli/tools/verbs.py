"""Commands whose names are misspelt."""

from __future__ import annotations

import click
from typer.core import TyperGroup

from dolfin_elastic.core.errors import nearest


class Verbs(TyperGroup):
    """The commands; an unknown one is answered with the nearest name."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """See `click.Group`.

        Args:
            ctx: The context of the program.
            args: What stands on the command line behind it.

        Raises:
            UsageError: There is no such command; with the nearest one.
        """
        name = args[0]
        if not ctx.resilient_parsing and self.get_command(ctx, name) is None and name[:1] != "-":
            known = nearest(name, self.list_commands(ctx))
            raise click.UsageError(f"There is no command '{name}': {known}", ctx)
        return super().resolve_command(ctx, args)
