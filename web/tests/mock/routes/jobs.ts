// Fits, maps, contrasts, verdicts, traces and measured errors.

import type { Ask, Json } from '../ask';
import type { MockLab } from '../lab';
import { fittedCurves } from '../fit';
import { finishedMap, mapFiles } from '../maps';
import { traceFiles } from '../trace';

export function answerJobs(lab: MockLab, { method, path, query, body, response, send, list, problem }: Ask): boolean {
  const ofScan = (row: Json): boolean => row['scan_id'] === Number(query.get('scan_id'));
  if (path === '/verdicts' && method === 'GET') return list(lab.verdicts.filter(ofScan));
  if (path === '/verdicts') {
    const named = typeof body['specification'] === 'string' ? lab.specifications.named(body['specification'])?.content : (body['specification'] as Json);
    if (!named) return problem(422, 'invalid-value', 'there is no such specification');
    return send(202, { id: lab.judge(Number(body['scan_id']), named, body['fit_id'] as number | undefined)['id'], state: 'completed' });
  }
  if (['/maps', '/contrasts'].includes(path) && method === 'GET') return list(path === '/maps' && lab.mapped.includes(Number(query.get('scan_id'))) ? [finishedMap(Number(query.get('scan_id')))] : []);
  const mapFile = /^\/maps\/1\/files\/(.+)$/.exec(path);
  if (mapFile) {
    const file = mapFiles().get(mapFile[1] ?? '');
    return file ? send(200, file, 'application/octet-stream') : problem(404, 'not-found', 'no such file');
  }
  const verdictMatch = /^\/verdicts\/(\d+)$/.exec(path);
  if (verdictMatch) return send(200, lab.verdicts.find((v) => v['id'] === Number(verdictMatch[1])) ?? {});
  if (path === '/fits' && method === 'POST') {
    const id = lab.fits.length + 1;
    lab.fits.unshift({ id, scan_id: body['scan_id'], request: body, state: 'running', created_at: new Date().toISOString(), progress: { stage: 'tracing', fraction: 0.25, time_left_s: 42 }, forecast: { seconds: 50, at_most: false, cut_short: false, amount: { count: 108, of: 'poses' } } });
    if (lab.fitMs !== null) lab.after(lab.fitMs, () => lab.finishFit(id, String(body['variant']), body['shape'] !== undefined));
    return send(202, { id, state: 'running' });
  }
  if (path === '/fits') {
    const [limit, from, of] = [query.get('limit'), query.get('cursor'), query.get('scan_id')];
    const rows = lab.fits.filter((f) => of === null || f['scan_id'] === Number(of));
    const begin = Number(from ?? 0);
    const end = begin + Number(limit ?? 100);
    return send(200, { items: rows.slice(begin, end), next_cursor: end < rows.length ? String(end) : null });
  }
  const fitMatch = /^\/fits\/(\d+)(\/curve)?$/.exec(path);
  const cancelled = /^\/fits\/(\d+)\/cancel$/.exec(path);
  if (cancelled) {
    Object.assign(lab.fits.find((f) => f['id'] === Number(cancelled[1])) ?? {}, { state: 'cancelled', progress: undefined });
    return send(202, { id: Number(cancelled[1]), state: 'cancelled' });
  }
  if (fitMatch) {
    const id = Number(fitMatch[1]);
    const fit = lab.fits.find((f) => f['id'] === id);
    if (!fit) return problem(404, 'not-found', `there is no fit ${id}`);
    const scan = lab.scans.find((s) => s.body.id === fit['scan_id']);
    const surface = scan && lab.surfaces.get(scan.body.sample_id);
    return send(200, fitMatch[2] === undefined ? fit : scan && surface ? fittedCurves(fit, scan, surface) : {});
  }
  if (path === '/traces' && method === 'POST') {
    const id = lab.traces.length + 1;
    lab.traces.unshift({ id, scan_id: null, state: 'running', created_at: new Date().toISOString(), request: { max_seconds: null, target_error: null, ...body }, progress: { stage: 'tracing photons', fraction: 0.25, time_left_s: 42 } });
    return send(202, { id, state: 'running' });
  }
  if (path === '/traces') return list(lab.traces);
  const traceMatch = /^\/traces\/(\d+)\/(cancel|files\/(.+))$/.exec(path);
  if (traceMatch) {
    const trace = lab.traces.find((t) => t['id'] === Number(traceMatch[1]));
    if (traceMatch[2] === 'cancel' && trace) {
      Object.assign(trace, { state: 'cancelled', progress: undefined });
      lab.event('calculation', {});
      return send(202, { id: trace['id'], state: 'cancelled' });
    }
    const file = traceFiles().get(traceMatch[3] ?? '');
    return file ? send(200, file, 'application/octet-stream') : problem(422, 'invalid-value', 'no such file');
  }
  if (path === '/accuracy' && lab.accuracy) return send(200, lab.accuracy);
  if (path === '/accuracy') {
    response.writeHead(204).end();
    return true;
  }
  return false;
}
