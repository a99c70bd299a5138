"""Write the audio of an export, and the manifests of its format."""

import logging
import os
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from roomeq.core.build import Build
from roomeq.export import espnet, huggingface, lhotse, nemo, rirs
from roomeq.export.audio import AudioRules, MadeAudio, make_audio
from roomeq.export.content import Content, utterances_of
from roomeq.export.plan import PlannedAudio, plan_export
from roomeq.records.rir_dir import n_channels

logger = logging.getLogger(__name__)

AT_ONCE = 20
"""Audio files that make one item of a build."""


class _Format(NamedTuple):
    """How a format takes audio, and the function that writes its manifests."""

    write_manifests: Callable[[Content], None]
    align_rirs: bool = True
    positive_rirs: bool = False
    utterance_files: bool = False
    all_rirs: bool = False
    with_direct: bool = True


_FORMATS = {
    "lhotse": _Format(lhotse.write_manifests, positive_rirs=True),
    "espnet": _Format(espnet.write_manifests),
    "nemo": _Format(nemo.write_manifests),
    "huggingface": _Format(huggingface.write_manifests, align_rirs=False, utterance_files=True),
    "roomeq": _Format(rirs.write_manifests, align_rirs=False, all_rirs=True, with_direct=False),
}


def make(build: Build, kind: str, directory: Path, *, link: bool, pipes: bool, nj: int) -> None:
    """Make the directory of a build.

    Raises
    ------
    ValueError
        See `roomeq.export.step.export`.
    """
    form = _FORMATS[kind]
    plan = plan_export(directory, utterance_files=form.utterance_files, all_rirs=form.all_rirs, pipes=pipes)
    if kind == "roomeq" and plan.data:
        raise ValueError(f"{directory}: kind=roomeq must be given an RIR directory or one of noises: choose another "
                         "kind for a data directory")
    arrays = sum(audio.is_rir and n_channels(audio.row or {}) > 1 for audio in plan.audio)
    if arrays and form.align_rirs:
        logger.warning("%s: %d of %d RIRs are of arrays: %s gets that of the first microphone", directory, arrays,
                       sum(audio.is_rir for audio in plan.audio), kind)
    if arrays and form.with_direct and not form.align_rirs:
        logger.warning("%s: %d RIRs are of arrays: where `datasets` decodes them, it averages the channels; read their "
                       "files themselves, with Audio(decode=False)", directory, arrays)
    rules = AudioRules(form.align_rirs, form.positive_rirs, form.with_direct, link, pipes)
    items = {f"{first:07d}": plan.audio[first:first + AT_ONCE] for first in range(0, len(plan.audio), AT_ONCE)}
    build.run(items, partial(_make_some, build.work, rules), nj=nj)

    def assemble(work: Path, records: list[list[list[Any]]]) -> None:
        made = list(_joined(plan.audio, records))
        _make_links(work, made)
        form.write_manifests(Content(directory, work, build.out, made, plan.data, utterances_of(plan.data, made)))
        counts = {folder: sum(audio.planned.folder == folder for audio in made)
                  for folder in dict.fromkeys(audio.planned.folder for audio in made)}
        logger.info("%s: %s", build.out, ", ".join(f"{count} {folder}" for folder, count in counts.items()))

    build.finish(assemble)


def _make_some(work: Path, rules: AudioRules, name: str, planned: list[PlannedAudio]) -> list[list[Any]]:
    return [list(make_audio(audio, work, rules)[1:]) for audio in planned]


def _joined(planned: list[PlannedAudio], records: list[list[list[Any]]]) -> Iterator[MadeAudio]:
    fields = (field for record in records for field in record)
    for audio, made in zip(planned, fields, strict=True):
        yield MadeAudio(audio, *made)


def _make_links(work: Path, made: list[MadeAudio]) -> None:
    for audio in made:
        if audio.link_to is not None:
            link = work / audio.file
            link.parent.mkdir(parents=True, exist_ok=True)
            link.unlink(missing_ok=True)  # of a run that was killed
            os.symlink(audio.link_to, link)
