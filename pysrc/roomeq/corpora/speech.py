"""Write a speech corpus of any kind as the Kaldi data directories `train.clean`, `dev.clean` and `test.clean`."""

import logging
import os
from collections import Counter
from collections.abc import Iterable, Mapping
from hashlib import sha256
from itertools import combinations
from pathlib import Path
from typing import Any

from roomeq.core.build import Build
from roomeq.core.digests import Listed, names_in_entry
from roomeq.core.files import physical
from roomeq.corpora.kaldi_dir import find_kaldi_dirs, read_kaldi_dir
from roomeq.corpora.librispeech import find_sets, list_librispeech
from roomeq.corpora.record import AUDIO_SUFFIXES, by_stamp
from roomeq.corpora.speech_folder import list_audio_folder
from roomeq.corpora.speech_plan import KaldiPart, Plan, plan_kaldi, plan_utterances
from roomeq.corpora.table import MANIFEST, find_manifest, refuse_spreadsheet
from roomeq.corpora.transcripts import list_transcripts
from roomeq.corpora.utterance import ROLES, Utterance, split_voices

logger = logging.getLogger(__name__)

Listing = list[Utterance] | list[KaldiPart]
"""What belongs to a role: utterances, or parts of Kaldi data directories."""
SetNames = Mapping[str, tuple[str, ...]]
"""Names of the corpus' sets by role."""
DEFAULT_SETS: SetNames = {"train": ("train-clean-100",), "dev": ("dev-clean",), "test": ("test-clean",)}
"""What the commands ask for where nobody chooses sets: they are those of LibriSpeech, and other corpora need not have
them."""


def prepare_speech(source: Path, out: Path, *, train_sets: Iterable[str] = (), dev_sets: Iterable[str] = (),
                   test_sets: Iterable[str] = (), limit: int | None = None, channel: int = 0,
                   nj: int = 1) -> list[Path]:
    """Make Kaldi data directories from a corpus of clean speech.

    A directory holds `wav.scp` (``UTT flac -c -d -s FILE |``, FILE absolute), `text`, `utt2spk`, `spk2utt`, `utt2dur`,
    `reco2dur` and, if the gender of every speaker is known, `spk2gender`, sorted by bytes. Audio stays where it is if
    it is 16 kHz 16-bit mono FLAC or WAV. Other audio is converted and written to the directory, which the log mentions.

    Parameters
    ----------
    source : Path
        A LibriSpeech tree (`SPEAKERS.TXT`, `set/reader/chapter/*.flac`, `*.trans.txt`) or the folder above it; a
        folder with `manifest.csv` (`file`, `transcript`, optional `utt_id`, `speaker`, `gender`, `set`), or that CSV; a
        Kaldi data directory or a folder of several, whose lines are copied; or a folder of audio files without
        transcripts (`roomeq.corpora.speech_folder`), for which no `text` is written.
    out : Path
        Where `train.clean`, `dev.clean` and `test.clean` go.
    train_sets, dev_sets, test_sets : iterable of str
        Names of the corpus' sets. Where they are those of `DEFAULT_SETS` or none, and the corpus has no such set, sets
        are taken whose names begin with the roles; a corpus without sets is split by speaker into about 70, 15 and 15 %
        of its utterances.
    limit : int, optional
        Largest number of utterances per role; their choice does not depend on what else is in the corpus.
    channel : int
        Channel of files with several that is used, counted from 0; of Kaldi data directories, `wav.scp` chooses it.
    nj : int
        Number of processes.

    Returns
    -------
    dirs : list of Path

    Raises
    ------
    ValueError
        The path is not a speech corpus, a set is missing, transcripts and audio do not match, two utterances share an
        id, an audio file is broken or sampled below 16 kHz, the channel of a Kaldi data directory is to be chosen, or
        `out` is the corpus itself.
    """
    source, out = Path(source), Path(out)
    wanted = {"train": tuple(train_sets), "dev": tuple(dev_sets), "test": tuple(test_sets)}
    if limit is not None and limit < 1:
        raise ValueError(f"limit={limit} utterances must be at least 1")
    if channel < 0:
        raise ValueError(f"channel={channel} must be 0 or more: channels are counted from 0")
    if not source.exists():
        raise ValueError(f"{source}: no such file or directory: check the path of the speech corpus")
    if os.path.realpath(out) == os.path.realpath(source):
        raise ValueError(f"{out}: is the folder of the speech corpus, which would be read together with the data "
                         "directories when this step runs again: choose another output")
    corpus = list_speech(source, wanted)
    if channel and any(_sorted_out(listed)[0] for listed in corpus.values()):
        raise ValueError(f"{source}: channel={channel} must be 0, as the audio of a Kaldi data directory is not "
                         "touched: choose the channel in wav.scp")
    _warn_of_shared({role: _voices(corpus[role]) for role in ROLES}, source)
    options = dict(sets=wanted, limit=limit, channel=channel, source=os.path.realpath(source))
    builds = {role: Build(out / f"{role}.clean", step="prepare-speech", inputs=_inputs(source, corpus[role]),
                          options=dict(options, role=role, said=_said(corpus[role])), refers=True) for role in ROLES}
    plans = [(build, _plan(build, corpus[role], limit, channel)) for role, build in builds.items() if not build.done]
    for build, plan in plans:  # all directories are made before one is put in place
        build.run(plan.items, plan.make, nj=nj)
    for build, _ in plans:
        build.withdraw()
    for build, plan in plans:
        build.finish(plan.assemble)
    return [build.out for build in builds.values()]


def _plan(build: Build, listed: Listing, limit: int | None, channel: int) -> Plan:
    parts, utterances = _sorted_out(listed)
    return plan_kaldi(parts, limit) if parts else plan_utterances(build, utterances, limit, channel)


def _sorted_out(listed: Listing) -> tuple[list[KaldiPart], list[Utterance]]:
    return ([part for part in listed if isinstance(part, KaldiPart)],
            [utterance for utterance in listed if isinstance(utterance, Utterance)])


def _said(listed: Listing) -> str:
    """Return a hash of what a corpus says of the utterances of a role."""
    parts, utterances = _sorted_out(listed)
    said = repr(sorted((os.path.realpath(part.directory.path), part.directory.files, sorted(part.utterances))
                       for part in parts) if parts else
                [(utterance.id, utterance.speaker, utterance.gender, utterance.text) for utterance in utterances])
    return sha256(said.encode()).hexdigest()


def _inputs(source: Path, listed: Listing) -> list[Path | Listed]:
    """Return the audio of a role, and the corpus where its stamp covers some of it."""
    parts, utterances = _sorted_out(listed)
    if parts:
        names = {name for part in parts for entry in part.directory.files["wav.scp"].values()
                 for name in names_in_entry(entry)}
        return [*by_stamp(source, ()).inputs, Listed(tuple(map(Path, sorted(names))))]
    stamped = by_stamp(source, (utterance.path for utterance in utterances))
    # as `wav.scp` names them, whatever the path of the corpus
    return [*stamped.inputs, Listed(tuple(map(physical, stamped.others)))]


def list_speech(source: Path, wanted: SetNames) -> Mapping[str, Listing]:
    """List the utterances, or the parts of Kaldi data directories, of every role.

    Raises
    ------
    ValueError
        See `prepare_speech`.
    """
    if source.is_file() and source.suffix.lower() in AUDIO_SUFFIXES:
        raise ValueError(f"{source}: is one audio file, but a corpus is expected: give its folder, or a CSV")
    refuse_spreadsheet(source)
    if manifest := source if source.is_file() else find_manifest(source):
        sets = list_transcripts(manifest)
        if set(sets) == {""} and not _are_chosen(wanted):
            return _split(sets[""], source)
        return {role: [utterance for name in names for utterance in sets[name]]
                for role, names in _sets_of_roles(wanted, sets, manifest).items()}
    if paths := find_kaldi_dirs(source):
        return _list_kaldi(paths, wanted, source)
    if trees := find_sets(source):
        if list(trees.values()) == [source] and not _are_chosen(wanted):
            return _split(list_librispeech([source]), source)
        return {role: list_librispeech(trees[name] for name in names)
                for role, names in _sets_of_roles(wanted, trees, source).items()}
    if source.is_dir() and len((folders := list_audio_folder(source))[""]) > 0:
        return _list_without_text(folders, wanted, source)
    raise ValueError(f"{source}: no speech corpus: expected LibriSpeech (set/reader/chapter/*.trans.txt), "
                     f"{MANIFEST} with transcripts, wav.scp of a Kaldi data directory, or audio files")


def _list_without_text(folders: dict[str, list[Utterance]], wanted: SetNames, source: Path) -> Mapping[str, Listing]:
    """Return the utterances of every role of a folder of audio files; its first folders are sets or speakers."""
    utterances = folders.pop("")
    logger.warning("%s: no transcripts: each of %d audio files is an utterance, and no text is written", source,
                   len(utterances))
    requested = {name for names in wanted.values() for name in names}
    if not _are_chosen(wanted) and not requested & set(folders) and not all(
            any(name.lower().startswith(role) for name in folders) for role in ROLES):
        _warn_of_no_folders(utterances, source)
        return _split(utterances, source)
    of_roles = {role: [utterance for name in names for utterance in folders[name]]
                for role, names in _sets_of_roles(wanted, folders, source).items()}
    _warn_of_no_folders([utterance for listed in of_roles.values() for utterance in listed], source)
    return of_roles


def _warn_of_no_folders(utterances: list[Utterance], source: Path) -> None:
    """Warn of files without the folder of a speaker: those of one speaker may be in several roles."""
    if alone := sum(utterance.speaker == utterance.id for utterance in utterances):
        logger.warning("%s: no folders of speakers for %d of %d files: each of them counts as a speaker of its own: "
                       "put the files of each speaker into a folder, or train, dev and test may share voices", source,
                       alone, len(utterances))


def _sets_of_roles(wanted: SetNames, sets: Mapping[str, Any], source: Path) -> SetNames:
    """Return the names of each role's sets; if there are none of the default ones, the sets named like the roles."""
    requested = [name for names in wanted.values() for name in names]
    if not _are_chosen(wanted) and not any(name in sets for name in requested):
        like = {role: tuple(name for name in sets if name.lower().startswith(role)) for role in ROLES}
        if all(like.values()):
            logger.info("%s: sets by name: %s", source, "; ".join(f"{x} {','.join(like[x])}" for x in ROLES))
            return like
    for role, names in wanted.items():
        for name in names or ("(none named)",):
            if name not in sets:
                present = ", ".join(sorted(sets))
                raise ValueError(f"{source}: {role} set {name!r} is not in it (it has {present or 'no sets'}): " + (
                    f"choose with --{role}-sets" if present else f"leave --{role}-sets out"))
            if requested.count(name) > 1:
                raise ValueError(f"{source}: set {name!r} is named {requested.count(name)} times: train, dev and test "
                                 "must not share speech: name it once")
    return wanted


def _are_chosen(wanted: SetNames) -> bool:
    """Tell whether sets are wanted that are not those of `DEFAULT_SETS`."""
    return any(names not in ((), DEFAULT_SETS[role]) for role, names in wanted.items())


def _split(utterances: list[Utterance], source: Path) -> dict[str, list[Utterance]]:
    roles = _roles((utterance.voice for utterance in utterances), source)
    return {role: [utterance for utterance in utterances if roles[utterance.voice] == role] for role in ROLES}


def _voices(listed: Listing) -> set[str]:
    parts, utterances = _sorted_out(listed)
    return {utterance.voice for utterance in utterances} | {
        voice for part in parts for utterance, voice in part.directory.voices().items()
        if utterance in part.utterances}


def _warn_of_shared(voices: dict[str, set[str]], source: Path) -> None:
    """Warn if a voice is in two roles, whose results are then not those on unseen voices."""
    for first, second in combinations(ROLES, 2):
        if shared := sorted(voices[first] & voices[second]):
            logger.warning("%s: %d voices are in both %s and %s (%s ...): results are not those on unseen voices",
                           source, len(shared), first, second, shared[0])


def _roles(voices: Iterable[str], source: Path) -> dict[str, str]:
    try:
        return split_voices(Counter(voices))
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from None


def _list_kaldi(paths: Mapping[str, Path], wanted: SetNames, source: Path) -> dict[str, list[KaldiPart]]:
    if "" in paths and not _are_chosen(wanted):
        whole = read_kaldi_dir(paths[""])
        voices = whole.voices()
        roles = _roles(voices.values(), source)
        return {role: [KaldiPart(whole, {utterance for utterance, voice in voices.items() if roles[voice] == role})]
                for role in ROLES}
    parts = {}
    for role, names in _sets_of_roles(wanted, paths, source).items():
        directories = [read_kaldi_dir(paths[name]) for name in names]
        parts[role] = [KaldiPart(directory, set(directory.files["utt2spk"])) for directory in directories]
    return parts
