"""`python -m probupdate.cli`."""

import sys

from probupdate.cli.program import main

if __name__ == "__main__":
    sys.exit(main())
