"""The command line: ``roomeq VERB``. Each verb calls one documented function that has the same options."""

import errno
import importlib
import logging
import os
import sys
import traceback
from collections.abc import Callable
from concurrent.futures import BrokenExecutor
from pathlib import Path
from typing import Any

import click

from roomeq import __version__
from roomeq.core.asking import NotUpToDate, only_ask
from roomeq.core.extras import absent
from roomeq.core.limits import LIMITS
from roomeq.core.progress import LineHandler

NOT_UP_TO_DATE = 3
"""Exit status where ``--ask`` is answered with no."""
MAX_MESSAGE = 1500
"""Longest message printed; of a longer one, only beginning and end are printed."""

_REMEDIES = {errno.ENAMETOOLONG: "shorten the name"} | dict.fromkeys(
    (errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "free some space, or choose another output") | dict.fromkeys(
    (errno.EACCES, errno.EPERM, errno.EROFS), "check the permissions") | dict.fromkeys(
    (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.ELOOP), "check the path")


class AnyPath(click.Path):
    """A path that the verb itself checks; the shell completes file names."""

    def convert(self, value: str | os.PathLike[str], param: click.Parameter | None, ctx: click.Context | None) -> Path:
        if value == "":  # Path("") is the current folder
            self.fail("'' is no path: give one, or . for the current folder", param, ctx)
        return Path(value)


class CommaSeparated(click.ParamType):
    """A tuple of values, such as ``773,194,242``; or one of some keywords, which stays a text."""

    name = "list"

    def __init__(self, item: Callable[[str], Any], rule: str, keywords: tuple[str, ...] = ()):
        self.item, self.rule, self.keywords = item, rule, keywords

    def convert(self, value: str, param: click.Parameter | None, ctx: click.Context | None) -> Any:
        if value in self.keywords:
            return value
        try:
            return tuple(self.item(word) for word in value.split(",") if word)
        except ValueError:
            self.fail(f"{value!r} must be {self.rule}", param, ctx)


class Verb(click.Command):
    """A subcommand that calls one function; the function's module is imported only then.

    Parameters
    ----------
    function : str
        Module and name, such as ``"eq.steps:fit_eq"``.
    example : str
        Arguments of an example, for the help.
    """

    def __init__(self, name: str, *, function: str, example: str, **attributes: Any):
        super().__init__(name, epilog=f"\b\nExample:\n  roomeq {name} {example}", **attributes)
        self.function = function

    def load(self) -> Callable[..., Any]:
        """Import and return the function, after the hash of the code is taken, which may change meanwhile."""
        from roomeq.core.digests import code_digest

        code_digest()
        module, name = self.function.split(":")
        return getattr(importlib.import_module(f"roomeq.{module}"), name)

    def invoke(self, ctx: click.Context) -> int:
        """Call the function and return the exit status; an error becomes one line, a closed output none."""
        try:
            self.load()(**ctx.params)
            print(end="", flush=True)  # at exit, its error would not become one line
        except BrokenPipeError:  # as of head: click exits with status 1, without a message
            raise
        except (ValueError, OSError) as error:
            return failed(one_line(error))
        except ModuleNotFoundError as error:
            return failed(absent((error.name or "").split(".")[0]))
        except NotUpToDate:
            return NOT_UP_TO_DATE
        except (MemoryError, BrokenExecutor) as error:
            return failed(f"not enough memory, or a worker was killed ({type(error).__name__}): use a smaller --nj and "
                          "start it again to go on")
        except KeyboardInterrupt:
            return failed("interrupted; start it again to go on", status=130)
        except Exception as error:  # a defect of roomeq: print no traceback either, but say where it is
            place = traceback.extract_tb(error.__traceback__)[-1]
            return failed(f"internal error, please report it: {type(error).__name__}: {error} ({place.name}, "
                          f"{os.path.basename(place.filename)}:{place.lineno})")
        return 0


class PipelineGroup(click.Group):
    """A group that lists its commands in the order of their definition, which is that of the pipeline."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(self.commands)


@click.group(cls=PipelineGroup, no_args_is_help=False, subcommand_metavar="VERB [ARGS]...",
             context_settings=dict(help_option_names=["-h", "--help"], show_default=True, max_content_width=120),
             epilog='Shell completion: eval "$(_ROOMEQ_COMPLETE=bash_source roomeq)", or zsh_source, or fish_source.',
             params=[click.Option(["--ask"], is_flag=True,
                                  help="Only tell whether the output is up to date: make nothing, and exit with "
                                       f"status {NOT_UP_TO_DATE} if it is not."),
                     *(click.Option([f"--{limit.option}"], type=float, metavar="N",
                                    help=f"{limit.description[0].upper()}{limit.description[1:]}; default: "
                                         f"{limit.default:g}, or {limit.variable} of the environment.")
                       for limit in LIMITS)])
@click.version_option(__version__, message="%(version)s")
def cli(ask: bool, **limits: float | None) -> None:
    """Simulate room impulse responses (RIRs) that match measured ones, and make far-field speech with them."""
    only_ask(ask)
    for limit in LIMITS:
        value = limits[limit.option.replace("-", "_")]
        if value is not None:  # in the environment, where worker processes find it too
            os.environ[limit.variable] = str(value)


def verb(function: str, example: str) -> Callable[[Callable[[], None]], click.Command]:
    """Make a `Verb` of a function that has only a name and a docstring."""
    return cli.command(cls=Verb, function=function, example=example)


def argument(name: str, help: str, **attributes: Any) -> Callable[..., Any]:
    """Add a positional argument, which is a path."""
    return click.argument(name, type=AnyPath(), help=help, **attributes)


NAMES = CommaSeparated(str, "names with commas between")
seed = click.option("--seed", default=0, help="Seed of all random numbers.")
nj = click.option("--nj", default=1, help="Number of processes; results do not depend on it.")
part = click.option("--part", metavar="JOB/JOBS", help="Do one share only; a later call without this option finishes.")
skip_bad = click.option("--skip-bad", is_flag=True, help="Leave out and report what cannot be used.")
keep_suspicious = click.option("--keep-suspicious", is_flag=True,
                               help="Keep recordings that are no RIR by their acoustics.")


@verb("corpora:prepare_speech", "--train-sets train-clean-100,train-clean-360 /corpora/LibriSpeech data")
@argument("source", "LibriSpeech tree, Kaldi data directory, folder with manifest.csv, or folder of audio files "
          "without transcripts.")
@argument("out", "Directory in which to make train.clean, dev.clean and test.clean.")
@click.option("--train-sets", type=NAMES, default="train-clean-100",
              help="Sets for training: of LibriSpeech, of the column set of a CSV, or folders.")
@click.option("--dev-sets", type=NAMES, default="dev-clean", help="Sets for development.")
@click.option("--test-sets", type=NAMES, default="test-clean", help="Sets for test.")
@click.option("--limit", type=int, help="Largest number of utterances in each set.")
@click.option("--channel", default=0, help="Channel of files with several that is used, counted from 0.")
@nj
def prepare_speech() -> None:
    """Make Kaldi data directories of clean speech from a corpus."""


@verb("corpora:read_measured", "/corpora/BUT_ReverbDB data/measured")
@argument("source", "BUT ReverbDB, OpenSLR 28, SOFA, a CSV, or a folder of audio files.")
@argument("out", "RIR directory to make.")
@click.option("--kind", type=click.Choice(["reverbdb", "slr28", "table", "sofa", "folder"]),
              help="Kind of the source, where it is not recognised.")
@click.option("--noises", type=AnyPath(), help="Folder or CSV of noise recordings to add to those of the corpus.")
@skip_bad
@keep_suspicious
@nj
def read_measured() -> None:
    """Read measured RIRs into an RIR directory."""


@verb("corpora:read_noises", "/corpora/noises data/noises")
@argument("source", "Folder of audio files, with or without manifest.csv, or the CSV.")
@argument("out", "Directory to make.")
@skip_bad
@nj
def read_noises() -> None:
    """Read noise recordings into a directory with noises.jsonl."""


@verb("corpora.characterise:characterise", "data/measured data/rirs.real")
@argument("rir_dir", "RIR directory.")
@argument("out", "RIR directory to make: the same audio, with acoustic parameters in the rows.")
@skip_bad
@keep_suspicious
@part
@nj
def characterise() -> None:
    """Measure acoustic parameters of RIRs.

    Repeats, uncommon spaces and recordings that are no RIR are dropped; RIRs unfit for the EQ fit are marked.
    """


@verb("corpora.split:split_rirs", "--split-by room data/rirs.real data/rirs.real")
@argument("rir_dir", "RIR directory with acoustic parameters.")
@argument("out_prefix", "Prefix of the directories to make: OUT_PREFIX.train, OUT_PREFIX.dev and OUT_PREFIX.test.")
@click.option("--split-by", type=click.Choice(["rir", "room"]), default="rir",
              help="Unit that is never in two sets.")
@click.option("--same-rooms", type=NAMES, default="", metavar="PATTERN,...",
              help="Rooms that one pattern matches count as one room, e.g. 'house_*'; only with --split-by room.")
@click.option("--sizes", type=CommaSeparated(int, "whole numbers with commas between, such as 773,194,242"),
              default="773,194,242", help="RIRs per set; taken as proportions where there are fewer RIRs.")
@click.option("--dev-rirs", type=AnyPath(), help="RIR directory to develop on, instead of a part of RIR_DIR.")
@click.option("--test-rirs", type=AnyPath(), help="RIR directory to test on, instead of a part of RIR_DIR.")
@seed
def split_rirs() -> None:
    """Split RIRs into training, development and test sets."""


def at_most_one(paths: tuple[Path, ...]) -> Path | None:
    """Return the only one of some paths, or None."""
    if len(paths) > 1:
        raise click.UsageError(f"{len(paths) + 1} directories are given where MEASURED_DIR OUT are at most two")
    return paths[0] if paths else None


@verb("simulate_rirs:simulate", "data/rirs.real.train data/rirs.sim.train\n  roomeq simulate --rooms 1000 rirs")
@argument("measured_dir", "RIR directory from which rooms, sources and microphones are taken.", nargs=-1,
          metavar="[MEASURED_DIR]", callback=lambda _ctx, _param, paths: at_most_one(paths))
@argument("out", "RIR directory to make.")
@click.option("--rooms", metavar="N|FIRST-LAST", help="Draw so many rooms, or those with these numbers, instead.")
@click.option("--room-types", metavar="FILE|NAMES", help="Distributions to draw rooms from: a TOML file, or some of "
              "meeting_room,living_room,lecture_hall; default: all of conf/room_types.toml.")
@click.option("--t60-range", "t60_range_s", metavar="MIN,MAX",
              type=CommaSeparated(float, "numbers with commas between, such as 0.2,2.0, or measured", ("measured",)),
              help="Reverberation times are uniform in this range [s]; measured: range of the measured rooms; "
                   "default: 0.2,2.0, or as the room types say.")
@click.option("--num-rays", default=10000, help="Rays per source and distinct set of scattering coefficients.")
@click.option("--order", default=200, help="Reflections of a ray on average, up to 3 s; more where the decay needs it.")
@click.option("--ism-order", default=6, help="Order up to which specular reflections are exact image sources.")
@click.option("--noise-rirs", default=1, help="RIRs of noise sources per RIR.")
@click.option("--materials", type=AnyPath(), help="TOML file of materials, instead of conf/materials.toml.")
@click.option("--model", type=AnyPath(), help="model.json of roomeq close-loop: effects to add to the simulation.")
@click.option("--draw-devices", is_flag=True, help="With --model: draw the loudspeaker and the microphone of each RIR, "
              "and where it faces if its row does not state it, instead of those that the closed loop has measured.")
@click.option("--diffraction/--no-diffraction", default=True, help="Whether sound bends around the edges of meshes.")
@click.option("--fs", "fs_hz", default=16000, metavar="HZ", help="Sample rate, 8000 to 48000.")
@seed
@part
@nj
def simulate() -> None:
    """Simulate one RIR per measured RIR, with a random T60; or RIRs of randomly drawn rooms."""


@verb("validate:validate", "data/rirs.sim.train exp/loop data/train.sim.rvb")
@argument("directories", "RIR or Kaldi data directories, or outputs of close-loop or wer.", nargs=-1, required=True)
def validate() -> None:
    """Check that directories keep their contracts."""


@verb("eq.steps:fit_eq", "data/rirs.real.train data/rirs.sim.train exp/eq")
@argument("real_dir", "Measured RIRs of the training set.")
@argument("sim_dirs", "Simulated RIRs, for comparison.", nargs=-1)
@argument("out", "Directory to make: gmm.json, EQs of all RIRs, screening.json.")
@click.option("--num-components", "n_components", default=7, help="Components of the mixture.")
@click.option("--weight-rooms", is_flag=True, help="Give every room the same weight in the mixture.")
@seed
@part
@nj
def fit_eq() -> None:
    """Fit a Gaussian mixture to EQs of measured RIRs."""


@verb("eq.steps:compensate", "data/rirs.sim.train exp/eq data/rirs.sim.EQ.train")
@argument("sim_dir", "Simulated RIRs.")
@argument("eq_dir", "Output of fit-eq.")
@argument("out", "RIR directory to make.")
@click.option("--taps", default=511, help="Length of the filters, odd.")
@click.option("--match-rooms/--no-match-rooms", default=True,
              help="Draw each EQ with the component weights of the measured RIRs of the same room.")
@seed
@part
@nj
def compensate() -> None:
    """Give simulated RIRs EQs drawn from the fitted mixture."""


@verb("loop.step:close_loop", "data/rirs.real.train --test data/rirs.real.dev --out exp/loop")
@argument("rir_dirs", "Measured RIRs with geometry, of three rooms or more.", nargs=-1, required=True)
@click.option("--out", type=AnyPath(), required=True, help="Directory to make: ledger.json, model.json.")
@click.option("--test", type=AnyPath(), multiple=True, metavar="DIR", help="RIRs that are only scored; repeatable.")
@click.option("--model", type=AnyPath(),
              help="model.json to begin with: its effects belong to the base model and are not candidates.")
@click.option("--max-effects", default=4, help="Largest number of effects to add.")
@seed
@nj
def close_loop() -> None:
    """Find the effects that the simulation lacks, and add them."""


@verb("augment:augment", "--snr 'uniform 5 25' data/train.clean data/rirs.sim.train data/train.sim.rvb")
@argument("data_dir", "Kaldi data directory of clean speech.")
@argument("rir_dir", "RIR directory.")
@argument("out", "Data directory to make.")
@click.option("--copies", default=1, help="Far-field versions of each utterance.")
@click.option("--snr", "snr_db", default="uniform 5 25", metavar="DIST",
              help="SNR of the ambient noise [dB]: 'uniform 5 25', 'normal 15 5', 'list 20,15,10' or none.")
@click.option("--point-snr", "point_snr_db", default="uniform 5 25", metavar="DIST",
              help="SNR of each point noise [dB], likewise.")
@click.option("--point-noise-prob", default=0.5, help="Probability of each point noise.")
@click.option("--max-point-noises", default=1, help="Largest number of point noises in an utterance.")
@click.option("--noises", type=AnyPath(), multiple=True, metavar="DIR",
              help="Further directory with noises.jsonl; repeatable.")
@click.option("--draw-rooms-equally", is_flag=True, help="Draw the room first, then one of its RIRs.")
@click.option("--packing", type=click.Choice(["recording", "utterance"]), default="recording",
              help="Content of a FLAC file: a whole recording, with segments, or one utterance.")
@click.option("--pipes", is_flag=True, help="Run any command in wav.scp. Without this option, commands known to "
              "decode a file are replaced by reading the file, and others are refused.")
@seed
@part
@nj
def augment() -> None:
    """Make far-field speech from clean speech, RIRs and noises."""


@verb("export:export", "lhotse data/rirs.sim.train lhotse/rirs.sim.train")
@click.argument("kind", type=click.Choice(["lhotse", "espnet", "nemo", "huggingface", "roomeq"]), metavar="KIND",
                help="lhotse, espnet, nemo or huggingface; or roomeq: an RIR directory that refers to nothing outside.")
@argument("directory", "RIR directory, directory of noises, or Kaldi data directory.")
@argument("out", "Directory to make.")
@click.option("--link", is_flag=True, help="Link to audio files that stay as they are, instead of copying them.")
@click.option("--pipes", is_flag=True, help="Run the commands in wav.scp; without this option, commands known to "
              "decode a file are replaced by reading the file, and others are refused.")
@nj
def export() -> None:
    """Write RIRs, noises or speech in the format of another toolkit, with their audio."""


@verb("wer:measure_wer", "--rirs data/rirs.real exp/kaldi exp/kaldi.seed1 exp/wer")
@argument("workspaces", "Kaldi workspaces with decoded systems, one per seed.", nargs=-1, required=True)
@argument("out", "Directory to make: wer.json, and counts.jsonl with the errors of each seed.")
@click.option("--rirs", type=AnyPath(), required=True, multiple=True,
              help="RIR directory that names the room of each RIR; may be given again for further RIRs.")
@click.option("--train-rirs", type=AnyPath(), help="Measured RIRs that the recognisers were trained with: states how "
              "far the EQ of each test room is from theirs.")
@click.option("--counted", type=AnyPath(), multiple=True,
              help="counts.jsonl of further seeds, such as those of another machine; may be given again.")
def wer() -> None:
    """Measure word error rates of Kaldi workspaces. Prints a table with confidence intervals."""


@verb("report:make_report", "data exp exp/report")
@argument("data_dir", "Where stages 0 to 6 wrote.")
@argument("exp_dir", "Where stages 3, 5 and 10 wrote eq, loop and wer.")
@argument("out", "Directory to make; it gets index.html.")
@click.option("--kinds", type=NAMES, default="real,sim.free,sim,sim.EQ,sim.loop",
              help="Kinds of RIRs to report, where they are there.")
def report() -> None:
    """Make one self-contained HTML page of a run."""


speech = click.option("--speech", type=AnyPath(), metavar="FILE",
                      help="Recording of dry speech to play on the page, instead of noise bursts.")
chosen_id = click.option("--id", "ident", metavar="ID", help="RIR of a directory; by default a typical one.")
show_suspicious = click.option("--keep-suspicious", is_flag=True,
                               help="Show recordings that are no RIR by their acoustics.")


@verb("show:show", "data/rirs.real --id room1-s1-m1 --out rir.html")
@argument("path", "RIR file, RIR directory, output of close-loop, or mesh of a room.")
@click.option("--out", type=AnyPath(), metavar="FILE",
              help="Page with audio (FILE.html) or picture (FILE.png) to make; by default, parameters are printed.")
@chosen_id
@click.option("--channel", type=int, help="Channel of a file with several, counted from 0.")
@speech
@show_suspicious
def show() -> None:
    """Show and play an RIR, the RIRs of a directory, what a closed loop found, or a room."""


@verb("show:compare", "data/rirs.real.train data/rirs.sim.train --out comparison.html")
@argument("first", "RIR file or RIR directory.")
@argument("second", "RIR file or RIR directory to compare with it.")
@click.option("--out", type=AnyPath(), metavar="FILE.html",
              help="Page with audio to make; by default, parameters are printed.")
@chosen_id
@click.option("--channel", type=int, help="Channel of files with several, counted from 0.")
@speech
@show_suspicious
def compare() -> None:
    """Compare two RIRs, or two sets of RIRs, in just noticeable differences (JND)."""


def main(argv: list[str] | None = None) -> int:
    """Run one verb and return the exit status; a mistake of the user is one line and status 1."""
    logging.basicConfig(level=logging.INFO, handlers=[LineHandler()], format="%(message)s")
    try:
        return cli.main(argv, prog_name="roomeq", standalone_mode=False) or 0
    except click.UsageError as error:
        command = error.ctx.command_path if error.ctx else "roomeq"
        return failed(f"{error.format_message().rstrip('.')}: see {command} --help")
    finally:
        only_ask(False)  # of this call alone


def failed(message: str, status: int = 1) -> int:
    """Print one line and return the exit status."""
    print(f"roomeq: {printable(message)}", file=sys.stderr)
    return status


def one_line(error: Exception) -> str:
    """Return an error's message, with the remedy that the operating system leaves out."""
    if isinstance(error, OSError) and error.errno is not None:
        remedy = _REMEDIES.get(error.errno, "check the path, free space and permissions")
        return f"{error.filename or 'output'}: {os.strerror(error.errno)}: {remedy}"
    return str(error)


def printable(text: str) -> str:
    """Return a text on one line, without control characters; of a very long one, only beginning and end."""
    text = "".join(c if c.isprintable() else ascii(c)[1:-1] for c in " ".join(text.split()))
    return text if len(text) <= MAX_MESSAGE else f"{text[:MAX_MESSAGE // 2]} [...] {text[-MAX_MESSAGE // 2:]}"


if __name__ == "__main__":
    sys.exit(main())
