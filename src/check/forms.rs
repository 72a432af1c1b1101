//! The closed forms against tables in 60-digit arithmetic and against laws that hold in every row.

use std::sync::atomic::AtomicBool;

use nalgebra::Complex;

use super::criterion::{digits, limit, refused};
use super::{CheckEffort, CheckRow};
use crate::cases::reference::{ReferenceTable, directions_of, surface_of};
use crate::model::brdf::{self, Case};
use crate::model::flat_stack::FlatStack;
use crate::model::fresnel;
use crate::model::prepared::{OpticsTable, Prepared};
use crate::model::quadrature::Quadrature;
use crate::model::sawtooth::visible_and_lit_fraction;
use crate::model::single_bounce::{Scattering, mueller_brdf};
use crate::model::{Optics, Surface, Variant, radiance};

const TABLE: &str = "60-digit arithmetic";
const RECIPROCITY: &str = "reciprocity";
pub(super) fn rows(_: CheckEffort, _: &AtomicBool) -> Vec<CheckRow> {
    let mut rows = Vec::new();
    printed(&mut rows);
    sawtooth(&mut rows);
    fresnel_rows(&mut rows);
    stacks(&mut rows);
    visibility(&mut rows);
    limits(&mut rows);
    refusals(&mut rows);
    rows
}

/// The case with lamp and camera exchanged.
fn exchanged(c: &Case) -> Case {
    Case {
        theta_i: c.theta_o,
        phi_i: c.phi_o,
        theta_o: c.theta_i,
        phi_o: c.phi_i,
        ..*c
    }
}

fn printed(rows: &mut Vec<CheckRow>) {
    let area = "printed BRDF";
    let table = ReferenceTable::read(include_str!("../../tests/data/extreme/brdf.csv"));
    for line in table.rows() {
        let (name, c) = (line.text("case"), line.case());
        let (expected, cond) = (line.number("value"), line.number("cond"));
        let value = |c: &Case| brdf::evaluate(c).map_or(f64::NAN, |e| e.f);
        let judged = digits(expected, cond, value(&c));
        rows.push(CheckRow::new(area, name, "f, sr⁻¹", TABLE, judged));
        let judged = digits(value(&c), cond, value(&exchanged(&c)));
        rows.push(CheckRow::new(
            area,
            name,
            "f exchanged",
            RECIPROCITY,
            judged,
        ));
        // The form that fits use: radiance, in doubles.
        let (surface, optics) = surface_of(&c);
        let d = directions_of(&c);
        let per_cos = 1.0 / d.incident.z;
        let found = radiance(Variant::Paper, &d, &surface, &optics) * per_cos;
        let judged = digits(expected, cond, found);
        rows.push(CheckRow::new(
            area,
            name,
            "f of a fit's form",
            TABLE,
            judged,
        ));
        let prepared = Prepared::new(Variant::Paper, &surface, &OpticsTable::new(&optics));
        let judged = digits(expected, cond, prepared.partials(&d).value * per_cos);
        rows.push(CheckRow::new(
            area,
            name,
            "f of the inner loop",
            TABLE,
            judged,
        ));
        // Without ridges and diffuse light it equals the single bounce of the Mueller BRDF.
        if c.theta_r == 0.0 && c.rho_d == 0.0 && c.alpha_u == c.alpha_v {
            let scattering = Scattering {
                theta_i: c.theta_i,
                theta_s: c.theta_o,
                // SCATMECH's mirror direction is φ = 0, ours φ_i + 180°.
                phi_s: c.phi_o - c.phi_i - std::f64::consts::PI,
            };
            let found = mueller_brdf(&scattering, c.alpha_u, c.eta, c.k);
            let judged = digits(expected, cond, found.map_or(f64::NAN, |m| m.0[(0, 0)]));
            rows.push(CheckRow::new(area, name, "m00, sr⁻¹", TABLE, judged));
        }
    }
}

fn sawtooth(rows: &mut Vec<CheckRow>) {
    let area = "sawtooth in full";
    let table = ReferenceTable::read(include_str!("../../tests/data/extreme/sawtooth.csv"));
    for line in table.rows() {
        let (name, c) = (line.text("case"), line.case());
        let (expected, cond) = (line.number("value"), line.number("cond"));
        let (surface, optics) = surface_of(&c);
        let d = directions_of(&c);
        let found = radiance(Variant::Sawtooth, &d, &surface, &optics);
        rows.push(CheckRow::new(
            area,
            name,
            "radiance",
            TABLE,
            digits(expected, cond, found),
        ));
        let prepared = Prepared::new(Variant::Sawtooth, &surface, &OpticsTable::new(&optics));
        let inner = prepared.partials(&d).value;
        rows.push(CheckRow::new(
            area,
            name,
            "inner loop",
            TABLE,
            digits(expected, cond, inner),
        ));
        // L = f cos θi, and f is symmetric.
        let back = radiance(
            Variant::Sawtooth,
            &directions_of(&exchanged(&c)),
            &surface,
            &optics,
        );
        let judged = digits(found / d.incident.z, cond, back / d.outgoing.z);
        rows.push(CheckRow::new(
            area,
            name,
            "L/cos θi exchanged",
            RECIPROCITY,
            judged,
        ));
        let gradient = prepared.partials(&d);
        let slopes = [
            gradient.theta_r,
            gradient.alpha_u,
            gradient.alpha_v,
            gradient.rho_d,
            gradient.eta,
        ];
        let finite = slopes
            .iter()
            .chain(&gradient.incident)
            .all(|x| x.is_finite());
        let judged =
            super::criterion::one_of(&["finite"], if finite { "finite" } else { "not finite" });
        rows.push(CheckRow::new(
            area,
            name,
            "derivatives",
            "finite for finite input",
            judged,
        ));
    }
}

fn fresnel_rows(rows: &mut Vec<CheckRow>) {
    let table = ReferenceTable::read(include_str!("../../tests/data/extreme/fresnel.csv"));
    for line in table.rows() {
        let (r_s, r_p) =
            fresnel::reflectances(line.number("cos"), line.number("eta"), line.number("k"));
        let found = if line.text("polarisation") == "s" {
            r_s
        } else {
            r_p
        };
        let judged = digits(line.number("value"), line.number("cond"), found);
        rows.push(CheckRow::new(
            "Fresnel",
            line.text("case"),
            "reflectance",
            TABLE,
            judged,
        ));
    }
}

/// An index in the notation of the table: `1.5` or `0.35+2.7i`.
fn index(text: &str) -> Complex<f64> {
    let parse = |t: &str| t.parse().expect("the program's tables hold indices");
    match text.strip_suffix('i').and_then(|t| t.split_once('+')) {
        Some((n, k)) => Complex::new(parse(n), parse(k)),
        None => Complex::new(parse(text), 0.0),
    }
}

fn stacks(rows: &mut Vec<CheckRow>) {
    let area = "flat stack";
    let table = ReferenceTable::read(include_str!("../../tests/data/extreme/stack.csv"));
    for line in table.rows() {
        let indices = line.text("indices").split('/').map(index).collect();
        let found = FlatStack::new(indices)
            .and_then(|s| s.reflect(line.number("theta")))
            .map_or([f64::NAN; 2], |r| [r.channel.s, r.channel.p]);
        for (n, (value, cond, name)) in [("rs", "rs_cond", "R_s"), ("rp", "rp_cond", "R_p")]
            .into_iter()
            .enumerate()
        {
            let judged = digits(line.number(value), line.number(cond), found[n]);
            rows.push(CheckRow::new(area, line.text("case"), name, TABLE, judged));
        }
    }
}

/// A row of the table of stacks, for the tracer.
pub(super) struct StackLine {
    pub(super) case: String,
    pub(super) indices: Vec<Complex<f64>>,
    pub(super) theta_deg: f64,
    pub(super) rs: f64,
    pub(super) rp: f64,
}

pub(super) fn stack_lines() -> Vec<StackLine> {
    ReferenceTable::read(include_str!("../../tests/data/extreme/stack.csv"))
        .rows()
        .map(|line| StackLine {
            case: line.text("case").to_owned(),
            indices: line.text("indices").split('/').map(index).collect(),
            theta_deg: line.number("theta").to_degrees(),
            rs: line.number("rs"),
            rp: line.number("rp"),
        })
        .collect()
}

fn visibility(rows: &mut Vec<CheckRow>) {
    let table = ReferenceTable::read(include_str!("../../tests/data/extreme/visibility.csv"));
    for line in table.rows() {
        let found = visible_and_lit_fraction(
            line.number("theta_r_deg"),
            line.number("theta_i_proj_deg"),
            line.number("theta_o_proj_deg"),
        );
        let judged = digits(line.number("value"), line.number("cond"), found);
        rows.push(CheckRow::new(
            "visibility",
            line.text("case"),
            "lit and seen",
            TABLE,
            judged,
        ));
    }
}

/// Limits of vanishing parameters.
fn limits(rows: &mut Vec<CheckRow>) {
    let source = "closed limit";
    let c = Case {
        theta_i: 0.3,
        phi_i: 1.2,
        theta_o: 0.4,
        phi_o: -0.5,
        theta_r: 0.0,
        alpha_u: 0.1,
        alpha_v: 0.1,
        rho_d: 0.5,
        eta: 1.0,
        k: 0.0,
    };
    let (surface, optics) = surface_of(&c);
    let d = directions_of(&c);
    let lambert = surface.rho_d / std::f64::consts::PI * d.incident.z;
    let matched = radiance(Variant::Sawtooth, &d, &surface, &optics);
    let judged = digits(lambert, 1.0, matched);
    rows.push(CheckRow::new(
        "sawtooth in full",
        "index 1, no ridges: a Lambertian",
        "radiance",
        source,
        judged,
    ));
    for step in [1e-6, 1e-9, 1e-12] {
        let optics = Optics {
            eta: 1.0 + step,
            ..optics
        };
        let found = radiance(Variant::Sawtooth, &d, &surface, &optics);
        let name = format!("index 1 + {step:e}: nearly Lambertian");
        rows.push(CheckRow::new(
            "sawtooth in full",
            name,
            "radiance",
            source,
            limit(lambert, step, found),
        ));
    }
    // Vanishing ridges give the flat surface, in every form.
    let optics = Optics {
        eta: 1.54,
        ..optics
    };
    let table = OpticsTable::new(&optics);
    let flat = radiance(Variant::Sawtooth, &d, &surface, &optics);
    for theta_r in [1e-3, 1e-6, 1e-9] {
        let ridged = Surface { theta_r, ..surface };
        // Lobes of width α move by θr/α; diffuse light and double reflections are of first order in θr.
        let distance = theta_r / surface.alpha_u.powi(2);
        let found = radiance(Variant::Sawtooth, &d, &ridged, &optics);
        let name = format!("theta_r {theta_r:e} rad: nearly flat");
        rows.push(CheckRow::new(
            "sawtooth in full",
            name.clone(),
            "radiance",
            source,
            limit(flat, distance, found),
        ));
        let higher_order = |s: &Surface| Quadrature::new(s, &table).radiance(&d, theta_r).value;
        let judged = limit(higher_order(&surface), distance, higher_order(&ridged));
        rows.push(CheckRow::new(
            "two-bounce quadrature",
            name,
            "radiance",
            source,
            judged,
        ));
    }
}

fn refusals(rows: &mut Vec<CheckRow>) {
    let source = "no value is possible";
    let c = Case {
        theta_i: 0.3,
        phi_i: 0.0,
        theta_o: 0.3,
        phi_o: 3.0,
        theta_r: 0.1,
        alpha_u: 0.1,
        alpha_v: 0.1,
        rho_d: 0.0,
        eta: 1.5,
        k: 0.0,
    };
    let cases = [
        (
            "roughness 0",
            Case { alpha_u: 0.0, ..c },
            "alpha_u is not positive",
        ),
        (
            "lamp below the horizon",
            Case { theta_i: 1.6, ..c },
            "theta_i is not within",
        ),
        (
            "ridge of 90° and more",
            Case { theta_r: 1.6, ..c },
            "theta_r is not within",
        ),
        (
            "an angle that is not a number",
            Case {
                phi_o: f64::NAN,
                ..c
            },
            "phi_o is not a finite number",
        ),
        ("index 0", Case { eta: 0.0, ..c }, "eta and k are both zero"),
    ];
    for (name, case, word) in cases {
        let found = brdf::evaluate(&case)
            .map(|e| e.f.to_string())
            .map_err(|e| e.to_string());
        rows.push(CheckRow::new(
            "printed BRDF",
            name,
            "f",
            source,
            refused(word, &found),
        ));
    }
    let found = FlatStack::new(vec![
        Complex::new(1.0, 0.0),
        Complex::new(1.5, 0.1),
        Complex::new(1.3, 0.0),
    ])
    .map(|_| "accepted".to_owned())
    .map_err(|e| e.to_string());
    rows.push(CheckRow::new(
        "flat stack",
        "a layer that absorbs",
        "R",
        source,
        refused("absorbs", &found),
    ));
}
