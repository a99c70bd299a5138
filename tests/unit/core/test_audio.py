"""Audio files that are cut off, or whose headers are odd."""

import numpy as np
import pytest
import soundfile

from roomeq.core.audio import read_audio

SAMPLES = np.random.default_rng(0).uniform(-0.5, 0.5, 16000)


@pytest.mark.parametrize("fmt", ["WAV", "AIFF", "AU", "RF64", "W64"])
@pytest.mark.parametrize("missing", [40, 16000])
def test_files_that_are_cut_off_are_refused(tmp_path, fmt, missing):
    path = tmp_path / f"a.{fmt.lower()}"
    soundfile.write(path, SAMPLES, 16000, format=fmt, subtype="PCM_16")
    assert len(read_audio(path)) == 16000
    path.write_bytes(path.read_bytes()[:-missing])
    with pytest.raises(ValueError, match=r"truncated: \d+ bytes of \d+: copy it again"):
        read_audio(path)


def test_wav_file_that_states_the_length_of_the_whole_file_is_read(tmp_path):
    path = tmp_path / "a.wav"
    soundfile.write(path, SAMPLES, 16000, subtype="PCM_16")
    data = path.read_bytes()
    path.write_bytes(data[:4] + len(data).to_bytes(4, "little") + data[8:])
    assert len(read_audio(path)) == 16000
    path.write_bytes(data[:-8])  # states 8 bytes more than there are as well, but lacks samples
    with pytest.raises(ValueError, match="truncated"):
        read_audio(path)


def test_flac_file_without_a_length_is_refused_with_the_reason(tmp_path):
    path = tmp_path / "a.flac"
    soundfile.write(path, SAMPLES, 16000)
    data = bytearray(path.read_bytes())
    data[21] &= 0xF0  # the number of samples, 36 bits
    data[22:26] = bytes(4)
    path.write_bytes(data)
    with pytest.raises(ValueError, match="its header does not state its length, .* encode it again"):
        read_audio(path)


@pytest.mark.parametrize("fmt, subtype", [("MP3", "MPEG_LAYER_III"), ("OGG", "VORBIS"), ("OGG", "OPUS"),
                                          ("FLAC", "PCM_16"), ("WAV", "IMA_ADPCM"), ("WAV", "GSM610")])
def test_segment_holds_the_samples_of_the_whole_file(tmp_path, fmt, subtype):
    time_s = np.arange(10 * 16000) / 16000
    chirp = 0.3 * np.sin(2 * np.pi * (200 + 100 * time_s) * time_s) * (np.sin(8 * time_s) > 0)
    soundfile.write(tmp_path / "a", chirp, 16000, format=fmt, subtype=subtype)
    whole = read_audio(tmp_path / "a")
    for start in range(0, 150000, 13131):
        np.testing.assert_allclose(read_audio(tmp_path / "a", start=start, stop=start + 4000),
                                   whole[start:start + 4000], atol=1e-6)
