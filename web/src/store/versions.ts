/** What is decoded of one tile, mark by mark: what is shown up to a mark never changes by what comes after it. */

interface Forking<S> {
  readonly lod: number;
  fork(): S;
}

/** A tile as it was after the last thing that came of it before the next mark. */
export class Version<S> {
  /** The last mark that came before it; it counts for every later one. */
  readonly since: number;
  readonly state: S;
  /** Whether it holds something that is to be staged. */
  fresh: boolean;
  /** Whether what it holds was handed out: it is not added to any more. */
  staged = false;

  constructor(since: number, state: S, fresh: boolean) {
    this.since = since;
    this.state = state;
    this.fresh = fresh;
  }

  handedOut(): S {
    this.fresh = false;
    this.staged = true;
    return this.state;
  }
}

/** The versions of one tile, the newest last. */
export class Versions<S extends Forking<S>> {
  private readonly all: Version<S>[];

  constructor(state: S, since: number) {
    this.all = [new Version(since, state, true)];
  }

  get length(): number {
    return this.all.length;
  }

  /** All that has come. */
  get newest(): S {
    return this.all.at(-1)!.state;
  }

  /** The state to add to what comes after mark `since`; {@link touch} where that changed anything. */
  writable(since: number): S {
    const last = this.all.at(-1)!;
    if (last.since !== since) this.all.push(new Version(since, last.state.fork(), false));
    else if (last.staged) this.all[this.all.length - 1] = new Version(since, last.state.fork(), last.fresh);
    return this.newest;
  }

  touch(): void {
    this.all.at(-1)!.fresh = true;
  }

  fresh(): Version<S>[] {
    return this.all.filter((version) => version.fresh);
  }

  /** All are to be staged again. */
  again(): void {
    for (const version of this.all) version.fresh = true;
  }

  /** Nothing before mark `basis` is asked for any more: of what came before it only the newest stays. */
  trim(basis: number): void {
    const before = this.all.filter((version) => version.since < basis).length;
    if (before > 1) this.all.splice(0, before - 1);
  }
}
