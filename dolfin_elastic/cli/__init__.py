"""The command line: the only folder that prints or makes an exit code.

Typer draws its own help with rich where it can import that: markdown, syntax of programs and all.
`app` asks for plain help, and so typer is imported here as if rich were not there, which is a
sixth of the time of --help and 12 MB of each rank; what `console` needs of rich comes later.
"""

import sys

if "typer" not in sys.modules:
    _rich = {name: module for name, module in sys.modules.items() if name == "rich"}
    sys.modules["rich"] = None  # type: ignore[assignment]  # importing it raises ImportError
    try:
        import typer as typer
    finally:
        del sys.modules["rich"]
        sys.modules.update(_rich)
