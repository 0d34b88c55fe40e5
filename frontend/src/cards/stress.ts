import { find, setAttribute } from "../dom";
import type { Model } from "../live/model";
import type { SampleRing } from "../live/ring";
import type { TissueInfo } from "../wire";
import { drawReferences, frameOf, type Axis, type Frame } from "./stress-plot";

const EVERY_MS = 100;
/** Points of the live curve are taken every few samples, and thinned by two once there are too many. */
const FIRST_STEP_TICKS = 2;
/** Over which a speed is taken: long enough for the encoder's steps. */
const SPEED_TICKS = 8;
const MOST_POINTS = 600;

/** The live curve of stress over compression on top of the library's tissues. */
export class StressCard {
  private readonly canvas: HTMLCanvasElement;
  private readonly background = document.createElement("canvas");
  private readonly sizes = new ResizeObserver(() => this.rebuild());
  private frame: Frame | null = null;
  private axis: Axis = "strain";
  private points: { forceN: number; compressionM: number }[] = [];
  private stepTicks = FIRST_STEP_TICKS;
  private nextTick = 0;
  private generation = -1;
  private grasp = -1;
  private drawnAt = -Infinity;

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
  ) {
    this.canvas = find(root, "stress-plot", HTMLCanvasElement);
    this.sizes.observe(this.canvas);
    for (const button of this.buttons()) button.addEventListener("click", () => this.choose(button.dataset.axis as Axis));
  }

  render(nowMs: number): void {
    if (nowMs - this.drawnAt < EVERY_MS && this.frame) return;
    this.drawnAt = nowMs;
    const { hello } = this.model;
    if (!hello) return;
    this.follow();
    if (!this.frame) {
      if (this.canvas.clientWidth === 0) return;
      this.frame = frameOf(this.canvas, hello.library, this.axis);
      drawReferences(this.background, this.frame, hello.library);
    }
    this.drawCurve(this.frame);
  }

  /** Other colours or another library: draw everything anew. */
  rebuild(): void {
    this.frame = null;
  }

  close(): void {
    this.sizes.disconnect();
  }

  private choose(axis: Axis): void {
    this.axis = axis;
    for (const button of this.buttons()) setAttribute(button, "aria-pressed", String(button.dataset.axis === axis));
    this.rebuild();
  }

  /** Takes in the samples of the grasp under way; begins anew with the next grasp or another source. */
  private follow(): void {
    const { ring, identification } = this.model;
    if (!ring || ring.isEmpty) return;
    const grasp = identification?.grasp ?? 0;
    const anew = ring.generation !== this.generation;
    if (anew || (grasp !== this.grasp && identification?.in_grasp)) {
      this.points = [];
      this.stepTicks = FIRST_STEP_TICKS;
      this.nextTick = anew ? this.contactOf(ring) : Math.max(ring.start, Math.min(this.nextTick, ring.end));
      this.grasp = grasp;
      this.generation = ring.generation;
    }
    const likeliest = this.likeliest();
    const columns = {
      force: this.model.column("jaw_force_n"),
      compression: this.model.column("tissue_displacement_m"),
      damping: likeliest ? this.model.column("damping_kg_per_s", likeliest.name) : -1,
    };
    let tick = Math.max(this.nextTick, ring.start);
    for (; tick < ring.end - SPEED_TICKS / 2; tick += this.stepTicks) {
      const compressionM = ring.at(columns.compression, tick);
      if (!Number.isFinite(compressionM)) continue;
      const estimate = ring.at(columns.damping, tick);
      const damping = Number.isFinite(estimate) ? estimate : (likeliest?.damping_kg_per_s ?? 0);
      this.points.push({ forceN: ring.at(columns.force, tick) - damping * this.speed(ring, columns.compression, tick), compressionM });
    }
    this.nextTick = tick;
    if (this.points.length > MOST_POINTS) {
      this.points = this.points.filter((_, i) => i % 2 === 0);
      this.stepTicks *= 2;
    }
  }

  /** The tick at which the tissue that is held now was touched; the newest one where nothing is held. */
  private contactOf(ring: SampleRing): number {
    const compression = this.model.column("tissue_displacement_m");
    let tick = ring.end;
    while (tick > ring.start && Number.isFinite(ring.at(compression, tick - 1))) tick -= 1;
    return tick;
  }

  /** Of the jaws, m/s; 0 where it is not known yet. With it the damping is taken off: the library's curves have none. */
  private speed(ring: SampleRing, compression: number, tick: number): number {
    const movedM = ring.at(compression, tick + SPEED_TICKS / 2) - ring.at(compression, tick - SPEED_TICKS / 2);
    return Number.isFinite(movedM) ? (movedM * (this.model.hello?.tool.sample_rate_hz ?? NaN)) / SPEED_TICKS : 0;
  }

  private drawCurve(frame: Frame): void {
    const { canvas } = this;
    const context = canvas.getContext("2d");
    if (!context) return;
    if (canvas.width !== frame.width || canvas.height !== frame.height) {
      canvas.width = frame.width;
      canvas.height = frame.height;
    }
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.drawImage(this.background, 0, 0);
    const thickness = this.axis === "mm" ? 1e-3 : this.thickness();
    context.beginPath();
    context.rect(frame.left, frame.top, frame.right - frame.left, frame.bottom - frame.top);
    context.save();
    context.clip();
    context.beginPath();
    for (const { forceN, compressionM } of this.points) context.lineTo(frame.x(compressionM / thickness), frame.y(forceN));
    context.strokeStyle = frame.colours.live;
    context.lineWidth = 2 * devicePixelRatio;
    context.stroke();
    const last = this.points.at(-1);
    if (last && this.model.identification?.in_grasp) {
      context.beginPath();
      context.arc(frame.x(last.compressionM / thickness), frame.y(last.forceN), 5 * devicePixelRatio, 0, 2 * Math.PI);
      context.fillStyle = frame.colours.live;
      context.fill();
    }
    context.restore();
  }

  /** Measured at contact where the tool can; else that of the tissue named, or of the likeliest. */
  private thickness(): number {
    const { identification } = this.model;
    return identification?.thickness_m ?? this.likeliest()?.thickness_m ?? NaN;
  }

  private likeliest(): TissueInfo | undefined {
    const { identification, tissues } = this.model;
    const [likeliest] = Object.entries(identification?.probabilities ?? {})
      .filter(([name]) => tissues.some((tissue) => tissue.name === name))
      .toSorted(([, a], [, b]) => b - a);
    return tissues.find(({ name }) => name === likeliest?.[0]) ?? tissues[0];
  }

  private buttons(): HTMLButtonElement[] {
    return [...find(this.root, "stress").querySelectorAll<HTMLButtonElement>("button[data-axis]")];
  }
}
