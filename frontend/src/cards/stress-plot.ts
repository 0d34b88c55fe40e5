import { cssColor } from "../dom";
import { tissueStyles, UNKNOWN_SLOT, type TissueStyle } from "../tissues";
import type { LibraryInfo, TissueInfo } from "../wire";

/** Horizontal axis: compression in millimeters, or as a share of the tissue's thickness. */
export type Axis = "mm" | "strain";

/** The plot's area on the canvas in device pixels, with its scales. */
export interface PlotArea {
  width: number;
  height: number;
  left: number;
  right: number;
  top: number;
  bottom: number;
  axis: Axis;
  maxX: number;
  maxForceN: number;
  x: (value: number) => number;
  y: (forceN: number) => number;
  colors: { live: string; text: string; grid: string };
}

const POINTS = 80;
const MARGIN = { left: 44, right: 26, top: 8, bottom: 34 };
const FONT_PX = 12;
const SPREAD_SDS = 1;

export function plotArea(canvas: HTMLCanvasElement, library: LibraryInfo, axis: Axis): PlotArea {
  const ratio = devicePixelRatio;
  const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
  const [left, right] = [MARGIN.left * ratio, width - MARGIN.right * ratio];
  const [top, bottom] = [MARGIN.top * ratio, height - MARGIN.bottom * ratio];
  const maxForceN = Math.min(...library.tissues.map(({ threshold_n: n }) => n)) * 1.15;
  const reach = library.tissues.map((tissue) => compression(tissue, maxForceN) / scale(tissue, axis));
  const maxX = Math.max(...reach) * 1.02;
  return {
    width,
    height,
    left,
    right,
    top,
    bottom,
    axis,
    maxX,
    maxForceN,
    x: (value) => left + (value / maxX) * (right - left),
    y: (forceN) => bottom - (Math.max(forceN, -0.05 * maxForceN) / maxForceN) * (bottom - top),
    colors: { live: cssColor("--line-measured"), text: cssColor("--text-dim"), grid: cssColor("--grid") },
  };
}

const scale = (tissue: TissueInfo, axis: Axis): number => (axis === "mm" ? 1e-3 : tissue.thickness_m);

/** Compression at which the elastic force of Eq. (7) reaches `forceN`, m. */
const compression = ({ alpha_n: alpha, beta_per_m: beta }: TissueInfo, forceN: number): number =>
  Math.log1p(forceN / alpha) / beta;

/** Draws the axes, and each tissue's curve with the spread between specimens. */
export function drawReferences(canvas: HTMLCanvasElement, area: PlotArea, library: LibraryInfo): void {
  canvas.width = area.width;
  canvas.height = area.height;
  const context = canvas.getContext("2d");
  if (!context) return;
  drawAxes(context, area, library.jaw_area_m2);
  context.save();
  context.beginPath();
  context.rect(area.left, area.top, area.right - area.left, area.bottom - area.top);
  context.clip();
  for (const style of tissueStyles(library.tissues)) {
    const tissue = library.tissues.find(({ name }) => name === style.name);
    if (tissue && style.slot !== UNKNOWN_SLOT) drawTissue(context, area, tissue, cssColor(`--tissue-${style.slot}`));
  }
  context.restore();
  markTissues(context, area, library.tissues);
}

function drawTissue(context: CanvasRenderingContext2D, area: PlotArea, tissue: TissueInfo, color: string): void {
  const { log_alpha: ofAlpha, log_beta: ofBeta, log_thickness: ofThickness } = tissue.spread;
  const maxCompressionM = compression(tissue, area.maxForceN);
  const middle = Array.from({ length: POINTS + 1 }, (_, i) => {
    const compressionM = (maxCompressionM * i) / POINTS;
    return { forceN: tissue.alpha_n * Math.expm1(tissue.beta_per_m * compressionM), value: compressionM / scale(tissue, area.axis) };
  });
  const spread = middle.map(({ forceN }) => spreadOfLog(tissue, forceN, ofAlpha, ofBeta, area.axis === "mm" ? 0 : ofThickness));
  const side = (sign: number): [number, number][] =>
    middle.map(({ forceN, value }, i) => [area.x(value * Math.exp(sign * SPREAD_SDS * (spread[i] ?? 0))), area.y(forceN)]);
  context.fillStyle = color;
  context.globalAlpha = 0.22;
  context.beginPath();
  for (const [x, y] of [...side(-1), ...side(1).toReversed()]) context.lineTo(x, y);
  context.fill();
  context.globalAlpha = 1;
  context.strokeStyle = color;
  context.lineWidth = 1.5 * devicePixelRatio;
  context.beginPath();
  for (const { forceN, value } of middle) context.lineTo(area.x(value), area.y(forceN));
  context.stroke();
}

/** SD of the logarithm of the compression at a force, from those of alpha, beta and thickness (to first order). */
function spreadOfLog(tissue: TissueInfo, forceN: number, ofAlpha: number, ofBeta: number, ofThickness: number): number {
  const ratio = forceN / tissue.alpha_n;
  const byAlpha = ratio < 1e-6 ? 1 : ratio / (1 + ratio) / Math.log1p(ratio);
  return Math.hypot(byAlpha * ofAlpha, ofBeta, ofThickness);
}

/** Writes each tissue's letters at the upper end of its curve, from left to right, without overlap. */
function markTissues(context: CanvasRenderingContext2D, area: PlotArea, tissues: TissueInfo[]): void {
  const styles = new Map(tissueStyles(tissues).map((style) => [style.name, style]));
  const ends = tissues.map((tissue) => ({
    style: styles.get(tissue.name),
    end: area.x(compression(tissue, area.maxForceN) / scale(tissue, area.axis)),
  }));
  let free = area.left;
  for (const { style, end } of ends.toSorted((a, b) => a.end - b.end)) {
    if (style) free = drawMark(context, area, style, Math.max(end, free));
  }
}

/** Writes the letters from `from` on, and returns where the next ones may begin. */
function drawMark(context: CanvasRenderingContext2D, area: PlotArea, { mark, slot }: TissueStyle, from: number): number {
  const ratio = devicePixelRatio;
  context.font = `700 ${11 * ratio}px system-ui, sans-serif`;
  const width = context.measureText(mark).width + 6 * ratio;
  const [x, y] = [Math.min(from + 2 * ratio, area.width - width), area.top + 8 * ratio];
  context.fillStyle = cssColor(`--tissue-${slot}`);
  context.fillRect(x, y - 7 * ratio, width, 14 * ratio);
  context.fillStyle = cssColor(`--tissue-${slot}-ink`);
  context.textBaseline = "middle";
  context.textAlign = "left";
  context.fillText(mark, x + 3 * ratio, y);
  return x + width;
}

function drawAxes(context: CanvasRenderingContext2D, area: PlotArea, areaM2: number): void {
  const ratio = devicePixelRatio;
  const maxKpa = area.maxForceN / areaM2 / 1e3;
  context.font = `${FONT_PX * ratio}px system-ui, sans-serif`;
  context.fillStyle = area.colors.text;
  context.strokeStyle = area.colors.grid;
  context.lineWidth = 1;
  context.textBaseline = "middle";
  context.textAlign = "right";
  for (const kpa of roundSteps(maxKpa)) {
    const y = Math.round(area.y((kpa * 1e3) * areaM2)) + 0.5;
    line(context, area.left, y, area.right, y);
    context.fillText(String(kpa), area.left - 5 * ratio, y);
  }
  context.textAlign = "center";
  context.textBaseline = "top";
  for (const value of roundSteps(area.maxX)) {
    const x = Math.round(area.x(value)) + 0.5;
    line(context, x, area.top, x, area.bottom);
    context.fillText(String(value), x, area.bottom + 4 * ratio);
  }
  const unit = area.axis === "mm" ? "compression, mm" : "strain (compression / thickness)";
  context.fillText(unit, (area.left + area.right) / 2, area.bottom + 18 * ratio);
  context.textAlign = "left";
  context.fillText("kPa", 2 * ratio, area.top);
}

function line(context: CanvasRenderingContext2D, x1: number, y1: number, x2: number, y2: number): void {
  context.beginPath();
  context.moveTo(x1, y1);
  context.lineTo(x2, y2);
  context.stroke();
}

/** Returns four to eight round values from 0 to `max`. */
function roundSteps(max: number): number[] {
  const power = 10 ** Math.floor(Math.log10(max / 4));
  const step = [1, 2, 5, 10].map((digit) => digit * power).find((each) => max / each <= 8) ?? power;
  return Array.from({ length: Math.floor(max / step) + 1 }, (_, i) => Number((i * step).toPrecision(6)));
}
