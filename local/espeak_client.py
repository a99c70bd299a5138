"""Client of eSpeak NG, for speech and pronunciations. eSpeak NG runs in another process, `espeak_worker`."""

import json
import struct
import subprocess
import sys
from typing import Any, Self

import espeak_worker

FS_HZ = espeak_worker.FS_HZ


class Espeak:
    """A process of eSpeak NG; a context manager.

    Raises
    ------
    OSError
        On a request, when the process has ended. Its own message is on standard error.
    """

    def __enter__(self) -> Self:
        self._process = subprocess.Popen([sys.executable, espeak_worker.__file__], stdin=subprocess.PIPE,
                                         stdout=subprocess.PIPE)
        assert self._process.stdin and self._process.stdout
        self._stdin, self._stdout = self._process.stdin, self._process.stdout
        return self

    def __exit__(self, *_: object) -> None:
        self._stdin.close()
        self._stdout.close()
        self._process.wait()

    def speak(self, **request: str | int) -> bytes:
        """Return one utterance as bytes of 16-bit samples at `FS_HZ`; for the options see `espeak_worker.speak`."""
        return self._ask(request)

    def phonemes(self, voice: str, words: list[str]) -> list[str]:
        """Return eSpeak NG's phonemes of each word on its own, joined by ``_``, with stress marks."""
        return self._ask(dict(voice=voice, words=words)).decode().splitlines()

    def _ask(self, request: dict[str, Any]) -> bytes:
        try:
            self._stdin.write(json.dumps(request).encode() + b"\n")
            self._stdin.flush()
            n_bytes, = struct.unpack("<q", self._stdout.read(8))
            return self._stdout.read(n_bytes)
        except (OSError, struct.error):
            raise OSError(f"eSpeak NG ended at {str(request)[:500]}: see the message above, or install it "
                          "(pip install espeakng-loader)") from None
