//! Pixels per second of the per-pixel fit, and that its cost is linear in pixels and observations.
//!
//! Times are CPU seconds of the fitting thread where the system tells them (Linux), so that other
//! work on the machine does not count; elsewhere wall-clock. `cargo bench --bench map` prints pixels
//! per second and core for each instruction set; `-- sizes` maps whole synthetic series up to 4
//! megapixels and prints seconds and memory.

use std::hint::black_box;
use std::sync::atomic::AtomicBool;
use std::time::Instant;

use criterion::measurement::{Measurement, ValueFormatter, WallTime};
use criterion::{BatchSize, BenchmarkId, Criterion, Throughput};
use rand::{RngExt, SeedableRng};
use rand_distr::StandardNormal;
use ridged::frame::{Frame, FrameKind};
use ridged::geometry::{Pose, RigGeometry};
use ridged::map::pixels::{Instructions, PixelFitter};
use ridged::map::{MapOptions, map};
use ridged::material::Material;
use ridged::reduction::{FrameReadError, FrameSource};
use ridged::series::{FrameRow, Manifest};

const PLASTIC: Material = Material::Dielectric {
    eta: 1.54,
    eta_std: 0.005,
};
/// Noise as a share of a signal near 0.2.
const SIGMA: f64 = 1e-3;

/// Seconds of this thread on a core.
fn cpu_s() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/thread-self/schedstat").ok()?;
    let nanoseconds: f64 = text.split(' ').next()?.parse().ok()?;
    Some(nanoseconds * 1e-9)
}

/// CPU time of the calling thread, wall-clock where there is none.
struct CpuTime(WallTime);

impl Measurement for CpuTime {
    type Intermediate = (Option<f64>, Instant);
    type Value = std::time::Duration;

    fn start(&self) -> Self::Intermediate {
        (cpu_s(), Instant::now())
    }
    fn end(&self, (cpu, wall): Self::Intermediate) -> Self::Value {
        match (cpu, cpu_s()) {
            (Some(a), Some(b)) => std::time::Duration::from_secs_f64((b - a).max(1e-9)),
            _ => wall.elapsed(),
        }
    }
    fn add(&self, a: &Self::Value, b: &Self::Value) -> Self::Value {
        self.0.add(a, b)
    }
    fn zero(&self) -> Self::Value {
        self.0.zero()
    }
    fn to_f64(&self, value: &Self::Value) -> f64 {
        self.0.to_f64(value)
    }
    fn formatter(&self) -> &dyn ValueFormatter {
        self.0.formatter()
    }
}

struct Pixels {
    fitter: PixelFitter,
    signal: Vec<f32>,
    sigma: Vec<f32>,
    starts: Vec<[f64; 5]>,
    truths: Vec<[f64; 5]>,
}

/// Noisy pixels whose parameters wander, with starts some standard deviations away: θr by 3°, lean
/// by 17°, α by 35 %, ρd by 30 %.
fn pixels(count: usize, tilts: usize, azimuths: usize) -> Pixels {
    let mut poses = Vec::new();
    for tilt in 0..tilts {
        for azimuth in 0..azimuths {
            poses.push(Pose::from_deg(
                -20.0 + 40.0 * tilt as f64 / (tilts - 1) as f64,
                360.0 * azimuth as f64 / azimuths as f64,
            ));
        }
    }
    let n = poses.len();
    let fitter = PixelFitter::new(RigGeometry::IN_PLANE, PLASTIC, poses);
    let mut random = rand_pcg::Pcg64::seed_from_u64(1);
    let mut signal = Vec::with_capacity(count * n);
    let mut starts = Vec::with_capacity(count);
    let mut truths = Vec::with_capacity(count);
    // A few hundred kinds of pixel; the full closed form for each of a million would take minutes.
    let kinds: Vec<([f64; 5], Vec<f64>)> = (0..count.min(300))
        .map(|i| {
            let x = i as f64;
            let truth = [
                0.17 + 0.05 * (0.37 * x).sin(),
                3.0 * (0.11 * x).sin(),
                0.12_f64.ln() + 0.3 * (0.71 * x).sin(),
                0.14_f64.ln() + 0.3 * (0.53 * x).cos(),
                0.35 + 0.1 * (0.23 * x).sin(),
            ];
            (truth, fitter.radiances(&truth))
        })
        .collect();
    for i in 0..count {
        let (truth, radiances) = &kinds[i % kinds.len()];
        let x = i as f64;
        truths.push(*truth);
        signal.extend(radiances.iter().map(|l| {
            let noise: f64 = random.sample(StandardNormal);
            (l + SIGMA * noise) as f32
        }));
        starts.push([
            truth[0] + 0.05 * (0.3 * x).cos(),
            truth[1] + 0.3 * (0.7 * x).cos(),
            truth[2] + 0.3 * (0.9 * x).cos(),
            truth[3] - 0.3 * (0.2 * x).sin(),
            truth[4] * 0.7,
        ]);
    }
    Pixels {
        fitter,
        sigma: vec![SIGMA as f32; signal.len()],
        signal,
        starts,
        truths,
    }
}

/// Evaluations per pixel, ends, and how far from the truth in standard deviations: the root mean
/// square of a fit that ends at the right place is 1, and its mean 0.
#[expect(clippy::print_stdout, reason = "a bench prints what it measures")]
fn tell(p: &Pixels, refreshes: u8) {
    let fits = p.fitter.fit(
        p.signal.clone(),
        p.sigma.clone(),
        &p.starts,
        refreshes,
        Instructions::Widest,
    );
    let (mut sum, mut squares) = ([0.0; 5], [0.0; 5]);
    let (mut converged, mut evaluations) = (0, 0.0);
    for (fit, truth) in fits.iter().zip(&p.truths) {
        evaluations += f64::from(fit.evaluations);
        let Some(std) = fit.std.filter(|_| fit.converged) else {
            continue;
        };
        converged += 1;
        for k in 0..5 {
            let mut away = fit.values[k] - truth[k];
            if k == 1 {
                away -= std::f64::consts::TAU * (away / std::f64::consts::TAU).round();
            }
            sum[k] += away / std[k];
            squares[k] += (away / std[k]).powi(2);
        }
    }
    let per = |x: [f64; 5]| x.map(|x| x / f64::from(converged));
    println!(
        "{refreshes} refreshes at most: {:.2} evaluations per pixel, {converged} of {} converged; \
         away from the truth over standard deviation, θr, lean, ln αu, ln αv, ρd: mean {:.2?}, rms {:.2?}",
        evaluations / fits.len() as f64,
        fits.len(),
        per(sum),
        per(squares).map(f64::sqrt),
    );
}

fn kernels(criterion: &mut Criterion<CpuTime>) {
    let mut group = criterion.benchmark_group("map, 108 observations, 5 parameters, covariance");
    let p = pixels(4096, 9, 12);
    for refreshes in [0, 3] {
        tell(&p, refreshes);
    }
    group.throughput(Throughput::Elements(p.starts.len() as u64));
    for (name, instructions) in [
        ("widest", Instructions::Widest),
        ("avx2", Instructions::Avx2),
        ("scalar", Instructions::Scalar),
    ] {
        for refreshes in [0, 3] {
            let id = BenchmarkId::new(name, format!("{refreshes} refreshes of the costly terms"));
            group.bench_with_input(id, &refreshes, |bencher, refreshes| {
                let own = || (p.signal.clone(), p.sigma.clone());
                bencher.iter_batched(
                    own,
                    |(signal, sigma)| {
                        let fits = p
                            .fitter
                            .fit(signal, sigma, &p.starts, *refreshes, instructions);
                        black_box(fits.iter().filter(|f| f.converged).count())
                    },
                    BatchSize::PerIteration,
                );
            });
        }
    }
    group.finish();
}

fn linear(criterion: &mut Criterion<CpuTime>) {
    let mut group = criterion.benchmark_group("map, cost per observation");
    for (count, tilts, azimuths) in [(1024, 9, 12), (16_384, 9, 12), (4096, 5, 8), (4096, 9, 36)] {
        let p = pixels(count, tilts, azimuths);
        group.throughput(Throughput::Elements(p.signal.len() as u64));
        let id = BenchmarkId::from_parameter(format!("{count} × {}", tilts * azimuths));
        group.bench_with_input(id, &p, |bencher, p| {
            let own = || (p.signal.clone(), p.sigma.clone());
            bencher.iter_batched(
                own,
                |(signal, sigma)| {
                    let fits = p
                        .fitter
                        .fit(signal, sigma, &p.starts, 0, Instructions::Widest);
                    black_box(fits.len())
                },
                BatchSize::PerIteration,
            );
        });
    }
    group.finish();
}

/// A series of a uniform sample that is made as it is read.
struct Uniform {
    manifest: Manifest,
    rows: Vec<FrameRow>,
    radiances: Vec<f64>,
    side: u32,
}

impl Uniform {
    fn new(side: u32) -> Self {
        let manifest = Manifest::from_toml(
            &format!(
                "schema = \"gonio-series-1\"\nname = \"uniform\"\n[rig]\ntheta_l_deg = 10.0\nlight_angular_radius_deg = 1.0\n[camera]\nprojection = \"orthographic\"\nwidth_px = {side}\nheight_px = {side}\nfield_width_mm = 50.0\nfield_height_mm = 50.0\nbit_depth = 16\nsaturation_dn = 65535\ngain_dn_per_electron = 2.0\nblack_level_dn = 200.0\nread_noise_electrons_rms = 2.0\nexposures_s = [0.04]\n[flat]\nreflectance = 0.99\nreflectance_std = 0.005\n[sample]\nkind = \"dielectric\"\nindex_of_refraction = 1.54\nindex_of_refraction_std = 0.005\n"
            ),
            "uniform",
        )
        .expect("the manifest is complete");
        let mut rows = Vec::new();
        let mut row = |kind: FrameKind, theta_c_deg: f64, phi_s_deg: f64, repeat: u32| {
            rows.push(FrameRow {
                file: format!("frames/{}.png", rows.len()),
                kind,
                theta_c_deg,
                phi_s_deg,
                exposure_s: 0.04,
                repeat,
                timestamp: String::new(),
            });
        };
        for repeat in 0..4 {
            row(FrameKind::Dark, 0.0, 0.0, repeat);
        }
        for tilt in [-10.0, 0.0, 10.0] {
            row(FrameKind::Flat, tilt, 0.0, 0);
        }
        for tilt in [-10.0, 0.0, 10.0] {
            for step in 0..8 {
                row(FrameKind::Sample, tilt, 45.0 * f64::from(step), 0);
            }
        }
        let poses = rows.iter().map(FrameRow::pose).collect();
        let fitter = PixelFitter::new(RigGeometry::IN_PLANE, PLASTIC, poses);
        Uniform {
            radiances: fitter.radiances(&[0.1745, 0.3, -2.12, -2.12, 0.34]),
            manifest,
            rows,
            side,
        }
    }
}

impl FrameSource for Uniform {
    fn manifest(&self) -> &Manifest {
        &self.manifest
    }
    fn rows(&self) -> &[FrameRow] {
        &self.rows
    }
    fn read(&self, index: usize) -> Result<Frame, FrameReadError> {
        let row = &self.rows[index];
        let level = match row.kind {
            FrameKind::Dark => 0.0,
            FrameKind::Flat => {
                let theta_i = (row.theta_c_deg + 10.0).to_radians();
                0.99 / std::f64::consts::PI * theta_i.cos()
            }
            FrameKind::Sample => self.radiances[index],
        };
        let electrons = level * 1.2e6 * 0.04;
        let spread = (electrons + 4.0_f64).sqrt();
        let mut state = 0x9E37_79B9_u64.wrapping_mul(index as u64 + 1);
        let pixels = (0..self.side * self.side)
            .map(|_| {
                state = state
                    .wrapping_mul(6_364_136_223_846_793_005)
                    .wrapping_add(1_442_695_040_888_963_407);
                // Four 16-bit uniforms have a standard deviation of √(4/12) of their range.
                let sum: u64 = (0..4).map(|k| state >> (16 * k) & 0xFFFF).sum();
                let z = (sum as f64 / 65_536.0 - 2.0) * 3.0_f64.sqrt();
                (200.0 + 2.0 * (electrons + spread * z)).round() as u16
            })
            .collect();
        Ok(Frame::new(self.side, self.side, pixels).expect("the size fits"))
    }
}

/// Highest resident memory so far, MiB.
fn peak_mib() -> Option<f64> {
    let status = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = status.lines().find(|l| l.starts_with("VmHWM"))?;
    let kib: f64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kib / 1024.0)
}

/// Maps whole series of growing size, planes in a scratch file beyond 256 MiB.
#[expect(clippy::print_stdout, reason = "a bench prints what it measures")]
fn sizes() {
    println!("   side   pixels  seconds  µs/pixel  peak MiB");
    for side in [256, 512, 1024, 2048] {
        let source = Uniform::new(side);
        let options = MapOptions {
            memory_bytes_max: 256 << 20,
            ..MapOptions::default()
        };
        let started = Instant::now();
        let mapped = map(&source, &options, &|_| {}, &AtomicBool::new(false));
        let seconds = started.elapsed().as_secs_f64();
        match mapped {
            Ok(mapped) => println!(
                "{side:>7} {:>8} {seconds:>8.2} {:>9.2} {:>9.0}",
                mapped.pixels_fitted,
                1e6 * seconds / mapped.pixels_fitted.max(1) as f64,
                peak_mib().unwrap_or(f64::NAN)
            ),
            Err(error) => println!("{side:>7} {error}"),
        }
    }
}

fn main() {
    if std::env::args().any(|a| a == "sizes") {
        sizes();
        return;
    }
    let mut criterion = Criterion::default()
        .with_measurement(CpuTime(WallTime))
        .sample_size(20)
        .configure_from_args();
    kernels(&mut criterion);
    linear(&mut criterion);
    criterion.final_summary();
}
