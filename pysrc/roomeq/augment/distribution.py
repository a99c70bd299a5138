"""Distributions of signal-to-noise ratios, as users state them."""

from collections.abc import Callable

_MAX_SNR_DB = 200.0

Quantile = Callable[[float], float]
"""Turns a uniform number in [0, 1) into an SNR [dB]."""


def parse_distribution(text: str | float, name: str) -> Quantile | None:
    """Return the quantile function of an SNR distribution.

    Parameters
    ----------
    text
        ``"uniform LOW HIGH"``, ``"normal MEAN SD"``, ``"list A,B,..."`` (each equally likely), one number, or
        ``"none"``; all in dB.
    name
        Name of the option, for the message.

    Returns
    -------
    Quantile or None
        None for ``"none"``.

    Raises
    ------
    ValueError
        The text has another form, or a number is out of range (at most 200 dB).
    """
    kind, _, rest = str(text).strip().partition(" ")
    try:
        if kind == "none" and not rest:
            return None
        numbers = [float(part) for part in (rest if rest else kind).replace(",", " ").split()]
        if not numbers or not all(abs(number) <= _MAX_SNR_DB for number in numbers):
            raise ValueError
        if kind == "uniform" and len(numbers) == 2 and numbers[0] <= numbers[1]:
            return lambda u: numbers[0] + u * (numbers[1] - numbers[0])
        if kind == "normal" and len(numbers) == 2 and numbers[1] > 0:
            from statistics import NormalDist

            return lambda u: NormalDist(*numbers).inv_cdf(min(max(u, 1e-12), 1 - 1e-12))
        if (kind == "list" and rest) or not rest and len(numbers) == 1:
            return lambda u: numbers[int(u * len(numbers))]
        raise ValueError
    except ValueError:
        raise ValueError(f"{name}={text!r} must be 'uniform LOW HIGH', 'normal MEAN SD', 'list A,B,...', a number "
                         f"or 'none', in dB between -{_MAX_SNR_DB:g} and {_MAX_SNR_DB:g}") from None
