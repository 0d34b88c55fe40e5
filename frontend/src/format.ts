import { serverTimeMs } from "./live/clock";

/** Text for a missing value. */
export const NO_VALUE = "–";

export function fixed(value: number | null | undefined, digits: number, unit: string): string {
  return value === null || value === undefined || !Number.isFinite(value)
    ? NO_VALUE
    : `${value.toFixed(digits)}\u202f${unit}`;
}

export const newtons = (value: number | null | undefined): string => fixed(withoutMinusZero(value), 2, "N");

/** Formats a share in percent. Only exact shares read 0 % or 100 %. */
export function percent(share: number | null | undefined): string {
  if (share === null || share === undefined || !Number.isFinite(share)) return NO_VALUE;
  if (share > 0.99 && share < 1) return ">\u202f99\u202f%";
  if (share > 0 && share < 0.005) return "<\u202f1\u202f%";
  return `${Math.round(share * 100)}\u202f%`;
}

export const wholePercent = (share: number): string =>
  Number.isFinite(share) ? `${Math.round(share * 100)}\u202f%` : NO_VALUE;

export function duration(ms: number): string {
  const s = Math.max(0, ms) / 1000;
  if (s < 10) return `${s.toFixed(1)}\u202fs`;
  if (s < 60) return `${Math.floor(s)}\u202fs`;
  if (s < 3600) return `${Math.floor(s / 60)}\u202fmin ${Math.floor(s % 60)}\u202fs`;
  return `${Math.floor(s / 3600)}\u202fh ${Math.floor((s % 3600) / 60)}\u202fmin`;
}

/** Formats the time since a start in whole seconds. */
export const elapsed = (ms: number): string => {
  const s = Math.floor(Math.max(0, ms) / 1000);
  return s < 60 ? `${s}\u202fs` : duration(s * 1000);
};

/** Formats the time to a decision: in milliseconds below one second. */
export function shortTime(s: number | null): string {
  if (s === null || !Number.isFinite(s)) return NO_VALUE;
  return s < 1 ? `${Math.round(s * 1000)}\u202fms` : `${s.toFixed(2)}\u202fs`;
}

/** Formats a size with decimal prefixes, as disk sizes are given. */
export function bytes(count: number): string {
  const units = ["B", "kB", "MB", "GB", "TB"];
  const power = count < 1 ? 0 : Math.min(units.length - 1, Math.floor(Math.log10(count) / 3));
  return fixed(count / 1000 ** power, power < 3 ? 0 : 1, units[power] ?? "B");
}

/** Returns the time of day, by the server's clock in the viewer's zone, at a moment of `performance.now()`. */
export function clockTime(pageMs: number): string {
  return new Date(serverTimeMs(pageMs)).toLocaleTimeString("en-GB", { hour12: false });
}

export const count = (n: number, one: string, many = `${one}s`): string => `${n} ${n === 1 ? one : many}`;

function withoutMinusZero(value: number | null | undefined): number | null | undefined {
  return typeof value === "number" && value < 0 && value > -0.005 ? 0 : value;
}

/** Joins texts into one line, without their final periods. */
export const inOneLine = (texts: string[]): string => texts.map((text) => text.replace(/\.$/, "")).join(" · ");
