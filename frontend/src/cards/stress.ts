import { find, setAttribute } from "../dom";
import type { Model } from "../live/model";
import type { SampleRing } from "../live/ring";
import type { TissueInfo } from "../wire";
import { drawReferences, plotArea, type Axis, type PlotArea } from "./stress-plot";

const EVERY_MS = 100;
/** The live curve takes every second sample. Above `MAX_POINTS` it drops every second point and doubles the step. */
const FIRST_STEP_TICKS = 2;
/** Ticks over which the jaws' speed is measured: long enough to smooth the encoder's steps. */
const SPEED_TICKS = 8;
const MAX_POINTS = 600;

/** Draws the live curve of stress over compression on top of the library's curves. */
export class StressCard {
  private readonly canvas: HTMLCanvasElement;
  private readonly background = document.createElement("canvas");
  private readonly sizes = new ResizeObserver(() => this.rebuild());
  private area: PlotArea | null = null;
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
    for (const button of this.buttons()) button.addEventListener("click", () => this.showAxis(button.dataset.axis as Axis));
  }

  render(nowMs: number): void {
    if (nowMs - this.drawnAt < EVERY_MS && this.area) return;
    this.drawnAt = nowMs;
    const { hello } = this.model;
    if (!hello) return;
    this.addSamples();
    if (!this.area) {
      if (this.canvas.clientWidth === 0) return;
      this.area = plotArea(this.canvas, hello.library, this.axis);
      drawReferences(this.background, this.area, hello.library);
    }
    this.drawCurve(this.area);
  }

  /** Draws everything again, after a change of colors, axis or library. */
  rebuild(): void {
    this.area = null;
  }

  close(): void {
    this.sizes.disconnect();
  }

  private showAxis(axis: Axis): void {
    this.axis = axis;
    for (const button of this.buttons()) setAttribute(button, "aria-pressed", String(button.dataset.axis === axis));
    this.rebuild();
  }

  /** Adds the new samples of the current grasp to the curve. A new grasp or a new source starts a new curve. */
  private addSamples(): void {
    const { ring, identification } = this.model;
    if (!ring || ring.isEmpty) return;
    const grasp = identification?.grasp ?? 0;
    const ringRestarted = ring.generation !== this.generation;
    if (ringRestarted || (grasp !== this.grasp && identification?.in_grasp)) {
      this.points = [];
      this.stepTicks = FIRST_STEP_TICKS;
      this.nextTick = ringRestarted ? this.contactTick(ring) : Math.max(ring.start, Math.min(this.nextTick, ring.end));
      this.grasp = grasp;
      this.generation = ring.generation;
    }
    const likeliestTissue = this.likeliestTissue();
    const columns = {
      force: this.model.column("jaw_force_n"),
      compression: this.model.column("tissue_displacement_m"),
      damping: likeliestTissue ? this.model.column("damping_kg_per_s", likeliestTissue.name) : -1,
    };
    let tick = Math.max(this.nextTick, ring.start);
    for (; tick < ring.end - SPEED_TICKS / 2; tick += this.stepTicks) {
      const compressionM = ring.at(columns.compression, tick);
      if (!Number.isFinite(compressionM)) continue;
      const estimate = ring.at(columns.damping, tick);
      const damping = Number.isFinite(estimate) ? estimate : (likeliestTissue?.damping_kg_per_s ?? 0);
      this.points.push({ forceN: ring.at(columns.force, tick) - damping * this.jawSpeed(ring, columns.compression, tick), compressionM });
    }
    this.nextTick = tick;
    if (this.points.length > MAX_POINTS) {
      this.points = this.points.filter((_, i) => i % 2 === 0);
      this.stepTicks *= 2;
    }
  }

  /** Tick of the first contact with the held tissue; the newest tick if no tissue is held. */
  private contactTick(ring: SampleRing): number {
    const compression = this.model.column("tissue_displacement_m");
    let tick = ring.end;
    while (tick > ring.start && Number.isFinite(ring.at(compression, tick - 1))) tick -= 1;
    return tick;
  }

  /** Speed of the jaws, m/s; 0 if unknown. It serves to subtract the damping force, which the library's curves leave out. */
  private jawSpeed(ring: SampleRing, compression: number, tick: number): number {
    const movedM = ring.at(compression, tick + SPEED_TICKS / 2) - ring.at(compression, tick - SPEED_TICKS / 2);
    return Number.isFinite(movedM) ? (movedM * (this.model.hello?.tool.sample_rate_hz ?? NaN)) / SPEED_TICKS : 0;
  }

  private drawCurve(area: PlotArea): void {
    const { canvas } = this;
    const context = canvas.getContext("2d");
    if (!context) return;
    if (canvas.width !== area.width || canvas.height !== area.height) {
      canvas.width = area.width;
      canvas.height = area.height;
    }
    context.clearRect(0, 0, canvas.width, canvas.height);
    context.drawImage(this.background, 0, 0);
    const thickness = this.axis === "mm" ? 1e-3 : this.thickness();
    context.beginPath();
    context.rect(area.left, area.top, area.right - area.left, area.bottom - area.top);
    context.save();
    context.clip();
    context.beginPath();
    for (const { forceN, compressionM } of this.points) context.lineTo(area.x(compressionM / thickness), area.y(forceN));
    context.strokeStyle = area.colors.live;
    context.lineWidth = 2 * devicePixelRatio;
    context.stroke();
    const last = this.points.at(-1);
    if (last && this.model.identification?.in_grasp) {
      context.beginPath();
      context.arc(area.x(last.compressionM / thickness), area.y(last.forceN), 5 * devicePixelRatio, 0, 2 * Math.PI);
      context.fillStyle = area.colors.live;
      context.fill();
    }
    context.restore();
  }

  /** Thickness measured at contact, if the tool can; else that of the likeliest tissue, m. */
  private thickness(): number {
    const { identification } = this.model;
    return identification?.thickness_m ?? this.likeliestTissue()?.thickness_m ?? NaN;
  }

  private likeliestTissue(): TissueInfo | undefined {
    const { identification, tissues } = this.model;
    const [likeliestTissue] = Object.entries(identification?.probabilities ?? {})
      .filter(([name]) => tissues.some((tissue) => tissue.name === name))
      .toSorted(([, a], [, b]) => b - a);
    return tissues.find(({ name }) => name === likeliestTissue?.[0]) ?? tissues[0];
  }

  private buttons(): HTMLButtonElement[] {
    return [...find(this.root, "stress").querySelectorAll<HTMLButtonElement>("button[data-axis]")];
  }
}
