"""Sections about far-field speech: signal-to-noise ratios and audio examples."""

from dataclasses import dataclass

import numpy as np

from roomeq.core.arrays import FloatArray
from roomeq.core.constants import FS_HZ
from roomeq.kaldi.datadir import DataDir, read_data_dir, read_utterance
from roomeq.report import figures
from roomeq.report.formats import flac_uri
from roomeq.report.kinds import COMPENSATED, EXTENDED, KINDS, MEASURED, SIMULATED, Kind
from roomeq.report.load import SETS, Context, Missing, Run, read_numbers, read_pairs

CLIP_S = 4.0
CLIP_PEAK = 0.7
CLEAN = Kind("clean", "clean", "clean")
CLIPS = (CLEAN, SIMULATED, COMPENSATED, EXTENDED, MEASURED)


@dataclass(frozen=True)
class Clip:
    """An utterance to play.

    Parameters
    ----------
    kind : Kind
        The kind of RIR that it was convolved with, or `CLEAN`.
    directory : str
        Data directory.
    src : str, optional
        Audio as a ``data:`` URI; None if the run lacks the directory.
    rir, snr : str, optional
        Id of the RIR and signal-to-noise ratio [dB] as in ``utt2rir`` and ``utt2snr``.
    """

    kind: Kind
    directory: str
    src: str | None = None
    rir: str | None = None
    snr: str | None = None


def noise(run: Run) -> Context:
    """Return histograms of the signal-to-noise ratios."""
    panels = []
    for split in SETS:
        if groups := snr_groups(run, split):
            values = np.concatenate([values for *_, values in groups])
            low, high = np.floor(values.min() / 2) * 2, np.ceil(values.max() / 2) * 2 + 2
            draw = figures.histogram(f"{split} sets", groups, np.arange(low, high + 0.1, 2.0),
                                     "Signal-to-noise ratio (dB)", "utterances")
            alt = f"SNR of the {split} sets: {values.min():.0f} to {values.max():.0f} dB"
            panels.append(figures.panel(f"figure-snr-{split}", draw, alt, figures.SMALL_IN))
    if not panels and not any(run.has(f"{split}.{kind.name}.rvb") for split in SETS for kind in KINDS):
        raise Missing("utt2snr of any data/*.rvb", "stage 6 (roomeq augment)")
    return {"panels": panels}


def snr_groups(run: Run, split: str) -> list[tuple[str, str, FloatArray]]:
    """Return label, colour and finite SNRs [dB] of a split's data sets; sets with equal SNRs form one group."""
    groups: dict[tuple[float, ...], list[Kind]] = {}
    for kind in KINDS:
        if not run.has(f"{split}.{kind.name}.rvb"):
            continue
        snrs = read_numbers(run.path(f"{split}.{kind.name}.rvb") / "utt2snr")
        if finite := tuple(snr for snr in snrs.values() if np.isfinite(snr)):
            groups.setdefault(finite, []).append(kind)
    return [(", ".join(kind.label for kind in kinds), kinds[0].colour, np.array(snrs))
            for snrs, kinds in groups.items()]


def audio_examples(run: Run) -> Context:
    """Return one utterance, clean and far-field, as clips to play."""
    kinds = [kind for kind in CLIPS if kind is not EXTENDED or run.has("loop")]
    for split in ("test", "dev", "train"):
        directories = {kind: f"{split}.clean" if kind is CLEAN else f"{split}.{kind.name}.rvb" for kind in kinds}
        present = [kind for kind, name in directories.items() if run.has(name)]
        if len(present) == len(kinds) or (split == "train" and CLEAN in present and len(present) > 1):
            break
    else:
        raise Missing("data/train.clean with its data/train.*.rvb", "stage 6 (roomeq augment)")
    data = {kind: read_data_dir(run.path(directories[kind])) for kind in present}
    augmented = {kind: augmented_ids(data[kind]) for kind in present if kind is not CLEAN}
    chosen = choose_utterance(data[CLEAN], list(augmented.values()))
    clips = [make_clip(kind, directory, data[kind], augmented[kind][chosen] if kind in augmented else chosen)
             if kind in data else Clip(kind, directory) for kind, directory in directories.items()]
    return {"clips": clips, "utterance": chosen, "words": (data[CLEAN].text or {}).get(chosen), "clip_s": CLIP_S}


def augmented_ids(data: DataDir) -> dict[str, str]:
    """Map each clean utterance to the first utterance of an augmented directory that was made from it."""
    ids: dict[str, str] = {}
    for ident in data.utterances:
        ids.setdefault(data.utt2uniq.get(ident, ident), ident)
    return ids


def choose_utterance(clean: DataDir, augmented: list[dict[str, str]]) -> str:
    """Return the utterance with a duration nearest to that of a clip among those in all data sets."""
    common = [ident for ident in clean.utterances if all(ident in ids for ids in augmented)]
    if not common:
        raise Missing("an utterance that all data directories share", "stage 6 (roomeq augment)")

    def misfit(ident: str) -> tuple[float, str]:
        _, _, _, start_s, end_s = clean.utterances[ident]
        length_s = clean.utt2dur.get(ident, 0.0) if end_s is None else end_s - start_s
        return abs(length_s - CLIP_S), ident

    return min(common, key=misfit)


def make_clip(kind: Kind, directory: str, data: DataDir, ident: str) -> Clip:
    """Return the beginning of an utterance as FLAC, scaled to a common peak."""
    samples = read_utterance(data, data.utterances[ident])[:round(CLIP_S * FS_HZ)].astype(np.float64)
    peak = np.abs(samples).max(initial=0.0)
    return Clip(kind, directory, flac_uri(samples * (CLIP_PEAK / peak if peak else 1.0), FS_HZ),
                read_pairs(data.path / "utt2rir").get(ident), read_pairs(data.path / "utt2snr").get(ident))
