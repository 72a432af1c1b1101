//! Frames of one pose → one level. Copies, black frames and outliers are left out by name; exposures are merged by their
//! expected variance.
//!
//! Two rules keep the mean free of bias. A frame with a full pixel in the region is left out as a whole if the pose has another
//! exposure: dropping only the full pixels would drop bright noise and keep dark noise. And the weight of a frame comes from
//! the noise expected at the common level of its pose, never from its own counts.
//!
//! *Conditioning.* Means are weighted with 1/variance: positive weights, over exposures that may differ by 1e12, without
//! cancelling differences. A pose without a usable pixel has no weight and gives no observation.

use std::collections::HashMap;

use super::flats::SAME_ANGLE_DEG;
use super::levels::Level;
use super::measure::Measured;
use super::reduction_log::{ReductionLog, Rejection};
use super::scale::Scale;
use super::sensor::median;
use crate::geometry::{Pose, group_angles, group_directions};
use crate::material::Material;
use crate::robust::MEDIAN_OF_SQUARE;
use crate::series::FrameRow;
use crate::units::Angle;
use crate::wording::counted;

/// Frames of one pose agree within this many standard errors …
const AGREE_SIGMAS: f64 = 6.0;
/// … plus this share of their level, for imperfect shutters and lamps.
const AGREE_SHARE: f64 = 0.02;

/// The level of one segment at one pose.
#[derive(Debug, Clone, Copy, Default)]
pub(super) struct Merged {
    pub(super) n: f64,
    pub(super) rate_dn_s: f64,
    pub(super) variance: f64,
    /// Mean column and row of the pixels, of near rigs.
    pub(super) middle_px: [f64; 2],
    /// Part of the rate's standard uncertainty from the noise of the dark frames, which other poses share.
    pub(super) dark_std_dn_s: f64,
}

/// One pose with its merged levels, by segment.
#[derive(Debug, Clone)]
pub(super) struct PoseLevels {
    pub(super) pose: Pose,
    pub(super) segments: Vec<Merged>,
    /// Places of its frames in the list.
    pub(super) frames: Vec<usize>,
    /// Mean time of its frames (s since 1970), if all have a time.
    pub(super) taken_s: Option<f64>,
}

/// What frames are merged with.
#[derive(Clone, Copy)]
pub(super) struct MergeContext<'a> {
    pub(super) rows: &'a [FrameRow],
    pub(super) material: Material,
    pub(super) scale: &'a Scale,
}

impl MergeContext<'_> {
    /// Variance of a segment's mean rate from counting and read noise at a level `rate_dn_s`, which
    /// is not taken from the frame itself: weights made of noisy counts would favour low ones.
    fn variance_model(&self, level: &Level, rate_dn_s: f64, exposure_s: f64) -> f64 {
        let (dark, sensor) = (self.scale.darks.at(exposure_s), &self.scale.sensor);
        let current = (dark.mean_dn - sensor.black_dn).max(0.0);
        let count = rate_dn_s.max(0.0) * exposure_s;
        let per_pixel = (sensor.variance_dn2(count + current) + dark.variance_dn2)
            * level.inverse_response2.max(1.0)
            + count * count * self.scale.response_variance;
        per_pixel / (level.n.max(1.0) * exposure_s * exposure_s)
    }

    /// Standard uncertainty of a segment's mean rate from the dark frames' noise: the same in every frame of an exposure.
    fn dark_std(&self, level: &Level, exposure_s: f64) -> f64 {
        let variance_dn2 = self.scale.darks.at(exposure_s).variance_dn2;
        let per_pixel = variance_dn2 * level.inverse_response2.max(1.0);
        (per_pixel / level.n.max(1.0)).sqrt() / exposure_s
    }
}

struct Group {
    pose: Pose,
    clean: Vec<Measured>,
    clipped: Vec<Measured>,
}

/// Merges all measured frames by pose. Returns the levels and the lamp's relative scatter from frame to frame.
pub(super) fn merge(
    context: &MergeContext<'_>,
    measured: Vec<Measured>,
    log: &mut ReductionLog,
) -> (Vec<PoseLevels>, f64) {
    let measured = without_copies(context, measured, log);
    let mut groups = by_pose(context, measured);
    let mut undecided = Vec::new();
    for (at, group) in groups.iter_mut().enumerate() {
        rescue(group, log);
        if !drop_outliers(context, group, log) {
            undecided.push(at);
        }
    }
    let mut lost: Vec<Pose> = Vec::new();
    for at in &undecided {
        let due = interpolated(&groups, &undecided, *at);
        if !decide(context, &mut groups[*at], due, log) {
            lost.push(groups[*at].pose);
        }
    }
    warn_of_contradictions(&lost, log);
    drop_black_poses(context, &mut groups, log);
    let scatter = lamp_scatter(context, &groups, log);
    let levels = groups
        .iter()
        .filter(|g| !g.clean.is_empty())
        .map(|g| merged(context, g, scatter))
        .collect();
    (levels, scatter)
}

/// Leaves out all but one of the frames with the same counts. The frame that agrees with the others of its pose stays, or the
/// earliest.
fn without_copies(
    context: &MergeContext<'_>,
    mut measured: Vec<Measured>,
    log: &mut ReductionLog,
) -> Vec<Measured> {
    let rows = context.rows;
    let mut sets: HashMap<u64, Vec<usize>> = HashMap::new();
    // A few pixels may count the same by chance.
    for (at, m) in measured.iter().enumerate().filter(|(_, m)| m.pixels > 8) {
        sets.entry(m.fingerprint).or_default().push(at);
    }
    let mut out = Vec::new();
    for set in sets.values().filter(|s| s.len() > 1) {
        let misfit = |at: usize| {
            let own = &measured[at];
            let pose = rows[own.index].pose();
            measured
                .iter()
                .filter(|m| {
                    m.fingerprint != own.fingerprint
                        && m.is_clean()
                        && same_pose(rows[m.index].pose(), pose)
                })
                .map(|m| (own.mean_rate() / m.mean_rate() - 1.0).abs())
                .fold(None, |worst: Option<f64>, x| {
                    Some(worst.map_or(x, |w| w.max(x)))
                })
                // Without another frame of the pose: neutral.
                .unwrap_or(AGREE_SHARE)
        };
        let mut order = set.clone();
        order.sort_by(|a, b| {
            let key = |at: usize| {
                let row = &rows[measured[at].index];
                (&row.timestamp, &row.file)
            };
            let off = |at: usize| if misfit(at) > 2.0 * AGREE_SHARE { 1 } else { 0 };
            off(*a).cmp(&off(*b)).then_with(|| key(*a).cmp(&key(*b)))
        });
        let original = &rows[measured[order[0]].index].file;
        for at in &order[1..] {
            log.reject(
                measured[*at].index,
                Rejection::new("duplicate", format!("it has the same counts as {original}")),
            );
            out.push(measured[*at].index);
        }
    }
    measured.retain(|m| !out.contains(&m.index));
    measured
}

fn same_pose(a: Pose, b: Pose) -> bool {
    (a.theta_c - b.theta_c).deg().abs() <= SAME_ANGLE_DEG
        && (a.phi_s - b.phi_s).deg().abs() <= SAME_ANGLE_DEG
}

fn by_pose(context: &MergeContext<'_>, measured: Vec<Measured>) -> Vec<Group> {
    let rows = context.rows;
    let poses: Vec<Pose> = measured.iter().map(|m| rows[m.index].pose()).collect();
    let of = |axis: fn(&Pose) -> Angle| poses.iter().map(axis).collect::<Vec<_>>();
    let within = Angle::from_deg(SAME_ANGLE_DEG);
    let tilts = group_angles(&of(|pose| pose.theta_c), within);
    let turns = group_directions(&of(|pose| pose.phi_s), within);
    let places = tilts.into_iter().zip(turns);
    let mut placed: Vec<((usize, usize), Measured)> = places.zip(measured).collect();
    placed.sort_by(|(place_a, a), (place_b, b)| {
        place_a
            .cmp(place_b)
            .then(a.exposure_s.total_cmp(&b.exposure_s))
            .then_with(|| rows[a.index].file.cmp(&rows[b.index].file))
    });
    let mut groups: Vec<Group> = Vec::new();
    let mut last = None;
    for (place, m) in placed {
        if last.replace(place) != Some(place) {
            groups.push(Group {
                pose: rows[m.index].pose(),
                clean: Vec::new(),
                clipped: Vec::new(),
            });
        }
        let group = groups.last_mut().expect("one was pushed just now");
        if m.is_clean() {
            group.clean.push(m);
        } else {
            group.clipped.push(m);
        }
    }
    groups
}

/// Returns the mean of poses that are nearly equal.
fn mean_pose(mut poses: impl Iterator<Item = Pose>) -> Pose {
    let first = poses.next().expect("a group has a member");
    let (mut n, mut tilt, mut turn) = (1.0, 0.0, 0.0);
    for pose in poses {
        n += 1.0;
        tilt += (pose.theta_c - first.theta_c).rad();
        turn += (pose.phi_s - first.phi_s).wrapped().rad();
    }
    Pose {
        theta_c: first.theta_c + Angle::from_rad(tilt / n),
        phi_s: first.phi_s + Angle::from_rad(turn / n),
    }
}

/// Leaves out the clipped frames. If a pose has no other, its shortest exposure is measured on the pixels that are expected
/// below full count.
fn rescue(group: &mut Group, log: &mut ReductionLog) {
    let clipped = std::mem::take(&mut group.clipped);
    for m in clipped {
        if group.clean.is_empty()
            && let Some(part) = &m.below_full
        {
            log.warn(
                "at some poses even the shortest exposure has full pixels: these poses are measured on the other pixels; add a shorter exposure".to_owned(),
            );
            group.clean.push((**part).clone());
            continue;
        }
        log.reject(
            m.index,
            Rejection::new(
                "partly saturated",
                format!("{} of {} pixels are full", m.full, m.pixels),
            ),
        );
    }
}

/// Returns the mean rate of a frame and its expected variance at the level `at_rate`.
fn rate_and_variance(context: &MergeContext<'_>, m: &Measured, at_rate: f64) -> (f64, f64) {
    let total: f64 = m.levels.iter().map(|l| l.n).sum();
    let variance = m
        .levels
        .iter()
        .map(|l| {
            (l.n / total.max(1.0)).powi(2)
                * context
                    .variance_model(l, at_rate, m.exposure_s)
                    .max(l.variance_pixels)
        })
        .sum::<f64>();
    (m.mean_rate(), variance)
}

fn agree(a: (f64, f64), b: (f64, f64)) -> bool {
    (a.0 - b.0).abs() <= AGREE_SIGMAS * (a.1 + b.1).sqrt() + AGREE_SHARE * a.0.abs().max(b.0.abs())
}

/// Leaves out frames that most others of the pose contradict. Returns `false` without a majority.
fn drop_outliers(context: &MergeContext<'_>, group: &mut Group, log: &mut ReductionLog) -> bool {
    if group.clean.len() < 2 {
        return true;
    }
    let mut rates: Vec<f64> = group.clean.iter().map(Measured::mean_rate).collect();
    let usual = median(&mut rates);
    let seen: Vec<(f64, f64)> = group
        .clean
        .iter()
        .map(|m| rate_and_variance(context, m, usual))
        .collect();
    let friends = |i: usize| seen.iter().filter(|other| agree(seen[i], **other)).count();
    let most = (0..seen.len()).map(friends).max().unwrap_or(0);
    if most == seen.len() {
        return true;
    }
    if most * 2 <= seen.len() {
        return false;
    }
    let leader = (0..seen.len())
        .find(|i| friends(*i) == most)
        .expect("one of them has the most");
    let keep: Vec<bool> = seen.iter().map(|s| agree(*s, seen[leader])).collect();
    let level = seen[leader].0;
    part_with(
        group,
        &keep,
        &seen,
        level,
        "the other exposures of its pose",
        log,
    );
    true
}

fn part_with(
    group: &mut Group,
    keep: &[bool],
    seen: &[(f64, f64)],
    level: f64,
    whom: &str,
    log: &mut ReductionLog,
) {
    for ((m, keep), (rate, variance)) in group.clean.iter().zip(keep).zip(seen) {
        if *keep {
            continue;
        }
        let dark = rate.abs() <= AGREE_SIGMAS * variance.sqrt() + 0.01 * level.abs();
        log.reject(
            m.index,
            if dark {
                black(whom)
            } else {
                Rejection::new(
                    "level",
                    format!("{:+.1} % off {whom}", (rate / level - 1.0) * 100.0),
                )
            },
        );
    }
    let mut keep = keep.iter();
    group.clean.retain(|_| *keep.next().expect("one flag each"));
}

/// The rejection of a frame without light, or with a wrong exposure time.
fn black(whom: &str) -> Rejection {
    Rejection::new(
        "black",
        format!(
            "it shows almost no light for its exposure time, but {whom} do: check lamp, cap and exposure_s"
        ),
    )
}

/// Returns the level interpolated linearly between the neighbours in φs at the same tilt.
fn interpolated(groups: &[Group], undecided: &[usize], at: usize) -> Option<f64> {
    let here = groups[at].pose;
    let level = |g: &Group| g.clean.first().map(Measured::mean_rate);
    let mut around: Vec<(f64, f64)> = groups
        .iter()
        .enumerate()
        .filter(|(i, g)| {
            *i != at
                && !undecided.contains(i)
                && (g.pose.theta_c - here.theta_c).deg().abs() <= 4.0 * SAME_ANGLE_DEG
        })
        .filter_map(|(_, g)| Some(((g.pose.phi_s - here.phi_s).wrapped().deg(), level(g)?)))
        .collect();
    around.sort_by(|a, b| a.0.total_cmp(&b.0));
    let above = around.iter().find(|(d, _)| *d > 0.0);
    let below = around.iter().rev().find(|(d, _)| *d < 0.0);
    match (below, above) {
        (Some((db, b)), Some((da, a))) => Some(b + (a - b) * (-db) / (da - db)),
        _ => None,
    }
}

/// Warns once of the poses at which it is undecided which exposure is right.
fn warn_of_contradictions(lost: &[Pose], log: &mut ReductionLog) {
    const SHOWN: usize = 8;
    let place = |pose: &Pose| format!("θc {}, φs {}", pose.theta_c, pose.phi_s);
    match lost {
        [] => {}
        [pose] => log.warn(format!(
            "the exposures at {} contradict each other and it is undecided which is right: the pose is left out",
            place(pose)
        )),
        poses => {
            let shown: Vec<String> = poses.iter().take(SHOWN).map(place).collect();
            let more = if poses.len() > SHOWN { "; …" } else { "" };
            log.warn(format!(
                "the exposures at {} contradict each other and it is undecided which is right: these poses are left out ({}{more}); \
                 check shutter, lamp and the camera's settings",
                counted(poses.len(), "pose"),
                shown.join("; ")
            ));
        }
    }
}

/// Decides between frames of a pose that contradict each other without a majority, by the neighbouring poses. If these do not
/// decide, all frames are left out; returns `false`.
fn decide(
    context: &MergeContext<'_>,
    group: &mut Group,
    due: Option<f64>,
    log: &mut ReductionLog,
) -> bool {
    let usual = due.unwrap_or(0.0);
    let seen: Vec<(f64, f64)> = group
        .clean
        .iter()
        .map(|m| rate_and_variance(context, m, usual))
        .collect();
    let far = |rate: f64| match due {
        Some(due) if due > 0.0 => (rate.max(1e-3 * due) / due).ln().abs(),
        _ => f64::INFINITY,
    };
    let nearest = (0..seen.len())
        .min_by(|a, b| far(seen[*a].0).total_cmp(&far(seen[*b].0)))
        .expect("an undecided pose has frames");
    let keep: Vec<bool> = seen.iter().map(|s| agree(*s, seen[nearest])).collect();
    let others = seen
        .iter()
        .zip(&keep)
        .filter(|(_, keep)| !**keep)
        .map(|(s, _)| far(s.0))
        .fold(f64::INFINITY, f64::min);
    let near = far(seen[nearest].0);
    // Within a factor of 1.5 of its neighbours, and the others three times further off.
    let clear = near < 1.5_f64.ln() && others > 3.0 * near;
    let keep = match clear {
        true => keep,
        false => vec![false; seen.len()],
    };
    let level = seen[nearest].0;
    part_with(
        group,
        &keep,
        &seen,
        level,
        "its pose and the neighbouring ones",
        log,
    );
    clear
}

/// Leaves out poses without light among bright ones: the lamp was off, or the lens was capped.
fn drop_black_poses(context: &MergeContext<'_>, groups: &mut [Group], log: &mut ReductionLog) {
    let levels: Vec<Option<(f64, f64)>> = groups
        .iter()
        .map(|g| {
            let m = g.clean.last()?;
            let (rate, variance) = rate_and_variance(context, m, 0.0);
            Some((rate, variance.sqrt()))
        })
        .collect();
    if let Some(text) = bright_darks(levels.iter().flatten()) {
        log.warn(text);
    }
    let metal = matches!(context.material, Material::Conductor { .. });
    let mut sorted: Vec<f64> = levels.iter().flatten().map(|l| l.0).collect();
    if sorted.len() < 4 {
        return;
    }
    sorted.sort_unstable_by(f64::total_cmp);
    let low = sorted[(sorted.len() / 20 + 1).min(sorted.len() - 1)];
    for at in 0..groups.len() {
        let Some((rate, sigma)) = levels[at] else {
            continue;
        };
        let nothing = rate.abs() <= (AGREE_SIGMAS * sigma).max(0.02 * low);
        if !nothing || low <= 50.0 * sigma {
            continue;
        }
        if metal {
            log.warn(format!(
                "θc {}, φs {} shows almost no light for its exposure time, but the other poses do; a metal may be dark, so it \
                 counts: check lamp, cap and exposure_s if it is unexpected",
                groups[at].pose.theta_c, groups[at].pose.phi_s
            ));
            continue;
        }
        for m in groups[at].clean.drain(..) {
            log.reject(m.index, black("the other poses"));
        }
    }
}

/// Names dark frames that are brighter than most poses, from rate and standard uncertainty of each.
fn bright_darks<'l>(levels: impl Iterator<Item = &'l (f64, f64)> + Clone) -> Option<String> {
    let below = levels
        .clone()
        .filter(|(rate, std)| *rate < -AGREE_SIGMAS * std);
    let (below, all) = (below.count(), levels.count());
    (2 * below > all).then(|| {
        format!(
            "the dark frames are brighter than {below} of {all} poses: light reached the sensor, or dark and sample frames are \
             swapped; take dark frames with the lens capped"
        )
    })
}

/// Returns the relative scatter of the level between frames of one pose beyond counting noise.
fn lamp_scatter(context: &MergeContext<'_>, groups: &[Group], log: &mut ReductionLog) -> f64 {
    let mut squares = Vec::new();
    let mut noise = Vec::new();
    let mut ratios: HashMap<(u64, u64), Vec<(f64, f64)>> = HashMap::new();
    for group in groups {
        for pair in group.clean.windows(2) {
            let level = pair[1].mean_rate();
            let a = rate_and_variance(context, &pair[0], level);
            let b = rate_and_variance(context, &pair[1], level);
            let variance = (a.1 + b.1) / (level * level);
            if level > 0.0 && variance < 1e-6 {
                let ratio = a.0 / b.0 - 1.0;
                squares.push(ratio * ratio / MEDIAN_OF_SQUARE);
                noise.push(variance);
                ratios
                    .entry((pair[0].exposure_s.to_bits(), pair[1].exposure_s.to_bits()))
                    .or_default()
                    .push((ratio, variance));
            }
        }
    }
    let mut keys: Vec<_> = ratios.keys().copied().collect();
    keys.sort_unstable();
    for key in keys {
        let pairs = &ratios[&key];
        let mut values: Vec<f64> = pairs.iter().map(|p| p.0).collect();
        let middle = median(&mut values);
        let error = (pairs.iter().map(|p| p.1).sum::<f64>()).sqrt() / pairs.len() as f64;
        if pairs.len() >= 5 && middle.abs() > 0.003 && middle.abs() > 5.0 * error {
            log.warn(format!(
                "exposures of {} s and {} s disagree by {:+.2} %: check the shutter's timing and the camera's linearity",
                f64::from_bits(key.0),
                f64::from_bits(key.1),
                middle * 100.0
            ));
        }
    }
    if squares.len() < 5 {
        return 0.0;
    }
    // Squares over the median of χ² with one degree of freedom: their median is the variance.
    let seen = median(&mut squares);
    let counting = median(&mut noise);
    if seen > 2.0 * counting {
        (0.5 * (seen - counting)).sqrt()
    } else {
        0.0
    }
}

fn merged(context: &MergeContext<'_>, group: &Group, lamp_scatter: f64) -> PoseLevels {
    let frames = &group.clean;
    let segments = frames[0].levels.len();
    let rows = context.rows;
    let pose = mean_pose(frames.iter().map(|m| rows[m.index].pose()));
    let segments = (0..segments)
        .map(|s| {
            let time: f64 = frames.iter().map(|m| m.exposure_s).sum();
            let common = frames
                .iter()
                .map(|m| m.levels[s].rate_dn_s * m.exposure_s)
                .sum::<f64>()
                / time;
            let (mut weight, mut rate, mut own, mut texture) = (0.0, 0.0, 0.0, 0.0);
            let mut dark = 0.0;
            for m in frames.iter().filter(|m| m.levels[s].n > 0.0) {
                let level = &m.levels[s];
                let model = context.variance_model(level, common, m.exposure_s);
                let w = 1.0 / model;
                weight += w;
                rate += w * level.rate_dn_s;
                own += w * w * model.max(level.variance_pixels);
                texture += w * level.variance_texture;
                dark += w * context.dark_std(level, m.exposure_s);
            }
            if weight <= 0.0 {
                return Merged::default();
            }
            let rate = rate / weight;
            Merged {
                n: frames[0].levels[s].n,
                middle_px: frames[0].levels[s].middle_px,
                dark_std_dn_s: dark / weight,
                rate_dn_s: rate,
                variance: own / (weight * weight)
                    + texture / weight
                    + (lamp_scatter * rate).powi(2) / frames.len() as f64,
            }
        })
        .collect();
    PoseLevels {
        pose,
        segments,
        frames: frames.iter().map(|m| m.index).collect(),
        taken_s: mean_time(frames.iter().map(|m| &rows[m.index])),
    }
}

/// Returns the mean time of frames (s since 1970); `None` if one has no time, or without frames.
pub(super) fn mean_time<'r>(frames: impl Iterator<Item = &'r FrameRow>) -> Option<f64> {
    let times: Vec<f64> = frames.map(FrameRow::taken_s).collect::<Option<_>>()?;
    (!times.is_empty()).then(|| times.iter().sum::<f64>() / times.len() as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn dark_frames_that_are_brighter_than_most_poses_are_named() {
        let dim = [(-5.0, 0.1), (-2.0, 0.1), (-1.0, 0.1), (4.0, 0.1)];
        let text = bright_darks(dim.iter()).unwrap();
        assert!(text.contains("brighter than 3 of 4 poses"), "{text}");
        // Noise below zero, and a half of the poses, say nothing.
        assert_eq!(bright_darks([(-0.3, 0.1); 4].iter()), None);
        assert_eq!(bright_darks(dim[1..].iter().chain(&dim[3..])), None);
        assert_eq!(bright_darks([].iter()), None);
    }
}
