"""All steps of the recipe, from corpora to the report, on the smallest data: each a command that a test can repeat."""

import shlex
from pathlib import Path
from typing import NamedTuple

import numpy as np
from corpora_examples import put, put_text
from datadirs import burst
from rirmaker import coloured_rir
from scipy.signal import resample_poly
from wer_run import put_example

from roomeq.core.audio import write_flac

ROOM_DIMS_M = ((5.0, 4.0, 3.0), (6.0, 4.5, 2.8), (7.0, 5.0, 3.2))
TAKES = 5
"""RIRs in each room."""


class Step(NamedTuple):
    """A step of the recipe; its directories are relative to the one that it runs in.

    Attributes
    ----------
    name : str
    command : str
        Arguments of `roomeq`, or a script of `local` (without its suffix) and its arguments.
    makes, reads, refers : tuple of str
        Directories that it makes; that it takes as inputs; whose files these inputs refer to.
    """

    name: str
    command: str
    makes: tuple[str, ...]
    reads: tuple[str, ...] = ()
    refers: tuple[str, ...] = ()

    @property
    def argv(self) -> list[str]:
        return shlex.split(self.command)


REAL, SIM, EQ, LOOP = (f"data/rirs.{kind}.train" for kind in ("real", "sim", "sim.EQ", "sim.loop"))
REFERRED = ("data/measured", "noises", "corpus")
SIMULATE = "simulate --num-rays 300 --order 20 --t60-range 0.3,0.4"
RVB = {rirs: f"data/train.{rirs[len('data/rirs.'):-len('.train')]}.rvb" for rirs in (REAL, SIM, EQ, LOOP)}
STEPS = (
    Step("prepare-speech", "prepare-speech speech data", tuple(f"data/{x}.clean" for x in ("train", "dev", "test"))),
    Step("read-measured", "read-measured --noises noises corpus data/measured", ("data/measured",)),
    Step("read-noises", "read-noises noises data/noises", ("data/noises",)),
    Step("characterise", "characterise data/measured data/rirs.real", ("data/rirs.real",), ("data/measured",),
         ("noises", "corpus")),
    Step("split-rirs", "split-rirs --sizes 9,3,3 data/rirs.real data/rirs.real",
         tuple(f"data/rirs.real.{x}" for x in ("train", "dev", "test")), ("data/rirs.real",), REFERRED),
    Step("simulate", f"{SIMULATE} {REAL} {SIM}", (SIM,), (REAL,), REFERRED),
    Step("fit-eq", f"fit-eq --num-components 1 {REAL} {SIM} exp/eq", ("exp/eq",), (REAL, SIM), REFERRED),
    Step("compensate", f"compensate {SIM} exp/eq {EQ}", (EQ,), (SIM, "exp/eq")),
    Step("close-loop", f"close-loop --max-effects 0 --test data/rirs.real.dev --out exp/loop {REAL}", ("exp/loop",),
         (REAL, "data/rirs.real.dev"), REFERRED),
    Step("simulate --model", f"{SIMULATE} --model exp/loop/model.json {REAL} {LOOP}", (LOOP,), (REAL, "exp/loop"),
         REFERRED),
    *(Step(f"augment {rirs[len('data/rirs.'):-len('.train')]}",
           f"augment --noises data/noises data/train.clean {rirs} {rvb}", (rvb,),
           ("data/train.clean", rirs, "data/noises"), ("speech", "noises", *REFERRED[:1 + (rirs == REAL)]))
      for rirs, rvb in RVB.items()),
    Step("export lhotse", f"export lhotse {REAL} exp/lhotse", ("exp/lhotse",), (REAL,), REFERRED),
    Step("export nemo", f"export nemo {RVB[SIM]} exp/nemo", ("exp/nemo",), (RVB[SIM],)),
    Step("wer", "wer --rirs decoded/rirs decoded/kaldi0 decoded/kaldi1 exp/wer", ("exp/wer",)),
)
REPORT = Step("report", "report data exp exp/report", ("exp/report",), tuple(
    directory for step in STEPS if step.name.split()[0] not in ("read-noises", "export") for directory in step.makes),
              ("speech", *REFERRED))
SYNTHETIC = (
    Step("make-synthetic-rirs", "make_synthetic_rirs --rooms 2 --mics 1 --speakers 1 --silence-s 1 synthetic/rirs",
         ("synthetic/rirs",)),
    Step("make-synthetic-speech", "make_synthetic_speech --utterances 16,4,8 synthetic/speech", ("synthetic/speech",)),
)
"""The steps that make the synthetic corpora, as small as they can be."""


def put_corpora(root: Path) -> None:
    """Write speech, measured RIRs, noises and decoded test sets; some audio is converted and some stays as it is."""
    rng, lines = np.random.default_rng(0), []
    for n in range(4 * 3):
        role = ("train", "train", "dev", "test")[n % 4]
        put(root / f"speech/u{n}.wav", burst(rng, 27000 if n % 8 < 4 else 9000), fs_hz=48000 if n % 8 < 4 else 16000)
        lines.append(f"u{n}.wav,HELLO {n},{role}{n},{role}\n")
    put_text(root / "speech/manifest.csv", "file,transcript,speaker,set\n" + "".join(lines))
    lines = []
    for n, (room, dims_m) in enumerate((room, dims_m) for room, dims_m in enumerate(ROOM_DIMS_M) for _ in range(TAKES)):
        rir = coloured_rir(n, time_s=0.3 + 0.05 * room, direct=8.0)[:6000] / 2
        put(root / f"corpus/r{n}.wav", resample_poly(rir, 3, 1) if n % 2 else rir, fs_hz=48000 if n % 2 else 16000)
        lines.append(f"r{n}.wav,r{n},room{room},box,omni,{' '.join(map(str, dims_m))},1 1 1.5,"
                     f"{2 + n % TAKES / 4} 2 1.2\n")
    put_text(root / "corpus/manifest.csv",
             "file,rir_id,room,source_id,mic_id,room_dims_m,source_pos_m,mic_pos_m\n" + "".join(lines))
    for n in range(6):
        write_flac(root / f"noises/{'silence' if n % 2 else 'click'}{n}.flac",
                   0.01 * np.random.default_rng(n).standard_normal(8000))
    put_example(root / "decoded", seeds=2)
