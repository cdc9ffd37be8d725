"""The command line: the only folder that prints or makes an exit code."""
