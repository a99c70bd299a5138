"""Word error rates: read Kaldi's scoring, count errors, estimate confidence intervals, print the table."""

from roomeq.wer.measure import measure_wer

__all__ = ["measure_wer"]
