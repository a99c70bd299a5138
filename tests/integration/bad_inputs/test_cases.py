"""Every bad input: exit 1, one line that says what, where and what to do, nothing lost, nothing left behind."""

import re

import cases_audio
import cases_corpora
import cases_datadirs
import cases_export
import cases_options
import cases_rooms
import cases_rows
import cases_wer
import pytest
from running import call, set_up, snapshot

TABLES = dict(audio=cases_audio, rows=cases_rows, datadirs=cases_datadirs, corpora=cases_corpora,
              rooms=cases_rooms, options=cases_options, wer=cases_wer,
              export=cases_export)
CASES = [pytest.param(case, id=f"{table}-{case.name}".replace(" ", "_")) for table, module in TABLES.items()
         for case in module.CASES]


@pytest.mark.parametrize("case", CASES)
def test_bad_input_is_one_line_and_loses_nothing(case, worlds, tmp_path, monkeypatch, strict, record_property):
    record_property("step", case.argv[0])
    set_up(case, worlds, tmp_path)
    monkeypatch.chdir(tmp_path)
    before = snapshot(tmp_path)
    status, said = call(case.argv)
    assert status == 1
    assert said.count("\n") == 1 and said.isprintable() is False and said[:-1].isprintable()
    assert re.fullmatch(".*".join(map(re.escape, f"{case.message}".split("..."))),
                        said[:-1].removeprefix("roomeq: ")), said
    assert snapshot(tmp_path) == before


def test_case_names_are_unique():
    names = [param.id for param in CASES]
    assert len(names) == len(set(names)) >= 80
