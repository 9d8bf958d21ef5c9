"""The campaign page in a real browser: it opens, sorts and filters, and nothing is refused."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from fdilog_reports import campaign_html
from tests.campaign_factory import campaign, finding, large, log

LOGS = 10_000
MOST_MS = 1000.0
TRIES = 5
"""The best of so many counts: what the page takes, not what others take from the machine."""
LOADED = "performance.getEntriesByType('navigation')[0].domComplete"


def opened(browser: Any, path: Path, text: str) -> tuple[Any, list[str]]:
    path.write_text(text, encoding="utf-8")
    page = browser.new_page()
    messages: list[str] = []
    page.on("console", lambda message: messages.append(message.text))
    page.on("pageerror", lambda error: messages.append(str(error)))
    page.on("dialog", lambda dialog: messages.append(f"dialog {dialog.message}"))
    page.goto(path.as_uri())
    return page, messages


def column(page: Any, number: int) -> list[str]:
    found: list[str] = page.eval_on_selector_all(
        f"#rows td:nth-child({number})", "cells => cells.map(cell => cell.innerText)"
    )
    return found


def test_ten_thousand_logs_open_and_sort_within_a_second(browser: Any, tmp_path: Path) -> None:
    page, messages = opened(browser, tmp_path / "index.html", campaign_html.render(large(LOGS)))
    load_ms = [page.evaluate(LOADED)]
    for _ in range(TRIES - 1):
        page.reload()
        load_ms.append(page.evaluate(LOADED))
    clicked = """name => {
        const begun = performance.now();
        const buttons = [...document.querySelectorAll("#table thead button")];
        buttons.find(button => button.innerText === name).click();
        document.body.offsetHeight;  // lay it out, too
        return performance.now() - begun;
    }"""
    sort_ms = {
        name: min(page.evaluate(clicked, name) for _ in range(TRIES))
        for name in ("Log", "Vehicle", "Length", "Lost")
    }
    page.click("#table thead button >> text=Length")
    lengths = column(page, 5)
    assert len(lengths) == 200
    assert lengths[0].endswith("min")
    assert messages == []
    assert min(load_ms) < MOST_MS, load_ms
    assert max(sort_ms.values()) < MOST_MS, sort_ms
    page.click("#more")
    assert page.locator("#rows tr").count() == LOGS


def test_it_filters_by_verdict_vehicle_and_word_and_sorts_numbers_as_numbers(
    browser: Any, tmp_path: Path
) -> None:
    made = campaign(
        log("a/log10.bin", "ann", "failed", duration_s=9.0, channels=(("imu1.y", "failed"),),
            findings=(finding("bias", "imu1.y"),), reports=("logs/log10-0.html",)),
        log("a/log9.bin", "ann", duration_s=100.0, channels=(("imu1.y", "healthy"),)),
        log("b/log2.bin", "bob", None, duration_s=None, error_kind="unreadable", error="cut short"),
        log("b/<img src=x onerror=alert(1)>.bin", "bob", duration_s=20.0),
    )  # fmt: skip
    page, messages = opened(browser, tmp_path / "index.html", campaign_html.render(made))
    page.click("#table thead button >> text=Length")
    assert column(page, 5) == ["100 s", "20 s", "9.0 s", ""]
    page.click("#table thead button >> text=Length")
    assert column(page, 5) == ["9.0 s", "20 s", "100 s", ""]
    page.click("#table thead button >> text=Log")
    assert [text.split("\n")[0] for text in column(page, 2)][1:] == [
        "log2.bin", "log9.bin", "log10.bin",
    ]  # fmt: skip
    page.click(".counts button[data-state='not analysed']")
    assert column(page, 7) == ["cut short"]
    page.click(".counts button[data-state='not analysed']")
    page.click(".matrix .cell a")
    assert [text.split("\n")[0] for text in column(page, 2)] == ["log10.bin"]
    assert page.get_attribute("#rows a", "href") == "logs/log10-0.html"
    page.fill("#find", "")
    page.select_option("#vehicle", "bob")
    assert len(column(page, 1)) == 2
    page.fill("#find", "CUT")
    assert column(page, 7) == ["cut short"]
    assert page.inner_text("#shown") == "1 of 4 logs"
    assert messages == []
