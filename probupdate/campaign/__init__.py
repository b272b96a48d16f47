"""Measurement campaigns as they lie on disk.

`reading.read_campaign` opens one, `blocks.blocks` streams its data, `checking.check` says what is wrong with it,
`scada.block_conditions` tells what the turbine did meanwhile.
"""
