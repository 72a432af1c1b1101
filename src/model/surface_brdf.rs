//! The closed form of one surface as a BRDF: prepared once, evaluated in many directions.

use super::closed_form::ClosedForm;
use super::extended::Real;
use super::{Optics, Surface, Variant};
use crate::geometry::{Cones, Directions};

/// A surface whose BRDF is a closed form, for points of lamp and lens.
#[derive(Debug, Clone)]
pub struct SurfaceBrdf {
    variant: Variant,
    surface: Surface,
    real: Real,
    form: ClosedForm,
}

impl SurfaceBrdf {
    /// Prepares a surface; `real` selects the form of real samples, as in [`ClosedForm::new`]. The cones of `optics` have no
    /// effect. The surface passes [`super::domain::check`].
    #[must_use]
    pub fn new(variant: Variant, surface: Surface, real: Option<Real>, optics: &Optics) -> Self {
        let points = Optics {
            cones: Cones::NONE,
            ..*optics
        };
        SurfaceBrdf {
            variant,
            surface,
            real: real.unwrap_or(Real::NONE),
            form: ClosedForm::new(variant, &surface, real.as_ref(), &points),
        }
    }

    /// Returns f in 1/sr; 0 if lamp or camera is not above the surface.
    #[must_use]
    pub fn value(&self, directions: &Directions) -> f64 {
        let cos_i = directions.incident.z;
        if cos_i <= 0.0 {
            return 0.0;
        }
        self.form.radiance(directions) / cos_i
    }

    /// Which closed form it is.
    #[must_use]
    pub fn variant(&self) -> Variant {
        self.variant
    }

    /// The surface.
    #[must_use]
    pub fn surface(&self) -> &Surface {
        &self.surface
    }

    /// Its deviations from an ideal sawtooth.
    #[must_use]
    pub fn real(&self) -> &Real {
        &self.real
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::model::radiance;
    use nalgebra::Vector3;

    const SURFACE: Surface = Surface {
        theta_r: 0.2,
        alpha_u: 0.08,
        alpha_v: 0.12,
        rho_d: 0.3,
        amplitude: 1.0,
    };
    const OPTICS: Optics = Optics {
        eta: 1.54,
        k: 0.0,
        theta_l: 0.17,
        cones: Cones::NONE,
    };

    fn direction(theta: f64, phi: f64) -> Vector3<f64> {
        Vector3::new(
            theta.sin() * phi.cos(),
            theta.sin() * phi.sin(),
            theta.cos(),
        )
    }

    #[test]
    fn every_form_is_the_same_from_both_ends() {
        let real = Real {
            translucency: 0.2,
            tail: 0.4,
            crest: 0.05,
            land: 0.1,
        };
        for (variant, real) in [
            (Variant::Paper, None),
            (Variant::Sawtooth, None),
            (Variant::Sawtooth, Some(real)),
        ] {
            let brdf = SurfaceBrdf::new(variant, SURFACE, real, &OPTICS);
            for (theta, phi, beside, turn) in [(0.3, 1.4, 0.5, -1.2), (0.9, 0.2, 0.1, 3.0)] {
                let (incident, outgoing) = (direction(theta, phi), direction(beside, turn));
                let there = brdf.value(&Directions { incident, outgoing });
                let back = brdf.value(&Directions {
                    incident: outgoing,
                    outgoing: incident,
                });
                assert!(there > 0.0, "{variant:?}");
                assert!(
                    (there / back - 1.0).abs() < 1e-9,
                    "{variant:?} {there} {back}"
                );
            }
        }
    }

    #[test]
    fn the_forms_are_those_of_the_fits() {
        let directions = Directions {
            incident: direction(0.5, -1.1),
            outgoing: direction(0.3, 2.0),
        };
        for variant in [Variant::Paper, Variant::Sawtooth] {
            let brdf = SurfaceBrdf::new(variant, SURFACE, None, &OPTICS);
            let expected = radiance(variant, &directions, &SURFACE, &OPTICS) / 0.5f64.cos();
            let found = brdf.value(&directions);
            assert!((found / expected - 1.0).abs() < 1e-12, "{variant:?}");
        }
    }

    #[test]
    fn cones_have_no_effect_and_nothing_comes_from_below() {
        let wide = Optics {
            cones: Cones::of_lamp(crate::units::Angle::from_deg(3.0)),
            ..OPTICS
        };
        let directions = Directions {
            incident: direction(0.4, 1.5),
            outgoing: direction(0.1, 0.0),
        };
        let of = |optics: &Optics| {
            SurfaceBrdf::new(Variant::Sawtooth, SURFACE, None, optics).value(&directions)
        };
        assert_eq!(of(&wide), of(&OPTICS));
        let below = Directions {
            outgoing: direction(1.6, 0.0),
            ..directions
        };
        let brdf = SurfaceBrdf::new(Variant::Sawtooth, SURFACE, None, &OPTICS);
        assert_eq!(brdf.value(&below), 0.0);
    }
}
