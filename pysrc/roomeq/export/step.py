"""The step that exports a directory. What it works with is imported where there is work to do."""

import os
from pathlib import Path

from roomeq.core.build import Build
from roomeq.core.files import output_path
from roomeq.records.rir_dir import mesh_files

KINDS = ("lhotse", "espnet", "nemo", "huggingface", "roomeq")
WITH_PLACE = ("espnet", "roomeq")
"""Kinds with files that hold the path of the directory."""


def export(kind: str, directory: Path | str, out: Path | str, *, link: bool = False, pipes: bool = False,
           nj: int = 1) -> None:
    """Write the content of an RIR, noise or data directory in the format of another toolkit, with its audio.

    RIRs for speech, RIRs of noise sources (rows with `noise_for`), ambient noises and point noises have a folder and a
    manifest each. Recordings that are no RIR are left out, except of ``"roomeq"``. For lhotse, ESPnet and NeMo the
    audio of RIRs begins `roomeq.export.align.LEAD_S` before the direct sound, so that reverberated speech stays aligned
    to its labels; otherwise it is unchanged, and the metadata state the direct sound.

    Parameters
    ----------
    kind
        ``"lhotse"``
            `recordings.jsonl.gz` and `supervisions.jsonl.gz`; of RIRs `rirs.jsonl.gz` and others. Paths are relative
            to `out`: read with ``RecordingSet.from_file(...).with_path_prefix(out)``.
        ``"espnet"``
            A data directory with plain paths in `wav.scp`; of RIRs `rirs.scp` and others for ``--rir_scp`` and
            ``--noise_scp``. Paths are absolute, because ESPnet takes relative ones from the current folder.
        ``"nemo"``
            `manifest.json`; of RIRs `rirs.json` and others. Paths are relative to the manifest.
        ``"huggingface"``
            Folders of audio files with `metadata.jsonl` (``audiofolder``), one file per utterance.
        ``"roomeq"``
            The same RIR directory with all audio and meshes in it, so that it can be moved on its own.
    directory
        RIR directory, directory with `noises.jsonl`, or Kaldi data directory.
    out
        Directory to make.
    link
        Link to audio files that are exported unchanged, instead of copying them.
    pipes
        Run the commands in `wav.scp`; without it they are refused.
    nj
        Number of processes.

    Raises
    ------
    ValueError
        An argument is out of range, or the directory or one of its audio files breaks its contract.
    """
    if kind not in KINDS:
        raise ValueError(f"kind={kind!r} must be one of {', '.join(KINDS)}")
    options = dict(kind=kind, link=link)
    if kind in WITH_PLACE:
        options["place"] = os.path.abspath(output_path(out))
    inputs = [Path(directory), *(mesh_files(Path(directory)) if kind == "roomeq" else [])]
    build = Build(Path(out), step="export", options=options, inputs=inputs)
    if not build.done:
        from roomeq.export.write import make

        make(build, kind, Path(directory), link=link, pipes=pipes, nj=nj)
