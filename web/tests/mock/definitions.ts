// Recipes and specifications of the mock daemon, in versions, and the verdicts that follow from their limits.

type Json = Record<string, unknown>;

interface Stored {
  readonly id: number;
  archived: boolean;
  /** Oldest first. */
  readonly versions: { readonly content: Json & { name: string }; readonly saved_at: string }[];
}

export interface Answer {
  readonly status: number;
  readonly body: unknown;
}

const refused = (status: number, code: string, detail: string, errors: Json[] = []): Answer => ({ status, body: { status, code, title: code, detail, errors } });

/** All definitions of one kind. */
export class MockDefinitions {
  readonly stored: Stored[] = [];
  readonly #key: 'recipe' | 'specification';

  constructor(key: 'recipe' | 'specification') {
    this.#key = key;
  }

  add(content: Json & { name: string }): number {
    const id = this.stored.length + 1;
    this.stored.push({ id, archived: false, versions: [{ content, saved_at: new Date().toISOString() }] });
    return id;
  }

  /** The newest version by name. */
  named(name: unknown): { ref: { id: number; name: string; version: number }; content: Json } | null {
    const found = this.stored.find((s) => !s.archived && s.versions.at(-1)?.content.name === name);
    const newest = found?.versions.at(-1);
    return found && newest ? { ref: { id: found.id, name: newest.content.name, version: found.versions.length }, content: newest.content } : null;
  }

  #row(of: Stored, version = of.versions.length): Json {
    const { content, saved_at } = of.versions[version - 1] ?? { content: { name: '' }, saved_at: '' };
    return { id: of.id, name: content.name, version, newest_version: of.versions.length, archived: of.archived, who: 'local', saved_at, [this.#key]: content };
  }

  /** Answers `/recipes…` or `/specifications…`; `path` is what follows it. */
  answer(method: string, path: string, query: URLSearchParams, body: Json): Answer {
    const list = (items: unknown[]): Answer => ({ status: 200, body: { items, next_cursor: null } });
    if (path === '' && method === 'GET') return list(this.stored.filter((s) => s.archived === (query.get('archived') === 'true')).map((s) => this.#row(s)));
    const content = (path === '' ? body : (body[this.#key] as Json | undefined)) as (Json & { name: string }) | undefined;
    if (content && this.#key === 'recipe') {
      // Like the daemon, which checks the plan against the travel of the rig.
      const tilts = (content['plan'] as { theta_c_deg?: number[] } | undefined)?.theta_c_deg ?? [];
      const beyond = tilts.findIndex((t) => Math.abs(t) > 60);
      if (beyond >= 0) return refused(422, 'plan-invalid', 'the plan cannot run', [{ field: `plan.theta_c_deg[${beyond}]`, message: 'is outside the travel of theta_c', out_of_range: { value: tilts[beyond], lower: -60, upper: 60 } }]);
    }
    if (path === '' && content) {
      if (this.named(content.name)) return refused(409, 'name-taken', `another ${this.#key} has the name ${content.name}`);
      return { status: 201, body: this.#row(this.stored[this.add(content) - 1] as Stored) };
    }
    const [, id, verb] = /^\/(\d+)\/(versions|archive|restore)$/.exec(path) ?? [];
    const found = this.stored.find((s) => s.id === Number(id));
    if (!found) return refused(404, 'not-found', `there is no ${this.#key} ${id}`);
    if (verb === 'versions' && method === 'GET') return list(found.versions.map((_, n) => this.#row(found, n + 1)).reverse());
    if (verb === 'versions' && content) {
      if (body['replaces'] !== found.versions.length) return refused(409, 'version-conflict', `version ${found.versions.length} is the newest`);
      found.versions.push({ content, saved_at: new Date().toISOString() });
    }
    if (verb === 'archive' || verb === 'restore') found.archived = verb === 'archive';
    return { status: 200, body: this.#row(found) };
  }
}

/** A verdict on the ridge angle by its limits, with a guard band of its expanded uncertainty. */
export function judged(specification: Json, parameters: Record<string, { value: number; expanded: number }>): Json {
  const { value, expanded } = parameters['theta_r_deg'] ?? { value: 0, expanded: 0 };
  const { lower = null, upper = null } = (specification['limits'] as Record<string, { lower?: number; upper?: number }>)['theta_r_deg'] ?? {};
  const inside = (lower === null || value - expanded >= lower) && (upper === null || value + expanded <= upper);
  const outside = (lower !== null && value + expanded < lower) || (upper !== null && value - expanded > upper);
  const verdict = inside ? 'pass' : outside ? 'fail' : 'cannot-tell';
  return {
    verdict, specification: specification['name'], decision_rule: 'JCGM 106:2012, guarded acceptance',
    items: [{
      quantity: 'theta_r_deg', value, std: expanded / 2, expanded, coverage_factor: 2, lower, upper, acceptance_lower: lower === null ? null : lower + expanded, acceptance_upper: upper === null ? null : upper - expanded,
      conformance_probability: inside ? 0.9999 : outside ? 0.0001 : 0.6, verdict, reason: inside ? 'the value is inside its limits' : outside ? `${value}° is outside its limits` : 'the value is too close to a limit',
    }],
    ...(verdict === 'cannot-tell' ? { would_decide: { theta_r_deg: { message: '12 poses more (27 in all) would decide' } } } : {}),
  };
}
