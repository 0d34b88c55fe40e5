import { drawReferences, frameOf, type Axis } from "../cards/stress-plot";
import { create, fill, find, setAttribute, setText } from "../dom";
import { fixed } from "../format";
import { showHints } from "../shell/hints";
import type { Page } from "../shell/router";
import { looksOf } from "../tissues";
import type { LibraryInfo, TissueInfo } from "../wire";
import "../styles/cards.css";
import "../styles/pages.css";
import { showFacts } from "./facts";
import { Polled } from "./polled";
import { headCell } from "./rows";
import markup from "./tissues.html?raw";

const EVERY_MS = 30_000;
const DIGITS = 4;

/** The tissue library in use: its profiles, where they are from, how much they spread, and their curves. */
export class TissuesPage implements Page {
  private readonly root: HTMLElement;
  private readonly canvas: HTMLCanvasElement;
  private readonly sizes = new ResizeObserver(() => this.draw());
  private readonly polled: Polled<LibraryInfo>;
  private library: LibraryInfo | null = null;
  private axis: Axis = "mm";

  constructor(box: HTMLElement) {
    this.root = fill(box, markup);
    showHints(this.root);
    this.canvas = find(this.root, "library-plot", HTMLCanvasElement);
    this.sizes.observe(this.canvas);
    for (const button of this.axisButtons()) button.addEventListener("click", () => this.choose(button.dataset.axis as Axis));
    const section = find(this.root, "library-plot-card");
    this.polled = new Polled({ path: "/api/tissues", what: "The library", section, take: (library) => this.take(library) });
  }

  render(): void {}

  themeChanged(): void {
    this.draw();
  }

  close(): void {
    this.polled.close();
    this.sizes.disconnect();
  }

  private take(library: LibraryInfo): number {
    const same = JSON.stringify(library) === JSON.stringify(this.library);
    this.library = library;
    setAttribute(find(this.root, "library"), "data-state", "ready");
    if (same) return EVERY_MS;
    setText(find(this.root, "library-heading"), library.title);
    showFacts(find(this.root, "library-facts"), {
      Library: library.name,
      Source: library.source,
      "Jaw area": fixed(library.jaw_area_m2 * 1e6, 1, "mm²"),
      Mass: fixed(library.mass_kg * 1e3, 1, "g"),
    });
    find(this.root, "library-body").replaceChildren(...rowsOf(library));
    this.draw();
    return EVERY_MS;
  }

  private draw(): void {
    if (!this.library || this.canvas.clientWidth === 0) return;
    drawReferences(this.canvas, frameOf(this.canvas, this.library, this.axis), this.library);
  }

  private choose(axis: Axis): void {
    this.axis = axis;
    for (const button of this.axisButtons()) setAttribute(button, "aria-pressed", String(button.dataset.axis === axis));
    this.draw();
  }

  private axisButtons(): HTMLButtonElement[] {
    return [...this.root.querySelectorAll<HTMLButtonElement>("button[data-axis]")];
  }
}

function rowsOf({ tissues }: LibraryInfo): HTMLTableRowElement[] {
  const looks = new Map(looksOf(tissues).map((look) => [look.name, look]));
  return tissues.map((tissue) => {
    const look = looks.get(tissue.name);
    const row = create("tr");
    const what = headCell("what");
    what.dataset.slot = look?.slot ?? "";
    what.append(create("span", "swatch", look?.mark ?? ""), tissue.title);
    row.append(what, ...cellsOf(tissue));
    return row;
  });
}

const cellsOf = ({ spread, ...tissue }: TissueInfo): HTMLTableCellElement[] => [
  valueCell(significant(tissue.alpha_n), spread.log_alpha),
  valueCell(significant(tissue.beta_per_m), spread.log_beta),
  valueCell(significant(tissue.damping_kg_per_s), spread.log_damping),
  valueCell(significant(tissue.thickness_m * 1e3), spread.log_thickness),
  valueCell(significant(tissue.threshold_pa / 1e3), null),
  valueCell(tissue.threshold_n.toFixed(2), null),
];

function valueCell(value: string, logSd: number | null): HTMLTableCellElement {
  const cell = create("td", "number", value);
  if (logSd !== null) cell.append(create("small", "spread", `×/÷\u202f${Math.exp(logSd).toFixed(2)}`));
  return cell;
}

/** As the library's file has it, but no more digits than count. */
const significant = (value: number): string => String(Number(value.toPrecision(DIGITS)));
