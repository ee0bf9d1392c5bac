"""The projector's window on a screen whose pixels can be read, and what is seen when its process dies."""

from __future__ import annotations

import contextlib
import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from devices.xvfb import COLUMNS, ROWS, Xvfb, needs_xvfb
from twin.test_print import upright_cylinder
from vialight.core.arrays import Grid
from vialight.core.config import Projector, ProjectorSettings, Rig
from vialight.core.errors import InputError
from vialight.core.plan import Patterns, Plan
from vialight.devices import DeviceError, DeviceGoneError, Lease, LightPhase, MonotonicClock, ProjectorProcess
from vialight.devices.panel import LightPanel
from vialight.devices.projectors import list_monitors, open_projector, randr, told_of_projector
from vialight.devices.projectors.curtain import draw_curtain
from vialight.devices.projectors.levels import light_of_levels, sent_levels
from vialight.devices.projectors.window import WindowScreen
from vialight.store import write_plan
from vialight.system import wait_for

pytestmark = [needs_xvfb, pytest.mark.alone]

SIZE = (COLUMNS, ROWS)
CORNER = (20, 31)
ANGLES = np.arange(8) * 2 * np.pi / 8
PATTERNS = np.random.default_rng(1).integers(1, 256, (8, 50, 71), dtype=np.uint8)
TABLE = Projector(
    distance_mm=120.0, pixel_mm=0.065, columns=COLUMNS, rows=ROWS, axis_column=159.5, azimuth_deg=-90.0, driver="window"
)
FOREVER = float("inf")


def on_screen(screen: Xvfb, pattern: int | None) -> bool:
    """Whether the screen shows a pattern and nothing else, in all three colours."""
    wanted = np.zeros((ROWS, COLUMNS, 3), np.uint8)
    if pattern is not None:
        wanted[CORNER[0] : CORNER[0] + 50, CORNER[1] : CORNER[1] + 71] = PATTERNS[pattern, ..., None]
    return bool((screen.pixels() == wanted).all())


@contextlib.contextmanager
def window() -> Iterator[WindowScreen]:
    shown = WindowScreen(0, SIZE, PATTERNS, CORNER)
    try:
        yield shown
    finally:
        shown.close()


@contextlib.contextmanager
def projector(folder: Path, table: Projector = TABLE) -> Iterator[ProjectorProcess]:
    """The projector in its process, showing a plan of those patterns."""
    part = upright_cylinder(1.0, 1.0)
    target = np.zeros((2, 4, 4), np.float32)
    patterns = Patterns(PATTERNS, ANGLES, *CORNER, 0.002)
    write_plan(folder / "plan.h5", Plan(patterns, part, target, Grid((2, 4, 4), 0.1), Rig()))
    shown = open_projector(table, MonotonicClock(), folder / "plan.h5", ANGLES, folder, folder, folder / "log.csv")
    try:
        yield shown
    finally:
        shown.close()


def lease(angle_rad: float, speed_rad_s: float = 0.0, for_s: float = 0.15) -> Lease:
    return Lease(LightPhase.LIT, time.monotonic() + for_s, angle_rad, time.monotonic(), speed_rad_s, FOREVER)


def light_up(shown: ProjectorProcess, screen: Xvfb, pattern: int) -> None:
    """Renew the lease until a pattern is on the screen."""
    deadline = time.monotonic() + 5.0
    while not on_screen(screen, pattern):
        assert time.monotonic() < deadline
        shown.renew(lease(ANGLES[pattern]))
        time.sleep(0.01)


def test_pattern_is_on_the_screen_bit_for_bit_at_its_place_and_all_else_is_black(screen: Xvfb) -> None:
    with window() as shown:
        assert screen.is_black()
        for pattern in (3, 0, 7):
            shown.show(pattern)
            time.sleep(0.05)
            assert on_screen(screen, pattern)
        shown.show(None)
        time.sleep(0.05)
        assert screen.is_black()


def test_what_is_drawn_reads_back_bit_for_bit_for_all_levels(screen: Xvfb) -> None:
    ramp = np.arange(256, dtype=np.uint8).reshape(1, 16, 16)
    shown = WindowScreen("screen", SIZE, ramp, (ROWS - 16, COLUMNS - 16))
    shown._draw(shown._textures[0])
    drawn = shown.drawn()
    shown.close()
    assert (drawn[-16:, -16:] == ramp[0][..., None]).all()
    assert int(drawn.sum()) == 3 * int(ramp.sum())


def test_monitor_of_another_size_is_refused_with_both_sizes(screen: Xvfb) -> None:
    with pytest.raises(DeviceError, match=r"would scale the image: it shows 320 x 240 pixels.* has 1024 x 768"):
        WindowScreen(0, (1024, 768), PATTERNS, CORNER)


def test_monitor_whose_image_x_scales_is_refused_with_the_way_out(
    screen: Xvfb, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Xvfb itself scales nothing, and says so to `scaling_of`; here X answers as on a desktop at 125 %."""
    assert list_monitors()[0].scaling == ""
    one = 1 << 16
    monkeypatch.setattr(randr, "_transform", lambda display, crtc: [5 * one // 4, 0, 0, 0, 5 * one // 4, 0, 0, 0, one])
    with pytest.raises(DeviceError, match=r"would scale the image: X11 draws 1.25 x 1.25 .*xrandr --output screen"):
        WindowScreen(0, SIZE, PATTERNS, CORNER)


def test_window_that_is_not_as_large_as_the_projector_is_told(screen: Xvfb, monkeypatch: pytest.MonkeyPatch) -> None:
    with window() as shown:
        monkeypatch.setattr(shown._glfw, "get_framebuffer_size", lambda handle: (640, 480))
        with pytest.raises(DeviceError, match=r"its window has 640 x 480 pixels, the rig's projector 320 x 240"):
            shown.tend()


def test_unknown_monitor_is_refused_with_those_there_are(screen: Xvfb) -> None:
    assert [monitor.name for monitor in list_monitors()] == ["screen"]
    with pytest.raises(InputError, match="monitor is 'HDMI-1'; accepted: 0: screen, 320 x 240"):
        WindowScreen("HDMI-1", SIZE, PATTERNS, CORNER)


def test_session_without_a_screen_is_told(screen: Xvfb, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY")
    with pytest.raises(DeviceError, match=r"no window can be opened .*DISPLAY"):
        list_monitors()


def test_patterns_that_reach_beyond_the_projector_are_refused(screen: Xvfb) -> None:
    with pytest.raises(InputError, match="rows 200 to 249, columns 31 to 101; accepted: the projector's 240 rows"):
        WindowScreen(0, SIZE, PATTERNS, (200, 31))


def test_window_that_someone_closes_is_told(screen: Xvfb) -> None:
    with window() as shown:
        shown.tend()
        shown._glfw.set_window_should_close(shown._window, True)
        with pytest.raises(DeviceError, match="its window was closed"):
            shown.tend()


def test_monitor_that_goes_is_told(screen: Xvfb) -> None:
    """As GLFW has it: the window is left without a monitor."""
    with window() as shown:
        shown._glfw.set_window_monitor(shown._window, None, 0, 0, 100, 80, 0)
        with pytest.raises(DeviceError, match="its monitor has gone"):
            shown.tend()


def test_measured_light_and_flat_field_decide_what_is_sent(screen: Xvfb, tmp_path: Path) -> None:
    flat = np.full((ROWS, COLUMNS), 255, np.uint8)
    flat[:, 60:] = 128
    Image.fromarray(flat).save(tmp_path / "flat.png")
    measured = ((0.0, 0.0), (128.0, 1.0), (255.0, 4.0))
    settings = ProjectorSettings(linearisation=measured, flat_field="flat.png")
    table = TABLE.model_copy(update={"settings": settings})
    wanted = np.zeros((ROWS, COLUMNS), np.uint8)
    at = (slice(CORNER[0], CORNER[0] + 50), slice(CORNER[1], CORNER[1] + 71))
    wanted[at] = sent_levels(PATTERNS[3], light_of_levels(measured), (flat[at] / np.float32(255)).astype(np.float32))
    with projector(tmp_path, table) as shown:
        deadline = time.monotonic() + 5.0
        while not (screen.pixels() == wanted[..., None]).all():
            assert time.monotonic() < deadline
            shown.renew(lease(ANGLES[3]))
            time.sleep(0.01)
    assert "the flat field takes 0 to 50 % of the light" in told_of_projector(table, tmp_path)[1]


def test_projector_shows_what_is_due_and_is_black_when_its_lease_has_run_out(screen: Xvfb, tmp_path: Path) -> None:
    with projector(tmp_path) as shown:
        assert screen.is_black()
        light_up(shown, screen, 5)
        light_up(shown, screen, 2)

        def lapse() -> float:
            light_up(shown, screen, 2)
            shown.renew(lease(ANGLES[2]))
            return screen.wait_until_black(1.0)

        assert min(lapse() for _ in range(3)) < 0.25  # a busy machine may once be late to look
        light_up(shown, screen, 1)
        shown.darken()
        assert screen.wait_until_black(1.0) < 0.25
    log = (tmp_path / "log.csv").read_text()
    assert log.startswith("refresh_s,shown_s,due,shown\n")
    assert ",5,5\n" in log


def test_latency_makes_the_projector_look_ahead(screen: Xvfb, tmp_path: Path) -> None:
    """At an eighth of a turn a second, a second ahead is the next pattern but for the few milliseconds of a refresh."""
    late = TABLE.model_copy(update={"settings": ProjectorSettings(latency_s=1.0)})
    with projector(tmp_path, table=late) as shown:
        deadline = time.monotonic() + 5.0
        while not on_screen(screen, 3):
            assert time.monotonic() < deadline
            shown.renew(lease(ANGLES[2], 2 * np.pi / 8))
            time.sleep(0.01)


def test_killed_projector_leaves_the_curtain_in_place_of_light(screen: Xvfb, tmp_path: Path) -> None:
    with projector(tmp_path) as shown:
        light_up(shown, screen, 6)
        os.kill(shown.pid, signal.SIGKILL)
        assert screen.wait_until_black(1.0) < 0.25
        time.sleep(0.3)
        assert screen.is_black()
        with pytest.raises(DeviceError, match="its process has ended"):
            shown.shown()


@pytest.mark.parametrize("stopped", ["projector", "guardian"])
def test_projector_or_guardian_that_hangs_leaves_no_light(screen: Xvfb, tmp_path: Path, stopped: str) -> None:
    """A projector that hangs does nothing by itself; of a guardian that hangs, the session learns, and darkens."""
    with projector(tmp_path) as shown:
        light_up(shown, screen, 6)
        os.kill(shown.processes[stopped].pid, signal.SIGSTOP)
        begin = time.monotonic()
        while not screen.is_black():
            assert time.monotonic() - begin < 0.25
            try:
                shown.shown()
                shown.renew(lease(ANGLES[6]))
            except DeviceError:
                shown.darken()
            time.sleep(0.01)
        os.kill(shown.processes[stopped].pid, signal.SIGCONT)
        end = time.monotonic() + 0.5
        while time.monotonic() < end:
            assert screen.is_black()
            time.sleep(0.01)
        if stopped == "projector":
            with pytest.raises(DeviceGoneError, match=r"no sign of life for 0.15 s, was covered and ended"):
                shown.shown()


def test_light_that_has_ended_cannot_be_lit_again_by_any_lease(screen: Xvfb, tmp_path: Path) -> None:
    with projector(tmp_path) as shown:
        light_up(shown, screen, 6)
        LightPanel(tmp_path).press_stop()
        assert screen.wait_until_black(1.0) < 0.25
        assert wait_for(lambda: LightPanel(tmp_path).is_dark_for_good, timeout_s=1.0) is None
        end = time.monotonic() + 0.3
        while time.monotonic() < end:
            shown.renew(lease(ANGLES[6]))
            assert screen.is_black()
            time.sleep(0.01)


def test_curtain_is_black_even_while_its_process_stands_still(screen: Xvfb, tmp_path: Path) -> None:
    holder = draw_curtain(0, SIZE)
    assert draw_curtain(0, SIZE) == holder
    os.kill(holder, signal.SIGSTOP)
    try:
        with projector(tmp_path) as shown:
            light_up(shown, screen, 4)
            os.kill(shown.pid, signal.SIGKILL)
            assert screen.wait_until_black(1.0) < 0.25
    finally:
        os.kill(holder, signal.SIGCONT)


def test_without_a_curtain_the_desktop_would_be_seen(screen: Xvfb) -> None:
    """So that the tests above see a difference."""
    os.kill(draw_curtain(0, SIZE), signal.SIGTERM)
    deadline = time.monotonic() + 2.0
    while screen.pixels().mean() < 240:  # white but for the pointer
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_curtain_over_a_monitor_of_another_size_is_refused(screen: Xvfb) -> None:
    with pytest.raises(DeviceError, match=r"has no curtain: projector: monitor 0: screen.* would scale"):
        draw_curtain(0, (640, 480))
