// Scans, their frames, calibrations and imports.

import type { Ask, Json } from '../ask';
import type { MockLab } from '../lab';
import { radiance } from '../bench';
import { frameImage } from '../frame';
import { MESSAGES, PRESETS, type MockScan } from '../lab';
import { picture } from '../preview';

export function answerScans(lab: MockLab, { method, path, query, body, response, send, list, problem }: Ask): boolean {
  const report = /^\/scans\/(\d+)\/report$/.exec(path);
  if (report) return send(200, new TextEncoder().encode(`<!doctype html><title>Report</title><h1>Report of scan ${report[1]}</h1>`), 'text/html; charset=utf-8');
  if ((path === '/scans' && method === 'POST') || path === '/scans/estimate') {
    const recipe = lab.recipes.named(body['recipe']);
    const asked = (recipe?.content['plan'] ?? body['plan']) as Json;
    const plan = { poses: [], exposures_s: [0.02, 0.06, 0.18], repeats: 1, ...PRESETS[String(asked['preset'])], ...asked } as MockScan['body']['plan'];
    const beyond = plan.theta_c_deg.findIndex((t) => Math.abs(t) > 60);
    if (beyond >= 0) {
      return send(422, { status: 422, code: 'plan-invalid', title: 'the plan cannot run', detail: 'the plan goes beyond the travel of an axis', errors: [{ field: `plan.theta_c_deg[${beyond}]`, message: `${plan.theta_c_deg[beyond]}° is beyond the limit of 60°` }] }, 'application/problem+json');
    }
    if (path === '/scans/estimate') {
      const n = 3 + plan.theta_c_deg.length + plan.theta_c_deg.length * plan.phi_s_deg.length * plan.exposures_s.length * plan.repeats;
      return send(200, { n_frames: n, n_shots: n, duration_s: 0.8 * n, disk_bytes: 25000 * n, disk_free_bytes: 61e9, disk_reserve_bytes: 5e8, operator_steps: Object.entries(MESSAGES).map(([action, message]) => ({ action, message })), plan, calibration_ids: asked['reuse_calibrations'] === false ? [] : lab.calibrations.map((c) => c['id']) });
    }
    const scan = lab.newScan(Number(body['sample_id']), plan);
    const { lot = null, external_id = null, operator_name = null } = body;
    Object.assign(scan.body, { lot, external_id, operator_name, recipe: recipe?.ref ?? null, specification: lab.specifications.named(body['specification'])?.ref ?? null, target_expanded_deg: recipe?.content['target_expanded_deg'] ?? null });
    scan.body.state = 'running';
    lab.publish(scan);
    lab.after(50, () => lab.run(scan));
    return send(202, { id: scan.body.id, state: 'planned' });
  }
  if (path === '/scans') return list(lab.scans.map((s) => s.body).filter((b) => b['archived'] !== true));
  const scanMatch = /^\/scans\/(\d+)(?:\/(\w+))?$/.exec(path);
  if (scanMatch) {
    const scan = lab.scans.find((s) => s.body.id === Number(scanMatch[1]));
    if (!scan) return problem(404, 'not-found', `there is no scan ${scanMatch[1]}`);
    const verb = scanMatch[2];
    if (verb === 'changes') return list(lab.changes.filter((c) => c['scan_id'] === scan.body.id));
    if (method === 'PATCH' && body['sample_id'] === undefined) {
      Object.assign(scan.body, body);
      const { tags, note, archived } = scan.body as Json;
      lab.changes.push({ id: lab.changes.length + 1, scan_id: scan.body.id, who: 'local', at: new Date().toISOString(), tags, note, archived });
      lab.event('order', {});
      return send(200, scan.body);
    }
    if (method === 'PATCH') {
      scan.body['earlier_samples'] = [{ sample_id: scan.body.sample_id, sample_name: scan.body['sample_name'], until: new Date().toISOString() }];
      scan.body.sample_id = Number(body['sample_id']);
      scan.body['sample_name'] = lab.scanName(scan.body.sample_id);
      return send(200, scan.body);
    }
    if (verb === undefined) return send(200, scan.body);
    if (verb === 'frames') return list(scan.frames);
    if (verb === 'uncertainty') return list(lab.certainties);
    if (verb === 'incidents') return list([]);
    if (verb === 'observations') {
      if (!scan.frames.some((f) => f['kind'] === 'sample')) return problem(422, 'no-observations', 'no observation is left');
      if (lab.regions.length > 0 && !query.has('region')) return problem(422, 'invalid-value', 'the part has several regions: name one of them');
      const surface = lab.surfaces.get(scan.body.sample_id);
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
    lab.publish(scan);
    if (scan.body.state === 'running') lab.after(5, () => lab.run(scan));
    return send(202, { id: scan.body.id, state: scan.body.state });
  }
  const calibration = /^\/calibrations\/(\d+)$/.exec(path);
  if (path === '/calibrations') return list(lab.calibrations.filter((c) => !query.has('scan_id') || c['scan_id'] === Number(query.get('scan_id'))));
  if (calibration) return send(200, lab.calibrations.find((c) => c['id'] === Number(calibration[1])));
  const imageMatch = /^\/frames\/(\d+)\/image\.png$/.exec(path);
  const previewMatch = /^\/frames\/(\d+)\/preview\.png$/.exec(path);
  if (previewMatch) {
    response.setHeader('x-low-dn', '210');
    response.setHeader('x-high-dn', '23456');
    return send(200, picture(Number(previewMatch[1])), 'image/png');
  }
  if (imageMatch) {
    const id = Number(imageMatch[1]);
    const row = lab.scans.flatMap((s) => s.frames).find((f) => f['id'] === id);
    return send(200, frameImage(id, Number(row?.['mean_dn'] ?? 0)), 'image/png');
  }
  if ((path === '/imports' || path === '/imports/upload') && method === 'POST') {
    const id = lab.addScan(1, 'paper');
    Object.assign(lab.scans.find((s) => s.body.id === id)?.body ?? {}, { origin: 'import' });
    return send(201, { scan_id: id, sample_id: 1, n_frames: 48, skipped: ['frames/7.png'], same_as_scan_id: null });
  }
  return false;
}
