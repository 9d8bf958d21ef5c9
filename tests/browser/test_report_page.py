"""Reports in a real browser, from disk and without a network: what a reader sees and can do."""

from __future__ import annotations

import dataclasses
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import pytest

import fdilog
from fdilog.analysis import Analysis, analyse_recording
from fdilog.config import Config
from fdilog.recording import Problem
from fdilog_reports import html, plots
from tests.reports_factory import analysis, bias, evidence, failed_analysis, table, with_error

SAMPLES = [
    "three_imus_bias.bin", "two_imus_bias.bin", "dropout.bin", "one_imu_dead_gyro.bin",
    "two_imus_attitude.bin", "three_imus_healthy.bin",
]  # fmt: skip
REAL = ["dataflash/copter_3imu_vibration_crash.bin", "dataflash/rover_dead_gyro.bin"]
DESKTOP, PHONE = {"width": 1280, "height": 800}, {"width": 390, "height": 844}
DRAWN = "document.documentElement.classList.contains('drawn') && window.Bokeh?.documents.length"
RANGES = "Bokeh.documents[0].roots().map(plot => [plot.x_range.start, plot.x_range.end])"
HOSTILE = (
    "</script><script>window.hacked=1</script><img src=x onerror=window.hacked=1>"
    "\"'`$$\\href{javascript:window.hacked=1}{x}$$\0\u202e\u05d0{{7*7}}"
)
# Drawing takes half a second on an idle machine; what is waited for here is a busy one.
PATIENCE_MS = 20_000

Open = Callable[..., Any]


class Opened:
    """A page with everything that it said or asked for."""

    def __init__(self, page: Any, path: Path) -> None:
        self.page, self.path = page, path
        self.messages: list[str] = []
        self.requests: list[str] = []
        page.on("console", self._console)
        page.on("pageerror", lambda error: self.messages.append(str(error)))
        page.on("dialog", lambda dialog: self.messages.append(f"dialog {dialog.message}"))
        page.on("request", lambda request: self.requests.append(request.url))

    def _console(self, message: Any) -> None:
        if message.type in {"error", "warning"}:
            self.messages.append(message.text)

    def goto(self, anchor: str = "", *, drawn: bool = True) -> Opened:
        self.page.goto(self.path.as_uri() + anchor)
        if drawn:
            self.page.wait_for_function(DRAWN, timeout=PATIENCE_MS)
        return self

    def asked_for_nothing_else(self) -> bool:
        return {url.partition("#")[0] for url in self.requests} == {self.path.as_uri()}


@contextmanager
def context(browser: Any, **more: Any) -> Iterator[Any]:
    made = browser.new_context(offline=True, **{"viewport": DESKTOP, **more})
    yield made
    made.close()


@cache
def analysed(path: Path) -> Analysis:
    return fdilog.analyse(path)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("reports")


def written(folder: Path, name: str, made: Analysis) -> Path:
    path = folder / f"{name}.html"
    if not path.exists():
        path.write_text(html.render(made), encoding="utf-8")
    return path


def report_of(request: pytest.FixtureRequest, folder: Path, log: str) -> tuple[Path, Analysis]:
    logs: Path = request.getfixturevalue("real_logs" if log in REAL else "sample_logs")
    made = analysed(logs / log)
    return written(folder, Path(log).stem, made), made


def bottom(locator: Any) -> float:
    box = locator.bounding_box()
    assert box is not None
    return float(box["y"] + box["height"])


@pytest.mark.parametrize("log", [*SAMPLES, *REAL])
def test_a_report_opens_from_disk_and_its_first_screen_holds_the_answer(
    log: str, browser: Any, request: pytest.FixtureRequest, folder: Path
) -> None:
    path, made = report_of(request, folder, log)
    with context(browser) as of:
        opened = Opened(of.new_page(), path).goto()
        page = opened.page
        assert page.inner_text(".verdict .word")
        assert bottom(page.locator(".verdict")) <= DESKTOP["height"]
        assert bottom(page.locator(".facts")) <= DESKTOP["height"]
        lines = page.locator(".brief li" if len(made.findings) > 1 else ".finding h3")
        assert lines.count() == len(made.findings)
        for line, finding in zip(lines.all(), made.findings, strict=True):
            assert bottom(line) <= DESKTOP["height"]
            assert all(name in line.inner_text() for name in finding.suspects)
        whole = page.evaluate(RANGES)
        canvas = page.locator("#stage .canvas").nth(1)
        canvas.scroll_into_view_if_needed()
        box = canvas.bounding_box()
        page.mouse.move(box["x"] + 0.4 * box["width"], box["y"] + 30)
        page.mouse.down()
        page.mouse.move(box["x"] + 0.5 * box["width"], box["y"] + 60, steps=3)
        page.mouse.move(box["x"] + 0.6 * box["width"], box["y"] + 60, steps=3)
        page.mouse.up()
        near = page.evaluate(RANGES)
        assert len(near) == page.locator("#stage .canvas").count() > 3
        assert all(each == near[0] for each in near)
        share = (near[0][1] - near[0][0]) / (whole[0][1] - whole[0][0])
        assert 0.15 < share < 0.25
        assert opened.messages == []
        assert opened.asked_for_nothing_else()


def two_findings() -> Analysis:
    later = bias(("imu0.x", "imu2.x"), start_s=90.0, end_s=100.0)
    return failed_analysis(findings=(bias(), later))


def test_a_link_to_a_finding_leads_to_it_and_its_link_to_its_plots(
    browser: Any, folder: Path
) -> None:
    path = written(folder, "two_findings", two_findings())
    with context(browser) as of:
        page = Opened(of.new_page(), path).goto("#finding-2").page
        assert page.evaluate("document.querySelector(':target').id") == "finding-2"
        top = page.locator("#finding-2").bounding_box()["y"]
        assert 0 <= top < DESKTOP["height"] / 2
        page.click("#finding-2 [data-finding]")
        page.locator("#moment", has_text="87.50 s").wait_for()
        assert page.evaluate(RANGES)[0] == pytest.approx([87.5, 102.5])
        assert 0 <= page.locator(".linked-group").first.bounding_box()["y"] < 100


def test_the_plots_are_moved_by_keys_and_buttons_and_read_at_the_pointer(
    browser: Any, folder: Path
) -> None:
    path = written(folder, "two_findings", two_findings())
    with context(browser) as of:
        page = Opened(of.new_page(), path).goto().page
        start, end = page.evaluate(RANGES)[0]
        page.focus("[data-look=whole]")
        page.keyboard.press("Tab")
        assert page.evaluate("document.activeElement.id") == "stage"
        page.keyboard.press("+")
        assert page.evaluate(RANGES)[0] == pytest.approx([end / 4, 3 * end / 4], abs=0.1)
        page.keyboard.press("ArrowRight")
        assert page.evaluate(RANGES)[0][0] == pytest.approx(3 * end / 8, abs=0.1)
        page.keyboard.press("0")
        assert page.evaluate(RANGES)[0] == [start, end]
        page.click("[data-look=in]")
        assert page.evaluate(RANGES)[0][1] < end
        page.click("[data-look=whole]")
        stage = page.locator("#stage").bounding_box()
        middle = stage["x"] + 54 + 0.42 * (stage["width"] - 62)
        page.locator("#stage .canvas").nth(6).hover()
        page.mouse.move(middle, page.locator("#stage .canvas").nth(6).bounding_box()["y"] + 40)
        assert page.inner_text("#moment").startswith("at 50.")
        assert "UTC" in page.inner_text("#moment")
        said = page.locator(".caption", has_text="imu1.y minus").inner_text()
        assert "interval" in said
        shown = page.locator(".key-button", has_text="imu1.y")
        shown.click()
        assert shown.get_attribute("aria-pressed") == "false"


def test_without_scripts_and_on_paper_the_pictures_are_there(browser: Any, folder: Path) -> None:
    path = written(folder, "two_findings", two_findings())
    with context(browser, java_script_enabled=False) as of:
        page = Opened(of.new_page(), path).goto(drawn=False).page
        assert page.locator("#residuals svg").first.is_visible()
        assert page.locator("#timeline svg").first.is_visible()
        assert not page.locator("#stage").is_visible()
        assert not page.locator("[data-finding]").first.is_visible()
    with context(browser) as of:
        page = Opened(of.new_page(), path).goto().page
        assert page.locator("#stage").is_visible()
        assert not page.locator("#residuals svg").first.is_visible()
        page.emulate_media(media="print")
        assert not page.locator("#stage").is_visible()
        assert page.locator("#residuals svg").first.is_visible()
        assert page.locator("#repeat details pre").is_visible()


def test_hundreds_of_findings_leave_the_answer_on_the_first_screen_and_the_page_small(
    browser: Any, folder: Path
) -> None:
    findings = tuple(
        bias(kind="impulse", start_s=0.1 * k, end_s=0.1 * k, detail="x" * 300) for k in range(600)
    )
    made = failed_analysis(findings=findings)
    path = written(folder, "hundreds", made)
    assert path.stat().st_size < 2_000_000
    with context(browser) as of:
        opened = Opened(of.new_page(), path).goto()
        assert bottom(opened.page.locator(".facts")) <= DESKTOP["height"]
        with opened.page.expect_download() as waited:
            opened.page.click("#download")
        assert Path(waited.value.path()).read_text("utf-8") == made.to_json()
        assert opened.messages == []


def hostile_analysis(sample_logs: Path) -> Analysis:
    """Analyse a real recording whose every string is an attack."""
    recording = fdilog.read(sample_logs / "two_imus_bias.bin")
    renamed = tuple(
        dataclasses.replace(stream, name=f"{HOSTILE}{number}", clock=HOSTILE)
        for number, stream in enumerate(recording.streams)
    )
    recording = dataclasses.replace(
        recording, path=f"{HOSTILE}.bin", format=HOSTILE, streams=renamed,
        vehicle={HOSTILE: HOSTILE}, problems=(Problem(what=HOSTILE, offset=7, bytes_lost=3),),
    )  # fmt: skip
    made = analyse_recording(recording, Config())
    channels = tuple(
        dataclasses.replace(channel, name=f"{HOSTILE}{channel.name}", source=HOSTILE)
        for channel in made.table.channels
    )
    found = tuple(
        dataclasses.replace(
            finding, suspects=tuple(f"{HOSTILE}{name}" for name in finding.suspects),
            detail=HOSTILE, witness=HOSTILE, detectors=(HOSTILE,),
        )
        for finding in made.findings
    )  # fmt: skip
    table = dataclasses.replace(made.table, channels=channels)
    return dataclasses.replace(made, table=table, findings=found)


def test_nothing_that_stands_in_a_log_is_executed(
    browser: Any, folder: Path, sample_logs: Path
) -> None:
    path = written(folder, "hostile", hostile_analysis(sample_logs))
    with context(browser) as of:
        opened = Opened(of.new_page(), path).goto()
        page = opened.page
        page.wait_for_timeout(300)
        assert page.evaluate("window.hacked") is None
        assert page.locator("img, iframe, object").count() == 0
        assert "<script>window.hacked=1</script" in page.locator("#stage").inner_text()
        assert "\u202e" not in page.inner_text("body")
        assert opened.messages == []
        assert opened.asked_for_nothing_else()


def test_a_page_cannot_run_what_it_was_not_made_with(browser: Any, folder: Path) -> None:
    text = html.render(failed_analysis())
    path = folder / "injected.html"
    path.write_text(text.replace("</main>", "<script>window.hacked=1</script></main>"), "utf-8")
    with context(browser) as of:
        opened = Opened(of.new_page(), path).goto()
        assert opened.page.evaluate("window.hacked") is None
        assert any("Content Security Policy" in message for message in opened.messages)


def test_reports_of_a_campaign_draw_with_the_script_they_share(
    browser: Any, tmp_path: Path
) -> None:
    path = tmp_path / "one.html"
    path.write_text(html.render_shared(failed_analysis()), encoding="utf-8")
    ((name, script),) = html.shared_files().items()
    (tmp_path / name).write_text(script, encoding="utf-8")
    with context(browser) as of:
        opened = Opened(of.new_page(), path).goto()
        assert opened.messages == []
        assert set(opened.requests) == {path.as_uri(), (tmp_path / name).as_uri()}


def test_a_damaged_reading_does_not_flatten_the_flight(browser: Any, folder: Path) -> None:
    made = table()
    at_s = float(made.time_s[len(made.time_s) // 2])
    damaged = with_error(made, "imu1.y", at_s, at_s, 1e6)
    tops = "Math.max(...Bokeh.documents[0].roots().map(plot => plot.y_range.end))"
    with context(browser) as of:
        page = Opened(of.new_page(), written(folder, "damaged", analysis(damaged))).goto().page
        assert page.locator(".linked .cut", has_text="are cut off").count() == 1
        assert page.evaluate(tops) < 1e3


def test_an_hour_of_six_channels_opens_and_is_drawn(browser: Any, folder: Path) -> None:
    made = with_error(
        table(sources=2, duration_s=3600.0, rate_hz=200.0), "imu1.y", 1800.0, 1800.0, 500.0
    )
    path = written(folder, "hour", analysis(made, evidence=(evidence(made, 60.0),)))
    assert path.stat().st_size < 1_000_000
    with context(browser) as of:
        page = Opened(of.new_page(), path).goto().page
        assert page.evaluate("performance.now()") < PATIENCE_MS
        # One sample of 720 000: it must be there to be seen.
        peak = page.evaluate(
            "Math.max(...Bokeh.documents[0].roots().map(plot => plot.y_range.end))"
        )
        assert peak > 500.0


AUDIT = """async () => (await axe.run(document, { resultTypes: ["violations"] })).violations
    .filter((found) => ["serious", "critical"].includes(found.impact))
    .map((found) => `${found.id}: ${found.nodes.map((node) => node.target).join(" ")}`)"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("viewport", [DESKTOP, PHONE], ids=["desktop", "phone"])
def test_nobody_is_shut_out(
    scheme: str, viewport: dict[str, int], browser: Any, request: Any, folder: Path
) -> None:
    axe = os.environ.get("FDILOG_AXE", "")
    if not Path(axe).is_file():
        pytest.skip("FDILOG_AXE does not name axe.min.js, of the npm package axe-core")
    paths = [
        written(folder, "two_findings", two_findings()),
        report_of(request, folder, "three_imus_healthy.bin")[0],
    ]
    with context(browser, color_scheme=scheme, viewport=viewport) as of:
        for path in paths:
            page = Opened(of.new_page(), path).goto().page
            page.evaluate(Path(axe).read_text("utf-8"))
            assert page.evaluate(AUDIT) == []
            assert page.evaluate("document.documentElement.scrollWidth") <= viewport["width"]


CONTRAST = """selector => {
    const channels = (colour) => colour.match(/[\\d.]+/g).map(Number);
    const luminance = (rgb) => rgb.slice(0, 3).map((v) => v / 255)
        .map((v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4))
        .reduce((sum, v, i) => sum + v * [0.2126, 0.7152, 0.0722][i], 0);
    return [...document.querySelectorAll(selector)].filter((e) => e.offsetParent).map((element) => {
        let behind = element;
        while (channels(getComputedStyle(behind).backgroundColor)[3] === 0)
            behind = behind.parentElement;
        const [a, b] = [getComputedStyle(element).color, getComputedStyle(behind).backgroundColor]
            .map((colour) => luminance(channels(colour)) + 0.05);
        return Math.max(a, b) / Math.min(a, b);
    });
}"""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_words_stand_out_from_their_paper(scheme: str, browser: Any, folder: Path) -> None:
    path = written(folder, "two_findings", two_findings())
    with context(browser, color_scheme=scheme) as of:
        page = Opened(of.new_page(), path).goto().page
        ratios = page.evaluate(
            CONTRAST, ".word, .sentence, .badge, dt, dd, .soft, td, th, h2, h3, a"
        )
        assert len(ratios) > 100
        assert min(ratios) >= 4.5  # WCAG 2.2, success criterion 1.4.3
        trace = page.evaluate(
            "Bokeh.documents[0].roots()[0].renderers.at(-1).glyph.line_color.value"
        )
        assert trace == ("#6a7d00" if scheme == "light" else "#c3d64a")


def test_a_figure_shows_itself_in_a_notebook(browser: Any, tmp_path: Path) -> None:
    figure = plots.linked_figure(failed_analysis())
    path = tmp_path / "notebook.html"
    path.write_text(f"<!DOCTYPE html><title>n</title>{figure._repr_html_()}", encoding="utf-8")
    with context(browser) as of:
        opened = Opened(of.new_page(), path).goto(drawn=False)
        frame = opened.page.frames[1]
        frame.wait_for_function(DRAWN, timeout=PATIENCE_MS)
        assert frame.locator("#stage .canvas").first.is_visible()
        assert opened.messages == []
