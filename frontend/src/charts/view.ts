import type { SampleRing } from "../live/ring";

/** What the charts show while they follow the tool. */
export const LIVE_SPAN_S = 10;
const SHORTEST_S = 0.05;

/** Which stretch of the ring the charts show: the newest ten seconds, or one that a person has chosen. */
export class View {
  /** Null while the charts follow the tool; else one past the last tick shown. */
  private heldEnd: number | null = null;
  private span: number;
  /** Newest tick when the person paused: what times count back from. */
  private pausedAt = 0;
  private generation = -1;

  constructor(
    private readonly ring: SampleRing,
    readonly rateHz: number,
  ) {
    this.span = LIVE_SPAN_S * rateHz;
  }

  get paused(): boolean {
    return this.heldEnd !== null && this.generation === this.ring.generation;
  }

  get changed(): boolean {
    return this.paused && (this.heldEnd !== this.ring.end || this.span !== LIVE_SPAN_S * this.rateHz);
  }

  get endTick(): number {
    return this.paused ? (this.heldEnd ?? 0) : this.ring.end;
  }

  get spanTicks(): number {
    return this.paused ? this.span : LIVE_SPAN_S * this.rateHz;
  }

  /** What times count back from. */
  get nowTick(): number {
    return this.paused ? this.pausedAt : this.ring.end;
  }

  /** Oldest and newest end that there are samples for. */
  get reach(): { first: number; last: number } {
    const last = this.paused ? this.pausedAt : this.ring.end;
    return { first: Math.min(this.ring.start + this.spanTicks, last), last };
  }

  pause(): void {
    if (this.paused) return;
    this.generation = this.ring.generation;
    this.pausedAt = this.heldEnd = this.ring.end;
    this.span = LIVE_SPAN_S * this.rateHz;
  }

  goOn(): void {
    this.heldEnd = null;
  }

  /** Shows the stretch between two ticks. */
  show(from: number, to: number): void {
    this.pause();
    this.span = Math.max(SHORTEST_S * this.rateHz, Math.round(to - from));
    this.moveTo(Math.round(to));
  }

  moveTo(end: number): void {
    this.pause();
    const { first, last } = this.reach;
    this.heldEnd = Math.min(Math.max(end, first), last);
  }

  /** Moves by a share of what is shown, to the past where negative. */
  move(share: number): void {
    this.pause();
    this.moveTo(this.endTick + Math.round(share * this.span));
  }

  /** Shows more (factor above 1) or less around the middle. */
  zoom(factor: number): void {
    this.pause();
    const most = this.pausedAt - this.ring.start;
    const span = Math.min(this.span * factor, Math.max(most, SHORTEST_S * this.rateHz));
    const middle = this.endTick - this.span / 2;
    this.show(middle - span / 2, middle + span / 2);
  }
}
