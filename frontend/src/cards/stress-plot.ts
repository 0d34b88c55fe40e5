import { cssColour } from "../dom";
import { looksOf, UNKNOWN_SLOT, type Look } from "../tissues";
import type { LibraryInfo, TissueInfo } from "../wire";

/** Compression in millimetres, or as a share of the tissue's thickness. */
export type Axis = "mm" | "strain";

/** Where the plot's area lies on the canvas, in device pixels, and how values are placed in it. */
export interface Frame {
  width: number;
  height: number;
  left: number;
  right: number;
  top: number;
  bottom: number;
  axis: Axis;
  mostX: number;
  mostN: number;
  x: (value: number) => number;
  y: (forceN: number) => number;
  colours: { live: string; text: string; grid: string };
}

const POINTS = 80;
const MARGIN = { left: 44, right: 26, top: 8, bottom: 34 };
const FONT_PX = 12;
const SPREAD_SDS = 1;

export function frameOf(canvas: HTMLCanvasElement, library: LibraryInfo, axis: Axis): Frame {
  const ratio = devicePixelRatio;
  const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
  const [left, right] = [MARGIN.left * ratio, width - MARGIN.right * ratio];
  const [top, bottom] = [MARGIN.top * ratio, height - MARGIN.bottom * ratio];
  const mostN = Math.min(...library.tissues.map(({ threshold_n: n }) => n)) * 1.15;
  const reach = library.tissues.map((tissue) => compression(tissue, mostN) / scale(tissue, axis));
  const mostX = Math.max(...reach) * 1.02;
  return {
    width,
    height,
    left,
    right,
    top,
    bottom,
    axis,
    mostX,
    mostN,
    x: (value) => left + (value / mostX) * (right - left),
    y: (forceN) => bottom - (Math.max(forceN, -0.05 * mostN) / mostN) * (bottom - top),
    colours: { live: cssColour("--line-measured"), text: cssColour("--text-dim"), grid: cssColour("--grid") },
  };
}

const scale = (tissue: TissueInfo, axis: Axis): number => (axis === "mm" ? 1e-3 : tissue.thickness_m);

/** Compression at which the elastic force of Eq. (7) reaches `forceN`, m. */
const compression = ({ alpha_n: alpha, beta_per_m: beta }: TissueInfo, forceN: number): number =>
  Math.log1p(forceN / alpha) / beta;

/** Everything that does not move: axes, and each tissue's curve with the spread between specimens. */
export function drawReferences(canvas: HTMLCanvasElement, frame: Frame, library: LibraryInfo): void {
  canvas.width = frame.width;
  canvas.height = frame.height;
  const context = canvas.getContext("2d");
  if (!context) return;
  drawAxes(context, frame, library.jaw_area_m2);
  context.save();
  context.beginPath();
  context.rect(frame.left, frame.top, frame.right - frame.left, frame.bottom - frame.top);
  context.clip();
  for (const look of looksOf(library.tissues)) {
    const tissue = library.tissues.find(({ name }) => name === look.name);
    if (tissue && look.slot !== UNKNOWN_SLOT) drawTissue(context, frame, tissue, cssColour(`--tissue-${look.slot}`));
  }
  context.restore();
  markTissues(context, frame, library.tissues);
}

function drawTissue(context: CanvasRenderingContext2D, frame: Frame, tissue: TissueInfo, colour: string): void {
  const { log_alpha: ofAlpha, log_beta: ofBeta, log_thickness: ofThickness } = tissue.spread;
  const mostM = compression(tissue, frame.mostN);
  const middle = Array.from({ length: POINTS + 1 }, (_, i) => {
    const compressionM = (mostM * i) / POINTS;
    return { forceN: tissue.alpha_n * Math.expm1(tissue.beta_per_m * compressionM), value: compressionM / scale(tissue, frame.axis) };
  });
  const spread = middle.map(({ forceN }) => spreadOfLog(tissue, forceN, ofAlpha, ofBeta, frame.axis === "mm" ? 0 : ofThickness));
  const side = (sign: number): [number, number][] =>
    middle.map(({ forceN, value }, i) => [frame.x(value * Math.exp(sign * SPREAD_SDS * (spread[i] ?? 0))), frame.y(forceN)]);
  context.fillStyle = colour;
  context.globalAlpha = 0.22;
  context.beginPath();
  for (const [x, y] of [...side(-1), ...side(1).toReversed()]) context.lineTo(x, y);
  context.fill();
  context.globalAlpha = 1;
  context.strokeStyle = colour;
  context.lineWidth = 1.5 * devicePixelRatio;
  context.beginPath();
  for (const { forceN, value } of middle) context.lineTo(frame.x(value), frame.y(forceN));
  context.stroke();
}

/** SD of the logarithm of the compression at a force, from those of alpha, beta and thickness (to first order). */
function spreadOfLog(tissue: TissueInfo, forceN: number, ofAlpha: number, ofBeta: number, ofThickness: number): number {
  const ratio = forceN / tissue.alpha_n;
  const byAlpha = ratio < 1e-6 ? 1 : ratio / (1 + ratio) / Math.log1p(ratio);
  return Math.hypot(byAlpha * ofAlpha, ofBeta, ofThickness);
}

/** Each curve's letters at its upper end, from left to right; where two are close, the right one gives way. */
function markTissues(context: CanvasRenderingContext2D, frame: Frame, tissues: TissueInfo[]): void {
  const looks = new Map(looksOf(tissues).map((look) => [look.name, look]));
  const ends = tissues.map((tissue) => ({
    look: looks.get(tissue.name),
    end: frame.x(compression(tissue, frame.mostN) / scale(tissue, frame.axis)),
  }));
  let free = frame.left;
  for (const { look, end } of ends.toSorted((a, b) => a.end - b.end)) {
    if (look) free = drawMark(context, frame, look, Math.max(end, free));
  }
}

/** Returns where the next one may begin. */
function drawMark(context: CanvasRenderingContext2D, frame: Frame, { mark, slot }: Look, from: number): number {
  const ratio = devicePixelRatio;
  context.font = `700 ${11 * ratio}px system-ui, sans-serif`;
  const width = context.measureText(mark).width + 6 * ratio;
  const [x, y] = [Math.min(from + 2 * ratio, frame.width - width), frame.top + 8 * ratio];
  context.fillStyle = cssColour(`--tissue-${slot}`);
  context.fillRect(x, y - 7 * ratio, width, 14 * ratio);
  context.fillStyle = cssColour(`--tissue-${slot}-ink`);
  context.textBaseline = "middle";
  context.textAlign = "left";
  context.fillText(mark, x + 3 * ratio, y);
  return x + width;
}

function drawAxes(context: CanvasRenderingContext2D, frame: Frame, areaM2: number): void {
  const ratio = devicePixelRatio;
  const mostKpa = frame.mostN / areaM2 / 1e3;
  context.font = `${FONT_PX * ratio}px system-ui, sans-serif`;
  context.fillStyle = frame.colours.text;
  context.strokeStyle = frame.colours.grid;
  context.lineWidth = 1;
  context.textBaseline = "middle";
  context.textAlign = "right";
  for (const kpa of roundSteps(mostKpa)) {
    const y = Math.round(frame.y((kpa * 1e3) * areaM2)) + 0.5;
    line(context, frame.left, y, frame.right, y);
    context.fillText(String(kpa), frame.left - 5 * ratio, y);
  }
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const value of roundSteps(frame.mostX)) {
    const x = Math.round(frame.x(value)) + 0.5;
    line(context, x, frame.top, x, frame.bottom);
    context.fillText(String(value), x, frame.bottom + 4 * ratio);
  }
  const unit = frame.axis === "mm" ? "compression, mm" : "strain (compression / thickness)";
  context.fillText(unit, (frame.left + frame.right) / 2, frame.bottom + 18 * ratio);
  context.textAlign = "left";
  context.fillText("kPa", 2 * ratio, frame.top);
}

function line(context: CanvasRenderingContext2D, x1: number, y1: number, x2: number, y2: number): void {
  context.beginPath();
  context.moveTo(x1, y1);
  context.lineTo(x2, y2);
  context.stroke();
}

/** Four to eight round values from 0 to `most`. */
function roundSteps(most: number): number[] {
  const power = 10 ** Math.floor(Math.log10(most / 4));
  const step = [1, 2, 5, 10].map((digit) => digit * power).find((each) => most / each <= 8) ?? power;
  return Array.from({ length: Math.floor(most / step) + 1 }, (_, i) => Number((i * step).toPrecision(6)));
}
