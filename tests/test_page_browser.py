"""The page of a run in a real browser. Needs Chromium and its driver; skipped where they lack."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from page_runs import (
    ALERT_FRAMES,
    COLLISION_FRAME,
    FIRST_S,
    HOSTILE,
    NAMES,
    hostile_run,
    made_up_run,
)

from hatn_sim.datatypes import DT_S, Score
from hatn_sim.log import read_run
from hatn_sim.log.schema import ALERTS_FILE, LINE_COUNTS, RUN_FILE
from hatn_sim.report.moment import moment_at
from hatn_sim.report.page.page import write_page
from hatn_sim.report.table import write_scores

pytestmark = pytest.mark.browser
ARGUMENTS = (
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
    *("--window-size=1200,1000", "--force-device-scale-factor=1"),
)


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Generator[Any]:
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    driver = shutil.which("chromedriver")
    if chromium is None or driver is None:
        pytest.skip("Chromium and chromium-driver are not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = chromium
    options.set_capability("goog:loggingPrefs", {"browser": "ALL"})
    for argument in (*ARGUMENTS, f"--user-data-dir={tmp_path_factory.mktemp('browser')}"):
        options.add_argument(argument)
    opened = webdriver.Chrome(options=options, service=webdriver.ChromeService(driver))
    yield opened
    opened.quit()


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = made_up_run(tmp_path_factory.mktemp("page") / "run")
    write_page(read_run(folder), folder, (20, "eastbound"))
    return folder


def waited(browser: Any, met: Callable[[dict[str, Any]], bool]) -> dict[str, Any]:
    """What the page shows, once that is so."""
    from selenium.webdriver.support.ui import WebDriverWait

    def shown(_: Any) -> Any:
        now = browser.execute_script("return window.hatn ? window.hatn.now() : null")
        return now if now and now["drawn"] and met(now) else False

    return WebDriverWait(browser, 30, 0.05).until(shown)


def opened(browser: Any, folder: Path, link: str = "") -> dict[str, Any]:
    browser.get("about:blank")
    browser.get_log("browser")
    browser.get((folder / "report.html").as_uri() + link)
    return waited(browser, lambda now: True)


def pressed(browser: Any, *keys: str) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    ActionChains(browser).send_keys(*keys).perform()


def clicked_at(browser: Any, xy_m: tuple[float, float]) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    canvas = browser.find_element("id", "map")
    x, y = browser.execute_script("return window.hatn.pixel(...arguments)", *xy_m)
    size = canvas.size
    chain = ActionChains(browser)
    chain.move_to_element_with_offset(canvas, x - size["width"] / 2, y - size["height"] / 2)
    chain.click().perform()


def test_it_opens_with_its_moment_and_without_a_complaint(browser: Any, run_folder: Path) -> None:
    now = opened(browser, run_folder)
    assert (now["ego"], round(now["time_s"], 3)) == ("eastbound", FIRST_S + 2.0)
    assert browser.title.startswith("eastbound northbound")
    assert now["said"] == "Pass before northbound"
    assert browser.get_log("browser") == []


def test_what_it_draws_is_what_the_log_says(browser: Any, run_folder: Path) -> None:
    opened(browser, run_folder)
    run = read_run(run_folder)
    table = run.predictions("made_up")
    for frame in (5, 50, 120):
        told = browser.execute_async_script(
            "window.hatn.at(arguments[0]).then(arguments[1])", FIRST_S + DT_S * frame
        )
        assert {one["id"] for one in told} == set(run.ids)
        for one in told:
            vehicle = run.ids.index(one["id"])
            track = (run.tracks.frame == frame) & (run.tracks.vehicle == vehicle)
            assert np.abs(run.tracks.xy_m[track][0] - one["xy_m"]).max() < 0.1
            assert abs(run.tracks.yaw_rad[track][0] - one["yaw_rad"]) < 0.01
            row = np.flatnonzero((table.frame == frame) & (table.vehicle == vehicle))[0]
            shown = np.array([mode["xy_m"] for mode in one["modes"]])
            assert np.abs(table.xy_m[row][:, 4::5] - shown).max() < 0.1
            assert [mode["chance"] for mode in one["modes"]] == [0.75, 0.25]
            slots = np.flatnonzero(table.slot_mask[row])
            assert [slot["id"] for slot in one["slots"]] == [
                run.ids[v] for v in table.slot_vehicle[row, slots]
            ]
            for slot, shown_slot in zip(slots, one["slots"], strict=True):
                if table.has_conflict[row]:
                    place = table.conflict_xy_m[row, slot]
                    assert np.abs(place - shown_slot["conflict_xy_m"]).max() < 0.1
                # Slots lie on the lanes, which are the axes here, from the front bumper on.
                strip = np.array(shown_slot["strip_xy_m"])
                behind = run.tracks.xy_m[
                    (run.tracks.frame == frame)
                    & (run.tracks.vehicle == run.ids.index(shown_slot["id"]))
                ][0]
                assert np.abs(strip).min(axis=1).max() < 0.1
                assert abs(np.linalg.norm(strip[0] - behind) - 2.0) < 0.15


def test_pixels_show_the_vehicle_where_it_is(browser: Any, run_folder: Path) -> None:
    opened(browser, run_folder, f"#t={FIRST_S + 2.0}&ego=eastbound")
    around = """
        const [x, y] = window.hatn.pixel(arguments[0], arguments[1]);
        const canvas = document.getElementById('map');
        return [...canvas.getContext('2d').getImageData(Math.round(x), Math.round(y), 1, 1).data];
    """
    x = -20.0 + 8.0 * 2.0
    red, green, blue, _ = browser.execute_script(around, x - 0.5, 0.0)  # its roof
    assert green > 120 and green > 2 * red and green > 2 * blue
    red, green, blue, _ = browser.execute_script(around, x - 12.0, -1.2)  # the road behind it
    assert max(red, green, blue) - min(red, green, blue) < 30


def test_it_plays_steps_and_scrubs(browser: Any, run_folder: Path) -> None:
    opened(browser, run_folder, f"#t={FIRST_S}")
    pressed(browser, " ")
    assert waited(browser, lambda now: now["time_s"] > FIRST_S + 0.25)["playing"]
    pressed(browser, " ")
    here = waited(browser, lambda now: not now["playing"])["time_s"]
    pressed(browser, "\ue014")  # arrow right
    waited(browser, lambda now: abs(now["time_s"] - here - DT_S) < 1e-6)
    browser.execute_script(
        "const bar = document.getElementById('scrub'); bar.value = arguments[0];"
        "bar.dispatchEvent(new Event('input'))",
        FIRST_S + 12.0,
    )
    waited(browser, lambda now: abs(now["time_s"] - FIRST_S - 12.0) < 1e-6)
    waited(browser, lambda now: f"#t={FIRST_S + 12.0:.1f}" in browser.current_url)
    assert browser.get_log("browser") == []


def test_a_click_chooses_the_ego(browser: Any, run_folder: Path) -> None:
    opened(browser, run_folder, f"#t={FIRST_S + 2.0}&ego=eastbound")
    clicked_at(browser, (0.0, -36.0 + 8.0 * 2.0))
    waited(browser, lambda now: now["ego"] == "northbound")
    waited(browser, lambda now: "ego=northbound" in browser.current_url)
    assert browser.find_element("css selector", "#panel h2").text == "northbound"


DRIVERS = ("eastbound", "northbound")


def test_alerts_and_events_lead_to_their_moments(browser: Any, run_folder: Path) -> None:
    opened(browser, run_folder, f"#t={FIRST_S}")
    onset_s, crash_s = (FIRST_S + DT_S * frame for frame in (ALERT_FRAMES[0], COLLISION_FRAME))
    pressed(browser, "\ue00f")  # page down
    now = waited(browser, lambda now: abs(now["time_s"] - onset_s) < 1e-6)
    assert [alert["type"] for alert in now["alerts"]] == ["CONFLICT"]
    assert "near northbound" in browser.find_element("id", "panel").text
    said = {ego: opened(browser, run_folder, f"#t={onset_s}&ego={ego}")["said"] for ego in DRIVERS}
    assert said["northbound"] == f"eastbound is told: {said['eastbound']}"
    assert not browser.find_element("css selector", "#panel .advice").is_displayed()
    run = read_run(run_folder)
    for frame in (ALERT_FRAMES[0] - 5, ALERT_FRAMES[0], ALERT_FRAMES[1] + 5):
        for ego in DRIVERS:  # as the picture of a moment has it
            now = opened(browser, run_folder, f"#t={FIRST_S + DT_S * frame}&ego={ego}")
            assert now["said"] == moment_at(run, frame, ego).headline
    rows = browser.find_elements("css selector", "#moments tbody tr")
    crash = next(row for row in rows if "T1" in row.text)
    crash.find_element("tag name", "button").click()
    now = waited(browser, lambda now: abs(now["time_s"] - crash_s) < 1e-6)
    assert now["alerts"] == []


def test_the_legend_tells_of_alerts_where_there_are_any(browser: Any, tmp_path: Path) -> None:
    folder = made_up_run(tmp_path / "run")
    for has_alerts in (True, False):
        if not has_alerts:
            (folder / ALERTS_FILE).write_text("", encoding="utf-8")
            head = json.loads((folder / RUN_FILE).read_text(encoding="utf-8"))
            head[LINE_COUNTS][ALERTS_FILE] = 0
            (folder / RUN_FILE).write_text(json.dumps(head), encoding="utf-8")
        write_page(read_run(folder), folder, (20, "eastbound"))
        opened(browser, folder)
        told = browser.find_element("id", "legend").text.split("\n")
        assert any("conflict" in words for words in told)
        assert any("alert" in words for words in told) == has_alerts


def test_names_from_a_file_are_only_ever_text(browser: Any, tmp_path: Path) -> None:
    folder = hostile_run(tmp_path / "run")
    write_page(read_run(folder), folder, (20, HOSTILE[0]))
    now = opened(browser, folder)
    assert now["ego"] == HOSTILE[0]
    pressed(browser, "n")
    waited(browser, lambda now: now["ego"] == HOSTILE[1])
    waited(browser, lambda now: "ego=%22%3E%3Csvg" in browser.current_url)
    link = browser.current_url.partition("#")[2]
    assert opened(browser, folder, f"#{link}")["ego"] == HOSTILE[1]
    assert browser.find_element("css selector", "#panel h2").text.startswith('"><svg onload')
    assert browser.find_elements("css selector", "img, svg, iframe, object, link") == []
    assert browser.get_log("browser") == []


def test_the_first_picture_is_there_when_the_page_is_loaded(browser: Any, run_folder: Path) -> None:
    """Who takes a screenshot of a page takes it then."""
    opened(browser, run_folder)
    drawn_ms, loaded_ms = browser.execute_script(
        "return [performance.getEntriesByName('first picture')[0].startTime,"
        " performance.getEntriesByType('navigation')[0].loadEventStart]"
    )
    assert 0.0 < drawn_ms < loaded_ms


def test_a_map_of_another_size_is_never_seen_empty(browser: Any, run_folder: Path) -> None:
    """What is on the canvas when the browser paints: after those who watch its size were told."""
    opened(browser, run_folder)
    script = """
        const told = arguments[0], canvas = document.getElementById('map');
        let first = true;
        new ResizeObserver(() => {
          if (first) { first = false; canvas.style.height = '311px'; return; }
          const [, , , alpha] = canvas.getContext('2d').getImageData(5, 5, 1, 1).data;
          told([canvas.height, alpha]);
        }).observe(canvas);
    """
    assert browser.execute_async_script(script) == [320, 255]  # the least height that it takes


def test_times_in_words_count_down(browser: Any, tmp_path: Path) -> None:
    words = "Yield to the red car; go after it in 4.8 s"
    folder = made_up_run(tmp_path / "run", names=NAMES, words=words)
    write_page(read_run(folder), folder, (0, NAMES[0]))
    assert opened(browser, folder)["said"] == words
    for seconds, expected in ((2.0, "in 2.8 s"), (4.7, "in 0.1 s"), (6.0, "now")):
        link = f"#t={FIRST_S + seconds}&ego={NAMES[0]}"
        assert opened(browser, folder, link)["said"] == words.replace("in 4.8 s", expected)
        assert f"said {seconds} s ago" in browser.find_element("id", "panel").text


@pytest.mark.parametrize(
    ("link", "told"),
    [
        ("#t=102.0&ego=nobody", ["\u201cnobody\u201d", "not in this run"]),
        ("#t=999&ego=eastbound", ["999 s", "from 100.0 s to 114.9 s"]),
        ("#t=noon", ["\u201cnoon\u201d", "expected seconds from 100.0 to 114.9"]),
    ],
)
def test_a_link_that_cannot_be_followed_says_so(
    browser: Any, run_folder: Path, link: str, told: list[str]
) -> None:
    now = opened(browser, run_folder, link)
    notice = browser.find_element("id", "notice")
    assert notice.is_displayed() and all(words in notice.text for words in told)
    assert now["ego"] != "northbound" and FIRST_S <= now["time_s"] <= FIRST_S + 14.9
    browser.execute_script("location.hash = '#t=103.0&ego=northbound'")
    waited(browser, lambda now: now["ego"] == "northbound")
    assert not notice.is_displayed()


def test_speeds_of_the_ego_are_those_of_the_log(browser: Any, run_folder: Path) -> None:
    """Both drive at 8 m/s, as is predicted and advised; the second mode is half as fast."""
    opened(browser, run_folder, f"#t={FIRST_S + 6.0}&ego=eastbound")
    shown = browser.execute_script("return window.hatn.speeds()")
    assert {round(speed, 2) for _, speed in shown["driven"]} == {8.0}
    assert (shown["driven"][0][0], shown["driven"][-1][0]) == pytest.approx((-5.0, 5.0))
    fast, slow = ([speed for _, speed in mode["points"]] for mode in shown["predicted"])
    assert fast == pytest.approx([8.0] * 6, abs=0.3) and slow == pytest.approx([4.0] * 6, abs=0.3)
    # Said at the first frame, for 5 s.
    assert [s for s, _ in shown["advised"]] == pytest.approx([0.5 * k - 6.0 for k in range(1, 11)])
    assert {speed for _, speed in shown["advised"]} == {8.0}


OVER_THE_MAP = """
    const map = document.getElementById('map').getBoundingClientRect();
    const boxes = [...document.querySelectorAll('#said, #clock, .zoom, #legend')]
      .map((part) => part.getBoundingClientRect())
      .map(({ left, top, right, bottom }) => [left, top, right, bottom])
      .map((box) => box.map((at, k) => at - (k % 2 ? map.top : map.left)));
    return [[map.width, map.height], boxes];
"""


def outside_of_all(point: tuple[float, float], boxes: list[list[float]]) -> bool:
    return not any(
        left < point[0] < right and top < point[1] < bottom for left, top, right, bottom in boxes
    )


@pytest.mark.parametrize("size", [(1200, 1000), (1000, 620), (390, 844)])
def test_the_ego_those_it_is_told_of_and_their_conflict_are_seen(
    browser: Any, run_folder: Path, size: tuple[int, int]
) -> None:
    """Both drive along the axes at 8 m/s and meet at (0, 0): places by hand, not by the page."""
    before = browser.get_window_size()
    phone = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    try:
        for seconds in (0.5, 2.0, 3.5):  # the last has an alert
            link = f"#t={FIRST_S + seconds}&ego=eastbound"
            now = opened(browser, run_folder, link)
            assert now["named"] == ["northbound"]
            east_m, north_m = -20.0 + 8.0 * seconds, -36.0 + 8.0 * seconds
            places = [(x, 0.0) for x in (east_m - 2.0, east_m, east_m + 2.0)]
            places += [(0.0, y) for y in (north_m - 2.0, north_m, north_m + 2.0)]
            places += [(0.0, 0.0)] if seconds < 2.5 else []  # the ego is at the conflict after that
            (wide, high), boxes = browser.execute_script(OVER_THE_MAP)
            for place in places:
                x, y = browser.execute_script("return window.hatn.pixel(...arguments)", *place)
                assert 0.0 < x < wide and 0.0 < y < high
                assert outside_of_all((x, y), boxes)
                for label in now["labels"]:
                    assert outside_of_all((x, y), [label["box"]]), label["words"]
            assert now["scale"] >= 4.0  # a car is 16 pixels long
            assert {"eastbound", "northbound"} <= {label["id"] for label in now["labels"]}
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
        browser.set_window_size(before["width"], before["height"])


SEEN_AT_ONCE = f"""
    const [size, boxes] = (() => {{ {OVER_THE_MAP} }})();
    const now = window.hatn.now(), driven = 8 * (now.time_s - arguments[0]);
    const places = [[driven - 20, 0], [0, driven - 36], [0, 0]];
    return [now, size, boxes, places.map((place) => window.hatn.pixel(...place))];
"""


def is_clear(place: list[float], size: list[float], boxes: list[list[float]]) -> bool:
    inside = 0.0 < place[0] < size[0] and 0.0 < place[1] < size[1]
    return inside and outside_of_all((place[0], place[1]), boxes)


@pytest.mark.parametrize(
    ("size", "is_followed"),
    [
        ((1200, 1000), True),
        ((390, 844), False),
        pytest.param((1200, 1000), False, marks=pytest.mark.slow),
        pytest.param((390, 844), True, marks=pytest.mark.slow),
    ],
)
def test_while_it_plays_those_told_of_stay_clear(
    browser: Any, run_folder: Path, size: tuple[int, int], is_followed: bool
) -> None:
    """Both drive on at 8 m/s, 80 m in all: places by hand at the time that the page tells."""
    phone = {"width": size[0], "height": size[1], "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    try:
        first = opened(browser, run_folder, f"#t={FIRST_S + 0.5}&ego=eastbound")
        pressed(browser, *("]]f" if is_followed else "]]"), " ")  # four times as fast
        seen: list[tuple[float, bool]] = []
        while not seen or seen[-1][0] < FIRST_S + 10.0:
            now, wide_high, boxes, (ego, other, _) = browser.execute_script(SEEN_AT_ONCE, FIRST_S)
            assert now["playing"] and now["speed"] == 4
            clear = is_clear(ego, wide_high, boxes) and is_clear(other, wide_high, boxes)
            seen.append((now["time_s"], clear))
            assert now["scale"] <= first["scale"] + 1e-6
        assert len(seen) > 3 and all(clear for _, clear in seen), seen
        pressed(browser, " ")
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_a_camera_that_a_hand_has_moved_stays(browser: Any, run_folder: Path) -> None:
    opened(browser, run_folder, f"#t={FIRST_S + 0.5}&ego=eastbound")
    pressed(browser, "-", "]", "]", " ")
    *_, (_, _, before) = browser.execute_script(SEEN_AT_ONCE, FIRST_S)
    waited(browser, lambda now: now["time_s"] > FIRST_S + 9.0)
    *_, (_, _, after) = browser.execute_script(SEEN_AT_ONCE, FIRST_S)
    assert after == before
    pressed(browser, " ")


def dragged(browser: Any, right_px: int, down_px: int) -> None:
    from selenium.webdriver.common.action_chains import ActionChains

    on_map = ActionChains(browser).move_to_element(browser.find_element("id", "map"))
    on_map.click_and_hold().move_by_offset(right_px, down_px).release().perform()


def test_follow_finds_the_ego_while_nothing_plays(browser: Any, run_folder: Path) -> None:
    """The one that is followed, and the next one chosen, too, at places by hand."""
    opened(browser, run_folder, f"#t={FIRST_S + 0.5}&ego=eastbound")
    dragged(browser, -300, 150)
    dragged(browser, -300, 150)
    _, size, boxes, (ego, _, _) = browser.execute_script(SEEN_AT_ONCE, FIRST_S)
    assert not is_clear(ego, size, boxes)
    drawn = browser.execute_script("return window.hatn.now().drawn")
    pressed(browser, "f")
    waited(browser, lambda now: now["following"] and now["drawn"] > drawn)
    _, size, boxes, (ego, _, _) = browser.execute_script(SEEN_AT_ONCE, FIRST_S)
    assert is_clear(ego, size, boxes)
    pressed(browser, *"++++++")
    _, size, boxes, (_, other, _) = browser.execute_script(SEEN_AT_ONCE, FIRST_S)
    assert not is_clear(other, size, boxes)
    drawn = browser.execute_script("return window.hatn.now().drawn")
    pressed(browser, "n")
    now = waited(browser, lambda now: now["ego"] == "northbound" and now["drawn"] > drawn)
    assert now["following"] and not now["playing"]
    _, size, boxes, (_, other, _) = browser.execute_script(SEEN_AT_ONCE, FIRST_S)
    assert is_clear(other, size, boxes)


FIRST_PICTURES = """
    const done = arguments[arguments.length - 1], seen = [];
    const look = () => {
      const now = window.hatn.now();
      seen.push([now.time_s, now.scale, ...window.hatn.pixel(0, 0)]);
      if (seen.length < 20) requestAnimationFrame(look); else done(seen);
    };
    // Play after a pause that is long against the haste of the camera.
    setTimeout(() => { document.getElementById('play').click(); look(); }, 1000);
"""


@pytest.mark.parametrize("seconds", [0.5, pytest.param(2.0, marks=pytest.mark.slow), 3.5])
def test_the_camera_sets_off_without_a_jerk(browser: Any, run_folder: Path, seconds: float) -> None:
    phone = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    try:
        opened(browser, run_folder, f"#t={FIRST_S + seconds}&ego=eastbound")
        seen = np.array(browser.execute_async_script(FIRST_PICTURES))
        passed_s, moved_px = np.diff(seen[:, 0]), np.abs(np.diff(seen[:, 2:], axis=0))
        # Opening keeps 26 px free at the edges, playing 70: that is the way; its pace is 0.25 s.
        assert (moved_px <= 44.0 * (1.0 - np.exp(-passed_s / 0.25))[:, None] + 0.1).all()
        assert moved_px.sum() > 1.0 and (seen[:, 1] == seen[0, 1]).all()
        pressed(browser, " ")
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


@pytest.mark.parametrize("is_followed", [False, True])
def test_who_wants_less_motion_has_a_camera_that_stands(
    browser: Any, run_folder: Path, is_followed: bool
) -> None:
    """Until it is asked to follow; both ends of 80 m do not fit into the map as it opens."""
    wish = [{"name": "prefers-reduced-motion", "value": "reduce"}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": wish})
    try:
        first = opened(browser, run_folder, f"#t={FIRST_S + 0.5}&ego=eastbound")
        *_, (_, _, before) = browser.execute_script(SEEN_AT_ONCE, FIRST_S)
        pressed(browser, *("]]f" if is_followed else "]]"), " ")
        waited(browser, lambda now: now["time_s"] > FIRST_S + 10.0)
        now, size, boxes, (ego, _, after) = browser.execute_script(SEEN_AT_ONCE, FIRST_S)
        assert now["scale"] == first["scale"]
        assert (after == before) == (not is_followed) == (not is_clear(ego, size, boxes))
        pressed(browser, " ")
    finally:
        browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": []})


def test_an_event_shows_both_of_it_and_where_they_met(browser: Any, tmp_path: Path) -> None:
    """Told by the one who is advised nothing: it comes from the south, 28 m from the other."""
    names = ("zulu", "alpha")  # eastbound, northbound: events name the first by the alphabet
    folder = made_up_run(tmp_path / "run", names=names)
    write_page(read_run(folder), folder, (0, "zulu"))
    phone = {"width": 390, "height": 844, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", phone)
    try:
        opened(browser, folder)
        rows = browser.find_elements("css selector", "#moments tbody tr")
        crash = next(row for row in rows if "T1" in row.text)
        browser.execute_script("arguments[0].click()", crash.find_element("tag name", "button"))
        crash_s = FIRST_S + DT_S * COLLISION_FRAME
        words = "where they met"  # drawn, and so the camera is set up
        now = waited(browser, lambda now: words in {one["words"] for one in now["labels"]})
        assert abs(now["time_s"] - crash_s) < 1e-6
        assert (now["ego"], now["named"]) == ("alpha", [])
        # The lanes cross at (0, 0), where the one was 2 s before the other.
        assert now["met_xy_m"] == pytest.approx([0.0, 0.0], abs=1.0)
        _, size, boxes, places = browser.execute_script(SEEN_AT_ONCE, FIRST_S)
        assert all(is_clear(place, size, boxes) for place in places)
        assert "green car: collision" in {label["words"] for label in now["labels"]}
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})


def test_labels_lie_on_nothing_that_is_told(browser: Any, run_folder: Path) -> None:
    """Neither on each other, nor on what lies over the map, nor, all along, on the ego's slot."""
    for seconds in (0.3, 1.1, 1.9):
        now = opened(browser, run_folder, f"#t={FIRST_S + seconds}&ego=eastbound")
        (wide, high), boxes = browser.execute_script(OVER_THE_MAP)
        labels = [label["box"] for label in now["labels"]]
        assert len(labels) == 2 and labels[0] != labels[1]
        for k, (left, top, right, bottom) in enumerate(labels):
            assert 0.0 <= left < right <= wide and 0.0 <= top < bottom <= high
            for other in [*boxes, *labels[:k]]:
                apart = other[2] <= left or right <= other[0] or other[3] <= top
                assert apart or bottom <= other[1]
            for x_m in np.arange(-20.0 + 8.0 * seconds + 2.0, 0.0, 0.5).tolist():
                place = browser.execute_script("return window.hatn.pixel(...arguments)", x_m, 0.0)
                assert outside_of_all(place, [[left, top, right, bottom]])
        named = next(label for label in now["labels"] if label["id"] == "northbound")
        assert named["words"] == "red car: pass before 80 %"


def test_scores_are_not_cut_and_the_timeline_has_a_key(browser: Any, tmp_path: Path) -> None:
    folder = made_up_run(tmp_path / "run")
    measures = ("ade_3s", "fde_3s", "ade_0s3", "fde_0s3", "goal_error", "fallback_share")
    rows = [
        Score(measure, name, "crossing", "all", "none", 12.345, "m", 12345, 11.111, 13.333, 9.999)
        for name in ("constant_velocity", "constant_turn_rate", "hatn+route")
        for measure in measures
    ]
    write_scores(folder, rows)
    write_page(read_run(folder), folder, (20, "eastbound"))
    metrics = {"width": 1400, "height": 950, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", metrics)
    try:
        opened(browser, folder)
        inner, outer, cells = browser.execute_script(
            "const wide = [...document.querySelectorAll('.tables .wide')];"
            "return [wide.map((one) => one.scrollWidth), wide.map((one) => one.clientWidth),"
            " wide.map((one) => one.querySelectorAll('tbody tr:first-child td').length)]"
        )
        assert cells == [2 + len(measures)] and inner == outer
    finally:
        browser.execute_cdp_cmd("Emulation.clearDeviceMetricsOverride", {})
    key = browser.find_element("css selector", ".timeline-key")
    items = [" ".join(one.text.split()) for one in key.find_elements("css selector", ".item")]
    assert items[:3] == ["yield", "pass", "watch, no advice"]
    assert items[3:] == ["\u25ac alert", "\u2715 T1 collision", "\u25cb T3 close pass"]


def test_a_jump_sets_up_the_camera_and_a_hand_keeps_it(browser: Any, run_folder: Path) -> None:
    first = opened(browser, run_folder, f"#t={FIRST_S + 0.5}&ego=eastbound")
    pressed(browser, "+")
    closer = waited(browser, lambda now: now["scale"] > first["scale"])
    pressed(browser, "\ue014")  # arrow right: no jump
    stepped = waited(browser, lambda now: now["time_s"] > closer["time_s"])
    assert stepped["scale"] == closer["scale"]
    pressed(browser, "\ue00f")  # page down, to the alert
    waited(browser, lambda now: bool(now["alerts"]) and now["scale"] < closer["scale"])


@pytest.mark.parametrize("frames", [1, 30])
def test_a_run_without_vehicles_opens_too(browser: Any, tmp_path: Path, frames: int) -> None:
    folder = made_up_run(tmp_path / "run", frames=frames, names=(), finished=False)
    write_page(read_run(folder), folder)
    opened(browser, folder)
    assert "stopped before its end" in browser.find_element("id", "unfinished").text
    pressed(browser, " ", "n", "f", "\ue00f", "a")
    assert browser.get_log("browser") == []
