"""The facing of loudspeakers: which hypothesis the direct sounds support, and the axes that follow."""

from dataclasses import dataclass, field, replace
from types import SimpleNamespace

import numpy as np
import pytest
from rirmaker import coloured_rir, write_rir_dir

from roomeq.effects.model import Extension, Model, read_model, write_model
from roomeq.effects.source_directivity import SourceDirectivity
from roomeq.loop import facing
from roomeq.loop.close import _faced_base_model, _facings
from roomeq.loop.data import load_data
from roomeq.loop.facing import _log_likelihood, estimate_facings, unknown_facings
from roomeq.loop.heldout_errors import transferred
from roomeq.loop.packing import N_SURFACE, ParameterIndex
from roomeq.loop.step import close_loop
from roomeq.loop.usable import usable_rirs

SOURCES_M = [(2.0, 2.0, 1.2), (6.0, 4.0, 1.2), (2.0, 5.0, 1.2)]
MICS_M = [(4.0, 3.0, 1.2), (5.0, 2.0, 1.2), (3.0, 4.5, 1.2)]
OF_POSITIONS = np.repeat([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [-0.6, 0.8, 0.0]], len(MICS_M), axis=0)
"""An axis for each position of the loudspeaker."""


@dataclass
class Rirs:
    """RIRs of one loudspeaker at three positions, each with three microphones, as far as facings need them."""

    places: list = field(default_factory=lambda: [SimpleNamespace(source_pos_m=source_m, mic_pos_m=mic_m)
                                                  for source_m in SOURCES_M for mic_m in MICS_M])
    facings: tuple = ()
    given_kinds: frozenset = frozenset()
    axis: np.ndarray = field(default_factory=lambda: np.empty(0, dtype=int))
    rows: list = field(default_factory=lambda: [dict(source_id="ls", room_id="room", room_dims_m=[8.0, 6.0, 3.0])
                                                for _ in SOURCES_M for _ in MICS_M])

    documented: list = field(default_factory=lambda: [dict(room_dims_m=[8.0, 6.0, None], mic_pos_m=mic_m)
                                                      for _ in SOURCES_M for mic_m in MICS_M])

    @property
    def towards(self):
        directions = np.array([np.subtract(place.mic_pos_m, place.source_pos_m) for place in self.places])
        return directions / np.linalg.norm(directions, axis=1, keepdims=True)


def estimate(rirs, axes, monkeypatch, sharpness=4.0, alike=-np.inf):
    """Estimate facings from direct sounds that tell the angle to true axes; return the estimate and the axes.

    `alike`: log likelihood of each direct sound if the loudspeaker has no directivity.
    """
    return estimate_from(rirs, log_likelihood(rirs, axes, sharpness)[None], alike, monkeypatch)


def log_likelihood(rirs, axes, sharpness=4.0, scale=1.0):
    """Log likelihood of each direct sound at `_TEST_ANGLES`, largest at the angle to its axis times a scale."""
    angle = scale * np.arccos(np.clip(np.sum(rirs.towards * axes, axis=1), -1.0, 1.0))
    return -0.5 * (sharpness * (facing._TEST_ANGLES - angle[:, None])) ** 2


def estimate_from(rirs, of_angles, alike, monkeypatch):
    """Estimate facings from log likelihoods, for each assumed directivity; return the estimate and the axes.

    RIRs share axes as the hypothesis says.
    """
    found = {}
    monkeypatch.setattr(facing, "_log_likelihood", lambda *_: (of_angles, np.full((1, len(rirs.rows)), alike)))
    monkeypatch.setattr(facing, "with_facings", lambda data, facings, **_: found.update(facings) or data)
    data = estimate_facings(rirs, SimpleNamespace(effects=()), *[None] * 4)
    (estimated,) = data.facings
    n_axes = {"towards the microphone": 0, "fixed": estimated.positions, "free": len(rirs.rows)}[estimated.hypothesis]
    assert sorted(set(data.axis)) == (list(range(n_axes)) if n_axes else [-1])
    return estimated, np.array([found[n] for n in range(len(rirs.rows))])


def degrees(axes, others):
    return np.degrees(np.arccos(np.clip(np.sum(axes * others, axis=1), -1.0, 1.0)))


def test_loudspeaker_turned_to_each_microphone_is_recognised(monkeypatch):
    rirs = Rirs()
    estimated, axes = estimate(rirs, rirs.towards, monkeypatch)
    assert estimated.hypothesis == "towards the microphone" and max(estimated.evidence.values()) < 0.0
    assert degrees(axes, rirs.towards).max() < 0.1 and estimated.angle_deg < 0.1


def test_axis_of_each_position_follows_from_all_its_microphones(monkeypatch):
    rirs = Rirs()
    estimated, axes = estimate(rirs, OF_POSITIONS, monkeypatch)
    assert estimated.hypothesis == "fixed" and estimated.positions == 3 and estimated.rirs == 9
    assert degrees(axes, OF_POSITIONS).max() < 12.0


def test_loudspeaker_turned_between_recordings_has_an_axis_for_each(monkeypatch):
    rirs, rng = Rirs(), np.random.default_rng(0)
    azimuth = rng.uniform(0.0, 2.0 * np.pi, len(rirs.rows))
    true = np.column_stack([np.cos(azimuth), np.sin(azimuth), np.zeros(len(azimuth))])
    estimated, axes = estimate(rirs, true, monkeypatch)
    assert estimated.hypothesis == "free" and estimated.evidence["free"] > estimated.evidence["fixed"] + 3.0
    error = np.abs(degrees(axes, rirs.towards) - degrees(true, rirs.towards))
    assert error.max() < 12.0


def test_direct_sounds_that_tell_nothing_leave_the_microphone_as_the_axis(monkeypatch):
    rirs = Rirs()
    estimated, axes = estimate(rirs, -rirs.towards, monkeypatch, sharpness=0.05)
    assert estimated.hypothesis == "towards the microphone"
    assert degrees(axes, rirs.towards).max() < 0.1


@pytest.mark.parametrize("room_id", ["room", "the same room with open curtains"])
def test_states_of_a_room_share_the_axis_at_a_position(room_id, monkeypatch):
    rirs = Rirs()
    for row in rirs.rows[::2]:
        row |= dict(room_id=room_id, room_dims_m=[8.0, 6.0, 3.1])  # as estimated of this state
    estimated, _ = estimate(rirs, np.tile([[0.0, 1.0, 0.0]], (len(rirs.rows), 1)), monkeypatch)
    assert estimated.positions == len(SOURCES_M)


def test_states_of_a_room_tell_of_a_direct_sound_once(monkeypatch):
    """Five states share each direct sound, and with it an error: they tell no more than one."""
    away = np.tile([[0.0, 1.0, 0.0]], (len(Rirs().rows), 1))
    once, _ = estimate(Rirs(), away, monkeypatch)
    states = Rirs()
    for name in ("places", "documented"):
        setattr(states, name, 5 * getattr(states, name))
    states.rows = [{**row, "room_id": f"state {state}", "room_dims_m": [8.0, 6.0, 3.0 + 0.1 * state]}  # as estimated
                   for state in range(5) for row in states.rows]
    estimated, axes = estimate(states, np.tile(away, (5, 1)), monkeypatch)
    assert (estimated.positions, estimated.hypothesis) == (once.positions, once.hypothesis)
    assert estimated.evidence == pytest.approx(once.evidence)
    assert len(np.unique(axes.reshape(5, -1), axis=0)) == 1


def test_loudspeaker_without_directivity_has_no_facing(monkeypatch):
    rirs = Rirs()
    half_away = np.cross(rirs.towards, [0.0, 0.0, 1.0])
    assert estimate(rirs, half_away, monkeypatch)[0].hypothesis == "free"
    estimated, axes = estimate(rirs, half_away, monkeypatch, alike=0.0)
    assert estimated.hypothesis == "towards the microphone" and degrees(axes, rirs.towards).max() < 0.1


def test_directivity_is_assumed_that_fits_the_direct_sounds(monkeypatch):
    """Of two assumed directivities, one fits direct sounds at the true angles; the axes are those that it tells."""
    rirs = Rirs()
    of_angles = [log_likelihood(rirs, OF_POSITIONS, scale=0.5) - 5.0, log_likelihood(rirs, OF_POSITIONS)]
    estimated, axes = estimate_from(rirs, np.stack(of_angles), -np.inf, monkeypatch)
    assert estimated.hypothesis == "fixed"
    assert degrees(axes, OF_POSITIONS).max() < 12.0


DIRECTIVITY = SourceDirectivity.from_vector([np.log(0.12), np.log(0.4), *[0.5] * 24])


def three_rooms(where, source_dir, rooms="abc"):
    """Write an RIR directory of three rooms with four RIRs each of one loudspeaker."""
    rows = [dict(id=f"{room}{n}", wav=f"{room}{n}.wav", room_id=room, source_id="ls", mic_id="m",
                 room_dims_m=[6.0, 5.0, 3.0], source_pos_m=[1.0 + 2.0 * (n % 2), 1.0, 1.5],
                 mic_pos_m=[2.0 + 0.6 * n, 3.0, 1.3], source_dir=source_dir) for room in rooms for n in range(4)]
    rirs = [(row, coloured_rir(n + 4 * ord(rooms[0]), time_s=0.3 + 0.05 * (n // 4))) for n, row in enumerate(rows)]
    return write_rir_dir(where, rirs)


def loaded(where, source_dir, model=None):
    return load_data(usable_rirs([three_rooms(where, source_dir)]), scattering=0.3, seed=0, model=model)


def test_directivity_that_is_fitted_does_not_take_part_and_a_given_one_does(tmp_path):
    """A fitted one would confirm the facings that it was fitted with."""
    fitted = loaded(tmp_path / "rirs", [0.0, 1.0, 0.0])
    given = replace(fitted, given=[[DIRECTIVITY]] * len(fitted.rows))
    spread = np.ones(fitted.features.shape[1])
    found = []
    for data, effects in ((fitted, (SourceDirectivity,)), (given, ())):
        index = ParameterIndex(data, effects)
        mean, local = np.full(index.n_shared, -1.0), [np.zeros(part.size) for part in index.local]
        mean[N_SURFACE:] = DIRECTIVITY.vector() if effects else []
        residual = data.features - index.predict(index.absorption(mean, local), index.vectors(mean, local),
                                                 index.gains(local), 0.0)
        found.append(_log_likelihood(data, index, mean, local, residual, spread))
    (of_cabinets, alike), (of_all, alike_given) = found
    assert len(of_cabinets) == len(facing._SCALES) * len(SourceDirectivity.STARTS)
    assert len(of_all) == len(of_cabinets) + len(facing._SCALES)
    np.testing.assert_allclose(of_all[:len(of_cabinets)], of_cabinets, atol=1e-6)
    np.testing.assert_allclose(alike_given, alike, atol=1e-6)


def test_base_model_with_a_directivity_is_fitted_with_its_facings(tmp_path):
    vector = DIRECTIVITY.vector()
    model = Model((Extension(SourceDirectivity, {"ls": DIRECTIVITY}, vector, np.zeros(len(vector))),))
    data = loaded(tmp_path / "rirs", None, model)
    session = _faced_base_model(data, unknown_facings(data), seed=0, nj=1)
    index, fitted = session.index, session.fit
    assert not len(unknown_facings(session.data))
    np.testing.assert_allclose(fitted.predicted, index.predict(
        index.absorption(fitted.mean, fitted.local), index.vectors(fitted.mean, fitted.local),
        index.gains(fitted.local), session.correction), atol=1e-6)
    test_data, _ = transferred(loaded(tmp_path / "test", None, model), session)
    assert not len(unknown_facings(test_data)) and [found.rirs for found in test_data.facings] == [12]


def test_model_holds_the_facings_of_the_test_set_and_of_other_rirs_of_the_base_model(tmp_path):
    vector = DIRECTIVITY.vector()
    base = Model((Extension(SourceDirectivity, {"ls": DIRECTIVITY}, vector, np.zeros(len(vector))),),
                 {"other": [1.0, 0.0, 0.0], "a0": [1.0, 0.0, 0.0], "d0": [1.0, 0.0, 0.0]},
                 {"elsewhere": {"source ls": 1.4}})
    write_model(tmp_path / "base.json", base)
    fit, test = (three_rooms(tmp_path / rooms, [0.0, -1.0, 0.0], rooms) for rooms in ("abc", "def"))
    close_loop([fit], tmp_path / "loop", test=[test], model=tmp_path / "base.json", max_effects=0)
    model = read_model(tmp_path / "loop/model.json")
    assert model.facings == {f"{room}{n}": [0.0, -1.0, 0.0] for room in "abcdef" for n in range(4)} | {
        "other": [1.0, 0.0, 0.0]}
    assert model.heights_m == base.heights_m


def test_model_holds_the_facings_of_sources_that_face_no_microphone():
    rirs = Rirs()
    rows = [dict(id="away", source_dir=[0.0, 2.0, 0.0]), dict(id="towards", source_dir=rirs.towards[1].tolist())]
    assert _facings(SimpleNamespace(rows=rows, places=rirs.places[:2])) == {"away": [0.0, 1.0, 0.0]}
