"""What a transcript may not hold, by the rules of Kaldi's `validate_text.pl`."""

import re
import unicodedata

_KALDIS_OWN = re.compile(r"(?<!\w)(<s>|</s>|#0)(?!\w)", re.ASCII)


def symbol_in(words: str) -> str | None:
    """Return a symbol of Kaldi's own that stands among words (``<s>``, ``</s>``, ``#0``), or None."""
    found = _KALDIS_OWN.search(words)
    return found and found[0]


def unprintable_in(line: str) -> str | None:
    """Return a character that is neither printable nor a plain blank, or None."""
    for character in line:
        control = unicodedata.category(character) in ("Cc", "Cn", "Cs")
        if control or (character.isspace() and character != " "):
            return character
    return None


def words_problem(words: str) -> str | None:
    """Return what is wrong with a transcript, with the remedy, or None."""
    if symbol := symbol_in(words):
        return f"{symbol!r} in it is a symbol of Kaldi's own: remove it"
    if (character := unprintable_in(words)) is not None:
        return f"character {character!r} in it must be printable, or a plain blank: replace it"
    return None
