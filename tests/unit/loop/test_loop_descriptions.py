"""Descriptions of residuals and of effects, as the log and the report print them."""

from dataclasses import asdict

import numpy as np
import pytest

from roomeq.acoustics.octaves import nominal_hz
from roomeq.effects.catalogue import CATALOGUE
from roomeq.effects.response import RESPONSE_HZ
from roomeq.loop.descriptions import advise_on_residual, describe_effect, describe_residual, effect_label
from roomeq.loop.features import REGION
from roomeq.loop.unexplained import Unexplained


@pytest.mark.parametrize("metric, bands_hz, varies_with, size_jnd, description", [
    ("t30", [500.0, 62.5, 125.0], "room", 2.0,
     "the decay time (T30) at 62.5 to 125, 500 Hz is 10 % longer than simulated, in some rooms (+2.0 JND)"),
    ("edt", [1000.0], "nothing", -2.0,
     "the early decay time (EDT) at 1000 Hz is 9 % shorter than simulated, equally in all rooms (-2.0 JND)"),
    ("drr", [], "source", 1.5, "the direct-to-reverberant ratio (DRR) is 3.0 dB higher than simulated, "
                               "for one source compared with the others (+1.5 JND)"),
    ("arrival", [], "mic", -3.0,
     "the direct sound is 0.3 ms earlier than simulated, for one microphone compared with the others (-3.0 JND)"),
    ("floor", [125.0, 250.0, 500.0], "nothing", 4.6,
     "noise after the response at 125 to 500 Hz is 4.6 dB louder than simulated, equally in all rooms (+4.6 JND)")])
def test_residual_is_described_in_the_unit_of_its_metric(metric, bands_hz, varies_with, size_jnd, description):
    unexplained = Unexplained(metric, REGION[metric], bands_hz, varies_with, size_jnd, 0.01)
    assert describe_residual(unexplained) == description


def parameters(*effects):
    return {f"u{n}": {"best": asdict(effect)} for n, effect in enumerate(effects, start=1)}


@pytest.mark.parametrize("name", list(CATALOGUE))
def test_every_effect_is_described_at_its_starts(name):
    effect = CATALOGUE[name]
    for n_units in (1, 3):
        text = describe_effect(name, parameters(*[effect.from_vector(np.array(start))
                                                  for start in effect.STARTS * n_units]))
        assert text and not {"nan", "None", "["} & set(text.split()) and "\n" not in text


def test_third_octaves_have_their_nominal_frequencies():
    assert [nominal_hz(third_hz) for third_hz in RESPONSE_HZ] == pytest.approx([
        25, 31.5, 40, 50, 63, 80, 100, 125, 160, 200, 250, 315, 400, 500, 630, 800, 1000, 1250, 1600, 2000, 2500, 3150,
        4000, 5000, 6300, 8000])


def test_effects_are_described_by_their_parameters():
    def description(name, *vectors):
        return describe_effect(name, parameters(*(CATALOGUE[name].from_vector(np.array(vector)) for vector in vectors)))

    flat, bass_light = np.zeros(len(RESPONSE_HZ)), np.zeros(len(RESPONSE_HZ))
    bass_light[0], bass_light[17] = -9.7, 6.2
    assert description("source_response", flat, bass_light) == (
        "the least flat response, that of u2, ranges from -9.7 dB at 25 Hz to +6.2 dB at 1250 Hz")
    assert description("coupled_volume", [-1.5, np.log(2.0), 0.0], [-6.0, 0.0, 0.0], [-2.0, np.log(3.0), 0.2]) == (
        "2 of 3 rooms have a second decay of 2.5 s (2.0 to 3.0), 18 dB (15 to 20) below the energy of all reflections "
        "in octaves that decay in 0.5 s, as of a volume that is coupled through an opening")
    assert describe_effect("mic_response", parameters(CATALOGUE["mic_response"].from_vector(flat)), "source_response"
                           ).endswith("Hz; recordings determine its sum with the frequency response of the "
                                      "loudspeakers, and not how a filter that all share is divided between both")
    assert description("occlusion", [np.log(0.2)], [-9.0]) == (
        "an obstacle delays the direct sound of 1 of 2 recordings by a detour of 20 cm")
    assert description("near_reflector", [np.log(0.7), 0.5]) == (
        "a surface 0.70 m below source and microphone reflects 50 % of the pressure")


@pytest.mark.parametrize("effect", sorted(CATALOGUE))
def test_every_effect_has_a_name_in_words(effect):
    assert "_" not in effect_label(effect)


@pytest.mark.parametrize("metric", sorted(REGION))
@pytest.mark.parametrize("varies_with, words", [
    ("nothing", ""), ("room", "; look at the rooms"), ("mic", "; exchange")])
def test_every_residual_has_advice(metric, varies_with, words):
    advice = advise_on_residual(Unexplained(metric, REGION[metric], [], varies_with, 2.0, 0.01))
    assert advice[0].islower() and words in advice and (";" in advice) == bool(words)
