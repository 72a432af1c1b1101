//! What is read, and what is refused with its place and way out.

use super::*;

fn read(text: &str, environment: &[(&str, &str)]) -> Result<Config, ConfigError> {
    Config::from_text(
        text,
        "rig.toml",
        environment
            .iter()
            .map(|(k, v)| ((*k).to_owned(), (*v).to_owned())),
    )
}

#[test]
fn an_empty_file_means_the_defaults() {
    assert_eq!(read("", &[]).unwrap(), Config::default());
}

#[test]
fn the_example_file_is_read_and_names_every_section() {
    let text = include_str!("../../ridged.example.toml");
    let config = read(text, &[]).unwrap();
    assert!(config.port.is_some() && config.camera.folder.is_some());
    for section in [
        "server", "import", "store", "stage", "rig", "camera", "flat", "dark", "scan", "hooks",
        "lamp", "park", "due",
    ] {
        assert!(text.contains(&format!("[{section}]")), "{section}");
    }
}

#[test]
fn the_example_file_shows_every_key() {
    let example = include_str!("../../ridged.example.toml");
    // serde names all keys of a table where it refuses one.
    let keys_of = |table: &str| -> Vec<String> {
        let probe = match table {
            "" => "nothing = 1".to_owned(),
            _ => format!("[{table}]\nnothing = 1"),
        };
        let error = toml::from_str::<Config>(&probe).unwrap_err();
        let Some((_, names)) = error.message().split_once("unknown field `nothing`") else {
            return Vec::new();
        };
        names
            .split('`')
            .skip(1)
            .step_by(2)
            .map(str::to_owned)
            .collect()
    };
    let mut tables = vec![String::new()];
    let mut count = 0;
    while let Some(table) = tables.pop() {
        for key in keys_of(&table) {
            let word = |c: char| !(c.is_ascii_alphanumeric() || c == '_');
            assert!(example.split(word).any(|w| w == key), "{table}.{key}");
            count += 1;
            tables.push(match table.as_str() {
                "" => key,
                _ => format!("{table}.{key}"),
            });
        }
    }
    assert!(count > 80, "{count}");
}

#[test]
fn a_place_to_park_is_within_the_limits() {
    let example = include_str!("../../ridged.example.toml");
    let config = read(example, &[]).unwrap();
    assert!(config.park.is_none() && config.hooks.paused.is_empty());
    let text = format!("{example}\n[park]\ntheta_c_deg = 0.0\nphi_s_deg = 370.0\n");
    let error = read(&text, &[]).unwrap_err().to_string();
    for part in ["park.phi_s_deg", "370", "-5", "365"] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
    let text = format!(
        "{example}\n[park]\ntheta_c_deg = 45.0\nphi_s_deg = 90.0\n\n[stage.homing]\norder = \"theta_c-first\"\n\n[[stage.forbidden]]\nname = \"lamp arm\"\n\
        theta_c_deg = [30.0, 60.0]\nphi_s_deg = [80.0, 100.0]\n"
    );
    let error = read(&text, &[]).unwrap_err().to_string();
    for part in ["park is in the forbidden region", "lamp arm", "outside"] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
    let text = "[park]\ntheta_c_deg = nan\nphi_s_deg = 0.0\n";
    assert!(read(text, &[]).is_err());
    let hooks = "[hooks]\npaused = [\"mail\", \"me\"]\ntime_limit_s = 0.0\n";
    let error = read(hooks, &[]).unwrap_err().to_string();
    assert!(
        error.contains("hooks.time_limit_s is 0, expected"),
        "{error}"
    );
}

#[test]
fn an_unknown_key_is_named_with_its_line_and_what_was_meant() {
    let error = read("[camera]\nwidth_px = 10\nheigth_px = 10\n", &[])
        .unwrap_err()
        .to_string();
    for part in ["rig.toml", "line 3", "heigth_px", "height_px"] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
}

#[test]
fn a_value_out_of_range_is_named_with_line_and_range() {
    let error = read("[rig]\n\ntheta_l_deg = 100.0\n", &[])
        .unwrap_err()
        .to_string();
    for part in ["rig.toml, line 3", "rig.theta_l_deg", "100", "0 to 90"] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
    assert!(read("[rig]\ntheta_l_deg = nan", &[]).is_err());
}

#[test]
fn settings_that_contradict_each_other_are_refused_with_both() {
    for (text, words) in [
        (
            "[camera]\nbit_depth = 12\nsaturation_dn = 65535.0\n",
            [
                "line 3",
                "camera.saturation_dn is 65535",
                "at most 4095",
                "bit_depth = 12",
            ],
        ),
        (
            "[camera]\nbit_depth = 8\nblack_level_dn = 300.0\n",
            [
                "line 3",
                "camera.black_level_dn is 300",
                "below 255",
                "full",
            ],
        ),
        (
            "[rig]\nlight_radius_mm = 3.0\n",
            [
                "line 2",
                "rig.light_radius_mm is 3",
                "light_distance_mm",
                "angle",
            ],
        ),
    ] {
        let error = read(text, &[]).unwrap_err().to_string();
        for part in words {
            assert!(error.contains(part), "{part} is not in: {error}");
        }
    }
    // The check does not depend on which of the two comes from a variable.
    let variable = ("RIDGED_CAMERA__BIT_DEPTH", "10");
    let error = read("[camera]\nsaturation_dn = 4095.0\n", &[variable]);
    assert!(error.unwrap_err().to_string().contains("bit_depth = 10"));
}

#[test]
fn uncertainties_of_stages_and_lamp_go_into_the_manifests() {
    let text = "[rig]\ntheta_c_std_deg = 0.1\nphi_s_std_deg = 0.05\nlamp_drift_std = 0.002\n";
    let rig = read(text, &[]).unwrap().rig_facts();
    assert_eq!(rig.theta_c_std_deg, Some(0.1));
    assert_eq!(rig.phi_s_std_deg, Some(0.05));
    assert_eq!(rig.lamp_drift_std, Some(0.002));
    assert_eq!(read("", &[]).unwrap().rig_facts().lamp_drift_std, None);
    let error = read("[rig]\nphi_s_std_deg = 11.0\n", &[]).unwrap_err();
    let error = error.to_string();
    for part in ["line 2", "rig.phi_s_std_deg is 11", "0 to 10"] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
}

#[test]
fn settings_of_access_that_protect_nothing_are_refused() {
    for (text, words) in [
        (
            "[server]\ntls_cert = \"a.pem\"\n",
            ["server.tls_key", "tls_cert and server.tls_key"],
        ),
        (
            "[server]\nhosts = [\"https://lab:8787\"]\n",
            ["server.hosts", "without scheme"],
        ),
        (
            "[import]\nroots = [\"data\"]\n",
            ["import.roots", "absolute"],
        ),
        ("[server]\nproxies = [\"proxy\"]\n", ["line 2", "proxies"]),
    ] {
        let error = read(text, &[]).unwrap_err().to_string();
        for part in words {
            assert!(error.contains(part), "{part} is not in: {error}");
        }
    }
    let roots = ("RIDGED_IMPORT__ROOTS", "[\"/srv\"]");
    let config = read("", &[roots]).unwrap();
    assert_eq!(config.import.roots, Some(vec!["/srv".into()]));
}

#[test]
fn a_wrong_type_and_a_garbled_file_are_named_with_their_line() {
    for (text, line) in [
        ("[camera]\nwidth_px = \"wide\"\n", "line 2"),
        ("[camera\nwidth_px = 3\n", "line 1"),
        ("\u{0}\u{1}garbage", "line 1"),
    ] {
        let error = read(text, &[]).unwrap_err().to_string();
        assert!(error.contains(line), "{line} is not in: {error}");
        for word in ["u32", "f64", "expected struct", "invalid type"] {
            assert!(!error.contains(word), "{word} is in: {error}");
        }
    }
    let error = read("", &[("RIDGED_CAMERA__WIDTH_PX", "wide")]).unwrap_err();
    let words = "environment variable RIDGED_CAMERA__WIDTH_PX: camera.width_px: expected a whole number from 0 to 4294967295, got \"wide\"";
    assert!(error.to_string().starts_with(words), "{error}");
}

#[test]
fn a_stage_setting_out_of_range_is_named_with_its_line() {
    let text = include_str!("../../ridged.example.toml").replace("address = 2 ", "address = 200 ");
    let text = text.replace("address = 2\n", "address = 200\n");
    let error = read(&text, &[]).unwrap_err().to_string();
    for part in ["line ", "stage.phi_s.address", "1 to 99"] {
        assert!(error.contains(part), "{part} is not in: {error}");
    }
    let error = read("port = \"/dev/ttyUSB0\"", &[])
        .unwrap_err()
        .to_string();
    assert!(error.contains("limit_min_deg"), "{error}");
}

#[test]
fn the_environment_wins_and_is_named_when_it_is_wrong() {
    let text = "[flat]\nreflectance = 0.5\n";
    let config = read(text, &[("RIDGED_FLAT__REFLECTANCE", "0.9")]).unwrap();
    assert_eq!(config.flat.reflectance, 0.9);
    let config = read("", &[("RIDGED_STORE__FOLDER", "/srv/data")]).unwrap();
    assert_eq!(config.store.folder, PathBuf::from("/srv/data"));
    for variable in [
        ("RIDGED_FLAT__REFLECTANCE", "7"),
        ("RIDGED_FLAT__REFLECTANCE", "0"),
        ("RIDGED_FLAT__REFLEKTANCE", "0.9"),
        ("RIDGED_FLAT__REFLECTANCE", "bright"),
    ] {
        let error = read(text, &[variable]).unwrap_err().to_string();
        assert!(error.contains(variable.0), "{error}");
    }
}
