//! Interfaces as the walk uses them: a shape, the two media, and the scattering by the facets.
//!
//! An [`Interface`] has a [`Relief`] (where a ray hits it), a boundary seen from each side, and
//! optionally the [`crate::trace::facets::scattering::Roughness`] of its facets and diffuse light from
//! below. A [`Stack`] is a list of interfaces, top first, with the layers between them.

use std::sync::Arc;

use nalgebra::Complex;

use crate::model::polarisation::{Boundary, slant};
use crate::trace::facets::scattering::{DiffuseBody, Roughness};
use crate::trace::rng::RandomStream;
use crate::trace::surfaces::height_field::{FieldSpot, Flight, HeightField, Side};
use crate::trace::surfaces::surface_profile::{ProfileFlight, ProfileSpot, SurfaceProfile};
use crate::trace::vec3::{UP, V3};

/// The shape of an interface.
#[derive(Debug, Clone)]
pub enum Relief {
    /// A plane.
    Flat,
    /// A periodic field of heights.
    Field(Arc<HeightField>),
    /// A profile that is constant along u.
    Profile(Arc<SurfaceProfile>),
}

/// A point on a relief.
#[derive(Debug, Clone, Copy)]
pub enum ReliefPoint {
    /// Any point of a plane.
    Flat,
    /// On a height field.
    Field(FieldSpot),
    /// On a profile.
    Profile(ProfileSpot),
}

/// The end of a ray.
#[derive(Debug, Clone, Copy)]
pub enum RayEnd {
    /// At a point on the same relief.
    Hit(ReliefPoint),
    /// The ray leaves the relief.
    Free,
    /// Undecided: counted as truncated.
    Lost,
}

impl Relief {
    /// First hit of a ray from far away that crosses the outermost level at fractions `x`, `y` of
    /// the tile. The number of cells or pieces that it crosses is added to `crossed`.
    #[inline]
    #[must_use]
    pub fn enter(&self, side: Side, k: &V3, x: f64, y: f64, crossed: &mut u64) -> RayEnd {
        match self {
            Relief::Flat => RayEnd::Hit(ReliefPoint::Flat),
            Relief::Field(field) => match field.enter(side, k, x, y, crossed) {
                Flight::Hit(spot) => RayEnd::Hit(ReliefPoint::Field(spot)),
                Flight::Free => RayEnd::Free,
                Flight::Lost => RayEnd::Lost,
            },
            Relief::Profile(profile) => profile_way(profile.enter(side, k, y, crossed)),
        }
    }

    /// The end of a ray that leaves `place` on one side. The number of cells or pieces that it
    /// crosses is added to `crossed`.
    #[inline]
    #[must_use]
    pub fn onward(&self, place: &ReliefPoint, side: Side, k: &V3, crossed: &mut u64) -> RayEnd {
        match (self, place) {
            (Relief::Field(field), ReliefPoint::Field(spot)) => {
                match field.onward(spot, side, k, crossed) {
                    Flight::Hit(spot) => RayEnd::Hit(ReliefPoint::Field(spot)),
                    Flight::Free => RayEnd::Free,
                    Flight::Lost => RayEnd::Lost,
                }
            }
            (Relief::Profile(profile), ReliefPoint::Profile(spot)) => {
                profile_way(profile.onward(spot, side, k, crossed))
            }
            _ => RayEnd::Free,
        }
    }

    /// Facet frame at a point: unit vectors along u, across it, and the normal (upwards).
    #[inline]
    #[must_use]
    pub fn frame(&self, place: &ReliefPoint) -> [V3; 3] {
        match (self, place) {
            (Relief::Profile(profile), ReliefPoint::Profile(spot)) => {
                let (along, normal) = profile.pieces()[spot.piece].frame(spot.v);
                [[1.0, 0.0, 0.0], along, normal]
            }
            (Relief::Field(field), ReliefPoint::Field(spot)) => {
                let normal = field.normal(spot);
                let x = 1.0 / (normal[2] * normal[2] + normal[0] * normal[0]).sqrt();
                let along = [normal[2] * x, 0.0, -normal[0] * x];
                [along, crate::trace::vec3::cross(&normal, &along), normal]
            }
            _ => [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], UP],
        }
    }

    /// Effective ridge angle, rad: the area-weighted median inclination of the parts whose normal
    /// leans to +v; `None` if no part does, or, on a height field, by less than 0.001°.
    #[must_use]
    pub fn ridge_angle(&self) -> Option<f64> {
        match self {
            Relief::Flat => None,
            Relief::Field(field) => field.effective_ridge_angle(),
            Relief::Profile(profile) => profile.effective_ridge_angle(),
        }
    }

    /// Facet normal at a point, upwards.
    #[inline]
    #[must_use]
    pub fn normal(&self, place: &ReliefPoint) -> V3 {
        match (self, place) {
            (Relief::Profile(profile), ReliefPoint::Profile(spot)) => {
                profile.pieces()[spot.piece].frame(spot.v).1
            }
            (Relief::Field(field), ReliefPoint::Field(spot)) => field.normal(spot),
            _ => UP,
        }
    }
}

fn profile_way(flight: ProfileFlight) -> RayEnd {
    match flight {
        ProfileFlight::Hit(spot) => RayEnd::Hit(ReliefPoint::Profile(spot)),
        ProfileFlight::Free => RayEnd::Free,
        ProfileFlight::Lost => RayEnd::Lost,
    }
}

/// One interface of a stack.
#[derive(Debug, Clone)]
pub struct Interface {
    /// Its shape.
    pub relief: Relief,
    /// The boundary as seen from above.
    pub from_above: Boundary,
    /// The boundary as seen from below.
    pub from_below: Boundary,
    /// Roughness of the facets, below the resolution of the shape.
    pub roughness: Option<Roughness>,
    /// Diffuse return of the light that enters.
    pub diffuse: Option<DiffuseBody>,
}

impl Interface {
    /// The boundary as seen from a side.
    #[inline]
    #[must_use]
    pub fn boundary(&self, side: Side) -> &Boundary {
        match side {
            Side::Above => &self.from_above,
            Side::Below => &self.from_below,
        }
    }
}

/// A stack of interfaces, top first.
#[derive(Debug, Clone)]
pub struct Stack {
    /// At least one.
    pub interfaces: Vec<Interface>,
    /// The medium below each interface.
    pub layers: Vec<StackLayer>,
}

/// A medium between two interfaces, or below the last.
#[derive(Debug, Clone, Copy)]
pub struct StackLayer {
    /// 4πkd/λ, the optical depth at normal incidence; 0 below the last interface.
    pub optical_depth: f64,
    /// n + ik.
    pub index: Complex<f64>,
}

impl Stack {
    /// Whether all interfaces are smooth planes: then the only random choice is at which of them
    /// light turns back.
    #[inline]
    #[must_use]
    pub fn is_flat(&self) -> bool {
        self.interfaces.iter().all(|interface| {
            matches!(interface.relief, Relief::Flat)
                && interface.roughness.is_none()
                && interface.diffuse.is_none()
        })
    }

    /// Fraction of the light that a straight crossing of the layer below `interface` leaves at |cos
    /// θ|.
    #[inline]
    #[must_use]
    pub fn kept_in_layer(&self, interface: usize, cos: f64) -> f64 {
        let StackLayer {
            optical_depth,
            index,
        } = self.layers[interface];
        if optical_depth == 0.0 {
            1.0
        } else {
            (-optical_depth * slant(index, cos)).exp()
        }
    }

    /// First hit on an interface by light from the adjacent layer: the lateral position is drawn
    /// independently, because layers are assumed thick compared with their relief.
    #[inline]
    #[must_use]
    pub fn enter(
        &self,
        interface: usize,
        side: Side,
        k: &V3,
        random: &mut RandomStream,
        crossed: &mut u64,
    ) -> RayEnd {
        match &self.interfaces[interface].relief {
            Relief::Flat => RayEnd::Hit(ReliefPoint::Flat),
            relief => {
                let (x, y) = (random.uniform(), random.uniform());
                relief.enter(side, k, x, y, crossed)
            }
        }
    }
}
