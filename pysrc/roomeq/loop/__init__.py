"""The closed loop: what the simulation lacks against measured RIRs, which effect it is, and the error with it added."""
