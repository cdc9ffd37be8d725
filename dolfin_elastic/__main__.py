"""``python3 -m dolfin_elastic`` is the command line."""

from dolfin_elastic.cli.app import main

main()
