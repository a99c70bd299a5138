"""Word error rates: counts that are known, and the coverage of confidence intervals."""

import json
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import binom, ttest_1samp
from scipy.stats import t as student_t
from wer_run import (
    DEV_ROOMS,
    ERRORS,
    ROOMS,
    put_decode,
    put_example,
    put_rirs,
    put_workspace,
    sentence,
    utterances_of,
)

from roomeq.core.files import read_json, read_jsonl, write_json, write_jsonl
from roomeq.core.rng import rng_for
from roomeq.core.stamps import read_stamp
from roomeq.validate import validate
from roomeq.wer import measure_wer
from roomeq.wer.breakdown import ACOUSTICS, DRR, EQ_DISTANCE, gains_by_acoustics
from roomeq.wer.check import read_wer, validate_wer
from roomeq.wer.scoring import Weights, choose_weights, count_errors, read_bootci, read_reference
from roomeq.wer.statistics import (
    Components,
    Levels,
    RoomComponents,
    Statistic,
    detectable,
    ratio_interval,
    variance_components,
)
from roomeq.wer.table import caption, strata_notes, table_text

TIMES = 200


def measured(root, workspaces):
    return json.loads(measure_wer(workspaces, root / "wer", rirs=[root / "rirs"]).read_text())


@pytest.fixture(scope="module")
def example(tmp_path_factory):
    """`put_example` of two seeds and two columns, measured."""
    root = tmp_path_factory.mktemp("example")
    return measured(root, put_example(root, seeds=2, columns=("online", "fglarge")))


@pytest.mark.parametrize(("spoken", "heard", "counts"), [
    ("a b c", "a b c", (0, 0, 0)), ("a b c", "a x c", (1, 0, 0)), ("a b c", "a c", (0, 1, 0)),
    ("a b c", "a b b c", (0, 0, 1)), ("a b c", "", (0, 3, 0)), ("a", "x y z", (1, 0, 2)),
    ("a b c d", "b c x", (1, 1, 0))])
def test_errors_are_counted_by_kind(spoken, heard, counts):
    found = count_errors([tuple(spoken.split())], [tuple(heard.split())])
    np.testing.assert_array_equal(found, [counts])


def test_rates_match_the_errors_that_were_made(example):
    assert example["rows"] == ["train.clean", "train.real.rvb", "train.sim.rvb", "train.sim.EQ.rvb"]
    assert example["columns"] == ["fglarge", "online"] and example["seeds"] == [0, 1]
    for row, per_ten in (("train.real.rvb", 1), ("train.sim.rvb", 5), ("train.sim.EQ.rvb", 3)):
        one = example["results"][row]["online"]
        assert one["dev"]["wer"] == pytest.approx(10 * per_ten)
        assert one["test"]["wer"] == pytest.approx(10 * per_ten + 2.5)  # the loudest of four rooms has one more
        assert one["test"]["substitutions"] == 2 * (8 * per_ten + 2) and one["test"]["deletions"] == 0
        assert one["test"]["by_seed"] == pytest.approx([10 * per_ten + 2.5] * 2)
        assert one["dev_test_gap"]["points"] == pytest.approx(2.5)
        assert one["weights"] == [dict(lmwt=8, penalty="0.5", at_edge=True)] * 2
    assert example["sets"]["test.real.rvb"] == dict(rooms=4, utterances=16, words=160)
    rooms = {one["room"]: one["wer"]["online"]["train.sim.rvb"] for one in example["rooms"]}
    assert rooms == pytest.approx(dict(attic=50, cellar=50, hall=60, kitchen=50))


def test_strata_have_their_words_and_rates(example):
    found = {(one["what"], one["low"], one["high"]): (one["words"], round(one["wer"]["online"]["train.sim.rvb"], 3))
             for one in example["strata"]}
    assert found == {("SNR [dB]", None, 10.0): (80, 52.5), ("SNR [dB]", 10.0, 15.0): (80, 52.5),
                     ("T20 at 1 kHz [s]", 0.8, None): (40, 60.0),  # the hall; T20 of the other rooms is not valid
                     ("DRR [dB]", 0.0, 5.0): (160, 52.5)}
    assert strata_notes(example) == ["T20 at 1 kHz is known of 40 of 160 words: not all seeds or rooms state it."]


def test_rooms_state_their_acoustics_and_the_distance_of_their_eq(tmp_path):
    workspaces = put_example(tmp_path)
    (workspaces[0] / "kaldi_version").write_text("5.5.1-abcd\n")
    eqs_db = dict(attic=0.0, cellar=2.0, hall=-3.0, kitchen=6.0)
    for rirs, levels_db in (("rirs", eqs_db), ("train", dict(lab=0.0))):
        rows = read_jsonl(tmp_path / "rirs/rirs.jsonl")
        rows = rows if rirs == "rirs" else [row | dict(room_id="lab") for row in rows]
        for row in rows:
            if (level_db := levels_db.get(row["room_id"])) is not None:
                row["acoustic_parameters"] |= dict(eq_db=[level_db] * 8, eq_valid=[True] * 8, eq_edge_db=None,
                                                   c50_db=[7.0] * 8, c50_valid=[True] * 8)
        write_jsonl(tmp_path / rirs / "rirs.jsonl", rows)
    out = measure_wer(workspaces, tmp_path / "wer", rirs=[tmp_path / "rirs"], train_rirs=tmp_path / "train")
    wer = read_wer(out)
    assert wer["kaldi"] == ["5.5.1-abcd"]
    for room in wer["rooms"]:
        acoustics = room["acoustics"]
        assert acoustics["EQ at 4 and 8 kHz [dB]"] == eqs_db[room["room"]]
        assert acoustics["EQ distance [dB]"] == pytest.approx(abs(eqs_db[room["room"]]))
        assert acoustics["DRR [dB]"] == 1 and acoustics["C50 at 1 kHz [dB]"] == 7
        assert acoustics["T20 at 1 kHz [s]"] == (1 if room["room"] == "hall" else None)
    for what, parts in (("EQ distance", {(None, 60), (6.0, 20)}), ("EQ at", {(-3.0, 20), (0.0, 60)})):
        assert {(one["low"], one["words"]) for one in wer["strata"] if one["what"].startswith(what)} == parts
    assert wer["gains"] == []  # of four rooms, none is stated


def test_gains_follow_the_acoustics():
    rooms = [dict(wer=dict(online={"train.sim.rvb": 20.0, "train.sim.EQ.rvb": 20.0 - n}),
                  acoustics={what: None for what in ACOUSTICS} | {EQ_DISTANCE: 0.5 * n, DRR: 1.0}) for n in range(10)]
    gain, = gains_by_acoustics(rooms, ["train.sim.EQ.rvb"], "online")
    assert (gain["what"], gain["rooms"]) == (EQ_DISTANCE, 10)
    assert gain["rho"] == pytest.approx(-1) and gain["p"] < 0.001
    rooms[0]["acoustics"][EQ_DISTANCE] = 9.0  # the room without a gain is the farthest
    assert gains_by_acoustics(rooms, ["train.sim.EQ.rvb"], "online")[0]["rho"] == pytest.approx(-0.4545, abs=1e-3)
    assert gains_by_acoustics(rooms[:7], ["train.sim.EQ.rvb"], "online") == []
    for n, room in enumerate(rooms):  # one error less in 30 words everywhere: rounding must not rank the rooms
        room["wer"]["online"] = {"train.sim.rvb": 100 * (n + 2) / 30, "train.sim.EQ.rvb": 100 * (n + 1) / 30}
    assert gains_by_acoustics(rooms, ["train.sim.EQ.rvb"], "online") == []


def test_changed_training_rirs_are_measured_again(tmp_path, capsys):
    workspaces = put_example(tmp_path)
    (tmp_path / "train").mkdir()
    (tmp_path / "train/rirs.jsonl").write_bytes((tmp_path / "rirs/rirs.jsonl").read_bytes())
    train = tmp_path / "train"
    measure_wer(workspaces, tmp_path / "wer", rirs=[tmp_path / "rirs", train])
    before = read_wer(tmp_path / "wer/wer.json")
    measure_wer(workspaces, tmp_path / "wer", rirs=[tmp_path / "rirs"], train_rirs=train)
    assert (tmp_path / "wer/wer.json").stat().st_size and read_wer(tmp_path / "wer/wer.json") == before  # no EQ stated
    assert read_stamp(tmp_path / "wer").options["train_rirs"] is True


def test_table_states_rooms_and_gains(example):
    rooms = [json.loads(json.dumps(example["rooms"][0])) | dict(room=f"room{n}") for n in range(9)]
    for n, room in enumerate(rooms):
        room["acoustics"][DRR] = float(n)
        room["wer"]["fglarge"]["train.sim.EQ.rvb"] -= n
    text = table_text(example | dict(rooms=rooms, gains=gains_by_acoustics(rooms, ["train.sim.EQ.rvb"], "fglarge")))
    assert "train.sim.EQ.rvb: DRR -1.00 (p < 0.001, 9 rooms)" in text
    assert re.search(r"^room8 +\d+ +- +8\.0 +- +- ", text, re.M)


def test_malformed_snr_is_named_and_missing_file_accepted(tmp_path):
    workspaces = put_example(tmp_path)
    path = workspaces[0] / "data/test.real.rvb/utt2snr"
    path.write_text(path.read_text().replace(" 5\n", " loud\n", 1))
    with pytest.raises(ValueError, match="utt2snr: SNR 'loud' of 'test-attic-0' must be a number"):
        measured(tmp_path, workspaces)
    path.unlink()
    assert {one["what"] for one in measured(tmp_path, workspaces)["strata"]} == {"T20 at 1 kHz [s]", "DRR [dB]"}


def test_change_and_share_of_the_gap(example):
    one = example["results"]["train.sim.EQ.rvb"]["fglarge"]
    assert one["change"]["points"] == pytest.approx(-20) and one["change"]["p"] < 0.001
    assert one["change"]["relative"] == pytest.approx(100 * (32.5 / 52.5 - 1))
    low, high = one["change"]["relative_interval"]
    assert low < one["change"]["relative"] < high < 0
    assert one["closed"]["share"] == pytest.approx(0.5) and one["closed"]["interval"] == pytest.approx([0.5, 0.5])
    assert "change" not in example["results"]["train.sim.rvb"]["fglarge"]
    assert "closed" not in example["results"]["train.real.rvb"]["fglarge"]


def test_difference_is_stated_without_the_room_that_changes_it_most(example):
    change = example["results"]["train.clean"]["fglarge"]["change"]
    assert change["points"] == pytest.approx(27.5)  # 20 in the hall, 30 elsewhere
    assert change["influential"]["room"] == "hall" and change["influential"]["points"] == pytest.approx(30)
    assert "without hall, which changes it most: +30.00 [30.00, 30.00]\n" in table_text(example)


def test_change_is_stated_as_geometric_mean_over_rooms(example):
    mean = example["results"]["train.clean"]["fglarge"]["change"]["geometric_mean"]
    errors = [[room["words"] * room["wer"]["fglarge"][row] / 100 for row in ("train.clean", "train.sim.rvb")]
              for room in example["rooms"]]
    ratios = [(clean + 0.5) / (base + 0.5) for clean, base in errors]
    assert mean["relative"] == pytest.approx(100 * (np.prod(ratios) ** 0.25 - 1))
    low, high = mean["interval"]
    assert 0 < low < mean["relative"] < high and mean["p"] < 0.05 and mean["detectable"] > 0
    assert f"geometric mean over rooms: relative {mean['relative']:+.1f} % [{low:.1f}, {high:.1f}], p " in table_text(
        example)


def test_two_rooms_have_no_influential_one(tmp_path):
    put_rirs(tmp_path / "rirs", (*ROOMS, *DEV_ROOMS))
    sets = {"dev.real.rvb": utterances_of("dev", DEV_ROOMS), "test.real.rvb": utterances_of("test", ROOMS[:2])}
    put_workspace(tmp_path / "ws", {"train.sim.rvb": lambda *_: 5, "train.clean": lambda *_: 8}, sets=sets)
    change = measured(tmp_path, [tmp_path / "ws"])["results"]["train.clean"]["tgsmall"]["change"]
    assert change["interval"] and change["influential"] is None


def test_weights_are_chosen_on_dev_not_on_test(tmp_path):
    workspace, = put_example(tmp_path)
    decode = workspace / "train.sim.rvb/decode_test.real.rvb_tgsmall"
    reference = read_reference(decode)
    hypotheses = {ident: list(words) for ident, words in reference.items()}
    put_decode(decode, reference, hypotheses, spoil_best=3)
    assert choose_weights(decode) != Weights("0.5", 8)
    found = measured(tmp_path, [workspace])["results"]["train.sim.rvb"]["tgsmall"]
    assert found["weights"] == [dict(lmwt=8, penalty="0.5", at_edge=True)]
    assert (found["test"]["insertions"], found["test"]["wer"]) == (3, 100 * 3 / 80)


@pytest.mark.parametrize(("damage", "message"), [
    (lambda root: (root / "data/test.real.rvb/source").write_text("other RIRs"),
     "decode_test.real.rvb_tgsmall: was not decoded from what .*data/test.real.rvb holds now: run stages 8 to 10"),
    (lambda root: (root / "data/train.sim.rvb/source").write_text("other RIRs"),
     "train.sim.rvb: was not trained on what .*train.sim.rvb holds now"),
    (lambda root: (root / "train.sim.rvb/decode_dev.real.rvb_tgsmall/source").unlink(),
     "was not decoded from what .*dev"),
    (lambda root: (root / "seed").write_text("seven"), "seed: must hold the seed of the run: run stage 8 again"),
    (lambda root: (root / "train.sim.rvb/seed").write_text("7"), "train.sim.rvb/seed: must hold the seed of the "
     "workspace, 0: run stages 8 to 10 with one seed for all rows")])
def test_models_and_decodings_of_other_data_are_refused(tmp_path, damage, message):
    workspace, = put_example(tmp_path)
    damage(workspace)
    with pytest.raises(ValueError, match=message):
        measured(tmp_path, [workspace])


def test_rows_of_other_settings_are_refused(tmp_path):
    workspace, = put_example(tmp_path)
    for row in ("clean", "real.rvb", "sim.rvb", "sim.EQ.rvb"):
        (workspace / f"train.{row}/settings").write_text("ivectors false\nnum_leaves 400\n")
    measured(tmp_path, [workspace])
    (workspace / "train.sim.rvb/settings").write_text("ivectors false\nnum_leaves 300\n")
    with pytest.raises(ValueError, match=r"train.sim.rvb/settings: is not as .*train.clean/settings \(num_leaves\): "
                                         "rows of other settings cannot be compared"):
        measured(tmp_path, [workspace])
    (workspace / "train.sim.rvb/settings").unlink()
    with pytest.raises(ValueError, match=r"\(ivectors, num_leaves\)"):
        measured(tmp_path, [workspace])


@pytest.mark.parametrize(("words", "stated"), [
    ((100, 100, 100, 50), None), ((100, 100, 100, 10), "3.2"), ((1000, 10, 10, 10), "1.1")])
def test_caption_states_the_effective_number_of_rooms_of_unequal_sizes(example, words, stated):
    rooms = [room | dict(words=n) for room, n in zip(example["rooms"], words, strict=True)]
    text = " ".join(caption(example | dict(rooms=rooms)))
    assert (f"unequal in words: effective number of rooms {stated}." in text) if stated else "effective" not in text


def test_caption_counts_weights_at_the_edge_of_the_search(tmp_path, capsys):
    workspace, = put_example(tmp_path)
    measured(tmp_path, [workspace])
    assert "4 of 4 choices lie at the edge of the search" in capsys.readouterr().out
    for decode in workspace.glob("train.*/decode_*"):
        shutil.copytree(decode / "scoring_kaldi/penalty_0.0", decode / "scoring_kaldi/penalty_1.0")
        for made in (decode / "scoring_kaldi").glob("penalty_*"):
            shutil.copy(made / "7.txt", made / "9.txt")
    measure_wer([workspace], tmp_path / "again", rirs=[tmp_path / "rirs"])
    assert "edge of the search" not in capsys.readouterr().out


def test_ties_between_weights_go_to_the_smallest(tmp_path):
    reference = {"u": sentence(0)}
    put_decode(tmp_path, reference, reference, spoil_best=1)
    assert choose_weights(tmp_path) == Weights("0.0", 7)


def test_dev_set_is_of_the_rows_kind_if_decoded(tmp_path, capsys):
    put_rirs(tmp_path / "rirs", (*ROOMS, *DEV_ROOMS))
    sets = {name: utterances_of(name, DEV_ROOMS) for name in ("dev.sim.rvb", "dev.clean", "dev.real.rvb")}
    for dev in sets:
        row = dev.replace("dev", "train")
        put_workspace(tmp_path / "ws", {row: lambda name, *_: 2 if name.startswith("dev") else 4}, sets={
            dev: sets[dev], "test.real.rvb": utterances_of("test", ROOMS)})
    clean = tmp_path / "ws/data/dev.clean"
    (clean / "utt2rir").rename(clean / "utt2spk")  # clean speech has speakers and no rooms
    found = measured(tmp_path, [tmp_path / "ws"])
    assert found["dev_of"] == {"train.clean": "dev.clean", "train.sim.rvb": "dev.sim.rvb",
                               "train.real.rvb": "dev.real.rvb"}
    assert found["results"]["train.sim.rvb"]["tgsmall"]["dev_test_gap"]["points"] == pytest.approx(20)
    assert found["sets"]["dev.clean"]["rooms"] is None and found["sets"]["dev.sim.rvb"]["rooms"] == 2
    assert ("dev is of each row's own kind, as in the paper: dev.clean, dev.sim.rvb; else dev.real.rvb."
            in capsys.readouterr().out)


def test_table_text_states_sets_seeds_and_gap(tmp_path, capsys):
    workspaces = put_example(tmp_path, seeds=2, columns=("fglarge", "online"))
    measure_wer(workspaces[:1], tmp_path / "one", rirs=[tmp_path / "rirs"])
    one = capsys.readouterr().out
    measure_wer(workspaces, tmp_path / "two", rirs=[tmp_path / "rirs"])
    two = capsys.readouterr().out
    assert "train.sim.EQ.rvb            30.00   30.00     32.50   32.50\n" in one
    assert one.splitlines()[1].split() == ["Training", "data", "fglarge", "online", "fglarge", "online"]
    assert "chosen on dev" in one and "With one seed the spread over seeds is not known" in one
    assert "2 seeds" in two and "is not known" not in two
    assert "closes 50 % [50, 50] of the gap train.sim.rvb - train.real.rvb +40.00" in two


def test_measuring_again_gives_the_same_bytes(tmp_path, capsys):
    workspaces = put_example(tmp_path, seeds=2, errors={"train.sim.rvb": 5, "train.sim.EQ.rvb": 2})
    first = measure_wer(workspaces, tmp_path / "a", rirs=[tmp_path / "rirs"]).read_bytes()
    said = capsys.readouterr().out
    shutil.rmtree(tmp_path / "a")
    assert measure_wer(workspaces, tmp_path / "a", rirs=[tmp_path / "rirs"]).read_bytes() == first
    assert measure_wer(workspaces, tmp_path / "a", rirs=[tmp_path / "rirs"]).read_bytes() == first
    assert capsys.readouterr().out == 2 * said


def test_changed_hypothesis_is_measured_again(tmp_path):
    workspace, = put_example(tmp_path)
    before = measured(tmp_path, [workspace])
    decode = workspace / "train.sim.rvb/decode_test.real.rvb_tgsmall"
    reference = read_reference(decode)
    put_decode(decode, reference, {ident: list(words) for ident, words in reference.items()})
    after = measured(tmp_path, [workspace])
    assert before["results"]["train.sim.rvb"]["tgsmall"]["test"]["wer"] == pytest.approx(52.5)
    assert after["results"]["train.sim.rvb"]["tgsmall"]["test"]["wer"] == 0


def test_output_of_kaldis_bootstrap_is_quoted(tmp_path, capsys):
    workspace, = put_example(tmp_path)
    (workspace / "train.sim.rvb/decode_test.real.rvb_tgsmall/bootci").write_text(
        "Set1: %WER 52.51 95% Conf Interval [ 49.40, 55.62 ]\n")
    one = measured(tmp_path, [workspace])["results"]["train.sim.rvb"]["tgsmall"]["test"]
    assert one["bootci"] == [dict(wer=52.51, interval=[49.40, 55.62])]
    said = capsys.readouterr().out
    assert "Kaldi's 52.51 [49.40, 55.62]" in said and "output of compute-wer-bootci" in said
    assert read_bootci(tmp_path) is None


def test_written_file_is_valid(example, tmp_path, capsys):
    write_json(tmp_path / "wer.json", example)
    assert validate_wer(tmp_path) == 8
    validate([tmp_path])
    assert "8 systems, OK" in capsys.readouterr().out


@pytest.mark.parametrize(("where", "value", "message"), [
    (("rows",), [], "rows must be names"), (("rows",), ["train.other"], "KeyError: 'train.other'"),
    (("seeds",), [], "seeds must be numbers"),
    (("seeds",), [-1], "seeds=-1 must be a number of 0 or more"),
    (("results", "train.sim.rvb", "online", "test", "wer"), "low", "train.sim.rvb online test='low' must be a number"),
    (("results", "train.sim.rvb", "online", "test", "interval"), [90.0, 99.0], r"interval=\[90.0, 99.0\] must lie"),
    (("results", "train.sim.EQ.rvb", "online", "change", "points"), None, "train.sim.EQ.rvb online change=None must"),
    (("results", "train.sim.EQ.rvb", "online", "closed", "interval"), None, "online share must have an interval"),
    (("results", "train.sim.EQ.rvb", "online", "dev_test_gap", "p"), -1, "dev_test_gap p=-1 must be"),
    (("results", "train.sim.EQ.rvb", "online", "change", "influential", "room"), 3, "influential must state its room"),
    (("results", "train.sim.EQ.rvb", "online", "change", "geometric_mean", "relative"), -101.0, "geometric mean=-101"),
    (("rooms",), [dict(room="hall", words=9, wer={})], "KeyError: 'fglarge'"), (("rooms",), [], "rooms must not be"),
    (("rooms", 0, "words"), 0, "words of room 'attic'=0 must be a number of 1"),
    (("rooms", 0, "acoustics", "DRR [dB]"), True, "DRR .dB. of room 'attic'=True must be a number"),
    (("gains",), [dict(row="train.sim.EQ.rvb", what="mood", rooms=9, rho=0, p=1)], "gain of .* must be of a row"),
    (("gains",), [dict(row="train.sim.EQ.rvb", what="DRR [dB]", rooms=9, rho=0, p=7)], "p of .* must be 1 or less"),
    (("kaldi",), "5.5", "kaldi must be versions"),
    (("strata", 0, "words"), 0, "SNR .dB. from None to 10.0=0 must be a number of 1"),
    (("sets",), {}, "KeyError: 'test.real.rvb'")])
def test_edited_file_is_refused_in_one_line(example, tmp_path, where, value, message):
    found = one = json.loads(json.dumps(example))
    for key in where[:-1]:
        one = one[key]
    one[where[-1]] = value
    write_json(tmp_path / "wer.json", found)
    with pytest.raises(ValueError, match=f"wer.json: .*{message}.*: measure again$"):
        read_wer(tmp_path / "wer.json")


# ---- intervals


def table(seed, row, room, residual, shape):
    """Deviations of rates [%] from their mean over seeds and rooms."""
    rng = rng_for(0, "world", str(seed))
    n_seeds, n_rooms = shape
    return (row * rng.standard_normal((n_seeds, 1)) + room * rng.standard_normal(n_rooms)
            + residual * rng.standard_normal(shape))


def rate(percent, words=200):
    """A rate from the rates [%] of its cells, all of so many words; errors need not be whole."""
    words = np.full(percent.shape, float(words))
    return Statistic.of(percent / 100 * words, words)


def equal(shape):
    """Shares of cells of equal size."""
    return [np.full(shape, 1.0 / np.prod(shape))]


def test_variance_components_of_a_known_table():
    seeds, rooms = np.array([-1.0, 0.0, 1.0]), np.array([-3.0, 0.0, 0.0, 3.0])
    found = variance_components(seeds[:, None] + rooms, equal((3, 4)))
    of_rooms, = found.of_sets
    assert (found.seed, of_rooms.room, of_rooms.residual) == pytest.approx((1.0, 6.0, 0.0))
    assert found.variance == pytest.approx(1 / 3 + 6 / 4)
    # Satterthwaite: (sum of terms)^2 / sum of terms^2 / df
    assert found.df == pytest.approx((1 / 3 + 1.5) ** 2 / ((1 / 3) ** 2 / 2 + 1.5 ** 2 / 3))
    alone = variance_components(rooms[None], equal((1, 4)))
    assert alone.seed is None and alone.variance == pytest.approx(1.5) and alone.df == pytest.approx(3)


def test_components_of_unequal_rooms_are_unbiased_and_their_df_are_those_of_their_variance():
    words, times = np.tile([2000.0, 1000.0, *[100.0] * 8], (4, 1)), 4000
    seeds, rooms, residual = 1.0, 3.0, 2.0
    shares = words / words.sum()
    found = []
    for n in range(times):
        percent = table(f"unequal{n}", seeds, rooms, residual, words.shape)
        found.append(variance_components(words.size * shares * (percent - (shares * percent).sum()), [shares]))
    true = seeds ** 2 / 4 + (rooms ** 2 + residual ** 2 / 4) * (shares.sum(axis=0) ** 2).sum()
    variances = np.array([one.variance for one in found])
    assert variances.mean() == pytest.approx(true, rel=0.05)
    exact = Components(found[0].seeds, seeds ** 2,
                       (RoomComponents(found[0].of_sets[0].rooms, rooms ** 2, residual ** 2),))
    assert exact.variance == pytest.approx(true)
    assert 2 * true ** 2 / variances.var() == pytest.approx(exact.df, rel=0.1)


@pytest.mark.parametrize(("shape", "seed", "room", "residual"), [
    ((1, 10), 0, 4, 0), ((5, 40), 1, 4, 2), ((5, 40), 2, 0, 0.5), ((3, 40), 2, 3, 1), ((5, 40), 0, 0, 3),
    ((2, 27), 0.5, 0.5, 1.4), ((3, 27), 0.5, 0.5, 1.4), ((2, 27), 0.4, 1.2, 1.4)])
def test_intervals_cover_the_truth_at_their_level(shape, seed, room, residual):
    found = [rate(20 + table(n, seed, room, residual, shape)).interval() for n in range(TIMES)]
    held = sum(low <= 20 <= high for low, high in found)
    assert held >= binom.ppf(0.001, TIMES, 0.93)
    ideal = 2 * 1.96 * np.sqrt(seed ** 2 / shape[0] + room ** 2 / shape[1] + residual ** 2 / np.prod(shape))
    if shape[0] != 2:  # two seeds say next to nothing of seeds
        assert np.mean([high - low for low, high in found]) < 2.0 * ideal


@pytest.mark.parametrize("n_rooms", [2, 3, 10])
def test_interval_over_rooms_of_equal_size_is_that_of_students_t(n_rooms):
    percent = 2.0 + table("t", 0, 3, 0, (1, n_rooms))
    one, expected = rate(percent), ttest_1samp(percent[0], 0.0)
    assert one.interval() == pytest.approx([*expected.confidence_interval()])
    assert one.p_value() == pytest.approx(expected.pvalue)


def test_intervals_of_equal_rows_cover_zero_at_their_level():
    shape = (5, 40)
    common = [20 + table(f"common{n}", 1, 5, 1, shape) for n in range(TIMES)]
    pairs = [(rate(both + table(f"a{n}", 0.5, 1, 2, shape)),
              rate(both + table(f"b{n}", 0.5, 1, 2, shape))) for n, both in enumerate(common)]
    differences = [a.minus(b) for a, b in pairs]
    held = sum(low <= 0 <= high for low, high in (one.interval() for one in differences))
    assert binom.ppf(0.001, TIMES, 0.93) <= held < TIMES
    significant = sum(one.p_value() < 0.05 for one in differences)
    assert significant <= binom.ppf(0.999, TIMES, 0.07)


@pytest.mark.parametrize(("n_seeds", "sizes"), [
    (5, [2000] + 9 * [200]), (5, [10000] + 39 * [200]), (5, 2 * [3000] + 25 * [100]), (1, 5 * [2000] + 22 * [100])])
def test_intervals_cover_the_truth_where_few_rooms_have_most_words(n_seeds, sizes):
    words, rates, differences = np.tile(sizes, (n_seeds, 1)).astype(float), 0, 0
    for n in range(TIMES):
        first, second = (Statistic.of(words * (20 + table(f"rooms{n}", 0, 3, 0, words.shape) + table(
            f"{name}{n}", 0.3, 1, 1, words.shape)) / 100, words) for name in "ab")
        low, high = first.interval()
        rates += low <= 20 <= high
        difference = first.minus(second)
        low, high = difference.interval()
        differences += low <= 0 <= high
        assert (difference.p_value() >= 0.05) == (low <= 0 <= high)
    assert min(rates, differences) >= binom.ppf(0.001, TIMES, 0.93)


@pytest.mark.parametrize("shape", [(1, 27), (5, 27)])
def test_geometric_mean_covers_the_truth_where_one_room_has_most_errors(shape):
    """Rates from 3 to 70 %, which one of two recognisers lowers by about a tenth."""
    words, held = np.full(shape, 1500), 0
    base = np.append(np.geomspace(0.03, 0.2, shape[1] - 1), 0.7)
    for n in range(TIMES):
        rng, change = rng_for(n, "world", "errors"), np.log(0.9) + table(f"ratio{n}", 0.02, 0.1, 0.05, shape)
        first, second = rng.binomial(words, base), rng.binomial(words, np.minimum(base * np.exp(change), 1.0))
        low, high = Statistic.of_log_ratio(second, first, words).interval()
        held += low <= np.log(0.9) <= high
    assert held >= binom.ppf(0.001, TIMES, 0.93)


def test_log_ratio_is_the_mean_over_rooms_by_their_words():
    words = np.array([[100.0, 300.0], [100.0, 300.0]])
    errors, base = np.array([[10.0, 60.0], [14.0, 66.0]]), np.array([[20.0, 60.0], [28.0, 66.0]])
    ratio = Statistic.of_log_ratio(errors, base, words)
    assert ratio.value == pytest.approx(0.25 * np.log(24.5 / 48.5))  # the larger room does not change
    assert ratio.z.sum() == pytest.approx(0.0) and ratio.z.shape == (2, 2)
    of_rooms = ratio.z.sum(axis=0) / ratio.z.size / ratio.shares[0].sum(axis=0)
    assert of_rooms == pytest.approx(np.array([0.75, -0.25]) * np.log(24.5 / 48.5))
    swapped = Statistic.of_log_ratio(base, errors, words)
    assert swapped.value == pytest.approx(-ratio.value) and swapped.z == pytest.approx(-ratio.z)


def test_log_ratio_of_rooms_without_errors_or_words_is_finite():
    words, none = np.array([[100.0, 50.0, 0.0]]), np.zeros((1, 3))
    assert Statistic.of_log_ratio(none, none, words).value == 0.0
    ratio = Statistic.of_log_ratio(none, np.array([[9.0, 4.0, 0.0]]), words)
    assert ratio.value == pytest.approx(2 / 3 * np.log(0.5 / 9.5) + 1 / 3 * np.log(0.5 / 4.5))
    assert np.isfinite(ratio.z).all() and np.isfinite(ratio.interval()).all()


def test_difference_of_sets_has_the_uncertainty_of_the_set_with_few_rooms():
    """Of 40 rooms of test and 3 of dev, all as variable."""
    shape, held = (4, 43), 0
    for n in range(TIMES):
        errors = (20 + table(f"sets{n}", 0.3, 3, 1, shape)) / 100 * 200
        of_test = np.arange(43) < 40
        test, dev = (Statistic.of(np.where(rooms, errors, 0.0), np.where(rooms, 200.0, 0.0) + np.zeros(shape))
                     for rooms in (of_test, ~of_test))
        low, high = test.minus(dev).interval()
        held += low <= 0 <= high
    assert test.minus(dev).components.df < 4 and test.components.df > 30
    assert held >= binom.ppf(0.001, TIMES, 0.93)


def test_set_of_a_single_room_leaves_no_interval_of_a_difference():
    words = np.array([[200.0, 200.0, 0.0], [200.0, 200.0, 0.0]])
    test = Statistic.of(0.2 * words + [[1, 3, 0], [2, 4, 0]], words)
    dev = Statistic.of(np.array([[0.0, 0.0, 30.0], [0.0, 0.0, 50.0]]), 200.0 - words)
    assert test.interval() and dev.interval() is None
    assert test.minus(dev).interval() is None and test.minus(dev).p_value() is None


def test_sets_with_a_common_room_are_paired_over_their_rooms():
    """Two sets of the same rooms, in which the rooms have other numbers of words."""
    first, second = np.tile([200.0, 300.0, 200.0, 250.0], (3, 1)), np.tile([300.0, 200.0, 250.0, 200.0], (3, 1))
    percent = 20 + table("common", 0.3, 8, 0.1, (3, 4))
    one, other = (Statistic.of(percent / 100 * words, words) for words in (first, second))
    assert len(one.minus(other).shares) == 1
    assert one.minus(other).components.variance < 0.2 * one.components.variance


def test_row_does_not_differ_from_itself():
    one = rate(20 + table(0, 1, 5, 1, (3, 8)))
    assert one.minus(one).interval() == [0.0, 0.0] and one.minus(one).p_value() == 1.0
    assert detectable(one.minus(one)) is None


def test_pairing_over_rooms_and_seeds_narrows_the_interval():
    shape = (5, 40)
    both = 20 + table("both", 2, 5, 0, shape)
    a, b = (rate(both + table(name, 0, 0, 2, shape)) for name in "ab")
    low, high = a.minus(b).interval()
    unpaired = np.hypot(*(np.diff(one.interval())[0] for one in (a, b)))
    assert high - low < 0.5 * unpaired


def test_rooms_with_more_words_weigh_more():
    errors, words = np.array([[10.0, 0.0]]), np.array([[10.0, 90.0]])
    assert Statistic.of(errors, words).value == 10.0


def test_single_room_has_no_interval():
    one = rate(np.array([[20.0], [22.0]]))
    assert one.interval() is None and one.p_value() is None and detectable(one) is None
    assert ratio_interval(one, one) is None


def test_contrast_is_zero_at_the_ends_of_a_ratio_interval():
    shape = (5, 40)
    base, row, oracle = (rate(mean + table(mean, 0.3, 2, 1, shape)) for mean in (20, 17, 14))
    gained, gap = base.minus(row), base.minus(oracle)
    low, high = ratio_interval(gained, gap)
    assert low < gained.value / gap.value < high
    assert gained.minus(gap, low).interval()[0] == pytest.approx(0, abs=1e-3)
    assert gained.minus(gap, high).interval()[1] == pytest.approx(0, abs=1e-3)


def test_intervals_of_gap_shares_cover_the_truth():
    shape, held, unknown, times = (5, 40), 0, 0, TIMES // 2
    for n in range(times):
        base, row, oracle = (rate(mean + table(f"{mean} {n}", 0.3, 4, 1, shape))
                             for mean in (20, 17.75, 17))
        found = ratio_interval(base.minus(row), base.minus(oracle))
        unknown += found is None
        held += found is not None and found[0] <= 0.75 <= found[1]
    assert held + unknown >= binom.ppf(0.001, times, 0.93) and 0 < unknown < times / 3


def test_uncertain_gap_has_no_share(tmp_path, capsys):
    workspace, = put_example(tmp_path, errors={"train.real.rvb": 5, "train.sim.rvb": 5, "train.sim.EQ.rvb": 4})
    closed = measured(tmp_path, [workspace])["results"]["train.sim.EQ.rvb"]["tgsmall"]["closed"]
    assert closed["share"] is None and closed["interval"] is None and closed["gap"]["points"] == 0
    assert closed["gained"]["points"] == pytest.approx(10)
    assert "is not certain: no share of it is stated" in capsys.readouterr().out


def test_detectable_difference_is_detected_in_80_percent():
    shape, parts = (5, 40), (0.5, 2.0, 1.5)
    seed, room, residual = (one ** 2 for one in parts)
    true = Components(Levels.of(np.full(5, 1 / 5)), seed,
                      (RoomComponents(Levels.of(np.full(40, 1 / 40)), room, residual),))
    found = detectable(rate(20 + table(0, *parts, shape)))
    size = found["standard_errors"] * np.sqrt(true.variance)
    times = sum(rate(size + table(n, *parts, shape)).p_value() < 0.05 for n in range(TIMES))
    assert binom.ppf(0.001, TIMES, 0.74) <= times <= binom.ppf(0.999, TIMES, 0.88)


def test_half_of_the_detectable_difference_needs_for_half():
    shape = (4, 20)
    one = rate(20 + table(3, 1, 3, 2, shape))
    fitted, found = one.components, detectable(one)

    def difference(n_seeds, n_rooms):
        times = n_seeds / 4, n_rooms / 20
        df = fitted.df_with(*times)
        return (student_t.ppf(0.975, df) + student_t.ppf(0.8, df)) * np.sqrt(fitted.variance_with(*times))

    half = found["for_half"]
    assert found["difference"] == pytest.approx(difference(*shape))
    assert difference(4 * half["factor"], 20 * half["factor"]) == pytest.approx(found["difference"] / 2)
    for kind, n_seeds, n_rooms in (("seeds", half["seeds"], 20), ("rooms", 4, half["rooms"])):
        if half[kind] is not None:
            assert difference(n_seeds, n_rooms) <= found["difference"] / 2
            assert difference(n_seeds - (kind == "seeds"), n_rooms - (kind == "rooms")) > found["difference"] / 2
    only_rooms = rate(20 + table(3, 0, 3, 0, shape))
    assert detectable(only_rooms)["for_half"]["seeds"] is None
    assert 70 <= detectable(only_rooms)["for_half"]["rooms"] <= 80
    assert detectable(rate(20 + table(3, 0, 3, 0, (1, 20))))["seed"] is None


def test_two_seeds_do_not_show_that_seeds_do_not_matter():
    """The degrees of freedom do not jump where the estimated variance over seeds becomes zero."""
    rng = rng_for(0, "test", "jump")
    rooms, residual = rng.standard_normal(27), rng.standard_normal((2, 27))
    rooms -= rooms.mean()
    residual -= residual.mean(axis=1, keepdims=True)
    expected = np.sqrt(residual.var(axis=0, ddof=1).sum() / 26 / 27)  # of a seed's mean, by the residual alone
    just_below, just_above = (variance_components(
        rooms + residual + factor * expected / np.sqrt(2.0) * np.array([[1.0], [-1.0]]), equal((2, 27)))
        for factor in (0.99, 1.01))
    assert just_below.seed == 0.0 < just_above.seed
    assert just_below.df == pytest.approx(just_above.df, rel=0.1) and just_below.df < 10


def test_p_value_is_the_level_of_the_interval_that_ends_at_zero():
    one = rate(20 + table(3, 1, 3, 2, (3, 20)))
    for end in one.interval():
        shifted = replace(one, value=one.value - end)
        assert shifted.p_value() == pytest.approx(0.05, abs=1e-3)
        df = one.components.df
        beyond = replace(one, value=2.0 * (one.value - end))
        assert beyond.p_value() == pytest.approx(2.0 * student_t.sf(2.0 * student_t.ppf(0.975, df), df), rel=0.5)


def put_seeds(root, count):
    """Write workspaces of seeds that make different errors."""
    workspaces = put_example(root, seeds=count)
    for seed, (workspace, harder) in enumerate(zip(workspaces[1:], ("attic-0", "hall-1"), strict=False), start=1):
        put_workspace(workspace, {row: lambda name, column, ident, rir, n=n, harder=harder: n + (rir == harder)
                                  for row, n in ERRORS.items()},
                      sets={"dev.real.rvb": utterances_of("dev", DEV_ROOMS),
                            "test.real.rvb": utterances_of("test", ROOMS)}, seed=seed)
    return workspaces


def test_drawn_rooms_of_two_seeds_are_not_the_same_rooms(tmp_path):
    workspaces = put_example(tmp_path, seeds=2)
    for measured_id, rooms in (("m1", len(DEV_ROOMS)), (None, 2 * len(DEV_ROOMS))):
        rows = read_jsonl(tmp_path / "rirs/rirs.jsonl")
        write_jsonl(tmp_path / "rirs/rirs.jsonl", [
            row | (dict(measured_id=measured_id) if row["room_id"] in DEV_ROOMS else {}) for row in rows])
        assert measured(tmp_path, workspaces)["sets"]["dev.real.rvb"]["rooms"] == rooms


def test_test_rirs_with_other_acoustics_in_another_directory_are_refused(tmp_path):
    workspaces, rows = put_example(tmp_path), read_jsonl(tmp_path / "rirs/rirs.jsonl")
    other = [row | dict(acoustic_parameters=row["acoustic_parameters"] | dict(drr_db=9.0)) for row in rows]
    write_jsonl(tmp_path / "drawn/rirs.jsonl", [row for row in other if row["room_id"] in DEV_ROOMS])
    rirs = [tmp_path / "rirs", tmp_path / "drawn"]
    measure_wer(workspaces, tmp_path / "wer", rirs=rirs)  # acoustics of dev are not stated
    write_jsonl(tmp_path / "drawn/rirs.jsonl", other)
    with pytest.raises(ValueError, match="its RIR attic-0 has other acoustics in another directory of --rirs"):
        measure_wer(workspaces, tmp_path / "wer", rirs=rirs)


def test_seeds_of_several_machines_are_put_together(tmp_path, capsys):
    workspaces, rirs = put_seeds(tmp_path, 3), [tmp_path / "rirs"]
    together = measure_wer(workspaces, tmp_path / "together", rirs=rirs)
    first = measure_wer(workspaces[:2], tmp_path / "first", rirs=rirs)
    counts = first.parent / "counts.jsonl"
    joined = measure_wer(workspaces[2:], tmp_path / "joined", rirs=rirs, counted=[counts])
    assert joined.read_bytes() == together.read_bytes() != first.read_bytes()
    assert (joined.parent / "counts.jsonl").read_bytes() == (together.parent / "counts.jsonl").read_bytes()


def test_room_that_a_seed_did_not_draw_counts_with_the_others(tmp_path):
    workspaces, rirs = put_seeds(tmp_path, 2), [tmp_path / "rirs"]
    path = workspaces[1] / "data/test.real.rvb/utt2rir"
    path.write_text(path.read_text().replace(" attic-", " hall-"))
    both, alone = ({room["room"]: room for room in read_json(measure_wer(seeds, tmp_path / name, rirs=rirs))["rooms"]}
                   for name, seeds in (("both", workspaces), ("alone", workspaces[:1])))
    assert both.keys() == alone.keys() and both["attic"] == alone["attic"]
    assert both["hall"]["words"] == 3 * alone["hall"]["words"]


def test_the_only_room_of_a_seed_is_not_left_out(tmp_path):
    workspaces = put_seeds(tmp_path, 2)
    path = workspaces[1] / "data/test.real.rvb/utt2rir"
    path.write_text(re.sub(r" \w+-", " hall-", path.read_text()))
    influential = measured(tmp_path, workspaces)["results"]["train.clean"]["tgsmall"]["change"]["influential"]
    assert influential["room"] != "hall" and np.isfinite(influential["points"])


def test_rates_that_are_the_same_in_all_rooms_have_no_detectable_difference():
    words, one, three = np.full((1, 2), 11.0), np.full((1, 2), 1.0), np.full((1, 2), 3.0)
    difference = Statistic.of(one, words).minus(Statistic.of(three, words))
    assert detectable(difference) is None


@pytest.mark.parametrize(("change", "message"), [
    (str, r"kaldi1: is of seed 1, as .*counts\.jsonl:2: give each seed once"),
    (lambda text: "", r"counts\.jsonl: holds no seed"),
    (lambda text: re.sub('"reference":".{64}"', f'"reference":"{64 * "0"}"', text),
     "kaldi1: its reference texts are not those of"),
    (lambda text: text.replace('"low":10.0,"high":15.0', '"low":11.0,"high":15.0', 1), r"'SNR \[dB\]' from 11\.0 to "
     r"15\.0 is no part of the test set"),
    (lambda text: text.replace("train.sim.EQ.rvb", "train.other.rvb"), "kaldi1: its rows are not those of .*: put only "
     "seeds of one experiment together"),
    (lambda text: text.replace("[[", "[[-", 1), r"counts\.jsonl:1: is not what roomeq wer writes \(Expected `int`"),
    (lambda text: text[:200] + "\n", r"counts\.jsonl:1: is not what roomeq wer writes \(.*truncated\): make it again"),
    (lambda text: text.replace('"words":[20,', '"words":[', 1), r"counts\.jsonl:1: is not what roomeq wer writes \(.* "
     "words or errors of another number"),
    (lambda text: text.replace('"test.real.rvb":{', '"test.old.rvb":{', 1), r"errors of train\.clean on "
     r"test\.real\.rvb are not complete"),
    (lambda text: text.replace('"acoustics":{"attic"', '"acoustics":{"barn"', 1), "of room 'attic' are missing"),
    (lambda text: text.replace('"errors":{"tgsmall":{"train.clean":', '"errors":{"tgsmall":{"other":', 1), r"errors by "
     r"SNR \[dB\] are not complete"),
    (None, r"counts\.jsonl: no such file: give the counts\.jsonl of a directory that roomeq wer made")])
def test_counts_that_do_not_fit_are_refused(tmp_path, capsys, change, message):
    workspaces, rirs = put_seeds(tmp_path, 3), [tmp_path / "rirs"]
    text = (measure_wer(workspaces[:1], tmp_path / "first", rirs=rirs).parent / "counts.jsonl").read_text()
    if change:
        text += (measure_wer(workspaces[1:2], tmp_path / "second", rirs=rirs).parent / "counts.jsonl").read_text()
        (tmp_path / "counts.jsonl").write_text(change(text))
    with pytest.raises(ValueError, match=message):
        measure_wer(workspaces[1:2], tmp_path / "wer", rirs=rirs, counted=[tmp_path / "counts.jsonl"])
    assert not (tmp_path / "wer/wer.json").exists()
