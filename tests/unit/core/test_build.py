"""Output directories are complete or absent, and remade only when something changed."""

import os
import pickle
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from roomeq.core import asking, build
from roomeq.core.audio import write_wav
from roomeq.core.build import DONE_FILE, Build, check_jobs, share
from roomeq.core.digests import Listed, code_digest, digest, names_in_entry
from roomeq.core.files import output_path, path_from, read_json, write_json, write_text


def make_squares(out, inputs=(), numbers=(1, 2, 3), part=None, fail_on=None, **options):
    build = Build(out, step="square", options=options, inputs=list(inputs))
    if build.done:
        return "up to date"

    def make(name, number):
        if number == fail_on:
            raise RuntimeError("killed")
        write_text(build.work / f"{name}.txt", str(number**2))
        return number**2

    if build.run({f"n{n}": n for n in numbers}, make, part=part):
        build.finish(lambda directory, records: write_json(directory / "all.json", records))
    return "made"


def contents(directory):
    return {p.name: p.read_bytes() for p in sorted(directory.iterdir()) if p.name != DONE_FILE}


def test_changed_option_remakes_the_directory(tmp_path):
    assert make_squares(tmp_path / "a", power=2) == "made"
    assert make_squares(tmp_path / "a", power=2) == "up to date"
    assert make_squares(tmp_path / "a", power=3) == "made"


def test_numbers_of_numpy_are_options_like_others(tmp_path):
    assert make_squares(tmp_path / "a", power=np.int64(2), scale=np.float32(0.5)) == "made"
    assert make_squares(tmp_path / "a", power=2, scale=0.5) == "up to date"


def test_parts_give_the_same_bytes_as_one_run(tmp_path):
    make_squares(tmp_path / "whole")
    for job in (2, 1):
        make_squares(tmp_path / "parts", part=f"{job}/2")
        assert not (tmp_path / "parts").exists()
    make_squares(tmp_path / "parts")
    assert contents(tmp_path / "whole") == contents(tmp_path / "parts")


def test_killed_run_keeps_the_earlier_result_and_resumes(tmp_path):
    out = tmp_path / "a"
    make_squares(out, version=1)
    before = contents(out)
    with pytest.raises(RuntimeError):
        make_squares(out, version=2, fail_on=2)
    assert contents(out) == before
    make_squares(out, version=2)
    assert sorted(contents(out)) == ["all.json", "n1.txt", "n2.txt", "n3.txt"]
    assert [p.name for p in tmp_path.iterdir() if "part" in p.name] == []


def test_temporary_files_of_a_killed_job_are_removed(tmp_path):
    with pytest.raises(RuntimeError):
        make_squares(tmp_path / "a", fail_on=2)
    (work,) = tmp_path.glob(".a.part-*")
    (work / ".n2.txt.123.tmp").write_text("ha")
    make_squares(tmp_path / "a")
    assert [path.name for path in (tmp_path / "a").iterdir() if path.name.endswith(".tmp")] == []


def test_directory_with_a_damaged_file_is_not_put_in_place(tmp_path):
    with pytest.raises(RuntimeError):
        make_squares(tmp_path / "a", fail_on=3)

    def damaging(name, number):
        write_text(build.work / f"{name}.txt", str(number**2))
        (build.work / "n2.txt").write_text("5")
        return number**2

    build = Build(tmp_path / "a", step="square", options={}, inputs=[])
    assert build.run({f"n{n}": n for n in (1, 2, 3)}, damaging)
    with pytest.raises(ValueError, match=r"n2.txt: is not as it was written: .* start this run again"):
        build.finish(lambda directory, records: write_json(directory / "all.json", records))
    assert not (tmp_path / "a").exists()
    make_squares(tmp_path / "a")
    assert (tmp_path / "a" / "n2.txt").read_text() == "4"


def test_missing_file_remakes_the_directory(tmp_path):
    make_squares(tmp_path / "a")
    (tmp_path / "a" / "n2.txt").unlink()
    assert make_squares(tmp_path / "a") == "made"
    assert (tmp_path / "a" / "n2.txt").read_text() == "4"


def test_changed_content_remakes_the_directory(tmp_path):
    make_squares(tmp_path / "a")
    (tmp_path / "a" / "n2.txt").write_text("4")
    assert make_squares(tmp_path / "a") == "up to date"
    (tmp_path / "a" / "n2.txt").write_text("5")
    assert make_squares(tmp_path / "a") == "made"
    assert (tmp_path / "a" / "n2.txt").read_text() == "4"


def test_edit_before_a_change_of_permissions_or_a_move_to_another_disk_is_noticed(tmp_path):
    make_squares(tmp_path / "a")
    (tmp_path / "a/n2.txt").write_text("5")
    time.sleep(0.02)
    (tmp_path / "a" / DONE_FILE).chmod(0o600)  # as chmod -R, and as what copies files with their times
    with pytest.raises(ValueError, match=r"a/n2\.txt: changed since it was made"):
        digest(tmp_path / "a")
    assert make_squares(tmp_path / "a") == "made"
    assert (tmp_path / "a/n2.txt").read_text() == "4"


def test_file_is_read_where_the_stamp_is_of_the_future(tmp_path, monkeypatch):
    make_squares(tmp_path / "a")
    stamp = tmp_path / "a" / DONE_FILE
    (tmp_path / "a/n2.txt").write_text("5")
    time.sleep(0.02)
    stamp.write_bytes(stamp.read_bytes())  # the edit seems older, as after the clock was set back
    monkeypatch.setattr("roomeq.core.stamps.time.time_ns", lambda: stamp.stat().st_ctime_ns - 10 ** 9)
    with pytest.raises(ValueError, match=r"a/n2\.txt: changed since it was made"):
        digest(tmp_path / "a")
    assert make_squares(tmp_path / "a") == "made"
    assert (tmp_path / "a/n2.txt").read_text() == "4"


def test_asking_makes_nothing_and_says_whether_the_output_is_up_to_date(tmp_path, monkeypatch):
    monkeypatch.setattr(asking, "_asked", True)
    with pytest.raises(asking.NotUpToDate):
        make_squares(tmp_path / "a")
    assert not list(tmp_path.iterdir())
    asking.only_ask(False)
    make_squares(tmp_path / "a")
    asking.only_ask(True)
    assert make_squares(tmp_path / "a") == "up to date"
    with pytest.raises(asking.NotUpToDate):
        make_squares(tmp_path / "a", v=2)
    assert (tmp_path / "a/n2.txt").read_text() == "4"


def test_changed_input_remakes_the_output(tmp_path):
    make_squares(tmp_path / "in")
    make_squares(tmp_path / "out", inputs=[tmp_path / "in"])
    assert make_squares(tmp_path / "out", inputs=[tmp_path / "in"]) == "up to date"
    (tmp_path / "in" / DONE_FILE).unlink()
    assert make_squares(tmp_path / "out", inputs=[tmp_path / "in"]) == "up to date"
    (tmp_path / "in" / "n1.txt").write_text("7")
    assert make_squares(tmp_path / "out", inputs=[tmp_path / "in"]) == "made"


def overwrite(path):
    path.write_text("7")


def overwrite_and_restore(path):
    before = path.read_bytes()
    path.write_text("7")
    path.write_bytes(before)


@pytest.mark.parametrize("given", ["of a step", "of nobody", "listed", "file"])
@pytest.mark.parametrize("write", [overwrite, overwrite_and_restore, Path.unlink])
def test_input_that_is_written_to_meanwhile_is_refused(tmp_path, given, write):
    make_squares(tmp_path / "in")
    path = tmp_path / "in/n1.txt"
    if given != "of a step":
        (tmp_path / "in" / DONE_FILE).unlink()
    paths = {"listed": Listed((path,)), "file": path}
    inputs = [paths.get(given, tmp_path / "in")]
    make_squares(tmp_path / "out", inputs=inputs, v=1)
    build = Build(tmp_path / "out", step="square", options=dict(v=2), inputs=inputs)
    build.run({"n1": 1}, lambda name, number: write(path))
    with pytest.raises(ValueError, match=r"out: an input changed while it was made: .*in/n1\.txt: .*; run this again"):
        build.finish(lambda directory, records: None)
    assert not build.work.exists()
    path.write_text("1")
    assert make_squares(tmp_path / "out", inputs=inputs, v=1) == "up to date"


def test_file_that_comes_into_an_input_meanwhile_is_not_of_it(tmp_path):
    """As a log, or the first of several outputs in a folder that no step made."""
    make_squares(tmp_path / "in")
    (tmp_path / "in" / DONE_FILE).unlink()
    build = Build(tmp_path / "out", step="square", options={}, inputs=[tmp_path / "in"])
    build.run({"n1": 1}, lambda name, number: (tmp_path / "in/step.log").write_text("."))
    build.finish(lambda directory, records: None)
    assert build.out.is_dir()


def test_items_of_a_part_of_an_input_that_changed_are_made_again(tmp_path):
    path = tmp_path / "in.txt"
    path.write_text("1")
    build = Build(tmp_path / "out", step="copy", options={}, inputs=[path])

    def make_late(name, number):
        path.write_text("2")
        return path.read_text()

    with pytest.raises(ValueError, match=r"in\.txt: was written to meanwhile; run this again"):
        build.run({"a": 1}, make_late, part="1/1")
    path.write_text("1")
    build = Build(tmp_path / "out", step="copy", options={}, inputs=[path])
    assert build.run({"a": 1}, lambda name, number: path.read_text())
    build.finish(lambda directory, records: write_json(directory / "all.json", records))
    assert read_json(tmp_path / "out/all.json") == ["1"]


def test_worker_gets_no_list_of_input_files(tmp_path):
    paths = [tmp_path / f"{n}.txt" for n in range(2000)]
    build = Build(tmp_path / "out", step="square", options={}, inputs=[Listed(tuple(paths))])
    assert len(pickle.dumps(build)) < 2000


@pytest.mark.parametrize("what, happened", [("in", "changed"), ("in", "missing"), ("in/n1.txt", "changed")])
def test_input_that_is_not_as_it_was_made_is_refused(what, happened, tmp_path):
    make_squares(tmp_path / "in")
    path = tmp_path / "in/n1.txt"
    if happened == "changed":
        path.write_text("7")
        os.utime(path, ns=(0, 0))
    else:
        path.unlink()
    with pytest.raises(ValueError, match=rf"in/n1.txt: {happened} since it was made: run roomeq square again, or "
                                         rf"remove .*in/{DONE_FILE} to use .*in as it is"):
        make_squares(tmp_path / "out", inputs=[tmp_path / what])
    assert make_squares(tmp_path / "in") == "made"
    assert make_squares(tmp_path / "out", inputs=[tmp_path / what]) == "made"


def make_links(out, to):
    build = Build(out, step="link", options={}, inputs=[])
    if build.run({"a": to}, lambda name, target: os.symlink(target, build.work / name)):
        build.finish(lambda directory, records: None)


def test_changed_file_behind_a_link_is_noticed(tmp_path):
    audio, folder = tmp_path / "audio.wav", tmp_path / "folder"
    audio.write_text("1")
    folder.mkdir()
    (folder / "b.wav").write_text("1")
    for target, file in ((audio, audio), (folder, folder / "b.wav")):
        make_links(tmp_path / "links", target)
        unchanged = digest(tmp_path / "links")
        assert digest(tmp_path / "links") == unchanged
        file.write_text("2")
        os.utime(file, ns=(0, 0))
        with pytest.raises(ValueError, match=r"links/a\S*: changed since it was made: run roomeq link again"):
            digest(tmp_path / "links")
        shutil.rmtree(tmp_path / "links")


def test_listed_audio_that_is_not_as_it_was_made_is_refused(tmp_path):
    make_squares(tmp_path / "corpus/folder")
    (tmp_path / "corpus/.done").write_text("of another program")
    listed = Listed(tuple(tmp_path / f"corpus/folder/n{n}.txt" for n in (1, 2)))
    before = digest(listed)
    assert digest(listed) == before
    listed.files[1].write_text("7")
    with pytest.raises(ValueError, match="folder/n2.txt: changed since it was made: run roomeq square again"):
        digest(listed)
    (tmp_path / "corpus/folder" / DONE_FILE).unlink()
    assert digest(listed) != before


def test_listed_audio_is_hashed_alike_wherever_its_folder_lies(tmp_path):
    for place in ("a", "b"):
        (tmp_path / place / "folder").mkdir(parents=True)
        (tmp_path / place / "folder/x.wav").write_text("1")
    listed = [tmp_path / place / "folder/x.wav" for place in ("a", "b")]
    here, there = (digest(Listed((path,), root=tmp_path / place)) for path, place in zip(listed, "ab", strict=True))
    assert here == there and digest(Listed((listed[0],))) != digest(Listed((listed[1],)))


@pytest.mark.parametrize("name", [".audio/u1.wav", "audio/.u1.wav", "audio/u1.wav"])
@pytest.mark.parametrize("table, line", [("wav.scp", "u1 {}"), ("rirs.jsonl", '{{"wav": "{}"}}')])
def test_hidden_audio_of_an_input_is_in_its_digest(tmp_path, name, table, line):
    write_text(tmp_path / "in" / table, line.format(tmp_path / "in" / name) + "\n")
    write_text(tmp_path / "in" / name, "1")
    before = digest(tmp_path / "in")
    assert digest(tmp_path / "in") == before
    write_text(tmp_path / "in" / name, "2")
    assert digest(tmp_path / "in") != before


@pytest.mark.parametrize("entry", [
    "{}", "flac -c -d -s {}|", "cat {}|", "cat '{}'|", "bash -c 'flac -cds {}' |", "(flac -cds {}) |", "(cat '{}')|",
    "{{ cat {};}}|", "cat <{}|", "cat $(ls {})|", "cat {}|sox -t wav - -t wav -|", "cat {}&&true|", "dd if={}|",
    """bash -c "cat '{}'"|""", "{}:12", "wav-copy ark,t:{} - |", "wav-copy scp:{} - |", "wav-copy 'scp,s,cs:{}' - |",
    "wav-reverberate --additive-signals='/x/b.wav,{}' a - |", "wav-reverberate --additive-signals={},b.wav a - |",
    "wav-reverberate --additive-signals='cat /x/b.wav |, {}' a - |", "wav-copy {}:12 -|"])
@pytest.mark.parametrize("name", ["a.flac", "a=b{1}.flac"])
def test_audio_that_a_command_reads_is_in_the_digest(tmp_path, entry, name):
    path = tmp_path / "elsewhere" / name
    write_text(path, "1")
    write_text(tmp_path / "in/wav.scp", f"u1 {entry.format(path)}\n")
    before = digest(tmp_path / "in")
    assert digest(tmp_path / "in") == before
    write_text(path, "2")
    assert digest(tmp_path / "in") != before


@pytest.mark.parametrize("entry", ["cd wav && cat a.wav |", "cat wav/a.w* |", "F=a.wav; cat wav/$F |", "cat `ls` |",
                                   "wav-copy scp:list.scp - |", "wav-copy 'scp,p:list.scp' - |"])
def test_command_whose_files_cannot_be_told_is_warned_of(tmp_path, entry, caplog):
    write_text(tmp_path / "in/wav.scp", f"u1 {entry}\nu2 flac -cds cd/$a*.flac\nu3 sox a/scp:a.wav -t wav - |\n")
    digest(tmp_path / "in")
    assert "in/wav.scp: 1 commands may read files that they name with cd, $, `, a pattern or a list (" in caplog.text
    assert entry in caplog.text


@pytest.mark.parametrize("entry, name", [
    ("cat /x/a\\ b.flac|", "/x/a b.flac"),
    ("(cat '/x/a b.flac')|", "/x/a b.flac"),
    ("""bash -c "cat '/x/a b.flac' | sox - -" |""", "/x/a b.flac"),
    ("cat '/x/a(b).flac'|", "/x/a(b).flac"),
    ("/x/a(b).ark:55", "/x/a(b).ark"),
    ("cat /x/it's.flac|", "/x/it's.flac"),
])
def test_names_in_an_entry(entry, name):
    assert name in names_in_entry(entry)


def test_damaged_stamp_is_refused(tmp_path):
    make_squares(tmp_path / "in", numbers=(1, 2))
    content = (tmp_path / "in" / DONE_FILE).read_text()
    for old, new in (('"square"', '"squire"'), ('"refers": false', '"refers": true'), ('"n1.txt"', '"n7.txt"')):
        (tmp_path / "in" / DONE_FILE).write_text(content.replace(old, new, 1))
        with pytest.raises(ValueError, match=rf"in/{DONE_FILE}: is damaged: remove .*in and make it again"):
            make_squares(tmp_path / "out", inputs=[tmp_path / "in"])


@pytest.mark.parametrize("content", ["", '{"step": "squ', "\0\0\0"])
def test_output_with_a_damaged_stamp_is_to_be_removed(content, tmp_path):
    make_squares(tmp_path / "out")
    (tmp_path / "out" / DONE_FILE).write_text(content)
    with pytest.raises(ValueError, match=rf"out/{DONE_FILE}: is damaged: remove .*out and make it again"):
        make_squares(tmp_path / "out")


def test_files_beside_those_of_an_input_may_come_and_go(tmp_path):
    make_squares(tmp_path / "in")
    first = digest(tmp_path / "in")
    (tmp_path / "in/feats.scp").write_text("of Kaldi")
    assert digest(tmp_path / "in") == first
    (tmp_path / "in/utt2dur").write_text("u1 3.5\n")  # which is read where it is
    assert digest(tmp_path / "in") != first


def test_row_that_nests_too_deep_is_left_to_the_reader_of_the_table(tmp_path):
    write_text(tmp_path / "in/rirs.jsonl", "[" * 100000 + "\n")
    assert len(digest(tmp_path / "in")) == 64


@pytest.mark.parametrize("wav", ["noise/hum.flac", "noise/../noise/hum.flac", "../elsewhere/hum.flac", ".hum.flac"])
def test_audio_of_a_table_beside_the_files_of_an_input_is_in_its_digest(tmp_path, wav):
    make_squares(tmp_path / "in")
    write_text(tmp_path / "in/noise/hum.flac", "of somebody")
    first = digest(tmp_path / "in")
    write_text(tmp_path / "in/noises.jsonl", f'{{"id": "hum", "wav": "{wav}"}}\n{{"id": "n1", "wav": "n1.txt"}}\n')
    digests = {first, digest(tmp_path / "in")}
    for content in ("1", "2"):
        write_text(tmp_path / "in" / wav, content)
        digests.add(digest(tmp_path / "in"))
        assert digest(tmp_path / "in") in digests
    assert len(digests) == 4


def test_audio_of_another_step_in_a_table_beside_files_is_to_be_as_it_was_made(tmp_path):
    for name in ("in", "other"):
        make_squares(tmp_path / name)
    write_text(tmp_path / "in/noises.jsonl", '{"wav": "../other/n1.txt"}\n')
    digest(tmp_path / "in")
    (tmp_path / "other/n1.txt").write_text("7")
    with pytest.raises(ValueError, match="other/n1.txt: changed since it was made: run roomeq square again"):
        digest(tmp_path / "in")


@pytest.mark.parametrize("changed_file", ["effects/base.py", "sim/materials.toml", "report/templates/page.html.j2"])
def test_changed_code_or_package_data_remakes_the_directory(tmp_path, project_dir, monkeypatch, changed_file):
    package = shutil.copytree(project_dir / "pysrc/roomeq", tmp_path / "pysrc/roomeq")
    code = "from roomeq.core.digests import code_digest; print(code_digest(), end='')"

    def digest_of_copy():
        return subprocess.run([sys.executable, "-c", code], env=os.environ | dict(PYTHONPATH=str(tmp_path / "pysrc")),
                              stdout=subprocess.PIPE, text=True, check=True).stdout

    assert digest_of_copy() == code_digest()
    assert make_squares(tmp_path / "a") == "made"
    (package / "core/__pycache__").mkdir(exist_ok=True)
    (package / "core/__pycache__/other.pyc").write_text("machine code is no source")
    assert digest_of_copy() == code_digest()
    with (package / changed_file).open("a") as source:
        source.write("# changed\n")
    changed = digest_of_copy()
    assert changed != code_digest()
    for name in ("code_digest", "code_digest_now"):
        monkeypatch.setattr(build, name, lambda: changed)
    assert make_squares(tmp_path / "a") == "made"


@pytest.mark.parametrize("when", ["inputs are hashed", "items are made", "files are put together"])
def test_output_of_code_that_changes_meanwhile_is_refused(tmp_path, monkeypatch, when):
    def change(now):
        if when == now:
            monkeypatch.setattr("roomeq.core.digests.source_digest", lambda *_: "other sources")

    make_squares(tmp_path / "a", power=2)
    build = Build(tmp_path / "a", step="square", options=dict(power=3), inputs=[])
    change("inputs are hashed")
    with pytest.raises(ValueError, match="a: the code of roomeq changed while it ran: start again"):
        build.run({"n1": 1}, lambda name, number: change("items are made"))
        build.finish(lambda directory, records: change("files are put together"))
    monkeypatch.undo()
    assert not build.work.exists()
    assert make_squares(tmp_path / "a", power=2) == "up to date"


def test_verb_takes_the_hash_of_the_code_before_it_loads_it(tmp_path, project_dir):
    package = shutil.copytree(project_dir / "pysrc/roomeq", tmp_path / "pysrc/roomeq")
    change = f"open({str(package / 'update.txt')!r}, 'w').close()\n"
    (package / "corpora/__init__.py").write_text(change + (package / "corpora/__init__.py").read_text())
    write_wav(tmp_path / "noises/hum.wav", np.linspace(-0.5, 0.5, 1600))

    def read_noises():
        return subprocess.run([sys.executable, "-m", "roomeq", "read-noises", tmp_path / "noises", tmp_path / "out"],
                              env=os.environ | dict(PYTHONPATH=str(tmp_path / "pysrc")), stderr=subprocess.PIPE,
                              text=True).stderr.splitlines()[-1]

    assert read_noises() == f"roomeq: {tmp_path}/out: the code of roomeq changed while it ran: start again"
    assert "hum" not in read_noises() and (tmp_path / "out/.done").is_file()
    assert read_noises() == f"{tmp_path}/out: up to date"


@pytest.mark.parametrize("package", ["espeakng_loader", "llvmlite", "numba"])
def test_another_version_of_a_library_changes_the_code_digest(package, tmp_path, monkeypatch):
    before = code_digest()
    (tmp_path / f"{package}-0.0.1.dist-info").mkdir()
    monkeypatch.syspath_prepend(tmp_path)
    code_digest.cache_clear()
    after = code_digest()
    code_digest.cache_clear()
    assert after != before


def test_input_remade_with_equal_content_has_equal_digest(tmp_path):
    make_squares(tmp_path / "in", v=1)
    first = digest(tmp_path / "in")
    make_squares(tmp_path / "in", v=2)
    assert digest(tmp_path / "in") == first


def as_of_format(directory, version):
    """Give the stamp of a directory another version of the formats; version 1 had no key for it."""
    stamp = read_json(directory / DONE_FILE) | dict(format=version)
    unknown = ("format", "check", "audio") if version == 1 else ()
    write_json(directory / DONE_FILE, {key: value for key, value in stamp.items() if key not in unknown})


@pytest.mark.parametrize("version, age", [(1, "an older"), (3, "a newer")])
def test_input_of_another_format_is_refused(version, age, tmp_path):
    make_squares(tmp_path / "in")
    as_of_format(tmp_path / "in", version)
    with pytest.raises(ValueError, match=rf"in: was written by {age} roomeq \(format {version}, not 2\): run roomeq "
                                         "square again"):
        make_squares(tmp_path / "out", inputs=[tmp_path / "in"])


def test_output_of_an_older_format_is_made_anew(tmp_path):
    make_squares(tmp_path / "a", power=2)
    as_of_format(tmp_path / "a", 1)
    assert make_squares(tmp_path / "a", power=3) == "made"
    assert make_squares(tmp_path / "b", inputs=[tmp_path / "a"]) == "made"


def test_output_behind_a_link_and_dots_is_made_where_the_system_finds_it(tmp_path):
    (tmp_path / "disk/sub").mkdir(parents=True)
    (tmp_path / "link").symlink_to("disk/sub")
    for _ in range(2):
        make_squares(f"{tmp_path}/link/../out")
    assert (tmp_path / "disk/out/n1.txt").is_file() and not (tmp_path / "out").exists()
    assert path_from(tmp_path / "disk/x.wav", Path(f"{tmp_path}/link/../out")) == "../x.wav"
    assert output_path("a/../b") == Path("b") and output_path("../b") == Path("../b")


@pytest.mark.skipif("not os.path.ismount('/proc')", reason="needs a mount point")
def test_mount_point_is_refused_as_output():
    with pytest.raises(ValueError, match="/proc: is a mount point, which cannot be replaced: give a directory in it"):
        make_squares(Path("/proc"))


def test_directory_without_a_stamp_is_not_replaced(tmp_path):
    (tmp_path / "thesis.txt").write_text("ten years")
    with pytest.raises(ValueError, match="was not made by roomeq"):
        make_squares(tmp_path)
    assert (tmp_path / "thesis.txt").read_text() == "ten years"


@pytest.mark.parametrize("nj", [1.5, "2", True, None])
def test_number_of_jobs_that_is_not_whole_is_refused(nj):
    with pytest.raises(ValueError, match=rf"nj={nj!r} must be a whole number"):
        check_jobs(nj)


@pytest.mark.parametrize("part", ["0/2", "3/2", "x", "1", (1, 2)])
def test_malformed_part_is_refused(part):
    with pytest.raises(ValueError, match="JOB/JOBS"):
        share(["a"], part)
