import uPlot from "uplot";
import { cssColor } from "../dom";
import { drawBands } from "./bands";
import type { Buckets } from "./buckets";
import { drawEndMarks, MARK_ROOM_PX, type MarkColors } from "./endmarks";
import { legendKey } from "./legend";
import { toUplotScale, type VerticalScale } from "./scales";
import type { PlotSpec, Trace } from "./traces";

const TIME_LABELS = 6;
const VALUES_PX = 46;
const SHORTEST_DRAG_PX = 6;
/** 1, 2 and 5 times powers of ten, for short labels. */
const STEPS = [-5, -4, -3, -2, -1, 0, 1, 2].flatMap((exponent) => [1, 2, 5].map((digit) => digit * 10 ** exponent));
const FONT = "12px system-ui, sans-serif";

export interface StripOptions {
  spec: PlotSpec;
  scale: VerticalScale;
  /** Whether this chart writes the time labels; only one of the stack does. */
  showTime: boolean;
  hidden: ReadonlySet<string>;
  onCursor: (chart: uPlot) => void;
  /** The pointer button went down. The lines must stand still while a time span is marked. */
  onPress: () => void;
  /** The pointer button came up. `marked` is the marked time span, seconds since tick 0; null if there is none. */
  onRelease: (marked: { fromS: number; toS: number } | null) => void;
}

/** The time span that a chart shows, seconds since tick 0. Time labels count back from `nowS`. */
export interface TimeWindow {
  fromS: number;
  toS: number;
  nowS: number;
}

/** One strip chart. */
export class Strip {
  private readonly chart: uPlot;
  private readonly sizes: ResizeObserver;
  private buckets: Buckets | null = null;
  private nowS = 0;
  private marked: { fromS: number; toS: number } | null = null;

  constructor(
    private readonly box: HTMLElement,
    private readonly options: StripOptions,
  ) {
    const data: uPlot.AlignedData = [[], ...options.spec.traces.map(() => [])];
    this.chart = new uPlot(this.plotOptions(), data, box);
    this.chart.over.addEventListener("mousedown", () => {
      this.marked = null;
      options.onPress();
      document.addEventListener("mouseup", () => void setTimeout(() => options.onRelease(this.marked)), { once: true });
    });
    this.sizes = new ResizeObserver(() => this.chart.setSize(this.size()));
    this.sizes.observe(box);
  }

  get traces(): Trace[] {
    return this.options.spec.traces;
  }

  draw(buckets: Buckets, window: TimeWindow): void {
    this.buckets = buckets;
    this.nowS = window.nowS;
    const data: uPlot.AlignedData = [buckets.time, ...this.traces.map((trace) => buckets.channel(trace.column))];
    this.chart.batch(() => {
      this.chart.setData(data, false);
      this.chart.setScale("x", { min: window.fromS, max: window.toS });
    });
  }

  /** Shows or hides the traces that belong to a legend key. */
  show(key: string, visible: boolean): void {
    this.traces.forEach((trace, i) => {
      if (legendKey(this.options.spec, trace) === key) this.chart.setSeries(i + 1, { show: visible });
    });
  }

  destroy(): void {
    this.sizes.disconnect();
    this.chart.destroy();
  }

  private timeAxis(showTime: boolean): uPlot.Axis {
    return {
      size: showTime ? 28 : 0,
      gap: 8,
      font: FONT,
      stroke: cssColor("--text-dim"),
      grid: { stroke: cssColor("--grid"), width: 1 },
      ticks: { show: false },
      splits: (_chart, _axis, min, max) => timesBack(this.nowS, min, max),
      values: (_chart, splits) => splits.map((s) => (showTime ? secondsBack(this.nowS - s) : "")),
    };
  }

  private size(): { width: number; height: number } {
    return { width: Math.max(80, this.box.clientWidth), height: Math.max(50, this.box.clientHeight) };
  }

  private plotOptions(): uPlot.Options {
    const { spec, scale, showTime, hidden, onCursor } = this.options;
    const marks = spec.traces.map(markColors);
    const colors = spec.traces.map(({ color }) => cssColor(color)); // reading them at each repaint would force a layout
    const line = 1 / devicePixelRatio; // lines of two device pixels take three times as long to draw
    return {
      ...this.size(),
      padding: [8, MARK_ROOM_PX, showTime ? 0 : 4, 0],
      legend: { show: false },
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false }, sync: { key: "strips" } },
      scales: { x: { time: false, auto: false }, y: toUplotScale(scale) },
      axes: [this.timeAxis(showTime), valueAxis(scale)],
      series: [
        {},
        ...spec.traces.map((trace, i) => ({
          stroke: colors[i] ?? "",
          width: line,
          dash: trace.dash,
          auto: trace.scaled,
          show: !hidden.has(legendKey(spec, trace)),
          points: { show: false },
        })),
      ],
      hooks: {
        drawAxes: [(chart) => void (this.buckets && drawBands(chart, spec.traces, colors, this.buckets))],
        draw: [(chart) => drawEndMarks(chart, spec.traces, marks)],
        setCursor: [onCursor],
        setSelect: [
          (chart) => {
            const { left, width } = chart.select;
            if (width < SHORTEST_DRAG_PX) return;
            this.marked = { fromS: chart.posToVal(left, "x"), toS: chart.posToVal(left + width, "x") };
            chart.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
          },
        ],
      },
    };
  }
}

const markColors = ({ ofTissue, color }: Trace): MarkColors =>
  ofTissue ? { background: cssColor(color), text: cssColor(`${color}-ink`) } : { background: null, text: cssColor(color) };

/** Returns the round times before `nowS` within the window. */
function timesBack(nowS: number, min: number, max: number): number[] {
  const step = STEPS.find((each) => (max - min) / each <= TIME_LABELS) ?? max - min;
  const first = Math.ceil((nowS - max) / step - 1e-6);
  const count = Math.floor((nowS - min) / step + 1e-6) - first + 1;
  return Array.from({ length: Math.max(0, count) }, (_, i) => nowS - (first + i) * step).toReversed();
}

const secondsBack = (s: number): string => (Math.abs(s) < 1e-6 ? "0 s" : `−${Number(s.toFixed(3))} s`);

function valueAxis(scale: VerticalScale): uPlot.Axis {
  const { splits } = scale;
  return {
    size: VALUES_PX,
    gap: 4,
    space: 26,
    font: FONT,
    stroke: cssColor("--text-dim"),
    grid: { stroke: cssColor("--grid"), width: 1 },
    ticks: { show: false },
    values: (_chart, values) => values.map((value) => (value === null ? "" : scale.label(value))),
    ...(splits ? { splits: (_chart, _axis, min, max) => splits(min, max) } : { incrs: STEPS }),
  };
}
