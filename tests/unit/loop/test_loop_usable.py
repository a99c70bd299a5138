"""Which RIRs the closed loop uses: those left out are counted by reason; too few are refused in one line."""

import subprocess
import sys
from pathlib import Path

import pytest
from rirmaker import coloured_rir, row, write_rir_dir

from enough_rooms import main as check_rooms
from roomeq.cli import main
from roomeq.core.audio import write_wav
from roomeq.core.files import write_text
from roomeq.loop.close import SCATTERING
from roomeq.loop.data import load_data
from roomeq.loop.doubtful_recordings import COPY_IN_ROOM
from roomeq.loop.usable import REPEAT, UNLIKE, LeftOut, require_enough_rooms, usable_rirs
from roomeq.records.geometry import BINAURAL, MARKED, OUTSIDE, TOO_CLOSE
from roomeq.records.rir_dir import read_rirs

ENOUGH_ROOMS = Path(__file__).parents[3] / "local/enough_rooms.py"
FLAT = dict(source_pos_m=[1.0, 1.0, None], mic_pos_m=[4.0, 3.0, None])
KNOWN = dict(source_pos_m=[1.0, 1.0, 1.5], mic_pos_m=[4.0, 3.0, 1.2])
BOX = "".join(f"v {x} {y} {z}\n" for z in (0, 3) for x, y in ((0, 0), (6, 0), (6, 5), (0, 5))) + (
    "f 4 3 2 1\nf 5 6 7 8\nf 1 2 6 5\nf 2 3 7 6\nf 3 4 8 7\nf 4 1 5 8\n")


def directory(where, rows):
    """Write rows and a recording for each."""
    return write_rir_dir(where, [(item, coloured_rir([*item["id"].encode()])) for item in rows])


def apart(places, n):
    """Return the places of the n-th RIR, whose room has another one elsewhere."""
    return places | dict(mic_pos_m=[*places["mic_pos_m"][:1], 3.0 + n % 2, *places["mic_pos_m"][2:]])


def enough_rooms(where, out):
    """Run the recipe's check; return whether the rooms are enough, and what it prints."""
    done = subprocess.run([sys.executable, ENOUGH_ROOMS, where, out, "2"], capture_output=True, text=True, check=True)
    return (out / "enough").exists(), done.stdout + done.stderr


@pytest.fixture
def bare(tmp_path, capsys):
    """Make an RIR directory of ten bare WAV files in three folders."""
    for n in range(10):
        write_wav(tmp_path / f"bare/room{n % 3}/rir{n}.wav", coloured_rir(n, time_s=0.2 + 0.08 * n))
    assert main(["read-measured", str(tmp_path / "bare"), str(tmp_path / "rirs")]) == 0
    capsys.readouterr()
    return tmp_path / "rirs"


def test_rirs_left_out_are_counted_by_reason(tmp_path):
    first = directory(tmp_path / "a", [row("a1", "x", **KNOWN), row("a2", "x", **FLAT), row("a3", "x", binaural=True),
                                       row("noise", "x", noise_for="a1"), row("a4", "y", unreliable_geometry=True)])
    second = directory(tmp_path / "b", [row("b1", "y", unreliable_geometry=True), row("b2", "z", **KNOWN),
                                        row("b3", "z", unreliable_geometry=True)])
    usable = usable_rirs([first, second])
    assert [(rir.directory, rir.row["id"]) for rir in usable.rirs] == [(first, "a1"), (first, "a2"), (second, "b2")]
    assert usable.left_out == [LeftOut(MARKED, 3, 2), LeftOut(BINAURAL, 1, 1)]
    assert str(usable.left_out[0]) == f"3 RIRs of 2 rooms: {MARKED}" and usable.n_scored == 1


def test_position_outside_of_a_mesh_is_left_out(tmp_path):
    write_text(tmp_path / "room.obj", BOX)
    mesh = dict(mesh="../room.obj", room_dims_m=None)
    where = directory(tmp_path / "a", [row("in", **KNOWN | mesh),
                                       row("out", **KNOWN | mesh | dict(mic_pos_m=[6.5, 1.0, 1.0]))])
    usable = usable_rirs([where])
    assert [rir.row["id"] for rir in usable.rirs] == ["in"] and usable.left_out == [LeftOut(OUTSIDE, 1, 1)]


@pytest.mark.parametrize("places", [KNOWN, FLAT], ids=["known", "heights unknown"])
@pytest.mark.parametrize("change, kept", [
    ({}, ["a"]), (dict(room_id="hall_dry"), ["a", "b"]), (dict(mic_id="other"), ["a", "b"]),
    (dict(mic_pos_m=[4.0, 3.5, 1.2]), ["a", "b"])], ids=["take", "state", "microphone", "position"])
def test_repeated_takes_are_left_out_but_the_first(tmp_path, caplog, places, change, kept):
    caplog.set_level("INFO")
    first = coloured_rir(0)
    take = first + 0.5 * coloured_rir(5)
    where = write_rir_dir(tmp_path / "rirs", [(row("b", **places | change), take), (row("a", **places), first)])
    usable = usable_rirs([where])
    assert sorted(rir.row["id"] for rir in usable.rirs) == kept
    if kept == ["a"]:
        assert usable.left_out == [LeftOut(REPEAT, 1, 1)]
        assert "left out: RIR b of room hall: same positions as a" in caplog.text


def test_marked_repeat_is_left_out_if_its_first_take_is_usable(tmp_path):
    where = directory(tmp_path / "rirs", [
        row("a", "x", repeat_of="z", **KNOWN), row("z", "x", **FLAT), row("b", "y", repeat_of="c", **KNOWN),
        row("c", "y", binaural=True), row("d", "y", repeat_of="z", **KNOWN)])
    usable = usable_rirs([where])
    assert [rir.row["id"] for rir in usable.rirs] == ["z", "b", "d"]
    assert usable.left_out == [LeftOut(BINAURAL, 1, 1), LeftOut(REPEAT, 1, 1)]


def channels(room, n_places, n_channels):
    """Return the rows of an array of microphones whose channels state one position, at some places of a room."""
    return [row(f"{room}p{place}c{channel}", room, mic_id=f"array{channel}", source_pos_m=[1.0, 1.0, 1.5],
                mic_pos_m=[3.0 + place, 3.0, 1.2]) for place in range(n_places) for channel in range(n_channels)]


def test_channels_of_one_place_are_one_position(tmp_path):
    rows = [item for room, n_places in (("x", 1), ("y", 2), ("z", 2)) for item in channels(room, n_places, 4)]
    usable = usable_rirs([directory(tmp_path / "rirs", rows)])
    assert len(usable.rirs) == 20 and usable.n_scored == 2
    with pytest.raises(ValueError, match="and has 2: the RIRs of 1 other have one source and one microphone position, "
                                         "of which one half cannot be held out: give further positions"):
        require_enough_rooms([tmp_path / "rirs"])


def test_copies_within_a_room_are_left_out_and_counted(tmp_path, caplog):
    rows = [item | dict(id=item["id"] + name, mic_id=item["mic_id"] + name) for item in channels("x", 2, 1)
            for name in ("", "copy")]
    where = write_rir_dir(tmp_path / "rirs", [(item, 0.5 ** (n % 2) * coloured_rir(n // 2))
                                              for n, item in enumerate(rows)])
    usable = usable_rirs([where])
    assert [rir.row["id"] for rir in usable.rirs] == ["xp0c0", "xp1c0"]
    assert usable.left_out == [LeftOut(COPY_IN_ROOM, 2, 1)]
    assert "left out: RIR xp0c0copy of room x is the recording of RIR xp0c0 of room x" in caplog.text


@pytest.mark.parametrize("air, message", [
    (dict(temperature_c=293.15), r"temperature_c=293.15 must lie in \[-20, 50\] \(ISO 9613-1\): give degrees Celsius"),
    (dict(temperature_c=68), r"temperature_c=68 must lie in \[-20, 50\]"),
    (dict(humidity_pct=150.0), r"humidity_pct=150 must lie in \[0, 100\]: give relative humidity in percent")])
def test_impossible_air_is_refused_with_rir_and_file(tmp_path, air, message):
    rows = [row("r0", **KNOWN), row("r1", temperature_c=None, **KNOWN), row("r2", **KNOWN | air)]
    where = tmp_path / "rirs"
    write_rir_dir(where, [(item, coloured_rir(n)) for n, item in enumerate(rows)])
    with pytest.raises(ValueError, match=f"^{where}/rirs.jsonl: RIR r2 of room hall: {message}"):
        usable_rirs([where])


def test_air_of_unusable_rirs_is_not_checked(tmp_path):
    where = directory(tmp_path / "rirs", [row("r", binaural=True, temperature_c=68.0)])
    assert usable_rirs([where]).left_out == [LeftOut(BINAURAL, 1, 1)]


def test_log_warns_once_of_humidity_as_a_fraction(tmp_path, caplog):
    rows = [row(f"r{n}", humidity_pct=humidity_pct, **apart(KNOWN, n)) for n, humidity_pct in enumerate([0.5, 0.4])]
    rows.append(row("r2", "dry", humidity_pct=10.0, **KNOWN))
    where = directory(tmp_path / "rirs", rows)
    assert len(usable_rirs([where]).rirs) == 3
    (text,) = [record.getMessage() for record in caplog.records]
    assert text == (f"{where}/rirs.jsonl: RIR r0 of room hall and 1 more: humidity_pct=0.5 is less than 10, which is "
                    "drier than the air of rooms: give percent if it is a fraction")


def test_id_in_two_directories_is_refused(tmp_path):
    first, second = (directory(tmp_path / name, [row("r", **KNOWN)]) for name in "ab")
    with pytest.raises(ValueError, match=f"RIR r is in both {first} and {second}: give each RIR once"):
        usable_rirs([first, second])


def test_data_holds_the_usable_rirs_and_counts_the_others(tmp_path):
    where = write_rir_dir(tmp_path / "rirs", [(row("r1", **KNOWN), coloured_rir(1)), (row("r2"), coloured_rir(2)),
                                              (row("r3", binaural=True), coloured_rir(3))])
    data = load_data(usable_rirs([where]), scattering=SCATTERING, seed=0)
    assert [row["id"] for row in data.rows] == ["r1"] and data.places[0].drawn == ()
    assert [entry.rirs for entry in data.left_out] == [1, 1]


@pytest.mark.parametrize("n_rooms, enough", [(2, False), (3, True)])
def test_recipe_and_verb_agree_on_rirs_with_unknown_heights(tmp_path, n_rooms, enough):
    where = directory(tmp_path / "rirs", [row(f"r{n}", f"room{n // 2}", **apart(FLAT, n)) for n in range(2 * n_rooms)])
    found, text = enough_rooms(where, tmp_path / "rooms")
    assert found == enough
    if enough:
        require_enough_rooms([where])
        assert text == ""
    else:
        with pytest.raises(ValueError, match=r"needs 3 rooms or conditions .* and has 2: give") as refused:
            require_enough_rooms([where])
        assert text == f"no closed loop: {refused.value}\n"


def test_bare_files_are_refused_by_recipe_and_verb_in_the_same_line(bare, tmp_path, capsys):
    enough, text = enough_rooms(bare, tmp_path / "rooms")
    assert not enough and text == (
        f"no closed loop: {bare}: 10 of 10 RIRs cannot be used (10: the room's dimensions and x and y of source and "
        "microphone are unknown); the closed loop needs 3 rooms or conditions (room_id) with two usable RIRs each, "
        "and has 0: measure what is unknown (heights may stay unknown), or give further rooms\n")
    assert main(["close-loop", str(bare), "--out", str(tmp_path / "loop")]) == 1
    assert capsys.readouterr().err == text.replace("no closed loop: ", "roomeq: ")
    assert not (tmp_path / "loop").exists()


def test_kept_answer_is_used_until_a_recording_changes(tmp_path, monkeypatch, capsys):
    where = directory(tmp_path / "rirs", [row(f"r{n}", f"room{n // 2}", **apart(KNOWN, n)) for n in range(6)])
    out = tmp_path / "rooms"
    for refused in (False, True):
        assert check_rooms([str(where), str(out), "1"]) == 0 and (out / "enough").exists() is not refused
        said = capsys.readouterr().out
        with monkeypatch.context() as patch:
            patch.setattr("roomeq.loop.usable.usable_rirs", None)
            assert check_rooms([str(where), str(out), "1"]) == 0
        assert capsys.readouterr().out == said and said.startswith("no closed loop: ") is refused
        write_wav(where / read_rirs(where)[0]["wav"], coloured_rir([*b"r5"]))  # a copy of another room's recording
    assert "is the recording of RIR" in said


def test_kept_answer_is_made_again_when_a_mesh_is_corrected(tmp_path, capsys):
    placed = KNOWN | dict(room_dims_m=None, mesh="../room.obj")
    where = directory(tmp_path / "rirs", [row(f"r{n}", f"room{n // 2}", **apart(placed, n)) for n in range(6)])
    for top, enough in ((" 1.1\n", False), (" 3\n", True)):
        write_text(tmp_path / "room.obj", BOX.replace(" 3\n", top))
        assert check_rooms([str(where), str(tmp_path / "rooms"), "1"]) == 0, capsys.readouterr().err
        assert (tmp_path / "rooms/enough").exists() is enough, capsys.readouterr().out


@pytest.mark.parametrize("third, left_out", [(3.0, 0), (3.005, 0), (10.62, 4)])
def test_room_whose_rows_state_different_dimensions_is_left_out(tmp_path, third, left_out):
    rows = [row(f"r{n}", f"room{n // 4}", **KNOWN | dict(room_dims_m=[7.62, 6.0, third if n == 2 else 3.0]))
            for n in range(16)]
    usable = usable_rirs([directory(tmp_path / "rirs", rows)])
    assert sum(entry.rirs for entry in usable.left_out) == left_out and len(usable.rirs) == 16 - left_out
    if left_out:
        assert usable.left_out[0].reason == UNLIKE
        assert usable.contradictions[0].startswith("room room0: RIR r0 states room_dims_m=[7.62, 6.0, 3.0], not "
                                                   "[7.62, 6.0, 10.62] of RIR r2: correct the row")


def test_recording_that_cannot_be_read_ends_the_check(tmp_path, capsys):
    where = directory(tmp_path / "rirs", [row(f"r{n}", f"room{n // 2}", **apart(KNOWN, n)) for n in range(6)])
    (where / read_rirs(where)[0]["wav"]).write_text("no audio")
    assert check_rooms([str(where), str(tmp_path / "rooms"), "1"]) == 1
    assert read_rirs(where)[0]["wav"] in capsys.readouterr().err and not (tmp_path / "rooms").exists()


def test_refusal_because_of_labels_names_them_and_says_to_correct_them(tmp_path):
    outside = KNOWN | dict(mic_pos_m=[400.0, 3.0, 1.2])
    where = directory(tmp_path / "rirs", [row(f"r{n}", f"room{n // 2}", **(outside if n < 4 else apart(KNOWN, n)))
                                          for n in range(6)])
    with pytest.raises(ValueError) as refused:
        require_enough_rooms([where])
    assert "and has 1: correct the rows (RIR r0 of room room0: mic_pos_m[0]=400 lies outside the room" in str(
        refused.value)
    assert str(refused.value).endswith("state lengths in metres), or give further rooms")
    assert "measure what is unknown" not in str(refused.value)


def test_reference_microphone_before_a_loudspeaker_is_left_out_and_named(tmp_path, caplog):
    rows = [row("near", **KNOWN | dict(mic_pos_m=[1.03, 1.0, 1.5])), row("far", **KNOWN)]
    usable = usable_rirs([directory(tmp_path / "rirs", rows)])
    assert [rir.row["id"] for rir in usable.rirs] == ["far"] and usable.left_out == [LeftOut(TOO_CLOSE, 1, 1)]
    assert "RIR near of room hall: source and microphone are 0.03 m apart and must be at least 0.05 m" in caplog.text


def test_room_whose_rows_state_dimensions_within_a_centimetre_is_one_room(tmp_path):
    """The position at 6.004 m lies in the dimensions of its own row, and not in those of the others."""
    rows = [row(f"r{n}", **apart(KNOWN, n) | dict(room_dims_m=[dims_m, 5.0, 3.0]))
            for n, dims_m in enumerate([6.0, 6.005])]
    rows[1]["mic_pos_m"] = [6.004, 3.0, 1.2]
    usable = usable_rirs([directory(tmp_path / "rirs", rows)])
    assert [rir.row["room_dims_m"] for rir in usable.rirs] == [[6.005, 5.0, 3.0]] * 2
    data = load_data(usable, scattering=SCATTERING, seed=0)
    assert len({place.room for place in data.places}) == 1
    assert [row["room_dims_m"] for row in data.documented] == [[6.005, 5.0, 3.0]] * 2
    assert [estimate.quantity for estimate in data.estimates].count("height of the room") == 1
