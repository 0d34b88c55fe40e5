import type uPlot from "uplot";
import type { Trace } from "./traces";

/** Room to the right of the plot for the letters, CSS pixels. */
export const MARK_ROOM_PX = 36;
const LINE_PX = 14;

/** Canvas colors of a trace's letters. Those of the tool's lines have no background. */
export interface MarkColors {
  background: string | null;
  text: string;
}

/** Writes each trace's letters beside its newest point, so that color is not the only difference between lines. */
export function drawEndMarks(chart: uPlot, traces: Trace[], colors: MarkColors[]): void {
  const ratio = devicePixelRatio;
  const { left, top, width, height } = chart.bbox;
  const marks = traces
    .map((trace, i) => ({ text: trace.mark, colors: colors[i], y: heightOfNewest(chart, i + 1) }))
    .filter(({ text, y }) => text !== "" && y >= top && y <= top + height)
    .toSorted((a, b) => a.y - b.y);
  spread(marks, LINE_PX * ratio, top, top + height);
  const context = chart.ctx;
  context.save();
  context.font = `700 ${11 * ratio}px system-ui, sans-serif`;
  context.textBaseline = "middle";
  context.textAlign = "left";
  for (const mark of marks) drawMark(context, mark, left + width + 4 * ratio, ratio);
  context.restore();
}

function drawMark(
  context: CanvasRenderingContext2D,
  { text, colors, y }: { text: string; colors: MarkColors | undefined; y: number },
  x: number,
  ratio: number,
): void {
  if (!colors) return;
  if (colors.background !== null) {
    context.fillStyle = colors.background;
    context.fillRect(x, y - 6.5 * ratio, context.measureText(text).width + 6 * ratio, 13 * ratio);
  }
  context.fillStyle = colors.text;
  context.fillText(text, x + (colors.background === null ? 0 : 3 * ratio), y);
}

function heightOfNewest(chart: uPlot, series: number): number {
  if (!chart.series[series]?.show) return NaN;
  const points = chart.data[series];
  const newest = points?.[points.length - 1] ?? points?.[points.length - 3];
  return typeof newest === "number" ? chart.valToPos(newest, "y", true) : NaN;
}

/** Moves marks apart: downward first, then back up from the bottom edge. */
function spread(marks: { y: number }[], gap: number, top: number, bottom: number): void {
  let floor = top;
  for (const mark of marks) {
    mark.y = Math.max(mark.y, floor);
    floor = mark.y + gap;
  }
  let ceiling = bottom;
  for (const mark of marks.toReversed()) {
    mark.y = Math.min(mark.y, ceiling);
    ceiling = mark.y - gap;
  }
}
