import type uPlot from "uplot";
import type { Trace } from "./traces";

/** Room right of the plot for the letters, CSS pixels. */
export const MARK_ROOM_PX = 36;
const LINE_PX = 14;

/** Face and ink of a trace's letters, as colours of the canvas; those of no tissue are written without a face. */
export interface MarkColours {
  face: string | null;
  ink: string;
}

/** Writes each trace's letters beside its newest point, so that colour is not the only thing that tells them apart. */
export function drawEndMarks(chart: uPlot, traces: Trace[], colours: MarkColours[]): void {
  const ratio = devicePixelRatio;
  const { left, top, width, height } = chart.bbox;
  const marks = traces
    .map((trace, i) => ({ text: trace.mark, colours: colours[i], y: heightOfNewest(chart, i + 1) }))
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
  { text, colours, y }: { text: string; colours: MarkColours | undefined; y: number },
  x: number,
  ratio: number,
): void {
  if (!colours) return;
  if (colours.face !== null) {
    context.fillStyle = colours.face;
    context.fillRect(x, y - 6.5 * ratio, context.measureText(text).width + 6 * ratio, 13 * ratio);
  }
  context.fillStyle = colours.ink;
  context.fillText(text, x + (colours.face === null ? 0 : 3 * ratio), y);
}

function heightOfNewest(chart: uPlot, series: number): number {
  if (!chart.series[series]?.show) return NaN;
  const points = chart.data[series];
  const newest = points?.[points.length - 1] ?? points?.[points.length - 3];
  return typeof newest === "number" ? chart.valToPos(newest, "y", true) : NaN;
}

/** Pushes marks apart, downwards first, then back up from the bottom. */
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
