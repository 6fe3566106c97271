/** Counts what a source receives, for the inspector. */

const WINDOW_US = 1_000_000;

export class Meter {
  bytesTiles = 0;
  bytesReference = 0;
  bytesOther = 0;
  decodeErrors = 0;
  reconnects = 0;
  /** When {@link figures} was asked for last. */
  toldUs = 0;
  private recent: { readonly atUs: number; readonly bytes: number }[] = [];

  received(bytes: number, nowUs: number): void {
    this.recent.push({ atUs: nowUs, bytes });
  }

  /** The figures of the last second and of all time. */
  figures(nowUs: number): {
    goodputBps: number; bytesTiles: number; bytesReference: number; bytesOther: number; decodeErrors: number; reconnects: number;
  } {
    this.toldUs = nowUs;
    this.recent = this.recent.filter(({ atUs }) => atUs > nowUs - WINDOW_US);
    const bytes = this.recent.reduce((sum, one) => sum + one.bytes, 0);
    const { bytesTiles, bytesReference, bytesOther, decodeErrors, reconnects } = this;
    return { goodputBps: (8e6 * bytes) / WINDOW_US, bytesTiles, bytesReference, bytesOther, decodeErrors, reconnects };
  }
}
