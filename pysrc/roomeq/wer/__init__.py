"""Word error rates: what Kaldi's scoring left behind, the paper's table of it, and what it can show."""
