"""``python3 -m dolfin_elastic`` is the command line."""

from dolfin_elastic.cli import main

main()
