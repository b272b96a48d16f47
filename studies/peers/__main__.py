import sys

from studies.command import main

sys.exit(main("peers"))
