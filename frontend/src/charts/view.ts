import type { SampleRing } from "../live/ring";

/** Length of the view while the charts follow the tool. */
export const LIVE_SPAN_S = 10;
const SHORTEST_S = 0.05;

/** Which part of the ring the charts show: the newest ten seconds, or a part that the person has chosen. */
export class View {
  /** One past the last tick shown while paused; null while the charts follow the tool. */
  private pausedEnd: number | null = null;
  private span: number;
  /** Newest tick at the time of the pause. Time labels count back from it. */
  private pausedAt = 0;
  private generation = -1;

  constructor(
    private readonly ring: SampleRing,
    readonly rateHz: number,
  ) {
    this.span = LIVE_SPAN_S * rateHz;
  }

  get paused(): boolean {
    return this.pausedEnd !== null && this.generation === this.ring.generation;
  }

  get changed(): boolean {
    return this.paused && (this.pausedEnd !== this.ring.end || this.span !== LIVE_SPAN_S * this.rateHz);
  }

  get endTick(): number {
    return this.paused ? (this.pausedEnd ?? 0) : this.ring.end;
  }

  get spanTicks(): number {
    return this.paused ? this.span : LIVE_SPAN_S * this.rateHz;
  }

  /** The tick that time labels count back from. */
  get nowTick(): number {
    return this.paused ? this.pausedAt : this.ring.end;
  }

  /** Smallest and largest value of `endTick` for which there are samples. */
  get reach(): { first: number; last: number } {
    const last = this.paused ? this.pausedAt : this.ring.end;
    return { first: Math.min(this.ring.start + this.spanTicks, last), last };
  }

  pause(): void {
    if (this.paused) return;
    this.generation = this.ring.generation;
    this.pausedAt = this.pausedEnd = this.ring.end;
    this.span = LIVE_SPAN_S * this.rateHz;
  }

  resume(): void {
    this.pausedEnd = null;
  }

  /** Shows the ticks between two ticks. */
  show(from: number, to: number): void {
    this.pause();
    this.span = Math.max(SHORTEST_S * this.rateHz, Math.round(to - from));
    this.moveTo(Math.round(to));
  }

  moveTo(end: number): void {
    this.pause();
    const { first, last } = this.reach;
    this.pausedEnd = Math.min(Math.max(end, first), last);
  }

  /** Moves by a share of the shown span; a negative share moves to the past. */
  move(share: number): void {
    this.pause();
    this.moveTo(this.endTick + Math.round(share * this.span));
  }

  /** Zooms around the middle. A factor above 1 shows more. */
  zoom(factor: number): void {
    this.pause();
    const ticksHeld = this.pausedAt - this.ring.start;
    const span = Math.min(this.span * factor, Math.max(ticksHeld, SHORTEST_S * this.rateHz));
    const middle = this.endTick - this.span / 2;
    this.show(middle - span / 2, middle + span / 2);
  }
}
