"""Errors of the systems of a Kaldi workspace, utterance by utterance."""

import hashlib
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from roomeq.core.arrays import IntArray
from roomeq.wer.scoring import (
    REFERENCE_FILE,
    Texts,
    Weights,
    choose_weights,
    count_errors,
    read_hypotheses,
    read_reference,
    read_texts,
    scoring_dir,
)
from roomeq.wer.workspace import System, Workspace


@dataclass(frozen=True)
class Scores:
    """Errors of all systems on one evaluation set.

    Attributes
    ----------
    errors : dict of ndarray, each of shape (n_utterances, 3)
        Substitutions, deletions and insertions by system.
    words : ndarray, shape (n_utterances,)
        Words of the reference.
    utterances : list of str, length n_utterances
        Identifier of each utterance.
    sources : list of str, length n_utterances
        RIR of each utterance; of clean speech the speaker.
    room : ndarray, shape (n_utterances,)
        Index into `room_names`.
    room_names : list of str
        Clean speech has no rooms; its speakers take their place.
    has_rooms : bool
        False for clean speech.
    reference : str
        SHA-256 of the utterances and their words.
    """

    errors: dict[System, IntArray]
    words: IntArray
    utterances: list[str]
    sources: list[str]
    room: IntArray
    room_names: list[str]
    has_rooms: bool
    reference: str


def choose_all_weights(workspace: Workspace) -> dict[System, Weights]:
    """Return the weights of each system, chosen on its development set."""
    return {system: choose_weights(workspace.decode_dir(system, workspace.dev_of[system.row]))
            for system in workspace.systems()}


def read_scores(workspace: Workspace, set_name: str, weights: dict[System, Weights],
                room_of_rir: dict[str, str]) -> Scores:
    """Count the errors of all systems on a set.

    Parameters
    ----------
    weights
        Weights to score each system with.

    Raises
    ------
    ValueError
        References differ between systems, an utterance has no hypothesis or RIR, or its RIR is unknown.
    """
    reference = _shared_reference(workspace, set_name)
    errors = {system: count_errors(list(reference.values()), read_hypotheses(
        weights[system].path(workspace.decode_dir(system, set_name)), reference))
        for system in workspace.systems(set_name)}
    clean = set_name.endswith(".clean")
    sources = _read_sources(workspace.path / "data" / set_name, reference, None if clean else room_of_rir)
    rooms = sources if clean else [room_of_rir[source] for source in sources]
    room_names, room = np.unique(rooms, return_inverse=True)
    return Scores(errors, np.array([len(spoken) for spoken in reference.values()]), list(reference), sources, room,
                  room_names.tolist(), has_rooms=not clean,
                  reference=hashlib.sha256(repr(sorted(reference.items())).encode()).hexdigest())


def _shared_reference(workspace: Workspace, set_name: str) -> Texts:
    """Read the reference of a set, which must be the same for all systems."""
    first_dir, *other_dirs = [workspace.decode_dir(system, set_name) for system in workspace.systems(set_name)]
    shared = read_reference(first_dir)
    for decode in other_dirs:
        reference = read_reference(decode)
        for utterance in [*shared, *reference]:
            if reference.get(utterance) != shared.get(utterance):
                raise ValueError(f"{scoring_dir(decode)}/{REFERENCE_FILE}: reference of {utterance!r} is not that of "
                                 f"{first_dir}: rows are compared on the same speech, decode them on one data "
                                 "directory")
    return shared


def _read_sources(data: Path, reference: Texts, known_rirs: dict[str, str] | None) -> list[str]:
    """Return the RIR of each utterance of a data directory; the speaker if it is clean speech, without known RIRs."""
    path = data / ("utt2spk" if known_rirs is None else "utt2rir")
    table, sources = read_texts(path), []
    for utterance in reference:
        source = " ".join(table.get(utterance, ()))
        if not source:
            raise ValueError(f"{path}: no {'speaker' if known_rirs is None else 'RIR'} of utterance {utterance!r}: "
                             "make the data directory again")
        if known_rirs is not None and source not in known_rirs:
            raise ValueError(f"{path}: RIR {source!r} of utterance {utterance!r} is not among those of --rirs: give "
                             "the RIR directory that the set was made with")
        sources.append(source)
    return sources
