"""``python3 -m dolfin_elastic`` is the command line."""

import os
import sys

# Nothing is imported from the current folder: neither a numpy.py nor a random.py of somebody.  The
# package knows where its own modules are.  `python3 -P` leaves the folder out from the start.
_here = {"", os.curdir}
# Without contextlib, which would itself be looked for in the current folder.
try:  # noqa: SIM105
    _here.add(os.getcwd())
except OSError:  # it is gone
    pass
sys.path[:] = [folder for folder in sys.path if folder not in _here]

from dolfin_elastic.cli.app import main  # noqa: E402

main()
