"""The command line, as ``python -m statechart``."""

import sys

from statechart.cli.main import program

sys.exit(program())
