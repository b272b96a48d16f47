import sys

from studies.command import main

sys.exit(main("oc4_jacket"))
