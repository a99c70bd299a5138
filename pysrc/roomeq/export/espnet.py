"""Data directories and lists of ESPnet 2: https://espnet.github.io/espnet/espnet2_tutorial.html.

A data directory is one of Kaldi, where an entry of `wav.scp` may be the path of a FLAC file. `segments` states the ends
that the audio has, since Kaldi's `validate_data_dir.sh` takes no -1. ``--rir_scp`` and ``--noise_scp`` take lists of
``ID PATH`` (`espnet2.train.preprocessor`).
"""

import os

from roomeq.core.files import read_text, write_text
from roomeq.export.content import Content
from roomeq.export.plan import RECORDINGS

_TABLES = ("text", "utt2spk", "spk2utt", "spk2gender", "utt2dur", "reco2dur", "utt2uniq", "utt2lang",
           "utt2rir", "utt2snr")
"""Files of a data directory that name no other files."""


def write_manifests(content: Content) -> None:
    """Write a data directory, or `rirs.scp` and others of RIRs and noises."""
    for folder, audio in content.by_folder().items():
        name = "wav.scp" if folder == RECORDINGS else f"{folder}.scp"
        write_text(content.work / name, "".join(
            f"{made.planned.id} {os.path.abspath(content.out / made.file)}\n" for made in audio))
    if content.data is None:
        return
    recordings = {utterance.recording for utterance in content.data.utterances.values()}
    for name in _TABLES:
        if (content.data.path / name).is_file():
            lines = read_text(content.data.path / name).splitlines(keepends=True)
            write_text(content.work / name, "".join(
                line for line in lines if name != "reco2dur" or line.split()[0] in recordings))
    if content.data.segmented:
        write_text(content.work / "segments", "".join(
            f"{utterance.id} {utterance.audio.planned.id} {utterance.start_s!r} {utterance.end_s!r}\n"
            for utterance in content.utterances))
