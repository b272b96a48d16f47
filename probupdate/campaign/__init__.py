"""Measurement campaigns as they lie on disk.

`reading.read_campaign` opens one, `blocks.blocks` streams its data, `checking.check` says what is wrong with it,
`scada.block_conditions` gives the turbine's state meanwhile.
"""

# what other rooms and users import; the other modules are this room's own
__all__ = [
    "between_setups", "blocks", "checking", "converting", "describing", "findings", "gaps", "heading", "last_line",
    "plausible", "pole_tables", "quantity", "reading", "rigid_bodies", "rotor_lines", "samples", "scada",
    "sensor_findings", "universal", "usable",
]
