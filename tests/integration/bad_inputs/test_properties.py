"""What holds for any text: readers give a result or a `ValueError` on one line that names the file."""

import json
import string
from dataclasses import fields
from pathlib import Path

import click
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from loop_run import make_loop
from running import call
from wrong import HOSTILE

from roomeq import cli
from roomeq.augment.distribution import parse_distribution
from roomeq.core.build import share
from roomeq.core.files import read_json, read_jsonl
from roomeq.core.stamps import read_stamp
from roomeq.corpora.record import parse_number, parse_vector
from roomeq.corpora.reverbdb import list_reverbdb, read_meta
from roomeq.corpora.table import list_noise_table, list_table
from roomeq.corpora.transcripts import list_transcripts
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.model import read_model
from roomeq.eq.gmm import read_gmm, sample_eq
from roomeq.kaldi.datadir import read_data_dir
from roomeq.kaldi.wavscp import parse_entry
from roomeq.loop.ledger import read_ledger
from roomeq.records.rir_dir import read_noises, read_rirs
from roomeq.records.schema import MAX_ID, is_id, make_id, row_problem

quick = settings(max_examples=60, deadline=None, derandomize=True,
                 suppress_health_check=[HealthCheck.function_scoped_fixture])
TEXT = st.text(st.one_of(st.characters(), st.sampled_from(string.printable + HOSTILE)), max_size=60)
NUMBER = st.one_of(st.integers(), st.floats(), st.sampled_from([0, -1, 10**400, 1e300, True]))
JSON = st.recursive(st.one_of(st.none(), st.booleans(), NUMBER, TEXT), lambda inner: st.one_of(
    st.lists(inner, max_size=8), st.dictionaries(TEXT, inner, max_size=4)), max_leaves=12)
CELL = st.one_of(TEXT, st.sampled_from(["", "?", "1", "1 2 3", "nan", "-1", "1,5", "a.wav", "../a.wav", "/", "."]))
ROW = dict(id="a", wav="a.wav", room_id="r", source_id="s", mic_id="m", fs_hz=16000, n_samples=99)
KEYS = [*ROW, "room_dims_m", "source_pos_m", "mic_pos_m", "mesh", "acoustic_parameters", "direct_sample",
        "direct_polarity", "model", "noise_for", "repeat_of", "binaural", "excitation", "screen", "distance_m",
        "temperature_c", "humidity_pct"]


def dump(value) -> str:
    return json.dumps(value, ensure_ascii=True)


def one_line_or_result(read, path):
    """Return what a reader gives, or None where it refused in the way it should."""
    try:
        return read(path)
    except ValueError as error:
        assert str(Path(path)) in str(error) and len(cli.printable(str(error))) < 2000
        assert "Traceback" not in str(error)
        return None


@quick
@given(st.lists(st.one_of(TEXT, JSON.map(dump), st.dictionaries(st.sampled_from(KEYS), JSON).map(
    lambda changed: dump(ROW | changed))), max_size=4).map("\n".join))
def test_rows_of_any_kind(tmp_path, content):
    for name, read in (("rirs.jsonl", read_rirs), ("noises.jsonl", read_noises)):
        (tmp_path / name).write_text(content, encoding="utf-8", errors="surrogatepass")
        one_line_or_result(read, tmp_path)
    one_line_or_result(read_jsonl, tmp_path / "rirs.jsonl")


@quick
@given(st.dictionaries(st.sampled_from(KEYS), JSON))
def test_a_row_is_right_or_its_problem_has_a_name(changed):
    problem = row_problem(ROW | changed)
    assert problem is None or (any(key in problem for key in [*KEYS, "eq_"]) and len(problem) < 400)


@quick
@given(st.binary(max_size=200))
def test_bytes_of_any_kind(tmp_path, content):
    for name, read in (("x.json", read_json), ("rirs.jsonl", read_jsonl), ("gmm.json", read_gmm), ("t.csv", list_table),
                       ("t.csv", list_noise_table), ("t.csv", list_transcripts)):
        (tmp_path / name).write_bytes(content)
        one_line_or_result(read, tmp_path / name)
    (tmp_path / ".done").write_bytes(content)
    one_line_or_result(read_stamp, tmp_path)
    (tmp_path / "meta.txt").write_bytes(content)
    assert isinstance(read_meta(tmp_path / "meta.txt"), dict)


@quick
@given(st.dictionaries(st.sampled_from(["weights", "means_db", "covariances_db2", "points_hz", "weights_of_room"]),
                       JSON))
def test_a_mixture_is_refused_or_can_be_drawn_from(tmp_path, changed):
    eye = np.eye(7).tolist()
    mixture = dict(weights=[0.5, 0.5], means_db=[[0.0] * 7] * 2, covariances_db2=[eye, eye], weights_of_room={})
    (tmp_path / "gmm.json").write_text(dump(mixture | changed))
    if (gmm := one_line_or_result(read_gmm, tmp_path / "gmm.json")) is not None:
        assert np.isfinite(sample_eq(gmm, 3, np.random.default_rng(0))).all()


@quick
@given(st.lists(st.sampled_from(["file", "id", "room", "binaural", "distance_m", "source_pos_m", "kind", "transcript",
                                 "gender", "speaker", ""]), max_size=6),
       st.lists(st.lists(CELL, max_size=7), max_size=3), st.sampled_from(",;\t"))
def test_tables_of_any_kind(tmp_path, columns, cells, delimiter):
    path = tmp_path / "t.csv"
    path.write_text("\n".join(map(delimiter.join, [columns, *cells])), encoding="utf-8", errors="surrogatepass")
    for read in (list_table, list_noise_table, list_transcripts):
        found = one_line_or_result(read, path)
        if read is list_table and found:
            assert all(is_id(recording.id) and is_id(recording.row["room_id"]) for recording in found.rirs)


@quick
@given(st.dictionaries(st.sampled_from(["EnvDepth", "EnvWidth", "EnvHeight", "EnvMicID", "EnvMic1Depth", "EnvMic1Width",
                                        "EnvSpk1Depth", "EnvTemp", "EnvType", "EnvMic1RelDistance"]), CELL), TEXT)
def test_meta_files_of_any_kind(worlds, tmp_path, meta, banner):
    mic = tmp_path / "room" / "MicID01" / "SpkID01_20190503_S" / "01"
    (mic / "RIR").mkdir(parents=True, exist_ok=True)
    (mic / "RIR" / "a.wav").touch()
    text = banner + "".join(f"\n${key}\t{value}" for key, value in meta.items())
    (mic / "mic_meta.txt").write_text(text, encoding="utf-8", errors="surrogatepass")
    (recording,) = list_reverbdb(tmp_path).rirs
    assert is_id(recording.id) and row_problem(ROW | recording.row) is None


@quick
@given(st.dictionaries(st.sampled_from(["wav.scp", "utt2spk", "spk2utt", "text", "segments", "utt2dur", "spk2gender"]),
                       st.lists(st.tuples(st.sampled_from(["a-1", "a-2", "b-1", "a", "b", ""]), CELL), max_size=4)))
def test_data_directories_of_any_kind(tmp_path, tables):
    for path in tmp_path.iterdir():
        path.unlink()
    for name, lines in tables.items():
        text = "".join(f"{key} {value}\n" for key, value in lines)
        (tmp_path / name).write_text(text, encoding="utf-8", errors="surrogatepass", newline="")
    one_line_or_result(read_data_dir, tmp_path)


@quick
@given(st.text(max_size=400))
def test_any_text_makes_an_id(text):
    made = make_id(text)
    assert is_id(made) and make_id(made) == made and len(made) < MAX_ID - 20
    assert Path("x", made).name == made and ".." not in Path(made).parts


@quick
@given(TEXT, st.floats(0, 1, exclude_max=True))
def test_any_text_is_a_distribution_or_refused(text, u):
    for candidate in (text, f"uniform {text}", f"normal {text}", f"list {text}"):
        try:
            quantile = parse_distribution(candidate, "snr_db")
        except ValueError as error:
            assert str(error).startswith("snr_db=")
        else:
            assert quantile is None or np.isfinite(quantile(u))


@quick
@given(TEXT)
def test_numbers_are_parsed_or_refused(text):
    for verb in cli.cli.commands.values():
        for param in verb.params:
            try:
                param.type.convert(text, param, None)
            except click.UsageError as error:
                assert repr(text) in error.message
    for parse in (parse_number, parse_vector, parse_entry, lambda text: share(["a", "b"], text)):
        try:
            parse(text)
        except ValueError:
            pass
    shown = cli.printable(text)
    assert shown.isprintable() and len(shown) < 2000


@quick
@given(st.sampled_from(sorted(CATALOGUE)), st.data())
def test_a_model_is_refused_or_gives_every_row_its_effects(tmp_path, name, data):
    effect = CATALOGUE[name]
    of = {field.name: data.draw(st.one_of(JSON, st.lists(NUMBER, min_size=8, max_size=8), st.floats(0.01, 60.0)))
          for field in fields(effect)}
    changed = data.draw(st.dictionaries(st.sampled_from(["effect", "of", "typical", "spread"]), JSON))
    (tmp_path / "m.json").write_text(dump(dict(format=3, effects=[dict(effect=name, of=dict(r=of)) | changed])))
    if (model := one_line_or_result(read_model, tmp_path / "m.json")) is not None:
        for unit in ("r", "other"):
            (one,) = model.for_row(dict(id=unit, room_id=unit, source_id=unit, mic_id=unit), 0)
            assert np.isfinite(one.vector()).all()


@settings(quick, max_examples=300)
@given(st.integers(0, 10**6), JSON)
def test_a_ledger_is_right_or_refused_in_one_line(loop, tmp_path, place, value):
    """Any value at any place of a ledger."""
    ledger = json.loads((loop / "ledger.json").read_text())
    places = list(everywhere(ledger))
    holder, key = places[place % len(places)]
    holder[key] = value
    (tmp_path / "ledger.json").write_text(dump(ledger))
    one_line_or_result(read_ledger, tmp_path / "ledger.json")


@pytest.fixture(scope="module")
def loop(tmp_path_factory):
    return make_loop(tmp_path_factory.mktemp("made") / "loop")


def everywhere(value):
    """Yield each place of nested lists and objects, as what holds it and its key."""
    for key in list(value) if isinstance(value, dict) else range(len(value)):
        yield value, key
        if isinstance(value[key], dict | list):
            yield from everywhere(value[key])


VERBS = ("validate", "simulate", "characterise", "split-rirs", "fit-eq", "compensate", "close-loop", "augment",
         "report", "prepare-speech", "read-measured", "read-noises", "export", "show", "compare")
OPTIONS = ("--seed", "--nj", "--part", "--num-rays", "--order", "--t60-range", "--sizes", "--taps",
           "--draw-rooms-equally",
           "--copies", "--snr", "--packing", "--limit", "--kind", "--skip-bad", "--num-components",
           "--max-mesh-mb", "--model", "--out", "--test", "--max-effects", "--id", "--channel", "--speech",
           "--keep-suspicious", "--")


@quick
@given(st.sampled_from(VERBS), st.lists(st.one_of(st.sampled_from(OPTIONS), CELL.filter(lambda text: text != "/")),
                                        max_size=7))
def test_command_lines_of_any_kind(tmp_path, verb, words):
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path)
        status, said = call([verb, *words])
    if {"-h", "--help"} & set(words) and status == 0:
        return
    assert status == 1 and said.count("\n") == 1 and said[:-1].isprintable() and "internal error" not in said
    assert [path for path in tmp_path.rglob("*") if not path.name.startswith(".")] == []
