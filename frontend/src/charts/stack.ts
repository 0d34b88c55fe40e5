import "uplot/dist/uPlot.min.css";
import type uPlot from "uplot";
import { create, find, setAttribute, setData, setHidden, setText } from "../dom";
import { NO_VALUE, fixed } from "../format";
import type { Model } from "../live/model";
import type { SampleRing } from "../live/ring";
import type { Hello } from "../wire";
import { Buckets } from "./buckets";
import { Legend } from "./legend";
import { Pace } from "./pace";
import { verticalScale } from "./scales";
import { Strip } from "./strip";
import { plotSpecs, type Parameter, type PlotSpec } from "./traces";
import { View } from "./view";

/** Buckets across a chart, about one per pixel; 500 take half as much time again. */
const BUCKETS = 250;
const CHARTS = ["force", "displacement", "probability", "parameter"];
const PARAMETERS: Record<Parameter, string> = {
  alpha_n: "N, stiffness α",
  beta_per_m: "1/m, stiffening β",
  damping_kg_per_s: "kg/s, damping d",
  nis: "fit of each filter: NIS, 1 if it fits",
  force_n: "N, force by each filter",
};

/** The strip charts on one time axis: four, and one for each further chart in the table of signals. */
export class ChartStack {
  private strips: Strip[] = [];
  private buckets: Buckets | null = null;
  private view: View | null = null;
  private builtFor: { ring: SampleRing; channels: unknown; run: string | null } | null = null;
  private drawnState = "";
  private pausedBefore = false;
  private pointerDown = false;
  private parameter: Parameter = "alpha_n";
  private readonly legend: Legend;
  private readonly pace = new Pace();
  private readonly scrub: HTMLInputElement;

  constructor(
    private readonly root: HTMLElement,
    private readonly model: Model,
  ) {
    this.scrub = find(root, "scrub-position", HTMLInputElement);
    const show = (key: string, visible: boolean): void => this.strips.forEach((strip) => strip.show(key, visible));
    this.legend = new Legend(find(root, "legend"), show);
    find(root, "pause").addEventListener("click", () => this.togglePause());
    find(root, "zoom-in").addEventListener("click", () => this.zoom(0.5));
    find(root, "zoom-out").addEventListener("click", () => this.zoom(2));
    find(root, "zoom-reset").addEventListener("click", () => this.reset());
    this.scrub.addEventListener("input", () => this.scrubTo(Number(this.scrub.value)));
    for (const button of this.parameterButtons()) {
      button.addEventListener("click", () => this.showParameter(button.dataset.parameter as Parameter));
    }
  }

  /** Draws new samples. While paused, the ring goes on filling. */
  render(): void {
    const { ring, hello } = this.model;
    setData(find(this.root, "charts"), "empty", String(ring === null || ring.isEmpty));
    if (!ring || !hello) return;
    const { builtFor } = this;
    const isSame = builtFor?.ring === ring && builtFor.channels === hello.channels && builtFor.run === this.model.graspsOfRun;
    if (!isSame) this.rebuild(); // each run has a scale of its own
    const { view, buckets } = this;
    if (!view || !buckets || ring.isEmpty) return;
    const began = performance.now();
    const state = `${view.endTick} ${view.spanTicks} ${ring.generation}`;
    if (state === this.drawnState) return;
    this.drawnState = state;
    buckets.update(view.endTick);
    const toS = view.endTick / view.rateHz;
    const shown = { fromS: toS - view.spanTicks / view.rateHz, toS, nowS: view.nowTick / view.rateHz };
    this.strips.forEach((strip, i) => {
      if (view.paused || this.pace.shouldDraw(i)) strip.draw(buckets, shown);
    });
    this.pace.nextPicture();
    if (!view.paused) this.pace.measure(began);
    this.renderControls(view);
  }

  /** Reads the ring again, because older samples have arrived. */
  historyChanged(): void {
    this.buckets?.invalidate();
    this.drawnState = "";
  }

  /** Builds the charts again, after a change of channels, parameter or theme. */
  rebuild(): void {
    const { ring, hello } = this.model;
    if (!ring || !hello) return;
    if (this.builtFor?.ring !== ring) this.view = new View(ring, hello.tool.sample_rate_hz);
    this.builtFor = { ring, channels: hello.channels, run: this.model.graspsOfRun };
    for (const strip of this.strips) strip.destroy();
    const specs = plotSpecs(this.model, this.parameter);
    this.placeFurtherCharts(specs);
    this.legend.rebuild(specs);
    this.strips = specs.map((spec) => this.makeStrip(spec, hello));
    this.rebuildBuckets();
    setText(find(this.root, "parameter-unit"), PARAMETERS[this.parameter]);
  }

  close(): void {
    this.pace.close();
    for (const strip of this.strips) strip.destroy();
  }

  togglePause(): void {
    if (this.view?.paused) this.reset();
    else this.changeView((view) => view.pause());
  }

  /** Follows the tool again, ten seconds at a time. */
  reset(): void {
    this.changeView((view) => view.resume());
  }

  /** Moves by a share of the shown span. */
  move = (share: number): void => this.changeView((view) => view.move(share));

  zoom = (factor: number): void => this.changeView((view) => view.zoom(factor));

  showParameter(parameter: Parameter): void {
    this.parameter = parameter;
    for (const button of this.parameterButtons()) {
      setAttribute(button, "aria-pressed", String(button.dataset.parameter === parameter));
    }
    this.rebuild();
  }

  /** Puts the charts of further signals above that of the probabilities. */
  private placeFurtherCharts(specs: PlotSpec[]): void {
    for (const old of this.root.querySelectorAll(".strip.further")) old.remove();
    const next = find(this.root, "chart-probability").closest(".strip");
    for (const { id, unit } of specs.filter((spec) => spec.unit !== undefined)) {
      const strip = create("div", "strip further");
      const heading = create("h3", "", `${id.charAt(0).toUpperCase()}${id.slice(1)} `);
      const parts = { lines: create("span", "lines"), readout: create("output", ""), chart: create("div", "plot") };
      for (const [name, part] of Object.entries(parts)) part.id = `${name}-${id}`;
      heading.append(create("small", "", unit), parts.lines, parts.readout);
      strip.append(heading, parts.chart);
      next?.before(strip);
    }
  }

  private changeView(change: (view: View) => void): void {
    if (!this.view) return;
    change(this.view);
    this.rebuildBuckets();
    this.renderControls(this.view);
  }

  private rebuildBuckets(): void {
    const { view } = this;
    if (!view || !this.builtFor) return;
    const traces = this.strips.flatMap((strip) => strip.traces);
    const columns = traces.flatMap(({ column, sdColumn }) => (sdColumn < 0 ? [column] : [column, sdColumn]));
    const bucketTicks = Math.max(1, Math.ceil(view.spanTicks / BUCKETS));
    this.buckets = new Buckets(this.builtFor.ring, [...new Set(columns)], view.rateHz, bucketTicks, BUCKETS + 1);
    this.drawnState = "";
  }

  private scrubTo(secondsBack: number): void {
    this.changeView((view) => view.moveTo(view.nowTick + Math.round(secondsBack * view.rateHz)));
  }

  private renderControls(view: View): void {
    if (this.pointerDown) return; // a control that appears would move the chart under the pointer
    setAttribute(find(this.root, "pause"), "aria-pressed", String(view.paused));
    setText(find(this.root, "pause-text"), view.paused ? "Go on" : "Pause");
    setData(find(this.root, "charts"), "paused", String(view.paused));
    setHidden(find(this.root, "zoom-reset"), !view.changed);
    setHidden(find(this.root, "scrub"), !view.paused);
    if (!view.paused) return;
    const { first, last } = view.reach;
    setAttribute(this.scrub, "min", ((first - last) / view.rateHz).toFixed(2));
    setAttribute(this.scrub, "max", "0");
    const back = (view.endTick - last) / view.rateHz;
    this.scrub.value = back.toFixed(2);
    const spanS = fixed(view.spanTicks / view.rateHz, 2, "s");
    setText(find(this.root, "scrub-text"), back === 0 ? `${spanS} up to the pause` : `${spanS}, ending ${fixed(-back, 2, "s")} before the pause`);
  }

  private parameterButtons(): HTMLButtonElement[] {
    return [...find(this.root, "charts").querySelectorAll<HTMLButtonElement>("button[data-parameter]")];
  }

  private makeStrip(spec: PlotSpec, hello: Hello): Strip {
    const scale = verticalScale(spec.id, hello, this.parameter);
    const readout = find(this.root, `readout-${spec.id}`);
    setText(readout, "");
    find(this.root, `lines-${spec.id}`).replaceChildren(...this.legend.lines(spec));
    return new Strip(find(this.root, `chart-${spec.id}`), {
      spec,
      scale,
      showTime: spec.id === CHARTS.at(-1),
      hidden: this.legend.hidden,
      onCursor: (chart) => setText(readout, this.readoutAt(chart, spec, scale.readout)),
      onPress: () => {
        this.pausedBefore = this.view?.paused ?? false;
        this.pointerDown = true;
        this.view?.pause();
      },
      onRelease: (marked) => {
        this.pointerDown = false;
        this.changeView((view) => {
          if (marked) view.show(marked.fromS * view.rateHz, marked.toS * view.rateHz);
          else if (!this.pausedBefore) view.resume();
        });
      },
    });
  }

  /** Returns the values under the cursor as text; empty if the cursor is elsewhere. */
  private readoutAt(chart: uPlot, spec: PlotSpec, format: (value: number) => string): string {
    const index = chart.cursor.idx;
    if (index === null || index === undefined || (chart.cursor.left ?? -1) < 0 || !this.view) return "";
    const values = spec.traces.map((trace, i) => {
      const value = chart.data[i + 1]?.[index];
      return `${trace.mark || trace.name} ${typeof value === "number" ? format(value) : NO_VALUE}`;
    });
    const ago = this.view.nowTick / this.view.rateHz - (chart.data[0][index] ?? 0);
    return `−${ago.toFixed(2)} s: ${values.join(" · ")}`;
  }
}
