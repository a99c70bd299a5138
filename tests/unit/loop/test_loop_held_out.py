"""A test set shares no recording with the RIRs that the loop is closed on."""

import re

import numpy as np
import pytest
from rirmaker import coloured_rir, row, write_rir_dir

from roomeq.loop.held_out import require_held_out
from roomeq.loop.step import close_loop
from roomeq.loop.usable import usable_rirs

ROOMS = ("x", "y", "z")


def place(n):
    return dict(source_pos_m=[1.0, 1.0, 1.5], mic_pos_m=[3.0 + n, 3.0, 1.2])


def rir_dir(where, first, rooms=ROOMS):
    """Write two RIRs a room, whose ids and recordings are numbered from the first on."""
    return write_rir_dir(where, [(row(f"r{first + n}", room, **place(n % 2)), coloured_rir(first + n, time_s=0.3))
                                 for n, room in enumerate(np.repeat(rooms, 2))])


def shortened(rir):
    """Return a recording without most of its time of flight and its end, inverted, at another level and in 16 bits."""
    return np.round(-0.4 * rir[250:-1000] * 2 ** 15) / 2 ** 15


def held_out(test, rirs):
    require_held_out(usable_rirs([test]).rirs, usable_rirs([rirs]).rirs)


def test_set_that_is_trained_on_is_refused_as_test_set(tmp_path):
    rirs = rir_dir(tmp_path / "rirs", 0)
    with pytest.raises(ValueError) as refused:
        close_loop([rirs], tmp_path / "loop", test=[rirs])
    assert str(refused.value) == (
        f"test set: {rirs}/audio/r0.wav: RIR r0 of room x is in {rirs} as well: the error of a test set is that of "
        "recordings which took no part in a fit: take it out of one of the two sets")
    assert not (tmp_path / "loop").exists()


@pytest.mark.parametrize("change", [lambda rir: rir, shortened])
def test_copy_under_another_id_and_room_is_refused(tmp_path, change):
    rirs = rir_dir(tmp_path / "rirs", 0)
    test = write_rir_dir(tmp_path / "test", [(row("other", "x", **place(0)), coloured_rir(9)),
                                             (row("same", "hall", suspicious=None, **place(0)),
                                              change(coloured_rir(3, time_s=0.3)))])
    with pytest.raises(ValueError, match=re.escape(
            f"test set: {test}/audio/same.wav: RIR same of room hall is the recording of RIR r3 of room y in {rirs}: "
            "the error of a test set")):
        held_out(test, rirs)


def test_rooms_positions_and_ids_of_other_rooms_may_be_in_both(tmp_path):
    rirs = rir_dir(tmp_path / "rirs", 0)
    held_out(rir_dir(tmp_path / "same_rooms", 10), rirs)
    held_out(write_rir_dir(tmp_path / "same_id", [(row("r0", "hall", **place(0)), coloured_rir(9))]), rirs)
