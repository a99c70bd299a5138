"""Geometric room acoustics: what a source sounds like at a microphone."""
