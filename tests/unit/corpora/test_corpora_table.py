"""A CSV of measured RIRs."""

import logging
import unicodedata
from pathlib import Path

import pytest
from corpora_examples import make_table, put, put_text

from roomeq.corpora.folder import list_folder
from roomeq.corpora.listing import detect_kind, list_corpus
from roomeq.corpora.record import UNKNOWN, noise_kind_of, parse_number, parse_vector, rir_row
from roomeq.corpora.speech import DEFAULT_SETS, list_speech
from roomeq.corpora.table import list_noise_table, list_table
from roomeq.corpora.transcripts import list_transcripts
from roomeq.records.geometry import find_contradiction
from roomeq.records.schema import make_id


def list_row(tmp_path, header, cells, file="a.wav"):
    put(tmp_path / file)
    return list_table(put_text(tmp_path / "t.csv", f"file,{header}\n{file},{cells}\n")).rirs[0]


def test_cells_of_the_example_are_parsed(tmp_path):
    rows = {recording.id: recording.row for recording in list_table(make_table(tmp_path) / "manifest.csv").rirs}
    first, clap = rows["lab__one"], rows["lab__two_clap"]
    assert first["room_dims_m"] == [9.7, 5.5, 2.7] and first["source_pos_m"] == [4.71, 2.75, None]
    assert first["distance_m"] == 1.5 and first["binaural"] is False and first["excitation"] is None
    assert first["tof_removed"] is None and first["corpus"] == "Lab"
    assert clap["binaural"] is True and clap["excitation"] == "clap" and clap["room_dims_m"] is None


@pytest.mark.parametrize("text, vector", [
    ("4.7 2.75 ?", [4.7, 2.75, None]), ("4.7,2.75,1", [4.7, 2.75, 1]), ("[1; 2; 3]", [1, 2, 3]),
    ("9x5 x 3", [9, 5, 3]),
    ("", None), ("?", None), ("? ? ?", None), (None, None), ("1 - 2", [1, None, 2]), ("-1 2 3", [-1, 2, 3])])
def test_vector_cells_are_parsed(text, vector):
    assert parse_vector(text) == vector


@pytest.mark.parametrize("text", ["6 5,5", "6,1,5,2", "6,5, 3", "1 2 3 4"])
def test_cells_without_three_coordinates_are_refused(text):
    with pytest.raises(ValueError, match="must be three numbers"):
        parse_vector(text)


def test_number_cells_are_parsed():
    assert parse_number("2,5") == 2.5 and parse_number(" 1e-3 ") == 1e-3 and parse_number("n/a") is None
    with pytest.raises(ValueError, match="must be finite"):
        parse_number("inf")


def test_separators_case_and_byte_order_mark_are_free(tmp_path):
    put(tmp_path / "a.wav")
    (tmp_path / "t.csv").write_text("\ufeffFile;Room;source_pos_m\r\na.wav;lab 1;1.5 2,5 1\r\n", encoding="utf-8")
    row = list_table(tmp_path / "t.csv").rirs[0].row
    assert row["room_id"] == "lab-1" and row["source_pos_m"] == [1.5, 2.5, 1]


def test_manifest_may_be_in_upper_case(tmp_path):
    put(tmp_path / "A.WAV")
    put_text(tmp_path / "MANIFEST.CSV", "file,room_dims_m,transcript\nA.WAV,5 4 3,\n")
    assert detect_kind(tmp_path) == "table"
    with pytest.raises(ValueError, match="MANIFEST.CSV:2: transcript=''"):
        list_speech(tmp_path, DEFAULT_SETS)
    put_text(tmp_path / "MANIFEST.CSV", "file,room_dims_m\nA.WAV,5 4 3\n")
    assert list_corpus(tmp_path).rirs[0].row["room_dims_m"] == [5, 4, 3]


@pytest.mark.parametrize("before", ["sep=;\r\n", '"sep=;"\n', ";;\n\n"])
def test_lines_that_spreadsheets_write_before_the_header_are_ignored(tmp_path, before):
    put(tmp_path / "a.wav")
    put_text(tmp_path / "t.csv", f"\ufeff{before}file;room_dims_m;distance_m\na.wav;5,2 4,1 2,8;near\n")
    with pytest.raises(ValueError, match=rf"t\.csv:{before.count(chr(10)) + 2}: distance_m='near'"):
        list_table(tmp_path / "t.csv")
    put_text(tmp_path / "t.csv", f"\ufeff{before}file;room_dims_m;distance_m\na.wav;5,2 4,1 2,8;1,5\n")
    row = list_table(tmp_path / "t.csv").rirs[0].row
    assert row["room_dims_m"] == [5.2, 4.1, 2.8] and row["distance_m"] == 1.5


def test_empty_columns_without_a_name_are_ignored(tmp_path):
    assert list_row(tmp_path, "room,,", "lab,,").row["room_id"] == "lab"
    with pytest.raises(ValueError, match="column '' occurs twice"):
        list_row(tmp_path, "room,,", "lab,,x")


def test_rooms_and_corpora_are_named_by_the_working_directory(tmp_path, monkeypatch):
    (tmp_path / "Hall").mkdir()
    put(tmp_path / "Hall" / "a.wav")
    put_text(tmp_path / "Hall" / "t.csv", "file\na.wav\n")
    monkeypatch.chdir(tmp_path / "Hall")
    for corpus in (list_table(Path("t.csv")), list_folder(Path())):
        assert corpus.name == "Hall" and corpus.rirs[0].row["room_id"] == "Hall"


def test_rooms_called_like_those_of_but_are_as_good_as_others(tmp_path):
    for name in ("Lab_L227", "ConferenceRoom2"):
        row = list_row(tmp_path, "room", name).row
        assert not row["uncommon"] and not row["unreliable_geometry"]


def test_unused_columns_are_logged(tmp_path, caplog):
    caplog.set_level(logging.INFO)
    list_row(tmp_path, "licence,gain", "CC0,2")
    assert "columns not used: gain, licence" in caplog.text


@pytest.mark.parametrize("read, columns, unused", [
    (list_noise_table, "file,type\na.wav,ambient\n", "type"),
    (list_transcripts, "file,transcript,speaker_id\na.wav,HELLO,spk1\n", "speaker_id")])
def test_unused_columns_of_noises_and_speech_are_logged(tmp_path, caplog, read, columns, unused):
    caplog.set_level(logging.INFO)
    read(put_text(tmp_path / "t.csv", columns))
    assert f"columns not used: {unused}" in caplog.text


def test_dummy_heads_are_recognised_by_name_as_in_folders(tmp_path):
    assert list_row(tmp_path, "room", "office", "office_brir_1.wav").row["binaural"] is True
    assert list_folder(tmp_path).rirs[0].row["binaural"] is True
    assert list_row(tmp_path, "binaural", "0", "office_brir_1.wav").row["binaural"] is False


def test_excitation_column_overrides_the_file_name(tmp_path):
    assert list_row(tmp_path, "excitation", "mls", "clap.wav").row["excitation"] == "mls"
    assert list_row(tmp_path, "excitation", "", "clap.wav").row["excitation"] is None
    assert list_row(tmp_path, "room", "Clapham", "x_sweep2.wav").row["excitation"] == "sweep"


def test_ids_never_hold_a_path(tmp_path):
    put(tmp_path / "elsewhere" / "r 1.wav")
    (tmp_path / "corpus" / "sub").mkdir(parents=True)
    path = put_text(tmp_path / "corpus" / "t.csv", "file,rir_id\n../elsewhere/r 1.wav,\nsub/x.wav,../../etc/x\n")
    ids = [recording.id for recording in list_table(path).rirs]
    assert ids == ["elsewhere-r-1", "etc-x"]


def test_paths_may_start_with_the_folder_of_the_csv(tmp_path):
    put(tmp_path / "noise" / "room_tone.wav")
    path = put_text(tmp_path / "noise" / "manifest.csv", "file,description\nnoise/room_tone.wav,quiet\n")
    noise = list_noise_table(path)[0]
    assert noise.path.is_file() and noise.id == "room_tone" and noise.row["kind"] == "ambient"


def test_umlauts_in_either_spelling_are_one_name_and_one_file(tmp_path):
    """macOS decomposes the letters of file names, and spreadsheets write composed ones."""
    composed, decomposed = (unicodedata.normalize(form, "Büro") for form in ("NFC", "NFD"))
    put(tmp_path / decomposed / "a.wav")
    put(tmp_path / composed / "b.wav")
    put_text(tmp_path / "t.csv", f"file,room\n{composed}/a.wav,{composed}\n{decomposed}/b.wav,{decomposed}\n"
                                 f"{decomposed}/a.wav,Raum 1\n{composed}/b.wav,Raum\u00a01\n")
    recordings = list_table(tmp_path / "t.csv").rirs
    assert [recording.path.parent.name for recording in recordings] == [decomposed, composed, decomposed, composed]
    assert [recording.path.is_file() for recording in recordings] == [True] * 4
    assert [recording.row["room_id"] for recording in recordings] == [make_id(composed)] * 2 + ["Raum-1"] * 2


def test_umlauts_of_a_folder_and_of_a_cell_are_one_name(tmp_path):
    """A folder names the room or the speaker where no cell does."""
    composed, decomposed = (unicodedata.normalize(form, "Büro") for form in ("NFC", "NFD"))
    put(tmp_path / decomposed / "a.wav")
    put_text(tmp_path / "t.csv", f"file,room\n{decomposed}/a.wav,\nb.wav,{composed}\n")
    put_text(tmp_path / "n.csv", f"file,room\nn.wav,{composed}\n")
    put_text(tmp_path / "s.csv", f"file,transcript,speaker\n{decomposed}/a.wav,HELLO,\nb.wav,HELLO,{composed}\n")
    rirs = [*list_table(tmp_path / "t.csv").rirs, *list_folder(tmp_path).rirs, *list_noise_table(tmp_path / "n.csv")]
    assert {recording.row["room_id"] for recording in rirs} == {make_id(composed)}
    assert len({utterance.speaker for utterance in list_transcripts(tmp_path / "s.csv")[""]}) == 1


def test_rooms_named_by_folders_of_one_name_are_refused(tmp_path):
    path = put_text(tmp_path / "t.csv", "file,room\nattic/RIR/a.wav,attic\nkitchen/RIR/a.wav,\ncellar/RIR/a.wav,\n")
    with pytest.raises(ValueError, match="t.csv:4: folder of a room without a name in column 'room'='.*cellar/RIR' and "
                                         "'.*kitchen/RIR' would both have the id 'RIR'"):
        list_table(path)


def test_documented_t60_in_words_is_unknown(tmp_path):
    path = put_text(tmp_path / "t.csv", 'file,documented_t60_s\na.wav,"0.5-0.75 (README)"\nb.wav,0.6\n')
    corpus = list_table(path)
    assert [recording.row["documented_t60_s"] for recording in corpus.rirs] == [None, 0.6]
    assert sum(corpus.notes.values()) == 1


def test_noise_kind_is_recognised_by_name():
    assert noise_kind_of("room_tone_home") == noise_kind_of("a/silence.v00") == "ambient"
    assert noise_kind_of("exercise_bike") == noise_kind_of("dial_tone") == "point"


def test_contradicting_geometry_is_found():
    good = dict(room_dims_m=[5, 4, 3], source_pos_m=[1, 1, None], mic_pos_m=[3, 1, 1], distance_m=2.0)
    assert find_contradiction(rir_row(**good)) is None
    assert "outside" in find_contradiction(rir_row(**good | dict(mic_pos_m=[5.1, 1, 1]))).detail
    assert "must be positive" in find_contradiction(rir_row(**good | dict(room_dims_m=[0, 4, 3]))).detail
    assert find_contradiction(rir_row(**good | dict(source_pos_m=[1, 1, 1]))) is None
    assert "2.9" in find_contradiction(rir_row(**good | dict(source_pos_m=[1, 1, 1], distance_m=2.9))).detail
    assert rir_row(**good | dict(source_pos_m=[3, 1, 1.03]))["unreliable_geometry"]  # is simulated elsewhere
    assert "0.005 m apart" in find_contradiction(rir_row(**good | dict(source_pos_m=[3, 1, 1.005]))).detail


@pytest.mark.parametrize("dims_m, message", [
    ("6 -4 3", r"t\.csv:2: room_dims_m\[1\]=-4 must be positive: give metres, or \? where it is unknown: correct"),
    ("0 4 3", r"t\.csv:2: room_dims_m\[0\]=0 must be positive"),
    ("6 4 300", r"t\.csv:2: room_dims_m\[2\]=300 must be at most 200")])
def test_impossible_room_dimensions_are_refused(tmp_path, dims_m, message):
    with pytest.raises(ValueError, match=message):
        list_row(tmp_path, "room_dims_m", dims_m)


@pytest.mark.parametrize("cells, name", [
    (dict(source_pos_m="1500 2000 1200", mic_pos_m="3000 2000 1200"),
     r"mic_pos_m\[0\] - source_pos_m\[0\]=1500 must lie in \[-200, 200\]"),
    (dict(source_pos_m="1500 2000 ?", mic_pos_m="1510 500 ?"),
     r"mic_pos_m\[1\] - source_pos_m\[1\]=-1500 must lie in \[-200, 200\]"),
    (dict(distance_m="1500"), "distance_m=1500 must be at most 200")])
def test_positions_in_millimetres_are_refused(tmp_path, cells, name):
    with pytest.raises(ValueError, match=rf"t\.csv:2: {name}: give metres: correct the cell"):
        list_row(tmp_path, ",".join(cells), ",".join(cells.values()))


@pytest.mark.parametrize("key", ["source_dir", "mic_dir"])
def test_facings_in_degrees_or_radians_are_refused(tmp_path, key):
    for angles in ("90 0 0", "0.5 0.1 0", "1.5708 0 ?", "1.05 0 0", "? 1.05 ?"):
        with pytest.raises(ValueError, match=rf"t\.csv:2: {key}=\[.*\] must be a unit vector, no angles: correct"):
            list_row(tmp_path, key, angles)
    for cells, known in {"0.7072 0.7072 ?": [0.7072, 0.7072, None], "0.6 0.6 0.6": [0.6] * 3}.items():
        assert list_row(tmp_path, key, cells).row[key] == known


def test_positions_may_count_from_anywhere(tmp_path):
    row = list_row(tmp_path, "source_pos_m,mic_pos_m", "412.3 1088.1 ?,415.0 1090.5 ?").row
    assert row["source_pos_m"] == [412.3, 1088.1, None]


HEADER = "file,rir_id,binaural,distance_m,mic_pos_m,kind\n"


@pytest.mark.parametrize("text, message", [
    ("", r"t\.csv: columns \(none\) must include 'file'"),
    ("name,room\na,b\n", r"t\.csv: columns name,room must include 'file'"),
    (HEADER, r"t\.csv: no rows below the header"),
    ("file,path\na.wav,a.wav\n", "column 'file' occurs twice"),
    (HEADER + "a.wav,x,0,1,1 2 3,point,more\n", r"t\.csv:2: 7 cells under 6 columns: quote cells"),
    (HEADER + ",x\n", r"t\.csv:2: file='' must be the path"),
    (HEADER + "a.wav,x,maybe\n", r"t\.csv:2: binaural='maybe': must be 0 or 1: correct the cell"),
    (HEADER + "a.wav,x,0,near\n", r"t\.csv:2: distance_m='near': must be a number or \?: correct"),
    (HEADER + "a.wav,x,0,1,1 2\n", r"t\.csv:2: mic_pos_m='1 2': '1 2' must be three numbers"),
    (HEADER + "a.wav,x,0,1,1 2 here\n", r"t\.csv:2: mic_pos_m='1 2 here': must be a number or \?")])
def test_malformed_table_is_refused(tmp_path, text, message):
    put(tmp_path / "a.wav")
    with pytest.raises(ValueError, match=message):
        list_table(put_text(tmp_path / "t.csv", text))


def test_bad_noise_kind_and_bytes_are_refused(tmp_path):
    with pytest.raises(ValueError, match=r"t\.csv:2: kind='loud' must be 'ambient' or 'point'"):
        list_noise_table(put_text(tmp_path / "t.csv", "file,kind\na.wav,loud\n"))
    (tmp_path / "t.csv").write_bytes(b"file\n\xff\xfe\n")
    with pytest.raises(ValueError, match="not a CSV file in UTF-8"):
        list_table(tmp_path / "t.csv")


@pytest.mark.parametrize("unknown", ["?", "", "NA", "unknown"])
def test_unknown_names_are_not_taken_for_one_name(tmp_path, unknown):
    for folder in ("hall", "attic"):
        put(tmp_path / folder / "a.wav")
    lines = [f"{folder}/a.wav,{unknown},{unknown},{unknown}\n" for folder in ("hall", "attic")]
    table = put_text(tmp_path / "t.csv", "file,rir_id,room,source_id\n" + "".join(lines))
    rows = [recording.row for recording in list_table(table).rirs]
    assert [row["room_id"] for row in rows] == ["hall", "attic"] and {row["source_id"] for row in rows} == {UNKNOWN}
    assert [noise.row["room_id"] for noise in list_noise_table(table)] == [None, None]
