//! Invalid scenes, and the key that each message names.

use super::super::scene::Scene;
use super::{interface, scene};

#[test]
fn an_invalid_scene_is_refused_with_the_key() {
    let flat = interface("shape = \"flat\"", "{ n = 1.5 }");
    let beckmann = |keys: &str| interface(&format!("shape = \"beckmann\"\n{keys}"), "{ n = 1.5 }");
    let cases = [
        (scene(45.0, "", ""), "interface"),
        (scene(95.0, &flat, ""), "theta_i_deg"),
        (
            scene(45.0, &beckmann("alpha_u = 0.0\nalpha_v = 0.1"), ""),
            "alpha_u",
        ),
        (
            scene(45.0, &beckmann("alpha_u = nan\nalpha_v = 0.1"), ""),
            "alpha_u",
        ),
        (
            scene(45.0, &beckmann("alpha_u = -0.1\nalpha_v = 0.1"), ""),
            "alpha_u",
        ),
        (
            scene(45.0, &beckmann("alpha_u = 1e154\nalpha_v = 0.1"), ""),
            "at most 1e8",
        ),
        (scene(45.0, &beckmann("alpha_u = 0.1"), ""), "alpha_v"),
        (
            scene(45.0, &interface("shape = \"flat\"", "{ n = 0 }"), ""),
            "below.n",
        ),
        (
            scene(45.0, &interface("shape = \"flat\"", "{ m = 1.5 }"), ""),
            "below.m",
        ),
        (
            scene(45.0, &interface("shape = \"flat\"", "\"Unobtainium\""), ""),
            "Unobtainium",
        ),
        (
            scene(45.0, &interface("shape = \"flat\"", "7"), ""),
            "below",
        ),
        (
            scene(45.0, &interface("shape = \"bumpy\"", "{ n = 1.5 }"), ""),
            "shape",
        ),
        (
            scene(
                45.0,
                &interface("shape = \"flat\"\nalpha_u = 0.1", "{ n = 1.5 }"),
                "",
            ),
            "alpha_u",
        ),
        (
            scene(
                45.0,
                &interface("shape = \"flat\"\ncolour = 1", "{ n = 1.5 }"),
                "",
            ),
            "colour",
        ),
        (
            scene(45.0, &(interface("shape = \"flat\"", "\"Au\"") + &flat), ""),
            "must be the last",
        ),
        (
            scene(
                45.0,
                &(interface("shape = \"flat\"", "{ n = 1.5, k = 0.01 }") + &flat),
                "",
            ),
            "thickness",
        ),
        (
            scene(
                45.0,
                &(interface(
                    "shape = \"flat\"\nthickness_um = 1.0",
                    "{ n = 1.5, k = 0.16 }",
                ) + &flat),
                "",
            ),
            "below.k = 0.16 is more than a tenth of n = 1.5",
        ),
        (
            scene(
                45.0,
                &interface(
                    "shape = \"ridges\"\ntheta_r_deg = 80.0\npitch_um = 50.0\ndraft_deg = 9.0",
                    "{ n = 1.5 }",
                ),
                "",
            ),
            "must be below 9.0",
        ),
        (
            scene(45.0, &flat, "seed = 9223372036854775808"),
            "run.seed = 9223372036854775808: must be from 0 to 9223372036854775807",
        ),
        (
            scene(45.0, &flat, "seed = 18446744073709551616"),
            "run.seed: expected a whole number up to 9223372036854775807",
        ),
        (
            scene(
                45.0,
                &beckmann("alpha_u = 0.1\nalpha_v = 0.1\nseed = 18446744073709551615"),
                "",
            ),
            "interface 1: seed = 18446744073709551615",
        ),
        (
            scene(
                45.0,
                &interface("shape = \"flat\"\npitch_um = 2.0", "{ n = 1.5 }"),
                "",
            ),
            "has no key pitch_um",
        ),
        (
            scene(
                45.0,
                &interface(
                    "shape = \"smith\"\nalpha_u = inf\nalpha_v = 0.1",
                    "{ n = 1.5 }",
                ),
                "",
            ),
            "alpha_u = inf: must be a finite number",
        ),
        (scene(45.0, &flat, "photons = 0"), "photons"),
        (scene(45.0, &flat, "photons = -5"), "photons"),
        (
            scene(45.0, &flat, "photons = 1e20"),
            "run.photons: expected a whole number from 0",
        ),
        (scene(45.0, &flat, "fotons = 5"), "fotons"),
        (scene(45.0, &flat, "polarised = \"yes\""), "polarised"),
        (scene(45.0, &flat, "theta_bins = 0"), "theta_bins"),
        (
            scene(
                45.0,
                &interface(
                    "shape = \"file\"\npath = \"a.csv\"\npitch_um = 1.0\nheight_unit_um = 1.0",
                    "{ n = 1.5 }",
                ),
                "",
            ),
            "a.csv",
        ),
        (
            scene(
                45.0,
                &interface(
                    "shape = \"ridges\"\ntheta_r_deg = 10.0\npitch_um = 50.0\nround_um = -9.0",
                    "{ n = 1.5 }",
                ),
                "",
            ),
            "round_um",
        ),
        (
            "n_top = 0.0\n".to_owned() + &scene(45.0, &flat, ""),
            "n_top",
        ),
        (
            scene(45.0, &flat, "")
                .replace("wavelength_nm = 550.0", "stokes = [1.0, 1.0, 1.0, 0.0]"),
            "stokes",
        ),
    ];
    for (text, word) in cases {
        let outcome = Scene::parse(&text).and_then(|s| s.prepare(&|_| Err("missing".to_owned())));
        let message = outcome.map(|_| ()).unwrap_err().to_string();
        assert!(message.contains(word), "{word}: {message}");
    }
}

#[test]
fn every_key_of_the_parser_is_documented() {
    let document = include_str!("../../../docs/reference/scenes.md");
    let flat = interface("shape = \"flat\"", "{ n = 1.5 }");
    let mut known = 0;
    for text in [
        "unheard_of = 1\n".to_owned(),
        "[light]\nunheard_of = 1\n".to_owned(),
        "[[interface]]\nunheard_of = 1\n".to_owned(),
        format!("{flat}\n[run]\nunheard_of = 1\n"),
        format!("{flat}\n[run]\nmethod = \"unheard_of\"\n"),
    ] {
        let refused = Scene::parse(&text).unwrap_err().to_string();
        let (_, keys) = refused.rsplit_once("expected ").unwrap();
        let (keys, _) = keys.split_once(", got").unwrap_or((keys, ""));
        for key in keys.replace(" or ", ", ").trim().split(", ") {
            let forms = [format!("`{key}`"), format!("\"{key}\""), format!("[{key}]")];
            assert!(forms.iter().any(|form| document.contains(form)), "{key}");
            known += 1;
        }
    }
    assert_eq!(known, 4 + 4 + 17 + 7 + 2);
    for text in [
        scene(
            45.0,
            &interface("shape = \"unheard_of\"", "{ n = 1.5 }"),
            "",
        ),
        scene(
            45.0,
            &interface("shape = \"flat\"", "{ unheard_of = 1 }"),
            "",
        ),
    ] {
        let scene = Scene::parse(&text).unwrap();
        let refused = scene.prepare(&|_| Err(String::new())).unwrap_err();
        let list = refused
            .to_string()
            .replace(" or ", ", ")
            .replace(" and ", ", ");
        let (_, words) = list
            .rsplit_once(": must be ")
            .or(list.rsplit_once(" are "))
            .unwrap();
        for word in words.split(", ") {
            assert!(document.contains(&format!("`{word}`")), "{word}");
        }
    }
}

#[test]
fn truncated_burrs_are_reported_with_their_resulting_height() {
    let reported = |burr_um: f64| {
        let keys =
            format!("shape = \"ridges\"\ntheta_r_deg = 10.0\npitch_um = 50.0\nburr_um = {burr_um}");
        let text = scene(45.0, &interface(&keys, "\"Au550\""), "");
        let ready = Scene::parse(&text)
            .unwrap()
            .prepare(&|_| Err(String::new()));
        let mut notes = ready.unwrap().left_out.into_iter();
        notes.find(|l| l.what.contains("tall burrs")).map(|l| l.why)
    };
    assert_eq!((reported(0.0), reported(2.0)), (None, None));
    // For a mean of 10 µm, truncated at 20 µm: 10 (1 − e⁻²).
    let why = reported(10.0).unwrap();
    assert!(
        why.contains("is 8.65 µm") && why.contains("the 10 µm"),
        "{why}"
    );
}

#[test]
fn a_cover_of_less_than_a_crystal_is_refused_and_a_rounded_one_is_reported() {
    let crystals = |cover: &str| {
        let keys = format!("shape = \"crystals\"\nsize_um = 10.0\ncells = 32\ncover = {cover}");
        let text = scene(45.0, &interface(&keys, "\"Au550\""), "");
        Scene::parse(&text)
            .unwrap()
            .prepare(&|_| Err(String::new()))
    };
    let refused = crystals("0.01").unwrap_err().to_string();
    assert!(refused.contains("cover"), "{refused}");
    let reported = |cover: &str| {
        let ready = crystals(cover).unwrap();
        let notes = ready.left_out.into_iter().map(|l| l.what);
        notes.filter(|what| what.contains("cover")).count()
    };
    // Four sizes²: one and a half crystals become two.
    assert_eq!((reported("0.375"), reported("0.5")), (1, 0));
}

#[test]
fn a_tile_too_small_for_beckmann_slopes_is_reported() {
    let notes = |cells: usize| {
        let keys = format!("shape = \"beckmann\"\nalpha_u = 0.1\nalpha_v = 0.1\ncells = {cells}");
        let text = scene(45.0, &interface(&keys, "\"Au550\""), "");
        let ready = Scene::parse(&text)
            .unwrap()
            .prepare(&|_| Err(String::new()));
        let notes = ready.unwrap().left_out.into_iter().map(|l| l.what);
        notes.filter(|what| what.contains("slopes")).count()
    };
    assert_eq!((notes(16), notes(99), notes(100)), (1, 1, 0));
}

#[test]
fn the_limit_of_rho_d_depends_on_the_medium_directly_above() {
    let body = |rho_d: f64| {
        let layer = interface("shape = \"flat\"", "{ n = 1.5 }");
        let below = format!("{{ n = 1.5, rho_d = {rho_d} }}");
        let text = scene(45.0, &(layer + &interface("shape = \"flat\"", &below)), "");
        Scene::parse(&text)
            .unwrap()
            .prepare(&|_| Err(String::new()))
    };
    // Without a boundary everything is transmitted; from air it would be 92 % in both directions.
    assert!(body(0.99).is_ok());
    assert!(body(1.01).unwrap_err().to_string().contains("rho_d"));
}
