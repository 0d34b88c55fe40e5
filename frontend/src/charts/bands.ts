import type uPlot from "uplot";
import type { Buckets } from "./buckets";
import type { Trace } from "./traces";

const OPACITY = 0.2;

/** Shades one standard deviation of the logarithm around each parameter, where both have a value. */
export function drawBands(chart: uPlot, traces: Trace[], colors: string[], buckets: Buckets): void {
  if (traces.every(({ sdColumn }) => sdColumn < 0)) return;
  const { left, top, width, height } = chart.bbox;
  const context = chart.ctx;
  context.save();
  context.beginPath();
  context.rect(left, top, width, height);
  context.clip();
  context.globalAlpha = OPACITY;
  traces.forEach((trace, i) => {
    if (trace.sdColumn < 0 || !chart.series[i + 1]?.show) return;
    context.fillStyle = colors[i] ?? "";
    for (const stretch of stretches(chart, trace, buckets)) {
      context.beginPath();
      for (const { x, high } of stretch) context.lineTo(x, high);
      for (const { x, low } of stretch.toReversed()) context.lineTo(x, low);
      context.fill();
    }
  });
  context.restore();
}

interface Edge {
  x: number;
  low: number;
  high: number;
}

/** Returns the parts of a band without gaps: its two edges in canvas pixels, one point per bucket. */
function stretches(chart: uPlot, trace: Trace, buckets: Buckets): Edge[][] {
  const [values, sds] = [buckets.channel(trace.column), buckets.channel(trace.sdColumn)];
  const found: Edge[][] = [];
  let open: Edge[] | null = null;
  for (let i = 0; i < values.length; i += 2) {
    const [value, sd] = [values[i], sds[i]];
    if (typeof value !== "number" || typeof sd !== "number") {
      open = null;
      continue;
    }
    if (!open) found.push((open = []));
    open.push({
      x: chart.valToPos(buckets.time[i] ?? 0, "x", true),
      low: chart.valToPos(value * Math.exp(-sd), "y", true),
      high: chart.valToPos(value * Math.exp(sd), "y", true),
    });
  }
  return found;
}
