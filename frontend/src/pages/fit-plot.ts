import { createSvg } from "../dom";
import type { CalibrationResult } from "../wire";

const BOX = { left: 66, right: 590, top: 10, bottom: 250 };
const TICKS = 5;

type Points = Pick<CalibrationResult, "axes" | "x" | "y" | "line_x" | "line_y">;

/** Draws readings as dots and their fit as a line, with axes. */
export function plot(svg: SVGElement, { axes, x, y, line_x, line_y }: Points): void {
  const across = scale([...x, ...line_x], BOX.left, BOX.right);
  const up = scale([...y, ...line_y], BOX.bottom, BOX.top);
  const parts: SVGElement[] = [];
  for (let n = 0; n <= TICKS; n += 1) {
    const atX = across.from + (n / TICKS) * across.span;
    const atY = up.from + (n / TICKS) * up.span;
    parts.push(label(across.of(atX), BOX.bottom + 18, atX, "middle"), label(BOX.left - 8, up.of(atY) + 5, atY, "end"));
    parts.push(createSvg("line", { x1: BOX.left, x2: BOX.right, y1: up.of(atY), y2: up.of(atY), class: "grid" }));
  }
  const line = line_x.map((each, n) => `${across.of(each)},${up.of(line_y[n] ?? 0)}`).join(" ");
  parts.push(createSvg("polyline", { points: line, class: "fit" }));
  parts.push(...x.map((each, n) => createSvg("circle", { cx: across.of(each), cy: up.of(y[n] ?? 0), r: 3, class: "reading" })));
  const [below = "", beside = ""] = axes;
  parts.push(text((BOX.left + BOX.right) / 2, BOX.bottom + 42, below, "middle"));
  const title = text(14, (BOX.top + BOX.bottom) / 2, beside, "middle");
  title.setAttribute("transform", `rotate(-90 14 ${(BOX.top + BOX.bottom) / 2})`);
  svg.replaceChildren(...parts, title);
}

function scale(values: number[], begin: number, end: number): { of: (value: number) => number; from: number; span: number } {
  const from = Math.min(...values);
  const span = Math.max(...values) - from || 1;
  return { of: (value) => begin + ((value - from) / span) * (end - begin), from, span };
}

function label(x: number, y: number, value: number, anchor: string): SVGElement {
  return text(x, y, Number(value.toPrecision(3)).toString(), anchor);
}

function text(x: number, y: number, content: string, anchor: string): SVGElement {
  const element = createSvg("text", { x, y, "text-anchor": anchor });
  element.textContent = content;
  return element;
}
