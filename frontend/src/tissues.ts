import type { TissueInfo } from "./wire";

/** Slots 1 to 7 are Okabe-Ito colours in `styles/theme.css`, the last slot is grey for what is not in the library. */
const SLOTS = 7;
export const UNKNOWN_SLOT = "unknown";

/** How a tissue is told from the others everywhere: a colour by its place in the library, and letters. */
export interface Look {
  name: string;
  title: string;
  slot: string;
  mark: string;
}

export function looksOf(tissues: TissueInfo[]): Look[] {
  const looks = tissues.map((tissue, i) => ({
    name: tissue.name,
    title: tissue.title,
    slot: String((i % SLOTS) + 1),
    mark: shortest(tissue.title, tissues),
  }));
  return [...looks, { name: "unknown", title: "Unknown", slot: UNKNOWN_SLOT, mark: "?" }];
}

/** Initials, or as many letters of the title as no other tissue shares. */
function shortest(title: string, tissues: TissueInfo[]): string {
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
