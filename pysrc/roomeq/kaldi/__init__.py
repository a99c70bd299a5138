"""Kaldi data directories: reading, checking and writing them, and the audio behind `wav.scp`."""

from roomeq.kaldi.validate import validate_data_dir

__all__ = ["validate_data_dir"]
