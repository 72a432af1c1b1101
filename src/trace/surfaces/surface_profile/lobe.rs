//! The angle that the lobe of a rough profile follows, relative to the profile's median
//! inclination.

use super::SurfaceProfile;

/// Roughness α from narrow to broad: the broader a lobe, the more edges shift its centre.
const ALPHAS: [f64; 2] = [0.06, 0.18];
/// Iterations to the centre of a lobe: each removes most of the remaining error.
const STEPS: usize = 40;

impl SurfaceProfile {
    /// Sets the standard uncertainty `error` (rad) of the lobe's angle of a measured profile at its
    /// effective ridge angle.
    #[must_use]
    pub fn with_lobe_error(self, lobe_error: f64) -> Self {
        SurfaceProfile { lobe_error, ..self }
    }

    /// The value set by [`SurfaceProfile::with_lobe_error`]; 0 for an exactly known profile.
    #[must_use]
    pub fn lobe_error(&self) -> f64 {
        self.lobe_error
    }

    /// Offsets of the lobes of a narrow and a broad roughness from the effective ridge angle, rad;
    /// `None` if no part leans to +v.
    #[must_use]
    pub fn lobe_offsets(&self) -> Option<[f64; 2]> {
        let median = self.effective_ridge_angle()?;
        let inclined: Vec<(f64, f64)> = self
            .pieces
            .iter()
            .map(|p| {
                let length = (p.to - p.from).hypot(p.z_to - p.z_from);
                (p.normal[1].atan2(p.normal[2]), length)
            })
            .collect();
        Some(ALPHAS.map(|alpha| {
            // The mean inclination, weighted by area and by the lobe about it.
            let mut middle = median;
            for _ in 0..STEPS {
                let (mut sum, mut weights) = (0.0, 0.0);
                for (angle, length) in &inclined {
                    let weight = length * (-((angle - middle) / alpha).powi(2)).exp();
                    sum += weight * angle;
                    weights += weight;
                }
                if weights <= 0.0 {
                    break;
                }
                middle = sum / weights;
            }
            middle - median
        }))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_lobe_follows_the_facets_and_a_broad_one_also_the_edges() {
        let sharp = SurfaceProfile::sawtooth(0.2, 10.0, 0.0).unwrap();
        let [narrow, broad] = sharp.lobe_offsets().unwrap();
        assert!(narrow.abs() < 1e-12 && broad.abs() < 1e-12);
        let round = SurfaceProfile::sawtooth(0.2, 10.0, 0.5).unwrap();
        let [narrow, broad] = round.lobe_offsets().unwrap();
        assert!(
            broad < narrow && narrow < 0.0 && broad > -0.01,
            "{narrow} {broad}"
        );
    }
}
