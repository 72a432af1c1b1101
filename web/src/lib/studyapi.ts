// Requests of the later views: curves, records, jobs, definitions, traces, maps, accuracy, comparisons, imports, and files. They are apart so that the first view stays small.

import { ask, get, getAll, post, PREFIX } from './api';
import type {
  Accuracy,
  Calibration,
  Comparison,
  CurvePoint,
  Curves,
  FrameRow,
  GaugeBy,
  Imported,
  Job,
  JobKind,
  Page,
  RecordChange,
  Repeatability,
  ResultChart,
  ResultRow,
  StoredDefinition,
  Trace,
  TracePlane,
} from './types';

/** Kinds of definitions, as they appear in paths. */
export type DefinitionKind = 'recipes' | 'specifications';

/** Body of `POST /traces`; `scene` is the text of its TOML. */
export interface TraceRequest {
  /** Content in base64 of the files that the scene names by `path`. */
  readonly files?: Readonly<Record<string, string>>;
  readonly scene: string;
  readonly photons?: number;
  readonly max_seconds?: number;
  readonly target_error?: number;
  readonly compare: boolean;
  /** Number of random surfaces of the same statistics, the scene's own included. */
  readonly surfaces?: number;
}

/** The scans of a study, and the lines of the budget that they share. */
function studied(scans: readonly number[], shared: readonly string[] | null): string {
  const ids = scans.map((id) => `scan_id=${id}`).join('&');
  return shared === null ? ids : `${ids}&shared=${shared.length === 0 ? 'none' : shared.join(',')}`;
}

export const studyApi = {
  recordChanges: (id: number, signal?: AbortSignal): Promise<RecordChange[]> => getAll(`/scans/${id}/changes`, signal),
  calibrationsOf: async (scanId: number, signal?: AbortSignal): Promise<readonly Calibration[]> => (await get<Page<Calibration>>(`/calibrations?scan_id=${scanId}`, signal)).items,
  /** The newest calibrations, newest first. */
  calibrations: async (limit: number, signal?: AbortSignal): Promise<readonly Calibration[]> => (await get<Page<Calibration>>(`/calibrations?limit=${limit}`, signal)).items,
  observations: (id: number, region: string | null, signal?: AbortSignal): Promise<Omit<CurvePoint, 'predicted' | 'residual'>[]> =>
    getAll(`/scans/${id}/observations${region === null ? '' : `?region=${encodeURIComponent(region)}`}`, signal),
  observationsCsvUrl: (id: number, region: string | null): string => `${PREFIX}/scans/${id}/observations?format=csv${region === null ? '' : `&region=${encodeURIComponent(region)}`}`,
  /** A page of results; `query` has filters, order and fields. */
  results: (query: string, { limit, cursor = null }: { readonly limit: number; readonly cursor?: string | null }, signal?: AbortSignal): Promise<Page<ResultRow> & { readonly count?: number }> => {
    const params = new URLSearchParams(query);
    params.set('limit', String(limit));
    if (cursor === null) params.set('count', 'true');
    else params.set('cursor', cursor);
    return get(`/results?${params.toString()}`, signal);
  },
  /** All results that the filters select, as CSV. */
  resultsCsvUrl: (query: string): string => `${PREFIX}/results?format=csv${query === '' ? '' : `&${query}`}`,
  /** The control chart of a parameter; `query` has the parameter, filters, and the specification whose limits are beside it. */
  chart: (query: string, signal?: AbortSignal): Promise<ResultChart> => get(`/charts?${query}`, signal),
  /** Frames, poses, observations and fit as one file. */
  nexusUrl: (scan: number): string => `${PREFIX}/scans/${scan}/scan.nxs`,
  curves: (id: number, signal?: AbortSignal): Promise<Curves> => get(`/fits/${id}/curve?step_deg=2`, signal),
  startJob: (kind: JobKind, request: Record<string, unknown>): Promise<{ id: number }> => post(`/${kind}`, request),
  jobUrl: (kind: JobKind, id: number): string => `${PREFIX}/${kind}/${id}`,
  job: <T extends Job>(kind: JobKind, id: number, signal?: AbortSignal): Promise<T> => get(`/${kind}/${id}`, signal),
  archived: (kind: DefinitionKind): Promise<StoredDefinition[]> => getAll(`/${kind}?archived=true`),
  /** All versions, newest first. */
  versions: (kind: DefinitionKind, id: number, signal?: AbortSignal): Promise<StoredDefinition[]> => getAll(`/${kind}/${id}/versions`, signal),
  addDefinition: (kind: DefinitionKind, content: object): Promise<StoredDefinition> => post(`/${kind}`, content),
  /** Adds a version; `replaces` is the one that it was made from. */
  addVersion: (kind: DefinitionKind, id: number, replaces: number, content: object): Promise<StoredDefinition> =>
    post(`/${kind}/${id}/versions`, { replaces, [kind === 'recipes' ? 'recipe' : 'specification']: content }),
  archive: (kind: DefinitionKind, id: number): Promise<unknown> => post(`/${kind}/${id}/archive`),
  restore: (kind: DefinitionKind, id: number): Promise<unknown> => post(`/${kind}/${id}/restore`),
  /** The fitted surface as a material for renderers. */
  surfaceUrl: (scan: number, fit: number): string => `${PREFIX}/scans/${scan}/surface.bsdf?fit_id=${fit}`,
  /** Imports a recorded series from a folder of the daemon's machine. */
  importSeries: (folder: string, skip_unreadable: boolean): Promise<Imported> => post('/imports', { folder, skip_unreadable }),
  /** Two scans by their newest fits; `shared` states the lines of the budget with the same error in both, null leaves it to the records. */
  compare: (scans: readonly [number, number], shared: readonly string[] | null, signal?: AbortSignal): Promise<Comparison> => get(`/comparisons?${studied(scans, shared)}`, signal),
  /** Scatter of several scans, and gauge R&R over operators or days. */
  repeatability: (scans: readonly number[], shared: readonly string[] | null, by: GaugeBy | null, signal?: AbortSignal): Promise<Repeatability> =>
    get(`/repeatability?${studied(scans, shared)}${by === null ? '' : `&by=${by}`}`, signal),
  mapFileUrl: (id: number, name: string): string => `${PREFIX}/maps/${id}/files/${name}`,
  mapBytes: async (id: number, name: string, signal?: AbortSignal): Promise<ArrayBuffer> =>
    (await ask(`${PREFIX}/maps/${id}/files/${name}`, signal ? { signal } : undefined)).arrayBuffer(),
  /** The newest 50 traces, newest first. */
  traces: async (signal?: AbortSignal): Promise<readonly Trace[]> => (await get<Page<Trace>>('/traces?limit=50', signal)).items,
  startTrace: (request: TraceRequest): Promise<{ id: number }> => post('/traces', request),
  traceFileUrl: (id: number, name: string): string => `${PREFIX}/traces/${id}/files/${name}`,
  tracePlane: (id: number, signal?: AbortSignal): Promise<TracePlane> => get(`/traces/${id}/files/plane.json`, signal),
  traceBytes: async (id: number, name: string, signal?: AbortSignal): Promise<ArrayBuffer> =>
    (await ask(`${PREFIX}/traces/${id}/files/${name}`, signal ? { signal } : undefined)).arrayBuffer(),
  /** Null if nothing was measured. */
  accuracy: async (signal?: AbortSignal): Promise<Accuracy | null> => {
    const response = await ask(`${PREFIX}/accuracy`, signal ? { signal } : undefined);
    return response.status === 204 ? null : ((await response.json()) as Accuracy);
  },
  accuracyUrl: (): string => `${PREFIX}/accuracy`,
  /** The bytes of a frame's file. */
  async frameBytes(row: FrameRow, signal?: AbortSignal): Promise<Uint8Array<ArrayBuffer>> {
    const response = await ask(row.image, signal ? { signal } : undefined);
    return new Uint8Array(await response.arrayBuffer());
  },
};
