"""The command line: the only place that prints, configures logging, or makes exit codes.

Everything heavy is imported where it is needed, so that --help comes at once.
"""
# ruff: noqa: D301

from __future__ import annotations

import errno
import gc
import logging
import os
import sys
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

import click
import typer
from click.exceptions import ClickException
from typer.core import TyperCommand, TyperGroup

from dolfin_elastic.cli.converge import converge
from dolfin_elastic.cli.fit import fit
from dolfin_elastic.cli.import_deck import import_deck
from dolfin_elastic.cli.look.command import look
from dolfin_elastic.cli.materials import material, materials
from dolfin_elastic.cli.pipes import guard_output, lost_output
from dolfin_elastic.cli.run import CaseFile, Trust, collect_garbage, log_to_screen, restart, run
from dolfin_elastic.cli.sweep import sweep
from dolfin_elastic.cli.tools.convert import convert
from dolfin_elastic.cli.tools.files import new, schema
from dolfin_elastic.cli.tools.gradient import gradient
from dolfin_elastic.cli.tools.plot import plot
from dolfin_elastic.cli.tools.report import report
from dolfin_elastic.cli.tools.verify import verify
from dolfin_elastic.core import __version__
from dolfin_elastic.core.errors import ElasticError, InputError, OutputError, nearest
from dolfin_elastic.core.signals import (
    INTERRUPTED,
    ignore_more,
    interrupt_on_request,
    launched_rank,
)
from dolfin_elastic.core.startup.libraries import start

if TYPE_CHECKING:
    from mpi4py import MPI


class Verb(TyperCommand):
    """A command whose help has brackets as they are: Typer escapes them for a markup of Rich's."""

    def get_help(self, ctx: click.Context) -> str:
        """See `click.Command`."""
        return super().get_help(ctx).replace("\\[", "[")


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


CRASHED = 1
HELP = """Deformable elastic bodies on DOLFINx and PETSc, on any number of cores.

\b
  dolfin-elastic new beam.toml              write a first case that runs as it is
  dolfin-elastic look part.step -o look.png see the faces of a body, and their numbers
  dolfin-elastic check beam.toml            what will be computed, and what is wrong
  dolfin-elastic material beam.toml         try its materials at a point
  dolfin-elastic fit law.toml --uniaxial a.csv
                                            constants of a material from measured curves
  dolfin-elastic run beam.toml              compute it
  mpirun -n 4 dolfin-elastic run beam.toml  the same on four cores
  dolfin-elastic restart beam_results       go on after it was stopped or killed
  dolfin-elastic report beam_results        a page about it that can be mailed
  dolfin-elastic plot beam_results          pictures, films and curves of what it has left
  dolfin-elastic convert beam_results b.glb what it has left, for Blender, USD, FreeCAD
  dolfin-elastic converge beam.toml --until "displacement of tip" 1%
                                            refine the mesh until it is known so well
  dolfin-elastic sweep beam.toml --set mesh.size="4 mm,2 mm"
                                            the same with other values, in one table
  dolfin-elastic gradient beam.toml --of "displacement_z of tip" --by materials.steel.E
                                            how a result changes with a number, or with the shape
  dolfin-elastic convert wing.msh wing.xdmf a large mesh, for many cores to read in parallel
  dolfin-elastic import part.inp            a case file of a deck of another program
  dolfin-elastic verify                     known results, computed on this installation

\b
Exit codes:
  0    done
  1    a fault of the program itself
  2    the case, a mesh or the command line is wrong, there is nothing to go on from, or a run
       is still going in that folder; nothing was written
  3    no solution was found; the results so far are complete
  4    results cannot be written, or what is printed
  5    the run came to its end, but its audit fails: not to be relied on
  6    `converge` has not reached its goal; the results so far are complete
  130  interrupted; the results so far are complete, and `restart` goes on
"""

app = typer.Typer(
    help=HELP,
    no_args_is_help=True,
    cls=Verbs,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(wanted: bool) -> None:
    if wanted:
        print(f"dolfin-elastic {__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool,
        typer.Option(
            "--version", callback=_print_version, is_eager=True, help="Show the version and exit."
        ),
    ] = False,
) -> None:
    pass


# --- commands ---


@app.command(cls=Verb)
def check(
    case: CaseFile,
    json: Annotated[bool, typer.Option("--json", help="Print JSON, for scripts.")] = False,
    trust: Trust = False,
) -> None:
    """Say what is wrong with a case, or what it will compute.

    \b
      dolfin-elastic check beam.toml
      dolfin-elastic check beam.toml --json | jq .unknowns

    Compares every name, unit and size with the mesh, sums up masses and loads; computes nothing.
    """
    start()
    from mpi4py import MPI

    from dolfin_elastic.case.check.report import report
    from dolfin_elastic.case.check.rest import read_case

    comm = MPI.COMM_WORLD
    collect_garbage()
    interrupt_on_request()
    log_to_screen(comm.rank, logging.ERROR)  # warnings are among the report's notes
    result = report(read_case(case, comm=comm, trust=trust), comm=comm)
    if comm.rank == 0 and json:
        from dataclasses import asdict
        from json import dumps

        print(dumps(asdict(result), indent=2))
    elif comm.rank == 0:
        from dolfin_elastic.cli.console_check import show_check

        show_check(result)


app.command(cls=Verb)(look)
app.command(cls=Verb)(run)
app.command(cls=Verb)(converge)
app.command(cls=Verb)(sweep)
app.command(cls=Verb)(gradient)
app.command(cls=Verb)(restart)
app.command(cls=Verb)(plot)
app.command(cls=Verb, context_settings={"allow_extra_args": True, "ignore_unknown_options": True})(
    material
)
app.command(cls=Verb)(materials)
app.command(cls=Verb)(fit)
app.command(cls=Verb)(report)
app.command(cls=Verb)(convert)
app.command("import", cls=Verb)(import_deck)
app.command(cls=Verb)(new)
app.command(cls=Verb)(schema)
app.command(cls=Verb)(verify)


@app.command(cls=Verb)
def info() -> None:
    """Show versions and libraries."""
    from dolfin_elastic.cli.info import describe

    versions, advice = describe()
    width = max(map(len, versions))
    for name, value in versions.items():
        print(f"{name:<{width}}  {value}")
    for line in advice if launched_rank() == 0 else ():
        print(f"warning: {line}", file=sys.stderr)


@contextmanager
def _only_what_is_asked_for() -> Iterator[None]:
    """Typer makes all commands of a program at each start, of which one is called: 15 ms."""
    every, asked = app.registered_commands, sys.argv[1] if len(sys.argv) > 1 else ""
    one = [
        known
        for known in every
        if known.callback and (known.name or known.callback.__name__) == asked
    ]
    app.registered_commands = one or every
    try:
        yield
    finally:
        app.registered_commands = every


# --- errors and exit codes ---


def main() -> None:
    """The console script."""
    # Imports make hundred thousands of objects that all stay: to look for garbage among them again
    # and again is a sixth of the start.  `begin` and `check` go on with it.
    gc.disable()
    # Pydantic would look for plugins of its own in the metadata of every installed package.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    guard_output()
    if launched_rank():
        sys.stdout = open(os.devnull, "w", encoding="utf-8")  # noqa: SIM115
    code = guarded()
    ignore_more()
    if lost := lost_output():
        print(f"error: {lost}", file=sys.stderr, flush=True)
        code = code or OutputError.exit_code
    sys.exit(code)


def guarded() -> int:
    """Runs the command line; returns its exit code, which is the same on every rank."""
    try:
        with _only_what_is_asked_for():
            result = app(prog_name="dolfin-elastic", standalone_mode=False)
        return result if isinstance(result, int) else 0
    except ClickException as error:
        if launched_rank() == 0:
            error.show()
            if "No such option" in error.format_message():
                print("PETSc options stand after two dashes: ... -- -ksp_view", file=sys.stderr)
        else:
            time.sleep(1.0)  # the launcher ends all ranks when one leaves: rank 0 prints first
        return error.exit_code
    except ElasticError as error:
        return _show_error(error)
    except KeyboardInterrupt:
        comm = _comm()
        if comm and not _all_arrive(comm):
            comm.Abort(INTERRUPTED)
        return INTERRUPTED
    except Exception as error:
        if isinstance(error, OSError) and error.errno == errno.ENAMETOOLONG:
            where, fewer = str(error.filename), "a name of at most 255 bytes"
            return _show_error(InputError("file name too long", where=where, expected=fewer))
        _abort_all_ranks()
        raise


def _comm() -> MPI.Comm | None:
    """All ranks, if MPI has started; it is not started to print an error."""
    if "mpi4py.MPI" not in sys.modules:
        return None
    from mpi4py import MPI

    return MPI.COMM_WORLD


def _show_error(error: ElasticError) -> int:
    """Prints an error once; returns its exit code. Called on every rank that has the error.

    No rank leaves before rank 0 has printed: the launcher ends all ranks when one leaves. If the
    others do not arrive, the error is this rank's alone, and all are aborted.
    """
    comm = _comm()
    if (comm.rank if comm else launched_rank()) == 0:
        from dolfin_elastic.cli.console import error_text

        print(error_text(error), file=sys.stderr, flush=True)
    if comm and not _all_arrive(comm):
        if comm.rank:
            print(f"error (rank {comm.rank} alone): {error}", file=sys.stderr, flush=True)
        comm.Abort(error.exit_code)
    return error.exit_code


def _all_arrive(comm: MPI.Comm) -> bool:
    from dolfin_elastic.core.together import all_ranks_arrive

    return all_ranks_arrive(comm)


def _abort_all_ranks() -> None:
    """Prints the traceback of a fault of the program, with the rank, and aborts all ranks."""
    comm = _comm()
    if comm is None or comm.size == 1:
        return
    time.sleep(min(0.5 * comm.rank, 5.0))  # rank 0 first; it aborts the others before they print
    print(
        f"rank {comm.rank} of {comm.size}:\n{traceback.format_exc()}", file=sys.stderr, flush=True
    )
    comm.Abort(CRASHED)


if __name__ == "__main__":
    main()
