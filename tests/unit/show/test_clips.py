"""Audio players: what is heard, at which level."""

import base64
import io

import numpy as np
import pytest
import soundfile
from rirmaker import coloured_rir

from roomeq.core.audio import write_wav
from roomeq.show.clips import clips, dry_signal


def sound(clip):
    return soundfile.read(io.BytesIO(base64.b64decode(clip.src.partition(",")[2])))


@pytest.mark.parametrize("fs_hz", [8000, 16000, 48000])
def test_sounds_have_equal_energy_and_do_not_clip(fs_hz):
    rirs = [("A", "measured", coloured_rir(0), fs_hz), ("B", "simulated", 20.0 * coloured_rir(1), fs_hz)]
    made = clips(rirs, None)
    assert [clip.label for clip in made] == ["noise bursts, dry", "noise bursts, A", "noise bursts, B",
                                            "impulse response, A", "impulse response, B"]
    heard = [sound(clip) for clip in made]
    assert {rate for _, rate in heard} == {fs_hz} and max(np.abs(samples).max() for samples, _ in heard) < 0.91
    energies = [np.sum(samples ** 2) for samples, _ in heard[:3]]
    assert np.ptp(10 * np.log10(energies)) < 0.1


def test_speech_is_resampled_and_heard_through_the_rir(tmp_path):
    speech = 0.1 * np.sin(np.arange(48000))
    write_wav(tmp_path / "speech.wav", speech, 48000)
    name, dry = dry_signal(tmp_path / "speech.wav", 16000)
    assert name == "speech" and len(dry) == 16000
    write_wav(tmp_path / "late.wav", np.concatenate([np.zeros(9 * 48000), speech]), 48000)
    assert len(dry_signal(tmp_path / "late.wav", 16000)[1]) == 16000  # from the first sound on
    made = clips([("A", "measured", np.eye(1, 800)[0], 16000)], tmp_path / "speech.wav", with_responses=False)
    dry_sound, heard = (sound(clip)[0] for clip in made)
    assert np.allclose(heard[:16000], dry_sound, atol=1e-4) and len(made) == 2


def test_rumble_and_offset_of_speech_do_not_count_as_sound(tmp_path):
    """All reflections of a constant or of a low frequency add up in simulated RIRs."""
    time_s, rir = np.arange(32000) / 16000, np.abs(coloured_rir(0))
    levels_db = []
    for rumble in (0.0, 0.05):
        speech = 0.05 * np.random.default_rng(0).standard_normal(32000) + rumble * (1.0 + np.cos(20.0 * time_s))
        write_wav(tmp_path / "speech.wav", speech)
        for clip in clips([("A", "simulated", rir, 16000)], tmp_path / "speech.wav", with_responses=False):
            levels_db.append(10 * np.log10(np.sum(np.abs(np.fft.rfft(sound(clip)[0], 64000)[80:]) ** 2)))
    assert levels_db[2] - levels_db[3] == pytest.approx(levels_db[0] - levels_db[1], abs=0.3)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
def test_rir_is_heard_from_its_direct_sound_on(noise):
    """However long the file is before it, and without a click where it is cut off."""
    rir = np.concatenate([np.zeros(5 * 16000), 10.0 * coloured_rir(0, time_s=7.0, length_s=5.0)])
    rir += noise * np.random.default_rng(0).standard_normal(len(rir))
    made = clips([("A", "measured", rir, 16000)], None)
    heard, response = (sound(clip)[0] for clip in made[1:])
    assert len(response) == 3 * 16000 and np.abs(response[:2000]).max() > 0.1
    assert np.abs(response[-16:]).max() < 1e-3 and np.abs(heard[:8000]).max() > 0.1


def test_silent_speech_is_refused(tmp_path):
    write_wav(tmp_path / "speech.wav", np.zeros(100))
    with pytest.raises(ValueError, match="speech.wav: silent"):
        dry_signal(tmp_path / "speech.wav", 16000)
