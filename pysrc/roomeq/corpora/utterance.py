"""One utterance of a speech corpus, and the split of voices into train, dev and test."""

from dataclasses import dataclass
from pathlib import Path

ROLES = {"train": 0.70, "dev": 0.15, "test": 0.15}
"""Roles of speech, and their shares where a corpus has no sets."""


@dataclass(frozen=True)
class Utterance:
    """One utterance.

    Parameters
    ----------
    id : str
    speaker : str
        Kaldi's speaker, over which cepstral means are computed; the id starts with it.
    voice : str
        The person who speaks; a voice belongs to one of train, dev and test.
    gender : str or None
        ``"m"`` or ``"f"``.
    text : str or None
        What is said; None where the corpus has no transcripts.
    path : Path
    where : str
        File and line that list the utterance, for messages.
    """

    id: str
    speaker: str
    voice: str
    gender: str | None
    text: str | None
    path: Path
    where: str


def split_voices(counts: dict[str, int]) -> dict[str, str]:
    """Return the role of every voice, so that utterances are divided as in `ROLES` as closely as whole voices allow.

    Voices with the most utterances come first; each gets the role that lacks most of its share. The result depends on
    the counts and names only.

    Parameters
    ----------
    counts : dict
        Number of utterances of every voice.

    Raises
    ------
    ValueError
        There are fewer voices than roles.
    """
    if len(counts) < len(ROLES):
        raise ValueError(f"{len(counts)} speakers ({', '.join(sorted(counts))}) cannot be split into "
                         f"{', '.join(ROLES)}: name at least {len(ROLES)} speakers, or give the corpus sets")
    missing = {role: part * sum(counts.values()) for role, part in ROLES.items()}
    roles: dict[str, str] = {}
    for n, voice in enumerate(sorted(counts, key=lambda voice: (-counts[voice], voice))):
        empty = [role for role in ROLES if role not in roles.values()]
        # the last voices go to roles that are empty
        free = empty if len(counts) - n <= len(empty) else list(ROLES)
        role = max(free, key=lambda role: missing[role])
        roles[voice] = role
        missing[role] -= counts[voice]
    return roles
