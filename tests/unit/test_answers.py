"""One process answers a recipe's questions as ``roomeq --ask`` does."""

import io
import logging
import os

import numpy as np
import pytest
from scripts import call

from roomeq.answers import SEPARATOR, answer
from roomeq.cli import NOT_UP_TO_DATE, main
from roomeq.core.asking import only_ask
from roomeq.core.audio import write_wav
from roomeq.core.digests import code_digest

RECIPE = """#!/usr/bin/env bash
# Run a step as it is, twice, and when the process that answers is gone.
# Usage: recipe.sh <noises> <out>
set -euo pipefail
. ./path.sh
. utils/parse_options.sh
. utils/ask.sh
roomeq() { echo "roomeq $1" && command roomeq "$@"; }
export -f roomeq
start_answering
bash ./step.sh "$1" "$2"
bash ./step.sh "$1" "$2"
bash ./step.sh absent "$2" || echo "exit $?"
kill "$COPROC_PID"
bash ./step.sh "$1" "$2"
"""
STEP = """. ./path.sh
. utils/ask.sh
run_verb read-noises "$1" "$2"
"""


@pytest.fixture(autouse=True)
def only_here():
    yield
    only_ask(False)


@pytest.fixture
def noises(tmp_path):
    write_wav(tmp_path / "a b/hum.wav", np.linspace(-0.5, 0.5, 1600))
    return tmp_path / "a b"


def test_answers_are_those_of_single_questions(noises, tmp_path, monkeypatch, capsys):
    asked = [["read-noises", str(path), str(tmp_path / out)] for path, out in
             ((noises, "other"), (noises, "out"), (tmp_path / "absent", "out"))]
    assert main(asked[1]) == 0
    capsys.readouterr()
    monkeypatch.setattr(logging.root, "handlers", [])  # as in a process of its own
    questions = "".join(SEPARATOR.join(arguments) + "\n" for arguments in asked)
    answer(io.StringIO(questions), answers := io.StringIO())
    assert answers.getvalue() == f"{NOT_UP_TO_DATE}\n0\n1\n"
    said = capsys.readouterr()
    assert said.err.startswith(f"{tmp_path}/out: up to date\nroomeq: {tmp_path}/absent: no such file or directory")
    assert said.err.count("\n") == 2 and said.out == ""


def test_sources_that_change_between_two_questions_are_noticed(noises, tmp_path, monkeypatch):
    assert main(["read-noises", str(noises), str(tmp_path / "out")]) == 0
    question = SEPARATOR.join(["read-noises", str(noises), str(tmp_path / "out")])

    def questions():
        yield question
        monkeypatch.setattr("roomeq.core.digests.source_digest", lambda *_: "other sources")
        yield question

    answer(questions(), answers := io.StringIO())
    code_digest.cache_clear()
    assert answers.getvalue() == f"0\n{NOT_UP_TO_DATE}\n"


def test_scripts_ask_one_process_and_do_without_it_when_it_is_killed(noises, tmp_path, project_dir):
    for name in ("path.sh", "pysrc", "utils", ".venv"):
        os.symlink(project_dir / name, tmp_path / name)
    (tmp_path / "recipe.sh").write_text(RECIPE)
    (tmp_path / "step.sh").write_text(STEP)
    done = call(tmp_path, "bash", "recipe.sh", str(noises), str(tmp_path / "out"))
    assert done.returncode == 0, done.stderr
    assert done.stdout.splitlines() == ["roomeq read-noises", "exit 1", "roomeq --ask"]
    assert done.stderr.count("out: up to date") == 2 and done.stderr.count("absent: no such file") == 1
