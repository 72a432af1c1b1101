//! The sample's own shape, measured: a profile across the ridges or a height map of them.

use crate::trace::profile::{Profile, ProfileError};
use crate::trace::ridge_map::{RidgeFacts, RidgeMap, RidgeMapError};
use crate::trace::scene::{HeightMap, MapUnits};

/// What a user says of a map's units, µm; counts more than what the file says.
#[derive(Debug, Clone, Default)]
pub struct Units {
    /// Spacing of samples, one number or one along the rows and one along the columns.
    pub pitch_um: Vec<f64>,
    /// Micrometres per unit of the heights.
    pub height_unit_um: Option<f64>,
}

impl Units {
    /// Whether nothing was said.
    #[must_use]
    pub fn are_left_open(&self) -> bool {
        self.pitch_um.is_empty() && self.height_unit_um.is_none()
    }

    /// Those of a map.
    fn of(&self, map: &HeightMap) -> Result<MapUnits, ShapeError> {
        let pitch_um = match (&self.pitch_um[..], map.pitch_um) {
            ([both], _) => match map.spacing {
                // One number does not say which of two it is.
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

/// A sample's shape, ready to be traced.
#[derive(Debug, Clone, PartialEq)]
pub struct Shape {
    /// The profile across the ridges, µm.
    pub profile: Profile,
    /// What it was made of, where it comes from a height map.
    pub facts: Option<RidgeFacts>,
    /// How its file was read, where it could have been read otherwise.
    pub notes: Vec<String>,
}

/// Why heights are no shape of ridges. Options are named as on the command line; the keys of a request are the same
/// words without dashes.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum ShapeError {
    /// Spacing unknown.
    #[error(
        "the file does not say how far its samples are apart in nm, µm, mm or m: add --pitch-um (pitch_um)"
    )]
    NoPitch,
    /// Two spacings in a unit that the file does not say, and one number for both.
    #[error(
        "the points of the file are {u} apart along x and {v} along y: --pitch-um (pitch_um) takes two numbers then"
    )]
    TwoSpacings {
        /// Along x.
        u: f64,
        /// Along y.
        v: f64,
    },
    /// Unit of heights unknown.
    #[error(
        "the file does not say if its heights are in nm, µm, mm or m: add --height-unit-um (height_unit_um)"
    )]
    NoUnit,
    /// Neither one nor two spacings.
    #[error("--pitch-um (pitch_um) takes one number or two")]
    PitchCount,
    /// Units said of a profile, which has its own.
    #[error(
        "a table of two columns is a profile in µm: leave out --pitch-um and --height-unit-um (pitch_um, height_unit_um)"
    )]
    ProfileHasUnits,
    /// No closed profile.
    #[error(transparent)]
    Profile(#[from] ProfileError),
    /// No map of parallel ridges.
    #[error(transparent)]
    Map(#[from] RidgeMapError),
}

/// The shape in some heights: of a table of two columns a profile, of anything else a map. Either is turned so that the
/// facets lean to +v.
///
/// # Errors
/// [`ShapeError`].
pub fn of(map: &HeightMap, units: &Units) -> Result<Shape, ShapeError> {
    let notes = map.notes.clone();
    let of_profile = |profile: Profile, notes| Shape {
        profile: profile.facets_to_v(),
        facts: None,
        notes,
    };
    // Only tables have two columns: of a picture two pixels wide nobody would read ridges.
    if map.is_profile_table() {
        if units.are_left_open() {
            return Ok(of_profile(map.profile()?, notes));
        }
        return Err(ShapeError::ProfileHasUnits);
    }
    let units = units.of(map)?;
    if map.rows == 1 {
        return Ok(of_profile(map.row_profile(units)?, notes));
    }
    let found = RidgeMap::of(map, units)?;
    Ok(Shape {
        profile: found.profile,
        facts: Some(found.facts),
        notes,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(columns: usize, heights: Vec<f64>) -> HeightMap {
        HeightMap::new(columns, heights)
    }

    #[test]
    fn tables_of_two_columns_and_single_rows_are_profiles_and_maps_need_their_units() {
        let corners = vec![0.0, 0.0, 9.0, -1.0, 10.0, 0.0];
        let open = Units::default();
        let Shape { profile, facts, .. } = of(&map(2, corners.clone()), &open).unwrap();
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
        // What the command line says counts more than what the file says.
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
