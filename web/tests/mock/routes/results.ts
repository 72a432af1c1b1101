// Rows of results, control charts, comparisons and repeatability.

import type { Ask } from '../ask';
import type { MockLab } from '../lab';
import { resultChart } from '../chart';
import { resultRows, resultsPage } from '../results';
import { comparison, repeatability, type MockResult } from '../study';

export function answerResults(lab: MockLab, { path, query, send, problem }: Ask): boolean {
  if (path === '/results') return send(200, resultsPage(resultRows(lab), query));
  if (path === '/due') return send(200, { items: lab.due });
  if (path === '/charts') {
    const asked = new URLSearchParams(query);
    const [parameter, limitsOf] = [asked.get('parameter') ?? 'theta_r_deg', asked.get('limits_of')];
    asked.delete('parameter');
    asked.delete('limits_of');
    asked.set('sort', 'created_at');
    asked.set('limit', '1000');
    const rows = resultsPage(resultRows(lab), asked).items;
    const specification = (name: string) => (lab.specifications.named(name)?.content ?? null) as { name: string; limits: Record<string, object> } | null;
    const chart = resultChart({ rows, parameter, limitsOf, filter: asked.get('specification'), specification, verdict: (id) => lab.verdicts.find((v) => v['id'] === id), due: lab.due });
    return chart ? send(200, chart) : problem(422, 'invalid-value', `limits_of: there is no specification \`${limitsOf}\``);
  }
  if (path === '/comparisons' || path === '/repeatability') {
    const found = query.getAll('scan_id').map((id) => ({ scan: lab.scans.find((s) => s.body.id === Number(id))?.body, fit: lab.fits.find((f) => f['scan_id'] === Number(id) && f['state'] === 'completed'), id: Number(id) }));
    const results = found.filter((r) => r.scan && r.fit) as unknown as MockResult[];
    const without = found.filter((r) => !r.fit).map((r) => r.id);
    const shared = query.get('shared');
    if (path === '/repeatability') return send(200, repeatability(results, without, shared, query.get('by')));
    const [a, b] = results;
    if (!a || !b) return problem(409, 'no-fit', `scan ${without[0]} has nothing to report: it has no completed fit; fit it on its page`);
    return send(200, comparison(a, b, shared));
  }
  return false;
}
