"""Every verb is a documented function with the same options; a user's mistake is one line."""

import inspect
import os
import shlex
import subprocess
import sys

import click
import numpy as np
import pytest
from plans import box_plan, prism_obj
from rirmaker import coloured_rir, row, write_rir_dir

from roomeq import __version__
from roomeq.cli import NOT_UP_TO_DATE, Verb, cli, main
from roomeq.core.audio import write_wav
from roomeq.core.extras import absent

VERBS = cli.commands


def defaults_of(verb):
    """Return what a verb passes to its function by parameter, when only the required words are given."""
    words = [param.type.choices[0] if isinstance(param.type, click.Choice) else "x"
             for param in verb.params if isinstance(param, click.Argument)]
    for param in verb.params:
        words += [param.opts[0], "x"] if param.required and isinstance(param, click.Option) else []
    return verb.make_context(verb.name, words).params


@pytest.mark.parametrize("verb", VERBS)
def test_verb_and_function_have_the_same_options(verb):
    function, options = VERBS[verb].load(), defaults_of(VERBS[verb])
    parameters = inspect.signature(function).parameters
    assert set(options) == set(parameters)
    for name, parameter in parameters.items():
        if parameter.default is not inspect.Parameter.empty and parameter.default != () and options[name] is not None:
            assert options[name] == parameter.default, f"{verb}: default of {name}"
    for section in ("Parameters", "Raises"):
        assert section in function.__doc__, f"{verb}: docstring lacks {section}"


@pytest.mark.parametrize("verb", VERBS)
def test_verb_help_shows_every_option_and_an_example(verb, capsys):
    assert main([verb, "--help"]) == 0
    text = capsys.readouterr().out
    assert f"Example:\n    roomeq {verb} " in text
    for param in VERBS[verb].params:
        name = param.human_readable_name if isinstance(param, click.Argument) else param.opts[0]
        assert param.help and name in text


@pytest.mark.parametrize("verb", VERBS)
def test_example_of_the_help_parses(verb):
    words = next(line for line in VERBS[verb].epilog.splitlines() if "roomeq" in line).split("roomeq", 1)[1]
    VERBS[verb].make_context(verb, shlex.split(words)[1:])


def test_help_lists_the_verbs_in_pipeline_order(capsys):
    assert main(["--help"]) == 0
    text = capsys.readouterr().out
    assert text.index("read-measured") < text.index("simulate") < text.index("augment") < text.index("report")


def test_version(capsys):
    assert main(["--version"]) == 0
    assert capsys.readouterr().out == f"{__version__}\n"


def test_help_imports_no_numerics():
    code = "import sys; from roomeq.cli import main; main(['simulate', '--help']); sys.exit('numpy' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 0 and "Usage: roomeq simulate" in done.stdout


@pytest.mark.parametrize("verb", sorted(set(cli.commands) - {"validate", "wer"}))
def test_step_that_is_only_asked_imports_no_numerics(verb):
    code = ("import sys; from roomeq.cli import cli; cli.commands[sys.argv[1]].load(); "
            "sys.exit(any(name in sys.modules for name in ('numpy', 'scipy', 'numba', 'matplotlib')))")
    assert subprocess.run([sys.executable, "-c", code, verb]).returncode == 0


def test_asking_for_an_absent_output_is_answered_by_the_status_alone(tmp_path, capsys):
    (tmp_path / "corpus").mkdir()
    write_wav(tmp_path / "corpus/hum.wav", np.linspace(-0.5, 0.5, 1600))
    arguments = ["read-noises", str(tmp_path / "corpus"), str(tmp_path / "noises")]
    assert main(["--ask", *arguments]) == NOT_UP_TO_DATE
    assert capsys.readouterr() == ("", "") and not (tmp_path / "noises").exists()
    assert main(arguments) == 0 and main(["--ask", *arguments]) == 0
    assert main(["--ask", "read-noises", str(tmp_path / "absent"), str(tmp_path / "noises")]) == 1


@pytest.mark.parametrize("module", ["roomeq", "roomeq.cli"])
def test_package_runs_as_a_module(module):
    done = subprocess.run([sys.executable, "-m", module, "validate"], capture_output=True, text=True, timeout=60,
                          check=False)
    assert done.returncode == 1
    assert done.stderr == "roomeq: Missing argument 'DIRECTORIES...': see roomeq validate --help\n"


@pytest.mark.parametrize("argv", [
    ["validate", "absent"],
    ["simulate", "absent", "out"],
    ["characterise", "absent", "out"],
    ["split-rirs", "absent", "out"],
    ["fit-eq", "absent", "absent", "out"],
    ["compensate", "absent", "absent", "out", "--seed", "1"],
    ["augment", "absent", "absent", "out"],
    ["wer", "--rirs", "absent", "absent", "out"],
    ["report", "absent", "absent", "out"],
    ["prepare-speech", "absent", "out"],
    ["read-measured", "absent", "out"],
    ["read-noises", "absent", "out"],
    ["show", "absent", "--out", "out.html"],
    ["compare", "absent", "absent", "--out", "out.html"],
])
def test_absent_input_is_one_line(argv, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(argv) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("roomeq: ") and "absent" in lines[0]
    assert [path for path in tmp_path.iterdir() if not path.name.startswith(".")] == []


@pytest.mark.parametrize("argv, name", [
    (["prepare-speech", "", "out"], "SOURCE"), (["read-measured", "in", ""], "OUT"), (["validate", ""], "DIRECTORIES"),
    (["augment", "--noises", "", "in", "in", "out"], "--noises"), (["simulate", "", "out"], "MEASURED_DIR")])
def test_empty_path_is_not_the_current_folder(argv, name, tmp_path, monkeypatch, capsys):
    (tmp_path / "in").mkdir()
    monkeypatch.chdir(tmp_path)
    assert main(argv) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and name in said and "'' is no path: give one" in said
    assert [path.name for path in tmp_path.iterdir()] == ["in"]


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_output_that_is_closed_ends_the_verb_without_a_message(tmp_path, unbuffered):
    (tmp_path / "noises").mkdir()
    write_wav(tmp_path / "noises/hum.wav", np.linspace(-0.5, 0.5, 1600))
    assert main(["read-noises", str(tmp_path / "noises"), str(tmp_path / "out")]) == 0
    reader, writer = os.pipe()
    os.close(reader)
    done = subprocess.run([sys.executable, "-m", "roomeq", "validate", tmp_path / "out"], stdout=writer, text=True,
                          stderr=subprocess.PIPE, timeout=60, check=False,
                          env=os.environ | dict(PYTHONUNBUFFERED=unbuffered))
    os.close(writer)
    assert (done.returncode, done.stderr) == (1, "")


def test_a_missing_optional_package_names_its_extra(monkeypatch, capsys):
    def load(verb):
        raise ModuleNotFoundError("No module named 'rapidfuzz'", name="rapidfuzz.distance")

    monkeypatch.setattr(Verb, "load", load)
    assert main(["wer", "--rirs", "rirs", "workspace", "out"]) == 1
    assert capsys.readouterr().err == "roomeq: the package rapidfuzz is not installed: pip install 'roomeq[wer]'\n"


@pytest.mark.parametrize("package, extra", [("markupsafe", "report"), ("click", None)])
def test_the_remedy_for_an_absent_package_is_its_extra(package, extra):
    assert absent(package).endswith(f"'roomeq[{extra}]'" if extra else "install roomeq again")


def run_without(packages, code, *arguments):
    """Run code in a process in which some packages are not installed."""
    absent_ones = f"import sys; sys.modules |= dict.fromkeys({packages})\n"
    return subprocess.run([sys.executable, "-c", absent_ones + code, *map(str, arguments)], capture_output=True,
                          text=True, timeout=300, check=False)


def test_numbers_are_shown_without_packages_for_pages(tmp_path):
    for name, time_s in (("a", 0.3), ("b", 0.5)):
        write_wav(tmp_path / f"{name}.wav", coloured_rir(1, time_s=time_s))
        write_rir_dir(tmp_path / name, [(row("r1"), coloured_rir(1, time_s=time_s))])
    (tmp_path / "room.obj").write_text(prism_obj(box_plan(6.0, 4.0), 3.0))
    code = """
import os
from roomeq.cli import main
os.chdir(sys.argv[1])
for words in ("show a.wav", "compare a.wav b.wav", "show a", "compare a b", "show room.obj"):
    assert main(words.split()) == 0, words
for suffix in ("html", "png"):
    assert main(["show", "a.wav", "--out", f"a.{suffix}"]) == 1
"""
    done = run_without(["jinja2", "markupsafe", "matplotlib", "sofar"], code, tmp_path)
    assert done.stderr == 2 * "roomeq: the package matplotlib is not installed: pip install 'roomeq[report]'\n"


@pytest.mark.parametrize("package, extra, call", [
    ("matplotlib", "report", "plot_rir([1.0, 0.1] + 4000 * [0.0], 16000)"),
    ("trimesh", "mesh", "Room(sys.argv[1], t60_s=0.5)"),
    ("sofar", "sofa", "read_directivity(sys.argv[1], (1, 0, 0))")])
def test_python_functions_name_the_extra_they_need(tmp_path, package, extra, call):
    (tmp_path / "room.obj").write_text(prism_obj(box_plan(6.0, 4.0), 3.0))
    done = run_without([package], f"from roomeq import *; import roomeq; roomeq.{call}", tmp_path / "room.obj")
    assert done.stderr.splitlines()[-1] == (
        f"ModuleNotFoundError: the package {package} is not installed: pip install 'roomeq[{extra}]'")


@pytest.fixture(scope="module")
def bash_completion(tmp_path_factory):
    """Complete words as bash does with the script that the manual names."""
    folder = tmp_path_factory.mktemp("bin")
    (folder / "roomeq").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m roomeq "$@"\n')
    (folder / "roomeq").chmod(0o755)
    script = ('eval "$(_ROOMEQ_COMPLETE=bash_source roomeq)"\ncompopt() { echo "$*"; }\n'
              'COMP_WORDS=("$@") COMP_CWORD=$(($# - 1)) COMPREPLY=()\n_roomeq_completion roomeq\n'
              'printf "%s\\n" "${COMPREPLY[@]}"')

    def complete(*words):
        done = subprocess.run(["bash", "-c", script, "bash", "roomeq", *words], capture_output=True, text=True,
                              check=True, env=os.environ | dict(PATH=f"{folder}:{os.environ['PATH']}"))
        assert done.stderr == ""
        return done.stdout.split()

    return complete


@pytest.mark.parametrize(("words", "expected"), [
    (["sim"], {"simulate"}), (["prepare"], {"prepare-speech"}),
    (["augment", "--p"], {"--packing", "--pipes", "--part", "--point-snr", "--point-noise-prob"}),
    (["augment", "--packing", ""], {"recording", "utterance"}), (["prepare-speech", "--ch"], {"--channel"})])
def test_bash_completes_verbs_options_and_values(bash_completion, words, expected):
    assert set(bash_completion(*words)) == expected


def test_bash_completes_every_verb(bash_completion):
    assert set(bash_completion("")) == set(VERBS)


def test_bash_completes_paths_as_files(bash_completion):
    assert "default" in bash_completion("augment", "--noises", "")


def test_module_runs_as_the_command():
    done = subprocess.run([sys.executable, "-m", "roomeq", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == __version__
