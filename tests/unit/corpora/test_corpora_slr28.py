"""RIRS_NOISES, the real part."""

import pytest
from corpora_examples import make_slr28, put, put_text

from roomeq.corpora.slr28 import list_slr28, room_of


def test_rirs_and_noises(tmp_path):
    corpus = list_slr28(make_slr28(tmp_path))
    rows = {recording.id: recording.row for recording in corpus.rirs}
    assert len(rows) == 4
    assert rows["RVB2014_type1_rir_largeroom1_near_angla"]["room_id"] == "RVB2014_largeroom1"
    dummy_head, phone = rows["air_type1_air_binaural_lecture_1_2"], rows["air_type1_air_phone_stairway_hhp"]
    assert dummy_head["binaural"] and dummy_head["room_id"] == "AIR_lecture" and not dummy_head["uncommon"]
    assert phone["uncommon"] and not phone["binaural"]
    assert {(noise.row["kind"], noise.row["room_id"]) for noise in corpus.noises} == {
        ("ambient", "RVB2014_largeroom1"), ("point", None)}


@pytest.mark.parametrize("below", [".", "RIRS_NOISES", "RIRS_NOISES/real_rirs_isotropic_noises"])
def test_file_names_replace_missing_lists(tmp_path, below):
    real = make_slr28(tmp_path) / "RIRS_NOISES" / "real_rirs_isotropic_noises"
    with_lists = list_slr28(tmp_path / below)
    (real / "rir_list").unlink()
    (real / "noise_list").unlink()
    without = list_slr28(tmp_path / below)
    assert {r.id: r.row for r in with_lists.rirs} == {r.id: r.row for r in without.rirs}
    assert {r.id: r.row for r in with_lists.noises} == {r.id: r.row for r in without.noises}


@pytest.mark.parametrize("stem, room", [
    ("air_type1_air_binaural_aula_carolina_1_3_0_3", "AIR_aula_carolina"),
    ("air_type1_air_phone_bt_office1_hhp", "AIR_office1"),
    ("air_type1_air_binaural_stairway_1_1_90", "AIR_stairway"),
    ("RWCP_type2_rir_cirline_ofc_imp130", "RWCP_cirline_ofc"), ("RWCP_type4_rir_p50r", "RWCP_type4"),
    ("RWCP_type5_noise_cirline_ofc_ambient1", "RWCP_cirline_ofc"), ("other", None)])
def test_room_is_recognised_by_file_name(stem, room):
    assert room_of(stem) == room


@pytest.mark.parametrize("line, message", [
    ("--rir-id 1 --room-id sox x.wav -t wav - |", "must be options with a value each, then one file: replace"),
    ("--rir-id 'x.wav", "No closing quotation")])
def test_malformed_list_is_refused(tmp_path, line, message):
    real = make_slr28(tmp_path) / "RIRS_NOISES" / "real_rirs_isotropic_noises"
    put_text(real / "rir_list", line)
    with pytest.raises(ValueError, match=rf"rir_list:1: .*{message}"):
        list_slr28(tmp_path)


def test_missing_real_part_is_an_error(tmp_path):
    put(tmp_path / "RIRS_NOISES" / "simulated_rirs" / "a.wav")
    with pytest.raises(ValueError, match="no folder real_rirs_isotropic_noises in it: unpack all of RIRS_NOISES"):
        list_slr28(tmp_path)
    (tmp_path / "RIRS_NOISES" / "real_rirs_isotropic_noises").mkdir()
    with pytest.raises(ValueError, match="no RIRs"):
        list_slr28(tmp_path)
