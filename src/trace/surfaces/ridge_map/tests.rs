//! Sawtooth maps with known direction, period and noise.

use super::*;
use crate::trace::rng::{Purpose, RandomStream};
use crate::trace::surfaces::worn_ridges::WornRidges;

/// A map of a profile whose +v points to `azimuth_deg`, with a tilt, and noise of this many µm
/// (rms).
pub(crate) fn map_of(
    profile: &SurfaceProfile,
    azimuth_deg: f64,
    size: [usize; 2],
    pitch: [f64; 2],
    noise: f64,
) -> HeightMap {
    let (s, c) = azimuth_deg.to_radians().sin_cos();
    let mut random = RandomStream::new(7, Purpose::Surface, 1);
    let pieces = profile.pieces();
    let height = |v: f64| {
        let v = pieces[0].from + (v - pieces[0].from).rem_euclid(profile.period());
        let n = pieces.partition_point(|p| p.to <= v).min(pieces.len() - 1);
        let p = &pieces[n];
        p.z_from + (p.z_to - p.z_from) * (v - p.from) / (p.to - p.from)
    };
    let heights = (0..size[0] * size[1]).map(|n| {
        let (x, y) = (
            (n % size[0]) as f64 * pitch[0],
            (n / size[0]) as f64 * pitch[1],
        );
        // Uniform noise of this standard deviation.
        let noise = noise * 12f64.sqrt() * (random.uniform() - 0.5);
        5.0 + height(x * c + y * s) + 0.01 * x - 0.02 * y + noise
    });
    HeightMap::new(size[0], heights.collect())
}

fn units(pitch: [f64; 2]) -> MapUnits {
    MapUnits {
        pitch_um: pitch,
        height_unit_um: 1.0,
    }
}

fn found(map: &HeightMap, pitch: [f64; 2]) -> Result<RidgeFacts, RidgeMapError> {
    RidgeMap::of(map, units(pitch)).map(|r| r.facts)
}

#[test]
fn direction_period_and_angle_are_recovered_from_rotated_noisy_maps() {
    let theta_r = 10f64.to_radians();
    let sawtooth = SurfaceProfile::sawtooth(theta_r, 25.0, 0.0).unwrap();
    for (azimuth_deg, pitch) in [
        (0.0, [1.0, 1.0]),
        (23.0, [1.0, 1.3]),
        (90.7, [1.0, 1.0]),
        (135.0, [1.2, 1.0]),
        (201.0, [0.7, 1.0]),
        (300.0, [1.0, 1.0]),
    ] {
        let noise = 0.1;
        let map = map_of(&sawtooth, azimuth_deg, [230, 190], pitch, noise);
        let f = found(&map, pitch).unwrap();
        let off = (f.lean_azimuth_deg - azimuth_deg + 180.0).rem_euclid(360.0) - 180.0;
        // A rotation by this shears a ridge by a third of a pixel over the map.
        assert!(off.abs() < 0.1, "{azimuth_deg}: {f:?}");
        let period = sawtooth.period();
        assert!((f.period_um / period - 1.0).abs() < 1e-3, "{f:?}");
        assert!((f.theta_r_deg - 10.0).abs() < 0.25, "{azimuth_deg}: {f:?}");
        // The part of a line that a riser crosses is not explained: one pixel of 25.
        assert!(f.ridges >= 5 && f.explained > 0.93, "{f:?}");
        assert!((f.unevenness_um / noise - 1.0).abs() < 0.1, "{f:?}");
        let (low, high) = sawtooth.range();
        assert!((f.height_um / (high - low) - 1.0).abs() < 0.15, "{f:?}");
    }
}

#[test]
fn the_mean_along_the_ridges_recovers_the_profile_of_the_map() {
    let worn = WornRidges {
        round: 1.5,
        ..WornRidges::ideal(0.2, 40.0)
    };
    let profile = worn.profile().unwrap();
    let map = map_of(&profile, 67.0, [300, 260], [1.0, 1.0], 0.05);
    let made = RidgeMap::of(&map, units([1.0, 1.0])).unwrap();
    let expected = profile.effective_ridge_angle().unwrap().to_degrees();
    assert!(
        (made.facts.theta_r_deg - expected).abs() < 0.2,
        "{:?}",
        made.facts
    );
    // On the facets the slopes are those of the sawtooth, for nine tenths of the length.
    let pieces = made.profile.pieces();
    let slope =
        |p: &&crate::trace::surfaces::surface_profile::Piece| (p.z_to - p.z_from) / (p.to - p.from);
    let close = pieces
        .iter()
        .filter(|p| (slope(p) + 0.2f64.tan()).abs() < 0.05);
    let length: f64 = close.map(|p| p.to - p.from).sum();
    assert!(length > 0.8 * made.profile.period(), "{length}");
}

#[test]
fn large_ridges_and_many_ridges_are_found_equally() {
    for (pitch_um, size) in [(160.0, [600, 520]), (10.0, [420, 300])] {
        let sawtooth = SurfaceProfile::sawtooth(0.15, pitch_um, 0.0).unwrap();
        let map = map_of(&sawtooth, 75.0, size, [1.0, 1.0], 0.02);
        let f = found(&map, [1.0, 1.0]).unwrap();
        assert!(
            (f.period_um / sawtooth.period() - 1.0).abs() < 1e-3,
            "{f:?}"
        );
        assert!((f.lean_azimuth_deg - 75.0).abs() < 0.1, "{f:?}");
    }
}

#[test]
fn other_maps_are_refused_with_the_remedy() {
    let unit = [1.0, 1.0];
    let sawtooth = SurfaceProfile::sawtooth(0.2, 30.0, 0.0).unwrap();
    let refused = |map: &HeightMap| found(map, unit).unwrap_err().to_string();
    let of = |heights: Vec<f64>, columns: usize| HeightMap::new(columns, heights);
    let mut random = RandomStream::new(3, Purpose::Surface, 0);
    let noise = of((0..120 * 120).map(|_| random.uniform()).collect(), 120);
    assert!(refused(&noise).contains("not made of parallel ridges"));
    // Two directions at once: a field of pyramids.
    let one = map_of(&sawtooth, 0.0, [150, 150], unit, 0.0);
    let other = map_of(&sawtooth, 90.0, [150, 150], unit, 0.0);
    let both = one.heights.iter().zip(&other.heights).map(|(a, b)| a + b);
    assert!(refused(&of(both.collect(), 150)).contains("not made of parallel ridges"));
    let plane = of((0..400).map(|n| 0.3 * f64::from(n % 20)).collect(), 20);
    assert!(refused(&plane).contains("flat"));
    let few = map_of(&sawtooth, 0.0, [75, 75], unit, 0.0);
    assert!(refused(&few).contains("are needed: measure a wider area"));
    let fine = SurfaceProfile::sawtooth(0.2, 5.0, 0.0).unwrap();
    let coarse = map_of(&fine, 20.0, [100, 100], unit, 0.0);
    let why = refused(&coarse);
    assert!(why.contains("finer pitch"), "{why}");
    let groove = SurfaceProfile::of_corners(&[(0.0, 0.0), (15.0, -3.0)], 30.0);
    let grooves = map_of(&groove, 40.0, [200, 200], unit, 0.01);
    assert!(refused(&grooves).contains("about equally to both sides"));
    let mut hole = map_of(&sawtooth, 0.0, [150, 150], unit, 0.0);
    hole.heights[151] = f64::INFINITY;
    assert!(refused(&hole).contains("row 2, column 2"));
    assert!(refused(&of(vec![0.0; 100], 10)).contains("16 × 16"));
    assert_eq!(found(&one, [0.0, 1.0]), Err(RidgeMapError::Units));
}

#[test]
fn the_lobe_error_covers_the_effects_of_noise_and_samples() {
    let (mut worst, mut beyond, mut all) = (0.0f64, 0, 0);
    for (theta_deg, round) in [(5.0f64, 1.0), (10.0, 2.0), (15.0, 0.0), (15.0, 2.0)] {
        for (azimuth_deg, noise, pitch) in [
            (0.0, 0.05, 1.0),
            (67.0, 0.05, 1.0),
            (67.0, 0.2, 1.0),
            (23.0, 0.05, 1.0),
            (67.0, 0.05, 0.5),
            (67.0, 0.05, 2.0),
        ] {
            let truth = WornRidges {
                round,
                ..WornRidges::ideal(theta_deg.to_radians(), 40.0)
            };
            let truth = truth.profile().unwrap();
            let map = map_of(&truth, azimuth_deg, [300, 260], [pitch; 2], noise);
            let made = RidgeMap::of(&map, units([pitch; 2])).unwrap();
            let case = format!(
                "{theta_deg} {round} {azimuth_deg} {noise} {pitch}: {:?}",
                made.facts
            );
            // Corners at their measured heights would have the noise of the most deviating line: up
            // to 0.3°.
            let theta_r = truth.effective_ridge_angle().unwrap();
            let off = made.facts.theta_r_deg - theta_r.to_degrees();
            assert!(off.abs() < 0.06, "{case}");
            let scaled = made.profile.with_ridge_angle(theta_r).unwrap();
            assert_eq!(scaled.lobe_error(), made.profile.lobe_error());
            let (of_map, of_truth) = (
                scaled.lobe_offsets().unwrap(),
                truth.lobe_offsets().unwrap(),
            );
            for (a, b) in of_map.iter().zip(of_truth) {
                let off = (a - b).to_degrees().abs();
                worst = worst.max(off);
                beyond += usize::from(off > 2.0 * made.facts.lobe_error_deg);
                all += 1;
                assert!(
                    off < 3.5 * made.facts.lobe_error_deg + 0.001,
                    "{off} {case}"
                );
            }
            assert!(made.facts.lobe_error_deg < 0.15, "{case}");
        }
    }
    // One in twenty, and as many again for errors common to all maps of one kind.
    assert!(
        worst < 0.08 && 10 * beyond <= all,
        "{worst} {beyond} of {all}"
    );
}

#[test]
fn strips_with_little_shear_get_no_spurious_lean() {
    let sawtooth = SurfaceProfile::sawtooth(10f64.to_radians(), 100.0, 0.0).unwrap();
    for (azimuth_deg, size, pitch, noise) in [
        (0.0, [512, 32], 1.0, 0.0),
        (0.0, [1280, 64], 1.0, 0.0),
        (0.0, [1280, 64], 0.645, 0.05),
        (180.0, [700, 16], 0.8, 0.1),
        (90.0, [32, 512], 1.0, 0.0),
        (270.0, [48, 900], 0.7, 0.03),
        (0.4, [512, 32], 1.0, 0.02),
        (1.3, [640, 48], 1.0, 0.0),
        (183.0, [600, 24], 1.0, 0.05),
        (88.0, [40, 700], 1.0, 0.1),
    ] {
        let map = map_of(&sawtooth, azimuth_deg, size, [pitch; 2], noise);
        let f = found(&map, [pitch; 2]).unwrap();
        let case = format!("{azimuth_deg} {size:?} {pitch} {noise}: {f:?}");
        assert!((f.theta_r_deg - 10.0).abs() < 0.08, "{case}");
        assert!(
            (f.period_um / sawtooth.period() - 1.0).abs() < 2e-3,
            "{case}"
        );
        let off = (f.lean_azimuth_deg - azimuth_deg + 180.0).rem_euclid(360.0) - 180.0;
        // A third of a sample over the short side.
        let third = 0.33 / size[0].min(size[1]) as f64;
        assert!(off.abs() < third.to_degrees(), "{case}");
        assert!(f.lobe_error_deg < 0.1, "{case}");
    }
}
