import uPlot from "uplot";
import type { Buckets } from "./buckets";
import { drawEndMarks, MARK_ROOM_PX, type MarkColours } from "./endmarks";
import { asScale, type VerticalScale } from "./scales";
import type { PlotSpec, Trace } from "./traces";

export const WINDOW_S = 10;
const GRID_S = 2;
const VALUES_PX = 46;
/** 1, 2 and 5 times the powers of ten, so that every label is a short number. */
const STEPS = [-5, -4, -3, -2, -1, 0, 1, 2].flatMap((exponent) => [1, 2, 5].map((digit) => digit * 10 ** exponent));
const FONT = "12px system-ui, sans-serif";

export interface StripOptions {
  spec: PlotSpec;
  scale: VerticalScale;
  /** Only one chart of the stack writes the times. */
  showTime: boolean;
  hidden: ReadonlySet<string>;
  onCursor: (chart: uPlot) => void;
}

/** One strip chart of the last ten seconds. */
export class Strip {
  private readonly chart: uPlot;
  private readonly sizes: ResizeObserver;

  constructor(
    private readonly box: HTMLElement,
    private readonly options: StripOptions,
  ) {
    const data: uPlot.AlignedData = [[], ...options.spec.traces.map(() => [])];
    this.chart = new uPlot(this.plotOptions(), data, box);
    this.sizes = new ResizeObserver(() => this.chart.setSize(this.size()));
    this.sizes.observe(box);
  }

  get traces(): Trace[] {
    return this.options.spec.traces;
  }

  draw(buckets: Buckets, endS: number): void {
    const data: uPlot.AlignedData = [buckets.time, ...this.traces.map((trace) => buckets.channel(trace.column))];
    this.chart.batch(() => {
      this.chart.setData(data, false);
      this.chart.setScale("x", { min: endS - WINDOW_S, max: endS });
    });
  }

  /** Shows or hides the traces of a legend key. */
  show(key: string, visible: boolean): void {
    this.traces.forEach((trace, i) => {
      if (trace.key === key) this.chart.setSeries(i + 1, { show: visible });
    });
  }

  destroy(): void {
    this.sizes.disconnect();
    this.chart.destroy();
  }

  private size(): { width: number; height: number } {
    return { width: Math.max(80, this.box.clientWidth), height: Math.max(50, this.box.clientHeight) };
  }

  private plotOptions(): uPlot.Options {
    const { spec, scale, showTime, hidden, onCursor } = this.options;
    const marks = spec.traces.map(markColours);
    const line = 1 / devicePixelRatio; // lines of two device pixels cost three times as much
    return {
      ...this.size(),
      padding: [8, MARK_ROOM_PX, showTime ? 0 : 4, 0],
      legend: { show: false },
      cursor: { y: false, points: { show: false }, drag: { x: false, y: false }, sync: { key: "strips" } },
      scales: { x: { time: false, auto: false }, y: asScale(scale) },
      axes: [timeAxis(showTime), valueAxis(scale)],
      series: [
        {},
        ...spec.traces.map((trace) => ({
          stroke: cssColour(trace.colour),
          width: line,
          dash: trace.dash,
          auto: trace.scaled,
          show: !hidden.has(trace.key),
          points: { show: false },
        })),
      ],
      hooks: {
        draw: [(chart) => drawEndMarks(chart, spec.traces, marks)],
        setCursor: [onCursor],
      },
    };
  }
}

/** The colour of a custom property in the theme that is on. */
function cssColour(name: string): string {
  return getComputedStyle(document.documentElement).getPropertyValue(name).trim();
}

const markColours = ({ ofTissue, colour }: Trace): MarkColours =>
  ofTissue ? { face: cssColour(colour), ink: cssColour(`${colour}-ink`) } : { face: null, ink: cssColour(colour) };

function timeAxis(showTime: boolean): uPlot.Axis {
  const steps = Array.from({ length: WINDOW_S / GRID_S + 1 }, (_, i) => i * GRID_S - WINDOW_S);
  return {
    size: showTime ? 28 : 0,
    gap: 8,
    font: FONT,
    stroke: cssColour("--text-dim"),
    grid: { stroke: cssColour("--grid"), width: 1 },
    ticks: { show: false },
    splits: (_chart, _axis, _min, max) => steps.map((step) => max + step),
    values: () => (showTime ? steps.map((step) => (step === 0 ? "0 s" : `−${-step} s`)) : steps.map(() => "")),
  };
}

function valueAxis(scale: VerticalScale): uPlot.Axis {
  const { splits } = scale;
  return {
    size: VALUES_PX,
    gap: 4,
    space: 26,
    font: FONT,
    stroke: cssColour("--text-dim"),
    grid: { stroke: cssColour("--grid"), width: 1 },
    ticks: { show: false },
    values: (_chart, values) => values.map((value) => (value === null ? "" : scale.label(value))),
    ...(splits ? { splits: (_chart, _axis, min, max) => splits(min, max) } : { incrs: STEPS }),
  };
}
