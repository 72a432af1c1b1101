//! A fault that a single visit does not show: a series that saturates the camera.
//!
//! [`FrameHistory::fault`] checks a visit against the visits passed to [`FrameHistory::remember`]. A series is too bright by
//! which of its poses are full, not by how many full ones came in a row: the order of the visits depends on where the stages
//! were. [`FrameHistory::undecided`] names the pose that decides it soonest.

use std::collections::BTreeSet;

use super::frame_rules::FrameRules;
use super::plan::{Shot, Step};
use super::recorder::{Rejected, Visit};
use crate::frame::{Frame, FrameKind};

/// Full poses without any other before the poses furthest apart are visited: a lobe fills a few.
const SUSPICIOUS: usize = 3;

/// What the visits of a scan showed so far.
#[derive(Debug, Default)]
pub(super) struct FrameHistory {
    /// Poses of the sample in the plan.
    poses: usize,
    /// The poses furthest apart: no lobe fills all of them.
    apart: Vec<u32>,
    /// Accepted poses that are full, and the number of accepted poses that are not; both with those of earlier runs.
    full: BTreeSet<u32>,
    not_full: usize,
}

/// What the history keeps of a visit.
#[derive(Debug)]
pub(super) struct FrameSummary {
    index: u32,
    kind: FrameKind,
    /// Whether most pixels of the shortest exposure are full.
    full: bool,
}

impl FrameSummary {
    pub fn at(visit: &Visit, rules: &FrameRules) -> FrameSummary {
        let full = |frame: &Frame| share(frame, |dn| dn >= rules.saturation_dn);
        let shortest = visit
            .frames
            .iter()
            .min_by(|a, b| a.exposure_s.total_cmp(&b.exposure_s));
        FrameSummary {
            index: visit.shot.index,
            kind: visit.shot.kind,
            full: shortest.is_some_and(|taken| full(&taken.captured.frame) > 0.5),
        }
    }
}

impl FrameHistory {
    /// Makes an empty history for a plan.
    pub fn of(steps: &[Step]) -> FrameHistory {
        let shots = || steps.iter().filter_map(sample_of);
        FrameHistory {
            poses: shots().count(),
            apart: furthest_apart(shots()),
            ..FrameHistory::default()
        }
    }

    /// Restores the history of a resumed scan from its accepted points, and those of them that are full.
    pub fn after(
        mut self,
        steps: &[Step],
        done: &BTreeSet<u32>,
        full: &BTreeSet<u32>,
    ) -> FrameHistory {
        let shots = steps.iter().filter_map(sample_of);
        for shot in shots.filter(|shot| done.contains(&shot.index)) {
            self.count(shot.index, full.contains(&shot.index));
        }
        self
    }

    fn count(&mut self, index: u32, full: bool) {
        match full {
            true => drop(self.full.insert(index)),
            false => self.not_full += 1,
        }
    }

    /// Returns what is wrong with a visit, given the earlier ones.
    pub fn fault(&self, summary: &FrameSummary, rules: &FrameRules) -> Option<Rejected> {
        if summary.kind == FrameKind::Dark || !summary.full {
            return None;
        }
        if summary.kind == FrameKind::Flat {
            return Some(Rejected::Otherwise(FULL_FLAT.into()));
        }
        let full = |index: &u32| *index == summary.index || self.full.contains(index);
        let poses = self.full.len() + usize::from(!self.full.contains(&summary.index));
        let too_bright = 2 * poses > self.poses || self.apart.iter().all(full);
        (too_bright && !rules.confirmed.full_sample).then_some(Rejected::FullSample {
            poses,
            of: self.poses,
        })
    }

    /// Returns the pose to visit next, out of turn, where all poses so far were full: it distinguishes a lobe from a series
    /// that is too bright.
    pub fn undecided(&self, rules: &FrameRules) -> Option<u32> {
        let suspicious = self.not_full == 0 && self.full.len() >= SUSPICIOUS;
        if !suspicious || rules.confirmed.full_sample {
            return None;
        }
        let mut apart = self.apart.iter();
        apart.find(|index| !self.full.contains(index)).copied()
    }

    /// Adds an accepted visit.
    pub fn remember(&mut self, summary: &FrameSummary) {
        if summary.kind == FrameKind::Sample {
            self.count(summary.index, summary.full);
        }
    }
}

const FULL_FLAT: &str = "full: most pixels of the white reference are full in the shortest exposure; check lamp and \
     camera, or plan shorter exposures";

fn sample_of(step: &Step) -> Option<&Shot> {
    match step {
        Step::Shot(shot) if shot.kind == FrameKind::Sample => Some(shot),
        Step::Shot(_) | Step::Operator(_) => None,
    }
}

/// Returns the poses at both ends and in the middle of the tilts, each at azimuths a quarter of the list apart. A lobe may
/// fill all azimuths of a tilt or all tilts of an azimuth, but not both.
fn furthest_apart<'a>(shots: impl Iterator<Item = &'a Shot>) -> Vec<u32> {
    let poses: Vec<(u32, f64, f64)> = shots
        .filter_map(|shot| {
            let pose = shot.pose?;
            Some((shot.index, pose.theta_c.deg(), pose.phi_s.deg()))
        })
        .collect();
    let values = |of: fn(&(u32, f64, f64)) -> f64| {
        let mut all: Vec<f64> = poses.iter().map(of).collect();
        all.sort_by(f64::total_cmp);
        all.dedup();
        all
    };
    let (tilts, azimuths) = (values(|p| p.1), values(|p| p.2));
    let at = |all: &[f64], places: &[usize]| -> Vec<f64> {
        places.iter().filter_map(|i| all.get(*i).copied()).collect()
    };
    let (n, last) = (azimuths.len(), tilts.len().saturating_sub(1));
    let tilts = at(&tilts, &[0, last, last / 2]);
    let azimuths = at(&azimuths, &[0, n / 2, n / 4, 3 * n / 4]);
    let mut apart: Vec<u32> = Vec::new();
    for phi in &azimuths {
        for theta in &tilts {
            let there = poses.iter().find(|p| p.1 == *theta && p.2 == *phi);
            if let Some((index, ..)) = there
                && !apart.contains(index)
            {
                apart.push(*index);
            }
        }
    }
    apart
}

fn share(frame: &Frame, is: impl Fn(u16) -> bool) -> f64 {
    let pixels = frame.pixels_dn();
    pixels.iter().filter(|dn| is(**dn)).count() as f64 / pixels.len() as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::Pose;
    use crate::scan::frame_rules::tests::{rules, taken};

    fn flat(frames: &[(u16, f64)]) -> FrameSummary {
        let pose = Pose::from_deg(0.0, 0.0);
        let visit = Visit {
            shot: Shot {
                index: 0,
                kind: FrameKind::Flat,
                pose: Some(pose),
                target: Some(pose),
                exposures_s: Vec::new(),
                repeats: 1,
            },
            attempt: 0,
            pose,
            frames: frames.iter().map(|(dn, s)| taken(*dn, *s)).collect(),
            rejected: None,
            discarded: None,
            taken_at: time::macros::datetime!(2026-01-01 00:00 UTC),
        };
        FrameSummary::at(&visit, &rules())
    }

    /// A plan of tilts and azimuths 10° and 30° apart.
    fn plan(tilts: u32, azimuths: u32) -> Vec<Step> {
        let pose = |index: u32| {
            let (theta, phi) = (index / azimuths, index % azimuths);
            Pose::from_deg(10.0 * f64::from(theta), 30.0 * f64::from(phi))
        };
        let shot = |index| Shot {
            index,
            kind: FrameKind::Sample,
            pose: Some(pose(index)),
            target: Some(pose(index)),
            exposures_s: vec![0.01],
            repeats: 1,
        };
        (0..tilts * azimuths)
            .map(|index| Step::Shot(shot(index)))
            .collect()
    }

    fn visited(index: u32, full: bool) -> FrameSummary {
        FrameSummary {
            index,
            kind: FrameKind::Sample,
            full,
        }
    }

    /// Returns after how many visits in this order a scan is called too bright.
    fn verdict(plan: &[Step], order: &[u32], is_full: impl Fn(u32) -> bool) -> Option<usize> {
        let rules = rules();
        let mut seen = FrameHistory::of(plan);
        let mut left: Vec<u32> = order.to_vec();
        let mut visits = 0;
        while !left.is_empty() {
            let next = seen.undecided(&rules).unwrap_or(left[0]);
            left.retain(|index| *index != next);
            visits += 1;
            let summary = visited(next, is_full(next));
            if let Some(fault) = seen.fault(&summary, &rules) {
                assert!(matches!(fault, Rejected::FullSample { .. }), "{fault}");
                return Some(visits);
            }
            seen.remember(&summary);
        }
        None
    }

    /// Orders of visits: from either end, either axis outside, and by leaps.
    fn orders(tilts: u32, azimuths: u32) -> Vec<Vec<u32>> {
        let n = tilts * azimuths;
        let there: Vec<u32> = (0..n).collect();
        let back: Vec<u32> = (0..n).rev().collect();
        let across: Vec<u32> = (0..n).map(|i| (i % tilts) * azimuths + i / tilts).collect();
        let leap = (2..n).find(|k| {
            (1..=*k)
                .filter(|d| k.is_multiple_of(*d) && n.is_multiple_of(*d))
                .count()
                == 1
        });
        let leap = leap.unwrap_or(1);
        let leaps: Vec<u32> = (0..n).map(|i| i * leap % n).collect();
        vec![there, back, across, leaps]
    }

    #[test]
    fn the_verdict_on_brightness_does_not_depend_on_the_first_pose() {
        for (tilts, azimuths) in [(5, 3), (9, 12), (1, 9), (4, 1), (1, 1), (1, 2)] {
            let plan = plan(tilts, azimuths);
            let all = |is_full: &dyn Fn(u32) -> bool| -> Vec<Option<usize>> {
                let orders = orders(tilts, azimuths);
                orders
                    .iter()
                    .map(|order| verdict(&plan, order, is_full))
                    .collect()
            };
            let bright = all(&|_| true);
            let most = SUSPICIOUS + 12;
            assert!(
                bright.iter().all(|v| v.is_some_and(|n| n <= most)),
                "{bright:?}"
            );
            assert!(all(&|_| false).iter().all(Option::is_none));
            // Poses full by chance: found in all orders, or in none.
            for seed in 0..200u32 {
                let is_full = |index: u32| {
                    let mixed = (index + 1)
                        .wrapping_mul(2_654_435_761)
                        .wrapping_add(seed * 97);
                    mixed.wrapping_mul(2_246_822_519) >> 30 <= seed % 4
                };
                let found = all(&is_full);
                let agree = found.iter().all(|v| v.is_some() == found[0].is_some());
                assert!(agree, "{tilts} × {azimuths}, {seed}: {found:?}");
            }
        }
    }

    #[test]
    fn a_lobe_may_fill_the_camera_wherever_a_scan_starts() {
        let (tilts, azimuths) = (9, 12);
        let plan = plan(tilts, azimuths);
        // Two tilts at all azimuths, and three azimuths at all tilts.
        let tilt = |index: u32| index / azimuths < 2;
        let azimuth = |index: u32| index % azimuths < 3;
        for order in orders(tilts, azimuths) {
            assert_eq!(verdict(&plan, &order, tilt), None);
            assert_eq!(verdict(&plan, &order, azimuth), None);
        }
    }

    #[test]
    fn a_resumed_scan_knows_its_full_poses() {
        let plan = plan(5, 3);
        let (done, full) = (BTreeSet::from([0, 1, 2, 3]), BTreeSet::from([1, 2, 3]));
        let none = BTreeSet::new();
        let again = |full| FrameHistory::of(&plan).after(&plan, &done, full);
        // One was not full: no pose is visited out of turn.
        assert_eq!(again(&full).undecided(&rules()), None);
        assert!(again(&done).undecided(&rules()).is_some());
        assert_eq!(again(&none).undecided(&rules()), None);
        let mut seen = again(&full);
        for index in 4..8 {
            let summary = visited(index, true);
            assert_eq!(seen.fault(&summary, &rules()), None, "{index}");
            seen.remember(&summary);
        }
        let fault = seen.fault(&visited(8, true), &rules());
        assert_eq!(fault, Some(Rejected::FullSample { poses: 8, of: 15 }));
        let mut confirmed = rules();
        confirmed
            .confirmed
            .note(&Rejected::FullSample { poses: 8, of: 15 });
        assert_eq!(seen.fault(&visited(8, true), &confirmed), None);
    }

    #[test]
    fn a_full_white_reference_is_rejected() {
        let white = flat(&[(4095, 0.01)]);
        let words = FrameHistory::of(&plan(3, 3))
            .fault(&white, &rules())
            .unwrap()
            .to_string();
        assert!(words.starts_with("full"), "{words}");
        // The longer exposure may be.
        let white = flat(&[(900, 0.01), (4095, 0.1)]);
        assert_eq!(FrameHistory::of(&plan(3, 3)).fault(&white, &rules()), None);
    }
}
