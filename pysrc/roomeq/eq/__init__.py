"""Sub-band EQ of measured and simulated RIRs: its distribution, compensation filters, distances between sets."""
