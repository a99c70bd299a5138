"""Broken corpora: CSV files, ReverbDB's meta files, SOFA, OpenSLR 28, LibriSpeech."""

import numpy as np
from corpora_examples import put_sofa
from wrong import HOSTILE, Case, audio, cut, line, remove, write

TABLE, NOISES, SOFA = "read-measured table out", "read-noises noises out", "read-measured sofa out"
SLR28 = "read-measured slr28 out"
PREPARE = "prepare-speech librispeech out"
TRANSCRIPTS = "prepare-speech transcripts out"
LISTS = "slr28/RIRS_NOISES/real_rirs_isotropic_noises"
TRANS = "librispeech/dev-clean/2/20/2-20.trans.txt"
MIC = "reverbdb/VUT_FIT_Q301/MicID01/SpkID01_20190503_S/01"


def cell(name: str, message: str, column: str, value: str) -> Case:
    """Return a case whose CSV has a further column with one value."""
    return Case(name, TABLE, message, (write("table/manifest.csv", f"file,{column}\nrirs/lab/one.flac,{value}\n"),))


def sofa(name: str, message: str, **values) -> Case:
    """Return a case whose SOFA file holds changed values."""
    return Case(name, SOFA, message, (lambda root: put_sofa(root / "sofa" / "room_a.sofa", **values),))


CASES = [
    Case("rirs of a LibriSpeech tree", "read-measured librispeech out", "librispeech: holds speech "
         "(dev-clean/2/20/2-20.trans.txt), but RIRs are expected here: pass it as the speech corpus"),
    Case("rirs of a table of transcripts", "read-measured transcripts out", "transcripts/manifest.csv: column "
         "'transcript' says that this is speech, but RIRs are expected here: pass it as the speech corpus"),
    Case("rirs of a data directory", "read-measured speech out", "speech: is a Kaldi data directory with speech "
         "(wav.scp), but RIRs are expected here: pass it as the speech corpus"),
    Case("csv empty", TABLE, "table/manifest.csv: columns (none) must include 'file', the "
         "column of the paths: rename it",
         (write("table/manifest.csv", ""),)),
    Case("csv of bytes", TABLE, "table/manifest.csv: not a CSV file in UTF-8 (...): export it again",
         (write("table/manifest.csv", b"file\n\xff\xfe\n"),)),
    Case("csv of zeros", TABLE, "table/manifest.csv: columns ... must include 'file', the "
         "column of the paths: rename it",
         (write("table/manifest.csv", bytes(1000)),)),
    Case("csv in utf-16", TABLE, "table/manifest.csv: not a CSV file in UTF-8 (...): export it again",
         (write("table/manifest.csv", "file\na.wav\n".encode("utf-16")),)),
    Case("csv without file", TABLE, "table/manifest.csv: columns room,t60 must include 'file', the "
         "column of the paths: rename it",
         (write("table/manifest.csv", "room,t60\na,1\n"),)),
    Case("csv column twice", TABLE,
         "table/manifest.csv: column 'room_id' occurs twice (also under another name): rename one",
         (write("table/manifest.csv", "file,room,room_id\na,b,c\n"),)),
    Case("csv without rows", TABLE, "table/manifest.csv: no rows below the header: the corpus is empty",
         (write("table/manifest.csv", "file,room\n"),)),
    Case("csv quote left open", TABLE,
         "table/rirs/lab/one.flac,a: no such audio file: check the path (or leave such files out with "
         "--skip-bad)", (write("table/manifest.csv", 'file,room\n"rirs/lab/one.flac,a\n'),)),
    Case("csv cell of a megabyte", TABLE, "table/manifest.csv: not a CSV file in UTF-8 (...): export it again",
         (write("table/manifest.csv", "file\n" + "a" * 2**20 + "\n"),)),
    Case("csv row too long", TABLE, "table/manifest.csv:2: 3 cells under 2 columns: quote cells that hold ','",
         (write("table/manifest.csv", "file,room\na,b,c\n"),)),
    Case("csv row too short", TABLE,
         "table/manifest.csv:2: file='' must be the path of an audio file: correct the cell",
         (write("table/manifest.csv", "room,file\na\n"),)),
    cell("csv binaural", "table/manifest.csv:2: binaural='maybe': must be 0 or 1: correct the cell",
         "binaural", "maybe"),
    cell("csv distance", "table/manifest.csv:2: distance_m='near': must be a number or ?: correct the cell",
         "distance_m", "near"),
    cell("csv distance infinite",
         "table/manifest.csv:2: distance_m='1e999': '1e999' must be finite and within 1e+09: correct the cell",
         "distance_m", "1e999"),
    cell("csv position",
         "table/manifest.csv:2: source_pos_m='1 2': '1 2' must be three numbers such as '4.7 2.75 ?': correct "
         "the cell", "source_pos_m", "1 2"),
    cell("csv position of nan",
         "table/manifest.csv:2: mic_pos_m='1 2 inf': 'inf' must be finite and within 1e+09: correct the cell",
         "mic_pos_m", "1 2 inf"),
    cell("csv distance negative", "table/manifest.csv:2: distance_m='-1': '-1' must be 0 or more: correct the cell",
         "distance_m", "-1"),
    cell("csv room in centimetres", "table/manifest.csv:2: room_dims_m[0]=620 must be at most 200: give metres: "
         "correct the cell", "room_dims_m", "620 410 270"),
    cell("csv temperature in kelvin", "table/manifest.csv:2: temperature_c=293 must lie in [-20, 50] (ISO 9613-1): "
         "give degrees Celsius: correct the cell", "temperature_c", "293"),
    Case("csv rooms alike once cleaned", TABLE, "table/manifest.csv:3: room_id='a/b' and 'a b' would both have the id "
         "'a-b': rename one: correct the cell", (write("table/manifest.csv", "file,room\nrirs/lab/one.flac,a b\n"
                                                       "rirs/lab/two_clap.flac,a/b\n"),)),
    Case("folder rooms alike once cleaned", "read-measured folder out", "folder/a-b/x.wav: room='a-b' and 'a b' would "
         "both have the id 'a-b': rename one", (audio("folder/a b/x.wav", 4000), audio("folder/a-b/x.wav", 4000))),
    Case("channels alike", "read-measured folder out", "folder: the id 'a_ch0' of a channel or measurement is also "
         "that of another RIR: ids must be unique: rename one file",
         (audio("folder/a.wav", np.ones((4000, 2))), audio("folder/a_ch0.wav", 4000))),
    Case("speakers alike once cleaned", TRANSCRIPTS, "transcripts/manifest.csv:3: speaker='a/b' and 'a b' would both "
         "have the id 'a_b': rename one: correct the row", (write(
             "transcripts/manifest.csv", "file,speaker,transcript\na.wav,a b,A\nb.wav,a/b,B\n"),)),
    Case("csv same id twice", TABLE,
         "table/rirs/lab/two_clap.flac: id 'a' is also that of table/rirs/lab/one.flac: ids must be unique: "
         "rename one file or id", (write(
        "table/manifest.csv", "file,id\nrirs/lab/one.flac,a\nrirs/lab/two_clap.flac,a\n"),)),
    Case("csv ids alike once cleaned", TABLE,
         "table/rirs/lab/two_clap.flac: id 'a-b' is also that of table/rirs/lab/one.flac: ids must be unique: "
         "rename one file or id", (write(
        "table/manifest.csv", "file,id\nrirs/lab/one.flac,a b\nrirs/lab/two_clap.flac,a/b\n"),)),
    Case("csv file evaluated", TABLE,
         "table/$(touch evil).wav: no such audio file: check the path (or leave such files out with --skip-bad)",
         (write("table/manifest.csv", "file\n$(touch evil).wav\n"),)),
    Case("csv file hostile", TABLE,
         "table/it's \"$(touch evil)\" `touch evil`; é*: no such audio file: check the path (or leave such "
         "files out with --skip-bad)", (write("table/manifest.csv", f"file\n{HOSTILE}\n"),)),
    Case("csv file with a line break", TABLE,
         "table/a b.wav: no such audio file: check the path (or leave such files out with --skip-bad)",
         (write("table/manifest.csv", 'file\n"a\nb.wav"\n'),)),
    Case("csv file name too long", TABLE, "table/...: File name too long: shorten the name",
         (write("table/manifest.csv", f"file\n{'x' * 5000}\n"),)),
    Case("csv file a directory", TABLE,
         "table/rirs: no such audio file: check the path (or leave such files out with --skip-bad)",
         (write("table/manifest.csv", "file\nrirs\n"),)),
    Case("csv file with a zero byte", TABLE,
         "table/rirs/lab/o\\x00ne.flac: no such audio file: check the path (or leave such files out with "
         "--skip-bad)", (write("table/manifest.csv", "file\nrirs/lab/o\0ne.flac\n"),)),
    Case("noise kind", NOISES,
         "noises/manifest.csv:2: kind='loud' must be 'ambient' or 'point': correct the cell",
         (line("noises/manifest.csv", 2, "roomtone.wav,tone,hall0,loud"),)),
    Case("noise absent", NOISES,
         "noises/absent.wav: no such audio file: check the path (or leave such files out with --skip-bad)",
         (line("noises/manifest.csv", 2, "absent.wav,tone,hall0,ambient"),)),
    Case("transcript empty", TRANSCRIPTS,
         "transcripts/manifest.csv:2: transcript='' of a.wav must hold the words that are spoken: correct the row",
         (line("transcripts/manifest.csv", 2, "a.wav,a,"),)),
    Case("transcript with a bell", TRANSCRIPTS,
         "transcripts/manifest.csv:2: transcript of a-a: character '\\x07' in it must be printable, or a plain "
         "blank: replace it", (line("transcripts/manifest.csv", 2, "a.wav,a,RING \x07"),)),
    Case("transcript with kaldi's own symbol", TRANSCRIPTS,
         "transcripts/manifest.csv:2: transcript of a-a: '<s>' is reserved by Kaldi: remove it",
         (line("transcripts/manifest.csv", 2, "a.wav,a,A <s> B"),)),
    Case("gender", TRANSCRIPTS, "transcripts/manifest.csv:2: gender='x' must be m or f: correct the row", (write(
        "transcripts/manifest.csv", "file,speaker,transcript,gender\na.wav,a,HI,x\n"),)),
    Case("two speakers", TRANSCRIPTS,
         "transcripts: 2 speakers (a, b) cannot be split into train, dev, test: name at least 3 speakers, or "
         "give the corpus sets", (line("transcripts/manifest.csv", 4, None),)),
    Case("speech without that channel", f"{TRANSCRIPTS} --channel 2",
         "...transcripts/a.wav: channel 2 of 2: count from 0 (named by transcripts/manifest.csv:2)",
         (audio("transcripts/a.wav", np.ones((99, 2)) / 9),)),

    Case("sofa no sofa", SOFA,
         "sofa/room_a.sofa: cannot be read as SOFA (...): export it again (or leave such files out with "
         "--skip-bad)", (write("sofa/room_a.sofa", "this is no SOFA file"),)),
    Case("sofa empty", SOFA,
         "sofa/room_a.sofa: cannot be read as SOFA (...): export it again (or leave such files out with "
         "--skip-bad)", (write("sofa/room_a.sofa", ""),)),
    Case("sofa cut off", SOFA,
         "sofa/room_a.sofa: cannot be read as SOFA (...): export it again (or leave such files out with "
         "--skip-bad)", (cut("sofa/room_a.sofa", 0.5),)),
    sofa("sofa free field",
         "sofa/room_a.sofa: convention SimpleFreeFieldHRIR describes a free field, no room: leave the file out "
         "(or leave such files out with --skip-bad)", convention="SimpleFreeFieldHRIR"),
    sofa("sofa rate of 0",
         "sofa/room_a.sofa: Data.SamplingRate=0 must be a whole number of hertz, at most 768000: export it "
         "again (or leave such files out with --skip-bad)", fs_hz=0),
    sofa("sofa rate of 8 kHz",
         "sofa/room_a.sofa: sample rate 8000 Hz must be at least 16000 Hz: the missing band cannot be restored: "
         "record or convert it at that rate (or leave such files out with --skip-bad)", fs_hz=8000),
    sofa("sofa rate nan",
         "sofa/room_a.sofa: Data.SamplingRate=nan must be a whole number of hertz, at most 768000: export it "
         "again (or leave such files out with --skip-bad)", fs_hz=float("nan")),
    sofa("sofa rate of 1e300",
         "sofa/room_a.sofa: Data.SamplingRate=1e+300 must be a whole number of hertz, at most 768000: export "
         "it again (or leave such files out with --skip-bad)", fs_hz=1e300),
    sofa("sofa silent",
         "sofa/room_a.sofa (room_a): RIR is silent (all samples 0): leave it out or record it again (or leave "
         "such files out with --skip-bad)", Data_IR=np.zeros((1, 1, 900))),
    sofa("sofa nan",
         "sofa/room_a.sofa (room_a): holds NaN or infinite samples: convert it again (or leave such files out "
         "with --skip-bad)", Data_IR=np.full((1, 1, 900), float("nan"))),
    sofa("sofa delay negative",
         "sofa/room_a.sofa: Data.Delay=-5 samples must lie in [0, 1e6): export it again (or leave such files "
         "out with --skip-bad)", Data_Delay=np.full((1, 1), -5.0)),
    sofa("sofa delay of hours",
         "sofa/room_a.sofa: Data.Delay=1e+09 samples must lie in [0, 1e6): export it again (or leave such "
         "files out with --skip-bad)", Data_Delay=np.full((1, 1), 1e9)),
    Case("sofa none", "read-measured --kind sofa folder out", "folder: no .sofa files below it: check the path"),

    Case("slr28 pipe", SLR28,
         "slr28/RIRS_NOISES/real_rirs_isotropic_noises/rir_list:1: '--rir-id 1 --room-id r sox x.wav -t wav - "
         "|' must be options with a value each, then one file: replace pipes by files",
         (write(f"{LISTS}/rir_list", "--rir-id 1 --room-id r sox x.wav -t wav - |\n"),)),
    Case("slr28 quote left open", SLR28,
         "slr28/RIRS_NOISES/real_rirs_isotropic_noises/rir_list:1: No closing quotation: correct the line",
         (write(f"{LISTS}/rir_list", "--rir-id 1 --room-id 'r x.wav\n"),)),
    Case("slr28 file absent", SLR28,
         "slr28/a_rir_x.wav: no such audio file: check the path (or leave such files out with --skip-bad)",
         (write(f"{LISTS}/rir_list", "--rir-id 1 --room-id r a_rir_x.wav\n"),)),
    Case("slr28 not utf-8", SLR28,
         "slr28/RIRS_NOISES/real_rirs_isotropic_noises/rir_list:1: byte 0xff is not UTF-8: convert the file",
         (write(f"{LISTS}/rir_list", b"--rir-id \xff x.wav\n"),)),
    Case("slr28 none", SLR28,
         "slr28/RIRS_NOISES/real_rirs_isotropic_noises: no RIRs (*_rir_*.wav, air_*.wav): unpack all of "
         "RIRS_NOISES", (write(f"{LISTS}/rir_list", ""),)),
    Case("reverbdb without rirs", "read-measured --kind reverbdb folder out",
         "folder: no RIRs (<Room>/MicID01/SpkIDnn_DATE_S/NN/RIR/*.wav): check that the release was unpacked "
         "whole"),
    Case("reverbdb rir empty", "read-measured reverbdb out",
         "reverbdb/VUT_FIT_Q301/MicID01/SpkID01_20190503_S/01/RIR/IR_sweep_15s_45Hzto22kHz_FS16kHz.v00.wav: "
         "audio file is empty (0 bytes): copy or record it again (or leave such files out with --skip-bad)",
         (write(f"{MIC}/RIR/IR_sweep_15s_45Hzto22kHz_FS16kHz.v00.wav", ""),)),

    Case("no corpus", "read-measured absent out",
         "absent: no such file or directory: check the path of the corpus"),
    Case("no audio", "read-measured eq out", "eq: no audio files below it: check the path"),
    Case("rir directory as corpus", "read-measured rirs out",
         "rirs: is an RIR directory already (rirs.jsonl): give the recordings that it was made from, or run the "
         "single steps on it, from roomeq characterise on"),
    Case("noises absent", "read-measured --noises absent folder out",
         "absent: no such file or directory: check the path of the corpus"),
    Case("kind without its file", "read-measured --kind table folder out",
         "folder: no manifest.csv in it: name the CSV file itself"),
    Case("kind sofa of a text", "read-measured --kind sofa table/manifest.csv out",
         "table/manifest.csv: a SOFA file's name must end in .sofa: rename it, or choose another kind"),
    Case("kind table of audio", "read-measured --kind table folder/kitchen/near.wav out",
         "folder/kitchen/near.wav: not a CSV file in UTF-8 (...): export it again"),
    Case("all bad and skipped", "read-measured --skip-bad folder/kitchen/near.wav out",
         "out: none of 1 RIR files can be used, the first because: folder/kitchen/near.wav: audio file is "
         "empty (0 bytes): copy or record it again",
         (write("folder/kitchen/near.wav", ""),)),

    Case("librispeech set absent", "prepare-speech --train-sets nope librispeech out",
         "librispeech: train set 'nope' is not in it (it has dev-clean, test-clean, train-clean-100): choose "
         "with --train-sets"),
    Case("librispeech set twice", "prepare-speech --dev-sets test-clean librispeech out",
         "librispeech: set 'test-clean' is named 2 times: train, dev and test must not share speech: name it "
         "once"),
    Case("transcripts not utf-8", PREPARE,
         "librispeech/dev-clean/2/20/2-20.trans.txt:1: byte 0xe9 is not UTF-8: convert the file",
         (write(TRANS, b"2-20-0000 caf\xe9\n2-20-0001 X\n"),)),
    Case("transcripts empty", PREPARE,
         "librispeech/dev-clean/2/20/2-20-0000.flac: no transcript in "
         "librispeech/dev-clean/2/20/2-20.trans.txt (2 such): complete it or remove the audio", (write(TRANS, ""),)),
    Case("transcripts with an empty line only", PREPARE,
         "librispeech/dev-clean/2/20/2-20-0000.flac: no transcript in "
         "librispeech/dev-clean/2/20/2-20.trans.txt (2 such): complete it or remove the audio",
         (write(TRANS, "\n\n"),)),
    Case("transcript of no audio", PREPARE,
         "librispeech/dev-clean/2/20/2-20.trans.txt:3: no audio librispeech/dev-clean/2/20/2-20-0009.flac: "
         "unpack the corpus again", (line(TRANS, 3, "2-20-0009 MORE"),)),
    Case("transcript twice", PREPARE,
         "librispeech/dev-clean/2/20/2-20.trans.txt:3: utterance 2-20-0001 occurs twice: ids must be unique: "
         "remove one line", (line(TRANS, 3, "2-20-0001 AGAIN"),)),
    Case("transcript of another chapter", PREPARE,
         "librispeech/dev-clean/2/20/2-20.trans.txt:2: utterance '3-30-0001' must start with 2-20-: correct "
         "the line", (line(TRANS, 2, "3-30-0001 X"),)),
    Case("utterance absent", PREPARE,
         "librispeech/dev-clean/2/20/2-20.trans.txt:2: no audio librispeech/dev-clean/2/20/2-20-0001.flac: "
         "unpack the corpus again", (remove("librispeech/dev-clean/2/20/2-20-0001.flac"),)),
    Case("utterance cut off", PREPARE,
         "...librispeech/dev-clean/2/20/2-20-0001.flac: broken audio (...): copy or record it again (named by "
         "librispeech/dev-clean/2/20/2-20.trans.txt:2)", (cut("librispeech/dev-clean/2/20/2-20-0001.flac", 0.7),)),
    Case("speech of one file", "prepare-speech folder/kitchen/near.wav out",
         "folder/kitchen/near.wav: is one audio file, but a corpus is expected: give its folder, or a CSV"),
    Case("no speech corpus", "prepare-speech sofa out",
         "sofa: no speech corpus: expected LibriSpeech (set/reader/chapter/*.trans.txt), manifest.csv with "
         "transcripts, wav.scp of a Kaldi data directory, or audio files"),
]
