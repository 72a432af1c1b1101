//! Sampled pixels with like signals, and the mean of each such cluster as observations of a fit.
//!
//! A cluster is found by its signals, pose by pose, before any surface is known: the noise of its mean is small, so the fit of
//! the mean separates a surface from its rival where a single pixel does not.

use super::globals::Given;
use crate::geometry::Pose;
use crate::map::run::Batch;
use crate::map::signals::view::View;
use crate::observation::{Observation, ObservationSet, SharedErrors, View as Directed};

/// Differences from the mean that count as those of one surface, as a share of the signal and of a tenth of the peak: those
/// of a quarter of a degree of ridge angle in a usual lobe. The mean of a wider cluster has a wider lobe.
const ALIKE: f64 = 0.07;
/// Floor of that share, as a part of the peak.
const FLOOR: f64 = 0.1;
/// Mean square of the differences, in units of their noise and of [`ALIKE`], beyond which a pixel is in another cluster: 3.5
/// standard deviations of the mean of 24 squares.
const APART: f64 = 2.0;
/// Largest number of clusters, so that the time for unlike pixels has a limit.
const CLUSTERS_MAX: usize = 64;
/// Least number of observations in which a pixel is compared.
const COMMON_MIN: usize = 5;
/// Members over whose directions the mean of a near field averages.
const VIEWS: usize = 9;
/// Poses closer than this, in degrees, are the same pose.
const SAME_POSE_DEG: f64 = 0.05;

/// Pixels with like signals.
pub(in crate::map) struct Cluster {
    /// Members, by their index in the batch.
    pub(in crate::map) members: Vec<usize>,
    /// Sums over the members per observation: number, signals, squared standard uncertainties.
    sums: Vec<[f64; 3]>,
}

impl Cluster {
    fn new(observations: usize) -> Self {
        Cluster {
            members: Vec::new(),
            sums: vec![[0.0; 3]; observations],
        }
    }

    fn add(&mut self, batch: &Batch, index: usize) {
        self.members.push(index);
        for (sum, (signal, sigma)) in self.sums.iter_mut().zip(batch.observed(index)) {
            if sigma > 0.0 {
                *sum = [sum[0] + 1.0, sum[1] + signal, sum[2] + sigma * sigma];
            }
        }
    }

    /// Returns the mean signal of an observation, with the usual standard uncertainty of a member; `None` if all are masked.
    pub(in crate::map) fn mean(&self, j: usize) -> Option<(f64, f64)> {
        let [count, signals, squares] = self.sums[j];
        (count > 0.0).then(|| (signals / count, (squares / count).sqrt()))
    }

    /// Returns the brightest mean.
    fn peak(&self) -> f64 {
        let means = (0..self.sums.len()).filter_map(|j| self.mean(j));
        means.fold(f64::MIN_POSITIVE, |most, (mean, _)| most.max(mean))
    }

    /// Returns the mean square difference of a pixel from this cluster; infinite if too few observations are common.
    fn apart(&self, peak: f64, batch: &Batch, index: usize) -> f64 {
        let (mut sum, mut common) = (0.0, 0);
        for (of_cluster, (signal, sigma)) in self.sums.iter().zip(batch.observed(index)) {
            let [count, signals, squares] = *of_cluster;
            if sigma > 0.0 && count > 0.0 {
                let mean = signals / count;
                let alike = ALIKE * (mean.abs() + FLOOR * peak);
                let noise2 = sigma * sigma + squares / (count * count);
                sum += (signal - mean).powi(2) / (noise2 + alike * alike);
                common += 1;
            }
        }
        match common < COMMON_MIN {
            true => f64::INFINITY,
            false => sum / common as f64,
        }
    }

    /// Returns the mean as observations at the poses of `like`, with its references and shared errors, in units of the second
    /// result.
    pub(in crate::map) fn observed(
        &self,
        batch: &Batch,
        view: &View,
        given: &Given<'_>,
        like: &ObservationSet,
    ) -> (ObservationSet, f64) {
        // Without a white reference the brightest signal is 1, as in a reduction.
        let unit = match like.white_reference {
            Some(_) => 1.0,
            None => self.peak(),
        };
        let mut set = ObservationSet {
            observations: Vec::new(),
            views: Vec::new(),
            field: None,
            region: None,
            region_azimuth: crate::units::Angle::ZERO,
            ..like.clone()
        };
        for observation in &like.observations {
            let pose = observation.pose;
            let place = given.recorded.iter().position(|p| is_same(*p, pose));
            let Some((j, (mean, sigma))) = place.and_then(|j| Some((j, self.mean(j)?))) else {
                continue;
            };
            let signal = mean / unit;
            let share = signal / observation.signal;
            let of = |error: f64| {
                if share.is_finite() {
                    error * share
                } else {
                    0.0
                }
            };
            set.observations.push(Observation {
                signal,
                sigma: sigma / self.sums[j][0].sqrt() / unit,
                shared: SharedErrors {
                    white_reference: of(observation.shared.white_reference),
                    led_drift: of(observation.shared.led_drift),
                    detector: of(observation.shared.detector),
                    ..observation.shared
                },
                ..*observation
            });
            if !view.is_telecentric() {
                let step = self.members.len().div_ceil(VIEWS);
                let seen = self.members.iter().step_by(step);
                let count = seen.len() as f64;
                let directed = seen.map(|member| {
                    let (directions, light) = view.seen(pose, view.place_mm(batch.pixels[*member]));
                    Directed::from((directions, light / count))
                });
                set.views.push(directed.collect());
            }
        }
        (set, unit)
    }
}

fn is_same(a: Pose, b: Pose) -> bool {
    let apart = [a.theta_c - b.theta_c, (a.phi_s - b.phi_s).wrapped()];
    apart.iter().all(|angle| angle.deg().abs() < SAME_POSE_DEG)
}

/// Groups the chosen pixels by their signals, the largest cluster first.
pub(in crate::map) fn clusters(batch: &Batch, chosen: &[usize]) -> Vec<Cluster> {
    let mut clusters: Vec<(Cluster, f64)> = Vec::new();
    for index in chosen {
        let apart = clusters
            .iter()
            .map(|(cluster, peak)| cluster.apart(*peak, batch, *index));
        let nearest = apart.enumerate().min_by(|a, b| a.1.total_cmp(&b.1));
        let at = match nearest {
            Some((at, apart)) if apart < APART => at,
            _ if clusters.len() < CLUSTERS_MAX => {
                clusters.push((Cluster::new(batch.observations), 0.0));
                clusters.len() - 1
            }
            _ => continue,
        };
        let (cluster, peak) = &mut clusters[at];
        cluster.add(batch, *index);
        *peak = cluster.peak();
    }
    clusters.sort_by_key(|(cluster, _)| std::cmp::Reverse(cluster.members.len()));
    clusters.into_iter().map(|(cluster, _)| cluster).collect()
}

/// Makes a pixel of the mean of each cluster, at the place of the member in its middle and with the noise of one.
pub(in crate::map) fn means(batch: &Batch, view: &View, clusters: &[Cluster]) -> Batch {
    let means = clusters.iter().flat_map(|cluster| {
        let all = 0..batch.observations;
        all.map(|j| cluster.mean(j).unwrap_or_default())
    });
    let (signal, sigma) = means.map(|(y, s)| (y as f32, s as f32)).unzip();
    let mut means = Batch::of_slices(batch.observations, signal, sigma);
    let middle = |cluster: &Cluster| {
        let pixels = cluster.members.iter().map(|member| batch.pixels[*member]);
        let count = pixels.len() as f64;
        let sum = pixels.clone().fold([0.0; 2], |sum, pixel| {
            let [x, y] = view.place_mm(pixel);
            [sum[0] + x, sum[1] + y]
        });
        let away = |pixel: &usize| {
            let [x, y] = view.place_mm(*pixel);
            (x - sum[0] / count).hypot(y - sum[1] / count)
        };
        let nearest = pixels.min_by(|a, b| away(a).total_cmp(&away(b)));
        nearest.expect("a cluster begins with a member")
    };
    means.pixels = clusters.iter().map(middle).collect();
    means
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pixels_of_one_surface_are_one_cluster_whatever_their_noise_and_masks() {
        const POSES: usize = 24;
        let mut batch = (Vec::new(), Vec::new());
        for pixel in 0..90 {
            // Two thirds of the pixels have their lobe at other poses; all have noise of a fifth of the peak.
            let middle = if pixel % 3 == 0 { 6.0 } else { 15.0 };
            for pose in 0..POSES {
                let away = (pose as f64 - middle) / 3.0;
                let noise = f64::sin((37 * pixel + 101 * pose) as f64);
                batch.0.push(((-away * away).exp() + 0.2 * noise) as f32);
                let masked = (pixel + pose) % 7 == 0;
                batch.1.push(if masked { 0.0 } else { 0.2 });
            }
        }
        let batch = Batch::of_slices(POSES, batch.0, batch.1);
        let all: Vec<usize> = (0..90).collect();
        let found = clusters(&batch, &all);
        let sizes: Vec<usize> = found.iter().map(|c| c.members.len()).collect();
        assert_eq!(sizes, [60, 30]);
        let (brightest, sigma) = found[1].mean(6).unwrap();
        assert!((brightest - 1.0).abs() < 0.1, "{brightest}");
        assert!((sigma - 0.2).abs() < 1e-6, "{sigma}");
    }
}
