"""The stage maker's own client satisfied by `ridged simulate-rig`, in native units.

Every claim is tested over a pseudo-terminal and over TCP. Time runs faster on the rig, so that nothing
here waits long; what has to be caught in mid-move runs at a speed at which it takes a minute of the
rig's time.
"""

import os
import signal
import subprocess
import threading
import time
import unittest

from zaber_motion import (
    BadCommandException,
    BadDataException,
    CommandFailedException,
    MovementInterruptedException,
    RequestTimeoutException,
)
from zaber_motion.ascii import Connection, GetAxisSetting, WarningFlags

RIDGED = os.environ.get("RIDGED_BIN", "target/debug/ridged")
TIME_SCALE = 50
# Speed data are microsteps per second times 1.6384: this is 5000 microsteps (1.6 degrees) per second.
SLOW = 8192


class Rig:
    """A running `ridged simulate-rig`; stopped by SIGTERM, which must end it with exit code 0."""

    def __init__(self, *line):
        command = [RIDGED, "simulate-rig", *line, "--time-scale", str(TIME_SCALE)]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
        ready = self.process.stdout.readline().strip()
        assert ready.startswith("listening on "), ready
        self.place = ready.removeprefix("listening on ")

    def stop(self, by=signal.SIGTERM):
        self.process.send_signal(by)
        code = self.process.wait(timeout=10)
        self.process.stdout.close()
        return code


class Claims:
    """What must hold, whatever the line."""

    @classmethod
    def setUpClass(cls):
        cls.rig = Rig(*cls.line)
        cls.connection = cls.connect()
        cls.devices = cls.connection.detect_devices(identify_devices=False)
        cls.tilt, cls.turn = (device.get_axis(1) for device in cls.devices)

    @classmethod
    def tearDownClass(cls):
        cls.connection.close()
        assert cls.rig.stop() == 0

    def setUp(self):
        for axis in (self.tilt, self.turn):
            if not axis.is_homed():
                axis.home()
            axis.settings.set("maxspeed", 200_000)
            axis.move_absolute(10_000)

    def test_detection_finds_both_devices(self):
        self.assertEqual([d.device_address for d in self.devices], [1, 2])
        serials = [d.settings.get("system.serial") for d in self.devices]
        self.assertEqual(serials, [90001, 90002])

    def test_homing_gives_the_reference(self):
        self.devices[0].generic_command("system reset")
        self.assertFalse(self.tilt.is_homed())
        self.assertIn(WarningFlags.NO_REFERENCE_POSITION, self.tilt.warnings.get_flags())
        self.tilt.home()
        self.assertTrue(self.tilt.is_homed())
        self.assertEqual(self.tilt.get_position(), 0)
        self.assertEqual(self.tilt.warnings.get_flags(), set())

    def test_absolute_and_relative_moves_arrive(self):
        self.tilt.move_absolute(200_000)
        self.assertEqual(self.tilt.get_position(), 200_000)
        self.tilt.move_relative(-50_000)
        self.assertEqual(self.tilt.get_position(), 150_000)
        self.tilt.move_min()
        self.assertEqual(self.tilt.get_position(), 0)
        self.tilt.move_max(velocity=100_000)
        self.assertEqual(self.tilt.get_position(), 416_000)

    def test_a_velocity_move_goes_on_until_it_is_stopped(self):
        self.turn.move_velocity(SLOW)
        self.assertTrue(self.turn.is_busy())
        # It accelerates for some milliseconds, in which the first question may fall.
        deadline = time.monotonic() + 5
        velocity = self.turn.settings.get("vel")
        while abs(velocity - SLOW) > 1 and time.monotonic() < deadline:
            velocity = self.turn.settings.get("vel")
        self.assertAlmostEqual(velocity, SLOW, delta=1)
        first = self.turn.get_position()
        self.turn.stop()
        self.assertFalse(self.turn.is_busy())
        self.assertGreaterEqual(self.turn.get_position(), first)

    def test_a_velocity_move_ends_at_the_limit(self):
        self.tilt.move_velocity(200_000)
        self.tilt.wait_until_idle()
        self.assertEqual(self.tilt.get_position(), 416_000)

    def test_beyond_the_limit_is_rejected(self):
        before = self.tilt.get_position()
        for move in (
            lambda: self.tilt.move_absolute(99_999_999),
            lambda: self.tilt.move_relative(-99_999_999),
        ):
            with self.assertRaises(BadDataException):
                move()
        self.assertEqual(self.tilt.get_position(), before)

    def test_stop_and_emergency_stop_end_a_move_on_the_way(self):
        for command in ("stop", "estop"):
            self.turn.settings.set("maxspeed", SLOW)
            self.turn.move_absolute(1_000_000, wait_until_idle=False)
            self.assertTrue(self.turn.is_busy())
            if command == "stop":
                self.turn.stop()
            else:
                self.turn.generic_command("estop")
            self.turn.wait_until_idle(throw_error_on_fault=False)
            self.assertFalse(self.turn.is_busy())
            self.assertLess(self.turn.get_position(), 999_999)
            self.assertIn(WarningFlags.MOVEMENT_INTERRUPTED, self.turn.warnings.get_flags())

    def test_stop_all_and_home_all_reach_both_devices(self):
        for axis in (self.tilt, self.turn):
            axis.settings.set("maxspeed", SLOW)
            axis.move_absolute(300_000, wait_until_idle=False)
        self.assertEqual(sorted(self.connection.stop_all()), [1, 2])
        self.assertFalse(self.tilt.is_busy() or self.turn.is_busy())
        for axis in (self.tilt, self.turn):
            axis.settings.set("maxspeed", 200_000)
        self.assertEqual(sorted(self.connection.home_all()), [1, 2])
        self.assertEqual(self.tilt.get_position(), 0)

    def test_a_second_command_preempts_the_first(self):
        self.tilt.settings.set("maxspeed", SLOW)
        caught = []

        def wait_for_it():
            try:
                self.tilt.move_absolute(400_000)
            except MovementInterruptedException as exception:
                caught.append(exception)

        waiting = threading.Thread(target=wait_for_it)
        waiting.start()
        while not self.tilt.is_busy():
            pass
        self.tilt.settings.set("maxspeed", 200_000)
        self.tilt.move_absolute(20_000, wait_until_idle=False)
        waiting.join(timeout=10)
        self.assertEqual(len(caught), 1)
        self.tilt.wait_until_idle(throw_error_on_fault=False)
        self.assertEqual(self.tilt.get_position(), 20_000)

    def test_warnings_are_listed_and_cleared_by_the_next_move(self):
        self.turn.settings.set("maxspeed", SLOW)
        self.turn.move_absolute(1_000_000, wait_until_idle=False)
        self.turn.stop()
        self.assertEqual(self.turn.warnings.get_flags(), {WarningFlags.MOVEMENT_INTERRUPTED})
        self.turn.move_relative(10)
        self.assertEqual(self.turn.warnings.get_flags(), set())
        self.turn.driver_disable()
        self.assertIn("FO", self.turn.warnings.get_flags())
        with self.assertRaises(CommandFailedException):
            self.turn.move_relative(10)
        self.turn.driver_enable()
        self.assertEqual(self.turn.warnings.clear_flags(), set())

    def test_settings_are_read_and_written(self):
        self.assertEqual(self.tilt.settings.get("limit.cycle.dist"), 1_152_000)
        self.assertEqual(self.tilt.settings.get("resolution"), 64)
        self.tilt.settings.set("accel", 25)
        self.assertEqual(self.tilt.settings.get("accel"), 25)
        self.tilt.settings.set("accel", 31)
        self.devices[0].settings.set("user.data.3", 4711)
        self.assertEqual(self.devices[0].settings.get("user.data.3"), 4711)
        self.assertEqual(self.devices[0].settings.get_string("version"), "7.38")
        many = self.tilt.settings.get_many(GetAxisSetting("pos"), GetAxisSetting("maxspeed"))
        self.assertEqual({v.setting: v.value for v in many}, {"pos": 10_000, "maxspeed": 200_000})
        with self.assertRaises(BadCommandException):
            self.tilt.settings.get("no.such.setting")
        with self.assertRaises(BadDataException):
            self.tilt.settings.set("maxspeed", 0)

    def test_parking_forbids_moves(self):
        self.turn.park()
        self.assertTrue(self.turn.is_parked())
        with self.assertRaises(CommandFailedException):
            self.turn.move_relative(10)
        self.turn.unpark()
        self.turn.move_relative(10)

    def test_checksums_may_be_off_or_on(self):
        for on_device in (1, 0):
            self.devices[0].settings.set("comm.checksum", on_device)
            for from_host in (False, True):
                self.connection.checksum_enabled = from_host
                self.tilt.move_relative(100)
                self.assertEqual(self.devices[0].settings.get("comm.checksum"), on_device)
        self.connection.checksum_enabled = True

    def test_alerts_tell_the_end_of_a_move(self):
        seen = threading.Event()
        subscription = self.connection.alert.subscribe(lambda _: seen.set())
        self.connection.enable_alerts()
        try:
            self.tilt.move_relative(50_000)
            self.assertEqual(self.tilt.get_position(), 60_000)
            self.assertTrue(seen.wait(timeout=5))
        finally:
            self.connection.disable_alerts()
            subscription.dispose()

    def test_long_commands_and_long_replies_are_whole(self):
        text = " ".join(f"word{n:02}" for n in range(40))
        reply = self.devices[1].generic_command(f"tools echo {text}")
        self.assertEqual(reply.data, text)
        echo = self.connection.generic_command("tools echo", device=1)
        self.assertEqual(echo.data, "0")

    def test_help_comes_as_info_lines(self):
        replies = self.devices[0].generic_command_multi_response("help")
        self.assertGreater(len(replies), 3)

    def test_both_axes_move_at_once(self):
        for axis in (self.tilt, self.turn):
            axis.settings.set("maxspeed", 4 * SLOW)
        self.tilt.move_absolute(300_000, wait_until_idle=False)
        self.turn.move_absolute(900_000, wait_until_idle=False)
        self.assertTrue(self.tilt.is_busy() and self.turn.is_busy())
        self.tilt.wait_until_idle()
        self.turn.wait_until_idle()
        self.assertEqual((self.tilt.get_position(), self.turn.get_position()), (300_000, 900_000))

    def test_an_address_without_a_device_is_silent(self):
        with self.assertRaises(RequestTimeoutException):
            self.connection.generic_command("", device=7)

    def test_identification_reads_what_it_needs(self):
        # The database itself is on the network; what is asked of the device is not.
        for name in ("deviceid", "system.serial", "version.build", "device.hw.modified",
                     "comm.command.packets.max", "comm.word.size.max", "get.settings.max",
                     "system.axiscount", "comm.packet.size.max"):
            self.connection.generic_command(f"get {name}", device=1)
        for name in ("resolution", "peripheralid", "peripheral.serial"):
            self.connection.generic_command(f"get {name}", device=1, axis=1)


class OverPty(Claims, unittest.TestCase):
    line = ("--pty",)

    @classmethod
    def connect(cls):
        return Connection.open_serial_port(cls.rig.place)

    def test_the_pty_outlives_a_client(self):
        OverPty.connection.close()
        OverPty.connection = self.connect()
        devices = OverPty.connection.detect_devices(identify_devices=False)
        OverPty.devices = devices
        OverPty.tilt, OverPty.turn = (device.get_axis(1) for device in devices)
        self.assertEqual(self.tilt.get_position(), 10_000)


class OverTcp(Claims, unittest.TestCase):
    line = ("--tcp", "127.0.0.1:0")

    @classmethod
    def connect(cls):
        host, port = cls.rig.place.rsplit(":", 1)
        return Connection.open_tcp(host, int(port))


class Program(unittest.TestCase):
    def test_ctrl_c_and_sigterm_are_clean_ends(self):
        for by in (signal.SIGINT, signal.SIGTERM):
            self.assertEqual(Rig("--pty").stop(by), 0)


if __name__ == "__main__":
    unittest.main()
