import type { Frame } from "./frame";

/** The newest samples of every channel at the full rate, addressed by tick. */
export class SampleRing {
  private readonly columns: Float32Array[];
  private first = 0;
  private next = 0;
  private restarts = 0;

  constructor(
    channelCount: number,
    readonly capacity: number,
  ) {
    this.columns = Array.from({ length: channelCount }, () => new Float32Array(capacity).fill(NaN));
  }

  /** Oldest tick held. */
  get start(): number {
    return this.first;
  }

  /** One past the newest tick held. */
  get end(): number {
    return this.next;
  }

  /** How often the ring was emptied, because the ticks started again or a gap was too long. */
  get generation(): number {
    return this.restarts;
  }

  get isEmpty(): boolean {
    return this.first === this.next;
  }

  at(channel: number, tick: number): number {
    if (tick < this.first || tick >= this.next) return NaN;
    return this.columns[channel]?.[tick % this.capacity] ?? NaN;
  }

  newest(channel: number): number {
    return this.at(channel, this.next - 1);
  }

  /** Adds a frame. Missing ticks become NaN. If the ticks go back, the ring starts again. */
  write(frame: Frame): void {
    const end = frame.firstTick + frame.rows;
    if (frame.rows === 0) return;
    if (this.isEmpty || this.ticksWentBack(frame) || frame.firstTick - this.next >= this.capacity) {
      this.first = this.next = frame.firstTick;
      this.restarts += 1;
    }
    this.fillGap(frame.firstTick);
    const skip = Math.max(0, frame.rows - this.capacity);
    this.columns.forEach((column, i) => {
      const source = frame.columns[i];
      if (source) this.copy(column, source.subarray(skip), frame.firstTick + skip);
    });
    this.next = end;
    this.first = Math.max(Math.min(this.first, frame.firstTick), end - this.capacity);
  }

  /** Whether the ticks went back. History may overlap the ring, but then it ends later. */
  private ticksWentBack(frame: Frame): boolean {
    return frame.history ? frame.firstTick + frame.rows < this.next : frame.firstTick < this.next;
  }

  private fillGap(until: number): void {
    for (let tick = this.next; tick < until; tick++) {
      for (const column of this.columns) column[tick % this.capacity] = NaN;
    }
  }

  private copy(column: Float32Array, source: Float32Array, tick: number): void {
    const from = tick % this.capacity;
    const untilWrap = Math.min(source.length, this.capacity - from);
    column.set(source.subarray(0, untilWrap), from);
    column.set(source.subarray(untilWrap), 0);
  }
}
