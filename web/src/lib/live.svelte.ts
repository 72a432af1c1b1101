// The daemon's state, kept current: read once, then updated by its events. One object for the
// whole page; components read it and call its methods.

import { api } from './api';
import { Problem, spoken } from './problems';
import type { Alarm, Certainty, Fit, FrameRow, OperatorStep, Progress, Rig, Sample, Scan, ScanState, StoredRecipe, StoredSpecification } from './types';
import { isActive } from './words';

type Link = 'connecting' | 'live' | 'lost';

interface ScanEvent {
  readonly scan_id: number;
  readonly state: ScanState;
  readonly reason: string | null;
  readonly operator: OperatorStep | null;
  readonly progress: Progress | null;
}

interface FrameEvent extends Omit<FrameRow, 'id'> {
  readonly frame_id: number;
  readonly progress?: Progress | null;
}

/** Interval of position polls while something moves or is fitted, and at rest. */
const RIG_BUSY_MS = 300;
const RIG_IDLE_MS = 3000;
/** Longest wait for the state of the rig: a line without an answer is a lost one. With silent stages the daemon answers within 2 s. */
const RIG_ANSWER_MS = 10_000;
/** After this time without an answer to a stop, the user is warned. The daemon answers within 1 s, also without stages. */
const STOP_ANSWER_MS = 3000;
/** Shortest time between two reads of the rig while its events come faster. */
const RIG_EVENT_MS = 200;
/** Frames that come faster than this are shown together, so that a fast rig does not block the buttons. */
const FRAMES_MS = 250;
/** A lost page asks for the rig that often in any case, so a rarer try of the event stream would only show a daemon that is back later. */
const RECONNECT_MS_MAX = RIG_IDLE_MS;
/** Most running fits that are polled for their progress; the others are updated by their events. */
const POLLED_MAX = 6;

interface Notice {
  readonly id: number;
  readonly text: string;
  /** A motion may be going on that should not. */
  readonly severe: boolean;
  /** The scan of which it says that it is paused; the notice goes when that scan continues or ends. */
  readonly paused: number | null;
}

/** An alarm with the number of times that it came in the same words; `id` and `at` are of the last time. */
export interface ShownAlarm extends Alarm {
  readonly times: number;
}

const LATE_STOP = 'The stop has no answer yet. If anything moves, use the rig’s emergency switch.';

/** Most alarms that are kept after they were seen. */
const PAST_MAX = 200;

class Live {
  link = $state<Link>('connecting');
  rig = $state.raw<Rig | null>(null);
  rigProblem = $state<string | null>(null);
  samples = $state.raw<readonly Sample[]>([]);
  /** Recipes and specifications that are in use, by name. */
  recipes = $state.raw<readonly StoredRecipe[]>([]);
  specifications = $state.raw<readonly StoredSpecification[]>([]);
  /** Increases when this page changes the queue. */
  queueChanged = $state(0);
  scans = $state.raw<readonly Scan[]>([]);
  /** Archived scans that were looked at; lists leave them out. */
  aside = $state.raw<readonly Scan[]>([]);
  /** Scans that were asked for and do not exist. */
  absent = $state.raw<readonly number[]>([]);
  fits = $state.raw<readonly Fit[]>([]);
  /** Whether the store has fits older than those that were read. */
  moreFits = $state(false);
  /** The scan whose fits were read in addition to the newest of all. */
  fitsOfScan = $state<number | null>(null);
  /** Those that are true as far as the page knows, until they are dismissed. */
  alarms = $state.raw<readonly ShownAlarm[]>([]);
  /** Those that were dismissed, or that ended. */
  pastAlarms = $state.raw<readonly ShownAlarm[]>([]);
  /** Numbers and times of all alarms so far: a replay after a lost link may repeat one. */
  readonly #alarmsCome = new Set<string>();
  /** Scans that were seen paused since a notice said so. */
  readonly #pausedScans = new Set<number>();
  #incidents = $state.raw<ReadonlyMap<number, number>>(new Map());
  /** Frames of events since the page was opened, by scan. */
  freshFrames = $state.raw<readonly FrameRow[]>([]);
  /** Reports of live fits since the page was opened, by scan. */
  freshCertainties = $state.raw<readonly (Certainty & { readonly scan_id: number })[]>([]);
  /** Increases when a job other than a fit starts, has a forecast or ends. */
  jobsChanged = $state(0);
  /** Failures of the user's actions. */
  notices = $state.raw<readonly Notice[]>([]);
  /** True once scans and fits have been read at least once. */
  loaded = $state(false);
  /** True once the first reading has ended, well or not, or the daemon is lost: views open then, so that nothing moves in them. */
  settled = $state(false);
  /** Increases with each look at the rig, and when a caller gives an order: the holder of the rig may be another one. */
  looks = $state(0);

  #source: EventSource | null = null;
  #reconnectMs = 500;
  #rigTimer: ReturnType<typeof setTimeout> | undefined;
  #connectTimer: ReturnType<typeof setTimeout> | undefined;
  #noticeId = 0;
  /** Number of events of each scan so far. */
  readonly #scanEvents = new Map<number, number>();
  #lastEvent = '';
  #rigAsked = false;
  #rigAgain = false;
  /** Frames that are not shown yet. */
  #framesCome: FrameEvent[] = [];
  #framesTimer: ReturnType<typeof setTimeout> | undefined;
  #framesShown = 0;
  #stopped = false;
  #fitsCursor: string | null = null;
  /** The shown scan and fit; the fits of this scan are read whatever their age. */
  #looked: { readonly scan: number | null; readonly fit: number | null } = { scan: null, fit: null };

  /** The scan that holds the rig, if any. */
  get activeScan(): Scan | null {
    return this.scans.find(isActive) ?? null;
  }

  start(): () => void {
    this.#stopped = false;
    this.#connect();
    void this.#pollRig();
    return () => {
      this.#stopped = true;
      this.#source?.close();
      clearTimeout(this.#rigTimer);
      clearTimeout(this.#connectTimer);
      clearTimeout(this.#framesTimer);
    };
  }

  /** Runs an action of the user; a failure becomes a notice. Returns whether it succeeded. */
  async attempt(work: () => Promise<unknown>): Promise<boolean> {
    try {
      await work();
      return true;
    } catch (error) {
      this.notify(spoken(error));
      return false;
    } finally {
      void this.#pollRig();
    }
  }

  notify(text: string, { severe = false, paused = null }: { readonly severe?: boolean; readonly paused?: number | null } = {}): void {
    if (this.notices.some((n) => n.text === text)) return;
    this.#noticeId += 1;
    const all = [...this.notices, { id: this.#noticeId, text, severe, paused }];
    const plain = all.filter((n) => !n.severe).slice(-4);
    this.notices = all.filter((n) => n.severe || plain.includes(n));
    this.#settleNotices();
  }

  /** Removes notices that a scan is paused once it continues or ends. Its state may come before or after the notice. */
  #settleNotices(): void {
    this.notices = this.notices.filter(({ paused }) => {
      if (paused === null) return true;
      const scan = this.scan(paused);
      if (scan?.state === 'paused') this.#pausedScans.add(paused);
      const over = scan === null || !isActive(scan) || (scan.state !== 'paused' && this.#pausedScans.has(paused));
      if (over) this.#pausedScans.delete(paused);
      return !over;
    });
  }

  dismissNotice(id: number): void {
    this.notices = this.notices.filter((n) => n.id !== id);
  }

  /** Number of alarms and recoveries of a scan since the page was opened. */
  incidentsOf(scanId: number): number {
    return this.#incidents.get(scanId) ?? 0;
  }

  #countIncident(scanId: number | null | undefined): void {
    if (scanId != null) this.#incidents = new Map(this.#incidents).set(scanId, this.incidentsOf(scanId) + 1);
  }

  dismissAlarm(id: number): void {
    this.#passAlarms((alarm) => alarm.id === id);
  }

  #passAlarms(ended: (alarm: ShownAlarm) => boolean): void {
    const past = this.alarms.filter(ended);
    if (past.length === 0) return;
    this.pastAlarms = [...this.pastAlarms, ...past].slice(-PAST_MAX);
    this.alarms = this.alarms.filter((alarm) => !past.includes(alarm));
  }

  /** The same words again are one alarm. */
  #takeAlarm(alarm: Alarm): void {
    const own = `${alarm.id} ${alarm.at}`;
    if (this.#alarmsCome.has(own)) return;
    this.#alarmsCome.add(own);
    const same = this.alarms.find((a) => a.code === alarm.code && a.message === alarm.message && a.scan_id === alarm.scan_id);
    this.alarms = [...this.alarms.filter((a) => a !== same), { ...alarm, times: (same?.times ?? 0) + 1 }];
  }

  /** Does not wait for any other request. A key can be pressed by mistake, so the page says what it did. */
  async stop(byKey = false): Promise<void> {
    const scan = this.activeScan;
    const moving = scan?.state === 'running' || this.rig?.activity === 'moving' || this.rig?.activity === 'homing';
    // The request goes on: it may still arrive.
    const late = setTimeout(() => this.notify(LATE_STOP, { severe: true }), STOP_ANSWER_MS);
    try {
      await api.stop();
      this.notices = this.notices.filter((n) => n.text !== LATE_STOP);
      if (byKey && moving) this.notify(`The key Esc stopped both axes.${scan ? ' The scan is paused. Press Resume to continue it.' : ''}`, { paused: scan?.id ?? null });
    } catch (error) {
      this.notify(`The stop did not reach the stages. Use the rig’s emergency switch. ${spoken(error)}`, { severe: true });
    } finally {
      clearTimeout(late);
      void this.#pollRig();
    }
  }

  async refresh(): Promise<void> {
    const before = new Map(this.#scanEvents);
    const [samples, scans, fits] = await Promise.all([api.samples(), api.scans(), api.fits(), this.reloadDefinitions()]);
    const asked = fits.next_cursor === null ? [] : await this.#fitsLookedAt();
    this.samples = samples;
    this.scans = scans;
    this.#takeFits(fits.items, asked);
    this.#fitsCursor = fits.next_cursor;
    this.moreFits = fits.next_cursor !== null;
    this.fitsOfScan = this.#looked.scan;
    this.loaded = true;
    // An event that arrived during the request may be newer than its answer.
    for (const [id, n] of this.#scanEvents) if (before.get(id) !== n) await this.reloadScan(id);
    this.#settleNotices();
  }

  async reloadScan(id: number): Promise<void> {
    let scan: Scan;
    let events: number | undefined;
    let tries = 5;
    do {
      tries -= 1;
      events = this.#scanEvents.get(id);
      scan = await api.scan(id);
    } while (this.#scanEvents.get(id) !== events && tries > 0);
    const others = this.scans.filter((s) => s.id !== id);
    this.aside = [...this.aside.filter((s) => s.id !== id), ...(scan.archived ? [scan] : [])];
    this.scans = scan.archived ? others : [...others, scan].sort((a, b) => b.id - a.id);
    this.#settleNotices();
  }

  /** A scan that was read, archived or not. */
  scan(id: number): Scan | null {
    return this.scans.find((s) => s.id === id) ?? this.aside.find((s) => s.id === id) ?? null;
  }

  async reloadFit(id: number): Promise<void> {
    const fit = await api.fit(id);
    const known = this.fits.find((f) => f.id === id);
    // Answers may arrive out of order: ended work does not run again.
    if (known && known.state !== 'running' && fit.state === 'running') return;
    const merged = { ...known, ...fit };
    this.fits = known ? this.fits.map((f) => (f.id === id ? merged : f)) : [merged, ...this.fits];
  }

  /** Reads a scan that the lists do not have: an archived one. */
  async find(id: number): Promise<void> {
    if (!this.loaded || this.scan(id) !== null || this.absent.includes(id)) return;
    await this.reloadScan(id).catch(() => (this.absent = [...this.absent, id]));
  }

  /** Sets the shown scan and fit. If the store has more fits than were read, those of this scan are read too. */
  async look(scan: number | null, fit: number | null): Promise<void> {
    if (this.#looked.scan === scan && this.#looked.fit === fit) return;
    this.#looked = { scan, fit };
    if (!this.loaded || !this.moreFits) return;
    try {
      const asked = await this.#fitsLookedAt();
      if (this.#looked.scan !== scan || this.#looked.fit !== fit) return;
      this.#takeFits(this.fits, asked);
    } catch {
      // The fits read so far stay.
    }
    this.fitsOfScan = scan;
  }

  /** Reads the next page of older fits. */
  async olderFits(): Promise<void> {
    if (this.#fitsCursor === null) return;
    const page = await api.fits({ cursor: this.#fitsCursor });
    this.#takeFits(this.fits, page.items);
    this.#fitsCursor = page.next_cursor;
    this.moreFits = page.next_cursor !== null;
  }

  async #fitsLookedAt(): Promise<readonly Fit[]> {
    const { scan, fit } = this.#looked;
    if (scan === null) return [];
    const { items } = await api.fits({ scan_id: scan });
    if (fit === null || items.some((f) => f.id === fit)) return items;
    const one = await api.fit(fit).catch(() => null);
    return one === null ? items : [...items, one];
  }

  /** Rows without duplicates, newest first; of two with the same id the second one counts. */
  #takeFits(some: readonly Fit[], others: readonly Fit[]): void {
    const all = new Map([...some, ...others].map((f) => [f.id, f]));
    this.fits = [...all.values()].sort((a, b) => b.id - a.id);
  }

  async reloadDefinitions(): Promise<void> {
    const byName = (a: { name: string }, b: { name: string }): number => a.name.localeCompare(b.name);
    const [recipes, specifications] = await Promise.all([api.recipes(), api.specifications()]);
    this.recipes = recipes.sort(byName);
    this.specifications = specifications.sort(byName);
  }

  async reloadSamples(): Promise<void> {
    this.samples = await api.samples();
  }

  #connect(): void {
    if (this.#stopped) return;
    // A new EventSource does not continue the old one: missed events are requested by their number.
    const source = new EventSource(`/api/v1/events${this.#lastEvent === '' ? '' : `?since=${this.#lastEvent}`}`);
    this.#source = source;
    source.onopen = () => {
      this.link = 'live';
      this.#reconnectMs = 500;
      // The replay brings alarms; scans and fits are read again in any case.
      this.refresh()
        .catch((error: unknown) => this.notify(spoken(error)))
        .finally(() => (this.settled = true));
      void this.#pollRig();
    };
    source.onerror = () => {
      this.#lose();
      // It does not say that the daemon asks for a login; this request does.
      void this.#pollRig();
    };
    const on = <T>(type: string, take: (data: T) => void): void => {
      source.addEventListener(type, (event) => {
        const { data, lastEventId } = event as MessageEvent<string>;
        if (lastEventId !== '') this.#lastEvent = lastEventId;
        take(JSON.parse(data) as T);
      });
    };
    on('rig', () => void this.#pollRig());
    on<ScanEvent>('scan', (event) => this.#takeScan(event));
    on<FrameEvent>('frame', (event) => this.#takeFrame(event));
    on<{ fit_id: number }>('fit', (event) => void this.reloadFit(event.fit_id).catch(() => undefined));
    on<Certainty & { readonly scan_id: number }>('uncertainty', (row) => {
      if (!this.freshCertainties.some((c) => c.id === row.id)) this.freshCertainties = [...this.freshCertainties, row].slice(-2000);
    });
    on('order', () => (this.looks += 1));
    on('calculation', () => (this.jobsChanged += 1));
    on<{ of: string; number: number }>('forecast', (job) => {
      if (job.of === 'fit') void this.reloadFit(job.number).catch(() => undefined);
      else this.jobsChanged += 1;
    });
    on<{ scan_id: number | null; code: string }>('recovered', (event) => {
      this.#countIncident(event.scan_id);
      this.#passAlarms((alarm) => alarm.scan_id === event.scan_id && alarm.code === event.code);
    });
    on<Alarm>('alarm', (alarm) => {
      this.#countIncident(alarm.scan_id);
      this.#takeAlarm(alarm);
      void this.#pollRig();
    });
  }

  #takeScan(event: ScanEvent): void {
    // Frames before it are older than its state.
    this.#showFrames();
    this.#scanEvents.set(event.scan_id, (this.#scanEvents.get(event.scan_id) ?? 0) + 1);
    const known = this.scans.find((s) => s.id === event.scan_id);
    // It runs again: what stopped it is over.
    if (event.state === 'running' && (known?.state === 'paused' || known?.state === 'interrupted')) this.#passAlarms((alarm) => alarm.scan_id === event.scan_id);
    if (!known || !isActive({ ...known, state: event.state })) {
      void this.reloadScan(event.scan_id).catch(() => undefined);
      return;
    }
    const { state, reason, operator } = event;
    const progress = event.progress ?? known.progress;
    this.scans = this.scans.map((s) => (s === known ? { ...s, state, reason, operator, progress } : s));
    this.#settleNotices();
    void this.#pollRig();
  }

  #takeFrame(event: FrameEvent): void {
    this.#framesCome.push(event);
    if (this.#framesTimer !== undefined) return;
    const wait = this.#framesShown + FRAMES_MS - Date.now();
    if (wait <= 0) this.#showFrames();
    else this.#framesTimer = setTimeout(() => this.#showFrames(), Math.min(wait, FRAMES_MS));
  }

  #showFrames(): void {
    clearTimeout(this.#framesTimer);
    this.#framesTimer = undefined;
    this.#framesShown = Date.now();
    const come = this.#framesCome;
    this.#framesCome = [];
    if (come.length === 0) return;
    const known = new Set(this.freshFrames.map((f) => f.id));
    const rows: FrameRow[] = [];
    const progressOf = new Map<number, Progress>();
    for (const { frame_id, progress, ...rest } of come) {
      const row: FrameRow = { ...rest, id: frame_id };
      if (!known.has(row.id)) rows.push(row);
      known.add(row.id);
      if (progress) progressOf.set(row.scan_id, progress);
    }
    this.freshFrames = [...this.freshFrames, ...rows].slice(-4000);
    if (progressOf.size === 0) return;
    this.scans = this.scans.map((s) => {
      const progress = progressOf.get(s.id);
      return progress ? { ...s, progress } : s;
    });
  }

  /** The link counts as lost until a new stream of events opens. EventSource gives up for good after some answers, so it is never waited for. */
  #lose(): void {
    this.link = 'lost';
    this.settled = true;
    this.#source?.close();
    clearTimeout(this.#connectTimer);
    const wait = this.#reconnectMs;
    this.#reconnectMs = Math.min(RECONNECT_MS_MAX, 2 * wait);
    this.#connectTimer = setTimeout(() => this.#connect(), wait);
  }

  #takeRig(rig: Rig): void {
    this.rig = rig;
    this.rigProblem = rig.connected ? null : (rig.problem?.detail ?? 'The stages are not connected.');
  }

  /** Reads the rig now: the daemon then connects stages that are neither connected nor in use. Returns whether they are connected. */
  async reconnect(): Promise<boolean> {
    const rig = await api.rig();
    this.#takeRig(rig);
    return rig.connected;
  }

  async #pollRig(): Promise<void> {
    if (this.#stopped) return;
    if (this.#rigAsked) {
      this.#rigAgain = true;
      return;
    }
    this.#rigAsked = true;
    // An event may be lost; a fit that has ended must not be shown as running.
    for (const fit of this.fits.filter((f) => f.state === 'running').slice(0, POLLED_MAX)) void this.reloadFit(fit.id).catch(() => undefined);
    this.#rigAgain = false;
    this.looks += 1;
    try {
      this.#takeRig(await api.rig(AbortSignal.timeout(RIG_ANSWER_MS)));
    } catch (error) {
      this.rigProblem = spoken(error);
      // The stream may outlive the requests, and would then never open again.
      if (error instanceof Problem && error.status === 0 && this.link !== 'lost') this.#lose();
    }
    this.#rigAsked = false;
    clearTimeout(this.#rigTimer);
    if (this.#rigAgain) {
      this.#rigTimer = setTimeout(() => void this.#pollRig(), RIG_EVENT_MS);
      return;
    }
    const axes = this.rig?.axes;
    const resting = this.rig?.activity === 'idle' || this.rig?.activity === 'not-connected';
    const busy = !resting || axes?.theta_c.moving === true || axes?.phi_s.moving === true || this.fits.some((fit) => fit.state === 'running');
    this.#rigTimer = setTimeout(() => void this.#pollRig(), busy && this.link === 'live' ? RIG_BUSY_MS : RIG_IDLE_MS);
  }
}

export const live = new Live();
