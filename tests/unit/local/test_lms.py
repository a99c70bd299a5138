"""Language models of a text: probabilities sum to one, and larger models have lower perplexity."""

import gzip
import math
import subprocess
import sys
from itertools import pairwise
from pathlib import Path

import make_lms
import numpy as np
import pytest

import synthetic_text

LOCAL = Path(__file__).parents[3] / "local"


def run(*args):
    return subprocess.run([sys.executable, str(LOCAL / "kaldi/make_lms.py"), *map(str, args)], capture_output=True,
                          text=True, check=False)


def sentences(seed, count):
    rng = np.random.default_rng(seed)
    return [synthetic_text.draw_sentence(0, rng) for _ in range(count)]


class Model:
    """An ARPA file, evaluated as a recogniser does."""

    def __init__(self, path):
        self.log10, self.weight = {}, {}
        for line in gzip.open(path, "rt"):
            fields = line.rstrip("\n").split("\t")
            if len(fields) > 1:
                ngram = tuple(fields[1].split())
                self.log10[ngram] = float(fields[0])
                self.weight[ngram] = float(fields[2]) if len(fields) > 2 else 0.0
        self.order = max(map(len, self.log10))
        self.vocabulary = [ngram[0] for ngram in self.log10 if len(ngram) == 1 and ngram[0] != "<s>"]

    def probability(self, history, word):
        history = tuple(history)[-self.order + 1:]
        if history + (word,) in self.log10:
            return 10 ** self.log10[history + (word,)]
        return 10 ** self.weight.get(history, 0.0) * self.probability(history[1:], word) if history else 0.0

    def perplexity(self, lines):
        logs = [math.log(self.probability(words[:n], words[n])) for line in lines
                for words in [["<s>", *line, "</s>"]] for n in range(1, len(words))]
        return math.exp(-sum(logs) / len(logs))


@pytest.fixture(scope="module")
def models(tmp_path_factory):
    where = tmp_path_factory.mktemp("lms")
    (where / "text").write_text("".join(" ".join(words) + "\n" for words in sentences(1, 3000)))
    done = run(where / "text", where / "lm")
    assert done.returncode == 0, done.stderr
    return {name: Model(where / "lm" / f"lm_{name}.arpa.gz") for name in make_lms.MODELS}


@pytest.mark.parametrize("name", make_lms.MODELS)
def test_probabilities_sum_to_one_after_any_history(models, name):
    model = models[name]
    rng = np.random.default_rng(0)
    listed = [ngram for ngram in model.log10 if len(ngram) < model.order and ngram[-1] != "</s>"]
    histories = [listed[n] for n in rng.choice(len(listed), 40)] + [("<s>",), ("never", "seen")]
    for history in histories:
        assert sum(model.probability(history, word) for word in model.vocabulary) == pytest.approx(1, abs=1e-4)


def test_larger_models_have_lower_perplexity(models):
    names = ["tgsmall", "tgmed", "tglarge", "fglarge"]
    assert [models[name].order for name in names] == [3, 3, 3, 4]
    sizes = [len(models[name].log10) for name in names]
    assert sizes == sorted(sizes) and len(set(sizes)) == 4
    unseen = sentences(2, 300)
    small, medium, large, fourgrams = (models[name].perplexity(unseen) for name in names)
    assert large < medium < small
    assert fourgrams < 1.01 * large


def test_history_followed_by_every_word_cannot_back_off(tmp_path):
    words = [f"w{n}" for n in range(6)]
    (tmp_path / "text").write_text("".join(f"{a} {b} {a}\n" for a in words for b in words))
    assert run(tmp_path / "text", tmp_path).returncode == 0
    for name in make_lms.MODELS:
        model = Model(tmp_path / f"lm_{name}.arpa.gz")
        assert max(model.weight.values()) <= 1e-4
        assert sum(model.probability(["w0"], word) for word in model.vocabulary) == pytest.approx(1, abs=1e-4)


def test_history_of_every_ngram_is_listed(models):
    for model in models.values():
        for ngram in model.log10:
            assert len(ngram) == 1 or ngram[:-1] in model.log10


def test_same_text_gives_the_same_bytes(tmp_path):
    (tmp_path / "text").write_text("".join(" ".join(words) + "\n" for words in sentences(3, 50)))
    for out in ("a", "b"):
        run(tmp_path / "text", tmp_path / out)
    files = [sorted((tmp_path / out).iterdir()) for out in ("a", "b")]
    assert all(x.read_bytes() == y.read_bytes() for x, y in zip(*files, strict=True))
    assert all(x.name < y.name for x, y in pairwise(files[0]))


@pytest.mark.parametrize("text, words", [
    (None, "No such file"), ("\n\n", "at least two"), ("ONE LINE\n", "at least two")])
def test_empty_or_absent_text_is_refused(tmp_path, text, words):
    if text is not None:
        (tmp_path / "text").write_text(text)
    done = run(tmp_path / "text", tmp_path / "out")
    assert done.returncode == 1
    assert words in done.stderr and len(done.stderr.splitlines()) == 1
    assert not (tmp_path / "out").exists()
