"""A lhotse training cut that is reverberated on the fly, by lhotse with our RIRs and by `Reverberate`.

Needs roomeq and lhotse. It exits with status 1 where a cut loses its length or its alignment.
"""

import sys
import tempfile
from pathlib import Path

import lhotse
import numpy as np
import soundfile

import roomeq

FS = 16000


def main():
    room = roomeq.Room((5, 4, 3), t60_s=0.4)
    rirs = roomeq.simulate_rir(room, (1, 1, 1.5), [(1.8, 1.2, 1.4), (2, 1.5, 1.2), (1.2, 2, 1.5)])
    with tempfile.TemporaryDirectory() as work:
        click = np.zeros(2 * FS, np.float32)
        click[FS] = 0.5
        soundfile.write(Path(work, "utterance.wav"), click, FS)
        for n, rir in enumerate(rirs):
            soundfile.write(Path(work, f"rir{n}.wav"), rir, FS, subtype="FLOAT")
        cut = lhotse.Recording.from_file(Path(work, "utterance.wav")).to_cut()
        of_rirs = lhotse.RecordingSet.from_recordings(
            lhotse.Recording.from_file(Path(work, f"rir{n}.wav")) for n in range(len(rirs)))
        (reverberated,) = lhotse.CutSet.from_cuts([cut]).reverb_rir(of_rirs)
        by_lhotse = reverberated.load_audio()[0]

        reverberate = roomeq.Reverberate(rirs, snr="none")
        ours = reverberate(cut.load_audio(), FS)[0]
        features = cut.compute_features(lhotse.Fbank(), augment_fn=reverberate)
    found = {name: int(np.argmax(np.abs(samples))) - FS for name, samples in (("lhotse", by_lhotse), ("ours", ours))}
    print(f"a click through lhotse's reverb_rir comes {found['lhotse']} samples after its place, through Reverberate "
          f"{found['ours']}; {features.shape[0]} frames of features")
    return int(abs(found["ours"]) > 1 or len(by_lhotse) != len(click) or len(ours) != len(click))


if __name__ == "__main__":
    sys.exit(main())
