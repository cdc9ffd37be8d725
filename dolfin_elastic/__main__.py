"""``python3 -m dolfin_elastic`` is the command line."""

import os
import sys
from contextlib import suppress

# Nothing is imported from the current folder: neither a numpy.py nor a random.py of somebody.  The
# package knows where its own modules are.  `python3 -P` leaves the folder out from the start.
_here = {"", os.curdir}
with suppress(OSError):  # it is gone
    _here.add(os.getcwd())
sys.path[:] = [folder for folder in sys.path if folder not in _here]

from dolfin_elastic.cli.app import main  # noqa: E402

main()
