"""What a simulation or a measurement may get wrong, as data: the catalogue's rows, and which of them are normal."""
