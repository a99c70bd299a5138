"""The closed loop: find the effects that the simulation of measured RIRs lacks, add them, and report the error."""
