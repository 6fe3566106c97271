/** When a dropped connection is opened again, as `cags_client.net.reconnect`: at once first, then ever more seldom. */

const FIRST_DELAY_US = 50_000;
const MAX_DELAY_US = 1_000_000;
const GROWTH = 1.5;
const JITTER = 0.25;

export class Reconnect {
  /** Attempts since the connection was lost. */
  attempts = 0;
  private readonly patienceUs: number;
  private readonly random: () => number;
  private lostUs: number | undefined;
  private dueUs: number | undefined; // undefined while connected and while an attempt is under way

  /** Attempts go on for `patienceUs` after a loss; `random` gives numbers in [0, 1). */
  constructor(patienceUs: number, random: () => number = Math.random) {
    this.patienceUs = patienceUs;
    this.random = random;
  }

  get possible(): boolean {
    return this.patienceUs > 0;
  }

  get away(): boolean {
    return this.lostUs !== undefined;
  }

  /** Whether an attempt is under way. */
  get trying(): boolean {
    return this.away && this.dueUs === undefined;
  }

  /** The connection is gone, or the attempt under way has failed. */
  lost(nowUs: number): void {
    if (this.lostUs === undefined) {
      this.lostUs = nowUs;
      this.attempts = 0;
    }
    const delayUs = this.attempts === 0 ? 0 : FIRST_DELAY_US * GROWTH ** (this.attempts - 1);
    this.dueUs = nowUs + Math.round(Math.min(delayUs, MAX_DELAY_US) * (1 - JITTER * this.random()));
  }

  /** Whether an attempt is to be made now; it is under way then. */
  begin(nowUs: number): boolean {
    if (this.dueUs === undefined || nowUs < this.dueUs) return false;
    this.dueUs = undefined;
    this.attempts += 1;
    return true;
  }

  /** The session goes on. */
  restored(): void {
    this.lostUs = this.dueUs = undefined;
  }

  /** Whether patience has ended. */
  expired(nowUs: number): boolean {
    return this.lostUs !== undefined && nowUs - this.lostUs >= this.patienceUs;
  }

  /** When an attempt is due or patience ends; undefined while connected. */
  nextTimerUs(): number | undefined {
    if (this.lostUs === undefined) return undefined;
    const end = this.lostUs + this.patienceUs;
    return this.dueUs === undefined ? end : Math.min(this.dueUs, end);
  }
}
