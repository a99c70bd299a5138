"""Broken Kaldi workspaces, for the word error rates."""

import shutil

from wrong import Case, cut, line, remove, row, write

WER = "wer --rirs decoded/rirs decoded/kaldi0 decoded/kaldi1 out"
SIM = "decoded/kaldi0/train.sim.rvb"
DEV, TEST = (f"{SIM}/decode_{name}.real.rvb_tgsmall" for name in ("dev", "test"))
HYPOTHESES = f"{TEST}/scoring_kaldi/penalty_0.5/8.txt"
REFERENCE = f"{TEST}/scoring_kaldi/test_filt.txt"
UTT2RIR = "decoded/kaldi0/data/test.real.rvb/utt2rir"
AGAIN = "run stages 8 to 10 again"


def without(name: str):
    """Remove a directory."""
    return lambda root: shutil.rmtree(root / name)


CASES = [
    Case("no rirs", "wer decoded/kaldi0 out",
         "Missing option '--rirs': see roomeq wer --help"),
    Case("no workspace", "wer --rirs decoded/rirs out",
         "Missing argument 'WORKSPACES...': see roomeq wer --help"),
    Case("workspace absent", "wer --rirs decoded/rirs nowhere out",
         "nowhere: no such Kaldi workspace: check the path, or run stages 8 to 10"),
    Case("workspace without decoding", "wer --rirs decoded/rirs decoded/rirs out",
         "decoded/rirs: no train.*/decode_test.real.rvb_* in it: run stages 8 to 10, or check the path"),
    Case("workspace twice", "wer --rirs decoded/rirs decoded/kaldi0 decoded/kaldi1 decoded/../decoded/kaldi0 out",
         "workspace decoded/../decoded/kaldi0 is given twice: give each seed's once"),
    Case("rirs absent", "wer --rirs nowhere decoded/kaldi0 out",
         "nowhere/rirs.jsonl: no such file: check the path, or run the step that makes it (of recordings: roomeq "
         "read-measured)"),
    Case("no rooms", WER, "decoded/rirs/rirs.jsonl: no RIRs in it: run the step that makes it again",
         (write("decoded/rirs/rirs.jsonl", ""),)),
    Case("rir without room", WER, "decoded/rirs/rirs.jsonl:1: room_id=... must be ...: correct the line or make the "
         "file again", (row("decoded/rirs/rirs.jsonl", 1, room_id=None),)),
    Case("acoustic parameters without T20", WER,
         "decoded/rirs/rirs.jsonl:1: acoustic_parameters: key 't20_s' is missing: correct the line or make the file "
         "again", (row("decoded/rirs/rirs.jsonl", 1, acoustic_parameters=dict(t20_valid=[True] * 8)),)),
    Case("acoustic parameters with a DRR that is no number", WER,
         "decoded/rirs/rirs.jsonl:1: acoustic_parameters: drr_db=... must be ...: correct the line or make the file "
         "again", (row("decoded/rirs/rirs.jsonl", 1, acoustic_parameters=dict(drr_db="far")),)),
    Case("column of one row missing", WER,
         f"{TEST}/scoring_kaldi: no such directory, but other rows, columns or seeds have it: decode and score it "
         "(stage 10), or leave the row or column out of all", (without(TEST),)),
    Case("dev of one row missing", WER,
         f"{DEV}/scoring_kaldi: no such directory, but other rows, columns or seeds have it: decode and score it "
         "(stage 10), or leave the row or column out of all", (without(DEV),)),
    Case("row of one seed missing", WER,
         f"{DEV.replace('kaldi0', 'kaldi1')}/scoring_kaldi: no such directory, but other rows, columns or seeds have "
         "it: decode and score it (stage 10), or leave the row or column out of all",
         (without("decoded/kaldi1/train.sim.rvb"),)),
    Case("decoded and not scored", WER,
         f"{TEST}/scoring_kaldi: no such directory, but other rows, columns or seeds have it: decode and score it "
         "(stage 10), or leave the row or column out of all", (without(f"{TEST}/scoring_kaldi"),)),
    Case("no hypotheses", WER, f"{DEV}/scoring_kaldi: no penalty_P/LMWT.txt in it: {AGAIN}", tuple(
        without(f"{DEV}/scoring_kaldi/penalty_{penalty}") for penalty in ("0.0", "0.5"))),
    Case("one weight missing", WER,
         f"{DEV}/scoring_kaldi/penalty_0.0/7.txt: no such file, but other penalties have it: {AGAIN}",
         (remove(f"{DEV}/scoring_kaldi/penalty_0.0/7.txt"),)),
    Case("weight chosen is not there for test", WER, f"{HYPOTHESES}: no such file: {AGAIN}", (remove(HYPOTHESES),)),
    Case("no reference", WER, f"{REFERENCE}: no such file: {AGAIN}", (remove(REFERENCE),)),
    Case("reference file empty", WER, f"{REFERENCE}: file is empty: {AGAIN}", (write(REFERENCE, ""),)),
    Case("reference empty", WER, f"{REFERENCE}: reference of 'test-attic-0' is empty: write it, or leave the "
         "utterance out of the data directory", (line(REFERENCE, 1, "test-attic-0"),)),
    Case("references differ", WER,
         f"{REFERENCE}: reference of 'test-attic-1' is not that of "
         "decoded/kaldi0/train.clean/decode_test.real.rvb_tgsmall: rows are compared on the same speech, decode them "
         "on one data directory", (line(REFERENCE, 2, "test-attic-1 other words"),)),
    Case("reference of another utterance", WER,
         f"{REFERENCE}: reference of 'test-attic-1' is not that of "
         "decoded/kaldi0/train.clean/decode_test.real.rvb_tgsmall: rows are compared on the same speech, decode them "
         "on one data directory", (line(REFERENCE, 2, None),)),
    Case("hypothesis missing", WER,
         f"{HYPOTHESES}: utterance 'test-attic-1' of test_filt.txt is missing: it was not decoded, {AGAIN}",
         (line(HYPOTHESES, 2, None),)),
    Case("hypothesis of an unknown utterance", WER,
         f"{HYPOTHESES}: utterance 'other' is not in test_filt.txt: {AGAIN}", (line(HYPOTHESES, 9, "other words"),)),
    Case("hypothesis twice", WER, f"{HYPOTHESES}:2: utterance 'test-attic-0' occurs twice: {AGAIN}",
         (line(HYPOTHESES, 2, "test-attic-0 words"),)),
    Case("hypothesis without utterance", WER,
         f"{HYPOTHESES}:2: line '' must start with an utterance: {AGAIN}", (line(HYPOTHESES, 2, ""),)),
    Case("hypotheses cut off", WER,
         f"{HYPOTHESES}:...: last line must end in a line break: the file may be cut off, {AGAIN}",
         (cut(HYPOTHESES, 0.5),)),
    Case("hypotheses not utf-8", WER, f"{HYPOTHESES}:1: byte 0xff is not UTF-8: convert the file",
         (write(HYPOTHESES, b"\xff\n"),)),
    Case("utt2rir missing", WER, f"{UTT2RIR}: no such file: {AGAIN}", (remove(UTT2RIR),)),
    Case("utterance without rir", WER,
         f"{UTT2RIR}: no RIR of utterance 'test-attic-1': make the data directory again", (line(UTT2RIR, 2, None),)),
    Case("rir unknown", WER,
         f"{UTT2RIR}: RIR '$(touch evil)' of utterance 'test-attic-0' is not among those of --rirs: give the RIR "
         "directory that the set was made with", (line(UTT2RIR, 1, "test-attic-0 $(touch evil)"),)),
    Case("bootci of something else", WER, f"{TEST}/bootci: 'ERROR' is not what compute-wer-bootci prints ('Set1: %WER "
         "...'): remove the file, or run it again", (write(f"{TEST}/bootci", "ERROR"),)),
    Case("output holds a workspace", "wer --rirs decoded/rirs decoded/kaldi0 decoded",
         "decoded: input decoded/rirs/rirs.jsonl lies in it and would be lost: choose another output"),
]
