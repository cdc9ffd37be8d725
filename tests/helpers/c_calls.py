"""Calls of C functions with arrays exactly as long as their prototypes say, under sanitisers.

A file is compiled with address and undefined-behaviour sanitisers.  Its functions are called in a
process of its own, which knows neither numpy nor MPI: an error of memory there ends it.
"""

from __future__ import annotations

import base64
import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from dolfin_elastic.core.native.functions import length_of, prototypes

FLAGS = ["-O0", "-g1", "-march=native", "-Wno-psabi", "-ffp-contract=fast", "-shared", "-fPIC"]
SANITISERS = ["-fsanitize=address,undefined", "-fno-sanitize-recover=all"]

CALLER = """
import base64, ctypes, json, sys
library, c = ctypes.CDLL(sys.argv[1]), ctypes.CDLL(None)
c.malloc.restype, c.malloc.argtypes = ctypes.c_void_p, [ctypes.c_size_t]
c.free.argtypes = [ctypes.c_void_p]
for name, arguments in json.load(open(sys.argv[2])):
    print(name, flush=True)
    handed, arrays = [], []
    for one in arguments:
        if isinstance(one, int):
            handed.append(ctypes.c_int64(one))
            continue
        data = base64.b64decode(one)
        arrays.append(c.malloc(len(data)))
        ctypes.memmove(arrays[-1], data, len(data))
        handed.append(ctypes.c_void_p(arrays[-1]))
    getattr(library, name)(*handed)
    for one in arrays:
        c.free(one)
"""

Values = Mapping[str, object]


def arguments(
    text: str, name: str, macros: Mapping[str, int], values: Values
) -> list[int | np.ndarray]:
    """What a function is called with: arrays of just the length of their parameter.

    Args:
        macros: That lengths are made of.
        values: Of parameters by name.  Arrays of integers may be longer than needed; where an array
            has no value, numbers are random and integers 0.
    """
    rng, found = np.random.default_rng(1), []
    parameters = prototypes(text)[name]
    names = [one.name for one in parameters]
    for parameter in parameters:
        given = values.get(parameter.name)
        if parameter.length is None:
            found.append(int(given))
            continue
        length = length_of(parameter.length, names[: len(found)], macros)(found)
        bare = parameter.kind.removeprefix("const ").removesuffix("_t")
        dtype = np.dtype("float32" if bare == "float" else bare)
        if given is not None:
            array = np.ascontiguousarray(np.ravel(given)[:length], dtype=dtype)
            assert array.size == length, f"{name}: {array.size} entries of {parameter}"
        elif dtype.kind == "f":
            array = rng.uniform(0.5, 1.5, length).astype(dtype)
        else:
            array = np.zeros(length, dtype)
        found.append(array)
    return found


def compile_with_sanitisers(text: str, folder: Path) -> Path:
    """The shared library of a file."""
    library = folder / "loops.so"
    command = ["gcc", *FLAGS, *SANITISERS, "-x", "c", "-o", str(library), "-", "-lm"]
    done = subprocess.run(command, input=text, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return library


def run(library: Path, calls: list[tuple[str, list[int | np.ndarray]]]) -> str:
    """Calls functions one after the other.

    Returns:
        What a sanitiser has said, with the name of the function; nothing where all is well.
    """
    packed = [
        (name, [one if isinstance(one, int) else base64.b64encode(one).decode() for one in given])
        for name, given in calls
    ]
    file = library.with_suffix(".json")
    file.write_text(json.dumps(packed))
    asan = subprocess.run(
        ["gcc", "-print-file-name=libasan.so"], capture_output=True, text=True, check=True
    )
    environment = os.environ | {
        "LD_PRELOAD": asan.stdout.strip(),
        "ASAN_OPTIONS": "detect_leaks=0:exitcode=99",
        "UBSAN_OPTIONS": "print_stacktrace=1",
    }
    done = subprocess.run(
        [sys.executable, "-S", "-E", "-c", CALLER, str(library), str(file)],
        capture_output=True,
        text=True,
        check=False,
        env=environment,
    )
    return "" if done.returncode == 0 else f"{done.stdout.split()[-1:]}: {done.stderr}"
