"""What cannot be exported."""

import numpy as np
from wrong import Case, audio, line, remove, row, write

LHOTSE, RIRS = "export lhotse speech out", "export lhotse rirs out"
CASES = [
    Case("unknown toolkit", "export kaldi rirs out",
         "Invalid value for 'KIND': 'kaldi' is not one of 'lhotse', 'espnet', 'nemo', 'huggingface', 'roomeq': see "
         "roomeq export --help"),
    Case("directory absent", "export nemo absent out",
         "absent: no such file or directory: check the path, or run the step that makes it"),
    Case("no directory of ours", "export nemo eq out",
         "eq: neither an RIR directory (rirs.jsonl), nor one of noises (noises.jsonl), nor a data directory (wav.scp): "
         "check the path"),
    Case("speech for a copy of rirs", "export roomeq speech out",
         "speech: kind=roomeq must be given an RIR directory or one of noises: choose another kind for a data "
         "directory"),
    Case("no jobs", "export lhotse --nj 0 rirs out", "nj=0 must lie in [1, 1024]: give the number of processes"),
    Case("recording absent", LHOTSE, "speech: a-1-0001: speech/wav/a-1-0001.flac: no such audio file: check the path",
         (remove("speech/wav/a-1-0001.flac"),)),
    Case("recording stereo", LHOTSE, "speech: b-1-0001: speech/wav/b-1-0001.flac: 2 channels where one is expected: "
         "split the file", (audio("speech/wav/b-1-0001.flac", np.ones((20011, 2)) / 9),)),
    Case("recording a pipe", LHOTSE, "speech/wav.scp:1: 'touch evil |' is a command other than 'flac -c -d -s FILE |', "
         "and those run only with --pipes: allow them, or convert the audio to files",
         (line("speech/wav.scp", 1, "a-1-0001 touch evil |"),)),
    Case("recording in a broken archive", LHOTSE, "speech: a-1-0001: x.ark:0: b'PKL' must be the start of WAV, FLAC or "
         "kaldiio AUDIO: matrices, arrays and pickles are not supported: write the archive again with wav-copy or "
         "kaldiio", (line("speech/wav.scp", 1, "a-1-0001 x.ark:0"), write("x.ark", b"PKL"))),
    Case("rir absent", RIRS, "rirs/wav/room0-0.wav: no such audio file: check the path",
         (remove("rirs/wav/room0-0.wav"),)),
    Case("direct sound outside", RIRS, "direct_sample=9999 of RIR room0-0 must lie in its 4000 samples: characterise "
         "it again", (row("rirs/rirs.jsonl", 1, direct_sample=9999),)),
    Case("noise absent", RIRS, "rirs/wav/tap.flac: no such audio file: check the path",
         (remove("rirs/wav/tap.flac"),)),
    Case("mesh absent", "export roomeq measured out",
         "measured/hall.obj: no such file or directory: check the path, or run the step that makes it",
         (row("measured/rirs.jsonl", 1, mesh="hall.obj", room_dims_m=None),)),
    Case("mesh broken", "export roomeq measured out",
         "measured/hall.obj: its copy cannot be read (...): put the mesh into one file, GLB or OBJ",
         (row("measured/rirs.jsonl", 1, mesh="hall.obj", room_dims_m=None), write("measured/hall.obj", "nothing\n"))),
]
