"""Typed rows of the files that the toolkit reads and writes, and their schema."""
