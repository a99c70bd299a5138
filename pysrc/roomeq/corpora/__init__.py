"""Corpora in: clean speech becomes Kaldi data directories, measured RIRs become an RIR directory.

One reader a kind of corpus lists what lies there (`record.Corpus`); `measured` and `speech` write all kinds alike.
"""

from roomeq.corpora.measured import read_measured, read_noises
from roomeq.corpora.speech import prepare_speech

__all__ = ["prepare_speech", "read_measured", "read_noises"]
