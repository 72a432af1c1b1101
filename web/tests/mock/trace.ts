// A trace as the daemon sends it, small enough to know each number: 9 × 12 bins of polarised light with made-up values.

const [N_THETA, N_PHI, NUMBERS] = [9, 12, 18];

/** Element i of every bin of the upper side: 0.2 for m00 and scalar, −0.1 for m01 and m10, else 0; each ± 0.001. Nothing at the rim. */
export function traceFiles(): Map<string, Uint8Array> {
  const bins = new Float32Array(N_THETA * N_PHI * NUMBERS * 2).fill(Number.NaN);
  const difference = new Float32Array(N_THETA * N_PHI * 4).fill(Number.NaN);
  for (let bin = 0; bin < (N_THETA - 1) * N_PHI; bin++) {
    for (let i = 0; i < NUMBERS; i++) {
      const value = i === 0 || i === 16 ? 0.2 : i === 1 || i === 4 ? -0.1 : 0;
      bins.set([value, 0.001], 2 * (bin * NUMBERS + i));
    }
    difference.set([-0.15, 0.004, 0.15, 0.15], 4 * bin);
  }
  const reading = { stokes: [0.2, -0.1, 0, 0], stokes_std: [0.001, 0.001, 0.001, 0.001], dolp: 0.5, dolp_std: 0.006, aop_deg: 90, aop_std_deg: 0.3 };
  const psiDelta = { psi_deg: 42.2, psi_std_deg: 0.1, delta_deg: 122.6, delta_std_deg: 0.4, dop: 0.97, dop_std: null };
  const plane = {
    states: [{ name: 'scene', stokes: [1, 0, 0, 0] }, { name: 'linear-0', stokes: [1, 1, 0, 0] }],
    points: [-40, -20, 20, 40].map((theta_s_deg) => ({ theta_s_deg, readings: [reading, reading], psi_delta: psiDelta })),
    lobe: [20, 40].map((theta_s_deg) => ({ theta_s_deg, polarised: { value: 0.17, std: 0.001 }, scalar: { value: 0.2, std: 0.001 }, difference: { value: -0.03, std: 0.001 } })),
  };
  return new Map([
    ['bins.f32', new Uint8Array(bins.buffer)],
    ['difference.f32', new Uint8Array(difference.buffer)],
    ['plane.json', new TextEncoder().encode(JSON.stringify(plane))],
  ]);
}

export function traceResult(): Record<string, unknown> {
  const share = (value: number): unknown => ({ value, std: 0.0004 });
  return {
    photons: 500_000, seconds: 2.5, run_seconds: 0.5, polarised: true, relative_error: 0.012, batches: 64, program: 'mock',
    energy: { reflected: share(0.7), transmitted: share(0), absorbed: share(0.3), truncated: { value: 0, std: 0 }, by_interactions: { R1: share(0.1), R2: share(0.6) } },
    light: { theta_i_deg: 60, phi_i_deg: 180, wavelength_nm: 550, stokes: [1, 0, 0, 0] },
    bins: { n_theta: N_THETA, n_phi: N_PHI, sides: ['reflected'], numbers: [...Array.from({ length: 16 }, (_, i) => `m${Math.floor(i / 4)}${i % 4}`), 'scalar', 'm00-scalar'] },
    comparison: {
      wavelengths_nm: [380, 660], mask: { divisor: 10, error_max: 0.02 }, adm: { greatest: 0.151, percentile_99: 0.15, mean: 0.1 }, mdm: { greatest: 0.2, percentile_99: 0.19, mean: 0.1 },
      worst: { theta_deg: 75, phi_deg: 15, mean: -0.151, std: 0.004 }, directions: 96, too_dark: 5, not_settled: 7,
    },
    files: ['bins.csv', 'bins.f32', 'plane.json', 'difference.f32'],
    warnings: ['the target error 0.01 was not reached: 500000 photons gave 1.20e-2'],
    left_out: [{ what: 'interference and diffraction', why: 'rays', cost: null }],
  };
}
