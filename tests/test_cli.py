"""Every verb is a documented function with the same options; a user's mistake is one line."""

import argparse
import importlib
import inspect

import pytest

from roomeq.cli import build_parser, main

VERBS = next(action for action in build_parser()._actions
             if isinstance(action, argparse._SubParsersAction)).choices


@pytest.mark.parametrize("verb", VERBS)
def test_verbs_are_functions(verb):
    parser = VERBS[verb]
    function = getattr(importlib.import_module(f"roomeq.{parser.get_default('module')}"),
                       parser.get_default("function"))
    options = {action.dest: action.default for action in parser._actions if action.dest != "help"}
    parameters = inspect.signature(function).parameters
    assert set(options) == set(parameters)
    for name, parameter in parameters.items():
        if parameter.default is not inspect.Parameter.empty and parameter.default != () and options[name] is not None:
            assert options[name] == parameter.default, f"{verb}: default of {name}"
    for section in ("Parameters", "Raises"):
        assert section in function.__doc__, f"{verb}: docstring lacks {section}"
    assert "example:" in parser.format_help()


def test_help_and_version(capsys):
    for flag in ("--help", "--version"):
        with pytest.raises(SystemExit) as stop:
            main([flag])
        assert stop.value.code == 0
    assert "simulate" in capsys.readouterr().out


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
])
def test_an_absent_input_is_one_line(argv, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(argv) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and lines[0].startswith("roomeq: ") and "absent" in lines[0]
    assert [path for path in tmp_path.iterdir() if not path.name.startswith(".")] == []
