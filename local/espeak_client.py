"""Ask eSpeak NG for speech and for pronunciations; it runs in a process of its own, `espeak_worker`."""

import json
import struct
import subprocess
import sys

import espeak_worker

FS_HZ = espeak_worker.FS_HZ


class Espeak:
    """eSpeak NG in a process of its own; a context manager.

    Raises
    ------
    OSError
        When asked, if it has ended by itself; what it said is on standard error.
    """

    def __enter__(self):
        self._process = subprocess.Popen([sys.executable, espeak_worker.__file__], stdin=subprocess.PIPE,
                                         stdout=subprocess.PIPE)
        return self

    def __exit__(self, *_):
        self._process.stdin.close()
        self._process.stdout.close()
        self._process.wait()

    def speak(self, **request):
        """Return one utterance as bytes of 16-bit samples at `FS_HZ`; the request is that of `espeak_worker.speak`."""
        return self._ask(request)

    def phonemes(self, voice, words):
        """Return eSpeak NG's phonemes of each word by itself, joined by ``_``, stress marks among them."""
        return self._ask(dict(voice=voice, words=words)).decode().splitlines()

    def _ask(self, request):
        try:
            self._process.stdin.write(json.dumps(request).encode() + b"\n")
            self._process.stdin.flush()
            n_bytes, = struct.unpack("<q", self._process.stdout.read(8))
            return self._process.stdout.read(n_bytes)
        except (OSError, struct.error):
            raise OSError(f"eSpeak NG ended at {str(request)[:500]}: see the message above, is espeakng-loader "
                          "installed (pip install espeakng-loader)?") from None
