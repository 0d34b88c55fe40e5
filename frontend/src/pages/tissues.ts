import { drawReferences, plotArea, type Axis } from "../cards/stress-plot";
import { create, fill, find, setAttribute, setText } from "../dom";
import { fixed } from "../format";
import { showHints } from "../shell/hints";
import type { Page } from "../shell/router";
import { tissueStyles } from "../tissues";
import type { LibraryInfo, TissueInfo } from "../wire";
import "../styles/cards.css";
import "../styles/pages.css";
import { showFacts } from "./facts";
import { Polled } from "./polled";
import { headCell } from "./rows";
import markup from "./tissues.html?raw";

const EVERY_MS = 30_000;
const DIGITS = 4;

/** Shows the tissue library in use: profiles, sources, spread and curves. */
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
    for (const button of this.axisButtons()) button.addEventListener("click", () => this.showAxis(button.dataset.axis as Axis));
    const section = find(this.root, "library-plot-card");
    this.polled = new Polled({ path: "/api/tissues", title: "The library", section, onAnswer: (library) => this.onAnswer(library) });
  }

  render(): void {}

  themeChanged(): void {
    this.draw();
  }

  close(): void {
    this.polled.close();
    this.sizes.disconnect();
  }

  private onAnswer(library: LibraryInfo): number {
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
    drawReferences(this.canvas, plotArea(this.canvas, this.library, this.axis), this.library);
  }

  private showAxis(axis: Axis): void {
    this.axis = axis;
    for (const button of this.axisButtons()) setAttribute(button, "aria-pressed", String(button.dataset.axis === axis));
    this.draw();
  }

  private axisButtons(): HTMLButtonElement[] {
    return [...this.root.querySelectorAll<HTMLButtonElement>("button[data-axis]")];
  }
}

function rowsOf({ tissues }: LibraryInfo): HTMLTableRowElement[] {
  const styles = new Map(tissueStyles(tissues).map((style) => [style.name, style]));
  return tissues.map((tissue) => {
    const style = styles.get(tissue.name);
    const row = create("tr");
    const what = headCell("what");
    what.dataset.slot = style?.slot ?? "";
    what.append(create("span", "swatch", style?.mark ?? ""), tissue.title);
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

/** Formats a value with its significant digits only. */
const significant = (value: number): string => String(Number(value.toPrecision(DIGITS)));
