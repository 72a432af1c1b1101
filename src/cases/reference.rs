//! Tables in 60-digit arithmetic that are part of the program, with their columns by name.

use nalgebra::Vector3;

use crate::geometry::{Cones, Directions};
use crate::model::brdf::Case;
use crate::model::{Optics, Surface};

/// The printed BRDF: a [`Case`], then f, its factors d, g and fresnel, and cond, the relative condition number of f.
pub const PRINTED_BRDF: &str = include_str!("../../tests/data/brdf/reference.csv");

/// θl of the tables, degrees: it sets the unit of ρd in the sawtooth.
const THETA_L_DEG: f64 = 10.0;

/// A table.
#[derive(Debug)]
pub struct ReferenceTable {
    header: csv::StringRecord,
    rows: Vec<csv::StringRecord>,
}

impl ReferenceTable {
    /// Reads a table of the program.
    ///
    /// # Panics
    /// The text is not a table.
    #[must_use]
    pub fn read(text: &str) -> Self {
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        let header = reader.headers().cloned();
        let rows = reader.records().collect::<Result<_, _>>();
        ReferenceTable {
            header: header.expect("a table of the program has a header"),
            rows: rows.expect("a table of the program is whole"),
        }
    }

    /// Returns the rows in their order.
    pub fn rows(&self) -> impl Iterator<Item = ReferenceRow<'_>> {
        let header = &self.header;
        self.rows.iter().map(|row| ReferenceRow { header, row })
    }
}

/// A row of a table.
#[derive(Debug, Clone, Copy)]
pub struct ReferenceRow<'a> {
    header: &'a csv::StringRecord,
    row: &'a csv::StringRecord,
}

impl<'a> ReferenceRow<'a> {
    /// Returns the text of a column.
    ///
    /// # Panics
    /// The table has no such column.
    #[must_use]
    pub fn text(&self, name: &str) -> &'a str {
        let at = self.header.iter().position(|n| n == name);
        &self.row[at.expect("a column of the program's table")]
    }

    /// Returns the number of a column.
    ///
    /// # Panics
    /// The table has no such column, or it has no number.
    #[must_use]
    pub fn number(&self, name: &str) -> f64 {
        let number = self.text(name).parse();
        number.expect("the program's tables hold numbers")
    }

    /// Returns the case of a row.
    ///
    /// # Panics
    /// The table has no cases.
    #[must_use]
    pub fn case(&self) -> Case {
        Case {
            theta_i: self.number("theta_i"),
            phi_i: self.number("phi_i"),
            theta_o: self.number("theta_o"),
            phi_o: self.number("phi_o"),
            theta_r: self.number("theta_r"),
            alpha_u: self.number("alpha_u"),
            alpha_v: self.number("alpha_v"),
            rho_d: self.number("rho_d"),
            eta: self.number("eta"),
            k: self.number("k"),
        }
    }
}

/// Returns the directions of a case as vectors.
#[must_use]
pub fn directions_of(c: &Case) -> Directions {
    let of = |theta: f64, phi: f64| {
        let (s, cos) = theta.sin_cos();
        let (sp, cp) = phi.sin_cos();
        Vector3::new(s * cp, s * sp, cos)
    };
    Directions {
        incident: of(c.theta_i, c.phi_i),
        outgoing: of(c.theta_o, c.phi_o),
    }
}

/// Returns the surface of a case under a collimated lamp.
#[must_use]
pub fn surface_of(c: &Case) -> (Surface, Optics) {
    let surface = Surface {
        theta_r: c.theta_r,
        alpha_u: c.alpha_u,
        alpha_v: c.alpha_v,
        rho_d: c.rho_d,
        amplitude: 1.0,
    };
    let optics = Optics {
        eta: c.eta,
        k: c.k,
        theta_l: THETA_L_DEG.to_radians(),
        cones: Cones::NONE,
    };
    (surface, optics)
}
