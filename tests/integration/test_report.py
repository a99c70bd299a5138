"""Tests of the report: escaping, no external requests, completeness, and rendering in a browser."""

import base64
import json
import os
import re
import shutil
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path
from types import SimpleNamespace

import matplotlib
import numpy as np
import pytest
import webdriver
from datadirs import rir_dir
from report_run import HOSTILE, RIRS_PER_ROOM, ROOMS, make_measured, make_run, make_simulated
from wer_run import put_example

from roomeq.core.digests import digest
from roomeq.core.files import read_jsonl, write_json, write_text
from roomeq.core.stamps import FORMAT
from roomeq.corpora.characterise import characterise
from roomeq.corpora.split import split_rirs
from roomeq.eq.distance import EqSet
from roomeq.loop.features import N_FEATURES, feature_slice
from roomeq.records.rir_dir import read_rirs, write_rirs
from roomeq.report import figures, make_report, section_eq, section_rirs, section_summary
from roomeq.report.build_page import SECTIONS, render_page, render_section
from roomeq.report.formats import number, with_minus
from roomeq.report.kinds import MEASURED, SIMULATED
from roomeq.report.load import Run
from roomeq.report.render import environment
from roomeq.report.rir_sets import LIKE_T60, column_percentiles, measured_example, t60_mismatch
from roomeq.report.section_data import facts, limitations, measured
from roomeq.report.section_loop import REGIONS, facings, residual_sizes
from roomeq.wer import measure_wer

FIGURES = ("figure-1-left", "figure-1-right", "figure-2-measured", "figure-2-resampled", "figure-2-simulated",
           "figure-2-compensated", "figure-3-simulated", "figure-3-compensated", "figure-3-measured",
           *(f"figure-echogram-{n}" for n in "123"), "figure-summary-eq", "figure-t60-frequency",
           *(f"figure-room-{n}" for n in "123"),
           "figure-distance-points", "figure-accuracy-points", "figure-t60-histogram", "figure-t60-met",
           "figure-snr-train", "figure-snr-dev", "figure-snr-test", "figure-loop-map-before", "figure-loop-map-after",
           "figure-loop-ranking-1", "figure-loop-ranking-2", "figure-loop-ranking-3", "figure-loop-metrics",
           "figure-loop-bands", "figure-loop-source_response", "figure-wer-rates-panel",
           "figure-wer-rooms-train.sim.EQ.rvb",
           *(f"figure-loop-spectrum-{n}" for n in "12"),
           *(f"figure-loop-decay-{n}-{hz}" for n in "12" for hz in (125, 1000)))
TABLES = ("table-summary", "table-datasets", "table-distance", "table-accuracy", "table-rooms",
          "table-acoustic-parameters", "table-screening", "table-run", "table-loop", "table-loop-errors",
          "table-loop-explained", "table-loop-geometry", "table-loop-power", "table-wer", "table-wer-changes",
          "table-wer-rooms", "table-wer-strata")
CLIPS = ("audio-clean", "audio-sim", "audio-sim-EQ", "audio-sim-loop", "audio-real")


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Make a run and its report: the data directory, the experiment directory and the page."""
    root = tmp_path_factory.mktemp("<i>run")
    data, exp = make_run(root)
    return data, exp, make_report(data, exp, root / "report")


class Page(HTMLParser):
    """Elements of a page by tag, with their attributes, and its text with line breaks as blanks."""

    def __init__(self, text):
        super().__init__()
        self.elements, self.text, self._within = [], "", []
        self.feed(text)
        self.text = re.sub("[ \n]+", " ", self.text)

    def handle_starttag(self, name, attributes):
        self.elements.append((name, dict(attributes)))
        if name not in ("img", "meta"):
            self._within.append(name)

    def handle_data(self, data):
        if self._within[-1:] != ["style"]:
            self.text += data

    def handle_endtag(self, name):
        while self._within.pop() != name:
            pass

    def of(self, name):
        return [attributes for tag, attributes in self.elements if tag == name]


def template(name):
    """Return the macros of a template."""
    return environment().get_template(f"{name}.html.j2").make_module(dict(
        held_out="", n_held_out=0, frequencies_hz=[], rows=[], panels=[], few_rooms="",
        gap=dict(closed=None)))


def section_text(ident, run):
    """Return the text of one section of a report."""
    section = next(section for section in SECTIONS if section.ident == ident)
    return Page(render_section(run, section)).text


@pytest.fixture(scope="module")
def page(made):
    return Page(made[2].read_text())


@pytest.mark.parametrize("text", HOSTILE)
def test_templates_escape_text_and_attributes(text):
    built = environment().from_string('<p title="{{ text }}">{{ text }}</p>').render(text=text)
    parsed = Page(built)
    assert parsed.elements == [("p", {"title": text})] and parsed.text == text


def test_undecodable_names_are_replaced_on_the_page(tmp_path):
    (tmp_path / "measured").mkdir()
    stamp = dict(step="read-measured", key="", files={}, format=FORMAT, options=dict(name="a\udcff"))
    (tmp_path / "measured/.done").write_text(json.dumps(stamp))
    page = render_page(Run(tmp_path, tmp_path))
    assert "name = a?" in page and page.encode()


def test_table_cells_are_escaped_and_aligned():
    made = environment().from_string(
        '{% from "macros.html.j2" import table %}'
        '{% call table("t", columns, rows) %}{{ caption }}{% endcall %}').render(
        caption="<caption>", columns=[("a", "text"), ("<b>", "number")], rows=[["<i>", 2]])
    assert "&lt;i&gt;" in made and "&lt;b&gt;" in made
    assert '<td role="cell" class="number" data-label="&lt;b&gt;">2</td>' in made
    assert "&lt;caption&gt;" in made


@pytest.mark.parametrize(("value", "text"), [(1.25, "1.2"), (-0.5, "−0.5"), (-0.04, "0.0"), (None, "–"),
                                             (float("nan"), "–")])
def test_number_formats_signs_and_gaps(value, text):
    assert number(value) == text


def test_minus_signs_replace_hyphens_of_numbers_only():
    assert with_minus("spk-1 -3 (-0.5)") == "spk-1 −3 (−0.5)"


def test_hostile_names_appear_as_text_only(page):
    assert all(text in page.text for text in HOSTILE)
    names = {name for name, _ in page.elements}
    assert not names & {"script", "i", "svg", "iframe", "object", "link"}
    assert not [key for _, attributes in page.elements for key in attributes if key.startswith("on")]


def test_page_makes_no_external_requests(made, page):
    for _, attributes in page.elements:
        assert attributes.get("src", "data:").startswith("data:")
        assert attributes.get("href", "#").startswith("#")
    policy = next(meta["content"] for meta in page.of("meta") if meta.get("http-equiv") == "Content-Security-Policy")
    assert policy.startswith("default-src 'none'")
    for image in page.of("img"):
        svg = base64.b64decode(image["src"].partition(",")[2]).decode()
        assert all(link[0] in "#d" for link in re.findall(r'href="([^"]+)"', svg))
    assert str(made[0].parent) not in made[2].read_text()


def test_page_has_each_figure_table_and_clip_once(page):
    ids = [attributes["id"] for _, attributes in page.elements if "id" in attributes]
    assert len(ids) == len(set(ids))
    assert {image["id"] for image in page.of("img")} == set(FIGURES)
    assert all(len(image["alt"]) > 20 for image in page.of("img"))
    assert {table["id"] for table in page.of("table")} == set(TABLES)
    assert {clip["id"] for clip in page.of("audio")} == set(CLIPS)
    assert [link["href"] for link in page.of("a")] == [f"#{section.ident}" for section in SECTIONS]
    assert "Not in this run" not in page.text
    assert re.search(r"\d+ of \d+ simulated training RIRs have randomly drawn coordinates or room sizes", page.text)


def test_counts_match_the_run(made, page):
    data, _, path = made
    rows = {kind: len(read_jsonl(data / f"rirs.{kind}.train" / "rirs.jsonl")) for kind in ("real", "sim")}
    body = path.read_text()
    line = re.search(r"<tr[^>]*><th[^>]*><code>train.sim.rvb</code></th>(.*?)</tr>", body)[1]
    assert re.findall(r"<td[^>]*>(.*?)</td>", line)[1:3] == ["4", str(rows["sim"])]
    assert f"{RIRS_PER_ROOM * len(ROOMS)} measured RIRs of {len(ROOMS)} rooms" in page.text
    assert re.search(r"binaural\s*</th>\s*<td[^>]*>not in the EQ fit</td><td[^>]*>4</td>", body)


def test_loop_section_describes_effects_and_errors(page):
    assert "source_response or mic_response: Magnitude response of each loudspeaker" in page.text
    assert ("The data do not discriminate between these effects. A further measurement would: a recording of "
            "the same room with another") in page.text
    assert "The held-out error falls from 3.40 to 1.90 JND (95\N{NO-BREAK SPACE}% interval 1.60 to 2.20)" in page.text
    assert ("Sound before the direct sound at 125 Hz is 3.5 dB louder than simulated, equally in all rooms (+3.5 JND)."
            in page.text)
    assert "A surface 0.70 m (0.70 to 0.70) below source and microphone reflects 60 %" in page.text
    assert "Limitations of the closed loop" in page.text and "3.4 \u2192 1.5" in page.text
    assert "depth_m 0.7 (0.7 to 0.7); reflection 0.6 (0.6 to 0.6)" in page.text
    assert "79\N{NO-BREAK SPACE}% (59\N{NO-BREAK SPACE}% to 99\N{NO-BREAK SPACE}%)" in page.text
    assert re.search(r"noise_floor\s*not tried\s*0\.7\s*a recording of the background noise before the sweep",
                     page.text)
    assert re.search(r"room_eq\s*no fall in rooms with other devices\s*0\.5", page.text)
    assert "2.73 ± 0.03 m" in page.text and "height of the room" in page.text and "width of the room" not in page.text
    assert "cannot fall further, as it lies within a quarter of a JND of the ceiling: T30; C50." in page.text
    assert ("10 RIRs took no part (7: the room's dimensions are unknown; 3: the positions are marked unreliable). "
            "3 RIRs of the test set took no part (3: the positions are marked unreliable)." in page.text)


@pytest.mark.parametrize("own_test, rooms", [(False, 4), (True, 6)])
def test_test_rirs_of_their_own_count_and_share_no_room(own_test, rooms, tmp_path):
    make_measured(tmp_path / "measured")
    characterise(tmp_path / "measured", tmp_path / "rirs.real")
    split_rirs(tmp_path / "rirs.real", tmp_path / "rirs.real", sizes=(26, 8, 10), seed=0,
               test_rirs=rir_dir(tmp_path / "rirs.test") if own_test else None)
    run = Run(tmp_path, tmp_path / "exp")
    n_test, n_all = (6, 50) if own_test else (10, 44)
    assert facts(run) == {"n_measured": n_all, "n_rooms": rooms}
    context = measured(run)
    assert (context["totals"][2 + context["splits"].index("test")], context["totals"][-1]) == (n_test, n_all)
    assert ("share rooms" in section_text("limits", run)) is not own_test


def test_steps_name_directories_without_a_stamp(page):
    assert re.search(r"data/train.clean ?no stamp: made or changed by hand", page.text)
    assert re.search(r"exp/eq ?fit-eq", page.text)


def test_distance_table_has_a_row_for_the_loop(made):
    table_of_distances = made[2].read_text().partition('id="table-distance"')[2].partition("</table>")[0]
    assert re.findall(r'class="key (\w+)', table_of_distances) == ["simulated", "compensated", "drawn", "measured"]
    assert "simulated + loop" in table_of_distances


def test_distances_of_too_few_rooms_have_no_interval_and_it_is_said(made, monkeypatch, caplog):
    of_run = section_eq.eq_set
    monkeypatch.setattr(section_eq, "eq_set", lambda run, name: of_run(run, name) if name != section_eq.HELD_OUT else (
        EqSet(of_run(run, name).vectors_db, [f"room{n % 2}" for n in range(len(of_run(run, name).vectors_db))])))
    text = section_text("distance", Run(made[0], made[1]))
    stated = "Distances from or to a set of fewer than 3 rooms have no interval: held-out (2)."
    assert stated in text and stated in caplog.text and " to " not in text.partition("Wasserstein (dB)")[2][:300]


def test_page_without_loop_or_wer_omits_their_sections(made, tmp_path):
    for name in ("measured", "rirs.real", "rirs.real.train"):
        shutil.copytree(made[0] / name, tmp_path / "data" / name)
    text = render_page(Run(tmp_path / "data", tmp_path / "exp"))
    assert "Closed loop: effects added" not in text and "#loop" not in text and "sim.loop" not in text
    assert "Word error rates" not in text and "No recogniser was trained" in text


def test_wer_section_states_rates_and_intervals(page):
    assert "With one seed" not in page.text and "16 test utterances (160 words) in 4 rooms, 2 seeds" in page.text
    assert "50 % (50 to 50)" in page.text and "\u221220.00 (\u221220.00 to \u221220.00)" in page.text
    assert "52.5 \u2192 32.5" in page.text and "Only the table lists train.clean" in page.text
    assert "No recogniser was trained" not in page.text


@pytest.mark.parametrize(("errors", "shown", "not_shown"), [
    ({"train.clean": 8}, ["train.clean (baseline)"],
     ["Change against", "Only the table lists", "Detectable difference"]),
    ({"train.sim.rvb": 5, "train.real.rvb": 5, "train.sim.EQ.rvb": 4},
     ["gap not significant"], ["Detectable difference"]),
    ({"train.sim.rvb": 5, "train.sim.EQ.rvb": 4}, ["Change against"], ["gap not significant"])])
def test_wer_section_adapts_to_available_rows(tmp_path, errors, shown, not_shown):
    measure_wer(put_example(tmp_path, errors=errors), tmp_path / "exp/wer", rirs=[tmp_path / "rirs"])
    text = section_text("wer", Run(tmp_path / "data", tmp_path / "exp"))
    assert "With one seed the spread over seeds is not known" in text
    assert all(part in text for part in shown) and not any(part in text for part in not_shown)


def test_word_error_rates_of_other_data_are_left_out(made, tmp_path, caplog):
    (tmp_path / "data").mkdir()
    for name in ("rirs.real.train", "rirs.sim.train", "test.real.rvb"):
        (tmp_path / "data" / name).symlink_to(made[0] / name)
    workspaces = put_example(tmp_path, seeds=2, errors={"train.sim.rvb": 5, "train.sim.EQ.rvb": 4})

    def measured(*contents):
        for workspace, content in zip(workspaces, contents, strict=True):
            write_text(workspace / "data/test.real.rvb/content", f"{content}\n")
        path = measure_wer(workspaces, tmp_path / "exp/wer", rirs=[tmp_path / "rirs"])
        assert json.loads(path.read_text())["data"] == {"test.real.rvb": sorted(contents)}
        return Run(tmp_path / "data", tmp_path / "exp")

    run = measured(digest(made[0] / "test.real.rvb"), "1" * 64)
    assert run.has("wer") and "is of other data" not in section_text("summary", run)
    run = measured("0" * 64, "1" * 64)
    assert "Not known: exp/wer is of other data: run stages 8 to 10." in section_text("summary", run)
    page = make_report(run.data_dir, run.exp_dir, tmp_path / "report").read_text()
    assert "No recogniser was trained on these data." in page and "table-wer" not in page
    assert f"{tmp_path}/exp/wer is of other data: run stages 8 to 10" in caplog.messages


def test_wer_section_states_detectable_difference(tmp_path):
    workspaces = put_example(tmp_path, seeds=2, errors={"train.sim.rvb": 8, "train.sim.EQ.rvb": 4})
    path = measure_wer(workspaces, tmp_path / "exp/wer", rirs=[tmp_path / "rirs"])
    found = json.loads(path.read_text())["results"]["train.sim.EQ.rvb"]["tgsmall"]["change"]
    text = section_text("wer", Run(tmp_path / "data", tmp_path / "exp"))
    detectable = found["detectable"]
    assert f"{detectable['difference']:.2f} points (tgsmall)" in text
    assert f"{detectable['for_half']['rooms']} rooms" in text


def test_residual_map_averages_each_region_and_band():
    residual = np.full((2, N_FEATURES), np.nan)
    residual[0, feature_slice("t30")] = 3.0
    residual[1, feature_slice("late")] = -1.0
    residual[1, feature_slice("drr")] = 2.0
    found = residual_sizes(residual)
    late, direct = REGIONS.index("late"), REGIONS.index("direct")
    np.testing.assert_array_equal(found[late, :8], 2.0)
    assert found[direct, 8] == 2.0 and np.isfinite(found).sum() == 9


def test_facings_of_the_test_set_are_marked():
    entry = dict(source="s1", rirs=9, positions=3, hypothesis="fixed", evidence=dict(fixed=9.0, free=1.0),
                 angle_deg=20.0)
    ledger = dict(facings=[entry], test=dict(facings=[entry | dict(rirs=4)]))
    first, second = facings(ledger)
    assert first.startswith("source s1: 9 RIRs ") and second.startswith("in the test set, source s1: 4 RIRs ")


def test_page_is_reproducible_across_processes(made):
    data, exp, path = made
    code = ("import sys; from pathlib import Path; from roomeq.report.load import Run; "
            "from roomeq.report.build_page import render_page; "
            "sys.stdout.buffer.write(render_page(Run(Path(sys.argv[1]), Path(sys.argv[2]))).encode())")
    other = subprocess.run([sys.executable, "-c", code, data, exp], capture_output=True, check=True,
                           env={**os.environ, "PYTHONHASHSEED": "7", "PYTHONPATH": os.pathsep.join(sys.path)})
    assert other.stdout == path.read_bytes()


def test_settings_of_the_user_do_not_change_figures():
    """As a matplotlibrc in the home directory has them: with usetex, the report ended where LaTeX is absent."""
    def draw(axes, colours):
        axes.plot([1, 2], [3, 4])
        axes.set_xlabel("share of rooms_x [%]")

    before = figures.render_svg(draw)
    with matplotlib.rc_context({"text.usetex": True, "lines.marker": "o"}):
        assert figures.render_svg(draw) == before
        assert matplotlib.rcParams["lines.marker"] == "o"


def test_report_is_rebuilt_only_when_needed(made, caplog):
    data, exp, path = made
    before = path.stat().st_mtime_ns
    caplog.set_level("INFO")
    assert make_report(data, exp, path.parent) == path
    assert path.stat().st_mtime_ns == before and "up to date" in caplog.text


def test_bench_results_are_linked_if_present(made):
    data, exp, _ = made
    without = Run(data, exp)
    assert "tests/bench/speed/run.py" in render_page(without) and "../bench" not in render_page(without)
    (exp / "bench").mkdir()
    try:
        (exp / "bench" / "speed.json").write_text("{}")
        assert re.findall(r'href="(\.\./[^"]+)"', render_page(Run(data, exp))) == ["../bench/speed.json"]
    finally:
        shutil.rmtree(exp / "bench")


def test_missing_parts_name_their_stage(made, tmp_path):
    data, exp, _ = made
    (tmp_path / "data").mkdir()
    for name in ("measured", "rirs.real", "rirs.real.train"):
        shutil.copytree(data / name, tmp_path / "data" / name)
    text = Page(render_page(Run(tmp_path / "data", tmp_path / "exp"))).text
    for part in ("data/rirs.sim.train. Run stage 2 (roomeq simulate) to make it.",
                 "data/rirs.sim.EQ.train. Run stage 4 (roomeq compensate) to make it.",
                 "exp/eq/measured.jsonl. Run stage 3 (roomeq fit-eq) to make it.",
                 "any data/*.rvb. Run stage 6 (roomeq augment) to make it."):
        assert part in text


def test_sets_of_an_earlier_run_are_left_out(made, tmp_path):
    data, exp, path = made
    assert "sim.loop" in path.read_text() and 'id="loop"' in path.read_text()
    now = make_report(data, exp, tmp_path / "report", kinds=("real", "sim", "sim.EQ")).read_text()
    assert 'id="loop"' not in now and not re.search("sim.loop|simulated [+] loop", Page(now).text)
    with pytest.raises(ValueError, match="kinds: 'simulated' must be one of real, sim.free, sim, sim.EQ, sim.loop"):
        make_report(data, exp, tmp_path / "report", kinds=["simulated"])


def test_synthetic_corpus_is_announced_at_the_top(made, tmp_path):
    data, exp, _ = made
    shutil.copytree(data / "measured", tmp_path / "data/measured")
    assert "Synthetic data" not in render_page(Run(tmp_path / "data", exp))
    (tmp_path / "data/measured/README").write_text("Generated, not measured: a stand-in.\n")
    assert "Synthetic data" in render_page(Run(tmp_path / "data", exp))


def test_data_dir_without_a_run_is_an_error(tmp_path):
    with pytest.raises(ValueError, match="no directory of a run in it: run stages 0 to 6 first"):
        make_report(tmp_path, tmp_path, tmp_path / "report")


def test_foreign_output_directory_is_left_unchanged(made, tmp_path):
    (tmp_path / "thesis.txt").write_text("mine")
    with pytest.raises(ValueError, match="was not made by roomeq"):
        make_report(made[0], made[1], tmp_path)


def test_malformed_table_names_file_and_key(made, tmp_path):
    shutil.copytree(made[0] / "train.real.rvb", tmp_path / "train.real.rvb")
    (tmp_path / "train.real.rvb/utt2dur").write_text("a b\n")
    with pytest.raises(ValueError, match="utt2dur: a: 'b' must be a number"):
        render_page(Run(tmp_path, tmp_path))


def test_options_show_the_last_part_of_paths(made, tmp_path):
    (tmp_path / "measured").mkdir()
    write_json(tmp_path / "measured/.done", dict(step="read-measured", key="", files={}, format=FORMAT,
                                                 options=dict(seed=3, source="/home/me/corpora/rooms", kind=None)))
    text = Page(render_page(Run(tmp_path, tmp_path))).text
    assert "source = rooms" in text and "/home" not in text and "kind" not in text


@pytest.mark.parametrize(("closed", "part"), [(0.8, "closes 80 % of"), (1.2, "is small, and rooms"), (None, "no gap")])
def test_verdict_matches_the_closed_share(closed, part):
    gap = dict(closed=closed, closed_interval=[0.5, 1.0], closed_energy=None)
    verdict = Page(template("distance").verdict(gap)).text
    assert part in verdict and "no interval" not in verdict
    without = Page(template("distance").verdict(gap | dict(closed_interval=None))).text
    assert ("no interval" in without) == (closed is not None)
    assert ("is small, and rooms" in verdict) == (closed == 1.2)


def test_row_of_all_points_names_those_beyond_the_limits(monkeypatch):
    errors = np.zeros((20, 8))
    errors[:, 0] = 2.0
    monkeypatch.setattr(section_eq, "eq_errors", lambda run, names: errors)
    rows = section_eq.accuracy(Run(Path("data"), Path("exp")))["rows"]
    assert [row[-1] for row in rows] == ["no", *["yes"] * 6, "not at 62.5\N{NO-BREAK SPACE}Hz"]


def test_summary_states_lack_error_and_worth(made):
    text = section_text("summary", Run(made[0], made[1]))
    assert re.search(r"the median simulated RIR is \d\.\d dB too (quiet|loud) at", text)
    assert "Frequency response of the loudspeakers" in text and "Unexplained" in text
    assert "Held-out error (JND), unseen rooms" in text and "1.0, noise ceiling" in text
    assert "train.sim.EQ.rvb instead of train.sim.rvb changes the word error rate by \u221220.0" in text
    assert "closes 50\N{NO-BREAK SPACE}% of the gap" in text


@pytest.mark.parametrize("low_db, text", [
    (0.0, "of the median measured RIR at all points."),
    (np.nan, "at all other points. At 62.5\N{NO-BREAK SPACE}Hz it is not known: no simulated or no measured RIR has")])
def test_summary_names_points_without_a_valid_eq(low_db, text, monkeypatch, tmp_path):
    for name in ("real", "sim"):
        (tmp_path / f"rirs.{name}.train").mkdir()
    monkeypatch.setattr(section_summary, "eq_vectors", lambda run, name: np.array([[low_db, *[0.0] * 7]]))
    assert text in section_text("summary", Run(tmp_path, tmp_path / "exp"))


def test_decay_over_frequency_omits_octaves_of_which_few_are_valid():
    """At 62.5 Hz, only the RIR with the longest decay is valid; one has no T30 at 1 kHz."""
    def rir(lowest_s, valid, valid_1khz=True):
        flags = [valid, True, True, True, valid_1khz, True, True, True]
        return dict(acoustic_parameters=dict(t30_s=[lowest_s] + [0.4] * 7, t30_valid=flags))

    rows = [rir(0.8, True), rir(0.3, False), rir(0.3, False), rir(0.8, True, valid_1khz=False)]
    run = SimpleNamespace(has=lambda name: name == "rirs.real.train", rirs=lambda name: rows)
    (measured,) = section_rirs.decay_series(run)
    assert np.isnan(measured.middle[0])
    np.testing.assert_allclose(measured.middle[1:], 1.0)


def test_examples_have_similar_reverberation_times(made):
    run = Run(made[0], made[1])
    chosen = measured_example(run, (MEASURED, SIMULATED))
    best = min(t60_mismatch(row, other) for row in run.rirs(MEASURED.train) for other in run.rirs(SIMULATED.train)
               if other["measured_id"] == row["id"])
    assert t60_mismatch(chosen[MEASURED], chosen[SIMULATED]) <= max(LIKE_T60, best)


@pytest.mark.parametrize("drawn", [False, True])
def test_examples_of_drawn_rooms_are_of_another_place(drawn, tmp_path):
    make_measured(tmp_path / "measured")
    characterise(tmp_path / "measured", tmp_path / "rirs.real.train")
    make_simulated(read_rirs(tmp_path / "rirs.real.train"), tmp_path / "rirs.sim.train")
    if drawn:
        write_rirs(tmp_path / "rirs.sim.train", [row | dict(measured_id=None, room_id="drawn")
                                                 for row in read_rirs(tmp_path / "rirs.sim.train")])
    run = Run(tmp_path, tmp_path / "exp")
    for ident, place in (("responses", "uses its room and positions"), ("spectrograms", "RIRs of one place")):
        text = section_text(ident, run)
        assert (place in text, "of another place" in text) == (not drawn, drawn)


@pytest.mark.parametrize("drawn", [False, True])
def test_targets_and_drawn_coordinates_are_said_as_they_are(drawn, tmp_path):
    make_measured(tmp_path / "measured")
    characterise(tmp_path / "measured", tmp_path / "rirs.real.train")
    make_simulated(read_rirs(tmp_path / "rirs.real.train"), tmp_path / "rirs.sim.train")
    rows = read_rirs(tmp_path / "rirs.sim.train")
    write_rirs(tmp_path / "rirs.sim.train", [
        row | dict(drawn=["target_t60_s again"]) | (dict(room_type="office") if drawn else {}) for row in rows])
    run = Run(tmp_path, tmp_path / "exp")
    text = section_text("reverberation", run)
    assert ("distributions of the room types" in text, "a uniform distribution" in text) == (drawn, not drawn)
    assert limitations(run)["n_drawn"] == 0
    write_rirs(tmp_path / "rirs.sim.train", [row | dict(drawn=["target_t60_s again", "mic_pos_m.2"]) for row in rows])
    assert limitations(Run(tmp_path, tmp_path / "exp"))["n_drawn"] == len(rows)


def test_share_of_an_uncertain_gap_is_no_headline():
    unsure = dict(gap=dict(closed=1.16, closed_interval=None))
    shown = [Page(environment().get_template("facts.html.j2").render(facts=of_gap)).text for of_gap in (
        unsure, dict(gap=unsure["gap"] | dict(closed_interval=[0.5, 1.4])))]
    assert ["closed by compensation" in text for text in shown] == [False, True]


@pytest.mark.parametrize("label", ["W" * 90, "measured, simulated, simulated + EQ, simulated + loop (n = 132,123)"])
def test_legends_fit_into_their_figures(label):
    fitted = []

    def draw(axes, colours):
        axes.plot([0, 1], label=label)
        axes.plot([0, 1], label="short")
        figures.legend(axes)
        figure = axes.figure
        figure.canvas.draw()
        fitted.append(figure.legends[0].get_window_extent().width <= figure.bbox.width)

    figures.render_svg(draw, figures.SMALL_IN)
    assert fitted == [True]


def test_common_limits_cover_nearly_all_values():
    assert figures.common_limits(np.array([[-12.0, 3.0]]), np.array([[np.nan, 8.0]])) == (-15.0, 10.0)
    assert figures.common_limits(np.full((1, 8), np.nan)) == (-15.0, 15.0)


def test_column_percentiles_ignore_gaps():
    low, = column_percentiles(np.array([[1.0, np.nan], [3.0, np.nan]]), (50,))
    assert low[0] == 2.0 and np.isnan(low[1])


@pytest.mark.skipif(not webdriver.installed(), reason="needs chromium and chromedriver (Debian: chromium-driver)")
@pytest.mark.parametrize("width", [1200, 390])
def test_browser_renders_all_elements(made, width):
    with webdriver.Browser(width, 844, dark=width == 390) as browser:
        browser.open(made[2].as_uri())
        images = browser.run("return [...document.images].map(x => [x.id, x.complete, x.naturalWidth, x.width])")
        assert {ident for ident, *_ in images} == set(FIGURES)
        for _, complete, natural_width, shown_width in images:
            assert complete and natural_width > 0 and 200 < shown_width <= width
        tables = dict(browser.run("return [...document.querySelectorAll('table')]"
                                  ".map(x => [x.id, x.tBodies[0].rows.length])"))
        assert set(tables) == set(TABLES) and min(tables.values()) > 0
        for clip in CLIPS:
            assert browser.wait("const x = document.getElementById(arguments[0]); if (x.readyState == 0) x.load(); "
                                "return x.readyState >= 1 && x.duration > 0.5 && !x.error", clip)
        assert browser.run("return document.documentElement.scrollWidth") <= width
        assert browser.run("return document.querySelectorAll('h1').length") == 1
        paper = browser.run("return getComputedStyle(document.body).backgroundColor")
        assert paper == ("rgb(22, 27, 34)" if width == 390 else "rgb(255, 255, 255)")
        assert browser.console() == []


def test_histogram_of_more_groups_than_line_styles():
    groups = [(f"group {n}", "measured", np.arange(n + 3.0)) for n in range(7)]
    panel = figures.panel("figure-many", figures.histogram("", groups, np.arange(10.0), "SNR (dB)"), "many groups")
    assert panel
