#!/usr/bin/env python3
"""Make a Kaldi dictionary of the words of a text, with pronunciations of eSpeak NG (General American).

Usage: make_dict.py [--no-ids] TEXT DICT_DIR
e.g.:  python local/make_dict.py data/train.clean/text exp/kaldi/dict

TEXT is a Kaldi `text` file or, with --no-ids, lines of words only. Writes the input of stock utils/prepare_lang.sh,
with <UNK> for unknown words. For the synthetic corpus and small tasks; LibriSpeech comes with a lexicon.
"""

import argparse
import re
import sys
from itertools import groupby
from pathlib import Path

import espeak_client
import espeak_worker
from roomeq.core.build import Build
from roomeq.core.files import read_text, write_text

VOICE = "en-us"
SILENCES = {"!SIL": "SIL", "<UNK>": "SPN"}
WORD = re.compile(r"'?\w[\w'.-]*")
PHONES = {  # ARPAbet symbols of eSpeak NG's American English phonemes
    "0": "AA", "3": "ER", "3:": "ER", "@": "AX", "@-": "AX", "@2": "AX", "@L": "AX L", "A:": "AA", "A@": "AA R",
    "D": "DH", "E": "EH", "I": "IH", "I#": "IH", "I2": "IH", "N": "NG", "O": "AO", "O2": "AO", "O:": "AO",
    "O@": "AO R", "OI": "OY", "S": "SH", "T": "TH", "U": "UH", "U@": "UH R", "V": "AH", "Z": "ZH", "?": "T",
    "a": "AE", "a#": "AX", "a:": "AA", "aa": "AE", "aI": "AY", "aI3": "AY ER", "aI@": "AY AX", "aU": "AW", "b": "B",
    "d": "D", "dZ": "JH", "e@": "EH R", "eI": "EY", "f": "F", "g": "G", "h": "HH", "i": "IY", "i:": "IY",
    "i@": "IH AX", "i@3": "IH R", "j": "Y", "k": "K", "l": "L", "l#": "L", "m": "M", "n": "N", "n-": "AX N",
    "o@": "AO R", "oU": "OW", "p": "P", "r": "R", "r-": "R", "s": "S", "t": "T", "t#": "DX", "t2": "T", "tS": "CH",
    "u": "UW", "u:": "UW", "v": "V", "w": "W", "x": "K", "z": "Z"}


def pronunciation(word: str, phonemes: str) -> list[str]:
    """Return the phones of a word from eSpeak NG's phonemes.

    Parameters
    ----------
    word
    phonemes
        Joined by ``_``, with stress marks.

    Raises
    ------
    ValueError
        The word has no phoneme, or one outside American English.
    """
    names = [re.sub("[',%=|;!]", "", name) for name in re.split("[_ ]+", phonemes)]
    unknown = [name for name in names if name and name not in PHONES]
    phones = " ".join(PHONES[name] for name in names if name in PHONES).split()
    if unknown or not phones:
        raise ValueError(f"word {word!r} has pronunciation {phonemes!r}, which must consist of American English "
                         "phonemes: change the spelling")
    return [phone for phone, _ in groupby(phones)]  # "A@ r" holds R twice


def read_words(path: Path, *, ids: bool = True) -> list[str]:
    """Return the distinct words of a text, sorted.

    Parameters
    ----------
    path
    ids
        Whether the first field of a line is an utterance's id, as in Kaldi's `text`.

    Raises
    ------
    ValueError
        A word has characters other than letters, digits, dots, hyphens and apostrophes, or there are no words.
    """
    words = set()
    for number, line in enumerate(read_text(path).splitlines(), start=1):
        for word in line.split()[1 if ids else 0:]:
            if word not in SILENCES:
                if not WORD.fullmatch(word):
                    raise ValueError(f"{path}:{number}: {word!r} must be a word of letters or digits: correct the text")
                words.add(word)
    if not words:
        raise ValueError(f"{path}: holds no words: give a Kaldi text file, or --no-ids for lines without ids")
    return sorted(words)


def make_dict(text: Path, dict_dir: Path, *, ids: bool = True) -> None:
    """Make the dictionary.

    Parameters
    ----------
    text
        File with the words.
    dict_dir
        Directory to make.
    ids
        See `read_words`.

    Raises
    ------
    ValueError
        See `read_words` and `pronunciation`; or `dict_dir` exists and was not made by this function.
    OSError
        eSpeak NG does not run, or `dict_dir` cannot be written.
    """
    words = read_words(text, ids=ids)
    sources = [Path(str(module.__file__)) for module in (sys.modules[__name__], espeak_client, espeak_worker)]
    build = Build(dict_dir, step="dict", options=dict(words=words), inputs=sources)

    if build.done:
        return
    with espeak_client.Espeak() as espeak:
        spoken = espeak.phonemes(VOICE, [word.lower() for word in words])  # capitals would be spelled out
    lexicon = {word: pronunciation(word, phonemes) for word, phonemes in zip(words, spoken, strict=True)}

    def assemble(directory: Path, _: list[None]) -> None:
        phones = sorted({phone for phones in lexicon.values() for phone in phones})
        lines = [f"{word} {phone}" for word, phone in SILENCES.items()]
        lines += [f"{word} {' '.join(phones)}" for word, phones in lexicon.items()]
        for name, rows in (("lexicon", lines), ("nonsilence_phones", phones), ("silence_phones", SILENCES.values()),
                           ("optional_silence", ["SIL"]), ("extra_questions", [])):
            write_text(directory / f"{name}.txt", "".join(f"{row}\n" for row in rows))
        print(f"{dict_dir}: {len(words)} words, {len(phones)} phones")

    build.run({}, lambda name, item: None)
    build.finish(assemble)


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and make the dictionary; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("text", type=Path, metavar="TEXT")
    parser.add_argument("dict_dir", type=Path, metavar="DICT_DIR")
    parser.add_argument("--no-ids", dest="ids", action="store_false", help="lines hold words only")
    args = parser.parse_args(argv)
    try:
        make_dict(args.text, args.dict_dir, ids=args.ids)
    except (ValueError, OSError) as error:
        print(f"make_dict.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
