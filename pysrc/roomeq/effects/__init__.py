"""What a simulation may lack: physical effects, each with its parameters and its reference."""
