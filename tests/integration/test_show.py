"""`roomeq show` and `roomeq compare`: pages, pictures and texts of RIRs, of sets and of loops, and what they refuse."""

import os
import re

import numpy as np
import pytest
import soundfile
import webdriver
from loop_run import make_loop
from plans import L_PLAN, prism_obj
from rirmaker import DIRECT, coloured_rir, row, write_rir_dir
from test_report import Page

import roomeq
from roomeq.cli import NOT_UP_TO_DATE, main
from roomeq.core.audio import write_wav
from roomeq.core.constants import FS_HZ

ROOMS = {"hall": (0.6, [8.0, 6.0, 3.0]), "office": (0.3, [5.0, 4.0, 2.5])}


def rows_of(kind):
    """Return rows and RIRs of two rooms; simulated ones name the measured RIR that they were made for."""
    items = []
    for number, (room, (time_s, dims_m)) in enumerate(ROOMS.items()):
        for k in range(4):
            positions = dict(room_dims_m=dims_m, source_pos_m=[1.0, 1.5, 1.2], mic_pos_m=[3.0, 1.0 + 0.5 * k, 1.0],
                             source_dir=[1.0, 0.0, 0.0])
            name = f"{room}-{k}"
            more = {} if kind == "measured" else dict(measured_id=name, seed=0, direct_sample=float(DIRECT),
                                                     direct_polarity=1)
            items.append((row(name if kind == "measured" else f"{name}-sim", room, **positions, **more),
                          coloured_rir((number, k, len(kind)), time_s=time_s, snr_db=60.0)))
    return items


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Make two RIR directories, a loop directory, speech and further files."""
    root = tmp_path_factory.mktemp("<i>show")
    for kind in ("measured", "simulated"):
        write_rir_dir(root / kind, rows_of(kind))
    make_loop(root / "loop")
    write_wav(root / "speech.wav", coloured_rir(0, time_s=5.0, length_s=1.0))
    write_wav(root / "rir<48k>.wav", np.repeat(coloured_rir(9), 3), 48000)
    suspicious = [(one | dict(suspicious="no decay") if n else one, rir)
                  for n, (one, rir) in enumerate(rows_of("measured")[:3])]
    write_rir_dir(root / "marked", suspicious)
    write_wav(root / "silent.wav", np.zeros(8000))
    write_wav(root / "reversed.wav", coloured_rir(1)[::-1])
    soundfile.write(root / "stereo.wav", np.column_stack([coloured_rir(2), coloured_rir(3)]), FS_HZ, subtype="FLOAT")
    (root / "text.wav").write_text("no audio")
    (root / "l.obj").write_text(prism_obj(L_PLAN, 3.0))
    (root / "open.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    (root / "empty").mkdir()
    return root


PAGES = {
    "file": ["show", "rir<48k>.wav"], "row": ["show", "measured/audio/hall-1.wav", "--speech", "speech.wav"],
    "suspicious": ["show", "reversed.wav", "--keep-suspicious"], "set": ["show", "simulated", "--id", "office-2-sim"],
    "loop": ["show", "loop"], "mesh": ["show", "l.obj"],
    "pair": ["compare", "measured/audio/hall-0.wav", "rir<48k>.wav"],
    "sets": ["compare", "measured", "simulated", "--id", "hall-2"]}
SILENT = {"mesh"}
"""Pages without audio."""


@pytest.fixture(scope="module")
def pages(made):
    """Make every page, and return their paths."""
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(made)
        for name, words in PAGES.items():
            assert main([*words, "--out", f"{name}.html"]) == 0
    return {name: made / f"{name}.html" for name in PAGES}


@pytest.mark.parametrize("name", PAGES)
def test_page_is_complete_and_makes_no_requests(pages, name):
    page = Page(pages[name].read_text())
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    pictures, clips = (2, 0) if name in SILENT else (5, 3)
    assert len(ids) == len(set(ids)) and len(page.of("img")) >= pictures and len(page.of("audio")) >= clips
    assert all(image["src"].startswith("data:image/svg") and image["alt"] for image in page.of("img"))
    assert all(clip["src"].startswith("data:audio/flac") for clip in page.of("audio"))
    links = {attributes["href"] for attributes in page.of("a")}
    assert links <= {f"#{ident}" for ident in ids}
    assert not {tag for tag, _ in page.elements} & {"script", "i", "b", "iframe", "link"}
    assert "None" not in page.text and "nan" not in page.text.split()


def test_page_of_a_file_in_a_directory_has_the_map_of_its_room(pages):
    page = Page(pages["row"].read_text())
    assert {"figure-plan", "figure-section"} <= {image["id"] for image in page.of("img")}
    early = next(image["alt"] for image in page.of("img") if image["id"] == "figure-early")
    assert all(surface in early for surface in ("floor", "ceiling", "west", "south"))
    assert "Speech, through the RIR" in page.text


def test_page_of_a_file_alone_says_where_dimensions_come_from(pages):
    assert "No map: the row" in Page(pages["file"].read_text()).text
    assert "16000 Hz" in Page(pages["file"].read_text()).text.replace("\N{NO-BREAK SPACE}", " ")


def test_page_of_a_suspicious_recording_begins_with_the_reason(pages):
    assert "No RIR by its acoustics: time-reversed" in Page(pages["suspicious"].read_text()).text


def test_page_of_the_one_rir_of_a_set_says_what_was_left_out(made, monkeypatch):
    monkeypatch.chdir(made)
    assert main(["show", "marked", "--out", "marked.html"]) == 0
    assert "left out" in Page((made / "marked.html").read_text()).text


def test_page_of_a_loop_says_what_was_found_and_what_to_do(pages):
    page = Page(pages["loop"].read_text())
    assert "Frequency response of the loudspeakers" in page.text and "Reflecting surface near source" in page.text
    assert "What to do: Play the sweep at a lower level" in page.text
    assert "These recordings cannot tell it from: frequency response of the microphones" in page.text
    assert [clip["id"] for clip in page.of("audio")][:4] == ["audio-dry-1", "audio-through-1-1", "audio-through-2-1",
                                                             "audio-through-3-1"]
    assert "one direction at each position, 114 degrees from the microphone" in page.text
    assert "figure-gains-source_response" in {image["id"] for image in page.of("img")}


def test_page_of_two_sets_pairs_them_and_shows_the_chosen_pair(pages):
    text = Page(pages["sets"].read_text()).text
    assert "8 RIRs have a counterpart by id" in text and "One pair: hall-2" in text


def test_same_input_gives_the_same_page(made, pages, monkeypatch):
    monkeypatch.chdir(made)
    assert main([*PAGES["loop"], "--out", "again.html"]) == 0
    assert (made / "again.html").read_bytes() == pages["loop"].read_bytes()


@pytest.mark.parametrize("name", ["file", "set", "loop", "mesh"])
def test_picture_is_a_png(made, monkeypatch, name):
    monkeypatch.chdir(made)
    assert main([*PAGES[name], "--out", "picture.png"]) == 0
    assert (made / "picture.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"


@pytest.mark.parametrize("words, parts", [
    (["show", "rir<48k>.wav"], ["48,000 Hz", "16000 Hz", "T30 (s)", "--out FILE.html"]),
    (["show", "stereo.wav", "--channel", "1"], ["stereo.wav, channel 1", "16,000 Hz"]),
    (["show", "reversed.wav", "--keep-suspicious"], ["No RIR by its acoustics: time-reversed"]),
    (["show", "measured"], ["8 RIRs of 2 rooms", "hall", "office", "--id ID, such as"]),
    (["show", "measured", "--id", "office-0"], ["5.0 × 4.0 × 2.5 m", "Direct-to-reverberant ratio"]),
    (["show", "loop"], ["The simulation lacked: frequency response of the loudspeakers",
                        "Source s: 12 RIRs do not state where it faces", "What to do:"]),
    (["show", "l.obj"], ["6.00 × 6.00 × 3.00 m", "60.0 m³", "wall", "64.3", "mean free path"]),
    (["compare", "measured/audio/hall-0.wav", "measured/audio/office-0.wav"], ["B - A (JND)", "→"]),
    (["compare", "stereo.wav", "stereo.wav", "--channel", "1"], ["B - A (JND)", "→"]),
    (["compare", "stereo.wav", "rir<48k>.wav", "--channel", "1"], ["B - A (JND)", "→"]),
    (["compare", "reversed.wav", "reversed.wav", "--keep-suspicious"], ["A: no RIR by its acoustics: time-reversed"]),
    (["show", "marked"], ["1 RIRs of 1 rooms", "2 recordings that are no RIR are left out"]),
    (["show", "marked", "--keep-suspicious"], ["3 RIRs of 1 rooms"]),
    (["compare", "marked", "simulated"], ["marked, 1 RIRs.", "2 recordings that are no RIR are left out", "1 pairs"]),
    (["compare", "marked", "simulated", "--keep-suspicious"], ["marked, 3 RIRs.", "3 pairs"]),
    (["compare", "measured", "simulated"], ["8 pairs", "Medians A → B", "DRR:"])])
def test_without_out_the_parameters_are_printed(made, monkeypatch, capsys, words, parts):
    monkeypatch.chdir(made)
    before = sorted(made.rglob("*"))
    assert main(words) == 0
    said = capsys.readouterr().out
    assert all(part in said for part in parts) and sorted(made.rglob("*")) == before


@pytest.mark.parametrize("words, message", [
    (["show", "absent.wav"], r"absent.wav: no such file or directory"),
    (["show", "text.wav"], r"text.wav: cannot be read as audio"),
    (["show", "silent.wav"], r"silent.wav: .*silent"),
    (["show", "silent.wav", "--keep-suspicious"], r"silent.wav: .*silent"),
    (["show", "reversed.wav"], r"reversed.wav: no RIR by its acoustics: time-reversed.*--keep-suspicious"),
    (["show", "stereo.wav"], r"stereo.wav: 2 channels .*--channel 0 to 1"),
    (["show", "stereo.wav", "--channel", "2"], r"stereo.wav: channel 2 of 2"),
    (["show", "open.obj"], r"open.obj: the mesh has holes"),
    (["show", "l.obj", "--speech", "speech.wav", "--out", "l.html"], r"--speech speech.wav: l.obj is a mesh"),
    (["show", "empty"], r"empty: neither rirs.jsonl .* nor ledger.json"),
    (["show", "measured", "--id", "hall-9"], r"measured: no RIR 'hall-9' among its 8: .* such as hall-"),
    (["show", "measured/audio/hall-0.wav", "--id", "hall-0"], r"--id hall-0: .* is no RIR directory"),
    (["show", "measured", "--channel", "0"], r"--channel 0: measured is no audio file"),
    (["show", "measured", "--speech", "speech.wav"], r"--speech speech.wav: .* --out FILE.html"),
    (["show", "measured", "--out", "page.pdf"], r"--out page.pdf: must end in .html or .png"),
    (["show", "measured", "--out", "absent/page.html"], r"--out absent/page.html: its directory does not exist"),
    (["compare", "stereo.wav", "stereo.wav"], r"stereo.wav: 2 channels .*--channel 0 to 1"),
    (["compare", "rir<48k>.wav", "stereo.wav", "--channel", "2"], r"stereo.wav: channel 2 of 2"),
    (["compare", "measured", "simulated", "--channel", "0"], r"--channel 0: measured is no audio file"),
    (["compare", "measured", "loop"], r"must be two RIR files or two RIR directories"),
    (["compare", "measured", "speech.wav"], r"must be two RIR files or two RIR directories"),
    (["compare", "measured", "simulated", "--id", "hall-9"], r"--id hall-9: no pair .* 8 pairs"),
    (["compare", "measured", "simulated", "--out", "page.png"], r"--out page.png: must end in .html")])
def test_what_cannot_be_shown_is_refused_in_one_line(made, monkeypatch, capsys, words, message):
    monkeypatch.chdir(made)
    assert main(words) == 1
    said = capsys.readouterr().err
    assert said.count("\n") == 1 and re.search(message, said), said


def test_names_that_cannot_be_drawn_or_printed_are_replaced(made, monkeypatch):
    monkeypatch.chdir(made)
    name = "_$x_{\t.wav"
    (made / name).write_bytes((made / "measured/audio/hall-0.wav").read_bytes())
    for words in ([], ["--out", "odd.png"]):
        assert main(["show", name, *words]) == 0
    os.symlink(made / "measured", made / "$_{a")
    assert main(["compare", "$_{a", "simulated", "--out", "odd.html"]) == 0


def test_asking_makes_nothing(made, monkeypatch):
    monkeypatch.chdir(made)
    assert main(["--ask", "show", "measured", "--out", "asked.html"]) == NOT_UP_TO_DATE
    assert not (made / "asked.html").exists()
    roomeq.simulate(None, made / "drawn", rooms=1, num_rays=200, noise_rirs=0)  # what follows is no question


@pytest.mark.parametrize("fs", [8000, 16000, 48000])
def test_notebook_figure_shows_all_bands(fs):
    samples = np.concatenate([np.zeros(200), [3.0], coloured_rir(5)[DIRECT:]])
    figure = roomeq.plot_rir(samples, fs)
    assert sum(len(part.axes) > 0 for part in figure.subfigs) == 6 + {8000: 7, 16000: 8, 48000: 9}[fs]
    assert figure._repr_png_()[:4] == b"\x89PNG"


def test_notebook_figure_of_silence_is_refused():
    with pytest.raises(ValueError, match="silent"):
        roomeq.plot_rir(np.zeros(1000), 16000)


@pytest.mark.skipif(not webdriver.installed(), reason="needs chromium and chromedriver (Debian: chromium-driver)")
@pytest.mark.parametrize("width", [1200, 390])
def test_browser_shows_pages_without_overflow(pages, width):
    with webdriver.Browser(width, 844, dark=width == 390) as browser:
        for name, path in pages.items():
            browser.open(path.as_uri())
            assert browser.run("return document.documentElement.scrollWidth") <= width, name
            sizes = browser.run("return [...document.images].map(x => [x.complete, x.naturalWidth, x.width])")
            assert all(complete and natural > 0 and 200 < shown <= width for complete, natural, shown in sizes), name
            assert name in SILENT or browser.wait(
                "const x = document.querySelector('audio'); if (x.readyState == 0) x.load(); "
                "return x.readyState >= 1 && x.duration > 0.3 && !x.error"), name
            assert browser.console() == [], name
