"""Compiling forms: flags, all ranks at work, a cache that many runs share and that mends itself."""

import dolfin_elastic.core.startup.started  # noqa: F401  # before anything starts MPI

from dolfin_elastic.core.jit.c_code import compile_c
from dolfin_elastic.core.jit.cache import cache_folder
from dolfin_elastic.core.jit.compile import (
    FLAGS,
    JitOptions,
    compile_expression,
    compile_forms,
    options,
)
from dolfin_elastic.core.native.functions import CFunctions

__all__ = [
    "FLAGS",
    "CFunctions",
    "JitOptions",
    "cache_folder",
    "compile_c",
    "compile_expression",
    "compile_forms",
    "options",
]
