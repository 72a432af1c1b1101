// A mock daemon for tests of the page: the bodies of /api/v1 with invented optics, on its own
// loopback port. The real daemon is tested by tests/e2e.

import { readFile } from 'node:fs/promises';
import { createServer, type IncomingMessage, type Server, type ServerResponse } from 'node:http';
import type { AddressInfo } from 'node:net';
import { extname, join, normalize } from 'node:path';

import { radiance, random, type MockSurface } from './bench';
import { judged, MockDefinitions } from './definitions';
import { finishedMap, mapFiles } from './maps';
import { encodePng } from './png';
import { lookThrough, picture } from './preview';
import { resultRows, resultsPage } from './results';
import { resultChart } from './chart';
import { comparison, repeatability, type MockResult } from './study';
import { traceFiles, traceResult } from './trace';

type Json = Record<string, unknown>;

interface MockScan {
  body: Json & { id: number; state: string; sample_id: number; plan: { theta_c_deg: number[]; phi_s_deg: number[]; poses: unknown[]; exposures_s: number[]; repeats: number } };
  frames: Json[];
  steps: string[];
}

const TYPES: Record<string, string> = {
  '.html': 'text/html; charset=utf-8',
  '.js': 'text/javascript',
  '.css': 'text/css',
  '.svg': 'image/svg+xml',
  '.woff2': 'font/woff2',
  '.txt': 'text/plain; charset=utf-8',
};
const PRESETS: Record<string, { theta_c_deg: number[]; phi_s_deg: number[] }> = {
  paper: { theta_c_deg: [-20, -10, 0, 10, 20], phi_s_deg: [0, 90, 180] },
  full: { theta_c_deg: [-20, -15, -10, -5, 0, 5, 10, 15, 20], phi_s_deg: Array.from({ length: 12 }, (_, i) => 30 * i) },
};
const MESSAGES: Record<string, string> = {
  'cap-lens': 'put the cap on the lens, then continue',
  'place-white-reference': 'take the cap off and lay the white reference on the table, then continue',
  'place-sample': 'lay the part on the table with its mark towards the zero, then continue',
};
const SIZE_PX = 96;

interface MockSettings {
  /** Milliseconds per frame of a scan. */
  readonly frameMs: number;
  readonly dist: string;
}

export class MockDaemon {
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
  #lease: string | null = null;
  /** Size that the rows of frames state; their files stay small. */
  statedPx = SIZE_PX;
  /** Looks through the camera. */
  looks = 0;
  #session: { who: string; role: string } | null = null;
  /** Newest first; a new one runs until `finishTrace`. */
  readonly traces: Json[] = [];

  #server: Server;
  #streams = new Set<ServerResponse>();
  #timers = new Set<NodeJS.Timeout>();
  #ids = 0;
  #settings: MockSettings;

  constructor(settings: MockSettings) {
    this.#settings = settings;
    this.frameMs = settings.frameMs;
    this.#server = createServer((request, response) => {
      this.#answer(request, response).catch((error: unknown) => {
        response.writeHead(500).end(String(error));
      });
    });
    this.addSample('traced polymer', { theta_r_deg: 10, alpha_u: 0.12, alpha_v: 0.12, rho_d: 0.337 });
    this.addSample('model 15°', { theta_r_deg: 15, alpha_u: 0.1, alpha_v: 0.13, rho_d: 0.3 });
  }

  async start(port = 0): Promise<string> {
    await new Promise<void>((resolve) => this.#server.listen(port, '127.0.0.1', resolve));
    return `http://127.0.0.1:${(this.#server.address() as AddressInfo).port}`;
  }

  async stop(): Promise<void> {
    this.#timers.forEach(clearTimeout);
    this.dropStreams();
    this.#server.closeAllConnections();
    await new Promise<void>((resolve) => this.#server.close(() => resolve()));
  }

  /** Another caller takes the rig over. */
  takeOver(who: string, name: string): void {
    this.#lease = null;
    this.holder = { who, name, until: null };
    this.event('order', { who, order: `lease \`${name}\` taken over`, scan_id: null });
  }

  /** Revokes the token of the session: its events end, too. */
  revoke(): void {
    this.#session = null;
    this.dropStreams();
  }

  dropStreams(): void {
    this.#streams.forEach((stream) => stream.end());
    this.#streams.clear();
  }

  event(type: string, data: Json): void {
    this.#ids += 1;
    const text = `id: ${this.#ids}\nevent: ${type}\ndata: ${JSON.stringify({ id: this.#ids, at: new Date().toISOString(), type, ...data })}\n\n`;
    this.#streams.forEach((stream) => stream.write(text));
  }

  addSample(name: string, surface: MockSurface): number {
    const id = this.samples.length + 1;
    this.samples.unshift({ id, name, material: { kind: 'dielectric', eta: 1.54, eta_std: 0.005 }, note: null, simulated: { surface: 'model', ...surface }, earlier_names: [] });
    this.surfaces.set(id, surface);
    return id;
  }

  /** A scan with all its frames, as if it had run. */
  addScan(sampleId: number, preset: keyof typeof PRESETS & string): number {
    const scan = this.#newScan(sampleId, { ...(PRESETS[preset] ?? { theta_c_deg: [], phi_s_deg: [] }), poses: [], exposures_s: [0.02, 0.06, 0.18], repeats: 1 });
    scan.steps = [];
    this.#shots(scan).forEach((shot) => this.#expose(scan, shot));
    this.#finish(scan);
    return scan.body.id;
  }

  addFit(scanId: number, variant = 'auto'): number {
    const id = this.fits.length + 1;
    this.fits.unshift({ id, scan_id: scanId, state: 'running', created_at: new Date().toISOString() });
    this.#finishFit(id, variant);
    return id;
  }

  finishTrace(): void {
    const [trace] = this.traces;
    if (trace) Object.assign(trace, traceResult(), { state: 'completed', progress: undefined });
    this.event('calculation', {});
  }

  #after(ms: number, work: () => void): void {
    const timer = setTimeout(() => {
      this.#timers.delete(timer);
      work();
    }, ms);
    this.#timers.add(timer);
  }

  #scanName(sampleId: number): string {
    return String(this.samples.find((s) => s['id'] === sampleId)?.['name'] ?? '');
  }

  #newScan(sampleId: number, plan: MockScan['body']['plan']): MockScan {
    const id = this.scans.length + 1;
    const scan: MockScan = {
      body: {
        id, sample_id: sampleId, regions: this.regions, calibration_ids: [], earlier_samples: [], tags: [], note: null, archived: false, camera: { width_px: SIZE_PX, height_px: SIZE_PX, saturation_dn: 65535, states_exposure_start: true }, sample_name: this.#scanName(sampleId), state: 'planned', reason: null, origin: 'rig', operator: null, plan,
        progress: null, frames_rejected: 0, created_at: new Date().toISOString(), started_at: new Date().toISOString(), ended_at: null,
      },
      frames: [],
      steps: ['cap-lens', 'place-white-reference', 'place-sample'],
    };
    this.scans.unshift(scan);
    this.#progress(scan);
    return scan;
  }

  #shots(scan: MockScan): { kind: string; theta: number; phi: number; exposure: number }[] {
    const { theta_c_deg, phi_s_deg, exposures_s } = scan.body.plan;
    return [
      ...exposures_s.map((exposure) => ({ kind: 'dark', theta: 0, phi: 0, exposure })),
      ...theta_c_deg.map((theta) => ({ kind: 'flat', theta, phi: 0, exposure: exposures_s[0] ?? 0.02 })),
      ...theta_c_deg.flatMap((theta) => phi_s_deg.flatMap((phi) => exposures_s.map((exposure) => ({ kind: 'sample', theta, phi, exposure })))),
    ];
  }

  #progress(scan: MockScan): void {
    const total = this.#shots(scan).length;
    const done = scan.frames.length;
    const phase = this.#shots(scan)[done]?.kind ?? 'done';
    scan.body['progress'] = {
      phase, shots_done: done, shots_total: total, frames_done: done, frames_total: total, fraction: done / total,
      elapsed_s: done * 0.8, time_left_s: (total - done) * 0.8,
    };
  }

  #tell(scan: MockScan): void {
    const { id, sample_id, state, reason, operator, progress } = scan.body as Json;
    this.event('scan', { scan_id: id, sample_id, state, reason, operator, progress });
  }

  #finish(scan: MockScan): void {
    scan.body.state = 'completed';
    scan.body['ended_at'] = new Date().toISOString();
    this.#progress(scan);
    this.#tell(scan);
    if (this.fitsAtEnd) this.addFit(scan.body.id);
  }

  #expose(scan: MockScan, shot: { kind: string; theta: number; phi: number; exposure: number }): void {
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
    this.#progress(scan);
    const { id: frame_id, ...rest } = row;
    this.event('frame', { frame_id, ...rest, progress: scan.body['progress'] });
  }

  #run(scan: MockScan): void {
    if (scan.body.state !== 'running') return;
    const shot = this.#shots(scan)[scan.frames.length];
    if (!shot) return this.#finish(scan);
    const wanted = { dark: 'cap-lens', flat: 'place-white-reference', sample: 'place-sample' }[shot.kind] ?? '';
    if (scan.steps.includes(wanted)) {
      scan.body.state = 'waiting-for-operator';
      scan.body['operator'] = { action: wanted, message: MESSAGES[wanted] };
      return this.#tell(scan);
    }
    this.#expose(scan, shot);
    this.#after(this.frameMs, () => this.#run(scan));
  }

  #finishFit(id: number, variant: string, shaped = false): void {
    const fit = this.fits.find((f) => f['id'] === id);
    const scan = this.scans.find((s) => s.body.id === fit?.['scan_id']);
    const surface = scan ? this.surfaces.get(scan.body.sample_id) : undefined;
    if (!fit || !scan || !surface) return;
    const own = variant === 'auto' ? 'sawtooth' : variant;
    const parameter = (value: number, parts: Json): Json => {
      const std = Math.sqrt(Object.values(parts).reduce<number>((s, p) => s + (p as number) ** 2, 0));
      return { value, std, expanded: 2 * std, coverage_factor: 2, identifiable: true, budget: parts };
    };
    const paper = own === 'paper';
    Object.assign(fit, {
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
    });
    this.event('fit', { fit_id: id, scan_id: scan.body.id, state: 'completed', variant: own, status: 'converged' });
    const wanted = this.specifications.named((scan.body['specification'] as { name: string } | null)?.name);
    if (wanted) this.#judge(scan.body.id, wanted.content, id);
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
  #judge(scanId: number, specification: Json, fitId?: number): Json {
    const fit = this.fits.find((f) => (fitId === undefined ? f['scan_id'] === scanId && f['state'] === 'completed' : f['id'] === fitId));
    const verdict = {
      id: this.verdicts.length + 1, scan_id: scanId, state: 'completed', created_at: new Date().toISOString(), request: { specification, ...(fitId === undefined ? {} : { fit_id: fitId }) },
      ...judged(specification, (fit?.['parameters'] ?? {}) as Record<string, { value: number; expanded: number }>),
    };
    this.verdicts.unshift(verdict);
    this.event('calculation', {});
    return verdict;
  }

  #curve(id: number): Json {
    const fit = this.fits.find((f) => f['id'] === id);
    const scan = this.scans.find((s) => s.body.id === fit?.['scan_id']);
    const surface = scan ? this.surfaces.get(scan.body.sample_id) : undefined;
    if (!scan || !surface) return {};
    const own = String(fit?.['variant']);
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
      fit_id: id, peak,
      observations: points.map((p) => ({
        theta_c_deg: p.theta + 0.0003, phi_s_deg: p.phi - 0.0002, signal: p.signal, sigma: 0.0004 + 0.002 * p.signal, n_frames: 3, predicted: p.predicted,
        residual: (p.signal - p.predicted) / peak,
      })),
      curves: [own, other].flatMap((variant) => theta_c_deg.map((theta) => ({ variant, theta_c_deg: theta, phi_s_deg: phis, signal: phis.map((phi) => of(variant, theta, phi)) }))),
    };
  }

  #image(id: number): Uint8Array {
    const row = this.scans.flatMap((s) => s.frames).find((f) => f['id'] === id);
    const mean = Number(row?.['mean_dn'] ?? 0);
    const noise = random(id);
    const pixels = new Uint16Array(SIZE_PX * SIZE_PX);
    for (let y = 0; y < SIZE_PX; y++) {
      for (let x = 0; x < SIZE_PX; x++) {
        const r2 = ((x - SIZE_PX / 2) ** 2 + (y - SIZE_PX / 2) ** 2) / (SIZE_PX / 2) ** 2;
        const shot = Math.sqrt(2 * mean) * 1.7 * (noise() + noise() + noise() - 1.5);
        pixels[y * SIZE_PX + x] = Math.max(0, Math.min(65535, Math.round(200 + (mean - 200) * (1.03 - 0.06 * r2) + shot)));
      }
    }
    // One known pixel, so that a test can point at it.
    pixels[3 * SIZE_PX + 5] = 12345;
    return encodePng(SIZE_PX, SIZE_PX, pixels, { filter: 2 });
  }

  #rig(): Json {
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

  async #answer(request: IncomingMessage, response: ServerResponse): Promise<void> {
    const url = new URL(request.url ?? '/', 'http://mock');
    const method = request.method ?? 'GET';
    if (!url.pathname.startsWith('/api/v1')) return this.#file(url.pathname, response);
    const path = url.pathname.slice('/api/v1'.length);
    let text = '';
    for await (const part of request) text += String(part);
    const isArchive = request.headers['content-type'] === 'application/zip';
    const body = (isArchive ? { archive: text } : text === '' ? {} : JSON.parse(text)) as Json;
    if (method === 'POST' || method === 'PATCH') this.requests.push({ method, path, body });
    else this.reads.push(url.pathname.slice('/api/v1'.length) + url.search);

    const send = (status: number, answer: unknown, type = 'application/json'): void => {
      response.writeHead(status, { 'content-type': type });
      response.end(answer instanceof Uint8Array ? answer : JSON.stringify(answer));
    };
    const problem = (status: number, code: string, detail: string): void => send(status, { status, code, title: code, detail }, 'application/problem+json');
    const refusal = this.refusals.get(`${method} ${path}`);
    if (refusal) return send(refusal.status, refusal.body, 'application/problem+json');

    if (path === '/session' && method === 'POST') {
      this.#session = this.tokens.get(String(body['token'])) ?? null;
      if (this.#session === null) return problem(401, 'wrong-token', 'the token is not valid, or was revoked');
      return send(200, { ...this.#session, logged_in: true });
    }
    if (path === '/session' && method === 'DELETE') {
      this.#session = null;
      return send(200, { id: null, state: 'logged-out' });
    }
    if (this.tokens.size > 0 && this.#session === null && path !== '/rig/stop') return problem(401, 'no-token', 'send a token, or log in');
    if (path === '/session') return send(200, { who: 'local', role: 'admin', ...this.#session, logged_in: this.#session !== null });
    if (path === '/lease') {
      const own = this.#lease !== null && request.headers['ridged-lease'] === this.#lease;
      if (method === 'GET') return send(200, { holder: this.holder, own });
      if (method === 'POST' && this.holder !== null && !own && body['take_over'] !== true) return problem(409, 'lease-held', 'another caller holds the rig');
      this.#lease = method === 'POST' ? `lease ${this.requests.length}` : null;
      this.holder = method === 'POST' ? { who: this.#session?.who ?? 'local', name: body['name'], until: new Date(Date.now() + 600_000).toISOString() } : null;
      this.event('order', {});
      return method === 'POST' ? send(201, { id: this.#lease, ...this.holder }) : send(200, { id: null, state: 'free' });
    }

    if (path === '/events') {
      response.writeHead(200, { 'content-type': 'text/event-stream', 'cache-control': 'no-store' });
      response.write(': here\n\n');
      this.#streams.add(response);
      response.on('close', () => this.#streams.delete(response));
      return;
    }
    const list = (items: unknown[]): void => send(200, { items, next_cursor: null });
    if (path === '/rig') {
      // A reading connects stages that are not in use.
      if (this.plugged && this.#rig()['scan_id'] === null) this.connected = true;
      return send(200, this.#rig());
    }
    const lookMatch = /^\/rig\/preview\/(\d+)\/image\.png$/.exec(path);
    if (lookMatch) return send(200, picture(Number(lookMatch[1])), 'image/png');
    if (path === '/rig/preview') {
      if (this.#rig()['activity'] !== 'idle') return problem(409, 'busy', 'the rig is busy: scan 1 holds the rig until its end; stop is always allowed');
      this.looks += 1;
      return send(200, lookThrough(this.looks, body['exposures_s'] as number[], Number(body['suggest'] ?? 1), { theta_c_deg: this.axes.theta_c.position_deg, referenced: this.axes.theta_c.referenced }));
    }
    // Orders reconnect a lost link if the stages can be connected.
    if (method === 'POST' && (path.startsWith('/rig/') || path === '/scans') && !this.connected) {
      if (!this.plugged) return problem(503, 'port-missing', 'the serial port /dev/ttyUSB0 does not exist: plug the stage in or correct [bench] port');
      this.connected = true;
    }
    if (path === '/rig/stop') {
      for (const axis of Object.values(this.axes)) axis.moving = false;
      for (const scan of this.scans) {
        if (scan.body.state === 'running') {
          scan.body.state = 'paused';
          scan.body['reason'] = 'stopped';
          this.#tell(scan);
        }
      }
      this.event('rig', {});
      return send(200, { state: 'stopped' });
    }
    if (path === '/rig/home') {
      for (const axis of Object.values(this.axes)) axis.moving = true;
      this.#after(400, () => {
        for (const axis of Object.values(this.axes)) Object.assign(axis, { moving: false, homed: true, position_deg: 0 });
        this.event('rig', {});
      });
      return send(202, { id: null, state: 'homing' });
    }
    if (path === '/rig/jog') {
      const axis = this.axes[body['axis'] as 'theta_c' | 'phi_s'];
      axis.moving = Number(body['speed_deg_s']) !== 0;
      return send(200, { jog: 1, ended: !axis.moving, at_end: null });
    }
    if (path === '/rig/move') {
      const to = { theta_c: Number(body['theta_c_deg']), phi_s: Number(body['phi_s_deg']) };
      for (const axis of Object.values(this.axes)) axis.moving = true;
      this.#after(400, () => {
        for (const name of ['theta_c', 'phi_s'] as const) Object.assign(this.axes[name], { moving: false, position_deg: to[name] });
        this.event('rig', {});
      });
      return send(202, { id: 1, state: 'moving' });
    }
    const axisMatch = /^\/rig\/axes\/(theta_c|phi_s)\/(move|home)$/.exec(path);
    if (axisMatch) {
      const axis = this.axes[axisMatch[1] as 'theta_c' | 'phi_s'];
      const target = axisMatch[2] === 'home' ? 0 : Number(body['position_deg']);
      axis.moving = true;
      this.#after(400, () => {
        if (!axis.moving) return;
        axis.moving = false;
        axis.homed = true;
        axis.referenced = true;
        axis.position_deg = target;
        this.event('rig', {});
      });
      return send(202, { id: null, state: 'moving' });
    }
    if (path === '/samples' && method === 'POST') {
      const id = this.addSample(String(body['name']), { theta_r_deg: 12, alpha_u: 0.1, alpha_v: 0.1, rho_d: 0.2 });
      const sample = this.samples.find((s) => s['id'] === id);
      if (sample) sample['material'] = body['material'] ?? { kind: 'conductor', eta: 3.12, k: 3.33, eta_std: 0.1, k_std: 0.1 };
      return send(201, sample);
    }
    const ofScan = (row: Json): boolean => row['scan_id'] === Number(url.searchParams.get('scan_id'));
    if (path === '/verdicts' && method === 'GET') return list(this.verdicts.filter(ofScan));
    if (path === '/verdicts') {
      const named = typeof body['specification'] === 'string' ? this.specifications.named(body['specification'])?.content : (body['specification'] as Json);
      if (!named) return problem(422, 'invalid-value', 'there is no such specification');
      return send(202, { id: this.#judge(Number(body['scan_id']), named, body['fit_id'] as number | undefined)['id'], state: 'completed' });
    }
    if (['/maps', '/contrasts'].includes(path) && method === 'GET') return list(path === '/maps' && this.mapped.includes(Number(url.searchParams.get('scan_id'))) ? [finishedMap(Number(url.searchParams.get('scan_id')))] : []);
    const mapFile = /^\/maps\/1\/files\/(.+)$/.exec(path);
    if (mapFile) {
      const file = mapFiles().get(mapFile[1] ?? '');
      return file ? send(200, file, 'application/octet-stream') : problem(404, 'not-found', 'no such file');
    }
    const verdictMatch = /^\/verdicts\/(\d+)$/.exec(path);
    if (verdictMatch) return send(200, this.verdicts.find((v) => v['id'] === Number(verdictMatch[1])) ?? {});
    const report = /^\/scans\/(\d+)\/report$/.exec(path);
    if (report) return send(200, new TextEncoder().encode(`<!doctype html><title>Report</title><h1>Report of scan ${report[1]}</h1>`), 'text/html; charset=utf-8');
    for (const [root, kind] of [['/recipes', this.recipes], ['/specifications', this.specifications]] as const) {
      if (path !== root && !path.startsWith(`${root}/`)) continue;
      const answer = kind.answer(method, path.slice(root.length), url.searchParams, body);
      return send(answer.status, answer.body, answer.status < 400 ? 'application/json' : 'application/problem+json');
    }
    if (path === '/samples') return list(this.samples);
    if (path === '/queue/orders' && method === 'POST') {
      for (const order of body['orders'] as Json[]) {
        const id = this.orders.length + 1;
        const name = (of: unknown): Json | null => (of === undefined ? null : { id: 1, name: of });
        this.orders.push({ lot: null, external_id: null, reason: null, scan_id: null, part: this.#scanName(Number(order['sample_id'])), ...order, id, state: 'waiting', recipe: name(order['recipe']), specification: name(order['specification']) });
      }
      return send(201, { items: this.orders.slice(-1), next_cursor: null });
    }
    if (path === '/queue/orders') return list(this.orders.filter((o) => o['state'] === (url.searchParams.get('state') ?? 'waiting')));
    const orderMatch = /^\/queue\/orders\/(\d+)(?:\/(move|retry))?$/.exec(path);
    if (orderMatch) {
      const order = this.orders.find((o) => o['id'] === Number(orderMatch[1]));
      if (!order) return problem(404, 'not-found', `there is no order ${orderMatch[1]}`);
      if (method === 'DELETE') order['state'] = 'removed';
      else if (orderMatch[2] === 'retry' && order['state'] !== 'failed') return problem(409, 'state-conflict', `order ${orderMatch[1]} is ${String(order['state'])}`);
      else this.orders = [Object.assign(order, { state: 'waiting' }), ...this.orders.filter((o) => o !== order)];
      return send(200, order);
    }
    const queueMatch = /^\/queue\/(start|stop|pause)$/.exec(path);
    if (queueMatch) this.queueState = { start: 'running', stop: 'stopped', pause: 'paused' }[String(queueMatch[1])] ?? 'stopped';
    if (queueMatch || path === '/queue') {
      return send(200, { state: this.queueState, reason: null, who: null, changed_at: null, message: `The queue is ${this.queueState}.`, current: null, next: null, counts: { waiting: 0, running: 0, done: 0, failed: 0, removed: 0 }, on_failure: 'stop' });
    }
    const sampleMatch = /^\/samples\/(\d+)$/.exec(path);
    if (sampleMatch && method === 'PATCH') {
      const sample = this.samples.find((s) => s['id'] === Number(sampleMatch[1]));
      if (!sample) return problem(404, 'not-found', `there is no part ${sampleMatch[1]}`);
      sample['earlier_names'] = [...(sample['earlier_names'] as Json[]), { name: sample['name'], until: new Date().toISOString() }];
      sample['name'] = body['name'];
      for (const scan of this.scans.filter((s) => s.body.sample_id === sample['id'])) scan.body['sample_name'] = body['name'];
      return send(200, sample);
    }
    if ((path === '/scans' && method === 'POST') || path === '/scans/estimate') {
      const recipe = this.recipes.named(body['recipe']);
      const asked = (recipe?.content['plan'] ?? body['plan']) as Json;
      const plan = { poses: [], exposures_s: [0.02, 0.06, 0.18], repeats: 1, ...PRESETS[String(asked['preset'])], ...asked } as MockScan['body']['plan'];
      const beyond = plan.theta_c_deg.findIndex((t) => Math.abs(t) > 60);
      if (beyond >= 0) {
        return send(422, { status: 422, code: 'plan-invalid', title: 'the plan cannot run', detail: 'the plan goes beyond the travel of an axis', errors: [{ field: `plan.theta_c_deg[${beyond}]`, message: `${plan.theta_c_deg[beyond]}° is beyond the limit of 60°` }] }, 'application/problem+json');
      }
      if (path === '/scans/estimate') {
        const n = 3 + plan.theta_c_deg.length + plan.theta_c_deg.length * plan.phi_s_deg.length * plan.exposures_s.length * plan.repeats;
        return send(200, { n_frames: n, n_shots: n, duration_s: 0.8 * n, disk_bytes: 25000 * n, disk_free_bytes: 61e9, operator_steps: Object.entries(MESSAGES).map(([action, message]) => ({ action, message })), plan, calibration_ids: asked['reuse_calibrations'] === false ? [] : this.calibrations.map((c) => c['id']) });
      }
      const scan = this.#newScan(Number(body['sample_id']), plan);
      const { lot = null, external_id = null, operator_name = null } = body;
      Object.assign(scan.body, { lot, external_id, operator_name, recipe: recipe?.ref ?? null, specification: this.specifications.named(body['specification'])?.ref ?? null, target_expanded_deg: recipe?.content['target_expanded_deg'] ?? null });
      scan.body.state = 'running';
      this.#tell(scan);
      this.#after(50, () => this.#run(scan));
      return send(202, { id: scan.body.id, state: 'planned' });
    }
    if (path === '/results') return send(200, resultsPage(resultRows(this), url.searchParams));
    if (path === '/due') return send(200, { items: this.due });
    if (path === '/charts') {
      const asked = new URLSearchParams(url.searchParams);
      const [parameter, limitsOf] = [asked.get('parameter') ?? 'theta_r_deg', asked.get('limits_of')];
      asked.delete('parameter');
      asked.delete('limits_of');
      asked.set('sort', 'created_at');
      asked.set('limit', '1000');
      const rows = resultsPage(resultRows(this), asked).items;
      const specification = (name: string) => (this.specifications.named(name)?.content ?? null) as { name: string; limits: Record<string, object> } | null;
      const chart = resultChart({ rows, parameter, limitsOf, filter: asked.get('specification'), specification, verdict: (id) => this.verdicts.find((v) => v['id'] === id), due: this.due });
      return chart ? send(200, chart) : problem(422, 'invalid-value', `limits_of: there is no specification \`${limitsOf}\``);
    }
    if (path === '/scans') return list(this.scans.map((s) => s.body).filter((b) => b['archived'] !== true));
    if (path === '/comparisons' || path === '/repeatability') {
      const found = url.searchParams.getAll('scan_id').map((id) => ({ scan: this.scans.find((s) => s.body.id === Number(id))?.body, fit: this.fits.find((f) => f['scan_id'] === Number(id) && f['state'] === 'completed'), id: Number(id) }));
      const results = found.filter((r) => r.scan && r.fit) as unknown as MockResult[];
      const without = found.filter((r) => !r.fit).map((r) => r.id);
      const shared = url.searchParams.get('shared');
      if (path === '/repeatability') return send(200, repeatability(results, without, shared, url.searchParams.get('by')));
      const [a, b] = results;
      if (!a || !b) return problem(409, 'no-fit', `scan ${without[0]} has nothing to report: it has no completed fit; fit it on its page`);
      return send(200, comparison(a, b, shared));
    }
    const scanMatch = /^\/scans\/(\d+)(?:\/(\w+))?$/.exec(path);
    if (scanMatch) {
      const scan = this.scans.find((s) => s.body.id === Number(scanMatch[1]));
      if (!scan) return problem(404, 'not-found', `there is no scan ${scanMatch[1]}`);
      const verb = scanMatch[2];
      if (verb === 'changes') return list(this.changes.filter((c) => c['scan_id'] === scan.body.id));
      if (method === 'PATCH' && body['sample_id'] === undefined) {
        Object.assign(scan.body, body);
        const { tags, note, archived } = scan.body as Json;
        this.changes.push({ id: this.changes.length + 1, scan_id: scan.body.id, who: 'local', at: new Date().toISOString(), tags, note, archived });
        this.event('order', {});
        return send(200, scan.body);
      }
      if (method === 'PATCH') {
        scan.body['earlier_samples'] = [{ sample_id: scan.body.sample_id, sample_name: scan.body['sample_name'], until: new Date().toISOString() }];
        scan.body.sample_id = Number(body['sample_id']);
        scan.body['sample_name'] = this.#scanName(scan.body.sample_id);
        return send(200, scan.body);
      }
      if (verb === undefined) return send(200, scan.body);
      if (verb === 'frames') return list(scan.frames);
      if (verb === 'uncertainty') return list(this.certainties);
      if (verb === 'incidents') return list([]);
      if (verb === 'observations') {
        if (!scan.frames.some((f) => f['kind'] === 'sample')) return problem(422, 'no-observations', 'no observation is left');
        if (this.regions.length > 0 && !url.searchParams.has('region')) return problem(422, 'invalid-value', 'the part has several regions: name one of them');
        const surface = this.surfaces.get(scan.body.sample_id);
        const poses = new Map(scan.frames.filter((f) => f['kind'] === 'sample').map((f) => [`${String(f['theta_c_deg'])} ${String(f['phi_s_deg'])}`, f]));
        return list([...poses.values()].map((f) => {
          const signal = surface ? radiance(surface, Number(f['theta_c_deg']), Number(f['phi_s_deg'])) : 0;
          return { theta_c_deg: f['theta_c_deg'], phi_s_deg: f['phi_s_deg'], signal, sigma: 0.0004 + 0.002 * signal, n_frames: 3 };
        }));
      }
      if (verb === 'continue') {
        if (scan.body.state !== 'waiting-for-operator') return problem(409, 'state-conflict', `scan ${scan.body.id} is ${scan.body.state}: there is no step to continue`);
        const step = (scan.body['operator'] as { action: string } | null)?.action;
        if (body['action'] !== step) return problem(409, 'other-step', `scan ${scan.body.id} waits for ${step}, not for ${String(body['action'])}`);
        scan.steps.shift();
        scan.body['operator'] = null;
      }
      scan.body.state = { pause: 'paused', resume: 'running', continue: 'running', abort: 'aborted' }[verb] ?? scan.body.state;
      scan.body['reason'] = null;
      this.#tell(scan);
      if (scan.body.state === 'running') this.#after(5, () => this.#run(scan));
      return send(202, { id: scan.body.id, state: scan.body.state });
    }
    const calibration = /^\/calibrations\/(\d+)$/.exec(path);
    if (path === '/calibrations') return list(this.calibrations.filter((c) => !url.searchParams.has('scan_id') || c['scan_id'] === Number(url.searchParams.get('scan_id'))));
    if (calibration) return send(200, this.calibrations.find((c) => c['id'] === Number(calibration[1])));
    const imageMatch = /^\/frames\/(\d+)\/image\.png$/.exec(path);
    const previewMatch = /^\/frames\/(\d+)\/preview\.png$/.exec(path);
    if (previewMatch) {
      response.setHeader('x-low-dn', '210');
      response.setHeader('x-high-dn', '23456');
      return send(200, picture(Number(previewMatch[1])), 'image/png');
    }
    if (imageMatch) return send(200, this.#image(Number(imageMatch[1])), 'image/png');
    if ((path === '/imports' || path === '/imports/upload') && method === 'POST') {
      const id = this.addScan(1, 'paper');
      Object.assign(this.scans.find((s) => s.body.id === id)?.body ?? {}, { origin: 'import' });
      return send(201, { scan_id: id, sample_id: 1, n_frames: 48, skipped: ['frames/7.png'], same_as_scan_id: null });
    }
    if (path === '/fits' && method === 'POST') {
      const id = this.fits.length + 1;
      this.fits.unshift({ id, scan_id: body['scan_id'], request: body, state: 'running', created_at: new Date().toISOString(), progress: { stage: 'tracing', fraction: 0.25, time_left_s: 42 }, forecast: { seconds: 50, at_most: false, cut_short: false, amount: { count: 108, of: 'poses' } } });
      if (this.fitMs !== null) this.#after(this.fitMs, () => this.#finishFit(id, String(body['variant']), body['shape'] !== undefined));
      return send(202, { id, state: 'running' });
    }
    if (path === '/fits') {
      const [limit, from, of] = [url.searchParams.get('limit'), url.searchParams.get('cursor'), url.searchParams.get('scan_id')];
      const rows = this.fits.filter((f) => of === null || f['scan_id'] === Number(of));
      const begin = Number(from ?? 0);
      const end = begin + Number(limit ?? 100);
      return send(200, { items: rows.slice(begin, end), next_cursor: end < rows.length ? String(end) : null });
    }
    const fitMatch = /^\/fits\/(\d+)(\/curve)?$/.exec(path);
    const cancelled = /^\/fits\/(\d+)\/cancel$/.exec(path);
    if (cancelled) {
      Object.assign(this.fits.find((f) => f['id'] === Number(cancelled[1])) ?? {}, { state: 'cancelled', progress: undefined });
      return send(202, { id: Number(cancelled[1]), state: 'cancelled' });
    }
    if (fitMatch) {
      const id = Number(fitMatch[1]);
      const fit = this.fits.find((f) => f['id'] === id);
      return fit ? send(200, fitMatch[2] ? this.#curve(id) : fit) : problem(404, 'not-found', `there is no fit ${id}`);
    }
    if (path === '/traces' && method === 'POST') {
      const id = this.traces.length + 1;
      this.traces.unshift({ id, scan_id: null, state: 'running', created_at: new Date().toISOString(), request: { max_seconds: null, target_error: null, ...body }, progress: { stage: 'tracing photons', fraction: 0.25, time_left_s: 42 } });
      return send(202, { id, state: 'running' });
    }
    if (path === '/traces') return list(this.traces);
    const traceMatch = /^\/traces\/(\d+)\/(cancel|files\/(.+))$/.exec(path);
    if (traceMatch) {
      const trace = this.traces.find((t) => t['id'] === Number(traceMatch[1]));
      if (traceMatch[2] === 'cancel' && trace) {
        Object.assign(trace, { state: 'cancelled', progress: undefined });
        this.event('calculation', {});
        return send(202, { id: trace['id'], state: 'cancelled' });
      }
      const file = traceFiles().get(traceMatch[3] ?? '');
      return file ? send(200, file, 'application/octet-stream') : problem(422, 'invalid-value', 'no such file');
    }
    if (path === '/accuracy' && this.accuracy) return send(200, this.accuracy);
    if (path === '/accuracy') {
      response.writeHead(204).end();
      return;
    }
    return problem(404, 'not-found', `there is no ${path}`);
  }

  async #file(path: string, response: ServerResponse): Promise<void> {
    const name = normalize(path === '/' ? '/index.html' : path);
    try {
      const bytes = await readFile(join(this.#settings.dist, name));
      response.writeHead(200, { 'content-type': TYPES[extname(name)] ?? 'application/octet-stream' }).end(bytes);
    } catch {
      response.writeHead(404).end();
    }
  }
}
