import { create, setAttribute } from "../dom";
import type { PlotSpec, Trace } from "./traces";

/** One button for each tissue; it hides the lines of that tissue in every chart. */
export class Legend {
  readonly hidden = new Set<string>();

  constructor(
    private readonly box: HTMLElement,
    private readonly onToggle: (key: string, visible: boolean) => void,
  ) {}

  rebuild(specs: PlotSpec[]): void {
    const traces = new Map<string, Trace>();
    for (const trace of specs.flatMap((spec) => spec.traces)) {
      if (trace.ofTissue) traces.set(trace.key, trace);
    }
    this.box.replaceChildren(...[...traces.values()].map((trace) => this.button(trace)));
  }

  private button(trace: Trace): HTMLButtonElement {
    const button = create("button", "legend-key");
    button.type = "button";
    button.dataset.slot = slotOf(trace);
    button.title = `Show or hide ${trace.name.toLowerCase()} in all charts`;
    button.append(create("span", "swatch", trace.mark), create("span", "legend-name", trace.name));
    setAttribute(button, "aria-pressed", String(!this.hidden.has(trace.key)));
    button.addEventListener("click", () => {
      const visible = this.hidden.delete(trace.key);
      if (!visible) this.hidden.add(trace.key);
      setAttribute(button, "aria-pressed", String(visible));
      this.onToggle(trace.key, visible);
    });
    return button;
  }
}

/** The lines of a chart that belong to the tool rather than to a tissue, for its heading. */
export function lineNames(spec: PlotSpec): HTMLElement[] {
  return spec.traces
    .filter((trace) => !trace.ofTissue)
    .map((trace) => {
      const name = create("span", "line-name");
      name.dataset.slot = slotOf(trace);
      name.append(create("span", "line-sample"), trace.name);
      return name;
    });
}

const slotOf = (trace: Trace): string => trace.colour.replace(/^--(tissue|line)-/, "");
