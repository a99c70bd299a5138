"""A `rirs.jsonl` written by hand, with names and geometry only, goes through every verb that takes an RIR directory."""

import subprocess
import sys

import pytest
from datadirs import speech_dir
from rirmaker import coloured_rir

from roomeq.cli import main
from roomeq.core.audio import write_wav
from roomeq.core.files import read_json, write_jsonl, write_text
from roomeq.records.rir_dir import read_rirs
from roomeq.validate import validate

KEYS = {"id", "wav", "room_id", "source_id", "mic_id", "room_dims_m", "source_pos_m", "mic_pos_m"}


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Run the verbs on eight RIRs of four rooms; the microphones of the last room were not located."""
    where = tmp_path_factory.mktemp("hand")
    for folder, first in (("rirs", 0), ("others", 8)):
        rows = []
        for n in range(8):
            name, mic_pos_m = f"r{first + n}", [2 + n / 4, 2, 1.2] if n < 6 else None
            write_wav(where / f"{folder}/{name}.wav", coloured_rir(first + n, time_s=0.3 + 0.05 * n))
            rows.append(dict(id=name, wav=f"{name}.wav", room_id=f"room{n // 2}", source_id="speaker", mic_id="omni",
                             room_dims_m=[5, 4, 3], source_pos_m=[1, 1, 1.5], mic_pos_m=mic_pos_m))
        write_jsonl(where / folder / "rirs.jsonl", sorted(rows, key=lambda row: row["id"]))
    speech_dir(where / "speech")
    rirs, out = str(where / "rirs"), {verb: str(where / verb) for verb in (
        "characterise", "split", "simulate", "fit", "compensate", "augment", "loop")}
    for words in (["characterise", rirs, out["characterise"]], ["split-rirs", rirs, out["split"]],
                  ["simulate", "--num-rays", "500", rirs, out["simulate"]],
                  ["fit-eq", "--num-components", "2", rirs, out["simulate"], out["fit"]],
                  ["compensate", rirs, out["fit"], out["compensate"]],
                  ["augment", str(where / "speech"), rirs, out["augment"]]):
        assert main(words) == 0, words
    loop = ["close-loop", "--max-effects", "0", "--test", str(where / "others"), "--out", out["loop"], rirs]
    done = subprocess.run([sys.executable, "-m", "roomeq", *loop], capture_output=True, text=True, check=True)
    write_text(where / "close-loop.log", done.stderr)
    return where


def test_rows_hold_names_and_geometry_only(made):
    assert all(set(row) == KEYS | {"fs_hz", "n_samples"} for row in read_rirs(made / "rirs"))
    assert '"fs_hz"' not in (made / "rirs/rirs.jsonl").read_text()


def test_every_output_is_valid(made):
    validate([made / name for name in ("rirs", "characterise", "split.train", "simulate", "compensate", "augment",
                                       "loop")])


def test_log_and_ledger_count_the_rirs_that_the_loop_left_out(made):
    ledger = read_json(made / "loop/ledger.json")
    reason = "x and y of microphone are unknown"
    left_out = [dict(reason=reason, rirs=2, rooms=1)]
    assert (ledger["rirs"], ledger["rooms"], ledger["left_out"]) == (6, 3, left_out)
    assert (ledger["test"]["rirs"], ledger["test"]["left_out"]) == (6, left_out)
    log = (made / "close-loop.log").read_text()
    assert f"\nleft out 2 RIRs of 1 room: {reason}\ntest set: left out 2 RIRs of 1 room: {reason}\n" in f"\n{log}"
