import type { TissueInfo } from "./wire";

/** Slots 1 to 7 are Okabe-Ito colors in `styles/theme.css`. The last slot is gray, for tissues outside the library. */
const SLOTS = 7;
export const UNKNOWN_SLOT = "unknown";

/** How every card and chart marks a tissue: a color by its place in the library, and letters. */
export interface TissueStyle {
  name: string;
  title: string;
  slot: string;
  mark: string;
}

export function tissueStyles(tissues: TissueInfo[]): TissueStyle[] {
  const styles = tissues.map((tissue, i) => ({
    name: tissue.name,
    title: tissue.title,
    slot: String((i % SLOTS) + 1),
    mark: uniqueMark(tissue.title, tissues),
  }));
  return [...styles, { name: "unknown", title: "Unknown", slot: UNKNOWN_SLOT, mark: "?" }];
}

/** Returns the initials of a title or, if another tissue shares them, as many first letters as make it unique. */
function uniqueMark(title: string, tissues: TissueInfo[]): string {
  const others = tissues.map((tissue) => tissue.title).filter((other) => other !== title);
  const initials = initialsOf(title);
  if (!others.some((other) => initialsOf(other) === initials)) return initials;
  for (let length = 2; length < title.length; length++) {
    if (!others.some((other) => other.startsWith(title.slice(0, length)))) return title.slice(0, length);
  }
  return title;
}

const initialsOf = (title: string): string =>
  title
    .split(/\s+/)
    .map((word) => word[0]?.toUpperCase() ?? "")
    .join("");
