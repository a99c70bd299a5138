"""The dictionary of a text: the format of stock Kaldi, with pronunciations of eSpeak NG."""

import re
import subprocess
import sys
from pathlib import Path

import pytest

import make_dict

LOCAL = Path(__file__).parents[3] / "local"

TEXT = "a-1 THE QUICK BROWN FOX <UNK>\na-2 LIGHT NIGHT RIGHT FOX\n"


def run(*args):
    command = [sys.executable, str(LOCAL / "make_dict.py"), *map(str, args)]
    return subprocess.run(command, capture_output=True, text=True, check=False)


def lines(path):
    return path.read_text().splitlines()


@pytest.fixture(scope="module")
def dictionary(tmp_path_factory):
    where = tmp_path_factory.mktemp("dict")
    (where / "text").write_text(TEXT)
    assert run(where / "text", where / "dict").returncode == 0
    return where / "dict"


def test_lexicon_holds_each_word_once(dictionary):
    entries = [line.split(" ", 1) for line in lines(dictionary / "lexicon.txt")]
    assert entries[:2] == [["!SIL", "SIL"], ["<UNK>", "SPN"]]
    assert dict(entries[2:]) == {
        "BROWN": "B R AW N", "FOX": "F AA K S", "LIGHT": "L AY T", "NIGHT": "N AY T", "QUICK": "K W IH K",
        "RIGHT": "R AY T", "THE": "DH AX"}
    assert [word for word, _ in entries[2:]] == sorted(word for word, _ in entries[2:])


def test_phone_lists_match_the_lexicon(dictionary):
    spoken = {phone for line in lines(dictionary / "lexicon.txt") for phone in line.split()[1:]}
    silences, others = (lines(dictionary / f"{name}_phones.txt") for name in ("silence", "nonsilence"))
    assert silences == ["SIL", "SPN"] and lines(dictionary / "optional_silence.txt") == ["SIL"]
    assert set(silences) | set(others) == spoken and len(others) == len(spoken) - 2
    assert (dictionary / "extra_questions.txt").read_text() == ""


def test_phone_set_has_a_usable_size():
    phones = {phone for phones in make_dict.PHONES.values() for phone in phones.split()}
    assert 20 <= len(phones) <= 50 and all(re.fullmatch("[A-Z]+", phone) for phone in phones)


def test_dictionary_does_not_depend_on_word_order_or_ids(dictionary, tmp_path):
    shuffled = [" ".join(line.split()[:0:-1]) for line in TEXT.splitlines()]
    (tmp_path / "lm.txt").write_text("\n".join(shuffled) + "\n")
    assert run("--no-ids", tmp_path / "lm.txt", tmp_path / "dict").returncode == 0
    assert ({path.name: path.read_bytes() for path in (tmp_path / "dict").glob("*.txt")}
            == {path.name: path.read_bytes() for path in dictionary.glob("*.txt")})


def test_stress_and_allophones_are_dropped():
    assert make_dict.pronunciation("water", "w_'O:_t#_3") == ["W", "AO", "DX", "ER"]
    assert make_dict.pronunciation("starry", "s_t_'A@_r_i") == ["S", "T", "AA", "R", "IY"]
    assert make_dict.pronunciation("button", "b_'V_?_n-") == ["B", "AH", "T", "AX", "N"]


@pytest.mark.parametrize(("text", "message"), [
    ("a-1 GOOD\na-2 <BAD>\n", r"text:2: '<BAD>' must be a word"), ("a-1\n", "text: holds no words"),
    ("a-1 GOOD ...\n", r"text:1: '...' must be a word")])
def test_words_with_other_characters_are_refused(text, message, tmp_path):
    (tmp_path / "text").write_text(text)
    done = run(tmp_path / "text", tmp_path / "dict")
    assert done.returncode == 1 and re.fullmatch(rf"make_dict\.py: .*{message}.*\n", done.stderr)
    assert not (tmp_path / "dict").exists()


@pytest.mark.parametrize("phonemes", ["'y:_b_3", "", "_'"])
def test_word_with_foreign_or_no_phonemes_is_refused(phonemes):
    with pytest.raises(ValueError, match="word 'über' has pronunciation .* must consist of American English phonemes"):
        make_dict.pronunciation("über", phonemes)


def test_foreign_output_directory_is_left_alone(tmp_path):
    (tmp_path / "text").write_text(TEXT)
    (tmp_path / "dict").mkdir()
    (tmp_path / "dict/notes").write_text("mine")
    done = run(tmp_path / "text", tmp_path / "dict")
    assert done.returncode == 1 and "was not made by roomeq" in done.stderr
    assert [path.name for path in (tmp_path / "dict").iterdir()] == ["notes"]
