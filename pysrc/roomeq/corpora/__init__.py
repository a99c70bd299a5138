"""Read corpora: clean speech becomes Kaldi data directories, measured RIRs become an RIR directory.

A reader for each kind of corpus lists its recordings (`record.Corpus`); `measured` and `speech` write them all in the
same way.
"""

from roomeq.corpora.measured import read_measured, read_noises
from roomeq.corpora.speech import prepare_speech

__all__ = ["prepare_speech", "read_measured", "read_noises"]
