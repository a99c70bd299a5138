"""Files, the build cache, digests, random numbers, audio and progress: no acoustics."""
