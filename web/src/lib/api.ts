// The page's only way to the daemon: typed requests. A failure is thrown as a `Problem`.

import type { FitOptions } from './fitoptions';
import type { PlanRequest } from './plan';
import { noAnswer, problemOf } from './problems';
import type { SampleRequest } from './newsample';
import type { ShapeRequest } from './shape';
import type {
  AxisName,
  Calibration,
  Certainty,
  Due,
  Estimate,
  Fit,
  FrameRow,
  Incident,
  JobKind,
  Jog,
  LeaseState,
  LeaseTaken,
  NewOrder,
  OperatorStep,
  Page,
  Preview,
  Queue,
  QueueOrder,
  RefusedStages,
  ResultRow,
  Rig,
  Sample,
  Scan,
  ScanJob,
  Session,
  StoredRecipe,
  StoredSpecification,
} from './types';

export const PREFIX = '/api/v1';

/** A fit has about 20 kB, so a store of thousands is read page by page. */
const FITS_PER_PAGE = 100;

/** Seconds from the last request of this page to the end of its lease. A page in the background asks once a minute at least. */
export const LEASE_S = 150;

/** The lease of this page, which a reload keeps. */
export const ownLease = {
  id: (): string | null => sessionStorage.getItem('ridged-lease'),
  keep: (id: string): void => sessionStorage.setItem('ridged-lease', id),
  forget: (): void => sessionStorage.removeItem('ridged-lease'),
};

let askForLogin = (_code: string): void => undefined;

/** Calls `then` with the code of the refusal when the daemon asks for a token. */
export function whenLoginIsNeeded(then: (code: string) => void): void {
  askForLogin = then;
}

/** Headers that show the daemon that the page, and not a form of another one, sends the request, with the lease of this page. */
export function ownHeaders(init?: HeadersInit): Headers {
  const headers = new Headers(init);
  headers.set('ridged-request', '1');
  const id = ownLease.id();
  if (id !== null) headers.set('ridged-lease', id);
  return headers;
}

export async function ask(path: string, init: RequestInit = {}): Promise<Response> {
  let response: Response;
  try {
    response = await fetch(path, { ...init, headers: ownHeaders(init.headers) });
  } catch (cause) {
    if (cause instanceof DOMException && cause.name === 'AbortError') throw cause;
    throw noAnswer();
  }
  if (response.ok) return response;
  const body: unknown = await response.json().catch(() => null);
  const problem = problemOf(response.status, body, `the daemon answered ${response.status} ${response.statusText}`);
  if (response.status === 401) askForLogin(problem.code);
  throw problem;
}

export async function get<T>(path: string, signal?: AbortSignal): Promise<T> {
  const response = await ask(PREFIX + path, { headers: { accept: 'application/json' }, ...(signal ? { signal } : {}) });
  return (await response.json()) as T;
}

export async function post<T>(path: string, body?: unknown, method: 'POST' | 'DELETE' | 'PATCH' = 'POST', signal?: AbortSignal): Promise<T> {
  const init: RequestInit = { method, ...(signal ? { signal } : {}) };
  if (body !== undefined) {
    init.headers = { 'content-type': 'application/json' };
    init.body = JSON.stringify(body);
  }
  const response = await ask(PREFIX + path, init);
  const text = await response.text();
  return (text === '' ? null : JSON.parse(text)) as T;
}

/** All pages of a list. */
export async function getAll<T>(path: string, signal?: AbortSignal): Promise<T[]> {
  const items: T[] = [];
  let cursor: string | null = null;
  do {
    const separator = path.includes('?') ? '&' : '?';
    const page: Page<T> = await get(
      `${path}${separator}limit=1000${cursor === null ? '' : `&cursor=${encodeURIComponent(cursor)}`}`,
      signal,
    );
    items.push(...page.items);
    cursor = page.next_cursor;
  } while (cursor !== null);
  return items;
}

/** Body of `POST /scans`: of a plan, or of a recipe. */
export interface ScanRequest {
  readonly sample_id: number;
  readonly plan?: PlanRequest;
  /** Name of the recipe. */
  readonly recipe?: string;
  /** Name of the specification. */
  readonly specification?: string;
  readonly lot?: string;
  readonly external_id?: string;
  readonly operator_name?: string;
}

/** Body of `POST /fits`. */
export interface FitRequest extends FitOptions {
  readonly scan_id: number;
  readonly variant: string;
  readonly region?: string;
  /** The measured surface for the variant `traced`. */
  readonly shape?: ShapeRequest;
}

/** An 8-bit picture of a frame. */
export interface FramePicture {
  readonly bitmap: ImageBitmap;
  /** Count that is black; 0.2 % of the pixels are below. */
  readonly low: number;
  /** Count that is white; 0.2 % of the pixels are above. */
  readonly high: number;
}

export const api = {
  session: (): Promise<Session> => get('/session'),
  login: (token: string): Promise<Session> => post('/session', { token }),
  logout: (): Promise<unknown> => post('/session', undefined, 'DELETE'),
  lease: (): Promise<LeaseState> => get('/lease'),
  takeLease: (name: string, take_over: boolean): Promise<LeaseTaken> => post('/lease', { name, take_over, seconds: LEASE_S }),
  returnLease: (): Promise<unknown> => post('/lease', undefined, 'DELETE'),

  rig: (signal?: AbortSignal): Promise<Rig> => get('/rig', signal),
  move: (axis: AxisName, position_deg: number): Promise<unknown> => post(`/rig/axes/${axis}/move`, { position_deg }),
  moveBoth: (pose: { readonly theta_c_deg: number; readonly phi_s_deg: number }): Promise<unknown> => post('/rig/move', pose),
  home: (axis: AxisName): Promise<unknown> => post(`/rig/axes/${axis}/home`),
  /** Homes both axes in the order of the settings. */
  homeBoth: (): Promise<unknown> => post('/rig/home'),
  /** Begins a jog, or renews or ends (speed 0) the one with this number. */
  jog: (body: { readonly axis: AxisName; readonly speed_deg_s: number; readonly jog?: number }): Promise<Jog> => post('/rig/jog', body),
  /** Looks through the camera at the present pose; nothing moves. */
  preview: (body: { readonly exposures_s: readonly number[]; readonly suggest: number }, signal?: AbortSignal): Promise<Preview> => post('/rig/preview', body, 'POST', signal),
  /** Accepts the controllers that answer instead of those of the rig. */
  acceptStages: (stages: RefusedStages): Promise<unknown> =>
    post('/rig/accept-stages', { theta_c_serial: stages.theta_c.serial, phi_s_serial: stages.phi_s.serial }),
  /** Reconnects first if the link is lost; no motion starts. */
  stop: (): Promise<unknown> => post('/rig/stop'),

  recipes: (): Promise<StoredRecipe[]> => getAll('/recipes'),
  specifications: (signal?: AbortSignal): Promise<StoredSpecification[]> => getAll('/specifications', signal),
  /** The newest results: one row per scan, several for a part with regions. */
  verdictWords: async (limit: number, signal?: AbortSignal): Promise<readonly ResultRow[]> => (await get<Page<ResultRow>>(`/results?fields=scan_id,region,verdict,verdict_matches&limit=${limit}`, signal)).items,
  /** What the settings ask to measure again at intervals, due or not. */
  due: async (): Promise<readonly Due[]> => (await get<Page<Due>>('/due')).items,
  queue: (): Promise<Queue> => get('/queue'),
  /** Orders that run or wait, in sequence. */
  queueOrders: (): Promise<QueueOrder[]> => getAll('/queue/orders'),
  failedOrders: (): Promise<QueueOrder[]> => getAll('/queue/orders?state=failed'),
  addOrders: (orders: readonly NewOrder[]): Promise<unknown> => post('/queue/orders', { orders }),
  /** Moves an order to a place among those that wait, from 1. */
  moveOrder: (id: number, to: number): Promise<unknown> => post(`/queue/orders/${id}/move`, { to }),
  /** Lets a failed order wait again, as the next one. */
  retryOrder: (id: number): Promise<unknown> => post(`/queue/orders/${id}/retry`),
  removeOrder: (id: number): Promise<unknown> => post(`/queue/orders/${id}`, undefined, 'DELETE'),
  /** Starts the queue, or resumes a paused one. */
  startQueue: (): Promise<unknown> => post('/queue/start'),
  /** Stops the queue after the present order. */
  stopQueue: (): Promise<unknown> => post('/queue/stop'),
  pauseQueue: (): Promise<unknown> => post('/queue/pause'),

  samples: (): Promise<Sample[]> => getAll('/samples'),
  renameSample: (id: number, name: string): Promise<Sample> => post(`/samples/${id}`, { name }, 'PATCH'),
  addSample: (request: SampleRequest): Promise<Sample> => post('/samples', request),

  scans: (): Promise<Scan[]> => getAll('/scans'),
  scan: (id: number): Promise<Scan> => get(`/scans/${id}`),
  /** Assigns a scan to the part that was really scanned. */
  assignScan: (id: number, sample_id: number): Promise<Scan> => post(`/scans/${id}`, { sample_id }, 'PATCH'),
  /** Changes tags, note or archived flag of a scan. */
  changeRecord: (id: number, to: Partial<Pick<Scan, 'tags' | 'note' | 'archived'>>): Promise<Scan> => post(`/scans/${id}`, to, 'PATCH'),
  startScan: (request: ScanRequest): Promise<{ id: number }> => post('/scans', request),
  /** Takes dark and white-reference frames only. Returns the scan that takes them. */
  takeCalibrations: (request: Pick<ScanRequest, 'sample_id' | 'plan'>): Promise<{ id: number }> => post('/calibrations', request),
  estimate: (request: ScanRequest): Promise<Estimate> => post('/scans/estimate', request),
  command: (id: number, verb: 'pause' | 'resume' | 'abort'): Promise<unknown> => post(`/scans/${id}/${verb}`),
  /** Confirms one step by its name, since another page or terminal may have confirmed it already. */
  proceed: (id: number, action: OperatorStep['action']): Promise<unknown> => post(`/scans/${id}/continue`, { action }),
  calibration: (id: number, signal?: AbortSignal): Promise<Calibration> => get(`/calibrations/${id}`, signal),
  frames: (id: number, signal?: AbortSignal): Promise<FrameRow[]> => getAll(`/scans/${id}/frames`, signal),
  certainties: (id: number, signal?: AbortSignal): Promise<Certainty[]> => getAll(`/scans/${id}/uncertainty`, signal),
  incidents: (id: number, signal?: AbortSignal): Promise<Incident[]> => getAll(`/scans/${id}/incidents`, signal),

  reportUrl: (scan: number, fit: number, format: 'html' | 'json'): string => `${PREFIX}/scans/${scan}/report?fit_id=${fit}&format=${format}`,

  /** A page of fits of one scan, or of all scans; newest first. */
  fits: (of: { readonly scan_id?: number; readonly cursor?: string } = {}, signal?: AbortSignal): Promise<Page<Fit>> =>
    get(`/fits?limit=${FITS_PER_PAGE}${of.scan_id === undefined ? '' : `&scan_id=${of.scan_id}`}${of.cursor === undefined ? '' : `&cursor=${encodeURIComponent(of.cursor)}`}`, signal),
  fit: (id: number): Promise<Fit> => get(`/fits/${id}`),
  startFit: (request: FitRequest): Promise<{ id: number }> => post('/fits', request),

  /** Jobs of a kind of one scan, newest first. */
  jobsOf: (kind: JobKind, scan_id: number, signal?: AbortSignal): Promise<ScanJob[]> => getAll(`/${kind}?scan_id=${scan_id}`, signal),
  cancelJob: (kind: JobKind, id: number): Promise<unknown> => post(`/${kind}/${id}/cancel`),

  /** A small 8-bit picture of a frame, and the counts of its black and white. */
  async framePreview(id: number, width: number, signal?: AbortSignal): Promise<FramePicture> {
    const response = await ask(`${PREFIX}/frames/${id}/preview.png?width=${width}`, signal ? { signal } : undefined);
    const end = (name: string): number => Number(response.headers.get(name));
    return { bitmap: await createImageBitmap(await response.blob()), low: end('x-low-dn'), high: end('x-high-dn') };
  },
};
