"""Structures drawn from a seed, each with its user's files, its sensors and a truth that another program solved.

Nothing of `probupdate` is used here but its command line (`commands`): jackets and lattices are solved by OpenSees,
matrices by scipy, records are simulated by plain numpy.
"""
