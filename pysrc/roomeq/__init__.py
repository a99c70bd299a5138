"""roomeq: simulated room impulse responses that learn from measured ones, and Kaldi data made with them."""

__version__ = "0.1.0"
