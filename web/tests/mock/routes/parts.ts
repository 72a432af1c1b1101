// Parts, recipes, specifications and the queue.

import type { Ask, Json } from '../ask';
import type { MockLab } from '../lab';

export function answerParts(lab: MockLab, { method, path, query, body, send, list, problem }: Ask): boolean {
  if (path === '/samples' && method === 'POST') {
    const id = lab.addSample(String(body['name']), { theta_r_deg: 12, alpha_u: 0.1, alpha_v: 0.1, rho_d: 0.2 });
    const sample = lab.samples.find((s) => s['id'] === id);
    if (sample) sample['material'] = body['material'] ?? { kind: 'conductor', eta: 3.12, k: 3.33, eta_std: 0.1, k_std: 0.1 };
    return send(201, sample);
  }
  for (const [root, kind] of [['/recipes', lab.recipes], ['/specifications', lab.specifications]] as const) {
    if (path !== root && !path.startsWith(`${root}/`)) continue;
    const answer = kind.answer(method, path.slice(root.length), query, body);
    return send(answer.status, answer.body, answer.status < 400 ? 'application/json' : 'application/problem+json');
  }
  if (path === '/samples') return list(lab.samples);
  if (path === '/queue/orders' && method === 'POST') {
    for (const order of body['orders'] as Json[]) {
      const id = lab.orders.length + 1;
      const name = (of: unknown): Json | null => (of === undefined ? null : { id: 1, name: of });
      lab.orders.push({ lot: null, external_id: null, reason: null, scan_id: null, part: lab.scanName(Number(order['sample_id'])), ...order, id, state: 'waiting', recipe: name(order['recipe']), specification: name(order['specification']) });
    }
    return send(201, { items: lab.orders.slice(-1), next_cursor: null });
  }
  if (path === '/queue/orders') return list(lab.orders.filter((o) => o['state'] === (query.get('state') ?? 'waiting')));
  const orderMatch = /^\/queue\/orders\/(\d+)(?:\/(move|retry))?$/.exec(path);
  if (orderMatch) {
    const order = lab.orders.find((o) => o['id'] === Number(orderMatch[1]));
    if (!order) return problem(404, 'not-found', `there is no order ${orderMatch[1]}`);
    if (method === 'DELETE') order['state'] = 'removed';
    else if (orderMatch[2] === 'retry' && order['state'] !== 'failed') return problem(409, 'state-conflict', `order ${orderMatch[1]} is ${String(order['state'])}`);
    else lab.orders = [Object.assign(order, { state: 'waiting' }), ...lab.orders.filter((o) => o !== order)];
    return send(200, order);
  }
  const queueMatch = /^\/queue\/(start|stop|pause)$/.exec(path);
  if (queueMatch) lab.queueState = { start: 'running', stop: 'stopped', pause: 'paused' }[String(queueMatch[1])] ?? 'stopped';
  if (queueMatch || path === '/queue') {
    return send(200, { state: lab.queueState, reason: null, who: null, changed_at: null, message: `The queue is ${lab.queueState}.`, current: null, next: null, counts: { waiting: 0, running: 0, done: 0, failed: 0, removed: 0 }, on_failure: 'stop' });
  }
  const sampleMatch = /^\/samples\/(\d+)$/.exec(path);
  if (sampleMatch && method === 'PATCH') {
    const sample = lab.samples.find((s) => s['id'] === Number(sampleMatch[1]));
    if (!sample) return problem(404, 'not-found', `there is no part ${sampleMatch[1]}`);
    sample['earlier_names'] = [...(sample['earlier_names'] as Json[]), { name: sample['name'], until: new Date().toISOString() }];
    sample['name'] = body['name'];
    for (const scan of lab.scans.filter((s) => s.body.sample_id === sample['id'])) scan.body['sample_name'] = body['name'];
    return send(200, sample);
  }
  return false;
}
