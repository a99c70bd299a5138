"""Synthetic Kaldi workspaces with given numbers of errors, for tests of word error rates."""

import json
from itertools import cycle

from roomeq.core.files import write_text

WORDS = "one two three four five six seven eight nine ten".split()
LMWTS, PENALTIES = (7, 8), ("0.0", "0.5")
BEST = (8, "0.5")
"""LM weight and penalty with the fewest errors in `put_decode`."""


def sentence(n):
    """Return ten words; the first identifies the sentence."""
    return [f"w{n}", *WORDS[1:]]


def spoilt(words, errors):
    """Return a hypothesis with `errors` substitutions."""
    return ["WRONG"] * errors + words[errors:]


def put_texts(path, texts):
    write_text(path, "".join(" ".join([ident, *words]).rstrip() + "\n" for ident, words in texts.items()))


def put_decode(decode, reference, hypotheses, spoil_best=0):
    """Write a decode directory: `hypotheses` at the best weights, with one more insertion at the others.

    Parameters
    ----------
    spoil_best : int
        Words inserted in the first utterance at the best weights.
    """
    put_texts(decode / "scoring_kaldi/test_filt.txt", reference)
    first = next(iter(reference))
    for lmwt in LMWTS:
        for penalty in PENALTIES:
            n_inserted = spoil_best if (lmwt, penalty) == BEST else 1
            texts = hypotheses | {first: [*hypotheses[first], *["MORE"] * n_inserted]}
            put_texts(decode / f"scoring_kaldi/penalty_{penalty}/{lmwt}.txt", texts)


def put_rirs(directory, rooms, rirs_per_room=2):
    """Write an RIR directory without audio: ``room-0``, ``room-1`` ... of each room; only the hall has a valid T20."""
    parameters = {room: dict(t20_s=[1.0] * 8, t20_valid=[room == "hall"] * 8) for room in rooms}
    rows = [dict(id=f"{room}-{n}", wav=f"{room}-{n}.wav", room_id=room, source_id="s", mic_id="m", fs_hz=16000,
                 n_samples=800, acoustic_parameters=parameters[room] | dict(drr_db=2.0 * n))
            for room in rooms for n in range(rirs_per_room)]
    write_text(directory / "rirs.jsonl", "".join(json.dumps(row) + "\n" for row in sorted(rows, key=lambda r: r["id"])))


def utterances_of(name, rooms, per_room=2):
    """Return the RIR of each utterance of a set, `per_room` utterances in each room."""
    return {f"{name}-{room}-{n}": f"{room}-{n % 2}" for room in rooms for n in range(per_room)}


def put_workspace(workspace, errors, *, sets, columns=("tgsmall",), seed=0):
    """Write a workspace whose systems make given errors.

    Parameters
    ----------
    errors : dict of callable
        By row: ``errors(name, column, utterance, rir) -> int`` in [0, 10], substitutions in ten words.
    sets : dict of dict of str
        By name of the set: RIR by utterance.
    """
    write_text(workspace / "seed", f"{seed}\n")
    for row in errors:
        put_source(workspace, row, workspace / row)
        write_text(workspace / row / "seed", f"{seed}\n")
    for name, rirs in sets.items():
        put_texts(workspace / "data" / name / "utt2rir", {ident: [rir] for ident, rir in rirs.items()})
        snrs = zip(rirs, cycle(("5", "12")))
        put_texts(workspace / "data" / name / "utt2snr", {ident: [snr] for ident, snr in snrs})
        reference = {ident: sentence(n) for n, ident in enumerate(rirs)}
        for row, count in errors.items():
            for column in columns:
                hypotheses = {ident: spoilt(words, count(name, column, ident, rirs[ident]))
                              for ident, words in reference.items()}
                put_decode(workspace / row / f"decode_{name}_{column}", reference, hypotheses)
                put_source(workspace, name, workspace / row / f"decode_{name}_{column}")


def put_source(workspace, name, made):
    """State what a set holds, and that something was made of it."""
    for path in (workspace / "data" / name, made):
        write_text(path / "source", f"state of {name}\n")


ROOMS = ("attic", "cellar", "hall", "kitchen")
DEV_ROOMS = ("bath", "office")
ERRORS = {"train.clean": 8, "train.real.rvb": 1, "train.sim.rvb": 5, "train.sim.EQ.rvb": 3}
"""Errors in ten words, by training data; see `put_example`."""


def put_example(root, seeds=1, columns=("tgsmall",), errors=ERRORS):
    """Write ``root/rirs`` and ``root/kaldi0`` ...: each system makes its errors, and one more in the hall."""
    put_rirs(root / "rirs", (*ROOMS, *DEV_ROOMS))
    sets = {"dev.real.rvb": utterances_of("dev", DEV_ROOMS), "test.real.rvb": utterances_of("test", ROOMS)}
    for seed in range(seeds):
        put_workspace(root / f"kaldi{seed}", {
            row: lambda name, column, ident, rir, n=n: n + (rir.startswith("hall") and n < 8)
            for row, n in errors.items()}, sets=sets, columns=columns, seed=seed)
    return [root / f"kaldi{seed}" for seed in range(seeds)]
