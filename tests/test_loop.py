"""The closed loop on small undeclared worlds: nothing where there is nothing, the effect where there is one."""

from dataclasses import replace

import numpy as np
import pytest

from rirmaker import DIRECT, coloured_rir
from roomeq.acoustics.iso3382 import octave_bands
from roomeq.cli import main
from roomeq.core.constants import FS_HZ
from roomeq.core.files import read_json
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.model import read_model
from roomeq.effects.response import RESPONSE_HZ
from roomeq.effects.source_response import SourceResponse
from roomeq.loop.attribute import choose, rank
from roomeq.loop.close import SCATTERING, close_loop
from roomeq.loop.data import load_data
from roomeq.loop.features import HAS_GAIN, METRIC, feature_slice, measure_features
from roomeq.loop.fit import fit
from roomeq.loop.heldout import halves, heldout_errors
from roomeq.loop.leftout import leave_rooms_out
from roomeq.loop.packing import N_SURFACE, ParameterIndex
from roomeq.loop.predict import predict
from roomeq.loop.session import begin, look_ahead
from roomeq.records.rir_dir import load_rir, read_rirs, relocated, write_rirs
from roomeq.validate import validate
from testbed import make_world

ROOMS = 5
SEED = 3


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    """Make worlds of five rooms; those of one seed share their rooms."""
    cache = tmp_path_factory.mktemp("cache")
    made = {}

    def make(kind, strength=4):
        if kind not in made:
            made[kind] = tmp_path_factory.mktemp("world") / "world"
            make_world(kind, strength, SEED, made[kind], n_fit=ROOMS, n_judge=1, cache=cache)
        return made[kind]
    return make


@pytest.fixture(scope="module")
def closed(world, tmp_path_factory):
    """Close the loop on a world: its ledger."""
    found = {}

    def close(kind):
        if kind not in found:
            out = tmp_path_factory.mktemp("loop") / "loop"
            close_loop([world(kind) / "fit"], out, test=[world(kind) / "test"], nj=2)
            found[kind] = out
        return found[kind], read_json(found[kind] / "ledger.json")
    return close


@pytest.fixture(scope="module")
def session(world):
    """The base model, fitted to a clean world."""
    return begin(load_data([world("clean") / "fit"], scattering=SCATTERING, seed=0), seed=0, nj=2)


def test_features_are_in_just_noticeable_differences(world):
    directory = world("clean") / "fit"
    rir = load_rir(directory, read_rirs(directory)[0])
    plain, louder = measure_features(rir), measure_features(10.0 ** 0.15 * rir)
    change = np.where(plain.valid, louder.values - plain.values, np.nan)
    np.testing.assert_allclose(change[HAS_GAIN & plain.valid], 3.0, atol=1e-6)
    assert np.nanmax(np.abs(change[~HAS_GAIN & (METRIC != "floor") & (METRIC != "ahead")])) < 1e-6
    short, long = (np.mean([measure_features(coloured_rir(seed, time_s=time_s, length_s=1.2)).values[feature_slice("t20")][3:]
                            for seed in range(4)]) for time_s in (0.4, 0.42))
    assert long - short == pytest.approx(1.0, abs=0.2)


def test_noise_counts_by_how_much_it_raises_what_any_recording_has():
    """White noise of any level is nothing; a rise of the lowest octave is there in dB, and goes to 0 smoothly."""
    rng = np.random.default_rng(0)
    rir = coloured_rir(1, time_s=0.4, length_s=1.2)
    white = 1e-3 * rng.standard_normal(len(rir))
    low = octave_bands(1e-3 * rng.standard_normal(len(rir)), FS_HZ)[0]

    def floor(noise, **more):
        found = measure_features(rir + noise, **more)
        return found.values[feature_slice("floor")], found.valid[feature_slice("floor")], found.white
    for level in (0.1, 1.0, 4.0):
        values, valid, _ = floor(level * white)
        assert valid.all() and np.abs(values[3:]).max() < 1.5 and np.abs(values).max() < 4.0
    rises = [floor(white + gain * low)[0][0] for gain in (0.0, 0.7, 1.5, 3.0)]
    assert np.all(np.diff(rises) > 0.5) and rises[1] < 5.0 and rises[3] == pytest.approx(9.5, abs=2.0)
    # a rendering has no white noise: it is thought of as having the recording's
    known = floor(white)[2]
    assert floor(3.0 * low, white=known)[0][0] == pytest.approx(rises[3], abs=2.0)
    assert floor(10.0 * low, white=known)[0][0] == pytest.approx(20.0, abs=2.0)
    assert np.abs(floor(0.0 * low, white=known)[0]).max() < 1e-3


def test_a_response_that_ends_before_its_noise_tells_of_it_only_where_its_end_is_quiet():
    long, short = (coloured_rir(1, time_s=time_s, length_s=0.6) for time_s in (1.5, 0.3))
    assert not measure_features(long).valid[feature_slice("floor")][2:].any()  # no decay can be followed in the narrowest octaves
    found = measure_features(short)
    assert found.valid[feature_slice("floor")].all() and np.abs(found.values[feature_slice("floor")]).max() < 1e-3


def test_what_is_believed_ahead_of_a_recordings_direct_sound_can_be_said_of_an_earlier_one():
    rir = coloured_rir(1, time_s=0.3, length_s=0.6)
    recording, rendering = (measure_features(rir[DIRECT - sample:]) for sample in (113, 93))
    believed = recording.valid[feature_slice("ahead")]
    assert believed.any() and not rendering.valid[feature_slice("ahead")].any()
    assert np.isfinite(rendering.values[feature_slice("ahead")][believed]).all()


@pytest.mark.parametrize("late_samples, arrives", [(3, True), (28, False)])
def test_what_comes_too_late_for_the_direct_sound_is_another_path(late_samples, arrives):
    expected, rir = DIRECT, coloured_rir(1, time_s=0.3, length_s=0.6)
    rir[:expected + late_samples] = 0.0
    rir[expected + late_samples] = 1.0
    found = measure_features(rir, expected)
    assert found.valid[feature_slice("arrival")].all() == arrives
    assert found.direct_sample == pytest.approx(expected + late_samples * arrives, abs=0.5)


def test_a_world_against_itself_has_no_error_and_nothing_is_found(session):
    """What a model predicts, taken for the measurement: no error but for the pull of priors, and no effect helps."""
    itself = replace(session.data, features=session.fit.predicted)
    again = fit(itself, session.correction, (), like=session.fit)
    error = np.abs(itself.features - again.predicted)[itself.valid]
    assert error.mean() < 0.02 and error.max() < 0.5
    winner, _ = choose(rank(replace(session, data=itself, fit=again)), len(CATALOGUE))
    assert winner is None


def test_rooms_left_out_are_predicted_by_the_others(session):
    left_out = leave_rooms_out(session.data, session.fit)
    assert len(left_out) == ROOMS
    for one in left_out:
        assert np.isfinite(one.log_density)
        assert 0.0 < np.abs(one.mean - session.fit.mean).max() < 1.0


def test_halves_are_disjoint_and_hold_every_chain(session):
    first, second = halves(session.data)
    for r, (a, b) in enumerate(zip(first, second, strict=True)):
        assert not set(a) & set(b) and set(a) | set(b) == set(np.flatnonzero(session.data.room == r))
        assert set(session.data.chain[a]) == set(session.data.chain[b])


def test_gains_of_chains_that_occur_once_are_sums(session):
    """Chains of several RIRs have their own gain; of others, room, source and microphone have one."""
    data = session.data
    assert all((kinds == 0).all() and (parts.sum(axis=1) == 1).all()
               for parts, kinds in zip(session.packing.gain_of, session.packing.gain_kind, strict=True))
    members = np.flatnonzero(data.room == 0)[:4]
    changed = list(data.rows)
    for k, n in enumerate(members):
        changed[n] = changed[n] | dict(source_id=f"s{k // 2}", mic_id=f"m{k % 2}")
    chain = data.chain.copy()
    chain[members] = data.chain.max() + 1 + np.arange(4)
    packing = ParameterIndex(replace(data, rows=changed, chain=chain), ())
    parts, kinds = packing.gain_of[0], packing.gain_kind[0]
    assert sorted(kinds[parts[:4].any(axis=0)]) == [0, 1, 1, 2, 2]
    gains_db = np.array([10.0, 1.0, -1.0, 0.5, -0.5])
    local = [np.zeros(size) for _, size in packing.own_slices]
    local[0][N_SURFACE + np.flatnonzero(parts[:4].any(axis=0))] = gains_db
    np.testing.assert_allclose(packing.gains(local)[members], [11.5, 10.5, 9.5, 8.5])
    first, second = halves(packing.data)
    assert {len(set(half[0]) & set(members)) for half in (first, second)} == {2}
    for half in (first, second):
        here = [changed[n] for n in half[0] if n in members]
        assert {row["source_id"] for row in here} == {"s0", "s1"} and {row["mic_id"] for row in here} == {"m0", "m1"}


def test_a_room_with_a_single_rir_is_fitted_and_not_scored(world, tmp_path):
    source = world("clean") / "fit"
    rows = read_rirs(source)
    rooms = sorted({row["room_id"] for row in rows})[:3]
    rows = [row for room, n in zip(rooms, (4, 4, 1), strict=True)
            for row in [row for row in rows if row["room_id"] == room][:n]]
    (tmp_path / "few").mkdir()
    write_rirs(tmp_path / "few", relocated(rows, source, tmp_path / "few"))
    session = begin(load_data([tmp_path / "few"], scattering=SCATTERING, seed=0), seed=0, nj=2)
    assert session.data.n_scored == 2 and len(session.fit.local) == 3
    errors = heldout_errors(session)
    for way in errors.features:
        scored = np.isfinite(errors.features[way]).any(axis=1)
        assert (scored == (session.data.room < 2)).all() and len(errors.of_rooms(way)) == 2


@pytest.mark.parametrize("name", CATALOGUE)
def test_every_effect_speaks_for_itself(name, session):
    """Vector and parameters are the same thing, and what an effect does to tables it changes in some feature."""
    effect = CATALOGUE[name]
    for start in effect.STARTS:
        one = effect.from_vector(np.array(start, dtype=float))
        np.testing.assert_allclose(one.vector(), start, atol=1e-9)
    assert np.linalg.eigvalsh(effect.prior_covariance()).min() > 0.0
    look_ahead(session, [effect])
    packing = session.packing
    absorption = packing.absorption(session.fit.mean, session.fit.local)
    state, changed = (packing.state(absorption, []) for _ in range(2))
    moved = effect.from_vector(np.array(effect.STARTS[0]) + 0.5 * np.array(effect.SPREAD))
    moved.apply_to_prediction(changed, session.data, np.arange(len(session.data.rows)))
    assert not np.array_equal(predict(session.data, changed), predict(session.data, state))
    assert effect.DISCRIMINATING_MEASUREMENT


def test_a_clean_world_is_left_alone(closed):
    _, ledger = closed("clean")
    assert ledger["iterations"] == []
    assert ledger["final"] == ledger["baseline"]


@pytest.mark.parametrize("kind", ["source_response", "noise_floor"])
def test_an_effect_that_nobody_declared_is_found(kind, closed):
    out, ledger = closed(kind)
    first = ledger["iterations"][0]
    assert first["effect"] == kind == first["ranking"][0]["effect"]
    assert first["heldout_error_after"] < first["heldout_error_before"] and first["p"] < 0.05
    assert ledger["test"]["after"]["positions"]["error"] < ledger["test"]["before"]["positions"]["error"]
    assert kind in read_model(out / "model.json").names
    validate([out])


def test_a_loop_begins_with_a_given_model(closed, world, tmp_path):
    """Its effect is part of the base model, as it is there, and no candidate again."""
    out, before = closed("noise_floor")
    ledger = close_loop([world("noise_floor") / "fit"], tmp_path / "loop", model=out / "model.json", nj=2)
    assert ledger["given"] == read_model(out / "model.json").names
    assert not {one["effect"] for one in ledger["ranking"]} & set(ledger["given"])
    was, became = (before[when]["positions"]["error"] for when in ("baseline", "final"))
    assert ledger["baseline"]["positions"]["error"] < 0.5 * (was + became)
    assert ledger["iterations"] or (tmp_path / "loop/model.json").read_bytes() == (out / "model.json").read_bytes()
    validate([tmp_path / "loop"])


def test_the_response_that_is_found_is_that_of_the_world(closed, world):
    """Its shape, that is: what is the same at all frequencies is a gain, and nobody knows that."""
    out, _ = closed("source_response")
    (extension,) = [one for one in read_model(out / "model.json").extensions if one.effect is SourceResponse]
    clean, changed = ({row["id"]: (row, load_rir(world(kind) / "fit", row)) for row in read_rirs(world(kind) / "fit")}
                      for kind in ("clean", "source_response"))
    for source_id, found in extension.of.items():
        true_db = np.mean([measure_features(changed[name][1]).values[feature_slice("spectrum")]
                           - measure_features(rir).values[feature_slice("spectrum")]
                           for name, (row, rir) in clean.items() if row["source_id"] == source_id], axis=0)
        shape = np.array(found.gains_db)[:len(true_db)]
        upper = np.array(RESPONSE_HZ)[:len(true_db)] > 200.0
        error_db = (shape - true_db)[upper] - np.mean((shape - true_db)[upper])
        assert np.sqrt(np.mean(error_db ** 2)) < 1.0


def test_what_no_effect_explains_is_said_and_not_named(closed):
    _, ledger = closed("harmonic_distortion")
    assert ledger["iterations"] == []
    assert ledger["unexplained"]["time_region"] == "ahead" and ledger["unexplained"]["size_jnd"] > 2.0


def test_one_loudspeaker_and_one_microphone_cannot_be_told_apart(world, tmp_path):
    directory = tmp_path / "one"
    rows = read_rirs(world("source_response") / "fit")
    directory.mkdir()
    write_rirs(directory, [row | dict(mic_id="the-mic") for row in relocated(
        [row for row in rows if row["source_id"] == "spk1"], world("source_response") / "fit", directory)])
    close_loop([directory], tmp_path / "loop", nj=2)
    first = read_json(tmp_path / "loop" / "ledger.json")["iterations"][0]
    assert {"source_response", "mic_response"} <= set(first["cannot_tell"]) and first["would_tell"]


def test_results_do_not_depend_on_jobs(world, closed, tmp_path):
    out, _ = closed("noise_floor")
    close_loop([world("noise_floor") / "fit"], tmp_path / "loop", test=[world("noise_floor") / "test"], nj=1)
    for name in ("ledger.json", "model.json"):
        assert (tmp_path / "loop" / name).read_bytes() == (out / name).read_bytes()


@pytest.mark.parametrize("argv, message", [
    (["{two}", "--out", "out"], "RIRs of 2 rooms"),
    (["{two}", "--out", "out", "--max-effects", "-1"], "max_effects=-1 must lie in"),
    (["{two}", "{two}", "--out", "out"], "give each RIR once"),
    (["absent", "--out", "out"], "absent"),
])
def test_bad_input_is_one_line(argv, message, world, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    source = world("clean") / "fit"
    rows = read_rirs(source)
    rooms = sorted({row["room_id"] for row in rows})[:2]
    rows = [row for row in rows if row["room_id"] in rooms]
    two = tmp_path / "two"
    two.mkdir()
    write_rirs(two, relocated(rows, source, two))
    assert main(["close-loop", *(word.replace("{two}", str(two)) for word in argv)]) == 1
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 1 and message in lines[0] and not (tmp_path / "out").exists()


