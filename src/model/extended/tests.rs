use super::slopes::half_width_over_alpha;
use super::*;
use crate::geometry::{Cones, Directions, Pose, RigGeometry};
use crate::model::Variant;
use crate::model::lanes::Lane;
use crate::model::prepared::OpticsTable;
use crate::model::prepared::Partials;
use crate::model::prepared::Prepared;
use crate::model::real::DEVIATIONS;
use crate::units::Angle;
use nalgebra::Vector3;

/// A row of `tests/data/real-samples-reference.csv`; columns that a kind does not use are NaN.
#[derive(Debug)]
pub(crate) struct Row {
    pub theta_r: f64,
    pub alpha_u: f64,
    pub alpha_v: f64,
    pub gamma: f64,
    pub index: f64,
    pub rho_d: f64,
    pub theta_l: f64,
    pub i: [f64; 3],
    pub o: [f64; 3],
    pub x: f64,
    pub y: f64,
    pub value: f64,
}

impl Row {
    fn tail(&self) -> f64 {
        1.0 / (self.gamma - 1.0)
    }
}

/// Returns the rows of one kind.
pub(crate) fn reference(kind: &str) -> Vec<Row> {
    let text = include_str!("../../../tests/data/real-samples-reference.csv");
    let rows = text.lines().skip(1).map(|line| line.split(',').collect());
    let rows = rows.filter(|row: &Vec<&str>| row[0] == kind);
    rows.map(|row| {
        let at = |column: usize| row[column].parse().unwrap_or(f64::NAN);
        let three = |first: usize| [at(first), at(first + 1), at(first + 2)];
        Row {
            theta_r: at(1).to_radians(),
            alpha_u: at(2),
            alpha_v: at(3),
            gamma: at(4),
            index: at(5),
            rho_d: at(6),
            theta_l: at(7).to_radians(),
            i: three(8),
            o: three(11),
            x: at(14),
            y: at(15),
            value: at(16),
        }
    })
    .collect()
}

/// Returns the derivatives; `moves` states whether tails and crests are free.
fn partials(
    directions: &Directions,
    surface: &Surface,
    real: &Real,
    moves: bool,
    optics: &Optics,
    walls: &Walls,
) -> Partials {
    let terms = Terms::of(real, optics, &Real::from_array([moves; DEVIATIONS]));
    super::partials(directions, surface, real, terms, optics, walls)
}

fn slopes(row: &Row) -> Slopes<f64> {
    Slopes {
        u2: row.alpha_u * row.alpha_u,
        v2: row.alpha_v * row.alpha_v,
        tail: row.tail(),
        widening: 0.0,
    }
}

#[test]
fn slopes_have_the_density_of_student_s_t() {
    let rows = reference("std_slope_density");
    assert_eq!(rows.len(), 30);
    for row in rows {
        let slopes = slopes(&row);
        let found = slopes.relative(row.x * row.x, row.y * row.y) * slopes.norm();
        assert!((found / row.value - 1.0).abs() < 1e-12, "{row:?}: {found}");
    }
    for row in reference("std_half_width_over_alpha") {
        let to_half_width = std::f64::consts::LN_2.sqrt();
        let found = to_half_width * half_width_over_alpha(row.tail());
        assert!((found / row.value - 1.0).abs() < 1e-12, "{row:?}: {found}");
    }
}

#[test]
fn the_share_of_slopes_below_a_bound_agrees_with_student_s_t() {
    // Three quarters of the slopes are below the median of |slope|.
    let rows = reference("std_median_abs_slope_over_alpha");
    assert_eq!(rows.len(), 8);
    for row in rows {
        let slopes = Slopes {
            u2: 1.0,
            v2: 1.0,
            tail: row.tail(),
            widening: 0.0,
        };
        // A slope's own distribution has α/√2, the retro lobe's has α.
        let found = slopes.share_below(row.value * std::f64::consts::SQRT_2);
        assert!((found - 0.75).abs() < 3e-3, "{row:?}: {found}");
    }
}

#[test]
fn a_crest_s_arc_agrees_with_an_integral_in_forty_digits() {
    let rows = reference("arc_integral");
    assert_eq!(rows.len(), 15);
    for row in rows {
        let h_u = row.i[0];
        let across = (1.0 - h_u * h_u).sqrt();
        let (sin, cos) = row.y.sin_cos();
        let h = [h_u, across * sin, across * cos];
        let mut slopes = slopes(&row);
        slopes.tail = 0.0;
        for tails in [false, true] {
            let found = crest::lobe(h, (row.x, row.theta_r), &slopes, tails);
            // The sum over the angle is exact to some digits, the closed form to nearly all.
            let allowed = if tails { 1e-4 } else { 1e-9 };
            assert!(
                (found / row.value - 1.0).abs() < allowed,
                "{tails} {row:?}: {found}"
            );
        }
    }
}

fn optics(index: f64, theta_l: f64) -> Optics {
    Optics {
        eta: index,
        k: 0.0,
        theta_l,
        cones: Cones::of_lamp(Angle::ZERO),
    }
}

#[test]
fn a_translucent_body_agrees_with_an_independent_transcription() {
    let rows = reference("translucent_radiance_smooth");
    assert_eq!(rows.len(), 20);
    for row in rows {
        let surface = Surface {
            theta_r: row.theta_r,
            alpha_u: 1e-3,
            alpha_v: 1e-3,
            rho_d: row.rho_d,
            amplitude: 0.0,
        };
        let real = Real {
            translucency: 1.0,
            ..Real::default()
        };
        let optics = optics(row.index, row.theta_l);
        let directions = Directions {
            incident: Vector3::from(row.i),
            outgoing: Vector3::from(row.o),
        };
        let walls = Walls::smooth(&OpticsTable::new(&optics));
        let found = partials(&directions, &surface, &real, false, &optics, &walls).value;
        assert!((found / row.value - 1.0).abs() < 1e-12, "{row:?}: {found}");
    }
}

struct Draw {
    rig: RigGeometry,
    pose: Pose,
    surface: Surface,
    real: Real,
    optics: Optics,
}

/// Returns random rigs, poses and surfaces. A new term of [`Real`] is drawn here, from a value that depends only on `n`: one
/// more call of `between` changes all later draws. A term that [`Terms`] leaves out at 0 is drawn above 0.
fn draws(count: usize) -> impl Iterator<Item = Draw> {
    let mut state = 11u64;
    let mut between = move |low: f64, high: f64| {
        state = state
            .wrapping_mul(6_364_136_223_846_793_005)
            .wrapping_add(1_442_695_040_888_963_407);
        low + (high - low) * ((state >> 11) as f64 / (1u64 << 53) as f64)
    };
    (0..count).map(move |n| {
        let rig = RigGeometry {
            theta_l: Angle::from_deg(between(0.0, 40.0)),
            light_azimuth: Angle::from_deg(between(-180.0, 180.0)),
            azimuth_zero: Angle::from_deg(between(-180.0, 180.0)),
            cones: Cones::of_lamp(Angle::from_deg(between(0.0, 2.0))),
        };
        let metal = n % 4 == 0;
        Draw {
            rig,
            pose: Pose::from_deg(between(-50.0, 50.0), between(-180.0, 180.0)),
            surface: Surface {
                theta_r: between(0.02, 0.6),
                alpha_u: between(0.04, 0.4),
                alpha_v: between(0.04, 0.4),
                rho_d: if metal { 0.0 } else { between(0.01, 0.9) },
                amplitude: 1.0,
            },
            real: Real {
                translucency: between(0.0, 1.0),
                tail: between(0.0, 1.2),
                crest: between(0.0, 0.01),
                land: between(0.0, 0.5),
            },
            optics: Optics {
                eta: between(1.2, 2.5),
                k: if metal { between(0.5, 5.0) } else { 0.0 },
                theta_l: rig.theta_l.rad(),
                cones: rig.cones,
            },
        }
    })
}

#[test]
fn without_real_terms_the_form_and_its_derivatives_are_those_of_the_ideal_sawtooth() {
    let mut lit = 0;
    for draw in draws(2000) {
        let table = OpticsTable::new(&draw.optics);
        let walls = Walls::smooth(&table);
        let directions = draw.rig.directions(draw.pose);
        let none = Real::default();
        let sharp = Prepared::new(Variant::Sawtooth, &draw.surface, &table).partials(&directions);
        for free in [false, true] {
            let found = partials(
                &directions,
                &draw.surface,
                &none,
                free,
                &draw.optics,
                &walls,
            );
            lit += usize::from(sharp.value > 1e-6);
            let pairs = [
                (found.value, sharp.value),
                (found.theta_r, sharp.theta_r),
                (found.alpha_u, sharp.alpha_u),
                (found.alpha_v, sharp.alpha_v),
                match draw.optics.k > 0.0 {
                    // A metal has no diffuse light.
                    true => (0.0, 0.0),
                    false => (found.rho_d, sharp.rho_d),
                },
                (found.eta, sharp.eta),
                (found.k, sharp.k),
            ];
            for (k, (a, b)) in pairs.into_iter().enumerate() {
                let scale = b.abs() + sharp.value.abs() + 1e-9;
                assert!(
                    (a - b).abs() < 1e-9 * scale,
                    "{k} {a} {b} {:?} {:?}",
                    draw.surface,
                    draw.pose
                );
            }
        }
    }
    assert!(lit > 1500, "{lit}");
}

#[test]
fn derivatives_of_the_real_terms_agree_with_differences() {
    let mut lit = 0;
    for draw in draws(300) {
        let table = OpticsTable::new(&draw.optics);
        let walls = Walls::new(&draw.surface, &draw.real, &table);
        let directions = draw.rig.directions(draw.pose);
        let at = |real: Real| {
            partials(
                &directions,
                &draw.surface,
                &real,
                true,
                &draw.optics,
                &walls,
            )
        };
        let here = at(draw.real);
        lit += usize::from(here.value > 1e-6);
        let h = 1e-6;
        let by = |k: usize, h: f64| {
            let mut changed = draw.real.into_array();
            changed[k] += h;
            at(Real::from_array(changed)).value
        };
        for (k, a) in here.real.into_array().into_iter().enumerate() {
            let b = (by(k, h) - by(k, -h)) / (2.0 * h);
            assert!((a - b).abs() < 1e-5 * (a.abs() + here.value), "{k} {a} {b}");
        }
    }
    assert!(lit > 150, "{lit}");
}

#[test]
fn lamp_and_camera_may_be_exchanged() {
    let mut lit = 0;
    for draw in draws(1000) {
        let walls = Walls::new(&draw.surface, &draw.real, &OpticsTable::new(&draw.optics));
        let there = draw.rig.directions(draw.pose);
        let back = Directions {
            incident: there.outgoing,
            outgoing: there.incident,
        };
        let f = |d: &Directions| {
            let found = partials(d, &draw.surface, &draw.real, false, &draw.optics, &walls);
            found.value * d.outgoing.z
        };
        let (a, b) = (f(&there), f(&back));
        lit += usize::from(a > 1e-6);
        assert!(
            (a - b).abs() <= 1e-11 * (a + 1e-9),
            "{a} {b} {:?}",
            draw.pose
        );
    }
    assert!(lit > 500, "{lit}");
}

#[test]
fn the_appearance_of_a_flat_piece_does_not_depend_on_the_translucency() {
    for draw in draws(200).filter(|d| d.optics.k == 0.0) {
        let surface = Surface {
            theta_r: 0.0,
            ..draw.surface
        };
        let at = |translucency: f64| {
            let real = Real {
                translucency,
                crest: 0.0,
                ..draw.real
            };
            let walls = Walls::new(&surface, &real, &OpticsTable::new(&draw.optics));
            let directions = draw.rig.directions(draw.pose);
            partials(&directions, &surface, &real, false, &draw.optics, &walls).value
        };
        let (none, all) = (at(0.0), at(1.0));
        assert!((none - all).abs() <= 1e-12 * none, "{none} {all}");
    }
}

#[test]
fn a_register_of_surfaces_has_the_values_of_single_surfaces() {
    struct All<'a>(&'a Draw, &'a Walls, f64);
    impl pulp::WithSimd for All<'_> {
        type Output = ();
        #[inline(always)]
        fn with_simd<S: pulp::Simd>(self, simd: S) {
            let All(draw, walls, alone) = self;
            let k = |x: f64| Lane::splat(simd, x);
            let q = Parameters {
                theta_r: k(draw.surface.theta_r),
                alpha_u: k(draw.surface.alpha_u),
                alpha_v: k(draw.surface.alpha_v),
                rho_d: k(draw.surface.rho_d),
                real: Real::from_array(draw.real.into_array().map(k)),
                amplitude: k(1.0),
                eta: k(draw.optics.eta),
                k: k(draw.optics.k),
            };
            let terms = Terms::of(
                &draw.real,
                &draw.optics,
                &Real::from_array([true; DEVIATIONS]),
            );
            let d = draw.rig.directions(draw.pose);
            let of = |w: Vector3<f64>| [k(w.x), k(w.y), k(w.z)];
            let (i, o) = (of(d.incident), of(d.outgoing));
            let widening = draw.optics.cones.widening();
            let found = radiance_of(i, o, &q, terms, walls, widening);
            let mut lanes = vec![0.0; S::F64_LANES];
            found.store(&mut lanes, 0);
            for lane in lanes {
                assert!(
                    (lane - alone).abs() <= 1e-12 * (alone + 1e-9),
                    "{lane} {alone}"
                );
            }
        }
    }
    for draw in draws(200) {
        let walls = Walls::new(&draw.surface, &draw.real, &OpticsTable::new(&draw.optics));
        let directions = draw.rig.directions(draw.pose);
        if directions.incident.z <= 0.0 || directions.outgoing.z <= 0.0 {
            continue;
        }
        let alone = partials(
            &directions,
            &draw.surface,
            &draw.real,
            true,
            &draw.optics,
            &walls,
        );
        pulp::Arch::new().dispatch(All(&draw, &walls, alone.value));
    }
}

#[test]
fn the_transmittance_of_a_sawtooth_is_one_less_its_traced_albedo() {
    // Furnace test: with a body that returns no light, the albedo is the light that the walls reflect. From behind
    // and beyond 40° one mirror hop is not all of it.
    let rows = reference("sawtooth_transmittance_traced");
    assert_eq!(rows.len(), 48);
    for row in rows {
        let tail = if row.gamma.is_finite() { 1.0 } else { 0.0 };
        let surface = Surface {
            theta_r: row.theta_r,
            alpha_u: row.alpha_u,
            alpha_v: row.alpha_v,
            rho_d: 0.5,
            amplitude: 0.0,
        };
        let real = Real {
            translucency: 1.0,
            tail,
            crest: 0.0,
            land: 0.0,
        };
        let optics = optics(row.index, 0.0);
        let table = OpticsTable::new(&optics);
        let walls = Walls::new(&surface, &real, &table);
        // L (o·n) is c_d E(i) E(o).
        let directions = Directions {
            incident: Vector3::from(row.i),
            outgoing: Vector3::from(row.i),
        };
        let radiance = partials(&directions, &surface, &real, false, &optics, &walls).value;
        let c_d = surface.rho_d * walls.body(row.index, 0.0)[0];
        let found = (radiance / row.i[2] / c_d).sqrt();
        let (behind, slanting) = (row.i[1] < 0.0 && row.i[2] < 0.8, row.i[2] < 0.6);
        let allowed = match (behind, slanting) {
            (true, _) => 5e-3,
            (false, true) => 2.5e-3,
            (false, false) => 1.2e-3,
        };
        assert!((found - row.value).abs() < allowed, "{row:?}: {found}");
    }
}
