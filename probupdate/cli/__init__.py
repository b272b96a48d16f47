"""The command line: each verb reads files, calls the Python function of the same name and writes files."""

from probupdate.cli.parser import EXAMPLES, GROUPS, build_parser
from probupdate.cli.program import argument_paths, main

__all__ = ["EXAMPLES", "GROUPS", "argument_paths", "build_parser", "main"]
