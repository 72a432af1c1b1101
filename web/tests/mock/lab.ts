// What the mock daemon has: parts, scans that run, fits, verdicts and traces, with events for each change.

import type { ServerResponse } from 'node:http';

import type { Json } from './ask';
import { radiance, type MockSurface } from './bench';
import { judged, MockDefinitions } from './definitions';
import { completedFit } from './fit';
import { traceResult } from './trace';

export interface MockScan {
  body: Json & { id: number; state: string; sample_id: number; plan: { theta_c_deg: number[]; phi_s_deg: number[]; poses: unknown[]; exposures_s: number[]; repeats: number } };
  frames: Json[];
  steps: string[];
}

export const PRESETS: Record<string, { theta_c_deg: number[]; phi_s_deg: number[] }> = {
  paper: { theta_c_deg: [-20, -10, 0, 10, 20], phi_s_deg: [0, 90, 180] },
  full: { theta_c_deg: [-20, -15, -10, -5, 0, 5, 10, 15, 20], phi_s_deg: Array.from({ length: 12 }, (_, i) => 30 * i) },
};
export const MESSAGES: Record<string, string> = {
  'cap-lens': 'put the cap on the lens, then continue',
  'place-white-reference': 'take the cap off and lay the white reference on the table, then continue',
  'place-sample': 'lay the part on the table with its mark towards the zero, then continue',
};
export const SIZE_PX = 96;

export class MockLab {
  /** All paths that were read, with their queries. */
  readonly reads: string[] = [];
  readonly requests: { method: string; path: string; body: unknown }[] = [];
  /** Paths that answer with a problem, e.g. `POST /fits`. */
  readonly refusals = new Map<string, { status: number; body: Json }>();
  connected = true;
  /** Whether the stages can be connected. */
  plugged = true;
  /** Whether a completed scan is fitted, as the real daemon does. */
  fitsAtEnd = false;
  /** Rows of the live fit, for every scan. */
  readonly certainties: Json[] = [];
  /** Calibrations of earlier scans that a new scan can use. */
  readonly calibrations: Json[] = [];
  /** Regions of the part of every scan. */
  regions: string[] = [];
  frameMs: number;
  readonly axes = {
    theta_c: { position_deg: 0, referenced: true, moving: false, homed: true, warnings: [] as string[], serial: '90001', limit_min_deg: -60, limit_max_deg: 60 },
    phi_s: { position_deg: 0, referenced: true, moving: false, homed: true, warnings: [] as string[], serial: '90002', limit_min_deg: -10, limit_max_deg: 370 },
  };
  readonly surfaces = new Map<number, MockSurface>();
  readonly samples: Json[] = [];
  readonly recipes = new MockDefinitions('recipe');
  readonly specifications = new MockDefinitions('specification');
  /** Newest first. */
  readonly verdicts: Json[] = [];
  /** Scans that have a map. */
  readonly mapped: number[] = [];
  orders: Json[] = [];
  queueState = 'stopped';
  readonly scans: MockScan[] = [];
  /** Changes of the records of scans. */
  readonly changes: Json[] = [];
  /** What the settings ask to measure again at intervals. */
  readonly due: Json[] = [];
  readonly fits: Json[] = [];
  /** Duration of a fit; null: it runs until it is cancelled. */
  fitMs: number | null = 150;
  /** Results of `ridged accuracy` in the folder, if any. */
  accuracy: Json | null = null;
  /** Tokens and the role of each; none: the daemon asks for no token. */
  readonly tokens = new Map<string, { who: string; role: string }>();
  /** Who holds the rig. */
  holder: Json | null = null;
  /** Number of the lease of this page. */
  lease: string | null = null;
  /** Size that the rows of frames state; their files stay small. */
  statedPx = SIZE_PX;
  /** Looks through the camera. */
  looks = 0;
  session: { who: string; role: string } | null = null;
  /** Newest first; a new one runs until `finishTrace`. */
  readonly traces: Json[] = [];

  readonly streams = new Set<ServerResponse>();
  readonly timers = new Set<NodeJS.Timeout>();
  ids = 0;

  constructor(frameMs: number) {
    this.frameMs = frameMs;
    this.addSample('traced polymer', { theta_r_deg: 10, alpha_u: 0.12, alpha_v: 0.12, rho_d: 0.337 });
    this.addSample('model 15°', { theta_r_deg: 15, alpha_u: 0.1, alpha_v: 0.13, rho_d: 0.3 });
  }

  /** Another caller takes the rig over. */
  takeOver(who: string, name: string): void {
    this.lease = null;
    this.holder = { who, name, until: null };
    this.event('order', { who, order: `lease \`${name}\` taken over`, scan_id: null });
  }

  /** Revokes the token of the session: its events end, too. */
  revoke(): void {
    this.session = null;
    this.dropStreams();
  }

  dropStreams(): void {
    this.streams.forEach((stream) => stream.end());
    this.streams.clear();
  }

  event(type: string, data: Json): void {
    this.ids += 1;
    const text = `id: ${this.ids}\nevent: ${type}\ndata: ${JSON.stringify({ id: this.ids, at: new Date().toISOString(), type, ...data })}\n\n`;
    this.streams.forEach((stream) => stream.write(text));
  }

  addSample(name: string, surface: MockSurface): number {
    const id = this.samples.length + 1;
    this.samples.unshift({ id, name, material: { kind: 'dielectric', eta: 1.54, eta_std: 0.005 }, note: null, simulated: { surface: 'model', ...surface }, earlier_names: [] });
    this.surfaces.set(id, surface);
    return id;
  }

  /** A scan with all its frames, as if it had run. */
  addScan(sampleId: number, preset: keyof typeof PRESETS & string): number {
    const scan = this.newScan(sampleId, { ...(PRESETS[preset] ?? { theta_c_deg: [], phi_s_deg: [] }), poses: [], exposures_s: [0.02, 0.06, 0.18], repeats: 1 });
    scan.steps = [];
    this.shots(scan).forEach((shot) => this.expose(scan, shot));
    this.finish(scan);
    return scan.body.id;
  }

  addFit(scanId: number, variant = 'auto'): number {
    const id = this.fits.length + 1;
    this.fits.unshift({ id, scan_id: scanId, state: 'running', created_at: new Date().toISOString() });
    this.finishFit(id, variant);
    return id;
  }

  finishTrace(): void {
    const [trace] = this.traces;
    if (trace) Object.assign(trace, traceResult(), { state: 'completed', progress: undefined });
    this.event('calculation', {});
  }

  after(ms: number, work: () => void): void {
    const timer = setTimeout(() => {
      this.timers.delete(timer);
      work();
    }, ms);
    this.timers.add(timer);
  }

  scanName(sampleId: number): string {
    return String(this.samples.find((s) => s['id'] === sampleId)?.['name'] ?? '');
  }

  newScan(sampleId: number, plan: MockScan['body']['plan']): MockScan {
    const id = this.scans.length + 1;
    const scan: MockScan = {
      body: {
        id, sample_id: sampleId, regions: this.regions, calibration_ids: [], earlier_samples: [], tags: [], note: null, archived: false, camera: { width_px: SIZE_PX, height_px: SIZE_PX, saturation_dn: 65535, states_exposure_start: true }, sample_name: this.scanName(sampleId), state: 'planned', reason: null, origin: 'rig', operator: null, plan,
        progress: null, frames_rejected: 0, created_at: new Date().toISOString(), started_at: new Date().toISOString(), ended_at: null,
      },
      frames: [],
      steps: ['cap-lens', 'place-white-reference', 'place-sample'],
    };
    this.scans.unshift(scan);
    this.progress(scan);
    return scan;
  }

  shots(scan: MockScan): { kind: string; theta: number; phi: number; exposure: number }[] {
    const { theta_c_deg, phi_s_deg, exposures_s } = scan.body.plan;
    return [
      ...exposures_s.map((exposure) => ({ kind: 'dark', theta: 0, phi: 0, exposure })),
      ...theta_c_deg.map((theta) => ({ kind: 'flat', theta, phi: 0, exposure: exposures_s[0] ?? 0.02 })),
      ...theta_c_deg.flatMap((theta) => phi_s_deg.flatMap((phi) => exposures_s.map((exposure) => ({ kind: 'sample', theta, phi, exposure })))),
    ];
  }

  progress(scan: MockScan): void {
    const total = this.shots(scan).length;
    const done = scan.frames.length;
    const phase = this.shots(scan)[done]?.kind ?? 'done';
    scan.body['progress'] = {
      phase, shots_done: done, shots_total: total, frames_done: done, frames_total: total, fraction: done / total,
      elapsed_s: done * 0.8, time_left_s: (total - done) * 0.8,
    };
  }

  publish(scan: MockScan): void {
    const { id, sample_id, state, reason, operator, progress } = scan.body as Json;
    this.event('scan', { scan_id: id, sample_id, state, reason, operator, progress });
  }

  finish(scan: MockScan): void {
    scan.body.state = 'completed';
    scan.body['ended_at'] = new Date().toISOString();
    this.progress(scan);
    this.publish(scan);
    if (this.fitsAtEnd) this.addFit(scan.body.id);
  }

  expose(scan: MockScan, shot: { kind: string; theta: number; phi: number; exposure: number }): void {
    const surface = this.surfaces.get(scan.body.sample_id) ?? { theta_r_deg: 10, alpha_u: 0.1, alpha_v: 0.1, rho_d: 0.3 };
    const level = shot.kind === 'dark' ? 0 : shot.kind === 'flat' ? 0.31 : radiance(surface, shot.theta, shot.phi);
    const mean = Math.min(65535, 200 + 2 * 1.2e6 * level * shot.exposure);
    const id = 1000 * scan.body.id + scan.frames.length;
    this.axes.theta_c.position_deg = shot.theta;
    this.axes.phi_s.position_deg = shot.phi;
    const row = {
      id, scan_id: scan.body.id, kind: shot.kind, theta_c_deg: shot.theta + 0.0003, phi_s_deg: shot.phi - 0.0002, exposure_s: shot.exposure, repeat: 0,
      timestamp: new Date().toISOString(), sha256: '0', width_px: this.statedPx, height_px: this.statedPx, bytes: 18000,
      mean_dn: mean, max_dn: Math.min(65535, mean * 1.06), saturated_px: mean > 62000 ? 2200 : 0, accepted: mean <= 65000, reason: mean > 65000 ? 'saturated' : null,
      image: `/api/v1/frames/${id}/image.png`,
    };
    scan.frames.push(row);
    this.progress(scan);
    const { id: frame_id, ...rest } = row;
    this.event('frame', { frame_id, ...rest, progress: scan.body['progress'] });
  }

  run(scan: MockScan): void {
    if (scan.body.state !== 'running') return;
    const shot = this.shots(scan)[scan.frames.length];
    if (!shot) return this.finish(scan);
    const wanted = { dark: 'cap-lens', flat: 'place-white-reference', sample: 'place-sample' }[shot.kind] ?? '';
    if (scan.steps.includes(wanted)) {
      scan.body.state = 'waiting-for-operator';
      scan.body['operator'] = { action: wanted, message: MESSAGES[wanted] };
      return this.publish(scan);
    }
    this.expose(scan, shot);
    this.after(this.frameMs, () => this.run(scan));
  }

  finishFit(id: number, variant: string, shaped = false): void {
    const fit = this.fits.find((f) => f['id'] === id);
    const scan = this.scans.find((s) => s.body.id === fit?.['scan_id']);
    const surface = scan ? this.surfaces.get(scan.body.sample_id) : undefined;
    if (!fit || !scan || !surface) return;
    Object.assign(fit, completedFit(scan, surface, variant, shaped));
    this.event('fit', { fit_id: id, scan_id: scan.body.id, state: 'completed', variant: fit['variant'], status: 'converged' });
    const wanted = this.specifications.named((scan.body['specification'] as { name: string } | null)?.name);
    if (wanted) this.judge(scan.body.id, wanted.content, id);
  }

  /** A scan of a recipe with a specification, fitted and judged. */
  addPart(sampleId: number, recipe: string, specification: string): number {
    const id = this.addScan(sampleId, 'paper');
    const scan = this.scans.find((s) => s.body.id === id);
    Object.assign(scan?.body ?? {}, { recipe: this.recipes.named(recipe)?.ref, specification: this.specifications.named(specification)?.ref, lot: '4', external_id: 'A-1001', operator_name: 'Ada' });
    this.addFit(id);
    return id;
  }

  /** Judges a fit, or the newest one of the scan as if it were a new one. */
  judge(scanId: number, specification: Json, fitId?: number): Json {
    const fit = this.fits.find((f) => (fitId === undefined ? f['scan_id'] === scanId && f['state'] === 'completed' : f['id'] === fitId));
    const verdict = {
      id: this.verdicts.length + 1, scan_id: scanId, state: 'completed', created_at: new Date().toISOString(), request: { specification, ...(fitId === undefined ? {} : { fit_id: fitId }) },
      ...judged(specification, (fit?.['parameters'] ?? {}) as Record<string, { value: number; expanded: number }>),
    };
    this.verdicts.unshift(verdict);
    this.event('calculation', {});
    return verdict;
  }

  rigBody(): Json {
    const holder = this.scans.find((s) => ['planned', 'waiting-for-operator', 'running', 'pausing', 'paused'].includes(s.body.state));
    const moving = this.axes.theta_c.moving || this.axes.phi_s.moving;
    const unheard = (axis: Json): Json => ({ ...axis, position_deg: null, referenced: false, moving: null, homed: false, serial: null });
    const axes = this.connected ? this.axes : { theta_c: unheard(this.axes.theta_c), phi_s: unheard(this.axes.phi_s) };
    return {
      connected: this.connected, problem: this.connected ? null : { code: 'port-missing', detail: 'the serial port /dev/ttyUSB0 does not exist: plug the stage in or correct [bench] port' },
      simulated: true, description: 'Zaber ASCII on /dev/pts/3', time_scale: 20, geometry: { theta_l_deg: 10, light_azimuth_deg: 0, azimuth_zero_deg: 0, light_angular_radius_deg: 1, lens_angular_radius_deg: null, wavelength_nm: 550 },
      camera: { description: 'simulated camera, 96 × 96, 16 bit', width_px: SIZE_PX, height_px: SIZE_PX, bit_depth: 16, saturation_dn: 65535, exposures_s: [0.02, 0.06, 0.18] },
      axes, activity: holder?.body.state === 'running' ? 'scanning' : holder?.body.state === 'paused' ? 'paused' : moving ? 'moving' : 'idle', scan_id: holder?.body.id ?? null,
      scan_state: holder?.body.state ?? null, scan_reason: holder?.body.reason ?? null, refused_stages: null,
    };
  }
}
