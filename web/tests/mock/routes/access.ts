// The session of the page, and the lease of the rig.

import type { Ask } from '../ask';
import type { MockLab } from '../lab';

export function answerAccess(lab: MockLab, { method, path, body, headers, send, problem }: Ask): boolean {
  if (path === '/session' && method === 'POST') {
    lab.session = lab.tokens.get(String(body['token'])) ?? null;
    if (lab.session === null) return problem(401, 'wrong-token', 'the token is not valid, or was revoked');
    return send(200, { ...lab.session, logged_in: true });
  }
  if (path === '/session' && method === 'DELETE') {
    lab.session = null;
    return send(200, { id: null, state: 'logged-out' });
  }
  if (lab.tokens.size > 0 && lab.session === null && path !== '/rig/stop') return problem(401, 'no-token', 'send a token, or log in');
  if (path === '/session') return send(200, { who: 'local', role: 'admin', ...lab.session, logged_in: lab.session !== null });
  if (path === '/lease') {
    const own = lab.lease !== null && headers['ridged-lease'] === lab.lease;
    if (method === 'GET') return send(200, { holder: lab.holder, own });
    if (method === 'POST' && lab.holder !== null && !own && body['take_over'] !== true) return problem(409, 'lease-held', 'another caller holds the rig');
    lab.lease = method === 'POST' ? `lease ${lab.requests.length}` : null;
    lab.holder = method === 'POST' ? { who: lab.session?.who ?? 'local', name: body['name'], until: new Date(Date.now() + 600_000).toISOString() } : null;
    lab.event('order', {});
    return method === 'POST' ? send(201, { id: lab.lease, ...lab.holder }) : send(200, { id: null, state: 'free' });
  }
  return false;
}
