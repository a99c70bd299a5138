"""Gains of recordings, those of a chain and of a session; and what a fit reads off the recordings."""

from types import SimpleNamespace

import numpy as np
import pytest
from rirmaker import coloured_rir, write_rir_dir

from roomeq.effects.noise_floor import NoiseFloor
from roomeq.loop.data import load_data
from roomeq.loop.fit import fit
from roomeq.loop.heldout_errors import heldout_errors
from roomeq.loop.packing import _gains
from roomeq.loop.session import fit_base_model
from roomeq.loop.splitters import split_positions
from roomeq.loop.usable import usable_rirs

QUIETER_DB = 12.0


def loaded(where, quieter_db, session):
    """Load three rooms of six RIRs with one chain, every second of which is quieter and of another session."""
    rows = [dict(id=f"{room}{n}", wav=f"{room}{n}.wav", room_id=room, source_id="s", mic_id="m",
                 room_dims_m=[6.0, 5.0, 3.0], source_pos_m=[1.0, 1.0, 1.5], mic_pos_m=[2.0 + 0.4 * n, 3.0, 1.3],
                 session=session[n % 2]) for room in "abc" for n in range(6)]
    rirs = [(row, 10.0 ** (-quieter_db * (n % 2) / 20.0) * coloured_rir(n, time_s=0.3 + 0.05 * (n // 6)))
            for n, row in enumerate(rows)]
    return load_data(usable_rirs([write_rir_dir(where, rirs)]), scattering=0.3, seed=0)


@pytest.fixture(scope="module")
def two_sessions(tmp_path_factory):
    return loaded(tmp_path_factory.mktemp("sessions") / "rirs", QUIETER_DB, ("monday", "tuesday"))


def test_gain_of_a_chain_may_differ_between_sessions(two_sessions, tmp_path):
    session = fit_base_model(two_sessions, seed=0, nj=1)
    gains_db = session.index.gains(session.fit.local)
    np.testing.assert_allclose(gains_db[::2].mean() - gains_db[1::2].mean(), QUIETER_DB, atol=1.0)
    same_gain = heldout_errors(fit_base_model(loaded(tmp_path / "rirs", 0.0, (None, None)), seed=0, nj=1))
    for split in same_gain.by_split:
        assert heldout_errors(session).mean(split) == pytest.approx(same_gain.mean(split), abs=0.1)


def test_halves_have_rirs_of_each_session(two_sessions):
    for half in split_positions(two_sessions):
        assert all({two_sessions.rows[n]["session"] for n in of_room} == {"monday", "tuesday"} for of_room in half)


def test_single_rirs_of_devices_share_a_gain_within_their_session():
    rows = [dict(source_id=f"s{n // 2 % 2}", mic_id=f"m{n % 2}", session=session)
            for n, session in enumerate(["a"] * 4 + ["b"] * 4)]
    data = SimpleNamespace(rows=rows, chain=np.arange(8), comparable=np.full(8, True))
    design, kinds = _gains(data, np.arange(8))
    assert kinds.tolist() == [0, 0, 1, 1, 2, 2]
    np.testing.assert_array_equal(design[:, :2], np.repeat(np.eye(2), 4, axis=0))
    data.rows = [row | {"session": None} for row in rows]
    assert _gains(data, np.arange(8))[1].tolist() == [0, 1, 1, 2, 2]


def test_fit_reads_what_is_measured_once(two_sessions, monkeypatch):
    read, calls = NoiseFloor.measured_vectors, []
    monkeypatch.setattr(NoiseFloor, "measured_vectors", lambda data: calls.append(data) or read(data))
    fit(two_sessions, np.zeros(two_sessions.features.shape), (NoiseFloor,), iterations=1)
    assert len(calls) == 1
