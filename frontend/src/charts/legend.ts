import { create, setAttribute } from "../dom";
import type { PlotSpec, Trace } from "./traces";

/** One button for each tissue, which hides its lines in every chart, and one for each line of the tool. */
export class Legend {
  readonly hidden = new Set<string>();

  constructor(
    private readonly box: HTMLElement,
    private readonly onToggle: (key: string, visible: boolean) => void,
  ) {}

  rebuild(specs: PlotSpec[]): void {
    const tissues = new Map(specs.flatMap(({ traces }) => traces.filter((trace) => trace.ofTissue)).map((trace) => [trace.key, trace]));
    this.box.replaceChildren(...[...tissues.values()].map((trace) => this.tissueButton(trace)));
  }

  /** The lines of a chart that belong to the tool rather than to a tissue, for its heading. */
  lines(spec: PlotSpec): HTMLElement[] {
    return spec.traces
      .filter((trace) => !trace.ofTissue)
      .map((trace) => {
        const button = this.button(trace, `${spec.id} ${trace.key}`, "line-name");
        button.append(create("span", "line-sample"), trace.name);
        return button;
      });
  }

  private tissueButton(trace: Trace): HTMLButtonElement {
    const button = this.button(trace, trace.key, "legend-key");
    setAttribute(button, "aria-label", trace.name); // on a narrow chart only the mark is shown
    button.title = `Show or hide ${trace.name.toLowerCase()} in all charts`;
    button.append(create("span", "swatch", trace.mark), create("span", "legend-name", trace.name));
    return button;
  }

  private button(trace: Trace, key: string, className: string): HTMLButtonElement {
    const button = create("button", className);
    button.type = "button";
    button.dataset.slot = trace.colour.replace(/^--(tissue|line)-/, "");
    setAttribute(button, "aria-pressed", String(!this.hidden.has(key)));
    button.addEventListener("click", () => {
      const visible = this.hidden.delete(key);
      if (!visible) this.hidden.add(key);
      setAttribute(button, "aria-pressed", String(visible));
      this.onToggle(key, visible);
    });
    return button;
  }
}

/** What the legend calls a line: tissues by their name in all charts, the tool's lines by chart and name. */
export const legendKey = (spec: PlotSpec, trace: Trace): string => (trace.ofTissue ? trace.key : `${spec.id} ${trace.key}`);
