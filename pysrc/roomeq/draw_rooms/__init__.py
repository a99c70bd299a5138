"""Rooms that nobody measured, drawn from distributions: shapes, furniture, positions, reverberation times."""
