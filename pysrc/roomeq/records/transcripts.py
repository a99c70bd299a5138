"""Rules of Kaldi's `validate_text.pl` for transcripts."""

import re
import unicodedata

_RESERVED = re.compile(r"(?<!\w)(<s>|</s>|#0)(?!\w)", re.ASCII)


def symbol_in(words: str) -> str | None:
    """Return a symbol among the words that Kaldi reserves (``<s>``, ``</s>``, ``#0``), or None."""
    match = _RESERVED.search(words)
    return match[0] if match else None


def unprintable_in(line: str) -> str | None:
    """Return the first character that is neither printable nor a plain blank, or None."""
    for character in line:
        control = unicodedata.category(character) in ("Cc", "Cn", "Cs")
        if control or (character.isspace() and character != " "):
            return character
    return None


def words_problem(words: str) -> str | None:
    """Return what is wrong with a transcript and how to correct it, or None."""
    if symbol := symbol_in(words):
        return f"{symbol!r} is reserved by Kaldi: remove it"
    if (character := unprintable_in(words)) is not None:
        return f"character {character!r} in it must be printable, or a plain blank: replace it"
    return None
