// The report of a completed fit, and its curves.

import type { Json } from './ask';
import { radiance, random, type MockSurface } from './bench';
import type { MockScan } from './lab';

/** What a fit has once it is completed. */
export function completedFit(scan: MockScan, surface: MockSurface, variant: string, shaped: boolean): Json {
  const own = variant === 'auto' ? 'sawtooth' : variant;
  const parameter = (value: number, parts: Json): Json => {
    const std = Math.sqrt(Object.values(parts).reduce<number>((s, p) => s + (p as number) ** 2, 0));
    return { value, std, expanded: 2 * std, coverage_factor: 2, identifiable: true, budget: parts };
  };
  const paper = own === 'paper';
  return {
    state: 'completed', variant: own, status: 'converged', sample_id: scan.body.sample_id, sample_name: scan.body['sample_name'],
    n_observations: scan.body.plan.theta_c_deg.length * scan.body.plan.phi_s_deg.length, n_frames_used: scan.frames.length - 2, region: null,
    parameters: {
      theta_r_deg: parameter(surface.theta_r_deg + (paper ? 0.61 : 0.031), { counting: 0.0004, reference: 0.0021, angles: 0.021, model: paper ? 0.21 : 0.037 }),
      alpha_u: parameter(surface.alpha_u * 1.004, { counting: 0.00002, reference: 0.0001, angles: 0.0003, model: 0.0011 }),
      alpha_v: parameter(surface.alpha_v * 0.995, { counting: 0.00002, reference: 0.0002, angles: 0.0004, model: 0.0012 }),
      rho_d: parameter(surface.rho_d * 1.006, { counting: 0.00005, reference: 0.0019, angles: 0.0001, model: 0.0014 }),
      scale: { value: 1, std: 0.005, expanded: 0.01, coverage_factor: 2, identifiable: true, budget: { reference: 0.005 }, note: 'fixed by the white reference' },
      background: parameter(0.00012, { counting: 0.00003, model: 0.00006 }),
      azimuth_offset_deg: parameter(-0.021, { counting: 0.001, angles: 0.02, model: 0.05 }),
      tilt_offset_deg: paper
        ? { value: null, std: null, expanded: null, coverage_factor: null, identifiable: false, budget: null, note: 'three azimuths cannot tell it from the ridge angle' }
        : parameter(0.004, { counting: 0.0003, angles: 0.01, model: 0.012 }),
    },
    reference_plane: 'turntable', rms_residual: paper ? 0.041 : 0.0061, model_discrepancy: paper ? 0.04 : 0.006, chi2_reduced: 1, chi2_reduced_without_model: 8.1e4,
    rejected_frames: scan.frames.filter((f) => f['accepted'] === false).map((f) => ({ file: `frames/${String(f['id'])}.png`, reason: f['reason'] })),
    findings: paper ? [] : [{ code: 'translucent', explains: 0.9, change_of_theta_r_deg: 0.457, advice: 'state sample.translucency with its uncertainty' }],
    warnings: ['a wedge of the sample along v reads as ridge angle one to one; remount at 180° to tell'],
    variants: [{ variant: 'sawtooth', status: 'converged', rms_residual: 0.0061, theta_r_deg: surface.theta_r_deg + 0.031 }, { variant: 'paper', status: 'converged', rms_residual: 0.041, theta_r_deg: surface.theta_r_deg + 0.61 }],
    left_out: [{ what: 'cone average', why: 'the lobe is twelve times wider than the lamp', cost: 1e-5 }],
    ...(own === 'traced' ? { tracer: { paths_per_pose: 8192, error: 7.5e-4, polarised: true, ...(shaped ? { profile_theta_r_deg: 9.998, height_map: { ridges: 6, period_um: 101.54, height_um: 17.3, explained: 0.9999 } } : {}) } } : {}),
    timing_s: { read: 0.21, reduce: 0.38, fit: 0.012 }, program: 'ridged 0.1.0',
  };
}

/** Observations with noise, and the curves of both variants. */
export function fittedCurves(fit: Json, scan: MockScan, surface: MockSurface): Json {
  const own = String(fit['variant']);
  const other = own === 'paper' ? 'sawtooth' : 'paper';
  const wrong = { ...surface, theta_r_deg: surface.theta_r_deg + 0.6, alpha_v: surface.alpha_v * 1.09 };
  const of = (variant: string, theta: number, phi: number): number => radiance(variant === 'paper' ? wrong : surface, theta, phi);
  const noise = random(7);
  const { theta_c_deg, phi_s_deg } = scan.body.plan;
  const phis = Array.from({ length: 181 }, (_, i) => 2 * i);
  const points = theta_c_deg.flatMap((theta) =>
    phi_s_deg.map((phi) => ({ theta, phi, signal: of('sawtooth', theta, phi) * (1 + 0.012 * (noise() - 0.5)), predicted: of(own, theta, phi) })),
  );
  const peak = Math.max(...points.map((p) => p.signal));
  return {
    fit_id: fit['id'], peak,
    observations: points.map((p) => ({
      theta_c_deg: p.theta + 0.0003, phi_s_deg: p.phi - 0.0002, signal: p.signal, sigma: 0.0004 + 0.002 * p.signal, n_frames: 3, predicted: p.predicted,
      residual: (p.signal - p.predicted) / peak,
    })),
    curves: [own, other].flatMap((variant) => theta_c_deg.map((theta) => ({ variant, theta_c_deg: theta, phi_s_deg: phis, signal: phis.map((phi) => of(variant, theta, phi)) }))),
  };
}
