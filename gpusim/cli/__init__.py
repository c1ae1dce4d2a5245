"""The command line: one module a command, each imported only when its command runs."""

from gpusim.cli.app import main

__all__ = ["main"]
