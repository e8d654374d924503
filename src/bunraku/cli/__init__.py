"""The command line: `bunraku VERB …`, one module a verb, each imported only when it is called."""

from bunraku.cli.app import main

__all__ = ["main"]
