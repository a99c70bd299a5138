"""Speak lines of text with eSpeak NG, in a process of its own.

eSpeak NG is under the GPL, so it's loaded here only and never by the toolkit. Used by make_standin_speech.py:
every line of standard input is a JSON object {voice, rate_wpm, pitch, pitch_range, seed, text}; for each, standard
output gets an 8-byte little-endian byte count and that many bytes of 16-bit mono samples at `FS_HZ`.
"""

import ctypes
import json
import os
import struct
import sys

FS_HZ = 22050
_AUDIO_SYNCHRONOUS, _DONT_EXIT, _UTF8 = 2, 0x8000, 1
_RATE, _PITCH, _RANGE = 1, 3, 4
_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.c_void_p)


def load():
    """Return eSpeak NG, ready to speak.

    Raises
    ------
    RuntimeError
        If it doesn't start or has another sample rate.
    """
    import espeakng_loader

    library = ctypes.CDLL(espeakng_loader.get_library_path())
    data_path = espeakng_loader.get_data_path().encode()
    fs_hz = library.espeak_Initialize(_AUDIO_SYNCHRONOUS, 500, data_path, _DONT_EXIT)
    if fs_hz != FS_HZ:
        raise RuntimeError(f"eSpeak NG's rate is {fs_hz} Hz and must be {FS_HZ} Hz: reinstall espeakng-loader")
    library.espeak_ng_SetRandSeed.argtypes = [ctypes.c_long]
    return library


def speak(library, voice, rate_wpm, pitch, pitch_range, seed, text):
    """Return one utterance as bytes of 16-bit samples at `FS_HZ`.

    Parameters
    ----------
    library : ctypes.CDLL
    voice : str
        Language and variant, such as ``"en-us+f3"``.
    rate_wpm : int
        Words a minute, 80-450.
    pitch, pitch_range : int
        0-100; 50 is the variant's own.
    seed : int
        Of the breath in the voice, which starts from the time of day otherwise.
    text : str

    Raises
    ------
    RuntimeError
        If there is no such voice or nothing is heard.
    """
    chunks = []

    @_CALLBACK
    def keep(samples, count, _events):
        if samples and count:
            chunks.append(ctypes.string_at(samples, 2 * count))
        return 0

    library.espeak_SetSynthCallback(keep)
    library.espeak_ng_SetRandSeed(seed)
    failed = library.espeak_SetVoiceByName(voice.encode())
    for parameter, value in ((_RATE, rate_wpm), (_PITCH, pitch), (_RANGE, pitch_range)):
        failed |= library.espeak_SetParameter(parameter, value, 0)
    data = text.encode()
    failed |= library.espeak_Synth(data, len(data) + 1, 0, 0, 0, _UTF8, None, None)
    if failed or not chunks:
        raise RuntimeError(f"eSpeak NG doesn't speak {text!r} with voice {voice!r}: reinstall espeakng-loader")
    return b"".join(chunks)


def main():
    """Answer requests until standard input ends."""
    library = load()
    for line in sys.stdin:
        # eSpeak NG keeps state (filters, pitch) from one call to the next: each utterance gets a fresh copy.
        child = os.fork()
        if not child:
            samples = speak(library, **json.loads(line))
            sys.stdout.buffer.write(struct.pack("<q", len(samples)) + samples)
            sys.stdout.buffer.flush()
            os._exit(0)
        if os.waitpid(child, 0)[1]:
            return 1
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except (ImportError, OSError, RuntimeError) as error:
        print(f"espeak_worker.py: {error}", file=sys.stderr)
        os._exit(1)
