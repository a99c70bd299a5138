"""Far-field speech: what is drawn, mixed and packed."""
