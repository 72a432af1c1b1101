use std::time::Duration;

use super::*;
use crate::clock::SteppedClock;
use crate::sim::world::{AxisFault, WorldSettings};
use crate::units::Angle;
use proptest::prelude::*;

struct Rig {
    clock: Arc<SteppedClock>,
    world: Arc<World>,
    controller: Controller,
}

impl Rig {
    fn new() -> Self {
        let clock = Arc::new(SteppedClock::new());
        let world = Arc::new(World::new(clock.clone(), WorldSettings::default()));
        let controller = Controller::new(&world);
        Rig {
            clock,
            world,
            controller,
        }
    }

    fn of_one_controller() -> Self {
        let mut rig = Rig::new();
        rig.controller = Controller::with_both_axes(&rig.world);
        rig
    }

    fn homed() -> Self {
        let mut rig = Rig::new();
        rig.ask("/0 0 home");
        rig.wait_s(60.0);
        rig.ask("/0 0");
        rig
    }

    fn ask(&mut self, line: &str) -> String {
        let out = self.controller.receive(format!("{line}\n").as_bytes());
        String::from_utf8(out).unwrap().replace("\r\n", "|")
    }

    fn wait_s(&self, s: f64) {
        self.clock.advance(Duration::from_secs_f64(s));
    }
}

#[test]
fn a_broadcast_is_answered_by_both_devices() {
    let mut rig = Rig::new();
    assert_eq!(
        rig.ask("/0 0 00:00"),
        "@01 0 00 OK IDLE WR 0:BE|@02 0 00 OK IDLE WR 0:BD|"
    );
    assert_eq!(rig.ask("/"), "@01 0 OK IDLE WR 0|@02 0 OK IDLE WR 0|");
}

#[test]
fn two_axes_of_one_controller_answer_separately_and_together() {
    let mut rig = Rig::of_one_controller();
    assert_eq!(rig.ask("/"), "@01 0 OK IDLE WR 0|");
    assert_eq!(rig.ask("/1 get system.axiscount"), "@01 0 OK IDLE WR 2|");
    assert_eq!(rig.ask("/1 2 home"), "@01 2 OK BUSY WR 0|");
    assert_eq!(rig.ask("/1 1"), "@01 1 OK IDLE WR 0|");
    assert_eq!(rig.ask("/1"), "@01 0 OK BUSY WR 0|");
    rig.wait_s(60.0);
    assert_eq!(rig.ask("/1 2"), "@01 2 OK IDLE -- 0|");
    assert_eq!(rig.ask("/1 warnings"), "@01 0 OK IDLE WR 02 WR WH|");
    assert_eq!(rig.ask("/1 2 warnings"), "@01 2 OK IDLE -- 00|");
    rig.ask("/1 1 home");
    rig.wait_s(60.0);
    rig.ask("/1 2 move abs 5000");
    rig.wait_s(60.0);
    assert_eq!(rig.ask("/1 get pos"), "@01 0 OK IDLE -- 0 5000|");
    assert_eq!(rig.ask("/1 get 2 pos 1 pos"), "@01 0 OK IDLE -- 5000; 0|");
    // Controller settings are refused on an axis; settings of the axes may differ.
    assert_eq!(
        rig.ask("/1 2 get system.serial"),
        "@01 2 RJ IDLE -- DEVICEONLY|"
    );
    rig.ask("/1 2 set maxspeed 1000");
    let speeds = rig.ask("/1 get maxspeed");
    assert!(
        speeds.ends_with(" 1000|") && speeds != "@01 0 OK IDLE -- 1000 1000|",
        "{speeds}"
    );
    assert_eq!(rig.ask("/1 3 home"), "@01 3 RJ IDLE -- BADAXIS|");
    // An alert states the axis whose motion has ended.
    rig.ask("/1 set comm.alert 1");
    rig.ask("/1 2 move abs 0");
    rig.wait_s(60.0);
    let alerts = String::from_utf8(rig.controller.poll()).unwrap();
    assert_eq!(alerts, "!01 2 IDLE --\r\n");
    // A restart affects the whole controller.
    rig.world.cause(AxisName::PhiS, AxisFault::PowerCycle);
    rig.ask("/");
    assert_eq!(rig.ask("/1 1"), "@01 1 OK IDLE WR 0|");
    assert_eq!(rig.ask("/1 renumber 7"), "@07 0 OK IDLE WR 0|");
    assert_eq!(rig.ask("/7 2"), "@07 2 OK IDLE WR 0|");
}

#[test]
fn homing_sets_the_reference_and_clears_the_flags() {
    let mut rig = Rig::new();
    assert_eq!(rig.ask("/1 1 10 warnings"), "@01 1 10 OK IDLE WR 02 WR WH|");
    assert_eq!(rig.ask("/1 1 move abs 1000"), "@01 1 RJ IDLE WR BADDATA|");
    assert_eq!(rig.ask("/1 1 11 home"), "@01 1 11 OK BUSY WR 0|");
    rig.wait_s(60.0);
    assert_eq!(rig.ask("/1 1 13"), "@01 1 13 OK IDLE -- 0|");
    assert_eq!(rig.ask("/1 1 get pos"), "@01 1 OK IDLE -- 0|");
    assert!((rig.world.pose_now().theta_c.deg() + 65.0).abs() < 0.011);
    assert_eq!(
        rig.ask("/2 1 get pos"),
        "@02 1 OK IDLE WR 0|",
        "the other axis was not homed"
    );
}

#[test]
fn a_move_takes_the_time_of_its_trapezoid() {
    let mut rig = Rig::homed();
    assert_eq!(rig.ask("/1 1 40 move abs 208000"), "@01 1 40 OK BUSY -- 0|");
    // 65° at 20°/s; the ramp setting is a whole number: 31 × 10⁴/1.6384 microsteps/s².
    let speed = 104_858.0 / 1.6384;
    let ramp = 31.0 * 10_000.0 / 1.6384;
    let duration = 208_000.0 / speed + speed / ramp;
    rig.wait_s(duration - 1e-3);
    assert!(rig.ask("/1 1").contains("BUSY"));
    rig.wait_s(2e-3);
    assert_eq!(rig.ask("/1 1 get pos"), "@01 1 OK IDLE -- 208000|");
    assert!(rig.world.pose_now().theta_c.deg().abs() < 1e-9);
}

#[test]
fn a_target_beyond_the_limits_is_refused_and_nothing_moves() {
    let mut rig = Rig::homed();
    for command in [
        "move abs 99999999",
        "move abs -1",
        "move rel -1",
        "move abs x",
        "move abs",
    ] {
        let answer = rig.ask(&format!("/1 1 {command}"));
        assert!(
            answer.starts_with("@01 1 RJ IDLE -- BAD"),
            "{command}: {answer}"
        );
    }
    assert!(!rig.world.is_moving());
}

#[test]
fn a_velocity_move_ends_at_the_limit() {
    let mut rig = Rig::homed();
    rig.ask("/1 1 move vel 50000");
    rig.wait_s(1.0);
    assert_eq!(rig.ask("/1 1 get vel"), "@01 1 OK BUSY -- 50000|");
    rig.wait_s(60.0);
    assert_eq!(rig.ask("/1 1 get pos"), "@01 1 OK IDLE -- 416000|");
}

#[test]
fn a_stop_raises_a_flag_that_the_next_move_from_rest_clears() {
    let mut rig = Rig::homed();
    rig.ask("/1 1 move abs 200000");
    rig.wait_s(1.0);
    assert_eq!(rig.ask("/1 1 stop"), "@01 1 OK BUSY NI 0|");
    rig.wait_s(1.0);
    assert_eq!(rig.ask("/1 1 warnings"), "@01 1 OK IDLE NI 01 NI|");
    assert_eq!(rig.ask("/1 1 move abs 0"), "@01 1 OK BUSY -- 0|");
    assert_eq!(rig.ask("/1 1 move abs 100"), "@01 1 OK BUSY NI 0|");
    assert_eq!(rig.ask("/1 1 estop"), "@01 1 OK IDLE NI 0|");
}

#[test]
fn faults_raise_their_flags() {
    for (fault, flag) in [
        (AxisFault::Stall, "FS"),
        (AxisFault::LimitSensor, "WL"),
        (AxisFault::Knob(Angle::from_deg(1.0)), "NC"),
        (AxisFault::EmergencyStop, "FH"),
        (AxisFault::PowerCycle, "WR"),
    ] {
        let mut rig = Rig::homed();
        rig.ask("/1 1 move abs 200000");
        rig.wait_s(1.0);
        rig.world.cause(AxisName::ThetaC, fault);
        assert_eq!(
            rig.ask("/1 1"),
            format!("@01 1 OK IDLE {flag} 0|"),
            "{fault:?}"
        );
    }
}

#[test]
fn a_power_cycle_resets_counter_and_uptime() {
    let mut rig = Rig::homed();
    rig.ask("/2 1 move abs 1000");
    rig.wait_s(5.0);
    assert_eq!(rig.ask("/2 1 get pos"), "@02 1 OK IDLE -- 1000|");
    rig.world.cause(AxisName::PhiS, AxisFault::PowerCycle);
    rig.wait_s(1.5);
    assert_eq!(rig.ask("/2 0 get system.uptime"), "@02 0 OK IDLE WR 1500|");
    assert_eq!(rig.ask("/2 1 get pos"), "@02 1 OK IDLE WR 0|");
    rig.world.set_powered(AxisName::PhiS, false);
    assert_eq!(rig.ask("/2 0"), "");
    rig.world.set_powered(AxisName::PhiS, true);
    assert_eq!(rig.ask("/2 0 system reset"), "@02 0 OK IDLE WR 0|");
}

#[test]
fn the_controller_does_not_detect_a_slip() {
    let mut rig = Rig::homed();
    rig.ask("/1 1 move abs 208000");
    rig.wait_s(9.0);
    rig.world
        .cause(AxisName::ThetaC, AxisFault::Slip(Angle::from_deg(0.5)));
    assert_eq!(rig.ask("/1 1 get pos"), "@01 1 OK IDLE -- 208000|");
    assert!((rig.world.pose_now().theta_c.deg() - 0.5).abs() < 1e-9);
}

#[test]
fn checksums_follow_the_command_or_the_setting() {
    let mut rig = Rig::new();
    assert_eq!(rig.ask("/1 0 01 get version"), "@01 0 01 OK IDLE WR 7.38|");
    assert_eq!(
        rig.ask("/1 0 02 get version:77"),
        "@01 0 02 OK IDLE WR 7.38:1C|"
    );
    rig.ask("/1 0 set comm.checksum 1");
    assert_eq!(
        rig.ask("/1 0 02 get version"),
        "@01 0 02 OK IDLE WR 7.38:1C|"
    );
}

#[test]
fn a_garbled_command_is_neither_executed_nor_answered() {
    let mut rig = Rig::homed();
    assert_eq!(rig.ask("/1 1 40 move abs 200001:8B"), "");
    assert!(!rig.world.is_moving());
}

#[test]
fn the_end_of_a_motion_sends_one_alert() {
    let mut rig = Rig::homed();
    rig.ask("/0 0 set comm.alert 1");
    rig.ask("/1 1 move abs 100");
    assert!(rig.controller.may_alert());
    assert!(rig.controller.poll().is_empty());
    rig.wait_s(5.0);
    assert_eq!(rig.controller.poll(), b"!01 1 IDLE --\r\n");
    assert!(rig.controller.poll().is_empty() && !rig.controller.may_alert());
}

#[test]
fn settings_have_scopes_ranges_and_old_names() {
    let mut rig = Rig::homed();
    for (command, answer) in [
        ("/1 0 get deviceid", "OK IDLE -- 50105"),
        ("/1 1 get peripheralid", "OK IDLE -- 0"),
        ("/1 1 get device.id", "RJ IDLE -- DEVICEONLY"),
        ("/1 0 get pos", "OK IDLE -- 0"),
        ("/1 2 get pos", "RJ IDLE -- BADAXIS"),
        ("/1 1 get no.such", "RJ IDLE -- BADCOMMAND"),
        ("/1 0 set version 8", "RJ IDLE -- BADCOMMAND"),
        ("/1 1 set maxspeed 0", "RJ IDLE -- BADDATA"),
        ("/1 1 set maxspeed 1000", "OK IDLE -- 0"),
        ("/1 1 get maxspeed", "OK IDLE -- 1000"),
        ("/1 1 set user.data.3 77", "OK IDLE -- 0"),
        ("/1 1 get user.data.3", "OK IDLE -- 77"),
        ("/1 1 get limit.cycle.dist", "OK IDLE -- 1152000"),
        (
            "/1 0 get system.serial 1 pos maxspeed",
            "OK IDLE -- 90001; 0; 1000",
        ),
        ("/1 0 get 3 pos version", "RJ IDLE -- BADAXIS"),
        ("/1 1 move max 500 9", "OK BUSY -- 0"),
        ("/1 1 estop", "OK IDLE NI 0"),
        ("/1 1 move min", "OK IDLE -- 0"),
        ("/1 1 tools parking park", "OK IDLE -- 0"),
        ("/1 1 home", "RJ IDLE -- PARKED"),
        ("/1 1 tools parking unpark", "OK IDLE -- 0"),
        ("/1 1 driver disable", "OK IDLE FO 0"),
        ("/1 1 move abs 5", "RJ IDLE FO DRIVERDISABLED"),
        ("/1 1 driver enable", "OK IDLE -- 0"),
        ("/1 1 dance", "RJ IDLE -- BADCOMMAND"),
    ] {
        let scope = &command[3..4];
        assert_eq!(
            rig.ask(command),
            format!("@01 {scope} {answer}|"),
            "{command}"
        );
    }
    assert_eq!(rig.ask("/1 0 renumber 7"), "@07 0 OK IDLE -- 0|");
    assert_eq!(rig.ask("/1 0"), "");
    assert_eq!(
        rig.ask("/0 0 renumber"),
        "@01 0 OK IDLE -- 0|@02 0 OK IDLE -- 0|"
    );
    assert_eq!(rig.ask("/1 0 help").matches('#').count(), 4);
}

#[test]
fn a_long_command_is_echoed_in_full_and_a_torn_one_refused() {
    let mut rig = Rig::homed();
    assert_eq!(rig.ask("/1 0 05 tools echo one two\\"), "");
    assert_eq!(
        rig.ask("/1 0 05 cont 1 three"),
        "@01 0 05 OK IDLE -- one two three|"
    );
    assert_eq!(
        rig.ask("/1 0 05 cont 1 three"),
        "@01 0 05 RJ IDLE -- BADSPLIT|"
    );
    let long = "x".repeat(51);
    assert_eq!(
        rig.ask(&format!("/1 0 tools echo {long}")),
        "@01 0 RJ IDLE -- LONGWORD|"
    );
    let too_long = format!("/1 0 tools echo {}", "word ".repeat(20));
    assert_eq!(rig.ask(&too_long), "@01 0 RJ IDLE -- BADSPLIT|");
}

proptest! {
    #![proptest_config(crate::extremes::cases(256))]

    #[test]
    fn no_bytes_cause_a_panic(chunks in proptest::collection::vec(any::<Vec<u8>>(), 0..8)) {
        let mut rig = Rig::homed();
        for chunk in chunks {
            rig.controller.receive(&chunk);
            rig.wait_s(0.1);
        }
    }

    #[test]
    fn no_command_causes_a_panic(
        lines in proptest::collection::vec(
            "/[0-2]( [01])? (move (abs|rel|vel|min|max|index)|set (pos|maxspeed|accel|limit.min|limit.max|comm.address)|stop|home|get|renumber)( -?[0-9]{1,19}){0,3}",
            0..12,
        )
    ) {
        let mut rig = Rig::homed();
        for line in lines {
            let answer = rig.ask(&line);
            prop_assert!(answer.matches('@').count() <= 2);
            rig.wait_s(0.3);
            prop_assert!(rig.world.pose_now().theta_c.deg().abs() <= 65.011);
        }
    }
}
