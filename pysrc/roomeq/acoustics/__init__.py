"""Room acoustics that needs no simulator: direct sound, decay metrics, air and filter banks."""
