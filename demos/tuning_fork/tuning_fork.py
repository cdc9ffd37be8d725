"""A tuning fork for concert pitch: how long must its prongs be to sound 440 Hz?

Problem
    A fork of square steel, 5 x 5 mm, with prongs 8 mm apart, clamped at the end of its stem.  Of
    its many modes one is its tone: the prongs swing against each other.  Nothing else moves, so
    the hand at the stem does not damp it.

Equations
    Small vibrations: K u = omega^2 M u.  The force of a mode on its support is measured by its
    effective masses: those of the tone are next to nothing in every direction.

Discretisation
    `fork.geo`: little boxes of six quadratic tetrahedra each, n across a prong, round in the bend.
    The tone is symmetric, so a quarter of the fork has it, too.  Its frequency at n = 2, 4 and 6,
    with prongs of 88 mm, is 436.42, 434.77 and 434.45 Hz: the error falls as 1/n^2, and what is
    extrapolated from n = 2 and 4 (434.22) is that from 4 and 6 (434.20) to 1e-4.

Result
    The length of the prongs by the secant rule, which `fork.geo` has to a hundredth of
    a millimetre; the whole fork, of `case.toml`, has the tone within 0.1 % of 440 Hz.  Straight
    beams that are clamped where the bend begins, and as long as the axis down to the bend's
    middle, have it between them.

        python3 demos/tuning_fork/tuning_fork.py
        mpirun -n 2 python3 demos/tuning_fork/tuning_fork.py
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
from mpi4py import MPI

from dolfin_elastic import Case, read_case, run
from dolfin_elastic.core.parallel import on_root

HERE = Path(__file__).parent
PITCH = 440.0
TOLERANCE = 1e-3
"""Of the frequency: the whole fork's other triangulation accounts for 2e-4, the extrapolation for
1e-4, and a hundredth of a millimetre for 2e-4."""
SIDE, BEND, E, DENSITY = 5e-3, np.pi / 2 * 6.5e-3, 206e9, 7850.0


def geometry(**values) -> str:
    """The text of fork.geo with other values."""
    text = (HERE / "fork.geo").read_text(encoding="utf-8")
    for name, value in values.items():
        text = re.sub(rf"^{name} = [\d.]+;", f"{name} = {value};", text, flags=re.MULTILINE)
    return text


def stated() -> float:
    """The length of the prongs that stands in fork.geo [mm]."""
    return float(re.search(r"^prong = ([\d.]+);", geometry(), re.MULTILINE)[1])


def tone(prong: float, n: int) -> float:
    """Frequency of a quarter of the fork, whose lowest mode is the tone [Hz]."""
    file, comm = Path("quarter.geo").absolute(), MPI.COMM_WORLD
    on_root(comm, lambda: file.write_text(geometry(prong=prong, n=n, quarter=1)))
    tables = read_case(HERE / "case.toml").to_dict()
    tables["mesh"]["file"] = str(file)
    tables["surfaces"] = {
        "middle": {"plane": "x", "at": "min"},
        "face": {"plane": "z", "at": "min"},
    }
    tables["support"] += [{"on": name, "kind": "symmetry"} for name in ("middle", "face")]
    tables["modal"] = {"count": 1}
    case = Case.from_dict(tables)
    problem = case.make_problem(case.read_body())
    (mode,) = case.make_solver(problem).modes()
    on_root(comm, file.unlink)
    return mode.frequency


def tuned(share: float) -> float:
    """Length at which share x tone is the pitch, on the coarse mesh, by the secant rule [mm]."""
    lengths = [85.0, 90.0]
    heard = [share * tone(length, 2) for length in lengths]
    while abs(heard[-1] - PITCH) > 0.1:
        slope = (heard[-1] - heard[-2]) / (lengths[-1] - lengths[-2])
        lengths.append(lengths[-1] + (PITCH - heard[-1]) / slope)
        heard.append(share * tone(lengths[-1], 2))
    return lengths[-1]


def beam(length: float) -> float:
    """Lowest frequency of a clamped beam of Euler and Bernoulli [Hz]."""
    bending = np.sqrt(E * SIDE**2 / (12 * DENSITY))
    return 1.875104**2 / (2 * np.pi * length**2) * bending


def main():
    length = stated()
    coarse, fine = (tone(length, n) for n in (2, 4))
    share = (fine - (coarse - fine) / 3) / coarse  # of the extrapolated to the coarse one
    found = tuned(share)
    modes = list(run(read_case(HERE / "case.toml")))
    # The mode that shakes nothing.
    quiet = min(modes, key=lambda m: max(m.effective[k] / m.whole[k] for k in m.whole))
    pitch = share * quiet.frequency
    shaken = max(quiet.effective[k] / quiet.whole[k] for k in quiet.whole)
    if MPI.COMM_WORLD.rank == 0:
        print(f"prongs of {found:.2f} mm sound {PITCH:g} Hz; in fork.geo: {length:g} mm")
        print(f"mode {quiet.number} of the fork is its tone: it shakes {shaken:.1e} of its mass")
        print(f"beams without and with the bend: {beam(length / 1e3):.1f}", end=" and ")
        print(f"{beam(length / 1e3 + BEND):.1f} Hz")
        print(f"tone {pitch:.2f} Hz, off by {abs(pitch / PITCH - 1):.1e} (allowed {TOLERANCE:.0e})")
    assert abs(found - length) < 0.02  # stated to a hundredth of a millimetre
    assert quiet.number == 4
    assert shaken < 1e-3
    assert beam(length / 1e3 + BEND) < pitch < beam(length / 1e3)
    assert abs(pitch / PITCH - 1) < TOLERANCE


if __name__ == "__main__":
    main()
