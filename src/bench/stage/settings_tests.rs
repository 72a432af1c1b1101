//! The settings of a stage: reading, checks, limits, predictions.

use std::time::Duration;

use super::*;

#[test]
fn settings_are_unchanged_by_writing_and_reading() {
    let settings = StageSettings::simulated();
    let text = toml::to_string(&settings).unwrap();
    assert!(text.contains("limit_min_deg = -60.0"), "{text}");
    assert_eq!(toml::from_str::<StageSettings>(&text).unwrap(), settings);
}

#[test]
fn a_minimal_file_suffices_and_an_unknown_key_is_named() {
    let text = "[theta_c]\naddress = 1\nlimit_min_deg = -30\nlimit_max_deg = 30\n\
                [phi_s]\naddress = 2\nlimit_min_deg = 0\nlimit_max_deg = 360\n";
    let settings: StageSettings = toml::from_str(text).unwrap();
    settings.validate().unwrap();
    assert_eq!(settings.baud, 115_200);
    let error = toml::from_str::<StageSettings>(&format!("{text}limit_deg = 3\n")).unwrap_err();
    assert!(error.to_string().contains("limit_deg"), "{error}");
}

#[test]
fn an_invalid_value_is_refused_with_its_key() {
    type Change = fn(&mut StageSettings);
    let cases: [(&str, Change); 12] = [
        ("theta_c.limit_min_deg", |s| {
            s.theta_c.limit_min = Angle::from_deg(90.0)
        }),
        ("theta_c.limit_max_deg", |s| {
            s.theta_c.limit_max = Angle::from_deg(f64::NAN)
        }),
        ("phi_s.tolerance_deg", |s| s.phi_s.tolerance = Angle::ZERO),
        ("phi_s.backlash_deg", |s| {
            s.phi_s.backlash = Angle::from_deg(-1.0)
        }),
        ("phi_s.address", |s| s.phi_s.address = 1),
        ("phi_s.serial", |s| s.phi_s.serial = s.theta_c.serial),
        ("theta_c.address", |s| s.theta_c.address = 0),
        ("theta_c.axis", |s| s.theta_c.axis = 10),
        // One controller has one serial number.
        ("phi_s.serial", |s| {
            (s.phi_s.address, s.phi_s.axis) = (s.theta_c.address, 2)
        }),
        ("theta_c.max_speed_deg_s", |s| {
            s.theta_c.max_speed_deg_s = Some(f64::INFINITY)
        }),
        ("phi_s.home_timeout_s", |s| {
            s.phi_s.home_timeout_s = f64::NAN
        }),
        ("attempts", |s| s.attempts = 0),
    ];
    for (expected, change) in cases {
        let mut settings = StageSettings::simulated();
        change(&mut settings);
        match settings.validate() {
            Err(StageError::BadSetting { key, .. }) => assert_eq!(key, expected),
            other => panic!("{expected}: {other:?}"),
        }
    }
}

#[test]
fn two_axes_of_one_controller_differ_by_their_number() {
    let mut settings = StageSettings::simulated();
    settings.phi_s.serial = settings.theta_c.serial;
    settings.phi_s.address = settings.theta_c.address;
    settings.phi_s.axis = 2;
    settings.validate().unwrap();
    assert_eq!(settings.addresses(), [1]);
    let text = toml::to_string(&settings).unwrap();
    assert_eq!(text.matches("axis = ").count(), 1, "{text}");
    assert_eq!(toml::from_str::<StageSettings>(&text).unwrap(), settings);
}

#[test]
fn the_limits_themselves_are_allowed_and_values_beyond_are_not() {
    let settings = StageSettings::simulated();
    assert!(settings.check_limits(Pose::from_deg(-60.0, 390.0)).is_ok());
    assert!(matches!(
        settings.check_limits(Pose::from_deg(-60.001, 0.0)),
        Err(StageError::OutsideLimits {
            axis: AxisName::ThetaC,
            ..
        })
    ));
    assert!(matches!(
        settings.check_limits(Pose::from_deg(0.0, f64::NAN)),
        Err(StageError::NotANumber {
            axis: AxisName::PhiS
        })
    ));
}

#[test]
fn a_downward_move_includes_the_detour() {
    let settings = StageSettings::simulated();
    let (low, high) = (Pose::from_deg(0.0, 0.0), Pose::from_deg(10.0, 0.0));
    // 20°/s, 60°/s²: 10/20 + 20/60 s, plus 100 ms to settle.
    let up = settings.predicted_move(low, high).as_secs_f64();
    assert!((up - (0.5 + 1.0 / 3.0 + 0.1)).abs() < 1e-9);
    let down = settings.predicted_move(high, low).as_secs_f64();
    assert!((down - (up + 0.2 / 20.0 + 2.0 * (0.2f64 / 60.0).sqrt())).abs() < 1e-9);
    assert_eq!(settings.predicted_move(low, low), Duration::ZERO);
}

#[test]
fn forbidden_regions_and_the_order_of_homing_are_read_and_their_mistakes_named() {
    let text = "[theta_c]\naddress = 1\nlimit_min_deg = -30\nlimit_max_deg = 60\n\
                [phi_s]\naddress = 2\nlimit_min_deg = 0\nlimit_max_deg = 360\n\
                [[forbidden]]\nname = \"lamp arm\"\ntheta_c_deg = [30, 60]\nphi_s_deg = [80, 100]\n";
    let homing = "[homing]\norder = \"theta_c-first\"\nsafe_theta_c_deg = 0\nsafe_phi_s_deg = 10\n";
    let settings: StageSettings = toml::from_str(&format!("{text}{homing}")).unwrap();
    settings.validate().unwrap();
    let again = toml::to_string(&settings).unwrap();
    assert_eq!(toml::from_str::<StageSettings>(&again).unwrap(), settings);
    // Settings without them are written as before, so that the rig of an old data folder stays the same.
    let plain = toml::to_string(&StageSettings::simulated()).unwrap();
    for key in ["forbidden", "homing", "encoder"] {
        assert!(!plain.contains(&format!("{key}]")) && !plain.contains("encoder_tolerance"));
    }
    for (expected, change) in [
        ("homing.order", ("theta_c-first", "together")),
        ("forbidden[0].name", ("lamp arm", " ")),
        ("forbidden[0].phi_s_deg", ("[80, 100]", "[100, 80]")),
        ("forbidden[0].theta_c_deg", ("[30, 60]", "[nan, 60]")),
        (
            "homing.safe_theta_c_deg",
            ("safe_theta_c_deg = 0", "safe_theta_c_deg = 45"),
        ),
        (
            "homing.safe_phi_s_deg",
            ("safe_phi_s_deg = 10", "safe_phi_s_deg = 90"),
        ),
        (
            "homing.safe_phi_s_deg",
            ("safe_phi_s_deg = 10", "safe_phi_s_deg = 400"),
        ),
    ] {
        let text = format!("{text}{homing}").replacen(change.0, change.1, 1);
        let settings: StageSettings = toml::from_str(&text).unwrap();
        match settings.validate() {
            Err(StageError::BadSetting { key, .. }) => assert_eq!(key, expected),
            other => panic!("{expected}: {other:?}"),
        }
    }
}
