//! The angle that a rough profile's lobe follows, beside the median inclination that names the profile.

use super::Profile;

/// Roughness α from narrow to broad: of a broad lobe, edges move the middle more.
const ALPHAS: [f64; 2] = [0.06, 0.18];
/// Steps to the middle of a lobe: each takes off most of what is left.
const STEPS: usize = 40;

impl Profile {
    /// The same, measured so that the angle that light follows is off by `error` (rad, standard uncertainty) at its effective
    /// ridge angle.
    #[must_use]
    pub fn with_lobe_error(self, lobe_error: f64) -> Self {
        Profile { lobe_error, ..self }
    }

    /// What [`Profile::with_lobe_error`] was told; 0 of a profile that is known.
    #[must_use]
    pub fn lobe_error(&self) -> f64 {
        self.lobe_error
    }

    /// How far the lobes of a narrow and a broad roughness lie beside the effective ridge angle, rad; `None` where nothing
    /// leans to +v.
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
            // The mean inclination by area and by the lobe about it.
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
    fn a_lobe_follows_the_facets_and_the_more_of_the_edges_the_broader_it_is() {
        let sharp = Profile::sawtooth(0.2, 10.0, 0.0).unwrap();
        let [narrow, broad] = sharp.lobe_offsets().unwrap();
        assert!(narrow.abs() < 1e-12 && broad.abs() < 1e-12);
        let round = Profile::sawtooth(0.2, 10.0, 0.5).unwrap();
        let [narrow, broad] = round.lobe_offsets().unwrap();
        assert!(
            broad < narrow && narrow < 0.0 && broad > -0.01,
            "{narrow} {broad}"
        );
    }
}
