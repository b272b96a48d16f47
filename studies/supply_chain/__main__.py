import sys

from studies.command import main

sys.exit(main("supply_chain"))
