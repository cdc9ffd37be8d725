"""Kernels of FFCx for several cells at once.

FFCx writes code for one cell, in which a C compiler finds little to do at once: most of a law is
straight-line arithmetic.  Where there are many cells, each number of it becomes a vector that has
one of each of `vectorise.LANES` cells, in the same statements; none of them depends on another
lane.  Source: Sun, Mitchell, Kulkarni, Kloeckner, Ham & Kelly, Int. J. High Perform. Comput. Appl.
34 (2020) 629, who do so in code of their own generator.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

from dolfin_elastic.core.jit.c_code import Code
from dolfin_elastic.core.native.source import written

FROM = 10_000
"""Cells of a rank from which lanes pay: half a second of compiling, once, for each kernel saves 0.1
us a linear cell, 0.5 to 2 us a quadratic one each time."""


@dataclass(frozen=True)
class Kernel:
    """A function that FFCx has written for one cell.

    Attributes:
        address: Of the compiled function.
        arguments: How many it has.
        folder: Of the compiled module, with its code.
        number: Which integral of its form; 0 for an expression.
    """

    address: int
    arguments: int
    folder: Path
    number: int

    def code(self, *, many: bool) -> Code:
        """The kernel as TABULATE(A, w, c, y), of LANES cells at once: the header "kernel.h".

        Vectors A, w, c and y, of the type `lanes`, have a number of each cell.  LANES is 1 where
        there are few cells, or where `vectorise` does not know the kernel's code: then TABULATE
        calls the function at `kernel`, a variable.

        Args:
            many: There are so many cells that lanes pay.
        """

        def make() -> str:
            # Where it is not yet compiled: its expressions take 2 ms to be compiled, too.
            from dolfin_elastic.core.jit.vectorise import kernel_in_lanes, kernel_of_one_cell

            found = kernel_in_lanes(self.folder, self.number) if many else None
            return found or kernel_of_one_cell(self.arguments)

        rules = files(__package__).joinpath("vectorise.py").read_text(encoding="utf-8")
        which = [self.folder.name, self.number] if many else []
        return Code("\n".join(map(str, [rules, written("lanes.h"), self.arguments, *which])), make)


NO_KERNEL = Kernel(0, 7, Path(), 0)
"""Of loops that are given what else a kernel would write."""
