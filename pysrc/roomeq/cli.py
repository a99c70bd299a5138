"""The command line: ``roomeq VERB``. Each verb is one documented function with the same options."""

import argparse
import errno
import importlib
import logging
import os
import sys
import traceback
from concurrent.futures import BrokenExecutor

from roomeq import __version__
from roomeq.core.limits import LIMITS

_REMEDIES = {errno.ENAMETOOLONG: "shorten the name"}
_REMEDIES.update(dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "free some space, or choose another output"))
_REMEDIES.update(dict.fromkeys((errno.EACCES, errno.EPERM, errno.EROFS), "check the permissions"))
_REMEDIES.update(dict.fromkeys((errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ELOOP),
                               "check the path"))
MAX_MESSAGE = 1500
"""Longest message; of a longer one, begin and end are printed."""


def integer(text: str) -> int:
    """Parse ``"7"``."""
    return _parsed(int, text, "a whole number")


def number(text: str) -> float:
    """Parse ``"0.5"``."""
    return _parsed(float, text, "a number")


def numbers(text: str) -> tuple[float, ...]:
    """Parse ``"0.2,2.0"``."""
    return _parsed(lambda text: tuple(float(word) for word in text.split(",")), text,
                   "numbers with commas between, such as 0.2,2.0")


def t60_range(text: str) -> tuple[float, ...] | str:
    """Parse ``"0.2,2.0"`` or ``"measured"``."""
    return text if text == "measured" else numbers(text)


def integers(text: str) -> tuple[int, ...]:
    """Parse ``"773,194,242"``."""
    return _parsed(lambda text: tuple(int(word) for word in text.split(",")), text,
                   "whole numbers with commas between, such as 773,194,242")


def _parsed(parse, text: str, rule: str):
    try:
        return parse(text)
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} must be {rule}") from None


def names(text: str) -> tuple[str, ...]:
    """Parse ``"train-clean-100,train-clean-360"``."""
    return tuple(word for word in text.split(",") if word)


class Parser(argparse.ArgumentParser):
    """A parser that says on one line what is wrong."""

    def error(self, message: str):
        self.exit(1, f"{printable(f'{self.prog}: {message}: see {self.prog} --help')}\n")


class Verb:
    """One verb under definition: `argument` adds to its parser.

    Parameters
    ----------
    verbs
        What ``add_subparsers`` returned.
    name : str
        The verb; the function it calls has ``_`` for ``-`` unless `function` says otherwise.
    module : str
        Module of the package that holds the function.
    summary, example : str
    """

    def __init__(self, verbs, name: str, module: str, summary: str, example: str, function: str | None = None):
        self.parser = verbs.add_parser(
            name, help=summary, description=summary, epilog=f"example:\n  roomeq {name} {example}",
            formatter_class=argparse.RawDescriptionHelpFormatter)
        self.parser.set_defaults(module=module, function=function or name.replace("-", "_"))

    def argument(self, *flags, **how) -> "Verb":
        if how.get("default") not in (None, False) and "help" in how:
            how["help"] += " (default: %(default)s)"
        self.parser.add_argument(*flags, **how)
        return self

    def seed(self) -> "Verb":
        return self.argument("--seed", type=integer, default=0, help="of every random draw")

    def jobs(self) -> "Verb":
        self.argument("--part", metavar="JOB/JOBS", help="do one share only; a later call without it finishes")
        return self.argument("--nj", type=integer, default=1, help="processes; results do not depend on it")


def build_parser() -> argparse.ArgumentParser:
    """Define all verbs, in the order of the data's way."""
    parser = Parser(prog="roomeq", description=__doc__.splitlines()[0])
    parser.add_argument("--version", action="version", version=__version__)
    for limit in LIMITS:
        parser.add_argument(f"--{limit.option}", type=number, metavar="N",
                            help=f"{limit.what} (default: {limit.default:g}, or the environment's {limit.variable})")
    verbs = parser.add_subparsers(metavar="VERB", required=True)
    _corpus_verbs(verbs)
    _rir_verbs(verbs)
    _eq_verbs(verbs)
    _speech_verbs(verbs)
    return parser


def _corpus_verbs(verbs) -> None:
    (Verb(verbs, "prepare-speech", "corpora", "Make Kaldi data directories of clean speech from a corpus.",
          "--train-sets train-clean-100,train-clean-360 /corpora/LibriSpeech data")
     .argument("source", help="LibriSpeech tree, Kaldi data directory, or folder with manifest.csv")
     .argument("out", help="where train.clean, dev.clean and test.clean go")
     .argument("--train-sets", type=names, default=("train-clean-100",), help="sets of a LibriSpeech tree")
     .argument("--dev-sets", type=names, default=("dev-clean",), help="likewise")
     .argument("--test-sets", type=names, default=("test-clean",), help="likewise")
     .argument("--limit", type=integer, help="at most so many utterances a set")
     .argument("--nj", type=integer, default=1, help="processes; results do not depend on it"))
    (Verb(verbs, "read-measured", "corpora", "Read measured RIRs into an RIR directory.",
          "/corpora/BUT_ReverbDB data/measured")
     .argument("source", help="BUT ReverbDB, OpenSLR 28, SOFA, a CSV, or a folder of audio files")
     .argument("out", help="RIR directory to make")
     .argument("--kind", choices=("reverbdb", "slr28", "table", "sofa", "folder"),
               help="what the source is, where it is not found out by itself")
     .argument("--noises", help="folder or CSV of noise recordings, beside those of the corpus")
     .argument("--skip-bad", action="store_true", help="leave out and report what cannot be used")
     .argument("--nj", type=integer, default=1, help="processes; results do not depend on it"))
    (Verb(verbs, "read-noises", "corpora", "Read noise recordings into a directory with noises.jsonl.",
          "/corpora/noises data/noises")
     .argument("source", help="folder of audio files, with or without manifest.csv, or the CSV")
     .argument("out", help="directory to make")
     .argument("--skip-bad", action="store_true", help="leave out and report what cannot be used")
     .argument("--nj", type=integer, default=1, help="processes; results do not depend on it"))


def _rir_verbs(verbs) -> None:
    (Verb(verbs, "characterise", "corpora.characterise",
          "Measure every RIR; drop repeats; say what is unfit for the EQ fit.",
          "data/measured data/rirs.real")
     .argument("rir_dir", help="RIR directory")
     .argument("out", help="RIR directory to make: the same audio, rows with acoustic parameters")
     .argument("--skip-bad", action="store_true", help="leave out and report RIRs that cannot be measured")
     .jobs())
    (Verb(verbs, "split-rirs", "corpora.split", "Split RIRs into disjoint training, development and test sets.",
          "--split-by room data/rirs.real data/rirs.real")
     .argument("rir_dir", help="RIR directory with acoustic parameters")
     .argument("out_prefix", help="makes OUT_PREFIX.train, OUT_PREFIX.dev and OUT_PREFIX.test")
     .argument("--split-by", choices=("rir", "room"), default="rir", help="room: no room is in two sets")
     .argument("--same-rooms", type=names, default=(), metavar="PATTERN,...",
               help="rooms that one pattern matches count as one, e.g. 'house_*'; only by room")
     .argument("--sizes", type=integers, default=(773, 194, 242), help="proportions, where there are fewer RIRs")
     .seed())
    (Verb(verbs, "simulate", "simulate_rirs", "Simulate one RIR per measured one, with T60 drawn at random.",
          "data/rirs.real.train data/rirs.sim.train")
     .argument("measured_dir", help="RIR directory that rooms, sources and microphones come from")
     .argument("out", help="RIR directory to make")
     .argument("--t60-range-s", "--t60-range", type=t60_range, default=(0.2, 2.0), metavar="MIN,MAX",
               help="reverberation times are uniform in it [s]; measured: range of the measured rooms")
     .argument("--num-rays", type=integer, default=20000, help="rays a source")
     .argument("--order", type=integer, default=200, help="reflections a ray, at least")
     .argument("--ism-order", type=integer, default=6, help="specular reflections by exact image sources")
     .argument("--noise-rirs", type=integer, default=1, help="RIRs of noise sources, per RIR")
     .argument("--materials", help="TOML file of materials, instead of conf/materials.toml")
     .argument("--model", help="model.json of roomeq close-loop: effects that the simulator lacks otherwise")
     .argument("--diffraction", action=argparse.BooleanOptionalAction, default=True,
               help="let sound come around the edges of meshes")
     .seed().jobs())
    (Verb(verbs, "validate", "validate", "Say whether directories keep their contracts.",
          "data/rirs.sim.train exp/loop data/train.sim.rvb")
     .argument("directories", nargs="+", help="RIR or Kaldi data directories, or what close-loop or wer made"))


def _eq_verbs(verbs) -> None:
    (Verb(verbs, "fit-eq", "eq", "Fit a Gaussian mixture to the sub-band EQs of measured RIRs.",
          "data/rirs.real.train data/rirs.sim.train exp/eq")
     .argument("real_dir", help="measured RIRs, training set")
     .argument("sim_dirs", nargs="*", help="simulated RIRs, for the comparison")
     .argument("out", help="directory to make: gmm.json, EQs of all RIRs, screening.json")
     .argument("--num-components", dest="n_components", type=integer, default=7, help="of the mixture")
     .argument("--weight-rooms", action="store_true", help="let rooms count equally")
     .seed().jobs())
    (Verb(verbs, "compensate", "eq", "Give every simulated RIR an EQ drawn from the measured distribution.",
          "data/rirs.sim.train exp/eq data/rirs.sim.EQ.train")
     .argument("sim_dir", help="simulated RIRs")
     .argument("eq_dir", help="what fit-eq made")
     .argument("out", help="RIR directory to make")
     .argument("--taps", type=integer, default=511, help="of the filters, odd")
     .argument("--match-rooms", action=argparse.BooleanOptionalAction, default=True,
               help="choose the mixture's components as the measured RIRs of the same room do")
     .seed().jobs())
    (Verb(verbs, "close-loop", "loop.close", "Find out which effects the simulation of measured RIRs lacks; add them.",
          "data/rirs.real.train --test data/rirs.real.dev --out exp/loop")
     .argument("rir_dirs", nargs="+", help="measured RIRs with geometry, of three rooms or more")
     .argument("--out", required=True, help="directory to make: ledger.json, model.json")
     .argument("--test", action="append", default=[], metavar="DIR", help="RIRs that are only scored")
     .argument("--model", help="model.json to begin with: its effects are in the base model, and no candidates")
     .argument("--max-effects", type=integer, default=4, help="at most so many are added")
     .seed()
     .argument("--nj", type=integer, default=1, help="processes; results do not depend on it"))


def _speech_verbs(verbs) -> None:
    (Verb(verbs, "augment", "augment",
          "Make far-field speech: x * h + point noises * their RIRs + ambient noise.",
          "--snr 'uniform 5 25' data/train.clean data/rirs.sim.train data/train.sim.rvb")
     .argument("data_dir", help="Kaldi data directory of clean speech")
     .argument("rir_dir", help="RIR directory")
     .argument("out", help="data directory to make")
     .argument("--copies", type=integer, default=1, help="far-field versions of each utterance")
     .argument("--snr", dest="snr_db", default="uniform 5 25", metavar="DIST",
               help="SNR of the ambient noise [dB]: 'uniform 5 25', 'normal 15 5', 'list 20,15,10' or none")
     .argument("--point-snr", dest="point_snr_db", default="uniform 5 25", metavar="DIST", help="of point noises")
     .argument("--point-noise-prob", type=number, default=0.5, help="probability of each point noise")
     .argument("--max-point-noises", type=integer, default=1, help="point noises an utterance may have")
     .argument("--noises", action="append", default=[], metavar="DIR", help="another directory with noises.jsonl")
     .argument("--draw-rooms-equally", action="store_true", help="draw the room first, then one of its RIRs")
     .argument("--packing", choices=("recording", "utterance"), default="recording",
               help="what a FLAC file holds: a whole recording, with segments, or one utterance")
     .argument("--pipes", action="store_true", help="run the commands that wav.scp holds; without it only those "
                                                    "known to decode a file are understood, and read directly")
     .seed().jobs())
    (Verb(verbs, "wer", "wer", "Measure word error rates of Kaldi workspaces, with intervals; print the table.",
          "--rirs data/rirs.real exp/kaldi exp/kaldi.seed1 exp/wer", function="measure_wer")
     .argument("workspaces", nargs="+", help="Kaldi workspaces with decoded rows, one a seed")
     .argument("out", help="directory to make: wer.json")
     .argument("--rirs", required=True, help="RIR directory that says which rooms the sets' RIRs are of"))
    (Verb(verbs, "report", "report", "Make one self-contained HTML page of a run.", "data exp exp/report",
          function="make_report")
     .argument("data_dir", help="where stages 0-6 wrote")
     .argument("exp_dir", help="where stages 3, 5 and 10 wrote eq, loop and wer")
     .argument("out", help="directory to make; it gets index.html"))


def main(argv: list[str] | None = None) -> int:
    """Run one verb; what a user got wrong becomes one line and exit status 1."""
    given = vars(build_parser().parse_args(argv))
    for limit in LIMITS:
        value = given.pop(limit.option.replace("-", "_"))
        if value is not None:  # in the environment, where worker processes find it too
            os.environ[limit.variable] = str(value)
    module, function = given.pop("module"), given.pop("function")
    logging.basicConfig(level=logging.INFO, stream=sys.stderr, format="%(message)s")
    try:
        getattr(importlib.import_module(f"roomeq.{module}"), function)(**given)
    except (ValueError, OSError) as error:
        return _failed(one_line(error))
    except (MemoryError, BrokenExecutor) as error:
        return _failed(f"not enough memory, or a worker was killed ({type(error).__name__}): use a smaller --nj and "
                       "start it again to go on")
    except KeyboardInterrupt:
        _failed("interrupted; start it again to go on")
        return 130
    except Exception as error:  # a defect of ours: no traceback either, but where it is
        where = traceback.extract_tb(error.__traceback__)[-1]
        return _failed(f"internal error, please report it: {type(error).__name__}: {error} ({where.name}, "
                       f"{os.path.basename(where.filename)}:{where.lineno})")
    return 0


def _failed(message: str) -> int:
    print(f"roomeq: {printable(message)}", file=sys.stderr)
    return 1


def one_line(error: Exception) -> str:
    """Return an error's message, with the remedy that the operating system leaves out."""
    if isinstance(error, OSError) and error.errno is not None:
        remedy = _REMEDIES.get(error.errno, "check the path, free space and permissions")
        return f"{error.filename or 'output'}: {os.strerror(error.errno)}: {remedy}"
    return str(error)


def printable(text: str) -> str:
    """Return a text on one line without what would act on a terminal; only begin and end of a very long one."""
    text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(text.split()))
    return text if len(text) <= MAX_MESSAGE else f"{text[:MAX_MESSAGE // 2]} [...] {text[-MAX_MESSAGE // 2:]}"


if __name__ == "__main__":
    sys.exit(main())
