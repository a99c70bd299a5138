"""Broken Kaldi data directories; those that `tests/unit/kaldi/test_datadir.py` breaks are not repeated here."""

import numpy as np
from wrong import Case, audio, cut, line, remove, reorder, write

AUGMENT = "augment speech rirs out"
SEGMENTED = "augment segmented rirs out"
PREPARE = "prepare-speech kaldi out"

CASES = [
    Case("no wav.scp", AUGMENT,
         "speech/wav.scp: no such file: every Kaldi data directory has it: prepare the directory again",
         (remove("speech/wav.scp"),)),
    Case("no utt2spk", AUGMENT,
         "speech/utt2spk: no such file: every Kaldi data directory has it: prepare the directory again",
         (remove("speech/utt2spk"),)),
    Case("utt2spk empty", AUGMENT, "speech/utt2spk: file is empty: prepare the directory again",
         (write("speech/utt2spk", ""),)),
    Case("duplicate utterance", AUGMENT,
         "speech/utt2spk:2: id 'a-1-0001' occurs twice: ids must be unique: remove one",
         (reorder("speech/utt2spk", lambda lines: [lines[0], *lines]),)),
    Case("unsorted", AUGMENT,
         "speech/wav.scp:2: id 'b-1-0001' must not come after 'b-1-0002': sort the file with LC_ALL=C sort",
         (reorder("speech/wav.scp", lambda lines: lines[::-1]),)),
    Case("inconsistent", AUGMENT,
         "speech/utt2spk:2: 'a-1-0002' is not in text: every id must be in both: run Kaldi's "
         "utils/fix_data_dir.sh, or prepare the directory again", (line("speech/text", 2, None),)),
    Case("text not utf-8", AUGMENT, "speech/text:1: byte 0xe9 is not UTF-8: convert the file",
         (write("speech/text", b"a-1-0001 caf\xe9\n"),)),
    Case("windows line ends", AUGMENT,
         "speech/text:1: line ends as on Windows (\\r): convert the file with dos2unix",
         (write("speech/text", "a-1-0001 A\r\n"),)),
    Case("last line cut off", AUGMENT,
         "speech/utt2spk:2: last line must end in a line break: the file may be cut off",
         (write("speech/utt2spk", "a-1-0001 a\na-1-0002"),)),
    Case("a pipe", AUGMENT,
         "speech/wav.scp:1: 'touch evil |' is a command other than 'flac -c -d -s FILE |', and those run only "
         "with --pipes: allow them, or convert the audio to files",
         (line("speech/wav.scp", 1, "a-1-0001 touch evil |"),)),
    Case("a pipe in a path", AUGMENT,
         "speech/wav.scp:1: 'flac -c -d -s $(touch evil).flac |' is a command other than 'flac -c -d -s FILE "
         "|', and those run only with --pipes: allow them, or convert the audio to files",
         (line("speech/wav.scp", 1, "a-1-0001 flac -c -d -s $(touch evil).flac |"),)),
    Case("a pipe that fails", "augment --pipes speech rirs out",
         "speech: utterance a-1-0001: 'false': command failed with status 1 (no message): run it by hand",
         (line("speech/wav.scp", 1, "a-1-0001 false |"),)),
    Case("a pipe that says nothing", "augment --pipes speech rirs out",
         "speech: utterance a-1-0001: 'true': its 0 bytes of output cannot be read as audio (...): make it "
         "write WAV",
         (line("speech/wav.scp", 1, "a-1-0001 true |"),)),
    Case("standard input", AUGMENT,
         "speech/wav.scp:1: '-' names no audio: give a file, FILE:OFFSET or a command that ends in '|'",
         (line("speech/wav.scp", 1, "a-1-0001 -"),)),
    Case("audio absent", AUGMENT, "speech: utterance a-1-0001: nowhere.wav: no such audio file: check the path",
         (line("speech/wav.scp", 1, "a-1-0001 nowhere.wav"),)),
    Case("audio a directory", AUGMENT, "speech: utterance a-1-0001: speech: no such audio file: check the path",
         (line("speech/wav.scp", 1, "a-1-0001 speech"),)),
    Case("audio a device", AUGMENT, "speech: utterance a-1-0001: /dev/zero: no such audio file: check the path",
         (line("speech/wav.scp", 1, "a-1-0001 /dev/zero"),)),
    Case("audio name too long", AUGMENT, "....wav: File name too long: shorten the name",
         (line("speech/wav.scp", 1, f"a-1-0001 {'x' * 5000}.wav"),)),
    Case("archive absent", AUGMENT, "speech: utterance a-1-0001: wav.ark: no such archive: check the path",
         (line("speech/wav.scp", 1, "a-1-0001 wav.ark:12"),)),
    Case("archive of pickles", AUGMENT,
         "speech: utterance a-1-0001: x.ark:0: b'PKL\\x80\\x04' must be the start of WAV, FLAC or kaldiio AUDIO: "
         "matrices, arrays and pickles are not supported: write the archive again with wav-copy or kaldiio",
         (line("speech/wav.scp", 1, "a-1-0001 x.ark:0"),
                                             write("x.ark", b"PKL\x80\x04cos\nmkdir\n(S'evil'\ntR."))),
    Case("archive of arrays", AUGMENT,
         "speech: utterance a-1-0001: x.ark:0: b'NPY\\x04\\x08' must be the start of WAV, FLAC or kaldiio AUDIO: "
         "matrices, arrays and pickles are not supported: write the archive again with wav-copy or kaldiio",
         (line("speech/wav.scp", 1, "a-1-0001 x.ark:0"),
                                            write("x.ark", b"NPY\x04\x08\0\0\0\x93NUMPY"))),
    Case("archive offset behind the end", AUGMENT,
         "speech: utterance a-1-0001: x.ark:99: the offset must lie within the archive's 4 bytes: correct the line",
         (line("speech/wav.scp", 1, "a-1-0001 x.ark:99"),
                                                        write("x.ark", b"RIFF"))),
    Case("archive offset of an exabyte", AUGMENT,
         "speech: utterance a-1-0001: x.ark:999999999999999999: the offset must lie within the archive's 4 bytes: "
         "correct the line", (line("speech/wav.scp", 1, f"a-1-0001 x.ark:{'9' * 18}"), write("x.ark", b"RIFF"))),
    Case("archive offset beyond 64 bits", AUGMENT,
         "speech/wav.scp:1: offset 18446744073709551616... of 'x.ark' must be a byte position in the file: "
         "correct the line", (line("speech/wav.scp", 1, f"a-1-0001 x.ark:{2**64}"), write("x.ark", b"RIFF"))),
    Case("speech far beyond full scale", AUGMENT,
         "speech: utterance a-1-0001: x.wav: peak 1e+30 must be at most 1e+10: convert it again, full scale being 1",
         (line("speech/wav.scp", 1, "a-1-0001 x.wav"), audio("x.wav", np.full(12352, 1e30), subtype="FLOAT"))),
    Case("archive offset of 30 digits", AUGMENT,
         "speech/wav.scp:1: offset 99999999999999999999... of 'x.ark' must be a byte position in the file: "
         "correct the line", (line("speech/wav.scp", 1, f"a-1-0001 x.ark:{'9' * 30}"),
                                                      write("x.ark", b"RIFF"))),
    Case("archive offset of 5000 digits", AUGMENT,
         "speech/wav.scp:1: offset 99999999999999999999... of 'x.ark' must be a byte position in the file: "
         "correct the line", (line("speech/wav.scp", 1, f"a-1-0001 x.ark:{'9' * 5000}"),
                                                        write("x.ark", b"RIFF"))),
    Case("archive range", AUGMENT,
         "speech/wav.scp:1: 'x.ark:0[0:5]' selects a range, which is not supported for audio: use a segments file",
         (line("speech/wav.scp", 1, "a-1-0001 x.ark:0[0:5]"), write("x.ark", b"RIFF"))),
    Case("archive length lies", AUGMENT,
         "speech: utterance a-1-0001: x.ark:0: broken audio (...): make the archive again",
         (line("speech/wav.scp", 1, "a-1-0001 x.ark:0"),
                                              write("x.ark", b"AUDIO\x08" + b"\xff" * 7 + b"\x7f"))),
    Case("duration infinite", "validate speech",
         "speech/utt2dur:1: value '1e999' of 'a-1-0001' must be a positive number of seconds: correct the line",
         (line("speech/utt2dur", 1, "a-1-0001 1e999"),)),
    Case("segment behind the end", SEGMENTED,
         "segmented: utterance s-2: segmented/r.flac: segment from 1 s to 9.5 s must lie within the "
         "recording's 3 s: correct the segments file, or copy the audio again if it is truncated",
         (line("segmented/segments", 2, "s-2 r 1.0 9.5"),)),
    Case("segment of no samples", SEGMENTED,
         "segmented: utterance s-2: segmented/r.flac: segment from 1 s to 1.00001 s holds no sample at 16000 Hz: "
         "remove the utterance", (line("segmented/segments", 2, "s-2 r 1.0 1.00001"),)),
    Case("segment backwards", SEGMENTED,
         "segmented/segments:2: segment from 2.0 to 1.0 must be 0 <= START < END in seconds (or END -1): "
         "correct the line", (line("segmented/segments", 2, "s-2 r 2.0 1.0"),)),
    Case("segment of infinity", SEGMENTED,
         "segmented/segments:2: segment from 1e999 to 2.0 must be 0 <= START < END in seconds (or END -1): "
         "correct the line", (line("segmented/segments", 2, "s-2 r 1e999 2.0"),)),
    Case("segment start of 1e300", SEGMENTED,
         "segmented: utterance s-2: segmented/r.flac: segment from 1e+300 s to its end must lie within the "
         "recording's 3 s: correct the segments file, or copy the audio again if it is truncated",
         (line("segmented/segments", 2, "s-2 r 1e300 -1"),)),
    Case("segment of nobody's recording", SEGMENTED,
         "segmented/segments:2: recording 'q' is not in wav.scp: add it, or remove the segment",
         (line("segmented/segments", 2, "s-2 q 0 1"),)),
    Case("archive of hours", "--max-audio-hours 0.0001 augment speech rirs out",
         "rirs/wav/hum-room0.flac: 32000 samples in 1 channels must be at most 5760 (0.0001 h at 16000 Hz): "
         "split the file, or raise the bound with roomeq --max-audio-hours", (
        line("speech/wav.scp", 1, "a-1-0001 x.ark:0"), audio("x.ark.flac", 16000),
        lambda root: (root / "x.ark.flac").rename(root / "x.ark"))),
    Case("rirs where speech is asked for", "augment rirs speech out",
         "rirs/utt2spk: no such file: every Kaldi data directory has it: prepare the directory again"),
    Case("kaldi text not utf-8", "prepare-speech speech out",
         "speech/text:1: byte 0xe9 is not UTF-8: convert the file", (write("speech/text", b"a-1-0001 caf\xe9\n"),)),
    Case("kaldi two speakers", "prepare-speech speech out",
         "speech: 2 speakers (a, b) cannot be split into train, dev, test: name at least 3 speakers, or give "
         "the corpus sets"),
    Case("kaldi with an empty text", "prepare-speech speech out",
         "speech/text: missing or empty: complete the data directory (utils/fix_data_dir.sh)",
         (write("speech/text", ""),)),
    Case("validate cut audio", "validate speech",
         "speech/wav.scp:4: speech/wav/b-1-0001.flac: broken audio (...): copy or record it again",
         (cut("speech/wav/b-1-0001.flac", 0.9),)),
    Case("validate nothing", "validate folder",
         "folder: neither an RIR directory (rirs.jsonl), nor one of noises (noises.jsonl), nor a data "
         "directory (wav.scp), nor one of the loop (ledger.json) or of word error rates (wer.json): check the path"),
    Case("validate absent speakers", "validate speech",
         "speech/spk2utt: no such file: Kaldi's scripts need it: write it", (remove("speech/spk2utt"),)),
    Case("validate the second", "validate segmented speech",
         "speech/spk2utt: no such file: Kaldi's scripts need it: write it", (remove("speech/spk2utt"),)),
]
