"""Directories of RIRs, noises and speech in the formats of lhotse, ESPnet, NeMo and Hugging Face datasets."""

from roomeq.export.step import export

__all__ = ["export"]
