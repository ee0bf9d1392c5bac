"""The stage through pipython, against a controller that the tests serve."""

from __future__ import annotations

import contextlib
import random
import time
from collections.abc import Callable, Iterator

import numpy as np
import pytest

from devices.gcs2 import Controller, TcpServer, served_over_pty, served_over_tcp
from vialight.core.config import Stage, StageSettings
from vialight.core.errors import InputError
from vialight.devices import DeviceError, DeviceTimeoutError, MonotonicClock, StagePosition
from vialight.devices.stages import open_stage
from vialight.devices.stages.pi import PiStage
from vialight.printing.track import StageTrack

pytestmark = pytest.mark.alone

SPEED_DEG_S = 120.0
SPEED_RAD_S = float(np.radians(SPEED_DEG_S))
CLOCK = MonotonicClock()


@contextlib.contextmanager
def turning(controller: Controller) -> Iterator[PiStage]:
    """A stage of that controller over TCP, at its speed."""
    with served_over_tcp(controller) as address:
        stage = PiStage(StageSettings(address=address), CLOCK).prepared()
        try:
            stage.start(SPEED_RAD_S)
            time.sleep(0.15)
            yield stage
        finally:
            stage.close()


def followed(stage: PiStage, duration_s: float) -> list[StagePosition]:
    """Positions as the light's keeper asks for them."""
    positions: list[StagePosition] = []
    end = time.monotonic() + duration_s
    while time.monotonic() < end:
        with contextlib.suppress(DeviceTimeoutError):
            positions.append(stage.position(0.08))
        time.sleep(0.025)
    return positions


@pytest.mark.parametrize("serve", [served_over_tcp, served_over_pty])
def test_stage_is_referenced_turns_on_over_many_turns_and_comes_to_rest(
    serve: Callable[[Controller], contextlib.AbstractContextManager[str]],
) -> None:
    controller = Controller()
    with serve(controller) as address:
        stage = open_stage(Stage(driver="pi", settings=StageSettings(address=address)), CLOCK)
        assert controller.is_referenced
        assert controller.servo
        stage.start(8 * SPEED_RAD_S)
        time.sleep(2.0)
        position = stage.position(1.0)
        assert position.angle_rad > 3 * 2 * np.pi
        assert np.rad2deg(position.angle_rad) == pytest.approx(controller.angle_at(position.time_s), abs=3.0)  # 3 ms
        stage.stop()
        time.sleep(0.6)
        assert stage.position(1.0).angle_rad == stage.position(1.0).angle_rad
        stage.close()
        stage.close()
    moves = [command for command in controller.heard if command.startswith("MOV")]
    assert len(moves) == 1  # never a pause between turns
    assert "FRF 1" in controller.heard


def test_stage_turns_the_other_way_where_the_speed_is_negative() -> None:
    controller = Controller(is_referenced=True)
    with turning(controller) as stage:
        stage.start(-SPEED_RAD_S)
        time.sleep(0.2)
        first, second = stage.position(1.0), stage.position(1.0)
        assert second.angle_rad < first.angle_rad


def test_pipython_asks_only_what_the_controller_answers() -> None:
    """The server is as true as its list of commands: what it does not know sets error 2, which would be raised."""
    controller = Controller()
    with turning(controller) as stage:
        followed(stage, 0.2)
    assert controller.heard[:4] == ["CSV?", "ERR?", "ERR?", "*IDN?"]
    assert controller.error in (0, 10)


def test_stage_that_is_referenced_already_does_not_move_when_opened() -> None:
    controller = Controller(is_referenced=True)
    with served_over_tcp(controller) as address:
        PiStage(StageSettings(address=address), CLOCK).prepared().close()
    assert "FRF 1" not in controller.heard


def test_stage_without_a_switch_is_zero_where_it_stands() -> None:
    controller = Controller()
    with served_over_tcp(controller) as address:
        stage = PiStage(StageSettings(address=address, reference="here"), CLOCK).prepared()
        assert stage.position(1.0).angle_rad == 0.0
        stage.close()


def test_reference_that_is_not_found_is_told_with_the_way_out() -> None:
    controller = Controller()
    controller.faults.refuses["FRF"] = 5
    with served_over_tcp(controller) as address, pytest.raises(DeviceError, match=r"stage: refuses: .*5"):
        PiStage(StageSettings(address=address), CLOCK).prepared()


def test_axis_that_cannot_turn_far_enough_is_refused_with_its_room() -> None:
    with (
        served_over_tcp(Controller(range_deg=720.0)) as address,
        contextlib.closing(PiStage(StageSettings(address=address), CLOCK).prepared()) as stage,
        pytest.raises(DeviceError, match=r"can turn by 720 deg only.*travel limits"),
    ):
        stage.start(SPEED_RAD_S)


def test_unknown_axis_is_refused_with_those_there_are() -> None:
    with served_over_tcp(Controller()) as address, pytest.raises(InputError, match="axis is '2'; accepted: 1"):
        PiStage(StageSettings(address=address, axis="2"), CLOCK)


@pytest.mark.parametrize("address", ["192.168.0.1", "socket://there", "serial:///dev/ttyS0?speed=9600", "usb://1"])
def test_address_of_another_form_is_refused_with_what_is_accepted(address: str) -> None:
    with pytest.raises(InputError, match="accepted: socket://HOST:PORT or serial"):
        PiStage(StageSettings(address=address), CLOCK)


@pytest.mark.parametrize("address", ["socket://127.0.0.1:9", "serial:///dev/there-is-none"])
def test_controller_that_is_not_there_is_told_with_its_address(address: str) -> None:
    with pytest.raises(DeviceError, match=f"cannot be reached at {address}"):
        PiStage(StageSettings(address=address), CLOCK)


def test_velocity_that_the_controller_refuses_is_told_in_its_words() -> None:
    controller = Controller(is_referenced=True)
    controller.faults.refuses["VEL"] = 8
    with (
        served_over_tcp(controller) as address,
        contextlib.closing(PiStage(StageSettings(address=address), CLOCK).prepared()) as stage,
        pytest.raises(DeviceError, match=r"refuses: Velocity out of limits"),
    ):
        stage.start(SPEED_RAD_S)


def test_motion_error_is_told_within_two_seconds_and_stays_until_the_next_start() -> None:
    controller = Controller(is_referenced=True)
    with turning(controller) as stage:
        controller.faults.stalls = True
        with pytest.raises(DeviceError, match=r"reports: Motion error"):
            followed(stage, 2.0)
        with pytest.raises(DeviceError, match=r"reports: Motion error"):
            stage.position(0.08)


def test_silent_stage_times_out_in_the_time_given_and_is_in_step_again_when_it_is_back() -> None:
    controller = Controller(is_referenced=True)
    with turning(controller) as stage:
        controller.faults.is_silent = True
        for _ in range(3):
            began = time.monotonic()
            with pytest.raises(DeviceTimeoutError, match=r"has not answered within 0\.08 s"):
                stage.position(0.08)
            assert time.monotonic() - began < 0.2
        controller.faults.is_silent = False
        position = stage.position(1.0)
        assert np.rad2deg(position.angle_rad) == pytest.approx(controller.angle_at(position.time_s), abs=3.6)


def test_answer_that_comes_after_its_timeout_is_not_taken_for_the_next_one() -> None:
    controller = Controller(is_referenced=True)
    with turning(controller) as stage:
        stage.position(1.0)  # asks for errors too, which it then does not for a second
        delays = [0.2]
        controller.faults.delay_s = lambda: delays.pop() if delays else 0.0
        controller.faults.answer_share = 1.0
        with pytest.raises(DeviceTimeoutError):
            stage.position(0.08)
        position = stage.position(1.0)
        assert np.rad2deg(position.angle_rad) == pytest.approx(controller.angle_at(position.time_s), abs=3.6)


def test_slow_answers_are_asked_for_again_and_never_believed() -> None:
    controller = Controller(is_referenced=True)
    with turning(controller) as stage:
        stage.position(1.0)  # asks for errors too, which it then does not for a second
        delays = [0.0, 0.05, 0.05]
        controller.faults.delay_s = lambda: delays.pop() if delays else 0.0
        controller.faults.answer_share = 1.0  # by the middle of question and answer it would be 25 ms too new
        position = stage.position(1.0)
        assert not delays
        assert np.rad2deg(position.angle_rad) == pytest.approx(controller.angle_at(position.time_s), abs=1.8)
        controller.faults.delay_s = lambda: 0.05
        with pytest.raises(DeviceTimeoutError, match=r"takes 0.05\d s to answer"):
            stage.position(0.12)


def test_answers_that_make_no_sense_are_an_error_and_then_pass() -> None:
    controller = Controller(is_referenced=True)
    with turning(controller) as stage:
        controller.faults.garbles = True
        with pytest.raises(DeviceError, match="makes no sense"):
            stage.position(0.08)
        controller.faults.garbles = False
        stage.position(1.0)


def test_lost_connection_is_told_at_once_and_the_stage_can_still_be_closed() -> None:
    server = TcpServer(Controller(is_referenced=True))
    stage = PiStage(StageSettings(address=server.address), CLOCK).prepared()
    server.drop()
    with pytest.raises(DeviceError, match="the line is lost"):
        stage.position(1.0)
    with pytest.raises(DeviceError, match="the line is lost"):
        stage.stop()
    stage.close()
    server.close()


def test_angle_at_mid_exposure_is_right_to_a_third_of_a_degree_when_answers_jitter() -> None:
    """Delays of up to 16 ms, as of a USB adapter: 8 ms off at most, 0.16 deg at 20 deg/s."""
    controller = Controller(is_referenced=True)
    rng = random.Random(3)
    controller.faults.delay_s = lambda: rng.uniform(0.0, 0.016)
    with served_over_tcp(controller) as address:
        stage = PiStage(StageSettings(address=address), CLOCK).prepared()
        stage.start(float(np.radians(20.0)))
        time.sleep(0.3)
        track = StageTrack()
        positions = followed(stage, 2.0)
        for position in positions:
            track.add(position)
        stage.close()
        assert len(positions) > 25
        asked = np.linspace(positions[2].time_s, positions[-2].time_s, 20)
        off = [np.rad2deg(track.angle_at(time_s)) - controller.angle_at(time_s) for time_s in asked]
    assert np.abs(off).max() < 0.33
