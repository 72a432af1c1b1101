//! What a tilt of the sample on the turntable, and a turn of the lamp about the camera's axis, change in the directions.

use nalgebra::Vector3;

use crate::geometry::Directions;
use crate::model::prepared::Partials;

/// Sines and cosines of the wedge, across v towards rising azimuth, and of the lamp's turn, towards rising
/// `light_azimuth`.
#[derive(Debug, Clone, Copy)]
pub(super) struct Alignment {
    wedge: (f64, f64),
    lamp: (f64, f64),
}

impl Alignment {
    /// Both in radians.
    pub(super) fn new(wedge: f64, lamp: f64) -> Self {
        Alignment {
            wedge: wedge.sin_cos(),
            lamp: lamp.sin_cos(),
        }
    }

    /// Turns the lamp about the camera's axis (Rodrigues' formula).
    pub(super) fn with_lamp(&self, directions: Directions) -> Directions {
        let (sin, cos) = self.lamp;
        if sin == 0.0 {
            return directions;
        }
        let (w, axis) = (directions.incident, directions.outgoing);
        Directions {
            incident: w * cos + axis.cross(&w) * sin + axis * (axis.dot(&w) * (1.0 - cos)),
            ..directions
        }
    }

    /// Converts directions from the turntable's plane to that of the sample.
    pub(super) fn on_wedge(&self, directions: &Directions) -> Directions {
        let (s, c) = self.wedge;
        let tilted = |w: Vector3<f64>| Vector3::new(w.x * c + w.z * s, w.y, w.z * c - w.x * s);
        Directions {
            incident: tilted(directions.incident),
            outgoing: tilted(directions.outgoing),
        }
    }

    /// Converts derivatives by the components of directions back to the turntable's plane.
    pub(super) fn off_wedge(&self, mut partials: Partials) -> Partials {
        let (s, c) = self.wedge;
        for [u, _, n] in [&mut partials.incident, &mut partials.outgoing] {
            (*u, *n) = (*u * c - *n * s, *u * s + *n * c);
        }
        partials
    }
}

/// Rate at which the direction of the lamp changes as it turns about the camera's axis.
pub(super) fn lamp_rate(directions: &Directions) -> Vector3<f64> {
    directions.outgoing.cross(&directions.incident)
}
