import "uplot/dist/uPlot.min.css";
import type uPlot from "uplot";
import { byId, setAttribute, setData, setText } from "../dom";
import type { Model } from "../live/model";
import type { SampleRing } from "../live/ring";
import { NO_VALUE } from "../format";
import { Buckets } from "./buckets";
import { Legend, lineNames } from "./legend";
import { verticalScale } from "./scales";
import { Strip, WINDOW_S } from "./strip";
import { plotSpecs, type Parameter, type PlotSpec } from "./traces";

/** Pairs of points across a chart, about one a pixel; 500 cost half as much time again. */
const BUCKETS = 250;
const CHARTS = ["force", "displacement", "probability", "parameter"];
const PARAMETERS: Record<Parameter, string> = {
  alpha_n: "N, stiffness α",
  beta_per_m: "1/m, stiffening β",
  damping_kg_per_s: "kg/s, damping d",
};

/** The four strip charts on one time axis. */
export class ChartStack {
  private strips: Strip[] = [];
  private buckets: Buckets | null = null;
  private builtFor: { ring: SampleRing; channels: unknown } | null = null;
  private drawnTick = -1;
  private parameter: Parameter = "alpha_n";
  private paused = false;
  private readonly legend = new Legend(byId("legend"), (key, visible) =>
    this.strips.forEach((strip) => strip.show(key, visible)),
  );

  constructor(private readonly model: Model) {
    byId("pause").addEventListener("click", () => this.togglePause());
    for (const button of this.parameterButtons()) {
      button.addEventListener("click", () => this.choose(button.dataset.parameter as Parameter));
    }
  }

  /** Draws what is new, unless paused; the ring goes on filling meanwhile. */
  render(): void {
    const { ring, hello } = this.model;
    setData(byId("charts"), "empty", String(ring === null || ring.isEmpty));
    if (!ring || !hello) return;
    if (this.builtFor?.ring !== ring || this.builtFor.channels !== hello.channels) this.rebuild();
    if (this.paused && this.drawnTick >= 0) return;
    if (!this.buckets || ring.isEmpty || ring.end === this.drawnTick) return;
    this.buckets.update();
    this.drawnTick = ring.end;
    const endS = ring.end / hello.tool.sample_rate_hz;
    for (const strip of this.strips) strip.draw(this.buckets, endS);
  }

  /** Older samples have come in: read the ring again. */
  historyChanged(): void {
    this.buckets?.invalidate();
  }

  /** Builds the charts anew: other channels, other parameter, other theme. */
  rebuild(): void {
    const { ring, hello } = this.model;
    if (!ring || !hello) return;
    const bucketTicks = Math.max(1, Math.ceil((hello.tool.sample_rate_hz * WINDOW_S) / BUCKETS));
    this.buckets = new Buckets(ring, hello.channels.length, hello.tool.sample_rate_hz, bucketTicks, BUCKETS + 1);
    this.builtFor = { ring, channels: hello.channels };
    this.drawnTick = -1;
    for (const strip of this.strips) strip.destroy();
    const specs = plotSpecs(this.model, this.parameter);
    this.legend.rebuild(specs);
    this.strips = specs.map((spec) => this.strip(spec));
    setText(byId("parameter-unit"), PARAMETERS[this.parameter]);
  }

  togglePause(): void {
    this.paused = !this.paused;
    this.historyChanged();
    this.drawnTick = -1;
    setAttribute(byId("pause"), "aria-pressed", String(this.paused));
    setText(byId("pause-text"), this.paused ? "Go on" : "Pause");
    setData(byId("charts"), "paused", String(this.paused));
  }

  choose(parameter: Parameter): void {
    this.parameter = parameter;
    for (const button of this.parameterButtons()) {
      setAttribute(button, "aria-pressed", String(button.dataset.parameter === parameter));
    }
    this.rebuild();
  }

  private parameterButtons(): HTMLButtonElement[] {
    return [...document.querySelectorAll<HTMLButtonElement>("button[data-parameter]")];
  }

  private strip(spec: PlotSpec): Strip {
    const scale = verticalScale(spec.id, this.model.hello!, this.parameter);
    const readout = byId(`readout-${spec.id}`);
    setText(readout, "");
    byId(`lines-${spec.id}`).replaceChildren(...lineNames(spec));
    return new Strip(byId(`chart-${spec.id}`), {
      spec,
      scale,
      showTime: spec.id === CHARTS.at(-1),
      hidden: this.legend.hidden,
      onCursor: (chart) => setText(readout, readoutAt(chart, spec, scale.readout)),
    });
  }
}

/** The values under the cursor, in words; empty while the cursor is elsewhere. */
function readoutAt(chart: uPlot, spec: PlotSpec, say: (value: number) => string): string {
  const index = chart.cursor.idx;
  if (index === null || index === undefined || (chart.cursor.left ?? -1) < 0) return "";
  const values = spec.traces.map((trace, i) => {
    const value = chart.data[i + 1]?.[index];
    return `${trace.mark || trace.name} ${typeof value === "number" ? say(value) : NO_VALUE}`;
  });
  const ago = (chart.scales.x?.max ?? 0) - (chart.data[0][index] ?? 0);
  return `−${ago.toFixed(2)} s: ${values.join(" · ")}`;
}
