"""Directories that are copied, moved, linked or completed after a step made them."""

import json
import shlex
import shutil
from pathlib import Path

import pytest
from datadirs import rir_dir, speech_dir

from roomeq.augment import augment
from roomeq.core.build import Build
from roomeq.core.digests import digest
from roomeq.corpora.characterise import characterise
from roomeq.export import export
from roomeq.records.rir_dir import mesh_files, read_rirs, write_rirs
from roomeq.validate import check_stamp, validate


@pytest.fixture
def far_field(tmp_path, monkeypatch):
    """Far-field speech whose `wav.scp` names its audio from the current folder, as the recipe's does."""
    rirs = rir_dir(tmp_path / "rirs", simulated=True)
    folder = tmp_path / "recipe"
    folder.mkdir()
    monkeypatch.chdir(folder)
    augment(speech_dir(tmp_path / "clean"), rirs, "rvb")
    return folder / "rvb"


@pytest.mark.parametrize("use", [lambda path: export("nemo", path, path.with_name("out")), check_stamp])
def test_copy_that_names_the_audio_of_the_original_is_refused(far_field, use):
    use(far_field)
    copy = shutil.copytree(far_field, far_field.with_name("rvb.seed0"))
    with pytest.raises(ValueError, match=r"rvb\.seed0: its wav\.scp names audio in rvb, .* go to the folder .* or run "
                                         r"roomeq augment again"):
        use(copy)


def test_refused_directory_is_not_called_valid_before(far_field, capsys):
    validate(["rvb"])
    assert capsys.readouterr().out.endswith("utterances, OK\n")
    shutil.copytree(far_field, far_field.with_name("rvb.seed0"))
    with pytest.raises(ValueError, match="names audio in rvb"):
        validate(["rvb.seed0"])
    assert not capsys.readouterr().out


def test_directory_is_used_from_the_folder_where_it_was_made(far_field, monkeypatch, tmp_path):
    other = tmp_path / "other"
    other.mkdir()
    monkeypatch.chdir(other)
    with pytest.raises(ValueError, match="names audio in rvb"):
        export("nemo", far_field, "out")
    far_field.parent.rename(tmp_path / "moved")
    monkeypatch.chdir(tmp_path / "moved")
    export("nemo", "rvb", "out")


def test_moved_directory_is_made_anew_in_its_place(far_field, tmp_path):
    far_field.rename(far_field.with_name("moved"))
    augment(tmp_path / "clean", tmp_path / "rirs", "moved")
    assert "rvb/" not in far_field.with_name("moved").joinpath("wav.scp").read_text().replace("moved/", "")


def test_table_that_is_added_to_an_input_counts(far_field, tmp_path):
    before = digest(far_field)
    (far_field / "feats.scp").write_text("features of Kaldi\n")
    assert digest(far_field) == before
    table = far_field / "utt2lang"
    table.write_text("".join(f"{line.split()[0]} en\n" for line in (far_field / "utt2spk").read_text().splitlines()))
    assert digest(far_field) != before


@pytest.mark.parametrize("swap", ["folder", "linked folder", "linked files"])
def test_audio_of_another_directory_in_its_place_is_noticed(tmp_path, swap):
    for seed, name in enumerate("ab"):
        export("roomeq", rir_dir(tmp_path / f"rirs {name}", simulated=True, seed=seed), tmp_path / name)
    digest(tmp_path / "a")
    audio, other = tmp_path / "a/rirs", tmp_path / "b/rirs"
    if swap == "linked files":
        for path in audio.iterdir():
            path.unlink()
            path.symlink_to(other / path.name)
    else:
        shutil.rmtree(audio)
        other.rename(audio) if swap == "folder" else audio.symlink_to(other)
    with pytest.raises(ValueError, match="changed since it was made"):
        digest(tmp_path / "a")


def test_buffers_of_a_mesh_are_files_of_it(tmp_path):
    rirs = rir_dir(tmp_path / "rirs", simulated=True)
    rows = [json.loads(line) for line in (rirs / "rirs.jsonl").read_text().splitlines()]
    (rirs / "rirs.jsonl").write_text("".join(json.dumps({**row, "room_dims_m": None, "mesh": "hall.gltf"}) + "\n"
                                             for row in rows))
    (rirs / "hall.gltf").write_text(json.dumps(dict(buffers=[dict(uri="my%20hall.bin"), dict(uri="data:,")])))
    (rirs / "my hall.bin").write_bytes(b"0")
    assert [path.name for path in mesh_files(rirs)] == ["hall.gltf", "my hall.bin"]


def audio_in_rir_list(directory):
    """Return the paths of the audio as Kaldi's reverberate_data_dir.py reads them."""
    return [Path(shlex.split(shlex.split(line)[4])[2]) for line in (directory / "rir_list").read_text().splitlines()]


def test_rirs_may_be_moved_and_kaldi_finds_them_after_the_step(tmp_path):
    def make(out):
        build = Build(out, step="simulate", options={}, inputs=[])
        if not build.done and build.run({}, lambda *_: None):
            build.finish(lambda directory, _: write_rirs(rir_dir(directory), read_rirs(directory), out))

    make(tmp_path / "a")
    before = digest(tmp_path / "a")
    (tmp_path / "a").rename(tmp_path / "b")
    check_stamp(tmp_path / "b")
    make(tmp_path / "b")
    assert digest(tmp_path / "b") == before  # later steps do nothing
    assert all(path.is_file() and path.is_relative_to(tmp_path / "b") for path in audio_in_rir_list(tmp_path / "b"))


def test_rows_of_moved_rirs_name_their_audio_after_the_step(tmp_path):
    rirs, moved = rir_dir(tmp_path / "rirs"), tmp_path / "b/c/real"
    characterise(rirs, tmp_path / "a/real")
    moved.parent.mkdir(parents=True)
    (tmp_path / "a/real").rename(moved)
    with pytest.raises(ValueError, match="run all steps that lead to .*/real again"):
        check_stamp(moved)
    characterise(rirs, moved)
    check_stamp(moved)
