import { create, setAttribute } from "../dom";
import type { PlotSpec, Trace } from "./traces";

/** Buttons that hide lines: one per tissue for all charts, and one per line of the tool. */
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

  /** Creates the buttons for a chart's lines of the tool, which stand in its heading. */
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
    setAttribute(button, "aria-label", trace.name); // a narrow chart shows the mark only
    button.title = `Show or hide ${trace.name.toLowerCase()} in all charts`;
    button.append(create("span", "swatch", trace.mark), create("span", "legend-name", trace.name));
    return button;
  }

  private button(trace: Trace, key: string, className: string): HTMLButtonElement {
    const button = create("button", className);
    button.type = "button";
    button.dataset.slot = trace.color.replace(/^--(tissue|line)-/, "");
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

/** Returns the key under which the legend hides a line: the tissue's name, or chart and name for a line of the tool. */
export const legendKey = (spec: PlotSpec, trace: Trace): string => (trace.ofTissue ? trace.key : `${spec.id} ${trace.key}`);
