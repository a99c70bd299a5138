"""Sub-band EQ: its distribution, the compensation filters, distances."""
