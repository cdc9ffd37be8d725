"""Commands whose names are misspelt."""

from __future__ import annotations

import click
from typer.core import TyperGroup

from dolfin_elastic.core.errors import nearest


class Verbs(TyperGroup):
    """The commands; an unknown one is answered with the nearest name."""

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """See `click.Group`; no argument of ours is empty, as an unset variable of a script is.

        Raises:
            UsageError: One is empty: a path would be the current folder.
        """
        ours = args[: args.index("--")] if "--" in args else args
        for before, argument in zip(["dolfin-elastic", *ours], ours, strict=False):
            if argument == "" or (argument.startswith("--") and argument.endswith("=")):
                name = argument.rstrip("=") or before
                raise click.UsageError(
                    f"There is an empty argument behind {name}; the current folder is a dot", ctx
                )
        return super().parse_args(ctx, args)

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """See `click.Group`.

        Args:
            args: What stands on the command line behind it.

        Raises:
            UsageError: There is no such command; with the nearest one.
        """
        name = args[0]
        if not ctx.resilient_parsing and self.get_command(ctx, name) is None and name[:1] != "-":
            known = nearest(name, self.list_commands(ctx))
            raise click.UsageError(f"There is no command '{name}': {known}", ctx)
        return super().resolve_command(ctx, args)
