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
        let own = map.units;
        let pitch_um = match (&self.pitch_um[..], own) {
            ([both], _) => [*both; 2],
            ([u, v], _) => [*u, *v],
            ([], Some(units)) => units.pitch_um,
            ([], None) => {
                return Err(ShapeError::NoPitch);
            }
            _ => return Err(ShapeError::PitchCount),
        };
        let height_unit_um = match (self.height_unit_um, own) {
            (Some(unit), _) => unit,
            (None, Some(units)) => units.height_unit_um,
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

/// Why heights are no shape of ridges. Options are named as on the command line; the keys of a request are the same
/// words without dashes.
#[derive(Debug, PartialEq, thiserror::Error)]
pub enum ShapeError {
    /// Spacing unknown.
    #[error("the file does not say how far its samples are apart: add --pitch-um (pitch_um)")]
    NoPitch,
    /// Unit of heights unknown.
    #[error("the file does not say what its heights are in: add --height-unit-um (height_unit_um)")]
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
pub fn of(map: &HeightMap, units: &Units) -> Result<(Profile, Option<RidgeFacts>), ShapeError> {
    // Only tables have two columns: of a picture two pixels wide nobody would read ridges.
    if map.columns == 2 && map.units.is_none() {
        if units.are_left_open() {
            return Ok((map.profile()?.facets_to_v(), None));
        }
        return Err(ShapeError::ProfileHasUnits);
    }
    let units = units.of(map)?;
    if map.rows == 1 {
        let rows = map.heights.iter().enumerate();
        let rows: Vec<(f64, f64)> = rows
            .map(|(n, h)| (n as f64 * units.pitch_um[0], h * units.height_unit_um))
            .collect();
        return Ok((Profile::measured(&rows)?.facets_to_v(), None));
    }
    let found = RidgeMap::of(map, units)?;
    Ok((found.profile, Some(found.facts)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn map(columns: usize, heights: Vec<f64>, units: Option<MapUnits>) -> HeightMap {
        HeightMap {
            columns,
            rows: heights.len() / columns,
            heights,
            units,
            filled: 0,
        }
    }

    #[test]
    fn tables_of_two_columns_and_single_rows_are_profiles_and_maps_need_their_units() {
        let corners = vec![0.0, 0.0, 9.0, -1.0, 10.0, 0.0];
        let open = Units::default();
        let (profile, facts) = of(&map(2, corners.clone(), None), &open).unwrap();
        assert_eq!((profile.period(), facts), (10.0, None));
        let said = Units {
            pitch_um: vec![2.0],
            height_unit_um: Some(1e-3),
        };
        assert!(of(&map(2, corners, None), &said).is_err());
        let mirrored = map(2, vec![0.0, 0.0, 1.0, -1.0, 10.0, 0.0], None);
        let (turned, _) = of(&mirrored, &open).unwrap();
        assert!(turned.is_turned() && !profile.is_turned());
        assert_eq!(
            turned.effective_ridge_angle(),
            profile.effective_ridge_angle()
        );
        let row = map(4, vec![0.0, -500.0, -1000.0, 0.0], None);
        assert_eq!(of(&row, &said).unwrap().0.period(), 6.0);
        let square = map(20, vec![0.0; 400], None);
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
        let units = said.of(&map(20, vec![0.0; 400], Some(own))).unwrap();
        assert_eq!(units.pitch_um, [2.0, 2.0]);
        assert_eq!(open.of(&map(20, vec![0.0; 400], Some(own))).unwrap(), own);
    }
}
