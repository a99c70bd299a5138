"""Worker process of espeak_client.py: speech and pronunciations by eSpeak NG.

eSpeak NG is under the GPL, so it is loaded by this process only and never by the toolkit. Every line of standard input
is a JSON object {voice, rate_wpm, pitch, pitch_range, seed, text} or {voice, words}. The answer on standard output is
an 8-byte little-endian byte count and that many bytes: 16-bit mono samples at `FS_HZ`, or one line of phonemes per
word.
"""

import ctypes
import json
import os
import struct
import sys
from typing import Any

FS_HZ = 22050
_AUDIO_SYNCHRONOUS, _DONT_EXIT, _UTF8 = 2, 0x8000, 1
_RATE, _PITCH, _RANGE = 1, 3, 4
_SEPARATED = ord("_") << 8  # phoneme names, separated by _
_CALLBACK = ctypes.CFUNCTYPE(ctypes.c_int, ctypes.POINTER(ctypes.c_short), ctypes.c_int, ctypes.c_void_p)


def load() -> ctypes.CDLL:
    """Return the initialised library.

    Raises
    ------
    RuntimeError
        The library does not start or has another sample rate.
    """
    import espeakng_loader

    library = ctypes.CDLL(espeakng_loader.get_library_path())
    data_path = espeakng_loader.get_data_path().encode()
    fs_hz = library.espeak_Initialize(_AUDIO_SYNCHRONOUS, 500, data_path, _DONT_EXIT)
    if fs_hz != FS_HZ:
        raise RuntimeError(f"eSpeak NG's rate is {fs_hz} Hz and must be {FS_HZ} Hz: reinstall espeakng-loader")
    library.espeak_ng_SetRandSeed.argtypes = [ctypes.c_long]
    library.espeak_TextToPhonemes.argtypes = [ctypes.POINTER(ctypes.c_char_p), ctypes.c_int, ctypes.c_int]
    library.espeak_TextToPhonemes.restype = ctypes.c_char_p
    return library


def speak(library: ctypes.CDLL, voice: str, rate_wpm: int, pitch: int, pitch_range: int, seed: int, text: str) -> bytes:
    """Return one utterance as bytes of 16-bit samples at `FS_HZ`.

    Parameters
    ----------
    library
    voice
        Language and variant, such as ``"en-us+f3"``.
    rate_wpm
        Words per minute, 80-450.
    pitch, pitch_range
        0-100; 50 is that of the variant.
    seed
        Seed of the breath noise, which eSpeak NG seeds with the time otherwise.
    text

    Raises
    ------
    RuntimeError
        There is no such voice, or the result is empty.
    """
    chunks: list[bytes] = []

    @_CALLBACK
    def keep(samples: Any, count: int, _events: int) -> int:
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
        raise RuntimeError(f"eSpeak NG cannot speak {text!r} with voice {voice!r}: reinstall espeakng-loader")
    return b"".join(chunks)


def phonemes(library: ctypes.CDLL, voice: str, words: list[str]) -> bytes:
    """Return one line per word: the phonemes of the word on its own, joined by ``_``.

    Raises
    ------
    RuntimeError
        There is no such voice.
    """
    if library.espeak_SetVoiceByName(voice.encode()):
        raise RuntimeError(f"eSpeak NG has no voice {voice!r}: reinstall espeakng-loader")
    lines = []
    for word in words:
        clauses: list[bytes] = []
        rest = ctypes.c_char_p(word.encode())
        while rest.value:  # each call handles one clause and advances the text
            clauses.append(library.espeak_TextToPhonemes(ctypes.byref(rest), _UTF8, _SEPARATED))
        lines.append(b"_".join(clauses) + b"\n")
    return b"".join(lines)


def main() -> int:
    """Answer requests until standard input ends; return the exit status."""
    library = load()
    for line in sys.stdin:
        # eSpeak NG keeps state (filters, pitch) between calls: each request gets a fresh process.
        child = os.fork()
        if not child:
            request = json.loads(line)
            answer = (phonemes if "words" in request else speak)(library, **request)
            sys.stdout.buffer.write(struct.pack("<q", len(answer)) + answer)
            sys.stdout.buffer.flush()
            os._exit(0)
        if os.waitpid(child, 0)[1]:
            return 1
    return 0


if __name__ == "__main__":
    try:
        sys.exit(main())
    except BrokenPipeError:  # the client has ended and has reported why
        os._exit(1)
    except (ImportError, OSError, RuntimeError) as error:
        print(f"espeak_worker.py: {error}", file=sys.stderr)
        os._exit(1)
