"""Calibration of rooms from a part of their RIRs."""

from dataclasses import replace

import numpy as np
import pytest
from plans import L_PLAN, prism_obj
from rirmaker import coloured_rir, write_rir_dir

from roomeq.loop.data import load_data
from roomeq.loop.features import HAS_GAIN, METRIC
from roomeq.loop.heldout_errors import _USABLE, heldout_errors, transferred
from roomeq.loop.session import fit_base_model
from roomeq.loop.splitters import split_positions
from roomeq.loop.usable import usable_rirs

QUIETER_DB = 26.0
FREE_M, HIDDEN_M = ([1.5, 1.2, 1.3], [2.5, 0.8, 1.3]), ([1.0, 5.0, 1.3], [0.7, 4.5, 1.3])


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    """Load three rooms, in each of which one microphone sees the source and another does not."""
    where = tmp_path_factory.mktemp("hidden")
    (where / "l.obj").write_text(prism_obj(L_PLAN, 3.0))
    rows = [dict(id=f"{room}{mic}{n}", wav=f"{room}{mic}{n}.wav", room_id=room, source_id="s", mic_id=mic,
                 mesh="../l.obj", source_pos_m=[5.0, 1.0, 1.5], mic_pos_m=mic_m)
            for room in "abc" for mic, of_mic in (("free", FREE_M), ("hidden", HIDDEN_M))
            for n, mic_m in enumerate(of_mic)]
    rirs = [(row, coloured_rir(n, time_s=0.3 + 0.05 * (n // 4))) for n, row in enumerate(rows)]
    return load_data(usable_rirs([write_rir_dir(where / "rirs", rirs)]), scattering=0.3, seed=0)


def quieter(data):
    return replace(data, features=data.features - QUIETER_DB * HAS_GAIN)


@pytest.mark.parametrize("normalised", [False, True])
def test_hidden_rirs_are_scored_alike_at_any_gain_of_the_recording(rooms, normalised):
    data = replace(rooms, comparable=np.full(len(rooms.rows), not normalised))
    hidden = ~(data.valid & (METRIC == "direct")[None]).any(axis=1)
    assert hidden.sum() == 6
    of_loud, of_quiet = (heldout_errors(fit_base_model(data, seed=0, nj=1)) for data in (data, quieter(data)))
    for split, errors in of_loud.by_split.items():
        assert np.nanmean(np.abs(of_quiet.by_split[split] - errors)[hidden]) < 0.05
        assert np.nanmean(errors[hidden]) < 4.0


def test_gains_of_hidden_rirs_of_a_test_set_follow_their_level(rooms):
    session = fit_base_model(rooms, seed=0, nj=1)
    known, _ = split_positions(rooms)
    loud, quiet = (transferred(data, session)[1](known, _USABLE["leave_room_out"]) for data in (rooms, quieter(rooms)))
    np.testing.assert_allclose(loud[2] - quiet[2], QUIETER_DB, atol=0.2)
    np.testing.assert_allclose(loud[0], quiet[0], rtol=0.01)


def test_levels_tell_no_gain_of_which_the_direct_sound_tells(rooms):
    data = rooms
    free = (data.valid & (METRIC == "direct")[None]).any(axis=1)
    session, usable = fit_base_model(data, seed=0, nj=1), _USABLE["leave_room_out"]
    known, _ = split_positions(data)
    disturbed = replace(data, features=data.features + 3.0 * np.isin(METRIC, ("early", "late", "spectrum")))
    one, other = (transferred(of_test, session)[1](known, usable) for of_test in (data, disturbed))
    np.testing.assert_array_equal(one[2][free], other[2][free])
    np.testing.assert_array_equal(one[0], other[0])


def test_rirs_of_one_place_are_in_the_same_half(rooms):
    source, mic = np.arange(12) // 2 % 2, np.arange(12) % 4
    first, second = split_positions(replace(rooms, place_number=2 * rooms.room + source, chain=4 * rooms.room + mic))
    for of_room in zip(first, second, strict=True):
        places = [set(source[half]) for half in of_room]
        assert all(len(half) == 2 for half in of_room) and not places[0] & places[1]
    one_place = replace(rooms, place_number=np.where(rooms.room == 1, 4, np.arange(12) + 5))
    first, second = split_positions(one_place)
    assert [len(half) for half in second] == [2, 0, 2] and list(one_place.is_scored) == [True, False, True]
