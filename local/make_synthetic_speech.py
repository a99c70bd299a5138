#!/usr/bin/env python3
"""Generate a synthetic speech corpus with eSpeak NG, in the layout of LibriSpeech, and point noises.

Usage: make_synthetic_speech.py [--utterances 900,150,150] [--seed 0] [--nj 2] OUT_DIR
e.g.:  python local/make_synthetic_speech.py --nj 2 corpora/synthetic_speech

Writes OUT_DIR/LibriSpeech/{train-clean-100,dev-clean,test-clean}, no voice in two sets; OUT_DIR/LibriSpeech-LM/lm.txt,
further sentences of the same language for language models; and OUT_DIR/point_noises/*.flac with noises.csv. Nothing in
it is recorded.
"""

import argparse
import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import soxr

import espeak_client
import espeak_worker
import synthetic_noises
import synthetic_text
from espeak_client import Espeak
from roomeq.core.arrays import FloatArray
from roomeq.core.audio import write_flac
from roomeq.core.build import Build
from roomeq.core.constants import FS_HZ
from roomeq.core.files import write_text
from roomeq.core.rng import rng_for
from synthetic_text import draw_sentence


@dataclass(frozen=True)
class Voice:
    """An eSpeak NG voice: language, variant, words per minute, pitch and its range (50: that of the variant)."""

    sex: str
    language: str
    variant: str
    rate_wpm: int
    pitch: int
    pitch_range: int

    @property
    def name(self) -> str:
        """Name of the voice in eSpeak NG."""
        return f"{self.language}+{self.variant}"


VOICES = {
    "train-clean-100": (
        Voice("M", "en-us", "m1", 165, 50, 50), Voice("F", "en-us", "f1", 160, 50, 50),
        Voice("M", "en", "m2", 170, 45, 55), Voice("F", "en", "f2", 165, 55, 45),
        Voice("M", "en-gb-scotland", "m3", 160, 55, 50), Voice("F", "en-gb-scotland", "f3", 170, 45, 50),
        Voice("M", "en-029", "m4", 165, 50, 60), Voice("F", "en-029", "Annie", 165, 40, 50),
        Voice("M", "en-us", "Andy", 175, 58, 45), Voice("F", "en-us", "linda", 175, 42, 60),
        Voice("M", "en", "marcelo", 160, 42, 50), Voice("F", "en", "Alicia", 175, 48, 50),
        Voice("M", "en-us", "Denis", 160, 60, 40), Voice("F", "en-us", "anika", 165, 38, 45),
        Voice("M", "en-gb-scotland", "michel", 175, 48, 60), Voice("F", "en-029", "aunty", 160, 52, 50),
    ),
    "dev-clean": (
        Voice("M", "en-us", "m6", 168, 52, 50), Voice("F", "en-us", "f4", 168, 48, 55),
        Voice("M", "en", "m7", 162, 44, 50), Voice("F", "en", "shelby", 155, 50, 50),
    ),
    "test-clean": (
        Voice("M", "en-us", "m5", 162, 55, 50), Voice("F", "en-us", "f5", 168, 46, 50),
        Voice("M", "en-029", "victor", 168, 50, 55), Voice("F", "en-029", "belinda", 170, 45, 50),
        Voice("M", "en", "pablo", 165, 48, 50), Voice("F", "en", "Andrea", 125, 40, 50),
        Voice("M", "en-gb-scotland", "rob", 160, 52, 45), Voice("F", "en-gb-scotland", "grandma", 155, 50, 50),
    ),
}
BABBLERS = (Voice("M", "en-us", "travis", 180, 50, 50), Voice("F", "en-us", "steph", 175, 52, 50),
            Voice("M", "en", "sandro", 170, 55, 50), Voice("F", "en", "Nguyen", 180, 50, 50),
            Voice("M", "en-029", "miguel", 175, 45, 50), Voice("M", "en-us", "m8", 170, 50, 50))
LM_SENTENCES = 20_000
CHATTER = """because perhaps nobody ever told them about it however people would rather have been somewhere else
than listen again although every other friend remembered another story which sounded quite different""".split()
NOISES = tuple(f"{kind}{n}" for kind in ("hum", "fan", "clatter", "babble") for n in (1, 2, 3))
README = """Generated, not recorded: a synthetic corpus in the layout of LibriSpeech.

Made by local/make_synthetic_speech.py. The speech comes from the synthesiser eSpeak NG, the sentences are drawn from
an artificial language, and the point noises consist of sines, noise and synthesised speech. No file of LibriSpeech is
included.
"""


@dataclass(frozen=True)
class Chapter:
    """One directory of utterances of one voice."""

    subset: str
    voice: Voice
    speaker: int
    chapter: int
    n_utterances: int

    @property
    def folder(self) -> str:
        """Path in the corpus."""
        return f"LibriSpeech/{self.subset}/{self.speaker}/{self.chapter}"


def chapters(utterances: Sequence[int]) -> dict[str, Chapter]:
    """Return all chapters by folder, two per voice.

    Parameters
    ----------
    utterances
        Number of utterances in each of the sets of `VOICES`.
    """
    by_folder, speaker = {}, 100
    for (subset, voices), total in zip(VOICES.items(), utterances, strict=True):
        for k, voice in enumerate(voices):
            speaker += 1
            of_voice = total * (k + 1) // len(voices) - total * k // len(voices)
            for part, count in enumerate((of_voice - of_voice // 2, of_voice // 2)):
                if count:
                    chapter = Chapter(subset, voice, speaker, 10 * speaker + part, count)
                    by_folder[chapter.folder] = chapter
    return by_folder


def say(espeak: Espeak, voice: Voice, words: list[str], rng: np.random.Generator) -> FloatArray:
    """Return one utterance at `FS_HZ` without the silence around it, with peak 1; `rng` varies rate and pitch."""
    spoken = espeak.speak(voice=voice.name, rate_wpm=round(voice.rate_wpm * rng.uniform(0.93, 1.07)),
                         pitch=voice.pitch + int(rng.integers(-4, 5)), pitch_range=voice.pitch_range,
                         seed=int(rng.integers(1, 2**31)), text=" ".join(words))
    speech = soxr.resample(np.frombuffer(spoken, "<i2") / 2**15, espeak_client.FS_HZ, FS_HZ, quality="VHQ")
    loud = np.flatnonzero(np.abs(speech) > 0.003 * np.abs(speech).max())
    speech = speech[loud[0]:loud[-1] + 1]
    return speech / np.abs(speech).max()


def recorded(speech: FloatArray, rng: np.random.Generator) -> FloatArray:
    """Add what a recording adds: 0.15-0.35 s of silence on each side, a random level, a noise floor at -65 dB.

    Without the noise floor, recognisers would learn the digital zeros between words.

    Parameters
    ----------
    speech
        With peak 1, shape (n_samples,).
    rng
    """
    before, after = rng.uniform(0.15, 0.35, 2) + max(0, 0.7 - len(speech) / FS_HZ) / 2
    padded = np.pad(speech, (int(before * FS_HZ), int(after * FS_HZ))) * 10 ** (rng.uniform(-10, -3) / 20)
    spectrum = np.fft.rfft(rng.standard_normal(len(padded)))
    freqs_hz = np.fft.rfftfreq(len(padded), 1 / FS_HZ).clip(30)
    floor = np.fft.irfft(spectrum * np.sqrt(1 + 500 / freqs_hz), len(padded))  # white above 500 Hz, pink below
    return padded + 10 ** (-65 / 20) * floor / floor.std()


def draw_chatter(rng: np.random.Generator) -> list[str]:
    """Return 3 to 8 words that occur in no transcript."""
    return [str(word) for word in rng.choice(CHATTER, rng.integers(3, 9))]


def make_chapter(seed: int, out_dir: Path, chapter: Chapter) -> int:
    """Write audio and transcripts of one chapter; return the number of samples."""
    lines, n_samples = [], 0
    with Espeak() as espeak:
        for number in range(chapter.n_utterances):
            utterance = f"{chapter.speaker}-{chapter.chapter}-{number:04d}"
            rng = rng_for(seed, "standin-utterance", utterance)
            words = draw_sentence(seed, rng)
            samples = recorded(say(espeak, chapter.voice, words, rng), rng)
            write_flac(out_dir / chapter.folder / f"{utterance}.flac", samples)
            lines.append(f"{utterance} {' '.join(words).upper()}\n")
            n_samples += len(samples)
    write_text(out_dir / chapter.folder / f"{chapter.speaker}-{chapter.chapter}.trans.txt", "".join(lines))
    return n_samples


def make_noise(seed: int, out_dir: Path, name: str) -> int:
    """Write one point noise; return the number of samples."""
    rng = rng_for(seed, "standin-noise", name)
    n_samples = int(rng.uniform(5, 10) * FS_HZ)
    kind = name.rstrip("123")
    if kind == "babble":
        with Espeak() as espeak:
            talkers: list[list[FloatArray]] = [[] for _ in BABBLERS]
            for spoken, voice in zip(talkers, BABBLERS, strict=True):
                while sum(map(len, spoken)) < n_samples:
                    spoken.append(say(espeak, voice, draw_chatter(rng), rng))
        noise = synthetic_noises.levelled(synthetic_noises.babble(rng, talkers, n_samples))
    else:
        noise = synthetic_noises.point_noise(kind, rng, n_samples)
    write_flac(out_dir / "point_noises" / f"{name}.flac", noise)
    return n_samples


def make_item(seed: int, out_dir: Path, name: str, chapter: Chapter | None) -> int:
    """Make one chapter, or one noise if `chapter` is None."""
    return make_chapter(seed, out_dir, chapter) if chapter else make_noise(seed, out_dir, name)


def speakers_txt(minutes: dict[tuple[str, int, Voice], float]) -> str:
    """Return a table of speakers in LibriSpeech's format, from minutes of speech by subset, speaker and voice."""
    lines = [";\n; Generated voices of eSpeak NG, see README\n;\n", ";ID  |SEX| SUBSET           |MINUTES| NAME\n"]
    lines += [f"{speaker:<5}| {voice.sex} | {subset:<17}|{total:6.2f} | eSpeak NG {voice.name}\n"
              for (subset, speaker, voice), total in minutes.items()]
    return "".join(lines)


def lm_text(seed: int) -> str:
    """Return the text for language models: one sentence per line, in capitals like the transcripts."""
    rngs = (rng_for(seed, "standin-lm", str(n)) for n in range(LM_SENTENCES))
    return "".join(f"{' '.join(draw_sentence(seed, rng)).upper()}\n" for rng in rngs)


def make_synthetic_speech(out_dir: Path, utterances: Sequence[int], seed: int, nj: int = 1) -> None:
    """Make the corpus.

    Parameters
    ----------
    out_dir
        Directory to make.
    utterances
        Number of utterances in training, development and test set.
    seed
    nj
        Number of processes; the result does not depend on it.

    Raises
    ------
    ValueError
        `out_dir` exists and was not made by this function.
    OSError
        eSpeak NG does not run, or `out_dir` cannot be written.
    """
    modules = sys.modules[__name__], espeak_client, espeak_worker, synthetic_noises, synthetic_text
    sources = [Path(str(module.__file__)) for module in modules]
    build = Build(out_dir, step="synthetic-speech", options=dict(utterances=utterances, seed=seed), inputs=sources)
    items: dict[str, Chapter | None] = {**chapters(utterances), **dict.fromkeys(NOISES)}

    def assemble(directory: Path, counts: list[int]) -> None:
        minutes: dict[tuple[str, int, Voice], float] = {}
        for chapter, n_samples in zip(items.values(), counts, strict=True):
            if chapter:
                key = chapter.subset, chapter.speaker, chapter.voice
                minutes[key] = minutes.get(key, 0) + n_samples / FS_HZ / 60
        write_text(directory / "LibriSpeech/SPEAKERS.TXT", speakers_txt(minutes))
        rows = "".join(f"{name}.flac,point\n" for name in NOISES)
        write_text(directory / "point_noises/noises.csv", "file,kind\n" + rows)
        write_text(directory / "LibriSpeech-LM/lm.txt", lm_text(seed))
        write_text(directory / "README", README)
        print(f"{out_dir}: {sum(utterances)} generated utterances, {sum(minutes.values()):.1f} minutes")

    if not build.done and build.run(items, partial(make_item, seed, build.work), nj=nj):
        build.finish(assemble)


def utterance_counts(text: str) -> tuple[int, ...]:
    """Parse ``"900,150,150"``: utterances of each set, at least one per voice."""
    minimum = [len(voices) for voices in VOICES.values()]
    if re.fullmatch(r"\d{1,6},\d{1,6},\d{1,6}", text):
        parsed = tuple(int(count) for count in text.split(","))
        if all(count >= voices for count, voices in zip(parsed, minimum, strict=True)):
            return parsed
    raise argparse.ArgumentTypeError(f"{text} must be three counts of at least {','.join(map(str, minimum))}, such "
                                     "as 900,150,150: every voice needs an utterance")


def main(argv: list[str] | None = None) -> int:
    """Parse the command line and make the corpus; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out_dir", type=Path, metavar="OUT_DIR")
    parser.add_argument("--utterances", type=utterance_counts, default=(900, 150, 150), metavar="TRAIN,DEV,TEST",
                        help="number of utterances; default 900,150,150")
    parser.add_argument("--seed", type=int, default=0, help="seed of all random numbers; default 0")
    parser.add_argument("--nj", type=int, default=1, help="processes, at least 1; default 1")
    args = parser.parse_args(argv)
    if args.nj < 1:
        parser.error(f"--nj {args.nj} must be at least 1")
    try:
        make_synthetic_speech(args.out_dir, args.utterances, args.seed, args.nj)
    except (ValueError, OSError) as error:
        print(f"make_synthetic_speech.py: {error}", file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
