"""Write any speech corpus as the Kaldi data directories `train.clean`, `dev.clean` and `test.clean`."""

import logging
import os
import re
import shlex
from collections import Counter
from collections.abc import Iterable
from hashlib import sha256
from itertools import combinations
from pathlib import Path

from roomeq.core.audio import audio_info, read_audio, write_flac
from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.digests import audio_digest
from roomeq.core.files import write_text
from roomeq.corpora.kaldi_dir import KaldiDir, find_kaldi_dirs, read_kaldi_dir
from roomeq.corpora.librispeech import find_sets, list_librispeech
from roomeq.corpora.record import is_generated
from roomeq.corpora.table import MANIFEST
from roomeq.corpora.transcripts import list_transcripts
from roomeq.corpora.utterance import ROLES, Utterance, split_voices
from roomeq.records.transcripts import words_problem

logger = logging.getLogger(__name__)

_PLAIN_PATH = re.compile(r"[A-Za-z0-9_./+@,=%~^-]+")
_READABLE = ("FLAC", "WAV")


def prepare_speech(source: Path, out: Path, *, train_sets: Iterable[str] = (), dev_sets: Iterable[str] = (),
                   test_sets: Iterable[str] = (), limit: int | None = None, nj: int = 1) -> list[Path]:
    """Make Kaldi data directories from a corpus of clean speech.

    Written are `wav.scp` (``UTT flac -c -d -s FILE |``, FILE absolute), `text`, `utt2spk`, `spk2utt`, `utt2dur`,
    and `spk2gender` where every speaker's gender is known, sorted by bytes. Audio stays where it is, unless Kaldi
    could not read it so (another rate or format than 16 kHz 16-bit mono FLAC or WAV): then it is converted into
    the directory, and the log says so.

    Parameters
    ----------
    source : Path
        A LibriSpeech tree (`SPEAKERS.TXT`, `set/reader/chapter/*.flac`, `*.trans.txt`), with or without the folder
        `LibriSpeech` around it; a folder with `manifest.csv` (`file`, `transcript`, optional `utt_id`, `speaker`,
        `gender`, `set`) or that CSV; or a Kaldi data directory, or a folder of several, whose lines are passed on.
    out : Path
        Where `train.clean`, `dev.clean` and `test.clean` go.
    train_sets, dev_sets, test_sets : iterable of str
        Names of the corpus' sets. A corpus without sets is split by speaker, about 70/15/15 % of its utterances.
    limit : int, optional
        At most so many utterances a role: the same ones whatever else is in the corpus.
    nj : int
        Jobs.

    Returns
    -------
    dirs : list of Path

    Raises
    ------
    ValueError
        The path is no speech corpus, a set is not there, transcripts and audio do not fit, an utterance's id
        stands twice, or an audio file is broken or below 16 kHz.
    """
    source, out = Path(source), Path(out)
    wanted = {"train": tuple(train_sets), "dev": tuple(dev_sets), "test": tuple(test_sets)}
    if limit is not None and limit < 1:
        raise ValueError(f"limit={limit} utterances must be at least 1")
    if not source.exists():
        raise ValueError(f"{source}: no such file or directory: check the path of the speech corpus")
    corpus = list_speech(source, wanted)
    _warn_of_shared({role: _voices(corpus[role]) for role in ROLES}, source)
    options = dict(sets=wanted, limit=limit, source=os.path.realpath(source))
    builds = {role: Build(out / f"{role}.clean", step="prepare-speech", options=dict(
        options, role=role, listed=_listing(source, corpus[role])), inputs=[source] * is_generated(source), refers=True)
        for role in ROLES}
    plans = [(build, *(_plan_kaldi if isinstance(corpus[role], dict) else _plan_utterances)(
        build, corpus[role], limit)) for role, build in builds.items() if not build.done]
    for build, items, make, _ in plans:  # all are made before one is put in place
        build.run(items, make, nj=nj)
    for build, *_, assemble in plans:
        build.finish(assemble)
    return [build.out for build in builds.values()]


def _listing(source: Path, listed: list[Utterance] | dict) -> str:
    """Return a hash of what a role is made of: the words, and the audio unless a stamp of the corpus covers it."""
    if isinstance(listed, dict):
        said = repr(sorted((str(path), part.files, sorted(utts)) for path, (part, utts) in listed.items()))
        words = {word for part, _ in listed.values() for entry in part.files["wav.scp"].values()
                 for word in _words(entry)}
        audio = audio_digest(Path(re.sub(r":\d+$", "", word)) for word in sorted(words))
        return sha256((said + audio).encode()).hexdigest()
    said = repr([(utterance.id, utterance.speaker, utterance.gender, utterance.text) for utterance in listed])
    audio = "" if is_generated(source) else audio_digest(utterance.path for utterance in listed)
    return sha256((said + audio).encode()).hexdigest()


def _words(entry: str) -> list[str]:
    """Return the words of an entry of `wav.scp`, among them the files that it reads, whatever it does with them."""
    try:
        return shlex.split(entry)
    except ValueError:
        return entry.split()


def list_speech(source: Path, wanted: dict[str, tuple[str, ...]]) -> dict[str, list[Utterance] | dict]:
    """List utterances by role; of Kaldi data directories {KaldiDir: its utterances}.

    Raises
    ------
    ValueError
        See `prepare_speech`.
    """
    manifest = source if source.is_file() else source / MANIFEST
    if manifest.is_file():
        sets = list_transcripts(manifest)
        if set(sets) == {""}:
            return _split(sets[""], source)
        return {role: [utterance for name in names for utterance in sets[name]]
                for role, names in _sets_of_roles(wanted, sets, manifest).items()}
    if paths := find_kaldi_dirs(source):
        return _list_kaldi(paths, wanted, source)
    if trees := find_sets(source):
        if list(trees.values()) == [source]:
            return _split(list_librispeech([source]), source)
        return {role: list_librispeech(trees[name] for name in names)
                for role, names in _sets_of_roles(wanted, trees, source).items()}
    raise ValueError(f"{source}: no speech corpus: expected LibriSpeech (set/reader/chapter/*.trans.txt), "
                     f"{MANIFEST} with transcripts, or wav.scp of a Kaldi data directory")


def _sets_of_roles(wanted: dict[str, tuple[str, ...]], sets: dict, source: Path) -> dict[str, tuple[str, ...]]:
    """Return the names of each role's sets; where none of the wanted ones is there, sets named like the roles."""
    asked = [name for names in wanted.values() for name in names]
    if not any(name in sets for name in asked):
        like = {role: tuple(name for name in sets if name.lower().startswith(role)) for role in ROLES}
        if all(like.values()):
            logger.info("%s: sets by name: %s", source, "; ".join(f"{x} {','.join(like[x])}" for x in ROLES))
            return like
    for role, names in wanted.items():
        for name in names or ("(none named)",):
            if name not in sets:
                raise ValueError(f"{source}: {role} set {name!r} is not in it (it has {', '.join(sorted(sets))}): "
                                 f"choose with --{role}-sets")
            if asked.count(name) > 1:
                raise ValueError(f"{source}: set {name!r} is named {asked.count(name)} times: train, dev and test "
                                 "must not share speech: name it once")
    return wanted


def _split(utterances: list[Utterance], source: Path) -> dict[str, list[Utterance]]:
    roles = _roles((utterance.voice for utterance in utterances), source)
    return {role: [utterance for utterance in utterances if roles[utterance.voice] == role] for role in ROLES}


def _voices(listed: list[Utterance] | dict) -> set[str]:
    if isinstance(listed, dict):
        return {voice for part, utts in listed.values() for utt, voice in part.voices().items() if utt in utts}
    return {utterance.voice for utterance in listed}


def _warn_of_shared(voices: dict[str, set[str]], source: Path) -> None:
    """Say it when a voice is in two roles: held-out speech is then no test of unseen voices."""
    for one, other in combinations(ROLES, 2):
        if shared := sorted(voices[one] & voices[other]):
            logger.warning("%s: %d voices are both in %s and in %s (%s ...): results on unseen voices they are not",
                           source, len(shared), one, other, shared[0])


def _roles(voices: Iterable[str], source: Path) -> dict[str, str]:
    try:
        return split_voices(Counter(voices))
    except ValueError as error:
        raise ValueError(f"{source}: {error}") from None


def _list_kaldi(paths: dict[str, Path], wanted: dict, source: Path) -> dict[str, dict]:
    if "" in paths:
        whole = read_kaldi_dir(paths[""])
        voices = whole.voices()
        roles = _roles(voices.values(), source)
        return {role: {whole.path: (whole, {utt for utt, voice in voices.items() if roles[voice] == role})}
                for role in ROLES}
    of_role = {}
    for role, names in _sets_of_roles(wanted, paths, source).items():
        dirs = [read_kaldi_dir(paths[name]) for name in names]
        of_role[role] = {part.path: (part, set(part.files["utt2spk"])) for part in dirs}
    return of_role


def _limited(ids: Iterable[str], limit: int | None) -> set[str]:
    """Choose ids by their hash: spread over the corpus, and a larger limit keeps what a smaller one chose."""
    return set(sorted(ids, key=lambda name: sha256(name.encode()).digest())[:limit])


def _plan_kaldi(build: Build, parts: dict[Path, tuple[KaldiDir, set[str]]], limit: int | None) -> tuple:
    """Return items, what makes one, and what assembles the directory (see `Build`): there are only lines to copy."""
    kept = _limited((utt for _, utterances in parts.values() for utt in utterances), limit)
    files: dict[str, dict[str, str]] = {}
    for part, utterances in parts.values():
        for name, lines in part.subset(utterances & kept).items():
            target = files.setdefault(name, {})
            if name in ("wav.scp", "utt2spk") and (twice := set(lines) & set(target)):
                raise ValueError(f"{part.path / name}: {min(twice)} is in another set of the same role too: "
                                 "ids must be unique: rename one")
            target.update(lines)
    if any("segments" in part.files for part, _ in parts.values()) and len(parts) > 1:
        _complete_segments(files, parts)
    _check_order(files["utt2spk"])

    def assemble(directory: Path, records: list) -> None:
        _write_dir(directory, {name: lines for name, lines in files.items() if _is_whole(name, lines, files)})

    return {}, None, assemble


def _complete_segments(files: dict, parts: dict) -> None:
    for part, _ in parts.values():
        if "segments" not in part.files:
            raise ValueError(f"{part.path}: has no segments, but another set of the same role has: make them with "
                             "utils/data/get_segments_for_data.sh, or use sets of one kind")


def _is_whole(name: str, lines: dict, files: dict) -> bool:
    """Tell whether an optional file covers all: Kaldi takes no half ones."""
    of = {"spk2gender": set(files["utt2spk"].values()), "reco2dur": set(files["wav.scp"])}
    return set(lines) >= of.get(name, set(files["utt2spk"]) if name not in ("wav.scp",) else set())


def _plan_utterances(build: Build, utterances: list[Utterance], limit: int | None) -> tuple:
    """Return items (utterances by speaker), what makes one, and what assembles the directory (see `Build`)."""
    _check(utterances, build.out)
    kept = _limited((utterance.id for utterance in utterances), limit)
    utterances = [utterance for utterance in utterances if utterance.id in kept]
    items: dict[str, list[Utterance]] = {}
    for utterance in utterances:
        items.setdefault(utterance.speaker, []).append(utterance)

    def make(speaker: str, spoken: list[Utterance]) -> list:
        return [(utterance.id, *_audio(utterance, build)) for utterance in spoken]

    def assemble(directory: Path, records: list) -> None:
        entries = {name: (entry, n_samples) for record in records for name, entry, n_samples in record}
        genders = {utterance.speaker: utterance.gender for utterance in utterances}
        files = {"wav.scp": {name: entry for name, (entry, _) in entries.items()},
                 "text": {utterance.id: utterance.text for utterance in utterances},
                 "utt2spk": {utterance.id: utterance.speaker for utterance in utterances},
                 "utt2dur": {name: seconds(n_samples) for name, (_, n_samples) in entries.items()}}
        if None not in genders.values():
            files["spk2gender"] = genders
        elif any(genders.values()):
            logger.warning("%s: no gender known of %d speakers: spk2gender left out", build.out,
                           sum(gender is None for gender in genders.values()))
        _write_dir(directory, files)
        converted = sum((directory / "audio").is_dir() and f"/audio/{name}.flac" in entry
                        for name, (entry, _) in entries.items())
        hours = sum(n_samples for _, n_samples in entries.values()) / FS_HZ / 3600
        logger.info("%s: %d utterances of %d speakers, %.2f h%s", build.out, len(utterances), len(genders), hours,
                    f", {converted} converted to {FS_HZ} Hz FLAC" if converted else "")

    return items, make, assemble


def _check(utterances: list[Utterance], out: Path) -> None:
    if not utterances:
        raise ValueError(f"{out}: no utterances in its sets: choose others")
    first: dict[str, str] = {}
    for utterance in utterances:
        if utterance.id in first:
            raise ValueError(f"{utterance.where}: utterance {utterance.id} stands in {first[utterance.id]} too: "
                             "ids must be unique: rename one")
        if problem := words_problem(utterance.text):
            raise ValueError(f"{utterance.where}: transcript of {utterance.id}: {problem}")
        first[utterance.id] = utterance.where
    _check_order({utterance.id: utterance.speaker for utterance in utterances})


def _audio(utterance: Utterance, build: Build) -> tuple[str, int]:
    """Return the `wav.scp` entry of an utterance and its length [samples]; convert what Kaldi could not read."""
    try:
        path = Path(os.path.realpath(utterance.path.parent)) / utterance.path.name
        info = audio_info(path)
        as_it_is = (info.format in _READABLE and info.subtype == "PCM_16" and info.samplerate == FS_HZ
                    and info.channels == 1 and _has_a_line(path))
        if as_it_is and (info.format == "FLAC" or _PLAIN_PATH.fullmatch(str(path))):
            read_audio(path, start=info.frames - 1, stop=info.frames)  # a cut FLAC shows only at its end
            return _flac_entry(path) if info.format == "FLAC" else str(path), info.frames
        samples = read_audio(path)
        # resampling may overshoot full scale by a little
        peak = abs(samples).max()
        write_flac(build.work / "audio" / f"{utterance.id}.flac", samples / max(peak, 1.0))
        made = Path(os.path.realpath(build.out.parent)) / build.out.name / "audio" / f"{utterance.id}.flac"
        return _flac_entry(made), len(samples)
    except ValueError as error:
        raise ValueError(f"{error} (named by {utterance.where})") from None


def _has_a_line(path: Path) -> bool:
    """Tell whether a line of text can hold a path: no line break, and UTF-8."""
    try:
        return not {"\n", "\r"} & set(str(path)) and bool(str(path).encode())
    except UnicodeEncodeError:
        return False


def _flac_entry(path: Path) -> str:
    return f"flac -c -d -s {shlex.quote(str(path))} |"


def seconds(n_samples: int) -> str:
    """Return a duration [s] with all the decimals that tell one sample from the next."""
    return f"{n_samples / FS_HZ:.7f}".rstrip("0").rstrip(".")


def _write_dir(directory: Path, files: dict[str, dict[str, str]]) -> None:
    """Write the files of a data directory, sorted by bytes, with `spk2utt`."""
    spk2utt: dict[str, list[str]] = {}
    for utt in sorted(files["utt2spk"], key=str.encode):
        spk2utt.setdefault(files["utt2spk"][utt], []).append(utt)
    for name, lines in (files | {"spk2utt": {spk: " ".join(utts) for spk, utts in spk2utt.items()}}).items():
        write_text(directory / name, "".join(f"{key} {lines[key]}\n" for key in sorted(lines, key=str.encode)))


def _check_order(utt2spk: dict[str, str]) -> None:
    """Refuse utterances whose order is another than that of their speakers: Kaldi would refuse the directory."""
    by_utterance = sorted(utt2spk, key=str.encode)
    by_speaker = sorted(utt2spk, key=lambda utt: (utt2spk[utt].encode(), utt.encode()))
    if by_utterance != by_speaker:
        at = next(n for n, (a, b) in enumerate(zip(by_utterance, by_speaker, strict=True)) if a != b)
        raise ValueError(f"utterance {by_utterance[at]} of speaker {utt2spk[by_utterance[at]]} sorts apart from "
                         "its speaker: utterance ids must start with the speaker's id and '-': rename one of them")
