"""One model of what scatters and drifts, whatever is expected: evidence of what moves along a record."""
