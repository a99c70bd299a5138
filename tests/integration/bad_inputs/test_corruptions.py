"""`roomeq validate` finds every one of 30 seeded corruptions of a directory of each kind, with a stamp and without."""

import json
import shutil

import numpy as np
import pytest
from loop_run import make_loop
from running import call
from wrong import audio, patch, remove, reorder

from roomeq.core.rng import rng_for

MADE = {  # a directory of each kind that `validate` knows, by the command that makes it
    "rirs": ["compensate", "measured", "eq"],
    "rirs that refer to audio": ["characterise", "measured"],
    "speech": ["augment", "speech", "rirs"],
    "loop": [],
}


@pytest.fixture(scope="module", params=list(MADE))
def made(request, worlds, tmp_path_factory):
    """A directory that a verb made, right as it is."""
    root = tmp_path_factory.mktemp("made")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(worlds)
        out = root / "made"
        if request.param == "loop":
            make_loop(out)
        else:
            assert call([*MADE[request.param], str(out)])[0] == 0
    assert call(["validate", str(out)]) == (0, "")
    return out


def flip(rng, data):
    at = int(rng.integers(len(data)))
    return data[:at] + bytes([data[at] ^ (1 << int(rng.integers(8)))]) + data[at + 1:]


def cut(rng, data):
    return data[:int(rng.integers(len(data)))]


def more(rng, data):
    return data + rng.bytes(1 + int(rng.integers(50)))


def zero(rng, data):
    start = int(rng.integers(len(data) - len(data) // 3))
    return data[:start] + bytes(len(data) // 3) + data[start + len(data) // 3:]


def lose_a_piece(rng, data):
    start = int(rng.integers(len(data) - 1))
    return data[:start] + data[start + 1 + int(rng.integers(len(data) - start - 1)):]


def twice(rng, data):
    return data + data


WAYS = (flip, cut, more, zero, lose_a_piece, twice)


@pytest.mark.parametrize("seed", range(30))
def test_a_corrupted_file_is_found(seed, made, worlds, tmp_path, monkeypatch):
    monkeypatch.chdir(worlds)
    rng = rng_for(seed, "corruption", made.parent.name.rstrip("0123456789"))
    copy = shutil.copytree(made, made.with_name("copy"), dirs_exist_ok=False)
    try:
        files = sorted(path for path in copy.rglob("*") if path.is_file() and path.name != ".done")
        path = files[rng.integers(len(files))]
        before = path.read_bytes()
        way = WAYS[rng.integers(len(WAYS))] if rng.random() < 0.9 else None
        changed = None if way is None else way(rng, before)
        if changed is None:
            path.unlink()
        else:
            path.write_bytes(changed)
        assert changed != before
        status, said = call(["validate", str(copy)])
        assert status == 1, f"{path.name}: {way and way.__name__} was not found"
        assert said.count("\n") == 1 and str(copy) in said and "internal error" not in said
    finally:
        shutil.rmtree(copy)


def rows(change):
    """Edit the parsed rows of `rirs.jsonl`."""
    def edit(rng, root):
        def changed(lines):
            return list(map(json.dumps, change(rng, list(map(json.loads, lines)))))

        reorder("rirs/rirs.jsonl", changed)(root)
    return edit


def one_row(change):
    def edit(rng, found):
        change(rng, found[rng.integers(len(found))])
        return found
    return rows(edit)


def without_a_key(rng, row):
    row.pop(rng.choice(["id", "wav", "room_id", "source_id", "mic_id"]))


def with_a_wrong_value(rng, row):
    row[rng.choice([key for key in row if row[key] is not None])] = {"not": "this"}


def with_another_length(rng, row):
    row["n_samples"] += int(rng.integers(1, 99))


def with_lost_audio(rng, row):
    row["wav"] = row["wav"] + "x"


def for_nobody(rng, row):
    row["noise_for"] = "nobody"


def swapped(rng, found):
    n = int(rng.integers(len(found) - 1))
    return [*found[:n], found[n + 1], found[n], *found[n + 2:]]


def repeated(rng, found):
    n = int(rng.integers(len(found)))
    return [*found[:n], found[n], *found[n:]]


def on_audio(samples, **how):
    def edit(rng, root):
        audio(f"rirs/wav/room{rng.integers(2)}-{rng.integers(3)}.wav", samples, subtype="FLOAT", **how)(root)
    return edit


def cut_audio(rng, root):
    path = root / f"rirs/wav/room{rng.integers(2)}-{rng.integers(3)}.wav"
    path.write_bytes(path.read_bytes()[:int(rng.integers(path.stat().st_size - 2))])


def lost_noise(rng, root):
    remove("rirs/wav/tap.flac")(root)


def silent_noise(rng, root):
    audio("rirs/wav/tap.flac", np.zeros(4800))(root)


def short_noise(rng, root):
    audio("rirs/wav/tap.flac", 3000)(root)


BREAKS = (one_row(without_a_key), one_row(with_a_wrong_value), one_row(with_another_length), one_row(with_lost_audio),
          one_row(for_nobody), rows(swapped), rows(repeated), on_audio(np.zeros(4000)), on_audio(np.full(4000, np.nan)),
          on_audio(4001), on_audio(4000, fs_hz=48000), on_audio(np.ones((4000, 2))), cut_audio, lost_noise,
          silent_noise, short_noise)


@pytest.mark.parametrize("seed", range(32))
def test_a_broken_contract_is_found_without_a_stamp(seed, worlds, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(worlds / "rirs", tmp_path / "rirs")
    assert call(["validate", "rirs"]) == (0, "")
    BREAKS[seed % len(BREAKS)](rng_for(seed, "break", "rirs"), tmp_path)
    status, said = call(["validate", "rirs"])
    assert status == 1 and said.startswith("roomeq: rirs") and said.count("\n") == 1 and "internal error" not in said


def in_table(names, change):
    """Edit the lines of one of some tables of a data directory."""
    def edit(rng, root):
        name = names[rng.integers(len(names))]
        reorder(f"segmented/{name}", lambda lines: change(rng, lines))(root)
    return edit


def less(rng, lines):
    n = rng.integers(len(lines))
    return [*lines[:n], *lines[n + 1:]]


def again(rng, lines):
    n = rng.integers(len(lines))
    return [*lines[:n + 1], *lines[n:]]


def of_a_stranger(rng, lines):
    return [*lines[:-1], "zz" + lines[-1]]


def without_a_value(rng, lines):
    n = rng.integers(len(lines))
    return [line.split()[0] if n == k else line for k, line in enumerate(lines)]


def with_other_numbers(rng, lines):
    n = rng.integers(len(lines))
    key, *words = lines[n].split()
    return [*lines[:n], " ".join([key, *words[:-1], str(float(words[-1]) + rng.uniform(0.1, 99))]), *lines[n + 1:]]


def backwards(rng, lines):
    return lines[::-1]


def of_other_bytes(rng, root):
    name = rng.choice(["text", "utt2spk", "segments"])
    patch(f"segmented/{name}", int(rng.integers(8)), b"\xff")(root)


def without_a_table(rng, root):
    remove(f"segmented/{rng.choice(['utt2spk', 'spk2utt'])}")(root)


def cut_flac(rng, root):
    path = root / "segmented/r.flac"
    path.write_bytes(path.read_bytes()[:int(rng.uniform(0, 0.95) * path.stat().st_size)])


def on_flac(samples, **how):
    return lambda rng, root: audio("segmented/r.flac", samples, **how)(root)


DATA_BREAKS = (
    in_table(["text", "utt2spk", "segments", "utt2dur", "wav.scp", "spk2utt"], less),
    in_table(["text", "utt2spk", "segments", "utt2dur", "wav.scp", "spk2utt"], again),
    in_table(["text", "utt2spk", "segments", "utt2dur"], backwards),
    in_table(["text", "utt2spk", "segments", "utt2dur", "reco2dur", "spk2utt"], of_a_stranger),
    in_table(["utt2spk", "segments", "utt2dur", "reco2dur", "wav.scp", "spk2utt"], without_a_value),
    in_table(["segments", "utt2dur", "reco2dur"], with_other_numbers), of_other_bytes, without_a_table, cut_flac,
    lambda rng, root: remove("segmented/r.flac")(root), on_flac(40000), on_flac(np.ones((48000, 2))))


@pytest.mark.parametrize("seed", range(36))
def test_a_broken_data_directory_is_found_without_a_stamp(seed, worlds, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(worlds / "segmented", tmp_path / "segmented")
    assert call(["validate", "segmented"]) == (0, "")
    DATA_BREAKS[seed % len(DATA_BREAKS)](rng_for(seed, "break", "data"), tmp_path)
    status, said = call(["validate", "segmented"])
    assert status == 1 and said.startswith("roomeq: segmented") and said.count("\n") == 1
    assert "internal error" not in said


def ledger(change):
    """Edit the parsed ledger."""
    def edit(rng, root):
        path = root / "loop/ledger.json"
        content = json.loads(path.read_text())
        change(rng, content)
        path.write_text(json.dumps(content))
    return edit


def without_a_part(rng, content):
    place = [content, content["baseline"]["leave_room_out"], content["iterations"][0],
             content["iterations"][0]["ranking"][1], content["unexplained_all"][0],
             content["test"]["after"]][rng.integers(6)]
    place.pop(rng.choice([key for key in place if key not in ("test", "cannot_tell", "would_tell")]))


def with_a_wrong_error(rng, content):
    entry = content[rng.choice(["baseline", "final"])][rng.choice(["leave_positions_out", "leave_room_out"])]
    entry[rng.choice(["error", "ci", "by_metric", "by_band"])] = [[], "3", -1.0, 99.0, {"gnomes": 1.0}][
        rng.integers(5)]


def of_another_effect(rng, content):
    content["iterations"][rng.integers(2)]["effect"] = rng.choice(["gnomes", "noise_floor"])


def in_another_order(rng, content):
    content["iterations"].reverse()


def of_other_rirs(rng, content):
    content["rirs"] += int(rng.integers(1, 9))


def of_other_units(rng, content):
    content["iterations"][rng.integers(2)]["parameters"]["nowhere"] = {"best": {}}


def elsewhere(rng, content):
    where = content["unexplained_all"][0]
    where[rng.choice(["metric", "time_region", "varies_with", "bands_hz"])] = "gnomes"


def told_twice(rng, content):
    content["iterations"].append(content["iterations"][0])


def cut_residuals(rng, root):
    path = root / "loop" / rng.choice(["residuals.npz", "examples.npz"])
    path.write_bytes(path.read_bytes()[:int(rng.uniform(0, 0.95) * path.stat().st_size)])


def lost_file(rng, root):
    remove(f"loop/{rng.choice(['model.json', 'residuals.npz'])}")(root)


def other_model(rng, root):
    path = root / "loop/model.json"
    content = json.loads(path.read_text())
    if rng.random() < 0.5:
        content["effects"].pop()
    else:
        content["effects"][0]["of"]["hall"] = {"depth_m": None}
    path.write_text(json.dumps(content))


LOOP_BREAKS = (*map(ledger, (without_a_part, with_a_wrong_error, of_another_effect, in_another_order, of_other_rirs,
                             of_other_units, elsewhere, told_twice)), cut_residuals, lost_file, other_model)


@pytest.mark.parametrize("seed", range(44))
def test_a_broken_ledger_is_found_without_a_stamp(seed, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    make_loop(tmp_path / "loop")
    (tmp_path / "loop/.done").unlink()
    assert call(["validate", "loop"]) == (0, "")
    LOOP_BREAKS[seed % len(LOOP_BREAKS)](rng_for(seed, "break", "loop"), tmp_path)
    status, said = call(["validate", "loop"])
    assert status == 1 and said.startswith("roomeq: loop") and said.count("\n") == 1 and "internal error" not in said
