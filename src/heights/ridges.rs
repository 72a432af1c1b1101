//! The measured shape of a sample: a profile across the ridges, or a height map of them.

use crate::trace::scene::{HeightMap, MapUnits};
use crate::trace::surfaces::ridge_map::{RidgeFacts, RidgeMap, RidgeMapError};
use crate::trace::surfaces::surface_profile::{ProfileError, SurfaceProfile};
use crate::wording::significant;

/// Units of a map stated by the user, µm; they override those of the file.
#[derive(Debug, Clone, Default)]
pub struct Units {
    /// Spacing of the samples: one number, or two (along the rows, along the columns).
    pub pitch_um: Vec<f64>,
    /// Micrometres per unit of the heights.
    pub height_unit_um: Option<f64>,
}

impl Units {
    /// Whether the user stated no unit.
    #[must_use]
    pub fn are_left_open(&self) -> bool {
        self.pitch_um.is_empty() && self.height_unit_um.is_none()
    }

    /// Completes the units with those stated in a map.
    fn of(&self, map: &HeightMap) -> Result<MapUnits, ShapeError> {
        let pitch_um = match (&self.pitch_um[..], map.pitch_um) {
            ([both], _) => match map.spacing {
                // A single number is ambiguous for two different spacings.
                Some([u, v]) if (u / v - 1.0).abs() > 0.01 => {
                    return Err(ShapeError::TwoSpacings { u, v });
                }
                _ => [*both; 2],
            },
            ([u, v], _) => [*u, *v],
            ([], Some(pitch_um)) => pitch_um,
            ([], None) => {
                return Err(ShapeError::NoPitch);
            }
            _ => return Err(ShapeError::PitchCount),
        };
        let height_unit_um = match (self.height_unit_um, map.height_unit_um) {
            (Some(unit), _) | (None, Some(unit)) => unit,
            (None, None) => {
                return Err(ShapeError::NoUnit);
            }
        };
        Ok(MapUnits {
            pitch_um,
            height_unit_um,
        })
    }
}

/// A sample's shape, ready for the ray tracer.
#[derive(Debug, Clone, PartialEq)]
pub struct MeasuredShape {
    /// The profile across the ridges, µm.
    pub profile: SurfaceProfile,
    /// Facts about the ridges of a height map; `None` for a profile.
    pub facts: Option<RidgeFacts>,
    /// Notes on how an ambiguous file was read.
    pub notes: Vec<String>,
}

/// Why heights are not a shape of ridges. Options have the names of the command line; the keys of a
/// request are the same words without dashes.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum ShapeError {
    /// The spacing is unknown.
    #[error(
        "the file does not state the spacing of its samples in nm, µm, mm or m: add --pitch-um (pitch_um)"
    )]
    NoPitch,
    /// Two spacings without a known unit, and a single number from the user.
    #[error(
        "the points of the file are spaced {u} along x and {v} along y: give two numbers to --pitch-um (pitch_um)"
    )]
    TwoSpacings {
        /// Along x.
        u: f64,
        /// Along y.
        v: f64,
    },
    /// The unit of the heights is unknown.
    #[error(
        "the file does not state the unit of its heights (nm, µm, mm or m): add --height-unit-um (height_unit_um)"
    )]
    NoUnit,
    /// Neither one nor two spacings were given.
    #[error("--pitch-um (pitch_um) takes one number or two")]
    PitchCount,
    /// Units were given for a profile, which has fixed units.
    #[error(
        "a table of two columns is a profile in µm: leave out --pitch-um and --height-unit-um (pitch_um, height_unit_um)"
    )]
    ProfileHasUnits,
    /// The heights cannot be in the stated unit.
    #[error(
        "the heights span {} µm over a length of {} µm, which no part does; they are probably in another unit than stated: \
         add --height-unit-um (height_unit_um), the micrometres per unit",
        significant(*.height_um), significant(*.side_um)
    )]
    OffScale {
        /// Between the lowest and the highest point.
        height_um: f64,
        /// Longer side of the map.
        side_um: f64,
    },
    /// The heights are not a closed profile.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// The heights are not a map of parallel ridges.
    #[error(transparent)]
    Map(#[from] RidgeMapError),
}

/// Returns the shape of heights: a table of two columns is a profile, everything else a map. Both
/// are oriented so that the facets lean towards +v.
///
/// # Errors
/// [`ShapeError`].
pub fn of(map: &HeightMap, units: &Units) -> Result<MeasuredShape, ShapeError> {
    let notes = map.notes.clone();
    let of_profile = |profile: SurfaceProfile, notes| MeasuredShape {
        profile: profile.facets_to_v(),
        facts: None,
        notes,
    };
    // Only tables have two columns; an image two pixels wide cannot contain ridges.
    if map.is_profile_table() {
        if units.are_left_open() {
            return Ok(of_profile(map.profile()?, notes));
        }
        return Err(ShapeError::ProfileHasUnits);
    }
    let units = units.of(map)?;
    // What else is wrong follows from a wrong unit.
    let because = |why: ShapeError| off_scale(map, units).unwrap_or(why);
    if map.rows == 1 {
        let profile = map.row_profile(units).map_err(|why| because(why.into()))?;
        return Ok(of_profile(profile, notes));
    }
    let found = RidgeMap::of(map, units).map_err(|why| because(why.into()))?;
    Ok(MeasuredShape {
        profile: found.profile,
        facts: Some(found.facts),
        notes,
    })
}

/// Returns the refusal of a map that is higher than long.
fn off_scale(map: &HeightMap, units: MapUnits) -> Option<ShapeError> {
    let seen = || map.heights.iter().copied().filter(|h| h.is_finite());
    let low = seen().fold(f64::INFINITY, f64::min);
    let high = seen().fold(f64::NEG_INFINITY, f64::max);
    let height_um = (high - low) * units.height_unit_um;
    let [u, v] = units.pitch_um;
    let side_um = (u * map.columns as f64).max(v * map.rows as f64);
    (height_um > side_um && height_um.is_finite())
        .then_some(ShapeError::OffScale { height_um, side_um })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(columns: usize, heights: Vec<f64>) -> HeightMap {
        HeightMap::new(columns, heights)
    }

    #[test]
    fn tables_of_two_columns_and_single_rows_are_profiles_and_maps_need_units() {
        let corners = vec![0.0, 0.0, 9.0, -1.0, 10.0, 0.0];
        let open = Units::default();
        let MeasuredShape { profile, facts, .. } = of(&map(2, corners.clone()), &open).unwrap();
        assert_eq!((profile.period(), facts), (10.0, None));
        let said = Units {
            pitch_um: vec![2.0],
            height_unit_um: Some(1e-3),
        };
        assert!(of(&map(2, corners), &said).is_err());
        let mirrored = map(2, vec![0.0, 0.0, 1.0, -1.0, 10.0, 0.0]);
        let turned = of(&mirrored, &open).unwrap().profile;
        assert!(turned.is_turned() && !profile.is_turned());
        assert_eq!(
            turned.effective_ridge_angle(),
            profile.effective_ridge_angle()
        );
        let row = map(4, vec![0.0, -500.0, -1000.0, 0.0]);
        assert_eq!(of(&row, &said).unwrap().profile.period(), 6.0);
        let square = map(20, vec![0.0; 400]);
        for (units, word) in [
            (&open, "--pitch-um"),
            (
                &Units {
                    pitch_um: vec![1.0],
                    ..Units::default()
                },
                "--height-unit-um",
            ),
            (&said, "flat"),
            (
                &Units {
                    pitch_um: vec![1.0; 3],
                    height_unit_um: Some(1.0),
                },
                "one number or two",
            ),
        ] {
            let error = of(&square, units).unwrap_err().to_string();
            assert!(error.contains(word), "{error}");
        }
        // Micrometres that the file states as metres, of no whole number of periods.
        let slope = map(5, vec![0.0, -0.5, -1.0, -0.3, 2.0]);
        for (height_unit_um, word) in [(1.0, "close the period"), (1e6, "--height-unit-um")] {
            let stated = MapUnits {
                pitch_um: [2.0, 2.0],
                height_unit_um,
            };
            let error = of(&slope.clone().stating(stated), &open).unwrap_err();
            assert!(error.to_string().contains(word), "{error}");
        }
        // The command line overrides the file.
        let own = MapUnits {
            pitch_um: [1.0, 1.0],
            height_unit_um: 1.0,
        };
        let stating = map(20, vec![0.0; 400]).stating(own);
        assert_eq!(said.of(&stating).unwrap().pitch_um, [2.0, 2.0]);
        assert_eq!(open.of(&stating).unwrap(), own);
        let uneven = HeightMap {
            spacing: Some([1.0, 2.0]),
            ..square
        };
        assert_eq!(
            said.of(&uneven),
            Err(ShapeError::TwoSpacings { u: 1.0, v: 2.0 })
        );
    }
}
