import type { Frame } from "./frame";

/** The last minutes of every channel at the full rate, addressed by absolute tick. */
export class SampleRing {
  private readonly columns: Float32Array[];
  private first = 0;
  private next = 0;
  private begun = 0;

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

  /** How often the ticks began anew. */
  get generation(): number {
    return this.begun;
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

  /** Takes a frame in. Ticks that never came become NaN; a clock that went back begins anew. */
  write(frame: Frame): void {
    const end = frame.firstTick + frame.rows;
    if (frame.rows === 0) return;
    if (this.isEmpty || this.wentBack(frame) || frame.firstTick - this.next >= this.capacity) {
      this.first = this.next = frame.firstTick;
      this.begun += 1;
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

  /** Only history may overlap what is here; it does when the page comes back, and then it ends later. */
  private wentBack(frame: Frame): boolean {
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
