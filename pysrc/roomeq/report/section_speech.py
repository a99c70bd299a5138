"""Sections about far-field speech: signal-to-noise ratios, clips to listen to, and what the run does not show."""

import io

import numpy as np
import soundfile

from roomeq.core.constants import FS_HZ
from roomeq.kaldi.datadir import DataDir, read_data_dir, read_utterance
from roomeq.report import figures
from roomeq.report.load import ALL_KINDS, SETS, Run, read_numbers, read_pairs
from roomeq.report.page import Html, Missing, data_uri, figure, join, paragraph, tag
from roomeq.report.section_data import synthetic_corpora

CLIP_S = 4.0
CLIPS = (("clean", "Clean", "the utterance as it was spoken into a close microphone"),
         ("sim", "Simulated", "far-field with a simulated RIR"),
         ("sim.EQ", "Simulated + EQ", "the same simulated RIR after compensation"),
         ("sim.loop", "Simulated + loop", "the same place, simulated with the effects that the closed loop found"),
         ("real", "Measured", "far-field with a measured RIR"))
COLOURS = {"clean": "clean", "sim": "simulated", "sim.EQ": "compensated", "sim.loop": "drawn", "real": "measured"}
NAMES = {"real": "measured", "sim": "simulated", "sim.EQ": "simulated + EQ", "sim.loop": "simulated + loop"}


def noise(run: Run) -> Html:
    """Return histograms of the signal-to-noise ratios drawn."""
    panels = []
    for x in SETS:
        groups = snr_groups(run, x)
        if groups:
            values = np.concatenate([values for *_, values in groups])
            low, high = np.floor(values.min() / 2) * 2, np.ceil(values.max() / 2) * 2 + 2
            draw = figures.histogram(f"{x} sets", groups, np.arange(low, high + 0.1, 2.0),
                                     "Signal-to-noise ratio (dB)", "utterances")
            panels.append(figures.panel(f"figure-snr-{x}", draw,
                                        f"SNR of the {x} sets: {values.min():.0f} to {values.max():.0f} dB",
                                        figures.SMALL_IN))
    if not panels and any(run.has(f"{x}.{kind}.rvb") for x in SETS for kind in ALL_KINDS):
        return paragraph("No noise was given, and none was added.")
    if not panels:
        raise Missing("utt2snr of any data/*.rvb", "stage 6 (roomeq augment)")
    return join([
        paragraph("Every utterance gets recorded noise, at a signal-to-noise ratio drawn for it: level of the "
                  "reverberant speech over that of all noise together."),
        figure("figure-snr", panels, "Utterances by signal-to-noise ratio. Where sets share a curve, each "
               "utterance has the same ratio in all of them, so that only the RIR differs.")])


def snr_groups(run: Run, split: str) -> list[tuple[str, str, np.ndarray]]:
    """Return name, colour and finite SNRs of a split's sets; sets with the same SNRs are one group."""
    kinds: dict[tuple, list[str]] = {}
    for kind in ALL_KINDS:
        snrs = read_numbers(run.path(f"{split}.{kind}.rvb") / "utt2snr")
        finite = tuple(snr for snr in snrs.values() if np.isfinite(snr))
        if finite:
            kinds.setdefault(finite, []).append(kind)
    return [(", ".join(NAMES[kind] for kind in same), COLOURS[same[0]], np.array(snrs))
            for snrs, same in kinds.items()]


def listen(run: Run) -> Html:
    """Return the same utterance clean and far-field, to be played."""
    clips = [clip for clip in CLIPS if clip[0] != "sim.loop" or run.has("loop")]
    for x in ("test", "dev", "train"):
        directories = {kind: f"{x}.clean" if kind == "clean" else f"{x}.{kind}.rvb" for kind, *_ in clips}
        there = {kind: name for kind, name in directories.items() if run.has(name)}
        if len(there) == len(clips) or (x == "train" and "clean" in there and len(there) > 1):
            break
    else:
        raise Missing("data/train.clean with its data/train.*.rvb", "stage 6 (roomeq augment)")
    data = {kind: read_data_dir(run.path(name)) for kind, name in there.items()}
    chosen = choose(data["clean"], [originals(one) for kind, one in data.items() if kind != "clean"])
    items = []
    for kind, title, what in clips:
        if kind in data:
            utterance = chosen if kind == "clean" else originals(data[kind])[chosen]
            items.append(clip(kind, title, what, data[kind], utterance))
        else:
            items.append(tag("li", tag("strong", title), f": not in this run (data/{directories[kind]})"))
    words = (data["clean"].text or {}).get(chosen)
    return join([
        paragraph("One utterance, ", tag("code", chosen), join([": “", words.capitalize(), "”"]) if words else "",
                  f". The first {CLIP_S:g} s, scaled to the same peak. Listen for bass and for the tail of each "
                  "word; start and length are the same in all of them."),
        tag("ul", *items, class_="clips")])


def originals(data: DataDir) -> dict[str, str]:
    """Return utterance ids of an augmented directory by the clean utterance they were made from (the first of "
      "each)."""
    found: dict[str, str] = {}
    for ident in data.utterances:
        found.setdefault(data.utt2uniq.get(ident, ident), ident)
    return found


def choose(clean: DataDir, others: list[dict]) -> str:
    """Return the clean utterance that all sets have and whose duration is nearest to that of a clip."""
    common = [ident for ident in clean.utterances if all(ident in ids for ids in others)]
    if not common:
        raise Missing("one utterance that all data directories have", "stage 6 (roomeq augment)")

    def misfit(ident: str) -> tuple[float, str]:
        _, _, _, start_s, end_s = clean.utterances[ident]
        length_s = clean.utt2dur.get(ident, 0.0) if end_s is None else end_s - start_s
        return abs(length_s - CLIP_S), ident

    return min(common, key=misfit)


def clip(kind: str, title: str, what: str, data: DataDir, ident: str) -> Html:
    """Return one utterance as an item with a player and a link-free note of how it was made."""
    samples = read_utterance(data, data.utterances[ident])[:round(CLIP_S * FS_HZ)].astype(np.float64)
    peak = np.abs(samples).max(initial=0.0)
    stream = io.BytesIO()
    soundfile.write(stream, samples * (0.7 / peak if peak else 1.0), FS_HZ, format="FLAC", subtype="PCM_16")
    note = [what]
    rir = read_pairs(data.path / "utt2rir").get(ident)
    snr = read_pairs(data.path / "utt2snr").get(ident)
    if rir:
        note += [", RIR ", tag("code", rir)]
    if snr:
        note.append(", no noise" if snr == "inf" else f", SNR {snr} dB")
    return tag("li", tag("span", class_=f"key {COLOURS[kind]}"), tag("strong", title), ": ", *note,
               tag("audio", controls="controls", preload="metadata", id=f"audio-{kind.replace('.', '-')}",
                   src=data_uri("audio/flac", stream.getvalue()), aria_label=f"{title}: {what}"))


def limits(run: Run) -> Html:
    """Return what cannot be concluded from this run."""
    points = []
    if synthetic_corpora(run):
        points.append("The corpora are generated (see the top). Distances and accuracies show that the steps work "
                      "together; they say nothing about real rooms, and nothing about word error rates.")
    if run.has("rirs.real"):
        rows = run.rirs("rirs.real")
        rooms = {row["room_id"] for row in rows}
        points.append(f"{len(rows)} measured RIRs of {len(rooms)} rooms, where the paper has 1209. With few rooms "
                      "the distribution fitted is that of these rooms and of the loudspeakers and microphones "
                      "used in them, not of rooms in general.")
        if run.stamp("rirs.real.train").get("options", {}).get("split_by", "rir") == "rir":
            points.append(join([
                "RIRs are split at random as in the paper, so the same rooms are in training and test. The held-out "
                "distances are therefore optimistic for a room never seen; for that stricter question ask for ",
                tag("code", "--split-by room", class_="nw"), "."]))
    if run.has("rirs.sim.train"):
        rows = run.rirs("rirs.sim.train")
        if drawn := sum(bool(row.get("drawn")) for row in rows):
            points.append(f"{drawn} of {len(rows)} simulated training RIRs have coordinates or room sizes that were "
                          "drawn at random, since nobody measured them or the stated ones cannot be right.")
    points += [
        "Eight points describe the spectrum. Between them, and over time, a compensated RIR remains a simulated "
        "one: no single room modes, no directivity, no diffraction in empty boxes.",
        "Simulated RIRs are not paired with measured ones: materials are drawn at random, so a low error of "
        "distributions does not mean a low error for a given room."]
    if not run.has("wer"):
        points.append("No recogniser was trained: whether these data lead to fewer word errors is for stages 8 to 10, "
                      "with Kaldi.")
    return tag("ul", *(tag("li", point) for point in points))
